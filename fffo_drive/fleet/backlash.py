"""Backlash in a run: the law of the diagnosis along the measured motion, for gaps of a grid, as sums that add up.

The balance of `regress` has rows of sure sliding, which begin after the gap is closed. Here are all rows in motion,
reversals too. What the base columns leave of the torque is regressed on E_k, the torque that the law
`model.effects.laws.backlash` takes away with a gap g_k and all of inertia and friction behind it; the coefficient of
the right gap is the share that is there. With M the projection that removes the base columns of each run, the sums

    E^T M E,   E^T M y,   y^T M y

of an axis' runs are the fit of one gap and one share to all of them, at gaps between those of the grid too: E is smooth
in the logarithm of the gap and interpolated over it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..identification.facts import DriveFacts
from ..identification.kinematics import low_pass, sure_direction
from ..identification.ladder import HIGHEST_CUTOFF_PERIODS
from ..identification.rows import RegressionStretch, rows_at
from ..jit import njit
from ..least_squares import spectrum
from ..model.effects import slots
from ..model.effects.laws.backlash import CONTACT_HZ, LAW
from .pieces import MovingPart, Piece, moving_parts
from .regress import COULOMB, INERTIA, PARAMETERS, BalanceMotion, Estimates, balance_columns, rows_a_block

GAP_REV = np.geomspace(0.002, 0.128, 13)  # at the motor shaft, sqrt(2) apart: from a tight coupling to a worn gear
GAP_UPPER = np.triu_indices(GAP_REV.size)
M_PER_REV = 0.02  # of a linear axis: a gap of one revolution stands for so many metres, as the Stribeck speed does
CUTOFF_HZ = 100.0  # a gap of 0.02 rev is passed in about 25 ms
PRESLIDING_REV = (0.002, 0.006)  # travels of friction's own transition after a reversal, beside the gap
FINE = 24  # gaps between two of the grid at which the fit is looked for
LEAST_EXPLAINED = 0.12  # of the squared residual: simulated runs without a gap have up to 0.11, with one 0.14 to 0.69
LEAST_GAIN = 25.0  # fall of the squared misfit in variances, of a gap against none: five standard deviations
PLAUSIBLE = next(p.plausible for p in LAW.parameters if p.name == "share") or (0.0, 1.0)


class GapSums(NamedTuple):
    """Sums of one run, or of several runs of an axis; k gaps of the grid."""

    normal: Floats  # (k, k) E^T M E
    moment: Floats  # (k,) E^T M y
    energy_nm2: float  # y^T M y
    rows: float
    effective_rows: float  # independent ones among them, for the gap


class Gap(NamedTuple):
    """The gap that sums give; nan where none is found."""

    gap_rev: float  # at the motor shaft; of a linear axis m
    log_sd: float  # standard deviation of its logarithm
    share: float  # of the inertia behind it


_KERNEL = LAW.feedforward or LAW.kernel  # of a motion that is known


@njit
def _law_along(
    signals: Floats, parameters: Floats, memory: Floats, velocity_rps: Floats, acceleration_rps2: Floats,
    output: Floats,
) -> None:  # fmt: skip
    """Torque (n,) that the law takes away along a motion (n,), per share behind the gap."""
    for k in range(memory.size):
        memory[k] = 0.0
    memory[0] = velocity_rps[0]
    memory[2] = velocity_rps[0]
    rest_rps = signals[slots.REST_SPEED_RPS]
    for k in range(velocity_rps.size):
        signals[slots.VELOCITY_RPS] = velocity_rps[k]
        signals[slots.ACCELERATION_RPS2] = acceleration_rps2[k]
        direction = min(1.0, max(-1.0, velocity_rps[k] / rest_rps))
        signals[slots.CONTACT_NM] = signals[slots.COULOMB_NM] * direction
        signals[slots.LOAD_NM] = 0.0
        _KERNEL(signals, parameters, memory)
        output[k] = signals[slots.LOAD_NM] / parameters[0]


def gap_grid(units: str) -> Floats:
    """Gaps of the grid, rev at the motor shaft or m. (k,)"""
    return GAP_REV * (M_PER_REV if units == "linear" else 1.0)


def gap_sums(
    pieces: Iterable[Piece], facts: DriveFacts, found: Estimates, delay_s: float, motion: BalanceMotion, samples: int
) -> GapSums | None:
    """The sums of a run of so many samples; `found`: its balance, whose inertia and Coulomb friction the law needs.

    None where these are not determined, or nothing moves. The law begins anew in each piece, with its margin.
    """
    inertia, coulomb = float(found.theta[INERTIA]), float(found.theta[COULOMB])
    if not (np.isfinite(found.sd[[INERTIA, COULOMB]]).all() and inertia > 0.0 and coulomb > 0.0):
        return None
    unit = M_PER_REV if facts.units == "linear" else 1.0
    grid = gap_grid(facts.units)
    grams: dict[int, Floats] = {}  # by block, of base columns, gaps and torque at rows in motion
    there = np.zeros(len(PARAMETERS), dtype=np.bool_)
    number = moving_rows = 0
    cutoff_hz = min(CUTOFF_HZ, HIGHEST_CUTOFF_PERIODS / next(iter(pieces)).record.period_s)
    for part in moving_parts(pieces, cutoff_hz):
        stretch = part.stretch(0.0, cutoff_hz)
        if stretch is None:
            continue
        rows = rows_at([stretch], cutoff_hz, delay_s)
        moving = np.abs(stretch.motion.velocity_rps[stretch.rows]) > stretch.motion.speed_floor_rps
        columns = balance_columns(rows, facts, motion)
        there |= np.any(columns != 0.0, axis=0)
        gaps = _gap_columns(stretch, grid, inertia, coulomb, cutoff_hz)
        both = np.column_stack([columns, _transitions(part, stretch, unit), gaps, rows.torque_nm])[moving]
        length = rows_a_block(round(samples * part.record.period_s / rows.period_s), rows.period_s)
        block = (number + np.flatnonzero(moving)) // length
        for one in np.unique(block):
            own = both[block == one]
            grams[int(one)] = grams.get(int(one), 0.0) + own.T @ own
        number += moving.size
        moving_rows += int(np.count_nonzero(moving))
    base = np.flatnonzero(np.concatenate([there, np.ones(len(PRESLIDING_REV), dtype=np.bool_)]))
    if moving_rows <= 2 * base.size:
        return None
    blocks = np.array(list(grams.values()))
    first = len(PARAMETERS) + len(PRESLIDING_REV)
    kept = np.concatenate([base, np.arange(first, blocks.shape[1])])
    blocks = blocks[:, kept[:, None], kept]
    basis = spectrum(blocks.sum(axis=0)[: base.size, : base.size]).basis()
    total = blocks.sum(axis=0)
    shift = basis @ (basis.T @ total[: base.size, base.size :])  # of each column on the base: taken out of it
    out = np.vstack([-shift, np.eye(total.shape[0] - base.size)])
    left = out.T @ total @ out
    count = float(moving_rows)
    sums = GapSums(left[:-1, :-1], left[:-1, -1], float(left[-1, -1]), count, count)
    return sums._replace(effective_rows=_effective_rows(sums, left, out.T @ blocks @ out))


def _transitions(part: MovingPart, stretch: RegressionStretch, unit: float) -> Floats:
    """Friction that has not yet followed a reversal: gone after each of these travels. (m, 2)"""
    at = stretch.rows
    direction, travel = sure_direction(part.motion, part.before)[at], part.travel_rev[at]
    return np.column_stack([direction * np.exp(-travel / (unit * length)) for length in PRESLIDING_REV])


def _gap_columns(stretch: RegressionStretch, grid: Floats, inertia: float, coulomb: float, cutoff_hz: float) -> Floats:
    """Torque that each gap takes away from a motor with all of inertia and friction behind it. (m, k)"""
    motion = stretch.motion
    signals, memory = np.zeros(slots.N_SLOTS), np.zeros(slots.MEMORY_SLOTS)
    torque_nm = np.empty((grid.size, motion.velocity_rps.size))
    signals[slots.STEP_S] = motion.period_s
    signals[slots.INERTIA_NM_S2_PER_REV] = inertia
    signals[slots.COULOMB_NM] = coulomb
    signals[slots.REST_SPEED_RPS] = max(motion.speed_floor_rps, 1e-12)
    signals[slots.AT_INSTANTS] = 1.0
    for k, gap in enumerate(grid):
        values = {"gap_rev": float(gap), "friction_share": 1.0, "contact_hz": CONTACT_HZ}
        parameters = np.array([values.get(p.name, p.typical) for p in LAW.parameters])
        _law_along(signals, parameters, memory, motion.velocity_rps, motion.acceleration_rps2, torque_nm[k])
    return low_pass(torque_nm, cutoff_hz, motion.period_s)[:, stretch.rows].T


def _effective_rows(sums: GapSums, left: Floats, blocks: Floats) -> float:
    """Rows over how much the scores of blocks scatter beyond those of independent rows, for the best gap.

    `left` (k + 1, k + 1), `blocks` (b, k + 1, k + 1): products of the gaps' columns and the torque, without the base.
    """
    gains, shares = _gains(sums)
    place = int(np.argmax(gains))
    residual = np.append(-shares[place] * _WEIGHTS[place], 1.0)
    column = np.append(np.gradient(_WEIGHTS, axis=0)[place], 0.0)  # what another gap would add
    expected = float(column @ left @ column) * float(residual @ left @ residual) / sums.rows
    of_blocks = np.einsum("i,bij,j->b", column, blocks, residual)
    ratio = float(of_blocks @ of_blocks) / expected if expected > 0.0 else 1.0
    return sums.rows / max(1.0, ratio)


def _lagrange(places: Floats) -> Floats:
    """Weights (n, k) of the grid's columns at places (n,) counted along it, by the cubic through the four around."""
    first = np.clip(np.floor(places).astype(np.int64) - 1, 0, GAP_REV.size - 4)
    weights = np.zeros((places.size, GAP_REV.size))
    for a in range(4):
        value = np.ones(places.size)
        for b in range(4):
            if b != a:
                value *= (places - first - b) / (a - b)
        weights[np.arange(places.size), first + a] = value
    return weights


_WEIGHTS = _lagrange(np.linspace(0.0, GAP_REV.size - 1.0, FINE * (GAP_REV.size - 1) + 1))


def _gains(sums: GapSums) -> tuple[Floats, Floats]:
    """Fall of the squared residual with each gap, and its share of the inertia (places,); 0 for a share below 0."""
    along = _WEIGHTS @ sums.moment
    size = np.einsum("pk,pk->p", _WEIGHTS @ sums.normal, _WEIGHTS)
    share = np.where(size > 0.0, along / np.where(size > 0.0, size, 1.0), 0.0)
    return np.where(share > 0.0, share * along, 0.0), share


def gap_of(sums: GapSums, units: str) -> Gap:
    """The gap of one run, or of several together; nan where none is found, and at the ends of the grid."""
    none = Gap(math.nan, math.nan, math.nan)
    gains, shares = _gains(sums)
    place = int(np.argmax(gains))
    if not sums.rows > 0.0 or place in (0, gains.size - 1):
        return none
    before, best, after = gains[place - 1 : place + 2]
    curvature = 2.0 * best - before - after
    variance = max(sums.energy_nm2 - best, 0.0) / sums.effective_rows
    share = float(shares[place])
    found = best >= max(LEAST_GAIN * variance, LEAST_EXPLAINED * sums.energy_nm2)
    if curvature <= 0.0 or not found or not PLAUSIBLE[0] <= share <= PLAUSIBLE[1]:
        return none
    step = math.log(GAP_REV[1] / GAP_REV[0]) / FINE
    shift = 0.5 * (after - before) / curvature
    gap = float(gap_grid(units)[0]) * math.exp(step * (place + shift))
    return Gap(gap, step * math.sqrt(2.0 * variance / curvature), share)

"""The additive part of a record: a run's force balance as normal equations, and what these give.

Torque is regressed on what the motion needs, on the rows on which `identify` stands (`identification.rows`):

    torque = J a + sigma w + Fc d + Fst d exp(-|w| / V0) + offset + excess |w| + C cos(angle) + S sin(angle)

a acceleration, w velocity, d its direction; V0 is one number for all, so that the records of an axis add up to the fit
on all of its rows. The last two columns are there where the angle has the same zero in every run.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats, Integers, Mask
from ..identification.criterion import BLOCK_S, SHORTEST_BLOCK_S
from ..identification.facts import DriveFacts
from ..identification.ladder import GRAVITY_PERIODS, wave_columns
from ..identification.rows import RegressionRows, turns_one_way
from ..jit import njit
from ..least_squares import spectrum
from .matrices import inverses

PARAMETERS = (
    "inertia_nm_s2_per_rev", "viscous_nm_per_rps", "coulomb_nm", "stribeck_nm", "offset_nm",
    "viscous_excess_nm_per_rps", "gravity_cos_nm", "gravity_sin_nm",
)  # fmt: skip
INERTIA, VISCOUS, COULOMB, STRIBECK, OFFSET, EXCESS, GRAVITY_COS, GRAVITY_SIN = range(len(PARAMETERS))
RUNGS = {  # of the ladder, those that are columns here
    "constant": (OFFSET,), "direction": (EXCESS,), "gravity": (GRAVITY_COS, GRAVITY_SIN),
}  # fmt: skip
STRIBECK_RPS = 1.0  # V0: between those of small servo motors; one for all, or records would not add up
STRIBECK_M_PER_S = 0.02  # V0 of a linear axis
SINGULAR = 1e-9  # of the scaled normal matrix: what columns have in common beyond it is not known
MOST_BLOCKS = 2000  # of a long run: beyond they say no more of how much blocks scatter
BLOCKS_A_RUN = 60  # of a short run, which are independent pieces: several times as many as columns
LARGEST_INFLATION = 1e3  # of a variance by the other columns: an estimate beyond it says nothing by itself
UPPER = np.triu_indices(len(PARAMETERS))


class Balance(NamedTuple):
    """Normal equations of m rows with p columns: those of two sets of rows are added field by field."""

    normal: Floats  # (p, p) X^T X
    moment: Floats  # (p,) X^T y
    energy_nm2: float  # y^T y
    rows: float
    effective_rows: float  # independent ones among them: rows that follow each other say nearly the same


class Estimates(NamedTuple):
    """What a balance gives, or each of several (...)."""

    theta: Floats  # (..., p) of PARAMETERS, finite; what is not determined is the smallest that fits
    information: Floats  # (..., p, p) inverse covariance; 0 along what is not determined
    sd: Floats  # (..., p) nan where a parameter is not determined
    rms_nm: Floats  # (...) of the residual


class BalanceMotion(NamedTuple):
    """What of the motion at the rows that slide for sure decides which columns there are."""

    one_way: bool
    travel_rev: float


EVERY_COLUMN = BalanceMotion(False, math.inf)


def motion_at(rows: RegressionRows) -> BalanceMotion:
    """Of these rows."""
    travel_rev = float(np.ptp(rows.position_rev[rows.sliding])) if rows.sliding.any() else 0.0
    return BalanceMotion(turns_one_way(rows.direction[rows.sliding]), travel_rev)


def balance_columns(rows: RegressionRows, facts: DriveFacts, motion: BalanceMotion | None = None) -> Floats:
    """Columns of the balance at all rows, in the order of PARAMETERS; 0 where the motion has none. (m, p)

    `motion`: of all rows where these are some of them; None: these are all.
    """
    there = columns_there(facts, motion or motion_at(rows))
    speed = np.abs(rows.velocity_rps)
    v0_rps = STRIBECK_M_PER_S if facts.units == "linear" else STRIBECK_RPS
    columns = np.zeros((speed.size, len(PARAMETERS)))
    columns[:, INERTIA] = rows.acceleration_rps2
    columns[:, VISCOUS] = rows.velocity_rps
    columns[:, COULOMB] = rows.direction
    columns[:, STRIBECK] = rows.direction * np.exp(-speed / v0_rps)
    if there[OFFSET]:
        columns[:, OFFSET] = 1.0
        columns[:, EXCESS] = speed
    if there[GRAVITY_COS]:
        columns[:, GRAVITY_COS:] = wave_columns(rows, output_order(facts))
    return columns


def columns_there(facts: DriveFacts, motion: BalanceMotion) -> Mask:
    """Columns that a motion has. (p,)"""
    there = np.ones(len(PARAMETERS), dtype=np.bool_)
    there[[OFFSET, EXCESS]] = not motion.one_way  # else they are Coulomb and viscous friction
    turns = output_order(facts) * motion.travel_rev
    there[GRAVITY_COS:] = facts.units == "rotary" and facts.absolute_angle and turns >= GRAVITY_PERIODS
    return there


def output_order(facts: DriveFacts) -> float:
    """Order of the motor's angle that the output's angle is."""
    return 1.0 / (facts.gear_ratio or 1.0)


def balance_of(columns: Floats, rows: RegressionRows) -> Balance:
    """Normal equations of the rows that slide for sure; `columns` (m, p) of all rows."""
    kept = np.flatnonzero(rows.sliding)
    own, torque_nm = columns[kept], rows.torque_nm[kept]
    begins = block_starts(kept, rows.run.size, rows.period_s)
    whole = Balance(own.T @ own, own.T @ torque_nm, float(torque_nm @ torque_nm), float(kept.size), float(kept.size))
    solution = solve(whole)
    scores = own * (torque_nm - own @ solution.theta)[:, None]
    sums = np.add.reduceat(scores, begins, axis=0) if kept.size else scores
    return whole._replace(effective_rows=effective_rows(whole, sums, float(solution.rms_nm)))


def block_starts(kept: Integers, count: int, period_s: float) -> Integers:
    """Places in `kept` (m,), rows of `count` in all, at which a block begins that is independent of the one before."""
    return np.flatnonzero(np.diff(kept // rows_a_block(count, period_s), prepend=-1))


def rows_a_block(count: int, period_s: float) -> int:
    """Rows, of `count` in all, after which rows are independent; longer where there would be more than MOST_BLOCKS."""
    length_s = count * period_s
    block_s = max(min(BLOCK_S, max(SHORTEST_BLOCK_S, length_s / BLOCKS_A_RUN)), length_s / MOST_BLOCKS)
    return max(1, round(block_s / period_s))


def effective_rows(balance: Balance, sums: Floats, rms_nm: float) -> float:
    """Rows over how much larger variances are than those of independent rows, by blocks' scores (b, p)."""
    half = sums @ spectrum(balance.normal).basis(SINGULAR)
    rank = half.shape[1]
    if rms_nm == 0.0 or rank == 0 or sums.shape[0] <= rank:
        return balance.rows
    few = sums.shape[0] / (sums.shape[0] - rank)
    ratio = few * float(np.sum(half**2)) / (rank * rms_nm**2)
    return float(balance.rows / max(1.0, ratio))


def solve(balance: Balance) -> Estimates:
    """Least squares, with the covariance that the effective rows give."""
    scalars = (np.array([value]) for value in balance[2:])
    found = solve_each(balance.normal[None], balance.moment[None], *scalars)
    return Estimates(*(one[0] for one in found))


def solve_each(normal: Floats, moment: Floats, energy_nm2: Floats, rows: Floats, effective_rows: Floats) -> Estimates:
    """`solve` of n balances: (n, p, p), (n, p) and (n,) each.

    A fleet has many: by Cholesky, and by eigenvalues only where a direction may not be determined.
    """
    length = np.sqrt(np.diagonal(normal, axis1=-2, axis2=-1))
    scale = np.where(length > 0.0, length, 1.0)
    information: Floats = scale[..., :, None] * scale[..., None, :]
    np.divide(normal, information, out=information)
    within = np.diagonal(information, axis1=-2, axis2=-1) > 0.0  # columns that the motion has
    rank = within.sum(axis=-1)
    inverse, determinant = inverses(information)
    # with ones on the diagonal the smallest eigenvalue is at least the determinant over e, by the means of the others
    rest = np.flatnonzero(determinant < math.e * SINGULAR)
    found = spectrum(information[rest])
    known, curvature = found.known(SINGULAR), found.curvature
    rank[rest] = known.sum(axis=-1)
    for matrices, values in ((inverse, 1.0 / np.where(known, curvature, np.inf)), (information, known * curvature)):
        matrices[rest] = np.einsum("nij,nj,nkj->nik", found.directions, values, found.directions)
    within[rest] &= found.determined(SINGULAR)
    theta, sd, rms_nm = np.empty(scale.shape), np.full(scale.shape, np.nan), np.empty(rank.size)
    sums = np.array([energy_nm2, rows, effective_rows])
    _estimate_each(inverse, scale, rank, within, np.array(moment), sums, theta, information, sd, rms_nm)
    return Estimates(theta, information, sd, rms_nm)


@njit
def _estimate_each(
    inverse: Floats, scale: Floats, rank: Integers, within: npt.NDArray[np.bool_], moment: Floats, sums: Floats,
    theta: Floats, information: Floats, sd: Floats, rms_nm: Floats,
) -> None:  # fmt: skip
    """Estimates by the inverses of scaled balances; `information`: these balances, which become it in place."""
    size = scale.shape[1]
    for n in range(scale.shape[0]):
        explained = 0.0
        for i in range(size):
            value = 0.0
            for j in range(size):
                value += inverse[n, i, j] * (moment[n, j] / scale[n, j])
            theta[n, i] = value / scale[n, i]
            explained += moment[n, i] * theta[n, i]
        left = max(sums[0, n] - explained, 0.0)
        rows = max(sums[1, n], 1.0)
        variance_nm2 = left / max(sums[1, n] - rank[n], 1.0)
        precision = sums[2, n] / rows / variance_nm2 if variance_nm2 > 0.0 else 0.0
        rms_nm[n] = math.sqrt(left / rows)
        for i in range(size):
            for j in range(size):
                information[n, i, j] *= scale[n, i] * scale[n, j] * precision
            if within[n, i] and inverse[n, i, i] < LARGEST_INFLATION and precision > 0.0:
                sd[n, i] = math.sqrt(max(inverse[n, i, i], 0.0) / precision) / scale[n, i]


def explained_by(balance: Balance, without: tuple[int, ...]) -> float:
    """Share of the squared residual that these columns explain beside all others: of a rung of the ladder."""
    keep = np.setdiff1d(np.arange(len(PARAMETERS)), without)
    rest = solve(balance._replace(normal=balance.normal[np.ix_(keep, keep)], moment=balance.moment[keep]))
    left, whole = float(rest.rms_nm) ** 2, float(solve(balance).rms_nm) ** 2
    return max(0.0, 1.0 - whole / left) if left > 0.0 else 0.0


def packed(normal: Floats) -> Floats:
    """Upper triangle of (p, p), row by row."""
    return np.asarray(normal[UPPER])


def unpacked(upper: Floats, size: int = len(PARAMETERS)) -> Floats:
    """(..., size, size) of upper triangles (..., size (size + 1) / 2)."""
    full = np.zeros((*upper.shape[:-1], size, size))
    rows, columns = np.triu_indices(size)
    full[..., rows, columns] = upper
    full[..., columns, rows] = upper
    return full

"""The start of the fit: a linear regression of the motor's torque on what the motion needs.

    Kt i(t - Td) = J a + sigma w + sgn(w) (Fc + (Fs - Fc) exp(-(|w| / Vs)^delta))

Linear in J, sigma, Fc and Fs - Fc; Td, Vs and delta are scanned. Torque and every regressor go through one and the same
zero-phase filter and are decimated alike; presliding is masked by travel after a reversal.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .dataset import DataError, Record
from .kinematics import Motion, acting_torque_nm, motion_of, sliding_mask, travel_since_reversal_rev, trusted
from .ranking import lower

Floats = npt.NDArray[np.float64]

LONGEST_DELAY_SAMPLES = 24
EXPONENTS = (0.7, 1.0, 1.5, 2.0)
LEAST_ROWS = 200
TORQUE_TO_INERTIA_RPS2 = (5.0, 30_000.0)  # acceleration at the rated current of any sane rotary axis


class TorqueStart(NamedTuple):
    """What the regression found; torques in Nm (N), of revolutions (m)."""

    inertia_nm_s2_per_rev: float
    viscous_nm_per_rps: float
    coulomb_nm: float
    static_nm: float
    stribeck_velocity_rps: float
    stribeck_exponent: float
    delay_s: float
    relative_error: float  # of torque, sliding only
    rows: int
    sliding_travel_rev: float


class _Stack(NamedTuple):
    velocity_rps: Floats
    acceleration_rps2: Floats
    torque_nm: Floats


class _Stretch(NamedTuple):
    """One stretch without a gap, filtered once: a delay and a filter commute."""

    motion: Motion
    torque_nm: Floats  # without delay
    rows: npt.NDArray[np.int64]  # sliding, decimated


def _sliding_travel_rev(motions: Sequence[Motion], lsb_rev: float) -> float:
    """Travel after which presliding is over, for the start: a share of a typical stroke, at least some counts."""
    strokes: list[Floats] = []
    for motion in motions:
        travel = travel_since_reversal_rev(motion)
        strokes.append(travel[np.flatnonzero(np.diff(travel) < 0.0)])
    stroke = np.concatenate(strokes) if strokes else np.zeros(0)
    stroke = stroke[stroke > 50.0 * lsb_rev]
    typical = float(np.median(stroke)) if stroke.size else 0.0
    return max(20.0 * lsb_rev, min(0.1 * typical, 2000.0 * lsb_rev))


def _stretches(records: Sequence[Record], cutoff_hz: float) -> tuple[list[_Stretch], float]:
    parts = [
        (record, part)
        for record in records
        for part in record.segments()
        if part.stop - part.start > 4.0 / (cutoff_hz * record.period_s)
    ]
    if not parts:
        raise DataError("all stretches of the logs are too short for the filter")
    motions = [motion_of(record, part, cutoff_hz) for record, part in parts]
    travel_rev = _sliding_travel_rev(motions, max(record.lsb_rev for record in records))
    step = max(1, int(0.25 / (cutoff_hz * records[0].period_s)))
    found = []
    for (record, part), motion in zip(parts, motions, strict=True):
        mask = sliding_mask(motion, travel_rev, 2.0 / cutoff_hz) & trusted(record, part, cutoff_hz)
        rows = np.flatnonzero(mask)[::step]
        found.append(_Stretch(motion, acting_torque_nm(record, part, 0.0, cutoff_hz), rows))
    return found, travel_rev


def _stack(stretches: Sequence[_Stretch], delay_s: float) -> _Stack:
    columns: tuple[list[Floats], list[Floats], list[Floats]] = ([], [], [])
    for motion, torque_nm, rows in stretches:
        columns[0].append(motion.velocity_rps[rows])
        columns[1].append(motion.acceleration_rps2[rows])
        columns[2].append(np.interp(rows - delay_s / motion.period_s, np.arange(torque_nm.size), torque_nm))
    return _Stack(*(np.concatenate(column) for column in columns))


def _solve(stack: _Stack, columns: list[Floats]) -> tuple[Floats, float]:
    base = [stack.acceleration_rps2, stack.velocity_rps, np.sign(stack.velocity_rps), *columns]
    matrix = np.column_stack(base)
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    solution, *_ = np.linalg.lstsq(matrix / scale, stack.torque_nm, rcond=1e-10)
    residual = stack.torque_nm - (matrix / scale) @ solution
    return solution / scale, float(residual @ residual)


def regression_start(records: Sequence[Record], cutoff_hz: float = 40.0) -> TorqueStart:
    """Start values from one or several records of one axis.

    Raises DataError where the records do not hold enough sliding motion for it.
    """
    cutoff_hz = min(cutoff_hz, 0.1 / records[0].period_s)
    stretches, travel_rev = _stretches(records, cutoff_hz)
    period_s = records[0].period_s
    delays: Floats = np.arange(0.0, LONGEST_DELAY_SAMPLES + 1, 2) * period_s
    costs = []
    for delay_s in delays:
        stack = _stack(stretches, float(delay_s))
        if stack.torque_nm.size < LEAST_ROWS:
            raise DataError(
                f"only {stack.torque_nm.size} samples of sure sliding motion in {len(records)} log(s), {LEAST_ROWS} "
                "are needed: raise the current of the excitation, or add a run at higher speed"
            )
        costs.append(_solve(stack, [])[1])
    delay_s = _parabola_minimum(delays, np.array(costs))
    stack = _stack(stretches, delay_s)
    speed = np.abs(stack.velocity_rps)
    best = (np.inf, 1.0, 1.0, np.zeros(4))
    low, high = float(np.quantile(speed, 0.02)), float(np.quantile(speed, 0.9))
    for velocity in np.geomspace(max(low, 1e-3 * high), 0.5 * high, 14):
        for exponent in EXPONENTS:
            bump = np.sign(stack.velocity_rps) * np.exp(-((speed / velocity) ** exponent))
            solution, cost = _solve(stack, [bump])
            plausible = solution[2] > 0.0 and solution[3] > 0.0 and solution[1] > 0.0
            if plausible and lower(cost, best[0]):
                best = (cost, float(velocity), exponent, solution)
    if not np.isfinite(best[0]):
        solution, cost = _solve(stack, [])
        best = (cost, 0.1 * high, 1.0, np.append(solution, 0.1 * abs(solution[2])))
    cost, velocity, exponent = best[:3]
    inertia, viscous, coulomb, excess = (float(value) for value in best[3])
    energy = float(stack.torque_nm @ stack.torque_nm)
    coulomb = max(float(coulomb), 1e-3 * float(np.abs(stack.torque_nm).mean()))
    return TorqueStart(
        float(inertia),
        max(float(viscous), 1e-3 * coulomb / high),
        coulomb,
        coulomb + min(max(float(excess), 0.02 * coulomb), 6.0 * coulomb),
        velocity,
        exponent,
        delay_s,
        float(np.sqrt(cost / energy)),
        stack.torque_nm.size,
        travel_rev,
    )


def _parabola_minimum(x: Floats, y: Floats) -> float:
    k = int(np.argmin(y))
    if k in (0, y.size - 1):
        return float(x[k])
    curvature = y[k - 1] - 2.0 * y[k] + y[k + 1]
    shift = 0.5 * (y[k - 1] - y[k + 1]) / curvature if curvature > 0.0 else 0.0
    return float(x[k] + shift * (x[1] - x[0]))


def start_problems(start: TorqueStart, torque_constant_nm_per_a: float, rated_current_a: float | None) -> list[str]:
    """Where the start speaks of wrong units rather than of an axis: sentences, none where it is sane."""
    problems = []
    inertia = start.inertia_nm_s2_per_rev
    if not inertia > 0.0:
        return [
            f"the fitted inertia is {inertia:.3g} Nm s^2/rev: torque and acceleration have opposite signs, or hardly "
            "anything accelerates. Check the signs of command and position, and that both are of the same run"
        ]
    if rated_current_a is not None:
        acceleration = torque_constant_nm_per_a * rated_current_a / inertia
        low, high = TORQUE_TO_INERTIA_RPS2
        if not low <= acceleration <= high:
            way = "small" if acceleration > high else "large"
            problems.append(
                f"the fitted inertia is absurdly {way}: {inertia:.3g} Nm s^2/rev would accelerate at "
                f"{acceleration:.3g} rev/s^2 under the rated current ({low:g} to {high:g} are sane). A unit is "
                "wrong: rpm for rps is a factor of 60, rad for rev 6.28, degrees 360; or the torque constant is not "
                "that of this drive"
            )
    return problems

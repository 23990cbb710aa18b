"""Rows of a force balance: motor torque and the terms of the motion, all through one zero-phase filter.

Command, position and the sign of the motion are low-passed alike, so that a linear relation between them is preserved,
and decimated to four rows per period of the cut-off. Only rows in certain sliding are used: presliding is masked by the
travel after a reversal, as are rows that depend on filled-in samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Integers, Mask
from ..least_squares import LinearFit, robust_least_squares
from .dataset import DataError, Record
from .kinematics import (
    NOTHING_BEFORE,
    Before,
    Kinematics,
    acting_torque_nm,
    low_pass,
    motion_of,
    sliding_mask,
    sure_direction,
    travel_since_reversal_rev,
    trusted,
)

ROWS_A_PERIOD = 4.0  # of the filter's cut-off
ACCELERATION, VELOCITY, DIRECTION, CONSTANT = range(4)  # of the rigid balance's columns
LEAST_OTHER_WAY = 0.02  # share of the rows that must turn the other way
PRESLIDING_SHARE = 5e-4  # of a typical stroke, by which presliding may last however fine the sensor is
LONGEST_DELAY_SAMPLES = 24
LONGEST_DELAY_S = 0.012  # the scan goes as far as the longer of the two ...
LAST_DELAY_S = 0.1  # ... and on to here where it has no minimum before


class RegressionStretch(NamedTuple):
    """One segment without a gap, filtered once, since a delay and a filter commute. (n,) except `rows`."""

    record: int
    motion: Kinematics
    torque_nm: Floats  # without delay
    direction: Floats  # filtered sign of the motion
    sliding: Mask  # surely
    rows: Integers  # samples that are rows


class RegressionRows(NamedTuple):
    """Rows of all segments, joined; (m,) each."""

    run: Integers  # number of the record
    position_rev: Floats
    velocity_rps: Floats
    acceleration_rps2: Floats
    direction: Floats
    torque_nm: Floats  # of the motor, as it acts
    sliding: Mask  # rows that count
    bounds: tuple[tuple[int, int], ...]  # rows (begin, end) of each stretch
    period_s: float  # between rows
    cutoff_hz: float


def stretches_of(records: Sequence[Record], cutoff_hz: float) -> tuple[list[RegressionStretch], float]:
    """Segments of records of one rate, and the travel (rev) after which presliding is certainly over.

    Raises DataError where none is long enough for the filter.
    """
    parts = [
        (number, record, part)
        for number, record in enumerate(records)
        for part in record.segments()
        if part.stop - part.start > 4.0 / (cutoff_hz * record.period_s)
    ]
    if not parts:
        raise DataError("all stretches of the logs are too short for the filter")
    motions = [motion_of(record, part, cutoff_hz) for _, record, part in parts]
    strokes = []
    for motion in motions:
        travel = travel_since_reversal_rev(motion)
        strokes.append(travel[stroke_ends(travel)])
    travel_rev = sliding_travel_rev(np.concatenate(strokes), max(record.lsb_rev for record in records))
    step = samples_a_row(records[0].period_s, cutoff_hz)
    return [
        stretch_of(number, record, part, motion, travel_rev, cutoff_hz, np.arange(0, part.stop - part.start, step))
        for (number, record, part), motion in zip(parts, motions, strict=True)
    ], travel_rev


def samples_a_row(period_s: float, cutoff_hz: float) -> int:
    """Samples from one row to the next."""
    return max(1, int(1.0 / (ROWS_A_PERIOD * cutoff_hz * period_s)))


def stretch_of(
    number: int,
    record: Record,
    part: slice,
    motion: Kinematics,
    travel_rev: float,
    cutoff_hz: float,
    rows: Integers,
    before: Before = NOTHING_BEFORE,
) -> RegressionStretch:
    """One segment with its motion; presliding is over after `travel_rev`."""
    sliding = sliding_mask(motion, travel_rev, 2.0 / cutoff_hz, before) & trusted(record, part, cutoff_hz)
    direction = low_pass(sure_direction(motion, before), cutoff_hz, record.period_s)
    torque_nm = acting_torque_nm(record, part, 0.0, cutoff_hz)
    return RegressionStretch(number, motion, torque_nm, direction, sliding, rows)


def stroke_ends(travel_rev: Floats) -> Integers:
    """Samples of a travel since reversals (n,) at which a stroke ends."""
    return np.flatnonzero(np.diff(travel_rev) < 0.0)


def sliding_travel_rev(stroke: Floats, lsb_rev: float) -> float:
    """Travel after which presliding is over: a share of a typical stroke, of all strokes (n,), at least some counts."""
    stroke = stroke[stroke > 50.0 * lsb_rev]
    typical = float(np.median(stroke)) if stroke.size else 0.0
    return max(20.0 * lsb_rev, min(0.1 * typical, max(2000.0 * lsb_rev, PRESLIDING_SHARE * typical)))


def rows_at(stretches: Sequence[RegressionStretch], cutoff_hz: float, delay_s: float) -> RegressionRows:
    """The rows of segments, with the torque `delay_s` after the command."""
    period_s = stretches[0].motion.period_s
    step = int(stretches[0].rows[1] - stretches[0].rows[0])
    bounds, begin = [], 0
    torques = []
    for stretch in stretches:
        bounds.append((begin, begin + stretch.rows.size))
        begin += stretch.rows.size
        late = stretch.rows - delay_s / period_s
        torques.append(np.interp(late, np.arange(stretch.torque_nm.size), stretch.torque_nm))
    return RegressionRows(
        np.concatenate([np.full(s.rows.size, s.record, dtype=np.int64) for s in stretches]),
        np.concatenate([s.motion.position_rev[s.rows] for s in stretches]),
        np.concatenate([s.motion.velocity_rps[s.rows] for s in stretches]),
        np.concatenate([s.motion.acceleration_rps2[s.rows] for s in stretches]),
        np.concatenate([s.direction[s.rows] for s in stretches]),
        np.concatenate(torques),
        np.concatenate([s.sliding[s.rows] for s in stretches]),
        tuple(bounds),
        step * period_s,
        cutoff_hz,
    )


def rigid_columns(rows: RegressionRows) -> Floats:
    """Columns of inertia, viscous friction, Coulomb friction and constant torque, for all rows. (m, 4)"""
    return np.column_stack([rows.acceleration_rps2, rows.velocity_rps, rows.direction, np.ones(rows.run.size)])


class Rigid(NamedTuple):
    """The rigid balance of rows by robust least squares, at the delay at which it leaves least."""

    delay_s: float
    has_minimum: bool  # False: the residual falls to the end of the scan, and the delay is 0
    inertia_nm_s2_per_rev: float
    told: float  # share of the torque beside friction that the acceleration explains: noise in it lowers both


def rigid_balance(stretches: Sequence[RegressionStretch], cutoff_hz: float) -> Rigid:
    """The balance at the delay of `scanned_delay`. Weight on the shaft would bias it: there it has columns."""

    def columns(rows: RegressionRows) -> Floats:
        angle = 2.0 * np.pi * rows.position_rev
        return np.column_stack([rigid_columns(rows), np.cos(angle), np.sin(angle)])

    delay_s, nearest_s = scanned_delay(stretches, cutoff_hz, columns)
    rows = rows_at(stretches, cutoff_hz, nearest_s)
    return Rigid(delay_s or 0.0, delay_s is not None, *_inertia(rows))


def scanned_delay(
    stretches: Sequence[RegressionStretch], cutoff_hz: float, columns: Callable[[RegressionRows], Floats]
) -> tuple[float | None, float]:
    """Delay (s) from command to torque, by a scan, on to LAST_DELAY_S where it has to be, and a parabola; and the best
    one of the scan. None where the residual falls to the end of the scan. `columns` of rows (m,) are fitted, (m, k).
    """
    period_s = stretches[0].motion.period_s
    losses: list[float] = []
    count = longest_delay_samples(period_s)
    while True:
        for sample in range(2 * len(losses), count + 1, 2):
            rows = rows_at(stretches, cutoff_hz, sample * period_s)
            losses.append(robust_least_squares(columns(rows)[rows.sliding], rows.torque_nm[rows.sliding])[1])
        best = int(np.argmin(losses))
        last = math.ceil(LAST_DELAY_S / period_s)
        if best < len(losses) - 1 or count >= last:
            break
        count = last
    delays = 2.0 * period_s * np.arange(len(losses), dtype=np.float64)
    return parabola_minimum(delays, np.array(losses)), float(delays[best])


def _inertia(rows: RegressionRows) -> tuple[float, float]:
    """Inertia, and what the acceleration explains."""
    torque_nm = rows.torque_nm[rows.sliding]
    fit, loss, _ = robust_least_squares(rigid_columns(rows)[rows.sliding], torque_nm)
    return float(fit.values[ACCELERATION]), told_by_acceleration(fit, loss * torque_nm.size)


def told_by_acceleration(fit: LinearFit, cost: float) -> float:
    """Share of what friction and effects leave that the acceleration explains."""
    variance = fit.spectrum.inverse()[ACCELERATION, ACCELERATION] / fit.spectrum.lengths[ACCELERATION] ** 2
    explained = float(fit.values[ACCELERATION]) ** 2 / variance
    return float(explained / (explained + cost))


def longest_delay_samples(period_s: float) -> int:
    """As far as the scan for the delay goes."""
    return max(LONGEST_DELAY_SAMPLES, math.ceil(LONGEST_DELAY_S / period_s))


def turns_one_way(direction: Floats) -> bool:
    """Whether the motion is one-way (hardly a row (m,) of the other sign), so that Coulomb friction and a constant
    torque are inseparable.
    """
    return is_one_way(int(np.sum(direction > 0.0)), int(np.sum(direction < 0.0)), direction.size)


def is_one_way(forwards: float, backwards: float, rows: float) -> bool:
    """The same by numbers of rows."""
    return min(forwards, backwards) < LEAST_OTHER_WAY * rows if rows else True


def parabola_minimum(x: Floats, y: Floats) -> float | None:
    """Where a parabola through the smallest of `y` (n,) over even `x` (n,) and its neighbours has its minimum.

    None where `y` still falls at the last `x`; the first one is a bound, and may be where it is.
    """
    k = int(np.argmin(y))
    if k in (0, y.size - 1):
        return float(x[k]) if k == 0 else None
    curvature = y[k - 1] - 2.0 * y[k] + y[k + 1]
    shift = 0.5 * (y[k - 1] - y[k + 1]) / curvature if curvature > 0.0 else 0.0
    return float(x[k] + shift * (x[1] - x[0]))

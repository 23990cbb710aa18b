"""Prediction errors of all records at given parameters, and their Jacobian, on two threads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats, Mask
from ..model.axis import AxisConfig
from ..model.effects import slots
from ..model.effects.table import EffectTable, Term, effect_table
from .coordinates import PARAMETERS, Coordinates, axis_of, to_physical
from .dataset import Record
from .kinematics import trusted
from .layout import EffectLayout
from .shooting import ShootingConfig, innovations
from .threads import in_threads

OBSERVER_DAMPING = 0.8
BLOCK_PERIODS = 0.08  # of the observer's bandwidth: length over which residuals are averaged
SETTLING_PERIODS = 3.0  # of the observer's bandwidth, before its errors count
STILL_S = 0.2  # standstill: no motion beyond the sensor's resolution for this long
STILL_LSB = 2.5
CLUSTER_S = 0.25
JUMP = 0.5  # slopes of the two sides that differ by more than this share are those of a jump
BANDWIDTH_PERIODS = 0.04  # of the rate: the highest bandwidth of an observer
LONGEST_STEP_S = 0.0101  # of the simulation: in a longer one friction stops the axis and throws it back
STEP = 2e-3  # of the finite differences, in coordinates


class PredictedStretch(NamedTuple):
    """One segment without a gap."""

    record: int
    first: int  # sample of the record
    current_a: Floats
    position_rev: Floats
    kept: Mask  # (blocks,): what counts
    torque_constant_nm_per_a: float


class Problem(NamedTuple):
    """All inputs of the residual."""

    stretches: tuple[PredictedStretch, ...]
    shooting: ShootingConfig
    cluster_blocks: int
    lsb_rev: float
    layout: EffectLayout | None = None  # of the parameters after the model's own in a vector; None: no effects

    @property
    def rows(self) -> int:
        """Number of residuals used."""
        return sum(int(s.kept.sum()) for s in self.stretches)

    def clusters(self) -> npt.NDArray[np.int64]:
        """Number of the window of each residual; windows are clusters of dependent residuals. (rows,)"""
        found, offset = [], 0
        for stretch in self.stretches:
            number = np.arange(stretch.kept.size) // self.cluster_blocks
            found.append(offset + number[stretch.kept])
            offset += int(number[-1]) + 1 if number.size else 0
        return np.concatenate(found)


def observer(period_s: float, bandwidth_hz: float, block: int) -> ShootingConfig:
    """An observer that follows the position with this bandwidth."""
    omega = 2.0 * math.pi * bandwidth_hz
    substeps = math.ceil(period_s / LONGEST_STEP_S)
    return ShootingConfig(
        period_s, substeps, 0, block, 2.0 * OBSERVER_DAMPING * omega * period_s, omega * omega * period_s
    )


def make_problem(records: Sequence[Record], bandwidth_hz: float, longest_s: float | None = None) -> Problem:
    """Residuals of records at one observer bandwidth; `longest_s` takes the start of each record only."""
    period_s = records[0].period_s
    block = max(1, round(BLOCK_PERIODS / (bandwidth_hz * period_s)))
    shooting = observer(period_s, bandwidth_hz, block)
    stretches = []
    for number, record in enumerate(records):
        for part in record.segments():
            stop = part.stop if longest_s is None else min(part.stop, part.start + round(longest_s / period_s))
            position = np.ascontiguousarray(record.position_rev[part.start : stop])
            blocks = position.size // block
            settling = math.ceil(SETTLING_PERIODS / (bandwidth_hz * period_s * block))
            if blocks <= settling + 1:
                continue
            kept = moving_blocks(position, record.lsb_rev, block, period_s)
            kept[:settling] = False
            kept &= _trusted_blocks(record, slice(part.start, stop), bandwidth_hz, block)
            current = np.ascontiguousarray(record.current_a[part.start : stop])
            stretches.append(
                PredictedStretch(number, part.start, current, position, kept, record.torque_constant_nm_per_a)
            )
    clusters = max(1, round(CLUSTER_S / (block * period_s)))
    return Problem(tuple(stretches), shooting, clusters, max(record.lsb_rev for record in records))


def _trusted_blocks(record: Record, part: slice, bandwidth_hz: float, block: int) -> Mask:
    """False where the observer depends on filled-in samples. (blocks,)"""
    blocks = (part.stop - part.start) // block
    return np.asarray(trusted(record, part, bandwidth_hz)[: blocks * block].reshape(blocks, block).all(axis=1))


def moving_blocks(position_rev: Floats, lsb_rev: float, block: int, period_s: float) -> Mask:
    """False where the position has not moved for a while, by its resolution: a dwell has no information. (blocks,)"""
    blocks = position_rev.size // block
    shaped = position_rev[: blocks * block].reshape(blocks, block)
    high, low = shaped.max(axis=1), shaped.min(axis=1)
    half = max(1, round(0.5 * STILL_S / (block * period_s)))
    span = np.full(blocks, np.inf)
    if blocks > 2 * half:
        windows_high = np.lib.stride_tricks.sliding_window_view(high, 2 * half + 1).max(axis=1)
        windows_low = np.lib.stride_tricks.sliding_window_view(low, 2 * half + 1).min(axis=1)
        span[half : blocks - half] = windows_high - windows_low
    return np.asarray(span > STILL_LSB * lsb_rev)


def table_at(terms: Sequence[Term], axis: AxisConfig, step_s: float, step: int) -> EffectTable | None:
    """The effects at rest at a step of a record; None where there are none."""
    if not terms:
        return None
    table = effect_table(terms, axis, step_s)
    table.signals[slots.TIME_S] = step * step_s
    return table


def residual(problem: Problem, physical: Floats) -> Floats:
    """Prediction errors in counts of the sensor, (rows,)."""
    found = []
    for stretch in problem.stretches:
        axis, nuisance = axis_of(physical, stretch.torque_constant_nm_per_a)
        output = np.empty(stretch.kept.size)
        terms = problem.layout.terms(physical[len(PARAMETERS) :], stretch.record) if problem.layout else ()
        step_s = problem.shooting.period_s / problem.shooting.substeps
        table = table_at(terms, axis, step_s, stretch.first * problem.shooting.substeps)
        innovations(axis, table, problem.shooting, nuisance, stretch.current_a, stretch.position_rev, 0, output)
        found.append(output[stretch.kept])
    return np.concatenate(found) / problem.lsb_rev


def residuals(problem: Problem, candidates: Sequence[Floats]) -> list[Floats]:
    """`residual` at several parameter vectors, on as many threads as there are."""
    if len(candidates) == 1:
        return [residual(problem, candidates[0])]
    return list(in_threads(lambda candidate: residual(problem, candidate), candidates))


def _smooth_slope(forward: Floats, backward: Floats) -> Floats:
    """Mean of the one-sided slopes; the smaller one if they disagree, zero if their signs differ.

    A reversal that appears or disappears with a parameter makes the residual jump, which is not a slope.
    """
    larger = np.maximum(np.abs(forward), np.abs(backward))
    apart = np.abs(forward - backward) > JUMP * larger
    smaller = np.where(np.abs(forward) < np.abs(backward), forward, backward)
    one_sided = np.where(forward * backward > 0.0, smaller, 0.0)
    return np.asarray(np.where(apart, one_sided, 0.5 * (forward + backward)))


def jacobian(
    problem: Problem, space: Coordinates, values: Floats, base: Floats, free: npt.NDArray[np.int64], central: bool
) -> Floats:
    """Derivatives of the residuals `base` (rows,) by the free coordinates, by finite differences. (rows, free)"""
    points, steps = [], []
    signs = (1.0, -1.0) if central else (1.0,)
    for k in free:
        inward = -1.0 if not central and values[k] + STEP > space.high[k] else 1.0
        steps.append(inward * STEP)
        for sign in signs:
            moved = values.copy()
            moved[k] += sign * steps[-1]
            points.append(to_physical(moved, space.scale))
    found = residuals(problem, points)
    matrix = np.empty((base.size, free.size))
    for column, step in enumerate(steps):
        if central:
            matrix[:, column] = _smooth_slope((found[2 * column] - base) / step, (base - found[2 * column + 1]) / step)
        else:
            matrix[:, column] = (found[column] - base) / step
    return matrix

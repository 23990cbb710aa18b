"""Velocity, acceleration and delayed torque from recorded signals, all through the same zero-phase filter."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy  # its modules load where they are first used

from ..arrays import Floats, Mask
from .dataset import Record

DEFAULT_CUTOFF_HZ = 40.0
FILTER_ORDER = 4  # in total: half of it forwards, half backwards
FILLED_SHARE = 0.1  # of a filtered row's weight that may come from filled-in samples
SPEED_FLOOR_LSB = 3.0  # below this many counts in the filter's memory the sign of a speed is uncertain


class Kinematics(NamedTuple):
    """Kinematics of one stretch without a gap; (n,) each."""

    period_s: float
    position_rev: Floats
    velocity_rps: Floats
    acceleration_rps2: Floats
    speed_floor_rps: float  # below it the sign of the velocity is uncertain


def low_pass(values: Floats, cutoff_hz: float, period_s: float, order: int = FILTER_ORDER) -> Floats:
    """Zero-phase Butterworth filter of `order` in all, half of it each way; a cut-off beyond 0.45 of the rate: none."""
    if cutoff_hz * period_s >= 0.45:
        return values
    sections = scipy.signal.butter(max(1, order // 2), cutoff_hz, fs=1.0 / period_s, output="sos")
    padding = min(values.size - 1, round(3.0 / (cutoff_hz * period_s)))
    return np.asarray(scipy.signal.sosfiltfilt(sections, values, padlen=padding))


def central_difference(values: Floats, period_s: float) -> Floats:
    """Derivative by central differences, one-sided at the ends."""
    return np.asarray(np.gradient(values, period_s))


def motion_of(record: Record, part: slice, cutoff_hz: float = DEFAULT_CUTOFF_HZ) -> Kinematics:
    """Filtered position of a stretch and its two derivatives."""
    origin = record.position_rev[part.start]
    position_rev = low_pass(record.position_rev[part] - origin, cutoff_hz, record.period_s) + origin
    velocity_rps = central_difference(position_rev, record.period_s)
    acceleration_rps2 = central_difference(velocity_rps, record.period_s)
    floor_rps = SPEED_FLOOR_LSB * record.lsb_rev * cutoff_hz
    return Kinematics(record.period_s, position_rev, velocity_rps, acceleration_rps2, floor_rps)


def trusted(record: Record, part: slice, cutoff_hz: float = DEFAULT_CUTOFF_HZ) -> Mask:
    """False where a filtered signal depends on filled-in samples. (n,)"""
    if record.good is None:
        return np.ones(part.stop - part.start, dtype=np.bool_)
    filled = low_pass((~record.good[part]).astype(np.float64), cutoff_hz, record.period_s)
    return np.asarray(filled <= FILLED_SHARE)


def acting_torque_nm(record: Record, part: slice, delay_s: float, cutoff_hz: float = DEFAULT_CUTOFF_HZ) -> Floats:
    """Motor torque at the instants of the samples: the held command, `delay_s` late, through the same filter. (n,)

    The hold is included: the value at an instant is averaged over the period around it, as a derivative is.
    """
    current_a = record.current_a[part]
    charge = np.concatenate([[0.0], np.cumsum(current_a)])  # of the held command, in A samples
    at = np.arange(current_a.size) - delay_s / record.period_s
    mean_a = np.interp(at + 0.5, np.arange(charge.size), charge) - np.interp(at - 0.5, np.arange(charge.size), charge)
    return record.torque_constant_nm_per_a * low_pass(mean_a, cutoff_hz, record.period_s)


class Before(NamedTuple):
    """What is known of the motion before a stretch."""

    direction: float = 0.0  # of the last certain motion; 0: there was none
    travel_rev: float = 0.0  # since the last certain change of direction


NOTHING_BEFORE = Before()


def sure_direction(motion: Kinematics, before: Before = NOTHING_BEFORE) -> Floats:
    """Sign of the present motion, or of the last certain one; 0 before any. (n,)"""
    direction = np.where(np.abs(motion.velocity_rps) > motion.speed_floor_rps, np.sign(motion.velocity_rps), 0.0)
    sure = np.flatnonzero(direction)
    if not sure.size:
        return np.full(direction.size, before.direction)
    if before.direction == 0.0:
        return _held(direction[sure], np.concatenate([[0], sure[1:]]), direction.size)
    sure = np.concatenate([[0], sure[sure > 0]])
    direction[0] = direction[0] or before.direction
    return _held(direction[sure], sure, direction.size)


def travel_since_reversal_rev(motion: Kinematics, before: Before = NOTHING_BEFORE) -> Floats:
    """Travel since the last certain change of direction; 0 before any. (n,)"""
    held = sure_direction(motion, before)
    if not held.any():
        return held
    turned = np.flatnonzero(np.diff(held) != 0.0) + 1
    starts = np.concatenate([[0], turned])
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(motion.position_rev)))])
    travel = path - _held(path[starts], starts, held.size)
    if held[0] == before.direction:
        travel[: turned[0] if turned.size else None] += before.travel_rev
    return travel


def stroke_lengths_rev(motion: Kinematics) -> Floats:
    """Travel from one certain reversal to the next, of the stroke that each sample is in. (n,)"""
    travel = travel_since_reversal_rev(motion)
    last = np.append(np.flatnonzero(np.diff(travel) < 0.0), travel.size - 1)
    return np.repeat(travel[last], np.diff(last, prepend=-1))


def _held(values: Floats, starts: npt.NDArray[np.int64], count: int) -> Floats:
    """Each value from its start, the first of which is 0, to the next one. (count,)"""
    return np.repeat(values, np.diff(starts, append=count))


def sliding_mask(motion: Kinematics, travel_rev: float, margin_s: float, before: Before = NOTHING_BEFORE) -> Mask:
    """Whether the axis certainly slides: fast enough, far enough after a reversal, not at the ends. (n,)"""
    mask = np.abs(motion.velocity_rps) > motion.speed_floor_rps
    mask &= travel_since_reversal_rev(motion, before) > travel_rev
    edge = min(mask.size // 2, round(margin_s / motion.period_s))
    mask[:edge] = False
    mask[mask.size - edge :] = False
    return np.asarray(mask)

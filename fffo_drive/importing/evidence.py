"""What the data say of their columns: wraps, steps in time, derivatives, and torque against acceleration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from .source import Floats

LEAST_STEPS = 8
STEADY = 0.5  # of the median step: of a time that scatters, most steps are within
RISING_SHARE = 0.95
ANGLE_WRAPS = (1.0, 2.0 * np.pi, 360.0, 4.0 * np.pi, 720.0)
COUNTER_WRAPS = (360.0, 720.0, *(float(1 << bits) for bits in range(8, 33)))
WRAP_TOLERANCE = 0.02
LARGE_JUMP = 0.5  # of the range: what a motion does not do in one sample
SMOOTH_SAMPLES = 9
SMOOTH_S = 0.01
MOST_POINTS = 200_000  # from which a relation is recognised
OUTER = 0.25  # a signed number that is stored without its sign lies in the outer quarters of its range


class Relation(NamedTuple):
    """`one` = `slope` times `other`, with this correlation."""

    slope: float
    correlation: float


def is_time(values: Floats) -> bool:
    """Whether values (n,) rise as stamps do: nearly always, by steps that are nearly one."""
    given = values[np.isfinite(values)]
    steps = np.diff(given)
    if steps.size < LEAST_STEPS or not np.mean(steps > 0.0) > RISING_SHARE:
        return False
    usual = float(np.median(steps))
    return bool(np.mean(np.abs(steps - usual) < STEADY * usual) > RISING_SHARE)


def wrap_of(values: Floats) -> float | None:
    """The range at which a counter or an angle wraps, in its own unit; None where nothing jumps."""
    given = values[np.isfinite(values)]
    steps = np.diff(given)
    span = float(np.ptp(given)) if given.size else 0.0
    jumps = steps[np.abs(steps) > LARGE_JUMP * span]
    if span == 0.0 or not jumps.size or jumps.size > LARGE_JUMP * steps.size:
        return None
    small = steps[np.abs(steps) <= LARGE_JUMP * span]
    usual = float(np.quantile(np.abs(small), 0.9)) if small.size else 0.0
    size = float(np.median(np.abs(jumps)))
    whole = bool(np.array_equal(given, np.round(given)))
    for known in sorted(
        COUNTER_WRAPS if whole else (*ANGLE_WRAPS, *COUNTER_WRAPS), key=lambda k: abs(np.log(size / k))
    ):
        if size <= known * (1.0 + 1e-9) and known - size <= 2.0 * usual + WRAP_TOLERANCE * known:
            return known
    return None


def unwrapped(values: Floats, wrap: float) -> Floats:
    """A position without the wraps at `wrap`; missing samples are left as they are."""
    found = values.copy()
    given = np.isfinite(values)
    found[given] = np.unwrap(values[given], period=wrap)
    return found


def stored_without_sign(values: Floats) -> float | None:
    """The range (65536 and such) of a signed number that was stored as an unsigned one; None where it was not."""
    given = values[np.isfinite(values)]
    if not given.size or given.min() < 0.0 or not np.array_equal(given, np.round(given)):
        return None
    for bits in (16, 32):
        whole = float(1 << bits)
        if whole / 2.0 <= given.max() < whole:
            middle = (given > OUTER * whole) & (given < (1.0 - OUTER) * whole)
            return whole if not middle.any() and (given < OUTER * whole).any() else None
    return None


def smooth_derivative(values: Floats, time_s: Floats) -> tuple[Floats, Floats]:
    """Derivative (n,) of values by time over a short window, and its own derivative."""
    period_s = float(np.median(np.diff(time_s)))
    half = max(SMOOTH_SAMPLES, round(SMOOTH_S / period_s) | 1) // 2

    def slope(of: Floats) -> Floats:
        before = np.maximum(np.arange(of.size) - half, 0)
        behind = np.minimum(np.arange(of.size) + half, of.size - 1)
        return np.asarray((of[behind] - of[before]) / np.maximum(time_s[behind] - time_s[before], 1e-300))

    first = slope(values)
    return first, slope(first)


def smoothed(values: Floats) -> Floats:
    """Values (n,) over the window of `smooth_derivative`."""
    return np.asarray(ndimage.uniform_filter1d(values, SMOOTH_SAMPLES))


def relation(one: Floats, other: Floats) -> Relation:
    """Least squares of `one` on `other`, (n,) each, without constants."""
    use = np.isfinite(one) & np.isfinite(other)
    one, other = one[use][:MOST_POINTS], other[use][:MOST_POINTS]
    power, own = float(other @ other), float(one @ one)
    if power <= 0.0 or own <= 0.0:
        return Relation(0.0, 0.0)
    product = float(one @ other)
    return Relation(product / power, product / np.sqrt(power * own))


class Driven(NamedTuple):
    """What a column that may drive the axis has in common with its motion."""

    share: float  # R^2 by inertia and friction
    against: bool  # it takes power out on the whole, and opposes the acceleration: its sign is reversed


def driven_by(column: Floats, velocity: Floats, acceleration: Floats) -> Driven:
    """How much of a column (n,) inertia and friction explain, and whether its sign is that of the motion."""
    sign = np.tanh(velocity / max(0.05 * float(np.quantile(np.abs(velocity), 0.9)), 1e-12))
    matrix = np.stack([acceleration, velocity, sign, np.ones_like(sign)], axis=1)
    use = np.isfinite(column) & np.isfinite(matrix).all(axis=1)
    matrix, target = matrix[use][:MOST_POINTS], column[use][:MOST_POINTS]
    if target.size < LEAST_STEPS or float(np.ptp(target)) == 0.0:
        return Driven(0.0, False)
    scale = np.maximum(np.sqrt(np.mean(matrix**2, axis=0)), 1e-300)
    found = np.linalg.lstsq(matrix / scale, target, rcond=None)[0]
    share = 1.0 - float(np.var(target - (matrix / scale) @ found)) / float(np.var(target))
    return Driven(share, float(target @ matrix[:, 1]) < 0.0 and float(found[0]) < 0.0)

"""Samples that no motion makes: outliers, wraps, standstills and slips of a sensor, found in the steps of its samples.

A step, less those beside it, is impossible where it is far larger than the noise of the steps there, than the sensor's
resolution, than what the steps beside it change by, and than what the motion does in a filter's memory. The sum of
impossible steps is the sensor's error:

- It returns to zero at once: the samples between are outliers.
- It crosses zero from one side of the range to the other, and later comes back: a number has wrapped.
- Equal samples stand before the step, which makes up for them: the sensor stood still.
- It stays, in a position: a slip, or counts are lost. Nothing is simulated across it. What the fastest
  motion does in LONGEST_OUTLIER_S may be rows that are missing (LAAS: 7 of 10 ms), and is left alone.

An impossible step that stays in a velocity is a blow, and is left alone.

Smaller steps of a position that come at the same angle turn by turn are a fault of the sensor there (`fault_at_angle`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy  # its modules load where they are first used

from ..arrays import Floats, Integers, Mask
from ..units import MAD_TO_SD

LEAST_RATE_HZ = 100.0  # below it a motion may do in one sample what is impossible in a faster log
BESIDE = 9  # steps around one that tell what is usual there
LEVEL_S = 0.25  # blocks in which the noise of the steps is measured ...
LEAST_LEVEL = 25  # ... of at least so many steps
NOISES = 8.0  # standard deviations of a step, from the median magnitude, that are impossible ...
COUNTS = 3.5  # ... if it is as many counts of the sensor as well, and ...
CHANGES = 4.0  # ... as many times what the steps beside it change by
LONGEST_OUTLIER_S = 0.01  # an error that returns in this time, or in one sample, is an outlier
LARGE = 0.1  # of the range of the signal, of the speed in LONGEST_OUTLIER_S where it is a position: less bends no fit
RANGE = (0.01, 0.99)  # quantiles that are the ends of a range
RETURNED = 0.1  # of the largest error: it is zero again
WRAP_SHARE = 0.25  # of the range that lies on both sides of zero at a wrap
MOST_SLIPS = 0.01  # of the samples: with more it is not the coupling
LEAST_STILL = 4  # equal samples of a sensor that stands still, and at least LONGEST_OUTLIER_S
CAUGHT_UP = (0.5, 2.0)  # the step after a standstill, over what the steps before and after it would have made
MOST_SHARE = 0.3  # of the samples: with more it is the sensor's way, and not a fault


AT_ANGLE = 0.03  # of a turn, to each side: steps are at the same angle
ANGLES = np.linspace(0.0, 1.0, 100, endpoint=False)  # of a turn, that are tried
LEAST_TIMES = 6  # of such steps, in ...
LEAST_TURNS = 3  # ... so many turns
ONE_ANGLE = 0.4  # share of all impossible steps in motion: a scale may have a fault with a begin and an end


class Impossible(NamedTuple):
    """What one signal (n,) has of it."""

    bad: Mask  # (n,) samples to leave out
    outliers: int  # of them
    standstills: int
    slips: tuple[int, ...]  # samples before which a position has slipped
    slipped: float  # by so much at most

    def mended(self, values: Floats) -> Floats:
        """The signal with straight lines in place of what is left out."""
        places = np.arange(values.size)
        good = ~self.bad
        return np.interp(places, places[good], values[good])


def impossible_samples(values: Floats, period_s: float, count: float, position: bool) -> Impossible | None:
    """Those of a signal (n,) at even times; None where there are none.

    `count`: the sensor's resolution. `position`: a step that stays is a slip.
    """
    steps = np.diff(values)
    if steps.size < LEAST_LEVEL or period_s > 1.0 / LEAST_RATE_HZ:
        return None
    excess, usual, limit = _excess(steps, period_s)
    moves = usual * (LONGEST_OUTLIER_S / period_s) if position else values
    ends = np.quantile(moves, RANGE)
    fastest = float(np.abs(ends).max())
    limit = np.maximum(limit, LARGE * float(np.ptp(ends)))
    limit = np.maximum(limit, COUNTS * count)
    places = np.flatnonzero(np.abs(excess) > limit)
    if not 0 < places.size <= MOST_SHARE * steps.size:
        return None
    bad = np.zeros(values.size, dtype=np.bool_)
    far = WRAP_SHARE * float(np.ptp(values))
    outliers, standstills, slipped, number = 0, 0, 0.0, 0
    slips: list[int] = []
    while number < places.size:
        first = int(places[number])
        before, behind = values[first], values[first + 1]
        wraps = not position and before * behind < 0.0 and min(abs(before), abs(behind)) > far
        end = _return(places[number:], excess, limit, values.size if wraps else LONGEST_OUTLIER_S / period_s)
        stood = 0 if end else _standstill(steps, first, max(LEAST_STILL, LONGEST_OUTLIER_S / period_s))
        if end:
            last = int(places[number + end])
            bad[first + 1 : last + 1] = True
            outliers += last - first
        elif stood:
            bad[first - stood + 1 : first + 1] = True
            standstills += 1
        elif position and abs(excess[first]) > fastest:
            slips.append(first + 1)
            slipped = max(slipped, abs(float(excess[first])))
        number += end + 1
    found = Impossible(bad, outliers, standstills, tuple(slips), slipped)
    few = np.count_nonzero(bad) <= MOST_SHARE * bad.size and len(slips) <= MOST_SLIPS * bad.size
    return found if few and (outliers or standstills or slips) else None


class AngleFault(NamedTuple):
    """Steps of a position that come at one angle of the turn."""

    angle_rev: float
    step_rev: float  # median of their sizes
    times: int

    @property
    def sentence(self) -> str:
        """In words."""
        return (
            f"the position jumps by {self.step_rev:.3g} rev at one angle ({self.angle_rev:.2f} of a turn, {self.times} "
            "times): the sensor loses counts there, or its scale is damaged or dirty"
        )


def fault_at_angle(position_rev: Floats, period_s: float, count: float) -> AngleFault | None:
    """The angle at which a position (n,) at even times jumps turn by turn; None where there is none.

    Where counts are lost for good, the angle comes again a turn less these counts later.
    """
    steps = np.diff(position_rev)
    if steps.size < LEAST_LEVEL or period_s > 1.0 / LEAST_RATE_HZ:
        return None
    excess, usual, limit = _excess(steps, period_s)
    places = np.flatnonzero((np.abs(excess) > np.maximum(limit, COUNTS * count)) & (np.abs(usual) > count))
    if places.size < LEAST_TIMES:
        return None
    size = float(np.median(np.abs(excess[places])))
    found = []
    for period_rev in (1.0, 1.0 - size, 1.0 + size):
        turns = position_rev[places] / period_rev
        away = np.mod(turns - ANGLES[:, None] + 0.5, 1.0) - 0.5
        near = np.abs(away) < AT_ANGLE
        most = int(np.argmax(near.sum(axis=1)))
        here = near[most]
        if np.unique(np.rint(turns[here] - ANGLES[most])).size >= LEAST_TURNS:
            angle_rev = np.mod(ANGLES[most] + np.median(away[most][here]), 1.0)
            found.append(AngleFault(float(angle_rev), size, int(np.count_nonzero(here))))
    best = max(found, key=lambda one: one.times, default=None)
    return best if best is not None and best.times >= max(LEAST_TIMES, ONE_ANGLE * places.size) else None


def _standstill(steps: Floats, place: int, least: float) -> int:
    """The number of equal samples before a step that makes up for them; 0: it does not, or they are few."""
    count = 0
    while count < place and steps[place - 1 - count] == 0.0:
        count += 1
    if count < least or count == place or place + 1 == steps.size:
        return 0
    before, behind = steps[place - 1 - count], steps[place + 1]
    moved = steps[place] / (0.5 * (before + behind) * (count + 1)) if before * behind > 0.0 else 0.0
    return count if CAUGHT_UP[0] < moved < CAUGHT_UP[1] else 0


def _excess(steps: Floats, period_s: float) -> tuple[Floats, Floats, Floats]:
    """Steps (n,) less those beside them, the latter, and the size from which the former are no noise."""
    usual = scipy.ndimage.median_filter(steps, BESIDE, mode="nearest")
    excess = steps - usual
    block = max(LEAST_LEVEL, round(LEVEL_S / period_s))
    blocks = max(1, steps.size // block)
    sizes = np.array([np.median(part) for part in np.array_split(np.abs(excess), blocks)])
    level = scipy.ndimage.maximum_filter1d(MAD_TO_SD * sizes, 3)[np.arange(steps.size) * blocks // steps.size]
    change = scipy.ndimage.maximum_filter1d(usual, BESIDE) - scipy.ndimage.minimum_filter1d(usual, BESIDE)
    return excess, usual, np.maximum(NOISES * level, CHANGES * change)


def _return(places: Integers, excess: Floats, limit: Floats, longest: float) -> int:
    """The number of the impossible step with which the error of the first one is zero again; 0: it stays."""
    error = largest = 0.0
    for number, place in enumerate(places):
        if place - places[0] > max(longest, 1.0):
            return 0
        error += float(excess[place])
        largest = max(largest, abs(error))
        if number and abs(error) <= max(float(limit[place]), RETURNED * largest):
            return number
    return 0


def impossible_lines(what: str, found: Sequence[Impossible], size: int) -> list[str]:
    """What was left out of a signal of `size` samples, in words; `what`: its samples."""
    outliers = sum(one.outliers for one in found)
    still = sum(int(np.count_nonzero(one.bad)) for one in found) - outliers
    times, slips = sum(one.standstills for one in found), sum(len(one.slips) for one in found)
    lines = []
    if outliers:
        lines.append(f"{outliers:,} of {size:,} {what} are impossible (they jump and come back): left out")
    if times:
        lines.append(f"{still:,} of {size:,} {what} stand still while the axis moves ({times} times): left out")
    if slips:
        lines.append(
            f"the position slips {slips} times, by up to {max(one.slipped for one in found):.3g} rev (a coupling that "
            "slips, or lost counts): nothing is simulated across"
        )
    return lines


def resolution(values: Floats) -> float:
    """Smallest step that a sensor makes in samples (n,) that are as it gave them."""
    sizes = np.abs(np.diff(values))
    sizes = sizes[sizes > 0.0]
    return float(np.quantile(sizes, 0.001)) if sizes.size else 0.0

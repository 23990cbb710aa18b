"""Reversals: when the reference changes direction, when the axis does, and the lag between them.

A velocity reverses when it goes from beyond one threshold to beyond the opposite one; the moment is its last zero
crossing before that, interpolated between samples. So noise inside the thresholds is not counted, and a sticking axis
reverses when it leaves zero, not when it reaches it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Integers, Mask

THRESHOLD_RPS = 0.05  # some four standard deviations of a 15-bit resolver's velocity
FAST_RPS2 = 10.0  # from this slope of the reference on, a reversal is judged by its lag, below by its error
FARTHEST_S = 0.1  # a reversal that comes later than this was missed
SLOPE_SAMPLES = 3  # that the slope at a moment after the last but one sample needs of those before
SAME_SAMPLE = 1e-6  # a moment within this share of a sample is taken as at the sample, to be independent of rounding


class Reversals(NamedTuple):
    """Moments (n,) in s since the first sample, and the direction (+-1) that each one turns to."""

    time_s: Floats
    direction: Floats


NO_REVERSALS = Reversals(np.zeros(0), np.zeros(0))


class ReversalLag(NamedTuple):
    """Lag of the axis at reversals of the reference, without missed ones."""

    reversals: int  # of the reference
    missed: int
    mean_ms: float  # positive: late
    mean_absolute_ms: float
    p95_absolute_ms: float


class Crossing(NamedTuple):
    """The error at the moments in which the reference crosses zero. NaN where there is no such reversal."""

    fast: int  # reversals from FAST_RPS2 on
    fast_lag_ms: float  # mean of |error| over the slope: how late, to first order
    slow: int
    slow_error_mrps: float  # mean of |error|, 1e-3 rev/s


def magnitude_at(reversals: Reversals, values: Floats, period_s: float, begin: int = 0) -> Floats:
    """Magnitude of samples (n,), the first of which has the number `begin`, at the moments of reversals (m,)."""
    return np.abs(np.interp(reversals.time_s / period_s, begin + np.arange(values.size), values))


def crossing_error(reference_rps: Floats, error_rps: Floats, period_s: float) -> Crossing:
    """The error (n,) at the reversals of the reference (n,), by its slope there.

    A lag is an error over a slope: where the reference passes zero slowly it depends more on the slope than on the
    axis, so slow reversals are judged by the error itself.
    """
    sums = CrossingSums(find_reversals(reference_rps, period_s), period_s)
    sums.take(reference_rps, error_rps)
    return sums.crossing()


class CrossingSums:
    """The error at known reversals (m,) of a reference, taken part by part."""

    def __init__(self, reversals: Reversals, period_s: float) -> None:
        self._reversals, self._period_s = reversals, period_s
        self._reference_rps: Floats = np.zeros(0)  # the last SLOPE_SAMPLES: a slope needs its neighbours
        self._error_rps: Floats = np.zeros(0)
        self._begin = self._done = 0
        self._found: list[tuple[Floats, Floats]] = []  # error and slope

    def take(self, reference_rps: Floats, error_rps: Floats) -> None:
        """The next samples (n,) of both."""
        self._reference_rps = np.concatenate([self._reference_rps, reference_rps])
        self._error_rps = np.concatenate([self._error_rps, error_rps])
        end = self._begin + self._error_rps.size
        # up to here a moment has both of its samples, and they have a neighbour each
        self._measure(int(np.searchsorted(self._reversals.time_s / self._period_s, end - 2, side="left")))
        kept = min(SLOPE_SAMPLES, self._error_rps.size)
        self._begin = end - kept
        self._reference_rps = self._reference_rps[self._reference_rps.size - kept :].copy()
        self._error_rps = self._error_rps[self._error_rps.size - kept :].copy()

    def _measure(self, end: int) -> None:
        """The reversals up to this number."""
        own = Reversals(*(part[self._done : end] for part in self._reversals))
        self._done = max(end, self._done)
        if own.time_s.size:
            slope_rps2 = np.gradient(self._reference_rps, self._period_s)
            found = (magnitude_at(own, values, self._period_s, self._begin) for values in (self._error_rps, slope_rps2))
            self._found.append((next(found), next(found)))

    def crossing(self) -> Crossing:
        """Of all of them."""
        self._measure(self._reversals.time_s.size)
        error, slope = np.concatenate(self._found, axis=1) if self._found else np.zeros((2, 0))
        fast = slope >= FAST_RPS2
        lag_ms = float(np.mean(1e3 * error[fast] / slope[fast])) if fast.any() else float("nan")
        slow_mrps = float(np.mean(1e3 * error[~fast])) if (~fast).any() else float("nan")
        return Crossing(int(fast.sum()), lag_ms, int((~fast).sum()), slow_mrps)


def find_reversals(velocity_rps: Floats, period_s: float, threshold_rps: float = THRESHOLD_RPS) -> Reversals:
    """Reversals of a velocity (n,)."""
    search = ReversalSearch(period_s, threshold_rps)
    search.take(velocity_rps)
    return search.reversals()


class ReversalSearch:
    """Reversals of a velocity, taken part by part."""

    def __init__(self, period_s: float, threshold_rps: float = THRESHOLD_RPS) -> None:
        self._period_s, self._threshold_rps = period_s, threshold_rps
        self._count = 0
        # what the next reversal needs: the last sample beyond, the last one not yet turned, and the one after that
        self._number: Integers = np.zeros(0, np.int64)
        self._velocity_rps: Floats = np.zeros(0)
        self._found: list[Reversals] = []

    def take(self, velocity_rps: Floats) -> None:
        """The next samples (n,)."""
        number = np.concatenate([self._number, self._count + np.arange(velocity_rps.size)])
        velocity = np.concatenate([self._velocity_rps, velocity_rps])
        self._count += velocity_rps.size
        beyond = np.flatnonzero(np.abs(velocity) > self._threshold_rps)
        signs = np.sign(velocity[beyond])
        changes = np.flatnonzero(signs[1:] != signs[:-1])
        times_s = np.empty(changes.size)
        for place, change in enumerate(changes):
            before = _last_not_turned(velocity, int(beyond[change]), int(beyond[change + 1]) + 1, signs[change + 1])
            low, high = velocity[before : before + 2] * signs[change + 1]
            times_s[place] = (number[before] + low / (low - high)) * self._period_s
        self._found.append(Reversals(times_s, signs[changes + 1]))
        if beyond.size:
            last = int(beyond[-1])
            before = _last_not_turned(velocity, last, velocity.size, -signs[-1])
            kept = np.unique([last, before, min(before + 1, velocity.size - 1)])
            self._number, self._velocity_rps = number[kept], velocity[kept]

    def reversals(self) -> Reversals:
        """Those found so far, (m,)."""
        return Reversals(*(np.concatenate(part) for part in zip(NO_REVERSALS, *self._found, strict=True)))


def _last_not_turned(velocity_rps: Floats, begin: int, end: int, direction: float) -> int:
    """The last sample in a range that does not yet go in a direction; the first one of it does not."""
    return begin + int(np.flatnonzero(velocity_rps[begin:end] * direction <= 0.0)[-1])


def reversal_lag(reference: Reversals, axis: Reversals) -> ReversalLag:
    """Pair each reversal of the reference with the axis's nearest one of the same direction.

    It must be closer than half way to the neighbouring reversals and than FARTHEST_S; else it was missed.
    """
    n = reference.time_s.size
    if n == 0:
        return ReversalLag(0, 0, float("nan"), float("nan"), float("nan"))
    gaps_s = np.diff(reference.time_s)
    reach_s = np.minimum(np.append(gaps_s, np.inf), np.append(np.inf, gaps_s))
    reach_s = np.minimum(0.5 * reach_s, FARTHEST_S)
    lags_s = np.full(n, np.nan)
    for direction in (-1.0, 1.0):
        asked = np.flatnonzero(reference.direction == direction)
        candidates_s = axis.time_s[axis.direction == direction]
        if asked.size == 0 or candidates_s.size == 0:
            continue
        after = np.clip(np.searchsorted(candidates_s, reference.time_s[asked]), 1, max(1, candidates_s.size - 1))
        pairs = np.stack([candidates_s[after - 1], candidates_s[np.minimum(after, candidates_s.size - 1)]])
        distances_s = pairs - reference.time_s[asked]
        nearest = np.argmin(np.abs(distances_s), axis=0)
        lags_s[asked] = distances_s[nearest, np.arange(asked.size)]
    lags_s[np.abs(lags_s) > reach_s] = np.nan
    found_ms = 1e3 * lags_s[np.isfinite(lags_s)]
    if found_ms.size == 0:
        return ReversalLag(n, n, float("nan"), float("nan"), float("nan"))
    absolute_ms = np.abs(found_ms)
    return ReversalLag(
        n,
        n - found_ms.size,
        float(found_ms.mean()),
        float(absolute_ms.mean()),
        float(np.percentile(absolute_ms, 95)),
    )


def near_reversals(reversals: Reversals, samples: int, period_s: float, within_s: float, begin: int = 0) -> Mask:
    """Mask (samples,) of what is within `within_s` of a reversal; the first sample has the number `begin`."""
    edges = np.zeros(samples + 1, np.int64)
    first, last = (reversals.time_s - within_s) / period_s, (reversals.time_s + within_s) / period_s
    starts = np.clip(np.floor(first + SAME_SAMPLE).astype(np.int64) - begin, 0, samples)
    ends = np.clip(np.ceil(last - SAME_SAMPLE).astype(np.int64) + 1 - begin, 0, samples)
    np.add.at(edges, starts, 1)
    np.add.at(edges, ends, -1)
    return np.asarray(np.cumsum(edges[:-1]) > 0)

"""Reversals: when the reference changes direction, when the axis does, and the lag between them.

A velocity reverses when it goes from beyond one threshold to beyond the opposite one; the moment is its last zero
crossing before that, interpolated between samples. So noise inside the thresholds is not counted, and a sticking axis
reverses when it leaves zero, not when it reaches it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Mask

THRESHOLD_RPS = 0.05  # some four standard deviations of a 15-bit resolver's velocity
FAST_RPS2 = 10.0  # from this slope of the reference on, a reversal is judged by its lag, below by its error
FARTHEST_S = 0.1  # a reversal that comes later than this was missed
SAME_SAMPLE = 1e-6  # a moment within this share of a sample is taken as at the sample, to be independent of rounding


class Reversals(NamedTuple):
    """Moments (n,) in s since the first sample, and the direction (+-1) that each one turns to."""

    time_s: Floats
    direction: Floats


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


def magnitude_at(reversals: Reversals, values: Floats, period_s: float) -> Floats:
    """Magnitude of samples (n,) at the moments of reversals (m,)."""
    return np.abs(np.interp(reversals.time_s / period_s, np.arange(values.size), values))


def crossing_error(reference_rps: Floats, error_rps: Floats, period_s: float) -> Crossing:
    """The error (n,) at the reversals of the reference (n,), by its slope there.

    A lag is an error over a slope: where the reference passes zero slowly it depends more on the slope than on the
    axis, so slow reversals are judged by the error itself.
    """
    reversals = find_reversals(reference_rps, period_s)
    error = magnitude_at(reversals, error_rps, period_s)
    slope = magnitude_at(reversals, np.gradient(reference_rps, period_s), period_s)
    fast = slope >= FAST_RPS2
    lag_ms = float(np.mean(1e3 * error[fast] / slope[fast])) if fast.any() else float("nan")
    slow_mrps = float(np.mean(1e3 * error[~fast])) if (~fast).any() else float("nan")
    return Crossing(int(fast.sum()), lag_ms, int((~fast).sum()), slow_mrps)


def find_reversals(velocity_rps: Floats, period_s: float, threshold_rps: float = THRESHOLD_RPS) -> Reversals:
    """Reversals of a velocity (n,)."""
    beyond = np.flatnonzero(np.abs(velocity_rps) > threshold_rps)
    signs = np.sign(velocity_rps[beyond])
    changes = np.flatnonzero(signs[1:] != signs[:-1])
    times_s = np.empty(changes.size)
    for number, change in enumerate(changes):
        first, last = int(beyond[change]), int(beyond[change + 1])
        turned = velocity_rps[first : last + 1] * signs[change + 1]
        before = int(np.flatnonzero(turned <= 0.0)[-1])
        low, high = turned[before], turned[before + 1]
        times_s[number] = (first + before + low / (low - high)) * period_s
    return Reversals(times_s, signs[changes + 1])


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


def near_reversals(reversals: Reversals, samples: int, period_s: float, within_s: float) -> Mask:
    """Mask (samples,) of what is within `within_s` of a reversal."""
    edges = np.zeros(samples + 1, np.int64)
    starts = np.clip(np.floor((reversals.time_s - within_s) / period_s + SAME_SAMPLE).astype(np.int64), 0, samples)
    ends = np.clip(np.ceil((reversals.time_s + within_s) / period_s - SAME_SAMPLE).astype(np.int64) + 1, 0, samples)
    np.add.at(edges, starts, 1)
    np.add.at(edges, ends, -1)
    return np.asarray(np.cumsum(edges[:-1]) > 0)

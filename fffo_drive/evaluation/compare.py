"""Comparison of controllers over seeds: means with intervals, and ratios of runs with the same noise.

Seeds vary the reference's phases as well, so that much of the scatter is common to all controllers: ratios are taken
between runs of one seed, and their intervals come from resampling seeds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy  # its modules load where they are first used

from ..arrays import Floats

LEVEL = 0.95
RESAMPLES = 10_000


class SeedInterval(NamedTuple):
    """A figure and its 95 % interval; both ends NaN with a single seed."""

    value: float
    low: float
    high: float


def mean_interval(values: Floats) -> SeedInterval:
    """Mean of independent values (n,) with Student's interval: of the mean, or of its logarithm where all are positive.

    The interval of a non-negative quantity then does not extend below zero (delta method: sd(ln m) = sd(m) / m).
    """
    mean = float(values.mean())
    if values.size < 2:
        return SeedInterval(mean, float("nan"), float("nan"))
    half = float(scipy.stats.t.ppf(0.5 + 0.5 * LEVEL, values.size - 1) * values.std(ddof=1) / np.sqrt(values.size))
    if values.min() > 0.0:
        return SeedInterval(mean, mean * math.exp(-half / mean), mean * math.exp(half / mean))
    low = max(0.0, mean - half) if values.min() == 0.0 else mean - half  # a count of events, say
    return SeedInterval(mean, low, mean + half)


def ratio_interval(values: Floats, others: Floats) -> SeedInterval:
    """Ratio of the means of paired values (n,), with the percentile interval of resampled seeds."""
    total = float(others.mean())
    if total == 0.0:
        return SeedInterval(float("nan"), float("nan"), float("nan"))
    ratio = float(values.mean()) / total
    if values.size < 2:
        return SeedInterval(ratio, float("nan"), float("nan"))
    draws = np.random.default_rng(0).integers(0, values.size, (RESAMPLES, values.size))
    with np.errstate(divide="ignore", invalid="ignore"):  # a draw in which the denominator is zero throughout
        ratios = values[draws].mean(axis=1) / others[draws].mean(axis=1)
    if not np.isfinite(ratios).all():
        return SeedInterval(ratio, float("nan"), float("nan"))
    low, high = np.quantile(ratios, [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
    return SeedInterval(ratio, float(low), float(high))


class MetricComparison(NamedTuple):
    """One metric of all controllers, by name."""

    absolute: dict[str, SeedInterval]
    percent: dict[str, SeedInterval]  # of `base`, as in Table II
    base: str
    values: dict[str, Floats]  # (seeds,)


def compare_metric(values: dict[str, Floats], base: str | None = None) -> MetricComparison:
    """Compare paired values (seeds,) by controller, in per cent of `base` (None: of the smallest mean).

    Raises ValueError when there is no controller.
    """
    if not values:
        raise ValueError("no controller to compare")
    if base not in values:
        base = min(values, key=lambda name: float(values[name].mean()))
    percent = {}
    for name, own in values.items():
        ratio = ratio_interval(own, values[base])
        percent[name] = SeedInterval(100.0 * ratio.value, 100.0 * ratio.low, 100.0 * ratio.high)
    return MetricComparison({name: mean_interval(own) for name, own in values.items()}, percent, base, values)

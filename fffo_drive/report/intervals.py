"""Intervals of ratios of error metrics: bootstrap over stretches of the runs, the same stretches of every run.

Samples of a tracking error are correlated, so whole stretches of about a second are resampled. All runs follow one
reference: a stretch is drawn for all of them at once, so what they share cancels in the ratio. The interval shows how
much a ratio depends on the parts of the profile. It does not cover changes of the axis from day to day.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..arrays import Floats

RESAMPLED = ("ise", "mae", "std")  # the largest error is one sample, which cannot be resampled
LEAST_STRETCHES = 8


class ShownInterval(NamedTuple):
    """Ends of a 95 % interval."""

    low: float
    high: float


def ratio_intervals(
    errors: Mapping[str, Floats], against: Mapping[str, str], stretch: int, draws: int = 2000, seed: int = 1
) -> dict[str, dict[str, ShownInterval]]:
    """Per run and metric the interval of metric(run) / metric(against[metric]), as a plain ratio.

    `errors`: error (n,) of each run on one time grid, NaN where a sample is missing. `against` names a run for each
    metric. Empty when the runs are shorter than LEAST_STRETCHES stretches.
    """
    sums = {name: _stretch_sums(error, stretch) for name, error in errors.items()}
    stretches = min(block.shape[0] for block in sums.values())
    if stretches < LEAST_STRETCHES:
        return {}
    drawn = np.random.default_rng(seed).integers(0, stretches, (draws, stretches))
    metrics = {name: _metrics(block[drawn].sum(axis=1)) for name, block in sums.items()}
    found: dict[str, dict[str, ShownInterval]] = {}
    for name, own in metrics.items():
        found[name] = {}
        for metric in RESAMPLED:
            with np.errstate(divide="ignore", invalid="ignore"):
                low, high = np.percentile(own[metric] / metrics[against[metric]][metric], [2.5, 97.5])
            found[name][metric] = ShownInterval(float(low), float(high))
    return found


def _stretch_sums(error: Floats, stretch: int) -> Floats:
    """Per whole stretch: samples, sum, sum of magnitudes, sum of squares; shape (stretches, 4)."""
    whole = error[: error.size // stretch * stretch].reshape(-1, stretch)
    present = ~np.isnan(whole)
    filled = np.where(present, whole, 0.0)
    return np.stack(
        [present.sum(axis=1), filled.sum(axis=1), np.abs(filled).sum(axis=1), (filled * filled).sum(axis=1)], axis=1
    )


def _metrics(totals: Floats) -> dict[str, Floats]:
    """Metrics of each draw from its sums (draws, 4). Mean square stands for the ISE: lost samples then cancel."""
    count = np.maximum(totals[:, 0], 1.0)
    mean, magnitude, square = (totals[:, column] / count for column in (1, 2, 3))
    return {"ise": square, "mae": magnitude, "std": np.sqrt(np.maximum(square - mean * mean, 0.0))}

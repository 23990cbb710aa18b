"""All measures of one run: the paper's metrics, by speed and around reversals, lags, error histogram, effort."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Integers, Mask
from .effort import ControlEffort, EffortSums
from .metrics import ErrorMetrics, ErrorSums
from .reversal import (
    Crossing,
    CrossingSums,
    ReversalLag,
    Reversals,
    ReversalSearch,
    near_reversals,
    reversal_lag,
)
from .trace import Trace

REVERSAL_WINDOW_S = 0.025  # around a reversal: the time constant of a 24 Hz loop, four times
START_S = 2.0  # start of a record, when the axis starts from rest and the law has learned nothing
NOTHING = ErrorMetrics(float("nan"), float("nan"), float("nan"), float("nan"))


class Yardstick(NamedTuple):
    """Settings of the measures, the same for all runs of a comparison."""

    band_edges_rps: tuple[float, ...]  # of the reference's magnitude
    histogram_edges_rps: Floats  # of the error; values outside are counted in the first and last bin


class VelocityMeasures(NamedTuple):
    """The error against one velocity."""

    error: ErrorMetrics
    bands: tuple[ErrorMetrics, ...]  # one between each two edges; NaN if the reference was never in the band
    reversals: ErrorMetrics  # within REVERSAL_WINDOW_S of a reversal of the reference
    lag: ReversalLag
    crossing: Crossing
    settled: ErrorMetrics  # without the first START_S
    histogram: np.ndarray[Any, np.dtype[np.int64]]  # samples in each bin


class Measures(NamedTuple):
    """One run."""

    measured: VelocityMeasures
    true: VelocityMeasures | None  # against the shaft's velocity, if known
    effort: ControlEffort
    skipped_share: float  # of the samples: filled in, see `traces`


def measure(parts: Iterable[Trace], yardstick: Yardstick) -> Measures:
    """Measure a run in parts that follow each other, which are iterated over twice; what is kept of each are sums, and
    16 bytes a reversal.

    Raises ValueError for an empty run and for values that are not finite.
    """
    first = next(iter(parts), None)
    if first is None:
        raise ValueError("no sample to evaluate: the profile did not run")
    period_s = first.period_s
    search = ReversalSearch(period_s)
    for part in parts:
        search.take(part.reference_rps)
    reference, samples, skipped = search.reversals(), 0, 0
    measured, true = (_Against(reference, period_s, yardstick) for _ in range(2))
    effort, true_known = EffortSums(period_s), True
    for part in parts:
        places = _Places.of(part, samples, reference, yardstick)
        measured.take(part.reference_rps, part.measured_rps, places)
        true_known = true_known and part.true_rps is not None
        if true_known and part.true_rps is not None:
            true.take(part.reference_rps, part.true_rps, places)
        effort.take(part.command_a)
        samples += part.reference_rps.size
        skipped += part.skipped
    return Measures(measured.measures(), true.measures() if true_known else None, effort.effort(), skipped / samples)


class _Places(NamedTuple):
    """Where the samples (n,) of a part of a run are."""

    near: Mask  # to a reversal
    band: Integers  # of the speed
    settled: int  # from here on

    @classmethod
    def of(cls, part: Trace, begin: int, reference: Reversals, yardstick: Yardstick) -> _Places:
        size, inner_edges = part.reference_rps.size, np.asarray(yardstick.band_edges_rps[1:-1])
        return cls(
            near_reversals(reference, size, part.period_s, REVERSAL_WINDOW_S, begin),
            np.searchsorted(inner_edges, np.abs(part.reference_rps), side="right"),
            min(max(0, round(START_S / part.period_s) - begin), size),
        )


class _Against:
    """Sums against one velocity."""

    def __init__(self, reference: Reversals, period_s: float, yardstick: Yardstick) -> None:
        self._reference, self._period_s, self._edges_rps = reference, period_s, yardstick.histogram_edges_rps
        self._all, self._near, self._settled = ErrorSums(), ErrorSums(), ErrorSums()
        self._bands = [ErrorSums() for _ in yardstick.band_edges_rps[1:]]
        self._axis = ReversalSearch(period_s)
        self._crossing = CrossingSums(reference, period_s)
        self._histogram = np.zeros(self._edges_rps.size - 1, np.int64)

    def take(self, reference_rps: Floats, velocity_rps: Floats, places: _Places) -> None:
        """The next samples (n,)."""
        error_rps = reference_rps - velocity_rps
        self._all.take(error_rps)
        for number, sums in enumerate(self._bands):
            sums.take(error_rps[places.band == number])
        self._near.take(error_rps[places.near])
        self._settled.take(error_rps[places.settled :])
        self._axis.take(velocity_rps)
        self._crossing.take(reference_rps, error_rps)
        self._histogram += _counts(error_rps, self._edges_rps)

    def measures(self) -> VelocityMeasures:
        """Of all samples."""
        return VelocityMeasures(
            self._all.metrics(self._period_s),
            tuple(_metrics_of(sums, self._period_s) for sums in self._bands),
            _metrics_of(self._near, self._period_s),
            reversal_lag(self._reference, self._axis.reversals()),
            self._crossing.crossing(),
            _metrics_of(self._settled, self._period_s),
            self._histogram,
        )


def _metrics_of(sums: ErrorSums, period_s: float) -> ErrorMetrics:
    return sums.metrics(period_s) if sums.samples else NOTHING


def _counts(error_rps: Floats, edges_rps: Floats) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Counts in equidistant bins."""
    width_rps = (edges_rps[-1] - edges_rps[0]) / (edges_rps.size - 1)
    bins = np.clip((error_rps - edges_rps[0]) / width_rps, 0, edges_rps.size - 2).astype(np.int64)
    return np.bincount(bins, minlength=edges_rps.size - 1)

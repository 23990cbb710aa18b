"""All measures of one run: the paper's metrics, by speed and around reversals, lags, error histogram, effort."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from .effort import ControlEffort, control_effort
from .metrics import ErrorMetrics, error_metrics
from .reversal import Crossing, ReversalLag, crossing_error, find_reversals, near_reversals, reversal_lag
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


def measure(trace: Trace, yardstick: Yardstick) -> Measures:
    """Measure a run. Raises ValueError for an empty one and for values that are not finite."""
    reference = find_reversals(trace.reference_rps, trace.period_s)
    near = near_reversals(reference, trace.reference_rps.size, trace.period_s, REVERSAL_WINDOW_S)
    inner_edges = np.asarray(yardstick.band_edges_rps[1:-1])
    band = np.searchsorted(inner_edges, np.abs(trace.reference_rps), side="right")
    bands = len(yardstick.band_edges_rps) - 1

    def against(velocity_rps: Floats) -> VelocityMeasures:
        error_rps = trace.reference_rps - velocity_rps
        return VelocityMeasures(
            error_metrics(error_rps, trace.period_s),
            tuple(_metrics_of(error_rps[band == number], trace.period_s) for number in range(bands)),
            _metrics_of(error_rps[near], trace.period_s),
            reversal_lag(reference, find_reversals(velocity_rps, trace.period_s)),
            crossing_error(trace.reference_rps, error_rps, trace.period_s),
            _metrics_of(error_rps[round(START_S / trace.period_s) :], trace.period_s),
            _counts(error_rps, yardstick.histogram_edges_rps),
        )

    return Measures(
        against(trace.measured_rps),
        None if trace.true_rps is None else against(trace.true_rps),
        control_effort(trace.command_a, trace.period_s),
    )


def _metrics_of(error_rps: Floats, period_s: float) -> ErrorMetrics:
    return error_metrics(error_rps, period_s) if error_rps.size else NOTHING


def _counts(error_rps: Floats, edges_rps: Floats) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Counts in equidistant bins."""
    width_rps = (edges_rps[-1] - edges_rps[0]) / (edges_rps.size - 1)
    bins = np.clip((error_rps - edges_rps[0]) / width_rps, 0, edges_rps.size - 2).astype(np.int64)
    return np.bincount(bins, minlength=edges_rps.size - 1)

"""Measures for comparing the peers: errors against both velocities, reversals, the start on its own, effort."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..measures import START_S
from ..metrics import error_metrics
from ..reversal import find_reversals, magnitude_at, reversal_lag
from ..trace import Trace


class PeerMeasures(NamedTuple):
    """One run; infinite throughout where the velocity is not finite."""

    true_ise: float  # rps^2 s, against the shaft's velocity
    true_mae: float  # rps
    true_max: float  # rps
    measured_ise: float  # rps^2 s, against the reported velocity
    start_ise: float  # rps^2 s, of true_ise within START_S
    after_ise: float  # the rest of it
    crossing_rps: float  # mean of the error's magnitude where the reference crosses zero; NaN without a reversal
    lag_ms: float  # mean magnitude over the reversals that were not missed; NaN without one
    step_rms_a: float  # of the command from tick to tick


NOT_FINITE = PeerMeasures(*len(PeerMeasures._fields) * (math.inf,))


def measure_peer(trace: Trace) -> PeerMeasures:
    """Measure a run on a simulated drive. Raises ValueError where the shaft's velocity is not known."""
    if trace.true_rps is None:
        raise ValueError("no true velocity in the trace: peers are compared on a simulated drive")
    if not (np.isfinite(trace.true_rps).all() and np.isfinite(trace.measured_rps).all()):
        return NOT_FINITE
    error_rps = trace.reference_rps - trace.true_rps
    true = error_metrics(error_rps, trace.period_s)
    measured = error_metrics(trace.reference_rps - trace.measured_rps, trace.period_s)
    start_rps = error_rps[: round(START_S / trace.period_s)]
    start_ise = float(start_rps @ start_rps) * trace.period_s
    reference = find_reversals(trace.reference_rps, trace.period_s)
    crossing_rps = magnitude_at(reference, error_rps, trace.period_s)
    return PeerMeasures(
        true.ise,
        true.mae,
        true.max,
        measured.ise,
        start_ise,
        true.ise - start_ise,
        float(crossing_rps.mean()) if crossing_rps.size else math.nan,
        reversal_lag(reference, find_reversals(trace.true_rps, trace.period_s)).mean_absolute_ms,
        float(np.sqrt(np.mean(np.diff(trace.command_a) ** 2))) if trace.command_a.size > 1 else 0.0,
    )

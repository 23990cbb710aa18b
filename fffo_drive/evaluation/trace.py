"""The columns of a run that its evaluation needs, contiguous: a row is 20 times as long as what is read of it here."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .metrics import Floats, Rows


class Trace(NamedTuple):
    """A profile as it ran; arrays (n,). `true_rps` is None where no one knows the shaft's velocity."""

    period_s: float
    reference_rps: Floats
    measured_rps: Floats
    true_rps: Floats | None
    command_a: Floats


def trace_of(rows: Rows, period_s: float, samples: int | None = None) -> Trace:
    """The rows in which the profile ran. Raises ValueError when there is none."""
    sample = rows["profile_sample"]
    chosen = np.flatnonzero((sample >= 0) & (sample < (samples or np.iinfo(np.int32).max)))
    if chosen.size == 0:
        raise ValueError("no row to evaluate: the profile did not run")
    inside = rows[chosen[0] : chosen[-1] + 1]  # a view: between its first and last sample a profile has no gap
    true_rps = np.ascontiguousarray(inside["true_velocity_rps"])
    return Trace(
        period_s,
        np.ascontiguousarray(inside["reference_rps"]),
        np.ascontiguousarray(inside["velocity_rps"]),
        true_rps if np.isfinite(true_rps).all() else None,
        np.ascontiguousarray(inside["current_command_a"]),
    )

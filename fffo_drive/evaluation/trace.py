"""The columns of a run that its evaluation needs, contiguous: a row is 20 times longer than the columns used."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from .metrics import Rows

SAMPLE = "profile_sample"
TRACED = (SAMPLE, "reference_rps", "velocity_rps", "true_velocity_rps", "current_command_a")  # of the rows


class Trace(NamedTuple):
    """A profile as it ran, one sample per period; arrays (n,). `true_rps` is None if the true velocity is not known."""

    period_s: float
    reference_rps: Floats
    measured_rps: Floats
    true_rps: Floats | None
    command_a: Floats
    skipped: int = 0  # samples of skipped ticks: filled in, see `trace_of`

    @property
    def skipped_share(self) -> float:
        """Of the samples from the first to the last."""
        return self.skipped / self.reference_rps.size


def trace_of(rows: Rows, period_s: float, samples: int | None = None) -> Trace:
    """The rows in which the profile ran. Raises ValueError when there is none.

    A late loop skips samples of the profile, which have no row: the command is filled in as held by the drive, and all
    else by linear interpolation between rows, so that lags, bands and spectra keep their time base.
    """
    sample = rows[SAMPLE]
    chosen = np.flatnonzero((sample >= 0) & (sample < (samples or np.iinfo(np.int32).max)))
    if chosen.size == 0:
        raise ValueError("no row to evaluate: the profile did not run")
    inside = rows[chosen[0] : chosen[-1] + 1]  # a view: other rows are before the first or after the last of a profile
    known = inside[SAMPLE]
    grid = np.arange(int(known[0]), int(known[-1]) + 1)
    held = np.searchsorted(known, grid, side="right") - 1

    def straight(name: str) -> Floats:
        return np.asarray(np.interp(grid, known, inside[name]), dtype=np.float64)

    true_rps = straight("true_velocity_rps")
    return Trace(
        period_s,
        straight("reference_rps"),
        straight("velocity_rps"),
        true_rps if np.isfinite(true_rps).all() else None,
        np.ascontiguousarray(inside["current_command_a"][held]),
        grid.size - known.size,
    )

"""The columns of a run that its evaluation needs, contiguous: a row is 20 times longer than the columns used."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from .metrics import Rows

SAMPLE = "profile_sample"
TRACED = (SAMPLE, "reference_rps", "velocity_rps", "true_velocity_rps", "current_command_a")  # of the rows


class Trace(NamedTuple):
    """A profile as it ran, or a part of it, one sample per period; arrays (n,).

    `true_rps` is None if the true velocity is not known.
    """

    period_s: float
    reference_rps: Floats
    measured_rps: Floats
    true_rps: Floats | None
    command_a: Floats
    skipped: int = 0  # samples of skipped ticks: filled in, see `trace_of`


def trace_of(rows: Rows, period_s: float, samples: int | None = None) -> Trace:
    """The rows in which the profile ran, as `traces`. Raises ValueError when there is none."""
    found = next(traces([rows], period_s, samples), None)
    if found is None:
        raise ValueError("no row to evaluate: the profile did not run")
    return found


def traces(blocks: Iterable[Rows], period_s: float, samples: int | None = None) -> Iterator[Trace]:
    """The rows in which the profile ran, in parts that follow each other, one for each block that has some.

    A late loop skips samples of the profile, which have no row: the command is filled in as held by the drive, and all
    else by linear interpolation between rows, so that lags, bands and spectra keep their time base. Raises ValueError
    when a sample comes again.
    """
    before: dict[str, Floats] = {}  # the last row, for what is skipped between two blocks
    for rows in blocks:
        chosen = np.flatnonzero((rows[SAMPLE] >= 0) & (rows[SAMPLE] < (samples or np.iinfo(np.int32).max)))
        if chosen.size == 0:
            continue
        known = {name: np.concatenate([before.get(name, rows[name][:0]), rows[name][chosen]]) for name in TRACED}
        if (np.diff(known[SAMPLE]) <= 0).any():
            raise ValueError("the profile ran more than once: cut out one run with fffo-drive log export --from --to")
        yield _filled(known, len(before) > 0, period_s)
        before = {name: values[-1:].copy() for name, values in known.items()}


def _filled(columns: dict[str, Floats], continues: bool, period_s: float) -> Trace:
    """Columns (n,) with the skipped samples; `continues`: the first row is that before, and not a part of it."""
    known = columns[SAMPLE]
    grid = np.arange(int(known[0]) + continues, int(known[-1]) + 1)
    held = np.searchsorted(known, grid, side="right") - 1

    def straight(name: str) -> Floats:
        return np.asarray(np.interp(grid, known, columns[name]), dtype=np.float64)

    true_rps = straight("true_velocity_rps")
    return Trace(
        period_s,
        straight("reference_rps"),
        straight("velocity_rps"),
        true_rps if np.isfinite(true_rps).all() else None,
        np.ascontiguousarray(columns["current_command_a"][held]),
        grid.size - (known.size - continues),
    )

"""Repair of bus disturbances in the record of a loop: late ticks, ticks without an answer, skipped ticks.

- The drive latches at SYNC, which leaves when the loop wakes: the position of a late tick is younger than its deadline.
- A tick without an answer holds the last feedback.
- A skipped tick has no row. There was no SYNC either: the drive kept the current that it had, and the command that was
  under way acts with the next SYNC.

Up to `LONGEST_FILL_S` is filled: the command as the drive held it, the motion by a cubic through both ends (at 10 Hz
and 5 rps wrong by about a count of a 15-bit resolver). Longer gaps stay gaps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats, Integers
from ..units import NS_PER_S

LONGEST_FILL_S = 0.01


class LogTiming(NamedTuple):
    """Timing of the ticks of a record, (n,) each."""

    tick: Integers  # number of the period, rising
    age: Integers  # periods since the feedback was fresh
    lateness_ns: Integers  # of the waking, behind the deadline


class Mended(NamedTuple):
    """A repaired record."""

    columns: dict[str, Floats]
    fresh: npt.NDArray[np.bool_]  # (n,) False where the motion was filled in
    dropped: int  # ticks of gaps that are too long

    @property
    def filled(self) -> int:
        """Number of ticks whose motion was filled in."""
        return int(np.count_nonzero(~self.fresh))


def mended(columns: dict[str, Floats], timing: LogTiming, period_s: float) -> Mended:
    """The columns (n,) on whole periods, `time_s` with a step at each remaining gap. A record without faults is
    unchanged.

    `time_s`, `current_command_a`, `position_rev` and `velocity_rps` are needed; other columns are interpolated.
    """
    fresh = np.flatnonzero(timing.age == 0)
    late = timing.lateness_ns != 0
    if fresh.size < 2 or (fresh.size == timing.tick.size and not late.any() and (np.diff(timing.tick) == 1).all()):
        return Mended(columns, np.ones(timing.tick.size, dtype=np.bool_), 0)
    place = timing.tick - timing.tick[0]  # of each row on the grid of periods
    motion_rev = columns["position_rev"] - columns["velocity_rps"] * timing.lateness_ns / NS_PER_S
    known = place[fresh]
    wanted = np.arange(known[0], known[-1] + 1)
    before = np.searchsorted(known, wanted, side="right") - 1
    step = np.diff(known, append=known[-1] + 1)[before]  # periods from the known tick before to the next one
    kept = (step <= max(1.0, LONGEST_FILL_S / period_s)) | (wanted == known[before])
    wanted, before = wanted[kept], before[kept]
    found: dict[str, Floats] = {
        name: np.interp(wanted, place, values)
        for name, values in columns.items()
        if name not in ("time_s", "current_command_a", "position_rev", "velocity_rps")
    }
    found["time_s"] = columns["time_s"][0] + wanted * period_s
    found["current_command_a"] = _held(columns["current_command_a"], place)[wanted]
    velocity = columns["velocity_rps"][fresh]
    found["velocity_rps"] = np.interp(wanted, known, velocity)
    found["position_rev"] = _cubic(wanted, before, known, motion_rev[fresh], velocity * period_s)
    return Mended(found, wanted == known[before], int((~kept).sum()))


def _held(command_a: Floats, place: Integers) -> Floats:
    """The command of every period such that it acts from the next one on, although SYNCs were missing. (grid,)"""
    gaps = np.diff(place)
    held = np.repeat(command_a, np.append(gaps, 1))
    for k in np.flatnonzero(gaps > 1):
        begin, end = int(place[k]), int(place[k + 1])
        held[begin : end - 1] = held[begin - 1] if begin > 0 else command_a[k]
        held[end - 1] = command_a[k]
    return held


def _cubic(wanted: Integers, before: Integers, known: Integers, values: Floats, slopes: Floats) -> Floats:
    """Hermite's cubic through the known values with their slopes (per period); at a known place the value itself."""
    behind = np.minimum(before + 1, known.size - 1)
    length = np.maximum(known[behind] - known[before], 1).astype(np.float64)
    t = (wanted - known[before]) / length
    left, right = values[before], values[behind]
    rise, first, last = right - left, slopes[before] * length, slopes[behind] * length
    found = left + t * (first + t * (3.0 * rise - 2.0 * first - last + t * (first + last - 2.0 * rise)))
    return np.asarray(np.where(t == 0.0, left, found))

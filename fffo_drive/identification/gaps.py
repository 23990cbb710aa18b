"""Repair of bus disturbances in the record of a loop: late ticks, ticks without an answer, skipped ticks.

- The drive latches at SYNC, which leaves when the loop wakes: the position of a late tick is younger than its deadline.
- A tick without an answer holds the last feedback.
- A skipped tick has no row. There was no SYNC either: the drive kept the current that it had, and the command that was
  under way acts with the next SYNC.

Up to `LONGEST_FILL_S` is filled: the command as the drive held it, the motion by a cubic through both ends (at 10 Hz
and 5 rps wrong by about a count of a 15-bit resolver). Longer gaps stay gaps.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Integers, Mask
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
    fresh: Mask  # (n,) False where the motion was filled in
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
    longest = max(1.0, LONGEST_FILL_S / period_s)  # ticks from one row to the next
    edges = [0, *(np.flatnonzero(np.diff(timing.tick) > longest) + 1).tolist(), timing.tick.size]
    parts = [slice(a, b) for a, b in itertools.pairwise(edges)]
    faults = [part for part in parts if _has_fault(LogTiming(*(values[part] for values in timing)))]
    answered = timing.tick[timing.age == 0]
    if not faults or answered.size < 2:
        return Mended(columns, np.ones(timing.tick.size, dtype=np.bool_), 0)
    found: list[tuple[dict[str, Floats], Mask]] = []
    for part in parts:
        own, timed = {name: values[part] for name, values in columns.items()}, LogTiming(*(v[part] for v in timing))
        if part not in faults:
            found.append((own, np.ones(timed.tick.size, dtype=np.bool_)))
        elif np.count_nonzero(timed.age == 0) >= 2:
            found.append(_mended_part(own, timed, period_s, longest))
    fresh = np.concatenate([own for _, own in found])
    whole = {name: np.concatenate([own[name] for own, _ in found]) for name in columns}
    return Mended(whole, fresh, int(answered[-1] - answered[0] + 1 - fresh.size))


def _has_fault(timing: LogTiming) -> bool:
    return bool(timing.age.any() or timing.lateness_ns.any() or (np.diff(timing.tick) != 1).any())


def _mended_part(
    columns: dict[str, Floats], timing: LogTiming, period_s: float, longest: float
) -> tuple[dict[str, Floats], Mask]:
    """Rows between which no more than `longest` ticks are missing: columns, and where they were measured."""
    fresh = np.flatnonzero(timing.age == 0)
    place = timing.tick - timing.tick[0]  # of each row on the grid of periods
    motion_rev = columns["position_rev"] - columns["velocity_rps"] * timing.lateness_ns / NS_PER_S
    known = place[fresh]
    step = np.diff(known, append=known[-1] + 1)  # periods from each known tick to the next one
    filled = np.where(step <= longest, step, 1)
    before = np.repeat(np.arange(known.size), filled)
    wanted = known[before] + np.arange(before.size) - (np.cumsum(filled) - filled)[before]
    found: dict[str, Floats] = {
        name: np.interp(wanted, place, values)
        for name, values in columns.items()
        if name not in ("time_s", "current_command_a", "position_rev", "velocity_rps")
    }
    found["time_s"] = columns["time_s"][0] + wanted * period_s
    found["current_command_a"] = _held(columns["current_command_a"], place, wanted)
    velocity = columns["velocity_rps"][fresh]
    found["velocity_rps"] = np.interp(wanted, known, velocity)
    found["position_rev"] = _cubic(wanted, before, known, motion_rev[fresh], velocity * period_s)
    return found, wanted == known[before]


def _held(command_a: Floats, place: Integers, wanted: Integers) -> Floats:
    """The command of periods such that it acts from the next one on, although SYNCs were missing. (wanted,)"""
    before = np.searchsorted(place, wanted, side="right") - 1
    last = wanted + 1 == np.append(place[1:], place[-1] + 1)[before]  # before the next SYNC; else the one before acts
    return np.asarray(command_a[np.where(last, before, np.maximum(before - 1, 0))])


def _cubic(wanted: Integers, before: Integers, known: Integers, values: Floats, slopes: Floats) -> Floats:
    """Hermite's cubic through the known values with their slopes (per period); at a known place the value itself."""
    behind = np.minimum(before + 1, known.size - 1)
    length = np.maximum(known[behind] - known[before], 1).astype(np.float64)
    t = (wanted - known[before]) / length
    left, right = values[before], values[behind]
    rise, first, last = right - left, slopes[before] * length, slopes[behind] * length
    found = left + t * (first + t * (3.0 * rise - 2.0 * first - last + t * (first + last - 2.0 * rise)))
    return np.asarray(np.where(t == 0.0, left, found))

"""Rows of a run of the loop as columns over time, with simple evaluations."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats, Integers
from ..drive.cia402 import STATE_OPERATION_ENABLED, STATE_QUICK_STOP_ACTIVE, state_of

Bools = npt.NDArray[np.bool_]


class PulseMotion(NamedTuple):
    """Columns of a run, all of shape (n,); only rows with fresh feedback. Time 0 is the first row."""

    time_s: Floats
    command_a: Floats  # on the bus; held until the next row, acts with the delay of the drive
    velocity_rps: Floats
    position_rev: Floats
    current_a: Floats  # as the drive reports it
    current_fresh: Bools
    enabled: Bools
    braking: Bools  # the drive reports Quick Stop Active
    limits: Integers
    trip: Integers
    sample: Integers  # of the profile; -1 without one

    @property
    def size(self) -> int:
        """Rows."""
        return int(self.time_s.size)

    def part(self, mask: Bools) -> PulseMotion:
        """The rows of a mask."""
        return PulseMotion._make([column[mask] for column in self])


def motion_of(rows: np.ndarray[Any, np.dtype[np.void]]) -> PulseMotion:
    """Columns of recorded rows, without rows with old feedback."""
    fresh = rows[rows["velocity_age"] == 0]
    first_ns = int(fresh["deadline_ns"][0]) if fresh.size else 0
    words, index = np.unique(fresh["statusword"], return_inverse=True)
    states = np.array([state_of(int(word)) for word in words], np.int64)[index]
    return PulseMotion(
        (fresh["deadline_ns"] - first_ns) * 1e-9,
        fresh["current_command_a"].astype(np.float64),
        fresh["velocity_rps"].astype(np.float64),
        fresh["position_rev"].astype(np.float64),
        fresh["current_a"].astype(np.float64),
        fresh["status_age"] == 0,
        states == STATE_OPERATION_ENABLED,
        states == STATE_QUICK_STOP_ACTIVE,
        fresh["limits"].astype(np.int64),
        fresh["trip"].astype(np.int64),
        fresh["profile_sample"].astype(np.int64),
    )


def pulse_starts(motion: PulseMotion) -> Integers:
    """Rows at which a pulse begins: a current after zero current, or of the other sign."""
    sign = np.sign(motion.command_a).astype(np.int64)
    begins = (sign != 0) & (np.concatenate([[0], sign[:-1]]) != sign)
    return np.flatnonzero(begins)


def pulse_windows(motion: PulseMotion) -> list[slice]:
    """One slice for each pulse and what follows it, up to the next pulse."""
    starts = pulse_starts(motion)
    edges = np.append(starts, motion.size)
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]


def extreme(values: Floats) -> float:
    """The value of largest magnitude, with its sign; 0 for nothing."""
    return float(values[np.argmax(np.abs(values))]) if values.size else 0.0


class PulseResponse(NamedTuple):
    """Effect of one pulse, positive in the direction of its current."""

    current_a: float  # magnitude
    speed_rps: float  # extreme of the velocity
    travel_rev: float  # extreme of the excursion
    net_rev: float  # remaining travel at the end, by the position: friction at rest springs back
    net_by_velocity_rev: float  # and by the integral of the velocity
    duration_s: float


def responses(motion: PulseMotion) -> list[PulseResponse]:
    """One for each pulse, up to the next one."""
    found = []
    for window in pulse_windows(motion):
        sign = float(np.sign(motion.command_a[window.start]))
        time_s, velocity, position = (
            column[window] for column in (motion.time_s, motion.velocity_rps, motion.position_rev)
        )
        travel = position - motion.position_rev[max(0, window.start - 1)]
        found.append(
            PulseResponse(
                float(np.abs(motion.command_a[window]).max()),
                sign * extreme(velocity),
                sign * extreme(travel),
                sign * float(travel[-1]),
                sign * float(integral(time_s, velocity)[-1]),
                float(time_s[-1] - time_s[0]),
            )
        )
    return found


def integral(time_s: Floats, values: Floats) -> Floats:
    """Trapezoidal integral from the first row. Shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time_s))])

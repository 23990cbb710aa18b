"""The sum for a bus: its load, and whether everything that one control period needs fits into it.

Pure functions over lists of frames. Worst case is the longest frame that the length allows (Davis et al.
2007), typical the mean over random payloads with the frame's real identifier.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from .frame import longest_bits, typical_bits

BLOCKING_BITS = longest_bits(8)  # 135: a frame that has begun is never interrupted


class Traffic(NamedTuple):
    """One kind of frame on the bus."""

    name: str
    can_id: int
    data_bytes: int
    rate_hz: float
    on_change: bool = False  # at most at this rate, typically hardly ever


class Load(NamedTuple):
    """Share of the bus's time, 0 to 1 (more: it does not fit)."""

    worst: float
    typical: float


class ChainStep(NamedTuple):
    """One link of the chain inside a period."""

    name: str
    worst_s: float
    typical_s: float


class Chain(NamedTuple):
    """What must happen one after the other inside one period, and what is left of it."""

    steps: tuple[ChainStep, ...]
    period_s: float

    @property
    def worst_s(self) -> float:
        """Sum of the worst cases (s)."""
        return sum(step.worst_s for step in self.steps)

    @property
    def typical_s(self) -> float:
        """Sum of the typical durations (s)."""
        return sum(step.typical_s for step in self.steps)

    @property
    def slack_s(self) -> float:
        """What the worst case leaves of the period (s); negative when the chain does not fit."""
        return self.period_s - self.worst_s

    @property
    def fits(self) -> bool:
        """True when even the worst case ends before the next SYNC."""
        return self.slack_s >= 0.0


def bus_load(traffic: Sequence[Traffic], bitrate_hz: float) -> Load:
    """Load of all that comes again and again on a bus of `bitrate_hz` bit/s."""
    worst = sum(longest_bits(item.data_bytes) * item.rate_hz for item in traffic)
    periodic = [item for item in traffic if not item.on_change]
    typical = sum(typical_bits(item.can_id, item.data_bytes) * item.rate_hz for item in periodic)
    return Load(worst / bitrate_hz, typical / bitrate_hz)


def frame_step(item: Traffic, bitrate_hz: float) -> ChainStep:
    """The time that a frame takes on the wire."""
    worst = longest_bits(item.data_bytes) / bitrate_hz
    typical = 0.0 if item.on_change else typical_bits(item.can_id, item.data_bytes) / bitrate_hz
    return ChainStep(item.name, worst, typical)


def period_chain(
    answers: Sequence[Traffic],
    sync: Traffic,
    command: Traffic,
    *,
    bitrate_hz: float,
    period_s: float,
    turnaround_s: float,
    host_s: float,
) -> Chain:
    """SYNC, the drive's turnaround, its answers, the host's time, the command, and one blocking frame.

    `answers`: every TPDO that one SYNC can set off. `turnaround_s`: from SYNC received to the answer queued
    in the drive. `host_s`: waking, computing and handing the command to the controller. The blocking frame
    is the longest of the bus (an SDO, EMCY or event frame that began just before); typically there is none.
    """
    steps = [frame_step(sync, bitrate_hz), ChainStep("drive turnaround", turnaround_s, turnaround_s)]
    steps += [frame_step(item, bitrate_hz) for item in answers]
    steps += [ChainStep("host", host_s, host_s), frame_step(command, bitrate_hz)]
    steps.append(ChainStep("blocking frame", BLOCKING_BITS / bitrate_hz, 0.0))
    return Chain(tuple(steps), period_s)

"""What the services of a node share: the time of the present event, frames to send, listeners.

Frames are the 16 bytes of `struct can_frame`. Time is the caller's (`Node.handle`, `Node.poll`), in nanoseconds.
Nothing in the node reads a clock, so a test can run far faster than real time.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from ..can.frame import pack_frame

NEVER = 1 << 62  # no deadline
NS_PER_MS = 1_000_000
NS_PER_100_US = 100_000
NS_PER_US = 1_000

_CAN_ID = struct.Struct("=I")

Handler = Callable[[bytes], None]


class Bus:
    """Outbox, listeners and time of one node."""

    __slots__ = ("deadlines", "listeners", "now_ns", "outbox")

    def __init__(self) -> None:
        self.now_ns = 0
        self.deadlines: list[int] = []  # of all services, one entry each: the earliest is the node's
        self.outbox: list[bytes] = []
        self.listeners: dict[int, Handler] = {}

    def send(self, can_id: int, data: bytes) -> None:
        """Queue a data frame with an 11-bit identifier."""
        self.outbox.append(pack_frame(can_id, data))

    def listen(self, can_id: int, handler: Handler) -> None:
        """Call `handler` for each data frame with this 11-bit identifier, after earlier listeners."""
        first = self.listeners.get(can_id)
        if first is None:
            self.listeners[can_id] = handler
            return

        def both(frame: bytes) -> None:
            first(frame)
            handler(frame)

        self.listeners[can_id] = both


class Timed:
    """A service with a deadline, `deadline_ns`: NEVER while it has none."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self._place = len(bus.deadlines)
        bus.deadlines.append(NEVER)

    @property
    def deadline_ns(self) -> int:
        """When it must be polled."""
        return self.bus.deadlines[self._place]

    @deadline_ns.setter
    def deadline_ns(self, value: int) -> None:
        self.bus.deadlines[self._place] = value


def identifier(frame: bytes) -> int:
    """The word with identifier and flags."""
    word: int = _CAN_ID.unpack_from(frame)[0]
    return word

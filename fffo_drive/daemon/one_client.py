"""One connection to a socket, its limits, and its handler."""

from __future__ import annotations

import socket
import struct
import time
from collections import deque
from typing import NamedTuple, Protocol

LINE_COST_BYTES = 512  # cost of the shortest line


class SocketLimits(NamedTuple):
    """Limits for the clients of one socket."""

    line_bytes: int
    waiting_bytes: int  # of one client
    bytes_per_s: float  # of all clients together
    burst_bytes: float


CONTROL_LIMITS = SocketLimits(256 * 1024, 1024 * 1024, 256 * 1024.0, 512 * 1024.0)  # a model file fits a line
WATCH_LIMITS = SocketLimits(4 * 1024, 64 * 1024, 128 * 1024.0, 64 * 1024.0)


class ReceivedLine(NamedTuple):
    """A line as it arrived."""

    content: bytes
    epoch: int


class Handler(Protocol):
    """Handler of lines and clients; called on the clients' thread."""

    def stop_line(self, client: Client, line: ReceivedLine) -> bool:
        """A line that looks like a stop. False when it is none that can be carried out: it waits like any other."""
        ...

    def line(self, client: Client, line: ReceivedLine) -> None:
        """Any other line, when it is its turn."""
        ...

    def status_line(self) -> bytes:
        """The newest status as a notification."""
        ...

    def cut_off(self, client: Client, reason: str) -> None:
        """A client was cut off."""
        ...

    def turned_away(self, watching: bool, reason: str) -> None:
        """A connection was not let in."""
        ...

    def left(self, client: Client) -> None:
        """A client is gone."""
        ...

    def holds(self, client: Client) -> bool:
        """The axis hangs on this connection."""
        ...


class Budget:
    """Bytes a second, kept up to a burst."""

    def __init__(self, limits: SocketLimits, now_s: float) -> None:
        self._limits, self._left, self._filled_s = limits, limits.burst_bytes, now_s

    def take(self, line_bytes: int, now_s: float) -> bool:
        """Take a line's cost from the budget, if it suffices. All lines are shorter than the burst."""
        gained = (now_s - self._filled_s) * self._limits.bytes_per_s
        self._left = min(self._limits.burst_bytes, self._left + gained)
        self._filled_s = now_s
        cost = max(line_bytes, LINE_COST_BYTES)
        if self._left < cost:
            return False
        self._left -= cost
        return True


class Client:
    """One connection. All but `name`, `credentials` and `watching` belongs to the thread of the clients."""

    def __init__(self, sock: socket.socket, watching: bool, limits: SocketLimits, now_s: float, place: bool) -> None:
        self.sock, self.watching, self.limits = sock, watching, limits
        self.has_place = place  # False: beyond the limit, for a stop only
        self.joined_s = self.heard_s = now_s
        self.partial = bytearray()
        self.lines: deque[ReceivedLine] = deque()
        self.waiting_bytes = 0
        self.out = bytearray()
        self.calls = 0  # lines passed on and not yet answered
        self.ended = False  # it will say no more
        self.closed = False
        self.awaited = 0  # selectors.EVENT_*
        self.no_stop = (
            False  # one of its lines only looked like a stop: none is tried on arrival until all are answered
        )
        self.status_period_s = 0.0
        self.status_due_s = 0.0
        self.wants_events = False
        pid, uid, gid = struct.unpack("3i", sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        self.credentials = {"client_pid": pid, "client_uid": uid, "client_gid": gid}
        self.name = f"pid {pid} (uid {uid})"

    @property
    def listens(self) -> bool:
        """Whether it has subscribed to anything."""
        return bool(self.status_period_s or self.wants_events)

    def subscribe(self, status_hz: float, events: bool) -> None:
        """What it wants to hear from now on."""
        self.status_period_s = 1.0 / status_hz if status_hz > 0 else 0.0
        self.status_due_s = time.monotonic()
        self.wants_events = events

"""Node guarding and life guarding (CiA 301, 7.2.8.2.1): the node answers the master's remote frames with its state.

Bit 7 toggles with each answer. With 0x100C (ms) times 0x100D above 0 the node monitors the master, from the first
request on: silence is a life guarding event. While the node sends a heartbeat (0x1017) there is neither.
"""

from __future__ import annotations

from collections.abc import Callable

from ..can.frame import HEARTBEAT, REMOTE_FLAG
from .bus import NEVER, NS_PER_MS, Bus, Timed
from .dictionary import ObjectDictionary
from .heartbeat import PRODUCER_TIME
from .nmt import NmtSlave

GUARD_TIME = 0x100C
LIFE_TIME_FACTOR = 0x100D
TOGGLE = 0x80


class NodeGuarding(Timed):
    """Answers guarding requests. `on_loss()` and `on_recovery()` report life guarding events."""

    def __init__(
        self,
        bus: Bus,
        od: ObjectDictionary,
        nmt: NmtSlave,
        on_loss: Callable[[], None],
        on_recovery: Callable[[], None],
    ) -> None:
        super().__init__(bus)
        self.od, self.nmt = od, nmt
        self._on_loss, self._on_recovery = on_loss, on_recovery
        self._toggle = 0
        self._lost = False
        for index in (GUARD_TIME, LIFE_TIME_FACTOR):
            od.on_write(index, lambda sub, value: self._forget())

    @property
    def question(self) -> int:
        """The identifier word of the request, a remote frame."""
        return REMOTE_FLAG | HEARTBEAT + self.nmt.node_id

    def reset(self) -> None:
        """After an NMT reset: no request so far."""
        self._toggle = 0
        self._lost = False
        self.deadline_ns = NEVER

    def _forget(self) -> None:
        """The times changed: monitoring begins with the next request."""
        self.deadline_ns = NEVER
        self._found()

    def _found(self) -> None:
        if self._lost:
            self._lost = False
            self._on_recovery()

    def receive(self, frame: bytes) -> None:
        """A request."""
        number = self.od.number
        if number(PRODUCER_TIME):
            return
        self.bus.send(HEARTBEAT + self.nmt.node_id, bytes([self.nmt.state | self._toggle]))
        self._toggle ^= TOGGLE
        life_ns = number(GUARD_TIME) * number(LIFE_TIME_FACTOR) * NS_PER_MS
        self.deadline_ns = self.bus.now_ns + life_ns if life_ns else NEVER
        self._found()

    def poll(self) -> None:
        """No request came within the life time."""
        self.deadline_ns = NEVER
        if not self.od.number(PRODUCER_TIME):
            self._lost = True
            self._on_loss()

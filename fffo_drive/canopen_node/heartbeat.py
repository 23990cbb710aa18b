"""Heartbeat producer (0x1017) and consumer (0x1016), CiA 301 7.2.8.2.2 and 7.5.2.13.

A monitored node is supervised from its first heartbeat on. Its silence, or its boot-up message while it is
supervised, is a heartbeat event; the next heartbeat ends it.
"""

from __future__ import annotations

from collections.abc import Callable

from ..can.frame import DATA_OFFSET, HEARTBEAT, LENGTH_OFFSET
from .abort import Abort, SdoAbortError
from .bus import NEVER, NS_PER_MS, Bus, Timed, identifier
from .dictionary import ObjectDictionary
from .nmt import UNCONFIGURED, NmtSlave

PRODUCER_TIME = 0x1017
CONSUMER_TIME = 0x1016


class HeartbeatProducer(Timed):
    """Sends the NMT state every 0x1017 ms; the first one as soon as the time is written."""

    def __init__(self, bus: Bus, od: ObjectDictionary, nmt: NmtSlave) -> None:
        super().__init__(bus)
        self.od, self.nmt = od, nmt
        od.on_write(PRODUCER_TIME, lambda sub, value: self._start(self.bus.now_ns))

    def reset(self) -> None:
        """After boot-up, which counts as the first heartbeat."""
        self._start(self.bus.now_ns + self.od.number(PRODUCER_TIME) * NS_PER_MS)

    def _start(self, first_ns: int) -> None:
        speaks = self.od.number(PRODUCER_TIME) and self.nmt.node_id != UNCONFIGURED
        self.deadline_ns = first_ns if speaks else NEVER

    def poll(self) -> None:
        """Send when due; a late call sends one heartbeat and keeps the grid."""
        period_ns = self.od.number(PRODUCER_TIME) * NS_PER_MS
        late_ns = self.bus.now_ns - self.deadline_ns
        self.deadline_ns += period_ns * (1 + late_ns // period_ns)
        self.bus.send(HEARTBEAT + self.nmt.node_id, bytes([self.nmt.state]))


class HeartbeatConsumer(Timed):
    """Supervises as many nodes as 0x1016 has places.

    `on_loss(node_id)` and `on_recovery(node_id)` report heartbeat events; `on_change()`, a change of `node_ids`.
    """

    def __init__(
        self,
        bus: Bus,
        od: ObjectDictionary,
        on_loss: Callable[[int], None],
        on_recovery: Callable[[int], None],
        on_change: Callable[[], None],
    ) -> None:
        super().__init__(bus)
        self.od = od
        self._on_loss, self._on_recovery, self._announce_change = on_loss, on_recovery, on_change
        self._period_ns: dict[int, int] = {}  # configured
        self._due_ns: dict[int, int] = {}  # supervised: heard since configured
        self._lost: set[int] = set()
        self._subs = od.subs(CONSUMER_TIME)
        od.guard(CONSUMER_TIME, self._check)
        od.on_write(CONSUMER_TIME, lambda sub, value: self._configure())

    @property
    def node_ids(self) -> list[int]:
        """Nodes to listen to."""
        return list(self._period_ns)

    def reset(self) -> None:
        """Start again with the present values of 0x1016."""
        self._period_ns.clear()
        self._due_ns.clear()
        self._lost.clear()
        self._configure()

    def _check(self, sub: int, value: int) -> None:
        node_id, milliseconds = value >> 16, value & 0xFFFF
        if node_id > 127:
            raise SdoAbortError(Abort.INVALID_VALUE)
        if not node_id or not milliseconds:
            return
        for other in self._subs:
            existing = self.od.number(CONSUMER_TIME, other)
            if other != sub and existing & 0xFFFF and existing >> 16 == node_id:
                raise SdoAbortError(Abort.INCOMPATIBLE)

    def _configure(self) -> None:
        wanted: dict[int, int] = {}
        for sub in self._subs:
            value = self.od.number(CONSUMER_TIME, sub)
            if value >> 16 and value & 0xFFFF:
                wanted[value >> 16] = (value & 0xFFFF) * NS_PER_MS
        for node_id in [n for n, period_ns in self._period_ns.items() if wanted.get(n) != period_ns]:
            self._due_ns.pop(node_id, None)
            if node_id in self._lost:
                self._lost.discard(node_id)
                self._on_recovery(node_id)
        self._period_ns = wanted
        self._watch()
        self._announce_change()

    def _watch(self) -> None:
        """The next supervised node is overdue then."""
        self.deadline_ns = min(self._due_ns.values(), default=NEVER)

    def receive(self, frame: bytes) -> None:
        node_id = identifier(frame) - HEARTBEAT
        period_ns = self._period_ns.get(node_id)
        if period_ns is None or frame[LENGTH_OFFSET] != 1:
            return
        if frame[DATA_OFFSET] == 0:  # boot-up: the node was away
            if node_id in self._due_ns:
                self._lose(node_id)
            return
        self._due_ns[node_id] = self.bus.now_ns + period_ns
        self._watch()
        if node_id in self._lost:
            self._lost.discard(node_id)
            self._on_recovery(node_id)

    def _lose(self, node_id: int) -> None:
        del self._due_ns[node_id]
        self._watch()
        self._lost.add(node_id)
        self._on_loss(node_id)

    def poll(self) -> None:
        """Report what is overdue."""
        for node_id in [n for n, due_ns in self._due_ns.items() if due_ns <= self.bus.now_ns]:
            self._lose(node_id)

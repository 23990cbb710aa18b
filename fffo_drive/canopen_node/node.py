"""The node: all services put together. Frames and time in, frames out; no sockets, no clock, no threads.

`handle` takes a frame; `poll` does what is due, at `deadline_ns` at the latest. A device derives its node from
`CanopenNode` and says in `advance`, `update`, `on_sync`, `connection_lost` and `restart` what it does itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from ..can.frame import (
    ERROR_BUS_OFF,
    ERROR_FLAG,
    ERROR_RESTARTED,
    FRAME_SIZE,
    HEARTBEAT,
    LENGTH_OFFSET,
    MAX_DATA,
    NMT,
)
from . import emcy
from .abort import Abort, SdoAbortError
from .bus import NEVER, Bus, Handler, identifier
from .dictionary import WAITS_FOR_MASTER, ObjectDictionary
from .emcy import EmergencyProducer
from .guarding import NodeGuarding
from .heartbeat import HeartbeatConsumer, HeartbeatProducer
from .inbox import Box
from .lss import REQUEST_ID, LssSlave
from .nmt import UNCONFIGURED, NmtSlave, NmtState
from .rpdo import Rpdo
from .sdo_server import SdoServer
from .storage import Storage
from .sync import STATISTICS, SyncConsumer
from .sync_producer import SyncProducer
from .tpdo import Tpdo

ERROR_BEHAVIOUR = 0x1029
STARTUP = 0x1F80
MOST_PDOS = 512  # in each direction


class NodeService(Protocol):
    """A part of the node with a deadline."""

    deadline_ns: int

    def poll(self) -> None:
        """Do it."""
        ...


class CanopenNode:
    """One CANopen node. Call `start`, then `handle` and `poll` with rising times."""

    def __init__(
        self,
        od: ObjectDictionary,
        commands: frozenset[int] = frozenset(),
        event_objects: frozenset[int] = frozenset(),
        rtr_required: bool = False,
    ) -> None:
        """`commands`: objects of the device that "save" leaves out; `event_objects`: changes that TPDOs send.

        `rtr_required`: refuses the COB-ID of a TPDO without bit 30.
        """
        self.od = od
        self.bus = bus = Bus()
        od.guard(STARTUP, self._check_startup)
        self.nmt = NmtSlave(bus, od.node_id, self._on_state, self._on_reset, self.starts_itself)
        self.lss = LssSlave(bus, od, self.nmt, lambda: self.nmt.reset(whole_node=False))
        self.emergency = EmergencyProducer(bus, od, self.nmt)
        self.storage = Storage(od, commands)
        self._statistics = od.place(STATISTICS)
        self.sync = SyncConsumer(
            bus,
            od,
            self.nmt,
            self.emergency,
            self._on_sync,
            lambda: self.connection_lost(emcy.SYNC_LOSS),
            self.wire_up,
        )
        self.clock = SyncProducer(bus, od, self.nmt, self.sync.receive)
        self.producer = HeartbeatProducer(bus, od, self.nmt)
        self.consumer = HeartbeatConsumer(bus, od, self._on_heartbeat_loss, self._on_heartbeat_recovery, self.wire_up)
        self.guarding = NodeGuarding(
            bus, od, self.nmt, lambda: self._on_heartbeat_loss(0), lambda: self._on_heartbeat_recovery(0)
        )
        self.sdo = SdoServer(bus, od, self.nmt)
        self.tpdos = [
            Tpdo(bus, od, self.nmt, n, self.wire_up, event_objects, rtr_required) for n in pdo_numbers(od, 0x1800)
        ]
        self.rpdos = [
            Rpdo(
                bus,
                od,
                self.nmt,
                self.emergency,
                self.sync,
                n,
                self.wire_up,
                lambda: self.connection_lost(emcy.RPDO_TIMEOUT),
            )
            for n in pdo_numbers(od, 0x1400)
        ]
        self.services: list[NodeService] = [
            self.producer,
            self.consumer,
            self.guarding,
            self.emergency,
            self.clock,
            self.sync,
            self.sdo,
            *self.rpdos,
            *self.tpdos,
        ]
        self._pdos: tuple[Rpdo | Tpdo, ...] = (*self.rpdos, *self.tpdos)

    # what the device does

    def advance(self) -> None:
        """Bring the device to now, before an event acts on it."""

    def update(self) -> None:
        """Take in what an event has changed."""

    def on_sync(self) -> None:
        """A SYNC came: bring the device to now and latch what the TPDOs send."""
        self.advance()

    def connection_lost(self, code: int, announce: bool = False) -> None:
        """React to a lost connection (0x6007). `announce`: no EMCY was sent for it yet."""

    def left_operational(self) -> None:
        """The node left NMT OPERATIONAL, by command, by itself or by a reset: a lost connection."""
        self.connection_lost(emcy.COMMUNICATION, announce=True)

    def restart(self) -> None:
        """The node was reset: start as after power-on."""

    def starts_itself(self) -> bool:
        """0x1F80 of CiA 302-2: bit 2 says that the node waits for its master."""
        return not self.od.number_or(STARTUP, 0, WAITS_FOR_MASTER) & WAITS_FOR_MASTER

    # entry points

    def start(self, now_ns: int) -> list[bytes]:
        """Power on: boot-up."""
        self.bus.now_ns = now_ns
        self.nmt.reset(whole_node=True)
        return self._collect()

    def handle(self, frame: bytes, now_ns: int) -> list[bytes]:
        """A frame came from the bus (16 bytes). Returns the frames to send."""
        self.bus.now_ns = now_ns
        self.dispatch(frame)
        return self._collect()

    def poll(self, now_ns: int) -> list[bytes]:
        """Do what is due at `now_ns`. Returns the frames to send."""
        self.bus.now_ns = now_ns
        if self.deadline_ns > now_ns:
            return []
        self.advance()
        self.serve()
        self.update()
        return self._collect()

    def serve(self) -> None:
        """Poll the services whose deadline has come."""
        now_ns = self.bus.now_ns
        for service in self.services:
            if service.deadline_ns <= now_ns:
                service.poll()

    def bus_changed(self, present: bool, now_ns: int) -> list[bytes]:
        """The interface went down (as at bus-off) or came back. Returns the frames to send."""
        self.bus.now_ns = now_ns
        self._on_error_frame(ERROR_RESTARTED if present else ERROR_BUS_OFF)
        return self._collect()

    @property
    def deadline_ns(self) -> int:
        """When `poll` must be called at the latest."""
        return min(self.bus.deadlines)

    # frames

    def dispatch(self, frame: bytes) -> None:
        """Give a frame to the service that listens to it."""
        if len(frame) != FRAME_SIZE or frame[LENGTH_OFFSET] > MAX_DATA:
            self._count_malformed()
            return
        word = identifier(frame)
        handler = self.bus.listeners.get(word)  # flags are part of the word: a remote frame is another
        if handler is not None:
            handler(frame)
        elif word & ERROR_FLAG:
            self._on_error_frame(word)

    def _collect(self) -> list[bytes]:
        if self.nmt.exchanges:
            for tpdo in self._event_tpdos:
                tpdo.check_event()
        frames = self.leaving(self.bus.outbox)
        self.bus.outbox.clear()
        return frames

    def leaving(self, outbox: list[bytes]) -> list[bytes]:
        """What goes to the bus of the frames in the outbox."""
        return outbox[:]

    def wire_up(self) -> None:
        """Register all listeners anew, after a change of an identifier."""
        bus = self.bus
        bus.listeners.clear()
        bus.listen(REQUEST_ID, self._acting(self.lss.receive))
        if self.nmt.node_id != UNCONFIGURED:
            self._listen()
        self.clock.renew()
        self._sync_rpdos = [rpdo for rpdo in self.rpdos if rpdo.exists and rpdo.synchronous]
        self._sync_tpdos = [tpdo for tpdo in self.tpdos if tpdo.synchronous or tpdo.acyclic]
        self._event_tpdos = [tpdo for tpdo in self.tpdos if tpdo.event_driven]
        self._patient = tuple(self._waiting_for_sync())

    def _listen(self) -> None:
        bus = self.bus
        bus.listen(NMT, self._acting(self.nmt.receive))
        bus.listen(self.sync.can_id, self.sync.receive)
        for rpdo in self.rpdos:
            if rpdo.exists:
                bus.listen(rpdo.parameters.can_id, rpdo.receive if rpdo.synchronous else self._acting(rpdo.receive))
        bus.listen(self.sdo.request_id, self._acting(self.sdo.receive))
        for node_id in self.consumer.node_ids:
            bus.listen(HEARTBEAT + node_id, self._acting(self.consumer.receive))
        bus.listen(self.guarding.question, self._acting(self.guarding.receive))

    def _waiting_for_sync(self) -> Iterator[Box]:
        """RPDOs of which only the last frame before SYNC matters: no other listener, no synchronous window."""
        for rpdo in self._sync_rpdos:
            can_id = rpdo.parameters.can_id
            if self.bus.listeners.get(can_id) == rpdo.receive and self.sync.window_ns == NEVER:
                yield Box(can_id, rpdo.mapping.length)

    @property
    def boxes(self) -> tuple[Box, ...]:
        """Frames that may be handled late, with their time of arrival, before any later event."""
        return self._patient

    def _acting(self, handler: Handler) -> Handler:
        """`handler` with the device advanced to now before it and updated after it."""

        def act(frame: bytes) -> None:
            self.advance()
            handler(frame)
            self.update()

        return act

    def _count_malformed(self) -> None:
        self.od.put(self._statistics, 6, self.od.number(self._statistics, 6) + 1 & 0xFFFFFFFF)

    def _on_error_frame(self, word: int) -> None:
        if word & ERROR_BUS_OFF:
            self.on_bus_off()
        if word & ERROR_RESTARTED:
            self.emergency.announce(emcy.BUS_OFF_RECOVERED)

    def on_bus_off(self) -> None:
        """The controller left the bus."""
        self.advance()
        self._communication_error(emcy.COMMUNICATION, announce=True)
        self.update()

    # what services report

    def _on_sync(self, counter: int) -> None:
        self.on_sync()
        if not self.nmt.exchanges:
            self.update()
            return
        for rpdo in self._sync_rpdos:
            rpdo.on_sync()
        self.update()
        for tpdo in self._sync_tpdos:
            tpdo.on_sync(counter)

    def _on_state(self, old: NmtState, new: NmtState) -> None:
        if old is NmtState.OPERATIONAL:
            self.left_operational()
        for pdo in self._pdos:
            pdo.restart()
        self.sync.watch()
        self.clock.renew()
        if new is NmtState.STOPPED:
            self.sdo.reset()
        self.emergency.flush()

    def _on_reset(self, whole_node: bool) -> None:
        self.advance()
        self.left_operational()
        self._take_node_id(self.lss.adopt(whole_node))
        self.storage.reset(whole_node)
        for pdo in self._pdos:
            pdo.configure()
            pdo.restart()
        for service in (self.sync, self.producer, self.consumer, self.guarding, self.sdo):
            service.reset()
        self.emergency.reset(whole_node)
        if whole_node:
            self.restart()
        self.wire_up()

    def _check_startup(self, sub: int, value: int) -> None:
        if not self.od.foreign and value & ~WAITS_FOR_MASTER:  # it is no NMT master
            raise SdoAbortError(Abort.INVALID_VALUE)

    def _take_node_id(self, node_id: int) -> None:
        self.nmt.node_id = node_id
        if node_id != UNCONFIGURED:
            self.od.node_id = node_id

    def _on_heartbeat_loss(self, node_id: int) -> None:
        self.emergency.raise_error(emcy.HEARTBEAT_LOSS, node_id)
        self._communication_error(emcy.HEARTBEAT_LOSS)

    def _on_heartbeat_recovery(self, node_id: int) -> None:
        self.emergency.clear(emcy.HEARTBEAT_LOSS, node_id)

    def _communication_error(self, code: int, announce: bool = False) -> None:
        """0x6007 for the device and 0x1029 for the node. `announce`: no EMCY was sent for it yet."""
        self.connection_lost(code, announce)
        behaviour = self.od.number_or(ERROR_BEHAVIOUR, 1, 0)
        if behaviour == 2:
            self.nmt.enter(NmtState.STOPPED)
        elif behaviour == 0 and self.nmt.exchanges:
            self.nmt.enter(NmtState.PRE_OPERATIONAL)


def pdo_numbers(od: ObjectDictionary, first: int) -> list[int]:
    """The PDOs that a device has, counted from 0; `first` is the index of the first one's communication parameters."""
    return [number for number in range(MOST_PDOS) if first + number in od]

"""The node: all services put together. Frames and time in, frames out; no sockets, no clock, no threads.

`handle` takes a frame; `poll` does what is due, at `deadline_ns` at the latest. At a SYNC: advance the plant to now,
latch the feedback, apply the buffered RPDOs, compute the command, queue the TPDOs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Protocol

from ....can.frame import (
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
from .bus import NEVER, NS_PER_MS, Bus, Handler, Timed, identifier
from .config import NodeConfig, device_defaults
from .dictionary import ObjectDictionary
from .drive_profile import LARGEST_INDEX, NodeDrive
from .emcy import EmergencyProducer
from .fault_target import FaultTarget
from .faults import FaultInjector
from .foreign_dictionary import dictionary_of
from .guarding import NodeGuarding
from .habits import EmcyWarning, HoldingBrake
from .heartbeat import HeartbeatConsumer, HeartbeatProducer
from .inbox import Box
from .lss import REQUEST_ID, LssSlave
from .nmt import UNCONFIGURED, NmtSlave, NmtState
from .objects import WAITS_FOR_MASTER
from .rpdo import Rpdo
from .sdo_server import SdoServer
from .storage import Storage
from .sync import STATISTICS, SyncConsumer
from .sync_producer import SyncProducer
from .tpdo import Tpdo

if TYPE_CHECKING:
    from .simulated_plant import SimulatedPlant

ERROR_BEHAVIOUR = 0x1029
PLANT_PERIOD_NS = 10 * NS_PER_MS  # the plant is never further behind than this
INTERPOLATION_PERIOD = 0x60C2
STARTUP = 0x1F80
MOST_PDOS = 512  # in each direction


class NodeService(Protocol):
    """A part of the node with a deadline."""

    deadline_ns: int

    def poll(self) -> None:
        """Do it."""
        ...


class Node:
    """One CANopen node with a plant below it. Call `start`, then `handle` and `poll` with rising times."""

    def __init__(self, config: NodeConfig, plant: SimulatedPlant) -> None:
        self.config = config
        self.bus = bus = Bus()
        self._plant_due = Timed(bus)
        personality = config.personality
        self.od = od = dictionary_of(config, config.node_id, device_defaults(config))
        od.guard(STARTUP, self._check_startup)
        self.nmt = NmtSlave(bus, config.node_id, self._on_state, self._on_reset, self._starts_itself)
        self.lss = LssSlave(bus, od, self.nmt, lambda: self.nmt.reset(whole_node=False))
        self.emergency = EmergencyProducer(bus, od, self.nmt)
        self.storage = Storage(od)
        self.drive = NodeDrive(bus, od, self.emergency, plant, config.ratings, personality)
        self._mode_waits_for_sync = personality.mode_display == "with_sync"
        self._statistics = od.place(STATISTICS)
        self.sync = SyncConsumer(
            bus,
            od,
            self.nmt,
            self.emergency,
            self._on_sync,
            lambda: self._drive_lost(emcy.SYNC_LOSS),
            self._wire_up,
        )
        self.sync.supervised = not config.step_by_sync
        self.clock = SyncProducer(bus, od, self.nmt, self.sync.receive)
        self.producer = HeartbeatProducer(bus, od, self.nmt)
        self.consumer = HeartbeatConsumer(bus, od, self._on_heartbeat_loss, self._on_heartbeat_recovery, self._wire_up)
        self.guarding = NodeGuarding(
            bus, od, self.nmt, lambda: self._on_heartbeat_loss(0), lambda: self._on_heartbeat_recovery(0)
        )
        self.sdo = SdoServer(bus, od, self.nmt)
        rtr_required = personality.rtr_bit == "required"
        self.tpdos = [Tpdo(bus, od, self.nmt, n, self._wire_up, rtr_required) for n in pdo_numbers(od, 0x1800)]
        self.rpdos = [
            Rpdo(
                bus,
                od,
                self.nmt,
                self.emergency,
                self.sync,
                n,
                self._wire_up,
                lambda: self._drive_lost(emcy.RPDO_TIMEOUT),
            )
            for n in pdo_numbers(od, 0x1400)
        ]
        target = FaultTarget(bus, self.nmt, self.emergency, self.drive, self.rpdos, self.tpdos, self._on_bus_off)
        self.faults = FaultInjector(bus, od, self.emergency, target, config.faults, config.plant.seed)
        self._services: tuple[NodeService, ...] = (
            self.producer,
            self.consumer,
            self.guarding,
            self.emergency,
            self.clock,
            self.sync,
            self.sdo,
            *self.rpdos,
            *self.tpdos,
            *self._habits(),
        )
        self._pdos: tuple[Rpdo | Tpdo, ...] = (*self.rpdos, *self.tpdos)
        self._start_ns = 0
        self._plant_ns = 0

    def _habits(self) -> Iterator[NodeService]:
        """Services that only some vendors' drives have."""
        personality = self.config.personality
        self._warning: EmcyWarning | None = None
        if personality.brake_release_s:
            yield HoldingBrake(self.bus, self.od, self.drive, personality.brake_release_s)
        if personality.warning_code:
            code, at_s = personality.warning_code, personality.warning_at_s
            self._warning = EmcyWarning(self.bus, self.emergency, self.drive, code, at_s)
            yield self._warning

    # entry points

    def start(self, now_ns: int) -> list[bytes]:
        """Power on: boot-up."""
        self.bus.now_ns = self._start_ns = now_ns
        self._plant_due.deadline_ns = now_ns + PLANT_PERIOD_NS
        self.faults.start()
        if self._warning is not None:
            self._warning.start()
        self.nmt.reset(whole_node=True)
        return self._collect()

    def handle(self, frame: bytes, now_ns: int) -> list[bytes]:
        """A frame came from the bus (16 bytes). Returns the frames to send."""
        self.bus.now_ns = now_ns
        faults = self.faults
        if faults.quiet:
            self._dispatch(frame)
        elif not faults.dark:
            for arriving in faults.received.transfer(frame, now_ns):
                self._dispatch(arriving)
        return self._collect()

    def poll(self, now_ns: int) -> list[bytes]:
        """Do what is due at `now_ns`. Returns the frames to send."""
        self.bus.now_ns = now_ns
        if self.deadline_ns > now_ns:
            return []
        self._advance()
        self.faults.poll()
        for frame in self.faults.received.due(now_ns):
            if not self.faults.dark:
                self._dispatch(frame)
        for service in self._services:
            if service.deadline_ns <= now_ns:
                service.poll()
        self.drive.update()
        return self._collect()

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

    def _dispatch(self, frame: bytes) -> None:
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
        outbox = self.bus.outbox
        frames = outbox[:] if self.faults.quiet else self._leave_faulty(outbox)
        outbox.clear()
        return frames

    def _leave_faulty(self, outbox: list[bytes]) -> list[bytes]:
        wire, now_ns = self.faults.sent, self.bus.now_ns
        if self.faults.dark:
            return [frame for frame in outbox if identifier(frame) & ERROR_FLAG]
        frames = wire.due(now_ns)
        for frame in outbox:
            frames += wire.transfer(frame, now_ns)
        self.faults.take_stock()
        return frames

    def _wire_up(self) -> None:
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
        self.faults.renew()

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
        return self._patient if self.faults.quiet else ()

    def _acting(self, handler: Handler) -> Handler:
        """`handler` with the drive advanced to now before it and updated after it."""

        def act(frame: bytes) -> None:
            self._advance()
            handler(frame)
            self.drive.update()

        return act

    def _count_malformed(self) -> None:
        self.od.put(self._statistics, 6, self.od.number(self._statistics, 6) + 1 & 0xFFFFFFFF)

    def _on_error_frame(self, word: int) -> None:
        if word & ERROR_BUS_OFF:
            self._on_bus_off()
        if word & ERROR_RESTARTED:
            self.emergency.announce(emcy.BUS_OFF_RECOVERED)

    def _on_bus_off(self) -> None:
        self._advance()
        self._communication_error(emcy.COMMUNICATION, announce=True)
        self.drive.update()

    # time

    def _advance(self) -> None:
        """Advance the plant to now, unless only SYNC advances it."""
        if not self.config.step_by_sync:
            self._plant_ns = self.bus.now_ns - self._start_ns
        self._plant_due.deadline_ns = self.bus.now_ns + PLANT_PERIOD_NS
        self.drive.advance_to(self._plant_ns)

    def _sync_period_ns(self) -> int:
        """0x1006; where it is 0, the interpolation period 0x60C2."""
        number = self.od.number
        power = min(max(number(INTERPOLATION_PERIOD, 2), -LARGEST_INDEX), 0)
        exact = int(number(INTERPOLATION_PERIOD, 1) * 10 ** (9 + power))
        return self.sync.period_ns or exact

    def _on_sync(self, counter: int) -> None:
        if self.config.step_by_sync:
            self._plant_ns += self._sync_period_ns()
        self._advance()
        if self._mode_waits_for_sync:
            self.drive.settle_mode()
        if not self.nmt.exchanges:
            self.drive.update()
            return
        for rpdo in self._sync_rpdos:
            rpdo.on_sync()
        self.drive.update()
        for tpdo in self._sync_tpdos:
            tpdo.on_sync(counter)

    # what services report

    def _on_state(self, old: NmtState, new: NmtState) -> None:
        if old is NmtState.OPERATIONAL:
            self._drive_lost(emcy.COMMUNICATION, announce=True)
        for pdo in self._pdos:
            pdo.restart()
        self.sync.watch()
        self.clock.renew()
        if new is NmtState.STOPPED:
            self.sdo.reset()
        self.emergency.flush()

    def _on_reset(self, whole_node: bool) -> None:
        self._advance()
        self._drive_lost(emcy.COMMUNICATION, announce=True)
        self._take_node_id(self.lss.adopt(whole_node))
        self.storage.reset(whole_node)
        for pdo in self._pdos:
            pdo.configure()
            pdo.restart()
        for service in (self.sync, self.producer, self.consumer, self.guarding, self.sdo):
            service.reset()
        self.emergency.reset(whole_node)
        if whole_node:
            self.drive.restart()
        self._wire_up()

    def _starts_itself(self) -> bool:
        """0x1F80 of CiA 302-2: bit 2 says that the node waits for its master."""
        return self.config.personality.starts_itself or not self.od.number(STARTUP) & WAITS_FOR_MASTER

    def _check_startup(self, sub: int, value: int) -> None:
        if not self.od.foreign and value & ~WAITS_FOR_MASTER:  # it is no NMT master
            raise SdoAbortError(Abort.INVALID_VALUE)

    def _take_node_id(self, node_id: int) -> None:
        self.nmt.node_id = node_id
        if node_id != UNCONFIGURED:
            self.od.node_id = node_id

    def _drive_lost(self, code: int, announce: bool = False) -> None:
        self.drive.connection_lost(code, announce)

    def _on_heartbeat_loss(self, node_id: int) -> None:
        self.emergency.raise_error(emcy.HEARTBEAT_LOSS, node_id)
        self._communication_error(emcy.HEARTBEAT_LOSS)

    def _on_heartbeat_recovery(self, node_id: int) -> None:
        self.emergency.clear(emcy.HEARTBEAT_LOSS, node_id)

    def _communication_error(self, code: int, announce: bool = False) -> None:
        """0x6007 for the drive and 0x1029 for the node. `announce`: no EMCY was sent for it yet."""
        self._drive_lost(code, announce)
        behaviour = self.od.number(ERROR_BEHAVIOUR, 1)
        if behaviour == 2:
            self.nmt.enter(NmtState.STOPPED)
        elif behaviour == 0 and self.nmt.exchanges:
            self.nmt.enter(NmtState.PRE_OPERATIONAL)


def pdo_numbers(od: ObjectDictionary, first: int) -> list[int]:
    """The PDOs that a drive has, counted from 0; `first` is the index of the first one's communication parameters."""
    return [number for number in range(MOST_PDOS) if first + number in od]

"""The node of the simulated drive: the CiA 402 drive and its plant above the services of CiA 301.

At a SYNC: advance the plant to now, latch the feedback, apply the buffered RPDOs, compute the command, queue the TPDOs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from ....can.frame import ERROR_FLAG
from ....canopen_node.bus import NS_PER_MS, Timed, identifier
from ....canopen_node.inbox import Box
from ....canopen_node.node import CanopenNode, NodeService
from .config import NodeConfig, device_defaults
from .drive_profile import LARGEST_INDEX, NodeDrive
from .fault_target import FaultTarget
from .faults import FaultInjector
from .foreign_dictionary import dictionary_of
from .habits import EmcyWarning, HoldingBrake
from .objects import COMMANDS, EVENT_OBJECTS

if TYPE_CHECKING:
    from .simulated_plant import SimulatedPlant

PLANT_PERIOD_NS = 10 * NS_PER_MS  # the plant is never further behind than this
INTERPOLATION_PERIOD = 0x60C2


class Node(CanopenNode):
    """One drive on CANopen with a plant below it."""

    def __init__(self, config: NodeConfig, plant: SimulatedPlant) -> None:
        self.config = config
        personality = config.personality
        od = dictionary_of(config, config.node_id, device_defaults(config))
        super().__init__(od, COMMANDS, EVENT_OBJECTS, personality.rtr_bit == "required")
        self.sync.supervised = not config.step_by_sync
        self.drive = NodeDrive(self.bus, od, self.emergency, plant, config.ratings, personality)
        self._mode_waits_for_sync = personality.mode_display == "with_sync"
        target = FaultTarget(self.bus, self.nmt, self.emergency, self.drive, self.rpdos, self.tpdos, self.on_bus_off)
        self.faults = FaultInjector(self.bus, od, self.emergency, target, config.faults, config.plant.seed)
        self.services += self._habits()
        self._plant_due = Timed(self.bus)
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

    # the drive

    def advance(self) -> None:
        """Advance the plant to now, unless only SYNC advances it."""
        if not self.config.step_by_sync:
            self._plant_ns = self.bus.now_ns - self._start_ns
        self._plant_due.deadline_ns = self.bus.now_ns + PLANT_PERIOD_NS
        self.drive.advance_to(self._plant_ns)

    def update(self) -> None:
        """Let the drive act on what has changed."""
        self.drive.update()

    def on_sync(self) -> None:
        """Advance the plant, by a period where only SYNC advances it, and latch the feedback."""
        if self.config.step_by_sync:
            self._plant_ns += self._sync_period_ns()
        self.advance()
        if self._mode_waits_for_sync:
            self.drive.settle_mode()

    def connection_lost(self, code: int, announce: bool = False) -> None:
        """0x6007. `announce`: no EMCY was sent for it yet."""
        self.drive.connection_lost(code, announce)

    def left_operational(self) -> None:
        """As the connection lost, unless the drive keeps its last torque all the same."""
        if not self.config.personality.keeps_torque:
            super().left_operational()

    def restart(self) -> None:
        """The drive as after power-on; the shaft goes on."""
        self.drive.restart()

    def starts_itself(self) -> bool:
        """0x1F80, or a drive that always does."""
        return self.config.personality.starts_itself or super().starts_itself()

    def _sync_period_ns(self) -> int:
        """0x1006; where it is 0, the interpolation period 0x60C2."""
        number = self.od.number
        power = min(max(number(INTERPOLATION_PERIOD, 2), -LARGEST_INDEX), 0)
        exact = int(number(INTERPOLATION_PERIOD, 1) * 10 ** (9 + power))
        return self.sync.period_ns or exact

    # injected faults

    def start(self, now_ns: int) -> list[bytes]:
        """Power on: boot-up."""
        self.bus.now_ns = self._start_ns = now_ns
        self._plant_due.deadline_ns = now_ns + PLANT_PERIOD_NS
        self.faults.start()
        if self._warning is not None:
            self._warning.start()
        return super().start(now_ns)

    def handle(self, frame: bytes, now_ns: int) -> list[bytes]:
        """A frame came from the bus (16 bytes). Returns the frames to send."""
        faults = self.faults
        if faults.quiet:
            return super().handle(frame, now_ns)
        self.bus.now_ns = now_ns
        if not faults.dark:
            for arriving in faults.received.transfer(frame, now_ns):
                self.dispatch(arriving)
        return self._collect()

    def serve(self) -> None:
        """Poll the faults, then the services whose deadline has come."""
        self.faults.poll()
        for frame in self.faults.received.due(self.bus.now_ns):
            if not self.faults.dark:
                self.dispatch(frame)
        super().serve()

    def leaving(self, outbox: list[bytes]) -> list[bytes]:
        """What goes to the bus of the frames in the outbox."""
        if self.faults.quiet:
            return outbox[:]
        wire, now_ns = self.faults.sent, self.bus.now_ns
        if self.faults.dark:
            return [frame for frame in outbox if identifier(frame) & ERROR_FLAG]
        frames = wire.due(now_ns)
        for frame in outbox:
            frames += wire.transfer(frame, now_ns)
        self.faults.take_stock()
        return frames

    def wire_up(self) -> None:
        """Register all listeners anew, after a change of an identifier."""
        super().wire_up()
        self.faults.renew()

    @property
    def boxes(self) -> tuple[Box, ...]:
        """Frames that may be handled late, with their time of arrival, before any later event."""
        return super().boxes if self.faults.quiet else ()

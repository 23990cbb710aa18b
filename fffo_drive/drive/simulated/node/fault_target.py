"""The actions of `faults.FaultInjector` on a node."""

from __future__ import annotations

from collections.abc import Callable

from ....can.frame import ERROR_BUS_OFF, ERROR_RESTARTED, HEARTBEAT, MAX_DATA, pack_frame
from ....canopen_node.bus import Bus
from ....canopen_node.emcy import BUS_OFF_RECOVERED, EmergencyProducer
from ....canopen_node.nmt import NmtSlave
from ....canopen_node.rpdo import Rpdo
from ....canopen_node.tpdo import Tpdo
from .drive_profile import NodeDrive
from .faults import FaultKind


class FaultTarget:
    """The parts of a node on which faults act."""

    def __init__(
        self,
        bus: Bus,
        nmt: NmtSlave,
        emergency: EmergencyProducer,
        drive: NodeDrive,
        rpdos: list[Rpdo],
        tpdos: list[Tpdo],
        on_bus_off: Callable[[], None],
    ) -> None:
        self.bus, self.nmt, self.emergency, self.drive = bus, nmt, emergency, drive
        self.rpdos, self.tpdos = rpdos, tpdos
        self._on_bus_off = on_bus_off

    def can_ids_of(self, kind: FaultKind) -> frozenset[int] | None:
        """Identifiers that a fault without one of its own concerns at present; None: all."""
        if kind is FaultKind.NO_SYNC_ANSWER:
            return frozenset(t.parameters.can_id for t in self.tpdos if t.synchronous or t.acyclic)
        if kind is FaultKind.NO_RPDO:
            return frozenset(rpdo.parameters.can_id for rpdo in self.rpdos if rpdo.exists)
        if kind is FaultKind.NO_HEARTBEAT:
            return frozenset({HEARTBEAT + self.nmt.node_id})
        return None

    def hold_condition(self, code: int, present: bool) -> None:
        """Hold a fault condition of the drive, or release it; the drive finds it at its next supervision."""
        if present:
            self.drive.injected.add(code)
        else:
            self.drive.injected.discard(code)

    def stick_statusword(self, stuck: bool) -> None:
        """Freeze the statusword."""
        self.drive.stuck = stuck

    def lose_resolver(self, lost: bool, jump_rev: float) -> None:
        """Take the resolver's signal away, or give it back."""
        self.drive.plant.lose_resolver(lost, jump_rev)

    def lose_dc_link(self, lost: bool) -> None:
        """Take the supply away, or give it back."""
        self.drive.plant.lose_dc_link(lost)

    def power_down(self) -> None:
        """The electronics die: no torque, no memory; the shaft goes on, and the injector keeps the bus silent."""
        self.drive.restart()

    def power_up(self) -> None:
        """The node boots."""
        self.nmt.reset(whole_node=True)

    def bus_off(self, present: bool) -> None:
        """Report leaving the bus, or coming back, as a CAN controller does; the node then acts as at one of its own."""
        error_class = ERROR_BUS_OFF if present else ERROR_RESTARTED
        self.bus.outbox.append(pack_frame(error_class, bytes(MAX_DATA), error=True))
        if present:
            self._on_bus_off()
        else:
            self.emergency.announce(BUS_OFF_RECOVERED)

"""SYNC producer (CiA 301, 7.2.5 and 7.5.2.5): the drive as the clock of a bus, while bit 30 of 0x1005 is set.

The period is 0x1006; without one nothing is sent. The drive follows its own SYNC as it would another's.
"""

from __future__ import annotations

from collections.abc import Callable

from ..can.frame import pack_frame
from .bus import NEVER, NS_PER_US, Bus, Timed
from .dictionary import ObjectDictionary
from .nmt import NmtSlave
from .sync import COB_ID_SYNC, COUNTER_OVERFLOW, CYCLE_PERIOD, SHORTEST_PERIOD_US, SYNC_PRODUCER, sync_id


class SyncProducer(Timed):
    """Sends the SYNC in PRE-OPERATIONAL and OPERATIONAL; `on_sync(frame)` gets each of them."""

    def __init__(self, bus: Bus, od: ObjectDictionary, nmt: NmtSlave, on_sync: Callable[[bytes], None]) -> None:
        super().__init__(bus)
        self.od, self.nmt = od, nmt
        self._on_sync = on_sync
        self._settings = (0, 0, 0)
        self._counter = 0

    def renew(self) -> None:
        """The objects or the NMT state may have changed: with other values the first SYNC comes a period from now."""
        number = self.od.number
        produces = number(COB_ID_SYNC) & SYNC_PRODUCER and self.nmt.communicates
        period_us = number(CYCLE_PERIOD) if produces else 0
        period_ns = period_us * NS_PER_US if period_us >= SHORTEST_PERIOD_US else 0
        settings = (sync_id(number(COB_ID_SYNC)), period_ns, number(COUNTER_OVERFLOW))
        if settings != self._settings:
            self._settings = settings
            self._counter = 0
            self.deadline_ns = self.bus.now_ns + period_ns if period_ns else NEVER

    def poll(self) -> None:
        """Send when due; a late call sends one SYNC and keeps the grid."""
        can_id, period_ns, overflow = self._settings
        late_ns = self.bus.now_ns - self.deadline_ns
        self.deadline_ns += period_ns * (1 + late_ns // period_ns)
        if overflow:
            self._counter = self._counter % overflow + 1
        frame = pack_frame(can_id, bytes([self._counter]) if overflow else b"")
        self.bus.outbox.append(frame)
        self._on_sync(frame)

"""SYNC consumer (CiA 301, 7.2.5): counter, synchronous window, loss.

A SYNC that is missing is counted at the next one (0x2020:2); no SYNC for 0x1006 plus the tolerance 0x2010
(ms), and for 1.5 times 0x1006 at least, is a loss: EMCY 0x8700, and the drive's abort connection option. Without
0x1006 neither is detected.
"""

from __future__ import annotations

from collections.abc import Callable

from ..can.frame import DATA_OFFSET, LENGTH_OFFSET, STANDARD_MASK, SYNC
from .abort import Abort, SdoAbortError
from .bus import NEVER, NS_PER_MS, NS_PER_US, Bus, Timed
from .cob_id import check_can_id, is_restricted
from .dictionary import ObjectDictionary, multiplexer
from .emcy import SYNC_LENGTH, SYNC_LOSS, EmergencyProducer
from .nmt import NmtSlave

COB_ID_SYNC = 0x1005
CYCLE_PERIOD = 0x1006
WINDOW_LENGTH = 0x1007
COUNTER_OVERFLOW = 0x1019
LOSS_TOLERANCE = 0x2010
SYNC_PRODUCER = 1 << 30  # of 0x1005
SHORTEST_PERIOD_US = 200  # that this device can produce
STATISTICS = 0x2020


class SyncConsumer(Timed):
    """Follows the SYNC. `on_sync(counter)` is called for each valid one; the counter is 0 where none is sent.

    `on_change()` follows a change of its objects.
    """

    def __init__(
        self,
        bus: Bus,
        od: ObjectDictionary,
        nmt: NmtSlave,
        emergency: EmergencyProducer,
        on_sync: Callable[[int], None],
        on_loss: Callable[[], None],
        on_change: Callable[[], None],
    ) -> None:
        super().__init__(bus)
        self.od, self.nmt, self.emergency = od, nmt, emergency
        self._on_sync, self._on_loss = on_sync, on_loss
        self.supervised = True  # False where only SYNC advances time
        self._statistics = od.place(STATISTICS)
        self._tolerance = od.place(LOSS_TOLERANCE)
        self._received_slot = od.slots[multiplexer(self._statistics, 1)]
        od.guard(COB_ID_SYNC, self._check_cob_id)
        od.guard(COUNTER_OVERFLOW, self._check_overflow)
        od.guard(CYCLE_PERIOD, self._check_period)
        od.on_write(COB_ID_SYNC, lambda sub, value: on_change())
        for index in (CYCLE_PERIOD, WINDOW_LENGTH, COUNTER_OVERFLOW, self._tolerance):
            od.on_write(index, lambda sub, value: self._reconfigure(on_change))
        self.last_ns = -NEVER
        self.lost = False
        self.malformed = False
        self._configure()

    def _reconfigure(self, on_change: Callable[[], None]) -> None:
        self._configure()
        on_change()

    def _configure(self) -> None:
        number = self.od.number
        self.period_ns = number(CYCLE_PERIOD) * NS_PER_US
        self.window_ns = number(WINDOW_LENGTH) * NS_PER_US or NEVER
        self.counted = number(COUNTER_OVERFLOW) != 0
        tolerance_ns = max(number(self._tolerance) * NS_PER_MS, self.period_ns // 2)
        self._patience_ns = self.period_ns + tolerance_ns
        self.watch()

    def reset(self) -> None:
        """After an NMT reset: no SYNC was seen."""
        self.last_ns = -NEVER
        self.lost = False
        self.malformed = False
        self._configure()

    @property
    def can_id(self) -> int:
        """The identifier to listen to."""
        return sync_id(self.od.number(COB_ID_SYNC))

    def watch(self) -> None:
        """When the SYNC counts as lost: after each of them, and with each change of the NMT state."""
        watched = self.period_ns and self.supervised and not self.lost and self.last_ns >= 0 and self.nmt.exchanges
        self.deadline_ns = self.last_ns + self._patience_ns if watched else NEVER

    def poll(self) -> None:
        """The SYNC is lost."""
        self.lost = True
        self.watch()
        self.emergency.raise_error(SYNC_LOSS)
        self._on_loss()

    def receive(self, frame: bytes) -> None:
        """A frame with the identifier of the SYNC."""
        if not self.nmt.communicates:
            return
        if frame[LENGTH_OFFSET] != self.counted:
            self.malformed = True
            self.emergency.raise_error(SYNC_LENGTH, frame[LENGTH_OFFSET])
            return
        if self.malformed:
            self.malformed = False
            self.emergency.clear(SYNC_LENGTH)
        if self.lost:
            self.lost = False
            self.emergency.clear(SYNC_LOSS, 0)
        now_ns = self.bus.now_ns
        if self.period_ns and now_ns - self.last_ns > 1.5 * self.period_ns and self.last_ns >= 0:
            missed = round((now_ns - self.last_ns) / self.period_ns) - 1
            self.od.put(self._statistics, 2, self.od.number(self._statistics, 2) + missed & 0xFFFFFFFF)
        self.last_ns = now_ns
        self.watch()
        values = self.od.values
        values[self._received_slot] = values[self._received_slot] + 1 & 0xFFFFFFFF
        self._on_sync(frame[DATA_OFFSET] if self.counted else 0)

    def in_window(self) -> bool:
        """Whether synchronous PDOs may be exchanged now: always without a window, before the first SYNC too."""
        return self.window_ns == NEVER or self.bus.now_ns - self.last_ns <= self.window_ns

    def _check_cob_id(self, sub: int, value: int) -> None:
        can_id = value & ~SYNC_PRODUCER
        if can_id != SYNC:
            check_can_id(can_id)
        existing = self.od.number(COB_ID_SYNC)
        if existing & SYNC_PRODUCER and can_id != existing & STANDARD_MASK:
            raise SdoAbortError(Abort.INVALID_VALUE)
        if value & SYNC_PRODUCER and 0 < self.od.number(CYCLE_PERIOD) < SHORTEST_PERIOD_US:
            raise SdoAbortError(Abort.DEVICE_STATE)

    def _check_period(self, sub: int, value: int) -> None:
        if self.od.number(COB_ID_SYNC) & SYNC_PRODUCER and 0 < value < SHORTEST_PERIOD_US:
            raise SdoAbortError(Abort.VALUE_TOO_LOW)

    def _check_overflow(self, sub: int, value: int) -> None:
        if value == 1:
            raise SdoAbortError(Abort.INVALID_VALUE)
        if self.od.number(CYCLE_PERIOD) != 0:
            raise SdoAbortError(Abort.DEVICE_STATE)


def sync_id(cob_id: int) -> int:
    """The identifier in 0x1005; where a file has none that could be one, that of the pre-defined connection set."""
    can_id = cob_id & STANDARD_MASK
    return SYNC if is_restricted(can_id) else can_id

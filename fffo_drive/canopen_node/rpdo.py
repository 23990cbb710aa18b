"""Receive PDOs (CiA 301, 7.2.2): buffered until the next SYNC (types 0 to 240) or applied at once (254, 255).

Supervised: length (EMCY 0x8210 short, discarded; 0x8220 long, the mapped bytes are used), reception deadline
(sub 5, from the first reception on, EMCY 0x8250), synchronous window. Values outside an object's limits leave
that object as it was.
"""

from __future__ import annotations

from collections.abc import Callable

from ..can.frame import DATA_OFFSET, LENGTH_OFFSET
from .bus import NEVER, Bus, Timed
from .dictionary import Effect, ObjectDictionary, multiplexer
from .emcy import PDO_LENGTH, PDO_LENGTH_EXCEEDED, RPDO_TIMEOUT, EmergencyProducer
from .nmt import NmtSlave
from .pdo_parameters import EMPTY, HIGHEST_SYNC_TYPE, PdoParameters
from .sync import STATISTICS, SyncConsumer


class Rpdo(Timed):
    """One receive PDO. `on_timeout()` is called when its deadline passes."""

    def __init__(
        self,
        bus: Bus,
        od: ObjectDictionary,
        nmt: NmtSlave,
        emergency: EmergencyProducer,
        sync: SyncConsumer,
        number: int,
        on_change: Callable[[], None],
        on_timeout: Callable[[], None],
    ) -> None:
        super().__init__(bus)
        self.od, self.nmt, self.emergency, self.sync = od, nmt, emergency, sync
        self.number = number + 1
        self._announce_change = on_change
        self._on_timeout = on_timeout
        self._statistics = od.place(STATISTICS)
        self._applied_slot = od.slots[multiplexer(self._statistics, 3)]
        self.parameters = PdoParameters(od, number, True, self._changed)
        self.configure()
        self.restart()

    def _changed(self) -> None:
        self.configure()
        self.restart()
        self._announce_change()

    def configure(self) -> None:
        """Take the parameters from the dictionary."""
        parameters = self.parameters
        self.mapping = parameters.mapping() if parameters.valid else EMPTY
        self.exists = parameters.valid and self.mapping.length > 0
        self.synchronous = parameters.transmission_type <= HIGHEST_SYNC_TYPE
        self._unpack = self.mapping.layout.unpack_from
        self._deadline_after_ns = parameters.event_timer_ns
        self._limits = [self.od.limits(entry) for entry in self.mapping.entries]
        self._bounded = any(entry.low is not None or entry.high is not None for entry in self.mapping.entries)
        effects = [(self.od.effect_of(entry.index), entry.sub) for entry in self.mapping.entries]
        self._effects: list[tuple[Effect, int, int]] = [
            (effect, sub, slot)
            for (effect, sub), slot in zip(effects, self.mapping.slots, strict=True)
            if effect is not None
        ]

    def restart(self) -> None:
        """Forget what was received: the parameters changed, or the node entered or left OPERATIONAL."""
        self._buffer: bytes | None = None
        self.deadline_ns = NEVER
        for code in (PDO_LENGTH, PDO_LENGTH_EXCEEDED, RPDO_TIMEOUT):
            self.emergency.clear(code, self.number)
        self._troubled = False

    def receive(self, frame: bytes) -> None:
        """A frame with this PDO's identifier."""
        if not self.nmt.exchanges:
            return
        length = frame[LENGTH_OFFSET]
        if length != self.mapping.length or self._troubled:
            self._supervise_length(length)
            if length < self.mapping.length:
                return
        if self._deadline_after_ns:
            self.deadline_ns = self.bus.now_ns + self._deadline_after_ns
        if not self.synchronous:
            self.apply(frame)
        elif self.sync.in_window():
            self._buffer = frame
        else:
            self.od.put(self._statistics, 4, self.od.number(self._statistics, 4) + 1 & 0xFFFFFFFF)

    def _supervise_length(self, length: int) -> None:
        self._troubled = True
        if length < self.mapping.length:
            self.emergency.raise_error(PDO_LENGTH, self.number)
            return
        self.emergency.clear(PDO_LENGTH, self.number)
        self.emergency.clear(RPDO_TIMEOUT, self.number)
        if length > self.mapping.length:
            self.emergency.raise_error(PDO_LENGTH_EXCEEDED, self.number)
            return
        self.emergency.clear(PDO_LENGTH_EXCEEDED, self.number)
        self._troubled = False

    def on_sync(self) -> None:
        """Apply what waits for this SYNC."""
        if self._buffer is not None:
            frame, self._buffer = self._buffer, None
            self.apply(frame)

    def apply(self, frame: bytes) -> None:
        """Write the data into the dictionary and let the device act on it."""
        data = self._unpack(frame, DATA_OFFSET)
        values = self.od.values
        if self._bounded:
            self._apply_within_limits(data)
        else:
            for slot, value in zip(self.mapping.slots, data, strict=True):
                values[slot] = value
        values[self._applied_slot] = values[self._applied_slot] + 1 & 0xFFFFFFFF
        for effect, sub, slot in self._effects:
            effect(sub, values[slot])

    def _apply_within_limits(self, data: tuple[int, ...]) -> None:
        for (lowest, highest), slot, value in zip(self._limits, self.mapping.slots, data, strict=True):
            if lowest <= value <= highest:
                self.od.values[slot] = value

    def poll(self) -> None:
        """The deadline passed without a reception."""
        self.deadline_ns = NEVER
        self._troubled = True
        self.emergency.raise_error(RPDO_TIMEOUT, self.number)
        self._on_timeout()

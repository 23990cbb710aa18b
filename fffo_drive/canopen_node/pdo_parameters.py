"""PDO communication and mapping parameters (0x1400, 0x1600, 0x1800, 0x1A00 on) and the rules for changes.

CiA 301, 7.5.2.35 to 7.5.2.38: a COB-ID changes only while the PDO does not exist (bit 31); a mapping changes
in the order disable, sub 0 = 0, entries, sub 0 = n, enable.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NamedTuple

from ..can.frame import STANDARD_MASK
from .abort import Abort, SdoAbortError
from .bus import NS_PER_100_US, NS_PER_MS
from .cob_id import INVALID, NO_RTR, check_can_id, is_restricted
from .dictionary import (
    MAPPABLE_IN_RPDO,
    MAPPABLE_IN_TPDO,
    STRUCT_CODES,
    WRITABLE,
    DataType,
    Entry,
    ObjectDictionary,
)

COB_ID, TYPE, INHIBIT_TIME, EVENT_TIMER, SYNC_START = 1, 2, 3, 5, 6
HIGHEST_SYNC_TYPE = 240
EVENT_TYPES = (254, 255)
PDO_BITS = 64

# Dummy entries (CiA 301, 7.4.7.3) fill gaps in an RPDO: a data type in place of an object
DUMMIES = {data_type: 8 * struct.calcsize(STRUCT_CODES[DataType(data_type)]) for data_type in range(0x02, 0x08)}


class Mapping(NamedTuple):
    """What a PDO carries: the layout of its data, and the slots of the objects in it (dummies left out)."""

    layout: struct.Struct
    entries: tuple[Entry, ...]
    slots: tuple[int, ...]

    @property
    def length(self) -> int:
        """Data bytes."""
        return self.layout.size


EMPTY = Mapping(struct.Struct("<"), (), ())


class PdoParameters:
    """The parameters of one PDO, guarded; `on_change()` is called when any of them was written."""

    def __init__(
        self,
        od: ObjectDictionary,
        number: int,
        receives: bool,
        on_change: Callable[[], None],
        rtr_required: bool = False,
    ) -> None:
        """`rtr_required`: bit 30 of a TPDO's COB-ID must be 1, as for devices that answer no remote frames."""
        self.od = od
        self.receives = receives
        self._rtr_required = rtr_required
        self.communication = (0x1400 if receives else 0x1800) + number
        self.mapping_index = self.communication + 0x200
        od.guard(self.communication, self._check_communication)
        od.guard(self.mapping_index, self._check_mapping)
        od.on_write(self.communication, lambda sub, value: on_change())
        od.on_write(self.mapping_index, lambda sub, value: on_change())
        self._places = len(od.subs(self.mapping_index))
        # with a fixed number of entries they can be written without the sequence above
        self._fixed_count = self._places > 0 and od.find(self.mapping_index, 0).access not in WRITABLE

    @property
    def valid(self) -> bool:
        """The PDO exists: bit 31 of its COB-ID is clear."""
        return not self._cob_id & INVALID and not is_restricted(self.can_id)

    @property
    def _cob_id(self) -> int:
        return self.od.number_or(self.communication, COB_ID, INVALID)

    @property
    def can_id(self) -> int:
        """The 11-bit identifier."""
        return self._cob_id & STANDARD_MASK

    @property
    def transmission_type(self) -> int:
        """0 to 240 with SYNC, 254 and 255 on events."""
        return self.od.number_or(self.communication, TYPE, EVENT_TYPES[1])

    @property
    def inhibit_ns(self) -> int:
        """Shortest time between two transmissions."""
        return self.od.number_or(self.communication, INHIBIT_TIME, 0) * NS_PER_100_US

    @property
    def event_timer_ns(self) -> int:
        """TPDO: longest time between two transmissions. RPDO: deadline of reception. 0: none."""
        return self.od.number_or(self.communication, EVENT_TIMER, 0) * NS_PER_MS

    @property
    def sync_start(self) -> int:
        """SYNC counter value with which a TPDO's count begins; 0: any."""
        return self.od.number_or(self.communication, SYNC_START, 0)

    def mapping(self) -> Mapping:
        """The mapping in force; empty while sub 0 is 0.

        A default that maps an object which the drive's file lacks is a gap: zeros sent, or data ignored.
        """
        count = min(self.od.number_or(self.mapping_index, 0, 0), self._places)
        try:
            return self._parse(count, strict=False) if count else EMPTY
        except SdoAbortError:  # a default that is no mapping
            return EMPTY

    def _check_communication(self, sub: int, value: int) -> None:
        if sub == COB_ID:
            self._check_cob_id(value)
        elif sub == TYPE and HIGHEST_SYNC_TYPE < value < EVENT_TYPES[0]:
            raise SdoAbortError(Abort.INVALID_VALUE)
        elif sub in (INHIBIT_TIME, SYNC_START) and self.valid:
            raise SdoAbortError(Abort.UNSUPPORTED_ACCESS)

    def _check_cob_id(self, value: int) -> None:
        check_can_id(value & ~(INVALID | (0 if self.receives else NO_RTR)))  # reserved in an RPDO
        if not self.receives and self._rtr_required and not value & NO_RTR:
            raise SdoAbortError(Abort.INVALID_VALUE)  # answering remote frames is not supported
        stays_valid = self.valid and not value & INVALID
        if stays_valid and value & STANDARD_MASK != self.can_id:
            raise SdoAbortError(Abort.INVALID_VALUE)

    def _check_mapping(self, sub: int, value: int) -> None:
        if self.valid:
            raise SdoAbortError(Abort.UNSUPPORTED_ACCESS)
        if sub == 0:
            if value > self._places:
                raise SdoAbortError(Abort.PDO_TOO_LONG)
            if value:
                self._parse(value, strict=True)
            return
        if self.od.number_or(self.mapping_index, 0, 0) and not self._fixed_count:
            raise SdoAbortError(Abort.UNSUPPORTED_ACCESS)
        if value:  # 0 empties an entry that is not used
            self._resolve(value)

    def _parse(self, count: int, strict: bool) -> Mapping:
        code, bits = "<", 0
        entries: list[Entry] = []
        for sub in range(1, count + 1):
            raw = self.od.number_or(self.mapping_index, sub, 0)
            entry = self._resolve(raw) if strict else self._found(raw)
            bits += raw & 0xFF
            if entry is None:
                code += f"{(raw & 0xFF) // 8}x"
            else:
                entries.append(entry)
                code += self.od.struct_code(entry)
        if bits > PDO_BITS:
            raise SdoAbortError(Abort.PDO_TOO_LONG)
        slots = tuple(self.od.slots[entry.multiplexer] for entry in entries)
        return Mapping(struct.Struct(code), tuple(entries), slots)

    def _found(self, raw: int) -> Entry | None:
        """As `_resolve`; None also for what the drive does not have."""
        try:
            return self._resolve(raw)
        except SdoAbortError:
            return None

    def _resolve(self, raw: int) -> Entry | None:
        """The object that a mapping entry names; None for a dummy. Raises SdoAbortError."""
        index, sub, bits = raw >> 16, raw >> 8 & 0xFF, raw & 0xFF
        if self.receives and sub == 0 and DUMMIES.get(index) == bits:
            return None
        entry = self.od.find(index, sub)
        direction = MAPPABLE_IN_RPDO if self.receives else MAPPABLE_IN_TPDO
        carried = entry.data_type in STRUCT_CODES and entry.size * 8 == bits
        if not self.od.mappable(entry) or entry.access not in direction or not carried:
            raise SdoAbortError(Abort.NOT_MAPPABLE)
        return entry

"""The object dictionary as a store: typed values in slots, checked access from the network.

An `Entry` is one sub-index as CiA 306 describes it; the whole device is a flat tuple of them (`objects.py`).
Values are in one list, so that a PDO picks its data with a prepared `itemgetter` and no look-up. After the objects of
the device come cells that neither SDO nor PDO reaches, for objects that a service needs and this drive lacks.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

from .abort import Abort, SdoAbortError

WAITS_FOR_MASTER = 1 << 2  # of 0x1F80 (CiA 302-2): clear in a node that starts itself
Value = int | bytes


class DataType(IntEnum):
    """CiA 301 data type indices."""

    BOOLEAN = 0x0001
    INTEGER8 = 0x0002
    INTEGER16 = 0x0003
    INTEGER32 = 0x0004
    UNSIGNED8 = 0x0005
    UNSIGNED16 = 0x0006
    UNSIGNED32 = 0x0007
    REAL32 = 0x0008
    VISIBLE_STRING = 0x0009
    OCTET_STRING = 0x000A
    UNICODE_STRING = 0x000B
    TIME_OF_DAY = 0x000C
    TIME_DIFFERENCE = 0x000D
    DOMAIN = 0x000F
    INTEGER24 = 0x0010
    REAL64 = 0x0011
    INTEGER40 = 0x0012
    INTEGER48 = 0x0013
    INTEGER56 = 0x0014
    INTEGER64 = 0x0015
    UNSIGNED24 = 0x0016
    UNSIGNED40 = 0x0018
    UNSIGNED48 = 0x0019
    UNSIGNED56 = 0x001A
    UNSIGNED64 = 0x001B


class ObjectKind(IntEnum):
    """CiA 306 object codes."""

    VARIABLE = 7
    ARRAY = 8
    RECORD = 9


# of the types that a PDO can carry; REAL values are kept as the bits that they are on the wire
STRUCT_CODES = {
    DataType.INTEGER8: "b",
    DataType.INTEGER16: "h",
    DataType.INTEGER32: "i",
    DataType.INTEGER64: "q",
    DataType.UNSIGNED8: "B",
    DataType.UNSIGNED16: "H",
    DataType.UNSIGNED32: "I",
    DataType.UNSIGNED64: "Q",
    DataType.REAL32: "I",
    DataType.REAL64: "Q",
    DataType.BOOLEAN: "B",
}
SIGNED_TYPES = frozenset(data_type for data_type in DataType if data_type.name.startswith("INTEGER"))
REAL_TYPES = frozenset({DataType.REAL32, DataType.REAL64})
TEXT_TYPES = frozenset({DataType.VISIBLE_STRING, DataType.UNICODE_STRING})
_SIZES = {  # bytes on the wire; a type that is not here has the length of its value
    **{data_type: struct.calcsize(code) for data_type, code in STRUCT_CODES.items()},
    DataType.INTEGER24: 3,
    DataType.INTEGER40: 5,
    DataType.INTEGER48: 6,
    DataType.INTEGER56: 7,
    DataType.UNSIGNED24: 3,
    DataType.UNSIGNED40: 5,
    DataType.UNSIGNED48: 6,
    DataType.UNSIGNED56: 7,
    DataType.TIME_OF_DAY: 6,
    DataType.TIME_DIFFERENCE: 6,
}
LONGEST_TEXT = 255  # bytes that an object without a declared length takes
_BEYOND_SDO = 0x10000  # added to an index that no SDO may reach


def type_range(data_type: DataType) -> tuple[int, int]:
    """Lowest and highest number of a type that has a size."""
    if data_type is DataType.BOOLEAN:
        return 0, 1
    bits = 8 * _SIZES[data_type]
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if data_type in SIGNED_TYPES else (0, (1 << bits) - 1)


READABLE = frozenset({"ro", "rw", "rwr", "rww", "const"})
WRITABLE = frozenset({"wo", "rw", "rwr", "rww"})
MAPPABLE_IN_TPDO = frozenset({"ro", "rw", "rwr", "const"})
MAPPABLE_IN_RPDO = frozenset({"wo", "rw", "rww"})


@dataclass(frozen=True, slots=True)
class Entry:
    """One sub-index. `low` and `high` bound what the network may write (None: the range of the type).

    `relative`: the default is an offset to which the node-ID is added ($NODEID in the EDS). `default` None: unknown,
    such as that of a measured value. `value`: what a DCF sets, in place of the default (None: nothing), and
    `value_relative` of it. For types without a size, `high` is the greatest length in bytes.
    """

    index: int
    sub: int
    name: str
    data_type: DataType
    access: str
    default: Value | None = 0
    low: int | None = None
    high: int | None = None
    mappable: bool = False
    relative: bool = False
    value: Value | None = None
    value_relative: bool = False

    @property
    def size(self) -> int:
        """Bytes on the wire; 0 for strings, whose length is that of the value."""
        return _SIZES.get(self.data_type, 0)

    @property
    def multiplexer(self) -> int:
        """Index and sub-index in one number."""
        return multiplexer(self.index, self.sub)


def multiplexer(index: int, sub: int) -> int:
    """Index and sub-index in one number, as an SDO carries them."""
    return index << 8 | sub


Guard = Callable[[int, int], None]
Effect = Callable[[int, int], None]
Reader = Callable[[int], Value]


class ObjectDictionary:
    """Values of the entries, with the checks of CiA 301 on access from the network.

    Services register per index: a guard (sub, value) raises `SdoAbortError` to refuse a value, an effect (sub, value)
    acts after the value was stored by SDO or RPDO, a reader (sub) supplies the value when it is read.
    """

    def __init__(
        self,
        entries: Iterable[Entry],
        node_id: int,
        defaults: Mapping[int, Value] | None = None,
        absent: Iterable[Entry] = (),
        own: range | None = None,
        codes: Mapping[int, str] | None = None,
    ) -> None:
        """`defaults`: by `multiplexer(index, sub)`, for entries without one; 0 for all others.

        `absent`: entries that the services need, used where the device lacks them. Indices in `own` belong to this
        program alone: their entries are separate from the device's even at the same index (`place`). `codes`: struct
        codes of objects that the device writes itself, whatever sign the file gives them.
        """
        self.node_id = node_id
        self.entries: list[Entry] = list(entries)
        self._public = {entry.multiplexer: entry for entry in self.entries}
        self._own = own
        self._codes = codes or {}
        self._declares_mapping = any(entry.mappable for entry in self.entries)
        self.cells = [*self.entries]  # with those that cannot be reached
        for entry in absent:
            placed = replace(entry, index=self.place(entry.index))
            if placed.multiplexer not in self._public:
                self.cells.append(placed)
        self._defaults = defaults or {}
        self.slots: dict[int, int] = {cell.multiplexer: slot for slot, cell in enumerate(self.cells)}
        self.values: list[Any] = [self.power_on_value(cell) for cell in self.cells]  # of Value; not checked for struct
        self._indices = {entry.index for entry in self.entries}
        self._guards: dict[int, Guard] = {}
        self._effects: dict[int, Effect] = {}
        self._readers: dict[int, Reader] = {}

    @property
    def foreign(self) -> bool:
        """The dictionary is that of another drive."""
        return self._own is not None

    def place(self, index: int) -> int:
        """Index of an object of this program alone: its own, or one that no SDO reaches."""
        return index + _BEYOND_SDO if self._own is not None and index in self._own else index

    def power_on_value(self, entry: Entry) -> Value:
        """What a DCF sets, or the default of an entry, with the node-ID added where the file says $NODEID."""
        value, relative = entry.value, entry.value_relative
        if value is None:
            value, relative = entry.default, entry.relative
        if value is None:
            value = self._device_default(entry)
        if relative and isinstance(value, int):
            lowest, highest = type_range(entry.data_type)
            return min(max(value + self.node_id, lowest), highest)
        return value

    def _device_default(self, entry: Entry) -> Value:
        """The default that the device gives this entry, if it is valid for it."""
        known = self._defaults.get(entry.multiplexer)
        if not entry.size:
            return known if isinstance(known, bytes) else b""
        lowest, highest = self.limits(entry)
        if isinstance(known, int) and lowest <= known <= highest:
            return known
        return min(max(0, lowest), highest)

    def guard(self, index: int, guard: Guard) -> None:
        """Ask `guard` before a write from the network to `index`."""
        self._guards[index] = guard

    def on_write(self, index: int, effect: Effect) -> None:
        """Call `effect` after a write from the network to `index`."""
        self._effects[index] = effect

    def on_read(self, index: int, reader: Reader) -> None:
        """Let `reader` supply the values of `index`."""
        self._readers[index] = reader

    def effect_of(self, index: int) -> Effect | None:
        """What `on_write` registered (for RPDOs, which bypass the SDO checks)."""
        return self._effects.get(index)

    def __contains__(self, index: int) -> bool:
        return index in self._indices

    def has(self, index: int, sub: int = 0) -> bool:
        """The device has this sub-index."""
        return multiplexer(index, sub) in self._public

    def subs(self, index: int) -> list[int]:
        """Sub-indices from 1 on that the device has of an object."""
        return sorted(entry.sub for entry in self.entries if entry.index == index and entry.sub)

    def find(self, index: int, sub: int) -> Entry:
        """The entry of a sub-index. Raises SdoAbortError (NO_OBJECT, NO_SUBINDEX)."""
        entry = self._public.get(multiplexer(index, sub))
        if entry is None:
            raise SdoAbortError(Abort.NO_SUBINDEX if index in self._indices else Abort.NO_OBJECT)
        return entry

    def number(self, index: int, sub: int = 0) -> int:
        """The stored integer, without checks: for the device itself."""
        value = self.values[self.slots[multiplexer(index, sub)]]
        assert isinstance(value, int)
        return value

    def number_or(self, index: int, sub: int, otherwise: int) -> int:
        """The stored integer, `otherwise` where there is no such cell."""
        slot = self.slots.get(multiplexer(index, sub))
        return otherwise if slot is None else int(self.values[slot])

    def put(self, index: int, sub: int, value: Value) -> None:
        """Store without checks: for the device itself."""
        self.values[self.slots[multiplexer(index, sub)]] = value

    def upload(self, index: int, sub: int) -> bytes:
        """A value as the network reads it. Raises SdoAbortError."""
        entry = self.find(index, sub)
        if entry.access not in READABLE:
            raise SdoAbortError(Abort.WRITE_ONLY)
        reader = self._readers.get(index)
        value = reader(sub) if reader else self.values[self.slots[multiplexer(index, sub)]]
        if isinstance(value, bytes):
            return value
        return (value & (1 << 8 * entry.size) - 1).to_bytes(entry.size, "little")

    def check_download(self, index: int, sub: int, length: int | None) -> Entry:
        """What can be refused before the data is here: existence, access, a length. Raises SdoAbortError."""
        entry = self.find(index, sub)
        if entry.access not in WRITABLE:
            raise SdoAbortError(Abort.READ_ONLY)
        if length is not None:
            longest = longest_of(entry)
            if length > longest:
                raise SdoAbortError(Abort.TOO_LONG)
            if entry.size and length < entry.size:
                raise SdoAbortError(Abort.TOO_SHORT)
        return entry

    def download(self, index: int, sub: int, data: bytes) -> None:
        """Write a value as the network does. Raises SdoAbortError; nothing is stored then."""
        entry = self.check_download(index, sub, len(data))
        slot = self.slots[multiplexer(index, sub)]
        if not entry.size:
            self.values[slot] = data
            return
        value = int.from_bytes(data, "little", signed=entry.data_type in SIGNED_TYPES)
        if entry.high is not None and value > entry.high:
            raise SdoAbortError(Abort.VALUE_TOO_HIGH)
        if entry.low is not None and value < entry.low:
            raise SdoAbortError(Abort.VALUE_TOO_LOW)
        guard = self._guards.get(index)
        if guard:
            guard(sub, value)
        self.values[slot] = value
        effect = self._effects.get(index)
        if effect:
            effect(sub, value)

    def mappable(self, entry: Entry) -> bool:
        """It may be mapped into a PDO. If the file marks no object as mappable, every object is."""
        return entry.mappable or not self._declares_mapping

    def struct_code(self, entry: Entry) -> str:
        """Struct code in a PDO; what the device writes itself has the device's signedness."""
        return self._codes.get(entry.multiplexer) or STRUCT_CODES[entry.data_type]

    def limits(self, entry: Entry) -> tuple[int, int]:
        """Lowest and highest value that the network may write to a numeric entry."""
        lowest, highest = type_range(entry.data_type)
        return (lowest if entry.low is None else entry.low, highest if entry.high is None else entry.high)


def longest_of(entry: Entry) -> int:
    """The most bytes that a write to this entry may have."""
    return entry.size or (LONGEST_TEXT if entry.high is None else entry.high)

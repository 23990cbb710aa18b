"""The object dictionary as a store: typed values in slots, checked access from the network.

An `Entry` is one sub-index as CiA 306 describes it; the whole device is a flat tuple of them (`objects.py`).
Values lie in one list, so that a PDO picks its data with a prepared `itemgetter` and no look-up.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

from .abort import Abort, SdoAbortError

Value = int | bytes


class DataType(IntEnum):
    """CiA 301 data type indices of the types in use."""

    INTEGER8 = 0x0002
    INTEGER16 = 0x0003
    INTEGER32 = 0x0004
    UNSIGNED8 = 0x0005
    UNSIGNED16 = 0x0006
    UNSIGNED32 = 0x0007
    VISIBLE_STRING = 0x0009


class ObjectKind(IntEnum):
    """CiA 306 object codes."""

    VARIABLE = 7
    ARRAY = 8
    RECORD = 9


STRUCT_CODES = {
    DataType.INTEGER8: "b",
    DataType.INTEGER16: "h",
    DataType.INTEGER32: "i",
    DataType.UNSIGNED8: "B",
    DataType.UNSIGNED16: "H",
    DataType.UNSIGNED32: "I",
}
_CODECS = {data_type: struct.Struct("<" + code) for data_type, code in STRUCT_CODES.items()}
_RANGES = {
    data_type: (-(1 << (8 * codec.size - 1)), (1 << (8 * codec.size - 1)) - 1)
    if codec.format[-1].islower()
    else (0, (1 << (8 * codec.size)) - 1)
    for data_type, codec in _CODECS.items()
}

READABLE = frozenset({"ro", "rw", "rwr", "rww", "const"})
WRITABLE = frozenset({"wo", "rw", "rwr", "rww"})
MAPPABLE_IN_TPDO = frozenset({"ro", "rw", "rwr"})
MAPPABLE_IN_RPDO = frozenset({"wo", "rw", "rww"})


@dataclass(frozen=True, slots=True)
class Entry:
    """One sub-index. `low` and `high` bound what the network may write (None: the range of the type).

    `relative`: the default is an offset to which the node-ID is added ($NODEID in the EDS). For
    VISIBLE_STRING, `high` is the greatest length in bytes.
    """

    index: int
    sub: int
    name: str
    data_type: DataType
    access: str
    default: Value = 0
    low: int | None = None
    high: int | None = None
    mappable: bool = False
    relative: bool = False

    @property
    def size(self) -> int:
        """Bytes on the wire; 0 for strings, whose length is that of the value."""
        codec = _CODECS.get(self.data_type)
        return codec.size if codec else 0


def multiplexer(index: int, sub: int) -> int:
    """Index and sub-index in one number, as an SDO carries them."""
    return index << 8 | sub


Guard = Callable[[int, int], None]
Effect = Callable[[int, int], None]
Reader = Callable[[int], Value]


class ObjectDictionary:
    """Values of the entries, with the checks of CiA 301 on access from the network.

    Services hang themselves in per index: a guard (sub, value) raises `SdoAbortError` to refuse a value, an
    effect (sub, value) acts after the value was stored by SDO or RPDO, a reader (sub) supplies it at the time
    of reading.
    """

    def __init__(self, entries: Iterable[Entry], node_id: int, overrides: Mapping[int, Value] | None = None) -> None:
        """`overrides`: defaults of this device by `multiplexer(index, sub)`. ValueError on an unknown one."""
        self.node_id = node_id
        self.entries: list[Entry] = []
        self.slots: dict[int, int] = {}
        self.values: list[Any] = []  # of Value; not checked on the way to struct
        self._indices: set[int] = set()
        pending = dict(overrides or {})
        for entry in entries:
            default = pending.pop(multiplexer(entry.index, entry.sub), entry.default)
            self.slots[multiplexer(entry.index, entry.sub)] = len(self.entries)
            self.entries.append(replace(entry, default=default))
            self._indices.add(entry.index)
        if pending:
            raise ValueError(f"no object {min(pending) >> 8:04X}:{min(pending) & 0xFF:02X} in the object dictionary")
        self.values = [self.power_on_value(entry) for entry in self.entries]
        self._guards: dict[int, Guard] = {}
        self._effects: dict[int, Effect] = {}
        self._readers: dict[int, Reader] = {}

    def power_on_value(self, entry: Entry) -> Value:
        """The default of an entry, with the node-ID added where the EDS says $NODEID."""
        if entry.relative and isinstance(entry.default, int):
            return entry.default + self.node_id
        return entry.default

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

    def find(self, index: int, sub: int) -> Entry:
        """The entry of a sub-index. Raises SdoAbortError (NO_OBJECT, NO_SUBINDEX)."""
        slot = self.slots.get(multiplexer(index, sub))
        if slot is None:
            raise SdoAbortError(Abort.NO_SUBINDEX if index in self._indices else Abort.NO_OBJECT)
        return self.entries[slot]

    def number(self, index: int, sub: int = 0) -> int:
        """The stored integer, without checks: for the device itself."""
        value = self.values[self.slots[multiplexer(index, sub)]]
        assert isinstance(value, int)
        return value

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
        return value if isinstance(value, bytes) else _CODECS[entry.data_type].pack(value)

    def check_download(self, index: int, sub: int, length: int | None) -> Entry:
        """What can be refused before the data is here: existence, access, a length. Raises SdoAbortError."""
        entry = self.find(index, sub)
        if entry.access not in WRITABLE:
            raise SdoAbortError(Abort.READ_ONLY)
        if length is not None:
            longest = entry.size or entry.high or 0
            if length > longest:
                raise SdoAbortError(Abort.TOO_LONG)
            if entry.size and length < entry.size:
                raise SdoAbortError(Abort.TOO_SHORT)
        return entry

    def download(self, index: int, sub: int, data: bytes) -> None:
        """Write a value as the network does. Raises SdoAbortError; nothing is stored then."""
        entry = self.check_download(index, sub, len(data))
        slot = self.slots[multiplexer(index, sub)]
        if entry.data_type is DataType.VISIBLE_STRING:
            self.values[slot] = data
            return
        value: int = _CODECS[entry.data_type].unpack(data)[0]
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

    def limits(self, entry: Entry) -> tuple[int, int]:
        """Lowest and highest value that the network may write to a numeric entry."""
        lowest, highest = _RANGES[entry.data_type]
        return (lowest if entry.low is None else entry.low, highest if entry.high is None else entry.high)

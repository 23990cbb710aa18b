"""Store and restore parameters (0x1010, 0x1011) and what an NMT reset makes of the values.

"save" keeps the present values of a group; "load" makes the defaults valid at the next reset. The memory
lasts as long as the process. 0x1010 answers 1 (saves on command), 0x1011 answers 1 (restores), or what the file of a
drive says.
"""

from __future__ import annotations

import functools

from .abort import Abort, SdoAbortError
from .dictionary import WRITABLE, ObjectDictionary, Value, multiplexer

STORE = 0x1010
RESTORE = 0x1011
SAVE_SIGNATURE = int.from_bytes(b"save", "little")
LOAD_SIGNATURE = int.from_bytes(b"load", "little")

COMMUNICATION = range(0x1000, 0x2000)
MANUFACTURER = range(0x2000, 0x6000)  # what the other sub-indices store is manufacturer-specific
# sub-index of 0x1010 and 0x1011: the objects that belong to it
GROUPS = {
    1: range(0x1000, 0x10000),
    2: COMMUNICATION,
    3: range(0x6000, 0xA000),
    4: MANUFACTURER,
}
TRANSIENT = frozenset({0x1003, STORE, RESTORE})  # writable, but no parameters


class Storage:
    """The non-volatile memory of the device. `commands`: objects of its own that are no parameters."""

    def __init__(self, od: ObjectDictionary, commands: frozenset[int] = frozenset()) -> None:
        self.od = od
        self._transient = TRANSIENT | commands
        self._saved: dict[int, Value] = {}
        od.guard(STORE, lambda sub, value: _check_signature(value, SAVE_SIGNATURE))
        od.guard(RESTORE, lambda sub, value: _check_signature(value, LOAD_SIGNATURE))
        od.on_write(STORE, lambda sub, value: self._save(GROUPS.get(sub, MANUFACTURER)))
        od.on_write(RESTORE, lambda sub, value: self._forget(GROUPS.get(sub, MANUFACTURER)))
        for index in (STORE, RESTORE):
            od.on_read(index, functools.partial(self._capability, index))

    def reset(self, whole_node: bool) -> None:
        """Power-on values: the saved ones, or the defaults. A communication reset leaves the rest alone."""
        for slot, entry in enumerate(self.od.cells):
            relative = entry.relative or entry.value_relative  # the node-ID may be another one now
            changeable = entry.access in WRITABLE or relative
            if changeable and (whole_node or entry.index in COMMUNICATION):
                saved = self._saved.get(multiplexer(entry.index, entry.sub))
                self.od.values[slot] = self.od.power_on_value(entry) if saved is None else saved

    def _save(self, group: range) -> None:
        for slot, entry in enumerate(self.od.entries):
            if entry.index in group and entry.access in WRITABLE and entry.index not in self._transient:
                self._saved[multiplexer(entry.index, entry.sub)] = self.od.values[slot]

    def _forget(self, group: range) -> None:
        for wanted in [k for k in self._saved if k >> 8 in group]:
            del self._saved[wanted]

    def _capability(self, index: int, sub: int) -> Value:
        return self.od.power_on_value(self.od.find(index, sub))


def _check_signature(value: int, signature: int) -> None:
    if value != signature:
        raise SdoAbortError(Abort.NOT_STORED)

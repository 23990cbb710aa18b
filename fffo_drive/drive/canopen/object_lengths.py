"""Bytes of an object, for a drive whose expedited answer does not state its size (CiA 301 7.2.4.3.6, s = 0)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from .object_map import COMMAND_OBJECTS, CURRENT, FEEDBACK_OBJECTS, MODE_DISPLAY, TORQUE, MappedObject

SDO_ABORT = 0x80  # command byte; the only request that is not answered
SDO_DOWNLOADED = 0x60  # command byte of the answer to a download
LengthOf = Callable[[int, int], int | None]  # by index and sub-index; None: not known, all bytes count

_PDO_COMMUNICATION = {0: 1, 2: 1, 3: 2, 5: 2, 6: 1}  # the COB-ID has four
_RECORDS = {
    0x1003, 0x1010, 0x1011, 0x1016, 0x1018, 0x1029, 0x1200, 0x608F, 0x6090, 0x6091, 0x6092, 0x60C2, 0x60FE,
}  # fmt: skip
# shorter than four bytes in CiA 301 and CiA 402-2
_SHORT = {
    **{(index, 0): bits // 8 for index, bits in COMMAND_OBJECTS.items()},
    **{(index, 0): bits // 8 for index, (_, bits, _) in FEEDBACK_OBJECTS.items()},
    **{(index, 0): 1 for index in (*_RECORDS, 0x1001, 0x100D, 0x1019, MODE_DISPLAY, 0x607E)},
    **{(index, 0): 2 for index in (0x100C, 0x1015, 0x1017, 0x6007, 0x603F, *range(0x605A, 0x605F))},
    **{(index, 0): 2 for index in (0x6072, 0x6073, 0x6074, TORQUE, CURRENT, 0x6086)},
    (0x1029, 1): 1, (0x60C2, 1): 1, (0x60C2, 2): 1,
}  # fmt: skip


def standard_length(index: int, sub: int) -> int | None:
    """By CiA 301 and CiA 402-2."""
    if 0x1400 <= index < 0x1C00:
        mapping = bool(index & 0x200)
        return (1 if sub == 0 else None) if mapping else _PDO_COMMUNICATION.get(sub)
    return _SHORT.get((index, sub))


def lengths_of(dictionary: Any, mapped: Iterable[MappedObject] = ()) -> LengthOf:
    """By the PDO mapping, else by the drive's EDS (None: it has none), else by the standard."""
    known = {(item.index, item.sub): item.bits // 8 for item in mapped}

    def length(index: int, sub: int) -> int | None:
        if (index, sub) in known:
            return known[index, sub]
        variable = None if dictionary is None else dictionary.get_variable(index, sub)
        if variable is not None and variable.fixed_size:
            return int(len(variable) // 8)
        return standard_length(index, sub)

    return length

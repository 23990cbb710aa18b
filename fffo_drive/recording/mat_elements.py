"""The elements of a MAT file of version 5 to 7.2, unpacked and checked before scipy believes what they say.

scipy makes room for as many cells as an array says that it has, and unpacks whatever a variable holds: a file of 600
bytes could ask for a gigabyte. Source: MAT-File Format, The MathWorks, chapter 1.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from .errors import RecordingError
from .unpack import Allowance, inflated

HEADER_BYTES = 128
TAG_BYTES = 8
DEEPEST = 32  # of structs and cells in each other
MATRIX, COMPRESSED = 14, 15  # kinds of elements
HOLDERS = (1, 2, 3)  # classes of arrays that hold arrays: cell, struct, object
ZLIB_WINDOW_BITS = 15


class MatError(Exception):
    """What an element says does not fit what is there."""


class _Element(NamedTuple):
    kind: int
    begin: int  # of its content
    end: int
    after: int  # where the next one begins


def unpacked(path: Path) -> bytes:
    """The file with no compressed variable in it; one of version 4, which has none, as it is. Raises RecordingError."""
    data = path.read_bytes()
    byte_order = {b"IM": "<", b"MI": ">"}.get(data[HEADER_BYTES - 2 : HEADER_BYTES])
    if byte_order is None or 0 in data[:4]:  # version 4 begins with a small number
        return data
    allowance = Allowance(path, len(data))
    parts = [data[:HEADER_BYTES]]
    try:
        for element in _elements(data, HEADER_BYTES, len(data), byte_order, 1):
            if element.kind == COMPRESSED:
                packed = memoryview(data)[element.begin : element.end]
                parts.append(inflated(packed, ZLIB_WINDOW_BITS, allowance))
            else:
                parts.append(data[element.begin - TAG_BYTES : element.after])
        flat = b"".join(parts)
        _check(flat, HEADER_BYTES, len(flat), byte_order, 0)
    except (MatError, EOFError, zlib.error, struct.error):
        raise RecordingError(f"{path}: not a whole MAT file: a variable is cut off or damaged") from None
    return flat


def _elements(data: bytes, begin: int, end: int, byte_order: str, padded_to: int) -> Iterator[_Element]:
    """The elements between two places. Raises MatError for one that is longer than its room."""
    while begin < end:
        kind, size = struct.unpack_from(byte_order + "II", data, begin)
        if kind >> 16:  # a small one: its content stands in its tag
            element = _Element(kind & 0xFFFF, begin + 4, begin + 4 + (kind >> 16), begin + TAG_BYTES)
        else:
            first = begin + TAG_BYTES
            element = _Element(kind, first, first + size, first + size + -size % padded_to)
        if element.end > end:
            raise MatError
        yield element
        begin = element.after


def _check(data: bytes, begin: int, end: int, byte_order: str, depth: int) -> None:
    """Every array has room for as many arrays as it says that it holds. Raises MatError."""
    if depth > DEEPEST:
        raise MatError
    for element in _elements(data, begin, end, byte_order, 8 if depth else 1):
        if element.kind != MATRIX or element.begin == element.end:
            continue
        inner = _elements(data, element.begin, element.end, byte_order, 8)
        flags = next(inner)
        array_class = struct.unpack_from(byte_order + "I", data, flags.begin)[0] & 0xFF
        if array_class not in HOLDERS:
            continue
        shape = next(inner)
        count = math.prod(struct.unpack_from(f"{byte_order}{(shape.end - shape.begin) // 4}i", data, shape.begin))
        if not 0 <= count * TAG_BYTES <= element.end - shape.after:
            raise MatError
        _check(data, shape.after, element.end, byte_order, depth + 1)

"""The elements of a MAT file of version 5 to 7.2, unpacked and checked before scipy reads them.

scipy allocates as many cells as an array claims to have, and unpacks any variable: a file of 600 bytes could request a
gigabyte, and a number of an unknown type ends the process (SIGSEGV). Source: MAT-File Format, The MathWorks, chapter 1.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from .errors import RecordingError
from .files import regular
from .unpack import Allowance, inflated

HEADER_BYTES = 128
TAG_BYTES = 8
DEEPEST = 32  # of structs and cells in each other
MATRIX, COMPRESSED = 14, 15  # kinds of elements
NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})
TEXTS = frozenset({16, 17, 18})
INSIDE = NUMBERS | {MATRIX}  # of an array that holds arrays
FLAGS, FLAGS_BYTES, SHAPE = 6, 8, 5  # what an array begins with
HOLDERS = (1, 2, 3, 16)  # classes of arrays that hold arrays: cell, struct, object, function
TEXT, SPARSE, OPAQUE = 4, 5, 17
COMPLEX = 0x0800  # of the flags
CLASSES = range(1, 17)
ZLIB_WINDOW_BITS = 15


class MatError(Exception):
    """The header of an element contradicts its content."""


class _Element(NamedTuple):
    kind: int
    begin: int  # of its content
    end: int
    after: int  # where the next one begins


def unpacked(path: Path) -> bytes:
    """The file with no compressed variable in it; one of version 4, which has none, as it is. Raises RecordingError."""
    data = regular(path).read_bytes()
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
    """The elements between two positions. Raises MatError for an element that exceeds its space."""
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
    """Check that every array is of a known type and has space for its declared content. Raises MatError."""
    if depth > DEEPEST:
        raise MatError
    for element in _elements(data, begin, end, byte_order, 8 if depth else 1):
        if depth and element.kind not in INSIDE:
            raise MatError
        if element.kind == MATRIX and element.begin < element.end:
            _check_array(data, element, byte_order, depth)


def _check_array(data: bytes, array: _Element, byte_order: str, depth: int) -> None:
    parts = _elements(data, array.begin, array.end, byte_order, 8)
    flags = next(parts)
    if flags.kind != FLAGS or flags.end - flags.begin != FLAGS_BYTES:
        raise MatError
    (word,) = struct.unpack_from(byte_order + "I", data, flags.begin)
    array_class = word & 0xFF
    if array_class == OPAQUE:  # what MATLAB alone can read, without a shape
        return
    shape = next(parts, None)
    if shape is None or shape.kind != SHAPE or array_class not in CLASSES:
        raise MatError
    count = math.prod(struct.unpack_from(f"{byte_order}{(shape.end - shape.begin) // 4}i", data, shape.begin))
    if array_class in HOLDERS:
        if not 0 <= count * TAG_BYTES <= array.end - shape.after:
            raise MatError
        _check(data, shape.after, array.end, byte_order, depth + 1)
        return
    kinds = [part.kind for part in parts]
    needed = len(("name", "row", "column", "real") if array_class == SPARSE else ("name", "real")) + bool(
        word & COMPLEX
    )
    if len(kinds) < needed or not set(kinds) <= (NUMBERS | TEXTS if array_class == TEXT else NUMBERS):
        raise MatError

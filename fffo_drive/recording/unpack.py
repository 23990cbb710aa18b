"""How much a compressed file may unpack to: a file of 30 kB that holds a gigabyte of zeros must not fill the memory.

Measured: rows of a run unpack to 2 to 6 times their size, rows in which nothing but tick and time ever changes to 24
times, such a MAT file with 12 channels to 42 times, a CSV file with 60 channels to 172 times. Zeros alone unpack to
1000 times (deflate) or 30,000 times (zstd) their size.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path

from .errors import RecordingError

LARGEST_RATIO = 250  # of what a file unpacks to and its own size
FREE_BYTES = 16 * 1024 * 1024  # whatever the ratio
BLOCK_BYTES = 1 << 20
GZIP = b"\x1f\x8b"
GZIP_WINDOW_BITS = 31  # of zlib: the largest window, with the head of gzip


class Allowance:
    """What one file may unpack to."""

    def __init__(self, path: Path | str, size_bytes: int, largest_bytes: int | None = None) -> None:
        """`size_bytes`: of the file; `largest_bytes`: whatever its size."""
        self._path = path
        self._whole = FREE_BYTES + LARGEST_RATIO * size_bytes
        self._largest = largest_bytes if largest_bytes is not None and largest_bytes < self._whole else None
        self._left = self._whole if self._largest is None else self._largest

    def take(self, size_bytes: int) -> None:
        """Count bytes unpacked from the file. Raises RecordingError if there are too many."""
        self._left -= size_bytes
        if self._left < 0 and self._largest is not None:
            raise RecordingError(f"{self._path}: unpacks to more than {self._largest} bytes: split it")
        if self._left < 0:
            raise RecordingError(
                f"{self._path}: unpacks to more than {self._whole} bytes, {LARGEST_RATIO} times its size: no recording "
                "does; it is damaged, or made to fill the memory"
            )


def gunzipped(path: Path, data: bytes, largest_bytes: int) -> bytes:
    """What a gzip file holds; any other data as they are. Raises RecordingError where it is not whole, or too much."""
    if not data.startswith(GZIP):
        return data
    try:
        return inflated(data, GZIP_WINDOW_BITS, Allowance(path, len(data), largest_bytes))
    except (EOFError, zlib.error) as error:
        raise RecordingError(f"{path}: the compressed file is not whole") from error


def inflated(data: bytes | memoryview, window_bits: int, allowance: Allowance) -> bytes:
    """What a zlib (window_bits 15) or gzip (31) stream holds, or several one after another.

    The size is checked before anything is kept. Raises RecordingError if it is too large, EOFError if it is truncated,
    zlib.error if it is damaged.
    """
    for block in _blocks(data, window_bits):
        allowance.take(len(block))
    return b"".join(_blocks(data, window_bits))


def _blocks(data: bytes | memoryview, window_bits: int) -> Iterator[bytes]:
    rest: bytes | memoryview = data
    while rest:
        stream = zlib.decompressobj(window_bits)
        while not stream.eof:
            block = stream.decompress(rest, BLOCK_BYTES)
            yield block
            rest = stream.unconsumed_tail
            if not rest and not block and not stream.eof:
                raise EOFError
        rest = stream.unused_data.lstrip(b"\0")  # gzip files may be padded

"""The reading end of the ring that the loop writes rows into.

The loop is the only writer and never waits: a reader that is too late loses rows, and has to notice.
`words[0]` (HEAD) counts the rows ever written, released after the row; row r is in slot r mod capacity.
While HEAD is h the writer may be filling the slot of row h, which is that of row h - capacity: the capacity -
1 youngest rows can be read.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from ..jit import njit
from ..jit.atomic import load_acquire

HEAD = 0

Rows = np.ndarray[Any, np.dtype[np.void]]


class ReadableRing(Protocol):
    """Required interface of a ring: `rows` (capacity,), a power of two; `words` (n,) int64, words[0] the head."""

    @property
    def rows(self) -> Rows: ...

    @property
    def words(self) -> np.ndarray[Any, np.dtype[np.int64]]: ...


class Batch(NamedTuple):
    """Rows that came since the last reading, and how many were overwritten before they could be read."""

    rows: Rows
    lost: int


@njit
def _head(words: Any) -> int:
    return load_acquire(words, HEAD)


class RingReader:
    """Follows a ring with a tail of its own. Each row ever written is in one batch or counted as lost."""

    def __init__(self, ring: ReadableRing, newest: int | None = None, first: int | None = None) -> None:
        """Begin with the oldest row, or with so many of the newest (0: with the next that is written), or with row
        `first`, counted from the first ever written.
        """
        capacity = len(ring.rows)
        if capacity < 2 or capacity & (capacity - 1):
            raise ValueError(f"a ring of {capacity} rows: a power of two, at least 2, is needed")
        self._words = ring.words
        self._capacity = capacity
        self._dtype = ring.rows.dtype
        # as plain bytes: NumPy copies structured rows field by field, forty times slower
        self._slots = ring.rows.view(f"V{ring.rows.dtype.itemsize}")
        head = int(_head(self._words))  # compiled here, not beside the running loop
        # rows before this one are read, lost or older than this reader
        self.tail = 0 if newest is None else max(head - newest, 0)
        if first is not None:
            self.tail = first
        self.rows_read = 0
        self.rows_lost = 0

    def read(self) -> Batch:
        """Copy out the available rows. Never waits."""
        head = int(_head(self._words))
        first = max(self.tail, head - self._capacity + 1)
        copied = self._copy(first, head)
        # rows that the writer reached while they were being copied may be torn
        whole = max(first, min(int(_head(self._words)) - self._capacity + 1, head))
        lost = whole - self.tail
        rows = copied[whole - first :]
        self.tail = max(head, self.tail)
        self.rows_read += len(rows)
        self.rows_lost += lost
        return Batch(rows, lost)

    def _copy(self, first: int, head: int) -> Rows:
        out = np.empty(max(head - first, 0), self._slots.dtype)
        begin = first & (self._capacity - 1)
        until_wrap = min(len(out), self._capacity - begin)
        out[:until_wrap] = self._slots[begin : begin + until_wrap]
        out[until_wrap:] = self._slots[: len(out) - until_wrap]
        return out.view(self._dtype)

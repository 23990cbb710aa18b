"""Ring of rows between the loop and the recorder: one writer that never waits, readers that notice an overrun."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..signals import ROW

HEAD = 0  # words[HEAD]: rows ever written, published after the row


class Ring(NamedTuple):
    """`rows` (capacity,) of signals.ROW, capacity a power of two; `words` (1,) int64."""

    rows: np.ndarray[Any, np.dtype[np.void]]
    words: np.ndarray[Any, np.dtype[np.int64]]


def new_ring(at_least: int) -> Ring:
    """An empty ring for at least so many rows; its pages are touched."""
    capacity = 1 << max(4, (at_least - 1).bit_length())
    rows = np.empty(capacity, ROW)
    rows.view(np.uint8)[:] = 0  # touches every page, so that none faults in the loop
    return Ring(rows, np.zeros(1, np.int64))


def copy_row(ring: Ring, number: int) -> np.void:
    """A copy of row `number` (counted from the first ever written), as bytes: NumPy copies a row field by field."""
    rows = ring.rows
    place = number % rows.size
    copied: np.void = rows.view(f"V{rows.dtype.itemsize}")[place : place + 1].copy().view(rows.dtype)[0]
    return copied

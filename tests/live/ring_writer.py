"""Rows as the loop writes them, in a ring that a test holds."""

from __future__ import annotations

from typing import Any

import numpy as np

from fffo_drive.runtime.ring import HEAD, Ring
from fffo_drive.signals import ROW


def rows_of(first_tick: int, count: int, seed: int = 1) -> np.ndarray[Any, np.dtype[np.void]]:
    """Rows with random signals; ticks follow each other."""
    random = np.random.default_rng(seed)
    rows = np.zeros(count, ROW)
    rows["tick"] = np.arange(first_tick, first_tick + count)
    rows["deadline_ns"] = 500_000 * rows["tick"].astype(np.int64)
    rows["lateness_ns"] = random.integers(0, 20_000_000, count)
    for name in ("velocity_rps", "error_rps", "friction_nm"):
        rows[name] = random.normal(size=count)
    rows["true_velocity_rps"] = np.nan
    rows["trip"] = random.integers(0, 3, count)
    return rows


def write(ring: Ring, rows: np.ndarray[Any, np.dtype[np.void]]) -> None:
    """As the loop does: the row, then the head."""
    for row in rows:
        head = int(ring.words[HEAD])
        ring.rows[head % ring.rows.size] = row
        ring.words[HEAD] = head + 1

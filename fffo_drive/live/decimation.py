"""Decimation of rows: minimum, maximum and last value of each signal in bins of equal time, and a lateness
histogram.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..signals import SIGNALS

BINS_HZ = 50.0
# upper ends in microseconds, the last bin is open: few enough to read, fine enough for a 2 kHz loop
LATENESS_EDGES_US = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000)
MINIMUM, MAXIMUM, LAST = 0, 1, 2
TICK = next(i for i, signal in enumerate(SIGNALS) if signal.name == "tick")
_EDGES_NS = np.array(LATENESS_EDGES_US, np.int64) * 1000

Matrix = np.ndarray[Any, np.dtype[np.float64]]
Counts = np.ndarray[Any, np.dtype[np.int64]]


def bin_ticks_of(rate_hz: float) -> int:
    """Control periods per bin."""
    return max(1, round(rate_hz / BINS_HZ))


class Decimator:
    """Sorts rows into bins by their tick. A bin is returned once, when complete, with its extremes. Missing ticks
    leave a bin with fewer rows; a bin without rows is omitted.
    """

    def __init__(self, bin_ticks: int) -> None:
        self._bin_ticks = bin_ticks
        self._open: Matrix = np.empty((0, len(SIGNALS)))  # rows of the incomplete bin

    def feed(self, rows: np.ndarray[Any, np.dtype[np.void]]) -> Matrix:
        """Take rows in their order. Returns (bins, signals, 3) of the bins completed by them; NaN where all values
        are NaN.
        """
        values = np.concatenate((self._open, as_matrix(rows)))
        if not len(values):
            return np.empty((0, len(SIGNALS), 3))
        numbers = values[:, TICK] // self._bin_ticks
        starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1.0))
        if (values[-1, TICK] + 1) % self._bin_ticks:  # the last bin is incomplete
            self._open = values[starts[-1] :].copy()
            values, starts = values[: starts[-1]], starts[:-1]
        else:
            self._open = np.empty((0, len(SIGNALS)))
        if not len(starts):
            return np.empty((0, len(SIGNALS), 3))
        ends = np.append(starts[1:], len(values)) - 1
        extremes = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
        return np.stack((*extremes, values[ends]), axis=2)


def as_matrix(rows: np.ndarray[Any, np.dtype[np.void]]) -> Matrix:
    """(rows, signals) float64; integers are exact up to 2^53."""
    out = np.empty((len(rows), len(SIGNALS)))
    for column, signal in enumerate(SIGNALS):
        out[:, column] = rows[signal.name]
    return out


def lateness_counts(rows: np.ndarray[Any, np.dtype[np.void]]) -> Counts:
    """Number of ticks per class of lateness: (len(LATENESS_EDGES_US) + 1,)."""
    places = np.searchsorted(_EDGES_NS, rows["lateness_ns"], side="left")
    return np.bincount(places, minlength=len(_EDGES_NS) + 1).astype(np.int64)

"""From the loop's ring to bins: a ring reader of its own, bins for all clients, and the latest rows unchanged.

Runs on the live server's thread. The loop is the only writer of the ring and knows nothing of its readers; the recorder
has its own. Without clients nothing is read and nothing kept.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..recording.ring_reader import ReadableRing, RingReader
from ..recording.writer import wall_clock_offset_ns
from ..runtime.ring import new_ring
from ..signals import ROW
from . import frames
from .decimation import Counts, Decimator, Matrix, bin_ticks_of, lateness_counts

CAPTURE_S = 10.0
KEPT_S = CAPTURE_S + 5.0  # a page requests the rows around an event after it has seen the event
CHUNK_BYTES = 96 * 1024  # size of one frame of a capture: live frames are sent between two of them

Rows = np.ndarray[Any, np.dtype[np.void]]


class FeedSource(NamedTuple):
    """A running loop. `number` changes with each loop; the torque constant converts terms in Nm to A."""

    number: int
    ring: ReadableRing
    rate_hz: float
    torque_constant_nm_per_a: float


class Taken(NamedTuple):
    """Rows of a loop since the last poll."""

    loop: int
    bins: Matrix  # (bins, signals, 3), see Decimator
    ticks: int
    late: int
    lost: int  # rows that were overwritten before they were read
    lateness: Counts
    wall_offset_ns: int  # CLOCK_REALTIME minus CLOCK_MONOTONIC when the loop was first seen

    def frame(self) -> bytes:
        """A frame of kind `rows` for the scope."""
        return frames.binary(
            "rows", self.bins.tobytes(), loop=self.loop, bins=len(self.bins), lost=self.lost,
            late=self.late, ticks=self.ticks, lateness=self.lateness.tolist(),
        )  # fmt: skip


class Capture:
    """The latest rows, bit for bit."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._batches: deque[Rows] = deque()
        self._count = 0

    def add(self, rows: Rows) -> None:
        """Add rows, and drop those older than the longest capture."""
        if len(rows):
            self._batches.append(rows)
            self._count += len(rows)
        while self._batches and self._count - len(self._batches[0]) >= self._most:
            self._count -= len(self._batches.popleft())

    def newest(self, count: int, until_tick: int | None = None) -> Rows:
        """The newest rows, at most this many, oldest first; with `until_tick` those up to this tick."""
        found: list[Rows] = []
        missing = count
        for batch in reversed(self._batches):
            if missing <= 0:
                break
            rows = batch if until_tick is None else batch[: np.searchsorted(batch["tick"], until_tick, side="right")]
            found.append(rows[max(0, len(rows) - missing) :])
            missing -= len(found[-1])
        return np.frombuffer(b"".join(rows.tobytes() for rows in reversed(found)), ROW)  # NumPy copies by field


class Feed:
    """Follows the running loop, and the next one when another starts."""

    def __init__(self, source: Callable[[], FeedSource | None]) -> None:
        self._source = source
        self._number = 0
        self._reader: RingReader | None = None
        RingReader(new_ring(2))  # compiled, or loaded, before time matters

    def begin(self) -> None:
        """A first client: `poll` returns rows from now on."""
        self._reader, self._number = None, 0

    def end(self) -> None:
        """No client is left: free all memory."""
        self._reader = None

    def poll(self) -> Taken | None:
        """Rows since the last poll; None when there are none."""
        source = self._source()
        if source is None:
            return None
        if self._reader is None or source.number != self._number:
            self._follow(source)
        assert self._reader is not None
        batch = self._reader.read()
        if not len(batch.rows):
            return None
        self._capture.add(batch.rows)
        late = int(np.count_nonzero(batch.rows["late"]))
        return Taken(
            source.number, self._decimator.feed(batch.rows), len(batch.rows), late, batch.lost,
            lateness_counts(batch.rows), self._wall_offset_ns,
        )  # fmt: skip

    def _follow(self, source: FeedSource) -> None:
        self._number = source.number
        self._rate_hz = source.rate_hz
        self._wall_offset_ns = wall_clock_offset_ns()
        self._reader = RingReader(source.ring, newest=0)
        self._decimator = Decimator(bin_ticks_of(source.rate_hz))
        self._capture = Capture(round(KEPT_S * source.rate_hz))

    def facts(self) -> dict[str, Any]:
        """Facts of the loop for the page; null where none runs."""
        source = self._source()
        if source is None:
            return {"loop": None, "rate_hz": None, "bin_ticks": None, "torque_constant_nm_per_a": None}
        return {
            "loop": source.number,
            "rate_hz": source.rate_hz,
            "bin_ticks": bin_ticks_of(source.rate_hz),
            "torque_constant_nm_per_a": source.torque_constant_nm_per_a,
        }

    def captured(
        self, seconds: float, until_tick: int | None = None, names: Sequence[str] = (), number: int | None = None
    ) -> list[bytes]:
        """Rows of the last seconds (or of those before a tick) at the full rate, as frames of kind `capture`.

        `names`: only these signals, packed in this order; None: all. `number` identifies the frames of one request.
        Without rows one empty frame.
        """
        rows = np.empty(0, ROW)
        loop = None
        if self._reader is not None:
            loop = self._number
            rows = self._capture.newest(round(min(seconds, CAPTURE_S) * self._rate_hz), until_tick)
        if names:
            rows = _columns(rows, names)
        total, chunk = len(rows), max(1, CHUNK_BYTES // rows.dtype.itemsize)
        return [
            frames.binary(
                "capture", rows[first : first + chunk].tobytes(), loop=loop, first=first,
                rows=min(chunk, total - first), total=total, signals=list(names), id=number,
            )
            for first in range(0, max(total, 1), chunk)
        ]  # fmt: skip


def _columns(rows: Rows, names: Sequence[str]) -> Rows:
    """Some signals of rows, concatenated without gaps."""
    packed = np.empty(len(rows), np.dtype([(name, ROW[name]) for name in names]))
    for name in names:
        packed[name] = rows[name]
    return packed

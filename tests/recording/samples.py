"""Rows, rings, clocks and disks for the tests of the recording."""

from __future__ import annotations

import errno
import io
from pathlib import Path

import numpy as np

from fffo_drive.recording.writer import RunWriter
from fffo_drive.signals import ROW

WALL_NS = 1_700_000_000_000_000_000
BOOT_NS = 5_000_000_000  # deadline of the first row
PERIOD_NS = 500_000
RAW = f"V{ROW.itemsize}"


def random_rows(count: int, seed: int = 0, first_tick: int = 0) -> np.ndarray:
    """Rows of random bytes (any float, NaN payloads too) with ticks and deadlines as the loop makes them."""
    raw = np.random.default_rng(seed).integers(0, 256, count * ROW.itemsize, dtype=np.uint8)
    rows = raw.view(ROW)
    rows["tick"] = first_tick + np.arange(count)
    rows["deadline_ns"] = BOOT_NS + rows["tick"].astype(np.int64) * PERIOD_NS
    return rows


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    """Bit for bit: NaN equals NaN."""
    return a.dtype == b.dtype and a.tobytes() == b.tobytes()


def write_run(path: Path, rows: np.ndarray, batch: int = 100, flush_every: int = 0, **options) -> Path:
    """A finished recording of `rows`, written in batches, flushed each `flush_every` rows."""
    writer = RunWriter(
        path, {"axis": "bench"}, [("axis.yaml", "application/yaml", b"rate_hz: 2000\n")], WALL_NS, **options
    )
    for begin in range(0, len(rows), batch):
        writer.write_rows(rows[begin : begin + batch])
        if flush_every and (begin + batch) % flush_every == 0:
            writer.flush()
    return writer.close()


class FakeRing:
    """A ring and its single writer, as the loop has it."""

    def __init__(self, capacity: int) -> None:
        self.rows = np.zeros(capacity, ROW)
        self.words = np.zeros(1, np.int64)

    def push(self, rows: np.ndarray) -> None:
        """Write rows without waiting for anyone."""
        for row in rows:
            self.rows[int(self.words[0]) % len(self.rows)] = row
            self.words[0] += 1


class FakeClock:
    """CLOCK_MONOTONIC, moved by hand."""

    def __init__(self) -> None:
        self.now_ns = BOOT_NS

    def __call__(self) -> int:
        return self.now_ns

    def advance_s(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)


class Disk:
    """Opens files with so many bytes left on the disk; a write beyond them is cut short, then fails."""

    def __init__(self, room: int | None = None) -> None:
        self.room = room
        self.error = errno.ENOSPC
        self.on_write = lambda: None
        self.opened: list[Path] = []

    def __call__(self, path: Path) -> DiskFile:
        if self.room == 0:
            raise OSError(self.error, "injected", str(path))
        self.opened.append(path)
        return DiskFile(path, self)


class DiskFile(io.FileIO):
    """A real file on a limited disk."""

    def __init__(self, path: Path, disk: Disk) -> None:
        super().__init__(path, "xb")
        self._disk = disk

    def write(self, data) -> int:
        self._disk.on_write()
        room = self._disk.room
        if room is None:
            return super().write(data)
        if room == 0:
            raise OSError(self._disk.error, "injected")
        written = super().write(memoryview(data)[:room])
        self._disk.room = room - written
        return written

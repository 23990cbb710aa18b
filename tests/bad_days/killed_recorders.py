"""Recorders that are killed at any moment: a child for each, and how far the loop was when it died.

`python killed_recorders.py DIRECTORY SEED...` records into DIRECTORY/SEED until a signal that cannot be caught ends the
child, and prints {seed: rows that the ring had got}. Time is the rows' own (FakeClock): 100 rows, 50 ms, one drain.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from itertools import count
from pathlib import Path

import numpy as np
from recording.samples import WALL_NS, FakeClock, FakeRing, random_rows

from fffo_drive.recording.recorder import Recorder
from fffo_drive.recording.settings import RecorderHooks, RecorderSettings, RotationPolicy, RunHeader

TURN_ROWS, TURN_S = 100, 0.05
ROWS = random_rows(TURN_ROWS, seed=11)


def rows_of(turn: int) -> np.ndarray:
    """What the loop leaves behind in one turn."""
    rows = ROWS.copy()
    rows["tick"] += turn * TURN_ROWS
    rows["deadline_ns"] += turn * TURN_ROWS * 500_000
    return rows


def record_for_ever(directory: Path, progress: int) -> None:
    """One byte into `progress` for each turn whose rows are in the ring."""
    ring, clock = FakeRing(1024), FakeClock()
    settings = RecorderSettings(rotation=RotationPolicy(max_bytes=1_500_000), fsync_interval_s=2.0)
    header = RunHeader({"axis": "bench"}, (("axis.yaml", "application/yaml", b"x"),), WALL_NS)
    recorder = Recorder(ring, directory / "run.mcap", header, settings, RecorderHooks(clock))
    for turn in count():
        ring.push(rows_of(turn))
        os.write(progress, b".")
        clock.advance_s(TURN_S)
        recorder.drain_once()


def kill_one(directory: Path, seed: int) -> int:
    """Returns the rows that were in the ring when it died."""
    chance = random.Random(seed)
    reading, progress = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        record_for_ever(directory, progress)
    os.close(progress)
    turns = 0
    while turns < chance.randrange(1, 140):
        turns += len(os.read(reading, 1))
    until_ns = time.monotonic_ns() + chance.randrange(2_000_000)  # into the middle of a write, a rename, an fsync
    while time.monotonic_ns() < until_ns:
        pass
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    while rest := os.read(reading, 4096):
        turns += len(rest)
    os.close(reading)
    return turns * TURN_ROWS


if __name__ == "__main__":
    root = Path(sys.argv[1])
    print(json.dumps({seed: kill_one(root / seed, int(seed)) for seed in sys.argv[2:]}))

"""Service (SDO, NMT) frames from ordinary threads to the loop, which sends one per tick, after the command.

One producer at a time (a lock on the Python side), one consumer (the loop), no lock between them.
"""

from __future__ import annotations

import threading
import time
from typing import Any, NamedTuple

import numpy as np

from ...can.frame import FRAME_SIZE
from ...jit import njit
from ...jit.atomic import load_acquire, store_release

SLOTS = 64
HEAD, TAIL, CYCLE_NS = 0, 1, 2  # words: frames put, frames taken, time of the loop's last visit
MAX_AGE_NS = 100_000_000  # an older frame is dropped: its sender has timed out


class QueueMemory(NamedTuple):
    """The compiled side: frames uint8 (SLOTS, 16), their times int64 (SLOTS,), words int64 (3,)."""

    frames: np.ndarray[Any, np.dtype[np.uint8]]
    times: np.ndarray[Any, np.dtype[np.int64]]
    words: np.ndarray[Any, np.dtype[np.int64]]


def new_queue_memory() -> QueueMemory:
    """An empty queue."""
    return QueueMemory(np.zeros((SLOTS, FRAME_SIZE), np.uint8), np.zeros(SLOTS, np.int64), np.zeros(3, np.int64))


@njit
def next_service_frame(memory: QueueMemory, now_ns: int) -> int:
    """Slot of the oldest frame that is not stale, or -1. Stale frames are dropped. Also notes `now_ns`."""
    store_release(memory.words, CYCLE_NS, now_ns)
    head = load_acquire(memory.words, HEAD)
    tail = memory.words[TAIL]
    while tail < head and now_ns - memory.times[tail % SLOTS] > MAX_AGE_NS:
        tail += 1
    store_release(memory.words, TAIL, tail)
    return int(tail % SLOTS) if tail < head else -1


@njit
def drop_service_frames(memory: QueueMemory) -> int:
    """Drop all queued frames (the bus is off: no old frame may be sent later). Returns their number."""
    head = load_acquire(memory.words, HEAD)
    dropped = head - memory.words[TAIL]
    store_release(memory.words, TAIL, head)
    return int(dropped)


@njit
def service_frame_sent(memory: QueueMemory) -> int:
    """Free the slot returned by `next_service_frame`. Returns 0."""
    store_release(memory.words, TAIL, memory.words[TAIL] + 1)
    return 0


class ServiceQueue:
    """The Python side of the queue."""

    def __init__(self, loop_timeout_ns: int) -> None:
        """`loop_timeout_ns`: the loop counts as stopped when it has not visited the queue for this time."""
        self.memory = new_queue_memory()
        self._loop_timeout_ns = loop_timeout_ns
        self._lock = threading.Lock()

    @property
    def loop_runs(self) -> bool:
        """True while the loop visits the queue; frames must then go through it."""
        seen_ns = load_acquire(self.memory.words, CYCLE_NS)
        return seen_ns > 0 and time.monotonic_ns() - seen_ns < self._loop_timeout_ns

    def put(self, frame: bytes) -> bool:
        """Queue a frame of 16 bytes; False when the queue is full."""
        memory = self.memory
        with self._lock:
            head = int(memory.words[HEAD])
            if head - load_acquire(memory.words, TAIL) >= SLOTS:
                return False
            memory.frames[head % SLOTS] = np.frombuffer(frame, np.uint8)
            memory.times[head % SLOTS] = time.monotonic_ns()
            store_release(memory.words, HEAD, head + 1)
            return True

"""Service (SDO, NMT) frames from ordinary threads to the loop, which sends one per tick, after the command.

One producer at a time (a lock on the Python side), one consumer (the loop), no lock between them. What a thread sends
beside the loop, while that does not run, is counted here too: the loop's own link hears it, and has to know it from
somebody else's.
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
SENT_ASIDE = 3  # frames sent beside the loop, counted before each send
LOOP_REQUESTS = 4  # SDO requests of the loop's own, counted before each send
QUEUE_WORDS = 5
MAX_AGE_NS = 100_000_000  # an older frame is dropped: its sender has timed out


class QueueMemory(NamedTuple):
    """The compiled side: frames uint8 (SLOTS, 16), their times int64 (SLOTS,), words int64 (QUEUE_WORDS,)."""

    frames: np.ndarray[Any, np.dtype[np.uint8]]
    times: np.ndarray[Any, np.dtype[np.int64]]
    words: np.ndarray[Any, np.dtype[np.int64]]


def new_queue_memory() -> QueueMemory:
    """An empty queue."""
    frames, times = np.zeros((SLOTS, FRAME_SIZE), np.uint8), np.zeros(SLOTS, np.int64)
    return QueueMemory(frames, times, np.zeros(QUEUE_WORDS, np.int64))


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

    @property
    def loop_requests(self) -> int:
        """SDO requests that the loop has made itself."""
        return load_acquire(self.memory.words, LOOP_REQUESTS)

    def count_aside(self, frames: int) -> None:
        """A frame is about to be sent beside the loop (1), or was refused by the kernel (-1)."""
        with self._lock:
            store_release(self.memory.words, SENT_ASIDE, int(self.memory.words[SENT_ASIDE]) + frames)

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

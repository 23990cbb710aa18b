"""Waiting for frames in compiled code: a synchronous RPDO does not wake Python, it waits in a box for the next event.

Such a frame acts at the next SYNC, and of several only the last one does. It is kept with its time of arrival, and the
node takes it before the next event: another frame, or a deadline.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..can.frame import FRAME_SIZE
from ..jit import njit
from ..jit.libc import EAGAIN, EINTR, MSG_DONTWAIT, monotonic_ns, recv, wait_readable

Words = np.ndarray[Any, np.dtype[np.int64]]

BOXES = 8
NOTHING = 0  # the deadline has come, or a signal
BOXED = 1 << 16  # flag of a result: a box holds a frame

# words of the memory; a frame is two of them: identifier and length, then the data
FRAME = 4  # before it: 4 for C structures
HEAD = 6  # BOXES: the first word of frames that go into a box; NO_BOX: none
KEPT = HEAD + BOXES  # BOXES frames
ARRIVAL = KEPT + 2 * BOXES  # BOXES: when they came, in ns; 0: empty
SIZE = ARRIVAL + BOXES

NO_BOX = -1
HEAD_MASK = 0xFF_FFFF_FFFF  # identifier, flags and length; the rest of the word is padding


class Box(NamedTuple):
    """Frames with this identifier and length wait for the next SYNC."""

    can_id: int
    length: int


@njit
def wait_for_frame(fd: int, memory: Words, deadline_ns: int) -> int:
    """Wait until `deadline_ns` for a frame without a box: its size, NOTHING, or -errno; and BOXED."""
    boxed = 0
    while True:
        left_ns = deadline_ns - monotonic_ns(memory)
        if wait_readable(memory, fd, max(left_ns, 0)) <= 0:
            return NOTHING | boxed
        n = recv(fd, memory.ctypes.data + 8 * FRAME, FRAME_SIZE, MSG_DONTWAIT)
        if n in (-EAGAIN, -EINTR):
            return NOTHING | boxed
        if n != FRAME_SIZE:
            return int(n) if n < 0 else int(n) | boxed
        box = NO_BOX
        for i in range(BOXES):
            if memory[FRAME] & HEAD_MASK == memory[HEAD + i]:
                box = i
        if box == NO_BOX:
            return FRAME_SIZE | boxed
        memory[KEPT + 2 * box] = memory[FRAME]
        memory[KEPT + 2 * box + 1] = memory[FRAME + 1]
        memory[ARRIVAL + box] = monotonic_ns(memory)
        boxed = BOXED
        if left_ns <= 0:
            return NOTHING | boxed


class Inbox:
    """The memory that `wait_for_frame` works on, seen from Python."""

    def __init__(self) -> None:
        self.memory: Words = np.zeros(SIZE, np.int64)
        self._raw = self.memory.data.cast("B")
        self.arrange(())

    def arrange(self, boxes: tuple[Box, ...]) -> None:
        """Set which frames wait from now on, at most BOXES. The boxes must be empty."""
        self.memory[HEAD : HEAD + BOXES] = NO_BOX
        self.memory[ARRIVAL:] = 0
        for place, box in enumerate(boxes[:BOXES]):
            self.memory[HEAD + place] = box.can_id | box.length << 32

    def frame(self, size: int) -> bytes:
        """What was received last."""
        return bytes(self._raw[8 * FRAME : 8 * FRAME + size])

    def waiting(self) -> list[tuple[int, bytes]]:
        """Take out the waiting frames, as (time of arrival in ns, frame), oldest first."""
        found = []
        arrivals = self.memory[ARRIVAL:].tolist()
        for place, arrival_ns in enumerate(arrivals):
            if arrival_ns:
                first = 8 * (KEPT + 2 * place)
                found.append((arrival_ns, bytes(self._raw[first : first + FRAME_SIZE])))
        self.memory[ARRIVAL:] = 0
        found.sort()
        return found

"""Kernels that read and decode frames: feedback, EMCY, heartbeat, bus errors."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...can import frame as can
from ...jit import njit
from ...jit.atomic import load_acquire
from ...jit.libc import EAGAIN, EINTR, MSG_DONTWAIT, monotonic_ns, recv
from ..port import NMT_OPERATIONAL
from .object_map import FIELD_POSITION, FIELD_STATUSWORD, FIELD_TORQUE, FIELD_VELOCITY
from .port_memory import (
    ANSWERED,
    ANSWERED_TWICE,
    ANSWERS_SYNC,
    CONTROLLER_OFF,
    HEARD_ASIDE,
    MEMORY_WORDS,
    OF_LOOP,
    OF_SERVICE,
    OWED,
    POSITION_COUNTS,
    POSITION_KNOWN,
    POSITION_RAW,
    SECOND_ANSWERS,
    CanopenPort,
    Words,
)
from .sending import note_bus_state, note_errno
from .service_queue import SENT_ASIDE

FLAGS = can.EXTENDED_FLAG | can.REMOTE_FLAG
# An answer beyond those that are owed may be a repeated frame. More than one in SECOND_EVERY SYNCs, beyond a burst of
# SECOND_BURST, are somebody else's.
SECOND_EVERY, SECOND_BURST = 100, 10


@njit(inline="always")
def _decode(port: CanopenPort, slot: int, tick: int) -> int:
    """Decode the fields of a TPDO in the received frame into the feedback. Returns 0."""
    feedback = port.feedback[0]
    for row in range(port.fields.shape[0]):
        if port.fields[row, 0] != slot:
            continue
        first = can.DATA_OFFSET + port.fields[row, 1]
        size = port.fields[row, 2]
        raw: Any = 0
        for i in range(size):
            raw |= np.int64(port.received[first + i]) << (8 * i)
        if port.fields[row, 3] != 0 and raw >= 1 << (8 * size - 1):
            raw -= 1 << (8 * size)
        field = port.fields[row, 4]
        if field == FIELD_VELOCITY:
            feedback["velocity_rps"] = raw * port.scaling.velocity_rps_per_unit
            feedback["velocity_tick"] = tick
        elif field == FIELD_POSITION:
            feedback["position_rev"] = _unwrap(port.memory, raw) * port.scaling.position_rev_per_count
        elif field == FIELD_TORQUE:
            feedback["current_a"] = raw / port.scaling.feedback_units_per_a
        elif field == FIELD_STATUSWORD:
            feedback["statusword"] = raw
            feedback["status_tick"] = tick
    return 0


@njit
def _unwrap(memory: Words, raw: int) -> int:
    """Multi-turn counts from an int32 counter that wraps: the shortest way from the last value."""
    if memory[POSITION_KNOWN] == 0:
        memory[POSITION_KNOWN] = 1
        memory[POSITION_COUNTS] = raw
    else:
        step = ((raw - memory[POSITION_RAW] + 0x80000000) & 0xFFFFFFFF) - 0x80000000
        memory[POSITION_COUNTS] += step
    memory[POSITION_RAW] = raw
    return int(memory[POSITION_COUNTS])


@njit
def _note_foreign(port: CanopenPort, can_id: int, count: int) -> int:
    """Count frames of somebody else; the first is named, for what the drive does upon it comes later. Returns 0."""
    feedback = port.feedback[0]
    if feedback["foreign_frames"] == 0:
        feedback["foreign_id"] = can_id
    feedback["foreign_frames"] += count
    return 0


@njit
def _take_second_answer(port: CanopenPort, can_id: int) -> int:
    """A second answer to one SYNC, with none owed: above a share it is somebody else's. Returns 0."""
    port.feedback[0]["duplicate_feedback"] += 1
    port.memory[SECOND_ANSWERS] += SECOND_EVERY
    return _note_foreign(port, can_id, 1 if port.memory[SECOND_ANSWERS] > SECOND_EVERY * SECOND_BURST else 0)


@njit
def _take_masters_frame(port: CanopenPort, word: int, kind: int) -> int:
    """A frame that only we may send: a link does not hear its own, so it is somebody else's. Returns 0.

    Unless it is of our service, which sends by a link of its own while no loop runs, and counts what it sends.
    """
    if kind == OF_SERVICE and port.memory[HEARD_ASIDE] < load_acquire(port.queue.words, SENT_ASIDE):
        port.memory[HEARD_ASIDE] += 1
        return 0
    return _note_foreign(port, word & can.STANDARD_MASK, 1)


@njit(inline="always")
def _take_answer(port: CanopenPort, slot: int, tick: int, in_time: bool) -> int:
    """A TPDO that answers every SYNC: use it, or count it as late. Returns 0."""
    memory = port.memory
    bit = 1 << slot
    if memory[ANSWERED] & bit != 0:
        memory[ANSWERED_TWICE] |= bit
        if memory[OWED] == 0:
            _take_second_answer(port, port.known[slot, 0])
    if not in_time or memory[ANSWERED_TWICE] & bit != 0:
        port.feedback[0]["late_feedback"] += 1
    memory[ANSWERED] |= bit
    memory[OWED] = max(0, memory[OWED] - 1)
    if in_time:
        _decode(port, slot, tick)
        port.feedback[0]["received_ns"] = monotonic_ns(port.scratch)
    return 0


@njit
def _take_node_message(port: CanopenPort, can_id: int, length: int) -> int:
    """EMCY, or heartbeat and boot-up. Returns 0."""
    feedback = port.feedback[0]
    if can_id == can.EMERGENCY + port.node_id:
        if length < 2:
            feedback["bad_frames"] += 1
            return 0
        code = np.int64(port.received[can.DATA_OFFSET]) | np.int64(port.received[can.DATA_OFFSET + 1]) << 8
        for i in range(MEMORY_WORDS, port.memory.size):
            if port.memory[i] == code:
                feedback["warning_code"] = code
                feedback["warning_count"] += 1
                return 0
        feedback["emergency_code"] = code
        if code != 0:
            feedback["emergency_count"] += 1
        return 0
    if length != 1:
        feedback["bad_frames"] += 1
        return 0
    state = np.int64(port.received[can.DATA_OFFSET]) & 0x7F
    if state == 0:
        feedback["boot_count"] += 1
    elif state != NMT_OPERATIONAL and feedback["nmt_state"] == NMT_OPERATIONAL:
        feedback["nmt_exits"] += 1
    feedback["nmt_state"] = state
    feedback["heartbeat_ns"] = monotonic_ns(port.scratch)
    return 0


@njit
def _take_error_frame(port: CanopenPort, word: int) -> int:
    """Handle an error frame of the CAN controller. Returns 0."""
    port.feedback[0]["error_frames"] += 1
    if word & can.ERROR_BUS_OFF != 0:
        port.memory[CONTROLLER_OFF] = 1
    if word & can.ERROR_RESTARTED != 0:
        port.memory[CONTROLLER_OFF] = 0
    return note_bus_state(port)


@njit(inline="always")
def take_frame(port: CanopenPort, tick: int, in_time: bool) -> int:
    """Handle the frame in `port.received`: what is sent in our name is counted, other frames are ignored. Returns 0."""
    word: Any = np.int64(port.received_words[0])
    if word & can.ERROR_FLAG != 0:
        return _take_error_frame(port, word)
    if port.memory[CONTROLLER_OFF] != 0:  # any frame: the controller is on the bus again
        port.memory[CONTROLLER_OFF] = 0
        note_bus_state(port)
    can_id = word & can.EXTENDED_MASK
    slot = -1
    for i in range(port.known.shape[0]):
        if port.known[i, 0] == can_id or port.known[i, 0] == word:  # a guarding request is known by its flag
            slot = i
            break
    kind: Any = port.known[slot, 2] if slot >= 0 else -1
    if kind >= OF_LOOP:
        return _take_masters_frame(port, word, kind) if word == port.known[slot, 0] else 0
    if slot < 0 and can_id not in (can.EMERGENCY + port.node_id, can.HEARTBEAT + port.node_id):
        return 0
    length: Any = np.int64(port.received[can.LENGTH_OFFSET])
    if word & FLAGS != 0 or length > can.MAX_DATA or (slot >= 0 and length != port.known[slot, 1]):
        port.feedback[0]["bad_frames"] += 1
        return 0
    if slot < 0:
        return _take_node_message(port, can_id, length)
    if kind == ANSWERS_SYNC:
        return _take_answer(port, slot, tick, in_time)
    return _decode(port, slot, tick)


@njit(inline="always")
def read_frame(port: CanopenPort) -> int:
    """One frame into `port.received` without waiting: 1, or 0 when there is none (or the bus is gone)."""
    while True:
        n = recv(port.rx_fd, port.received.ctypes.data, can.FRAME_SIZE, MSG_DONTWAIT)
        if n == can.FRAME_SIZE:
            return 1
        if n >= 0:  # a datagram that is not a CAN frame; the kernel filter normally rejects these
            port.feedback[0]["bad_frames"] += 1
        elif n == -EAGAIN:
            return 0
        elif n != -EINTR:
            note_errno(port, n)
            return 0

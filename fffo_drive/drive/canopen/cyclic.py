"""The cyclic exchange with a CANopen drive, compiled: SYNC, feedback, command, heartbeat.

Assignment of answers to SYNCs. A TPDO carries no number, so the rule is:

- An answer that is in the queue before SYNC is sent is late: counted, never used.
- Of several answers of one TPDO after one SYNC, the last is used and the earlier ones are late. Frames that arrive
  after `port_receive` has returned are in the queue at the next SYNC, and are late.
- After a tick whose answer came neither in time nor late, the next tick waits for a second answer until its cut-off: if
  it comes, the first was the late one. If it does not, a frame was lost and the first is good. So a drive that is
  always more than a whole period late cannot be distinguished from one that is in time: see turnaround_ns of the row
  for that.
- A drive owes one answer for each SYNC, however late. A second answer to one SYNC with none owed is a repeated frame,
  or somebody else's. After LOST_TICKS in a row that were answered once, what is still owed was lost.

Nothing is sent while the bus is off: no command may go out late. The bus is back with an error frame "restarted", a
frame from the bus, or, after a lost interface, a frame that the kernel accepts. The first frame then is a command
without torque, before SYNC: a command still held by the drive must not act.
"""

from __future__ import annotations

import math

from ...jit import njit
from ...jit.atomic import load_acquire, store_release
from ...jit.libc import EINTR, monotonic_ns, sleep_until, wait_readable
from ..cia402 import CONTROL_QUICK_STOP, STATE_FAULT, is_operation_enabled, state_of
from ..port import (
    NMT_OPERATIONAL,
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sleep_until,
    port_sync,
)
from .port_memory import (
    AMBIGUOUS,
    ANSWERED,
    ANSWERED_TWICE,
    ANSWERS,
    BE_PRE_OPERATIONAL,
    COMMAND_FRAME,
    CONTROLLER_OFF,
    DISOBEYS,
    EXPECTED,
    HEARTBEAT_FRAME,
    IN_TIME_TICKS,
    NEXT_HEARTBEAT_NS,
    OWED,
    RETURNING,
    SAME_CONTROLWORD,
    SDO_DATA,
    SECOND_ANSWERS,
    SYNC_FRAME,
    TRIPPED_TICKS,
    ZERO_TARGET,
    CanopenPort,
)
from .receiving import read_frame, take_frame
from .sending import ENETDOWN, send_frame
from .service_queue import LOOP_REQUESTS, drop_service_frames, next_service_frame, service_frame_sent

__all__ = ["CanopenPort"]  # the kernels below are reached through the functions of drive.port

MAX_DRAINED = 1 << 14  # frames read before one SYNC, so that a flood cannot hold the loop
FLOOD_CHECK = 32  # frames between two checks of the clock while receiving
LOST_TICKS = 50
# after a fault, one frame a tick: a drive that answers hears the first two beside the RPDO; one that does not may be
# pre-operational (it hears SDO) or stopped (it hears NMT alone, and SDO after that); a frame may be lost
WITHDRAWAL = (ZERO_TARGET, SAME_CONTROLWORD, BE_PRE_OPERATIONAL, ZERO_TARGET, SAME_CONTROLWORD)
BESIDE_RPDO = 2  # from here on only if it does not answer SYNC, says that it is not operational, or disobeys
WITHDRAWAL_EVERY = 10  # ticks
SILENT_TICKS = 2  # without an answer in time


@njit(inline="always")
def _send_command(port: CanopenPort, controlword: int, target: int) -> int:
    """Send the RPDO. Returns 0, or -errno."""
    frame = port.frames[COMMAND_FRAME]
    frame[port.controlword_at] = controlword & 0xFF
    frame[port.controlword_at + 1] = (controlword >> 8) & 0xFF
    for i in range(port.target_bytes):
        frame[port.target_at + i] = (target >> (8 * i)) & 0xFF
    return send_frame(port, frame.ctypes.data)


@port_now_ns.register(CanopenPort)  # type: ignore[attr-defined, untyped-decorator]
@njit(inline="always")
def _now_ns(port: CanopenPort) -> int:
    return monotonic_ns(port.scratch)


@port_sleep_until.register(CanopenPort)  # type: ignore[attr-defined, untyped-decorator]
@njit(inline="always")
def _sleep_until(port: CanopenPort, deadline_ns: int) -> int:
    while sleep_until(port.scratch, deadline_ns) == EINTR:
        pass
    return 0


@port_sync.register(CanopenPort)  # type: ignore[attr-defined, untyped-decorator]
@njit(inline="always")
def _sync(port: CanopenPort, tick: int) -> int:
    memory = port.memory
    drained = 0
    while drained < MAX_DRAINED and read_frame(port) == 1:
        drained += 1
        take_frame(port, tick - 1, False)
    memory[AMBIGUOUS] = 1 if memory[ANSWERED] & memory[EXPECTED] != memory[EXPECTED] else 0
    single = memory[AMBIGUOUS] == 0 and memory[ANSWERED_TWICE] == 0  # a drive that answers twice is catching up
    memory[IN_TIME_TICKS] = memory[IN_TIME_TICKS] + 1 if single else 0
    if memory[IN_TIME_TICKS] > LOST_TICKS:
        memory[OWED] = 0
    memory[ANSWERED] = 0
    memory[ANSWERED_TWICE] = 0
    memory[EXPECTED] = 0
    memory[SECOND_ANSWERS] = max(0, memory[SECOND_ANSWERS] - 1)
    if memory[CONTROLLER_OFF] != 0:
        return -ENETDOWN
    if memory[RETURNING] != 0:
        result = _send_command(port, CONTROL_QUICK_STOP, 0)
        if result != 0:
            return result
        memory[RETURNING] = 0
    result = send_frame(port, port.frames[SYNC_FRAME].ctypes.data)
    if result == 0:
        memory[EXPECTED] = port.answer_mask
        memory[OWED] += memory[ANSWERS]
    return result


@port_receive.register(CanopenPort)  # type: ignore[attr-defined, untyped-decorator]
@njit(inline="always")
def _receive(port: CanopenPort, tick: int, cutoff_ns: int) -> int:
    memory = port.memory
    mask = port.answer_mask
    while True:
        left_ns = cutoff_ns - monotonic_ns(port.scratch)
        if left_ns <= 0 or wait_readable(port.scratch, port.rx_fd, left_ns) == 0:
            left_ns = 0
        count = 0
        while count < FLOOD_CHECK and read_frame(port) == 1:  # read everything in the queue before deciding
            count += 1
            take_frame(port, tick, True)
        complete = memory[ANSWERED] == mask
        if complete and (memory[AMBIGUOUS] == 0 or memory[ANSWERED_TWICE] == mask):
            break
        if left_ns == 0:
            break
    return 1 if memory[ANSWERED] == mask else 0


@port_command.register(CanopenPort)  # type: ignore[attr-defined, untyped-decorator]
@njit(inline="always")
def _command(port: CanopenPort, tick: int, controlword: int, current_a: float) -> float:
    if port.feedback[0]["bus_off"] != 0:
        return 0.0
    target = 0
    if current_a == current_a:  # no torque for a NaN
        limit = float((1 << (8 * port.target_bytes - 1)) - 1)
        limited = min(max(current_a * port.scaling.target_units_per_a, -limit), limit)
        target = math.floor(limited + 0.5)
    if _send_command(port, controlword, target) != 0 or target == 0:
        return 0.0
    return target / port.scaling.target_units_per_a


@njit
def _withdraw(port: CanopenPort, tick: int) -> bool:
    """After a fault: what the RPDO says by SDO too, and NMT where the drive may hear neither. True: a frame went out.

    A drive that does not answer SYNC is told again and again: its torque may still act. So is one that is enabled in
    spite of it, by somebody else's RPDO, say: pre-operational, it hears none. One in fault has no torque and takes none
    before a reset, which it must be able to hear: it may answer as late as it likes.
    """
    memory = port.memory
    turn = memory[TRIPPED_TICKS]
    memory[TRIPPED_TICKS] += 1
    feedback = port.feedback[0]
    state = feedback["nmt_state"]
    in_fault = feedback["status_tick"] >= 0 and state_of(feedback["statusword"]) == STATE_FAULT
    late = tick - feedback["velocity_tick"] > SILENT_TICKS and not in_fault
    silent = late or (state >= 0 and state != NMT_OPERATIONAL)
    says_so_since = feedback["status_tick"] > tick - turn + BESIDE_RPDO
    if turn >= WITHDRAWAL_EVERY and says_so_since and is_operation_enabled(feedback["statusword"]):
        memory[DISOBEYS] = 1
    step = turn % WITHDRAWAL_EVERY
    if step >= len(WITHDRAWAL) or (turn >= BESIDE_RPDO and not silent and memory[DISOBEYS] == 0):
        return False
    chosen = WITHDRAWAL[step]
    frame = port.frames[chosen]
    if chosen == SAME_CONTROLWORD:
        frame[SDO_DATA] = port.frames[COMMAND_FRAME][port.controlword_at]
        frame[SDO_DATA + 1] = port.frames[COMMAND_FRAME][port.controlword_at + 1]
    if chosen != BE_PRE_OPERATIONAL:
        store_release(port.queue.words, LOOP_REQUESTS, load_acquire(port.queue.words, LOOP_REQUESTS) + 1)
    send_frame(port, frame.ctypes.data)
    return True


@port_housekeeping.register(CanopenPort)  # type: ignore[attr-defined, untyped-decorator]
@njit(inline="always")
def _housekeeping(port: CanopenPort, tick: int, tripped: bool) -> int:
    now_ns = monotonic_ns(port.scratch)
    slot = next_service_frame(port.queue, now_ns)
    if port.feedback[0]["bus_off"] != 0:
        drop_service_frames(port.queue)
        return 0
    if not tripped:
        port.memory[TRIPPED_TICKS] = port.memory[DISOBEYS] = 0
    elif _withdraw(port, tick):
        return 0
    if now_ns >= port.memory[NEXT_HEARTBEAT_NS]:
        if send_frame(port, port.frames[HEARTBEAT_FRAME].ctypes.data) == 0:
            port.memory[NEXT_HEARTBEAT_NS] = now_ns + port.heartbeat_period_ns
        return 0
    if slot >= 0 and send_frame(port, port.queue.frames[slot].ctypes.data) == 0:
        service_frame_sent(port.queue)
    return 0

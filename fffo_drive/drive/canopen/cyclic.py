"""The cyclic exchange with a CANopen drive, compiled: SYNC, feedback, command, heartbeat.

Assignment of answers to SYNCs. A TPDO carries no number, so the rule is:

- An answer that is in the queue before SYNC is sent is late: counted, never used.
- Of several answers of one TPDO after one SYNC, the last is used and the earlier ones are late. Frames that arrive
  after `port_receive` has returned are in the queue at the next SYNC, and are late.
- After a tick whose answer came neither in time nor late, the next tick waits for a second answer until its cut-off: if
  it comes, the first was the late one. If it does not, a frame was lost and the first is good. So a drive that is
  always more than a whole period late cannot be distinguished from one that is in time: see turnaround_ns of the row
  for that.

Nothing is sent while the bus is off: no command may go out late. The bus is back with an error frame "restarted", a
frame from the bus, or, after a lost interface, a frame that the kernel accepts. The first frame then is a command
without torque, before SYNC: a command still held by the drive must not act.
"""

from __future__ import annotations

import math

from ...jit import njit
from ...jit.libc import EINTR, monotonic_ns, sleep_until, wait_readable
from ..cia402 import CONTROL_QUICK_STOP
from ..port import (
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
    CONTROLLER_OFF,
    EXPECTED,
    NEXT_HEARTBEAT_NS,
    RETURNING,
    CanopenPort,
)
from .receiving import read_frame, take_frame
from .sending import ENETDOWN, send_frame
from .service_queue import drop_service_frames, next_service_frame, service_frame_sent

__all__ = ["CanopenPort"]  # the kernels below are reached through the functions of drive.port

MAX_DRAINED = 1 << 14  # frames read before one SYNC, so that a flood cannot hold the loop
FLOOD_CHECK = 32  # frames between two checks of the clock while receiving


@njit(inline="always")
def _send_command(port: CanopenPort, controlword: int, target: int) -> int:
    """Send the RPDO. Returns 0, or -errno."""
    frame = port.command_frame
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
    memory[ANSWERED] = 0
    memory[ANSWERED_TWICE] = 0
    memory[EXPECTED] = 0
    if memory[CONTROLLER_OFF] != 0:
        return -ENETDOWN
    if memory[RETURNING] != 0:
        result = _send_command(port, CONTROL_QUICK_STOP, 0)
        if result != 0:
            return result
        memory[RETURNING] = 0
    result = send_frame(port, port.sync_frame.ctypes.data)
    if result == 0:
        memory[EXPECTED] = port.answer_mask
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


@port_housekeeping.register(CanopenPort)  # type: ignore[attr-defined, untyped-decorator]
@njit(inline="always")
def _housekeeping(port: CanopenPort, tick: int) -> int:
    now_ns = monotonic_ns(port.scratch)
    slot = next_service_frame(port.queue, now_ns)
    if port.feedback[0]["bus_off"] != 0:
        drop_service_frames(port.queue)
        return 0
    if now_ns >= port.memory[NEXT_HEARTBEAT_NS]:
        if send_frame(port, port.heartbeat_frame.ctypes.data) == 0:
            port.memory[NEXT_HEARTBEAT_NS] = now_ns + port.heartbeat_period_ns
        return 0
    if slot >= 0 and send_frame(port, port.queue.frames[slot].ctypes.data) == 0:
        service_frame_sent(port.queue)
    return 0

"""A port for benchmarks: the CANopen port as it is, and a drive that answers within the loop's own thread.

The other end of the bus is served between SYNC and reception, outside the time that is measured. So a cycle is what the
loop itself does, SYNC to housekeeping, and every pass sees the same feedback, tick by tick.
"""

from __future__ import annotations

import math
import socket
import struct
from typing import Any, NamedTuple

import numpy as np

from fffo_drive.can import frame as can
from fffo_drive.can.link import Link, free_loopback_port, open_link
from fffo_drive.control.reference import Profile
from fffo_drive.drive.canopen import cyclic  # noqa: F401  registers the kernels
from fffo_drive.drive.canopen.config import CanopenDriveConfig
from fffo_drive.drive.canopen.port_memory import CanopenPort, make_port
from fffo_drive.drive.canopen.service_queue import ServiceQueue
from fffo_drive.drive.port import (
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sleep_until,
    port_sync,
)
from fffo_drive.jit import njit
from fffo_drive.jit.libc import MSG_DONTWAIT, monotonic_ns, recv, send
from fffo_drive.units import NS_PER_S
from fffo_drive.workflows.plan import Plan

STATUS_EVERY = 10  # SYNCs between answers with statusword and current
ENABLED_STATUSWORD = 0x1637  # operation enabled
DELAY_TICKS = 6  # of the velocity that the drive reports behind its reference
WANDER_COUNTS, WANDER_HZ = 20.0, 5.0  # of the position, so that there is something to hold at rest

# words
CYCLE = 0  # number of the cycle under way
MARK_NS = 1  # when the part under way began; 0: none
CLOCK_NS = 2  # what the loop reads as the time where nothing paces it: the deadline, so that passes are alike
PORT_WORDS = 3


class CyclePort(NamedTuple):
    """The compiled side: a CANopen port, and a drive on the other end of its sockets."""

    feedback: Any  # that of `canopen`, where the loop looks for it
    canopen: CanopenPort
    peer_rx_fd: int
    peer_tx_fd: int
    paced: int  # 1: sleep until each deadline; 0: one cycle after the other
    motion: np.ndarray[Any, np.dtype[np.uint8]]  # (n, 16) TPDO1 of tick k in row k modulo n
    status: np.ndarray[Any, np.dtype[np.uint8]]  # (16,) TPDO2
    received: np.ndarray[Any, np.dtype[np.uint8]]  # (16,) what the drive hears
    words: np.ndarray[Any, np.dtype[np.int64]]  # (PORT_WORDS,)
    cycles_ns: np.ndarray[Any, np.dtype[np.int64]]  # (cycles,) time of each cycle; the loop's last one is not closed


@njit(inline="always")
def _close_part(port: CyclePort) -> int:
    """Add the time since the mark to the cycle under way. Returns the time."""
    now_ns = monotonic_ns(port.canopen.scratch)
    if port.words[MARK_NS] > 0:
        port.cycles_ns[port.words[CYCLE]] += now_ns - port.words[MARK_NS]
    return now_ns


@njit(inline="always")
def _answer(port: CyclePort, tick: int) -> int:
    """The drive: hear what was sent, answer the SYNC. Returns the number of frames heard."""
    heard = 0
    while recv(port.peer_rx_fd, port.received.ctypes.data, can.FRAME_SIZE, MSG_DONTWAIT) == can.FRAME_SIZE:
        heard += 1
    send(port.peer_tx_fd, port.motion[tick % port.motion.shape[0]].ctypes.data, can.FRAME_SIZE, MSG_DONTWAIT)
    if tick % STATUS_EVERY == 0:
        send(port.peer_tx_fd, port.status.ctypes.data, can.FRAME_SIZE, MSG_DONTWAIT)
    return heard


@port_now_ns.register(CyclePort)  # type: ignore[attr-defined]
@njit(inline="always")
def _now_ns(port: CyclePort) -> int:
    now_ns = port_now_ns(port.canopen)
    return now_ns if port.paced != 0 else int(port.words[CLOCK_NS])


@port_sleep_until.register(CyclePort)  # type: ignore[attr-defined]
@njit(inline="always")
def _sleep_until(port: CyclePort, deadline_ns: int) -> int:
    now_ns = _close_part(port)
    if port.words[MARK_NS] > 0:
        port.words[CYCLE] += 1
    port.words[CLOCK_NS] = deadline_ns
    if port.paced != 0:
        port_sleep_until(port.canopen, deadline_ns)
        now_ns = monotonic_ns(port.canopen.scratch)
    port.words[MARK_NS] = now_ns
    return 0


@port_sync.register(CyclePort)  # type: ignore[attr-defined]
@njit(inline="always")
def _sync(port: CyclePort, tick: int) -> int:
    result = port_sync(port.canopen, tick)
    _close_part(port)
    _answer(port, tick)
    port.words[MARK_NS] = monotonic_ns(port.canopen.scratch)
    return result


@port_receive.register(CyclePort)  # type: ignore[attr-defined]
@njit(inline="always")
def _receive(port: CyclePort, tick: int, cutoff_ns: int) -> int:
    return port_receive(port.canopen, tick, cutoff_ns)


@port_command.register(CyclePort)  # type: ignore[attr-defined]
@njit(inline="always")
def _command(port: CyclePort, tick: int, controlword: int, current_a: float) -> float:
    return port_command(port.canopen, tick, controlword, current_a)


@port_housekeeping.register(CyclePort)  # type: ignore[attr-defined]
@njit(inline="always")
def _housekeeping(port: CyclePort, tick: int, tripped: bool) -> int:
    return port_housekeeping(port.canopen, tick, tripped)


class Ends(NamedTuple):
    """Descriptors of a bus with two participants, and what keeps them open."""

    rx_fd: int
    tx_fd: int
    peer_rx_fd: int
    peer_tx_fd: int
    owners: tuple[socket.socket | Link, ...]

    def close(self) -> None:
        """Close all."""
        for owner in self.owners:
            owner.close()


def socket_pair() -> Ends:
    """Two sockets that hand packets to each other: the cheapest calls, so that the loop's own work counts most."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    return Ends(ours.fileno(), ours.fileno(), theirs.fileno(), theirs.fileno(), (ours, theirs))


def loopback_bus() -> Ends:
    """The loopback bus of the package."""
    spec = f"loopback:{free_loopback_port()}"
    ours, theirs = open_link(spec), open_link(spec)
    return Ends(ours.rx_fd, ours.tx_fd, theirs.rx_fd, theirs.tx_fd, (ours, theirs))


def drive_config(plan: Plan) -> CanopenDriveConfig:
    """The drive of a plan, which must be a CANopen one."""
    period_ns = NS_PER_S // plan.axis.loop.rate_hz
    config: CanopenDriveConfig = plan.axis.drive.drive_config(plan.model.torque_constant_nm_per_a, period_ns)  # type: ignore[union-attr]
    return config


def cycle_port(config: CanopenDriveConfig, ends: Ends, profile: Profile, cycles: int, paced: bool) -> CyclePort:
    """A port whose drive follows the profile late and with a little noise (the same in every pass)."""
    canopen = make_port(config, ends, ServiceQueue(NS_PER_S).memory)  # type: ignore[arg-type]
    status = can.pack_frame(config.answers[1].cob_id, struct.pack("<Hh", ENABLED_STATUSWORD, 25))
    return CyclePort(
        feedback=canopen.feedback,
        canopen=canopen,
        peer_rx_fd=ends.peer_rx_fd,
        peer_tx_fd=ends.peer_tx_fd,
        paced=int(paced),
        motion=_motion(config, profile),
        status=np.frombuffer(status, np.uint8).copy(),
        received=np.zeros(can.FRAME_SIZE, np.uint8),
        words=np.zeros(PORT_WORDS, np.int64),
        cycles_ns=np.full(cycles + 1, 0, np.int64),  # filled, so that no page faults in the loop
    )


def _motion(config: CanopenDriveConfig, profile: Profile) -> np.ndarray[Any, np.dtype[np.uint8]]:
    velocity_rps = np.roll(profile.values, DELAY_TICKS)
    velocity_rps += np.random.default_rng(1).normal(0.0, 0.008, velocity_rps.size)
    velocity = np.round(velocity_rps * config.velocity_units_per_rps).astype("<i4")
    travel_rev = np.cumsum(profile.values) * profile.period_s
    time_s = np.arange(travel_rev.size) * profile.period_s
    travel_rev += WANDER_COUNTS / config.counts_per_rev * np.sin(2.0 * math.pi * WANDER_HZ * time_s)
    position = np.round(travel_rev * config.counts_per_rev).astype("<i4")
    frames = np.zeros((velocity.size, can.FRAME_SIZE), np.uint8)
    frames[:] = np.frombuffer(can.pack_frame(config.answers[0].cob_id, bytes(8)), np.uint8)
    frames[:, 8:12] = velocity.view(np.uint8).reshape(-1, 4)
    frames[:, 12:16] = position.view(np.uint8).reshape(-1, 4)
    return frames

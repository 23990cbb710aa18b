"""The loop, its CANopen port and a simulated drive's node on one fake clock: bad days, to the nanosecond.

Runs without compilation (`tests/interpreted.py`), where the compiled loop and this one agree bit for bit. `run_loop`,
the law, the envelope and the whole port are the product's; the wire between them and the node is a script. Only the
functions that touch the machine (clock, waiting, send) are replaced.
"""

from __future__ import annotations

import heapq
import socket
import struct
from collections.abc import Callable
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from node.node_rig import RigidBody

from fffo_drive.can.frame import Frame, pack_frame, unpack_frame
from fffo_drive.config.axis import controller_config, envelope_config, loop_config, read_axis
from fffo_drive.control.friction_observer import TOGGLE_OFF
from fffo_drive.control.reference import MODE_VELOCITY, Profile
from fffo_drive.drive.canopen import cyclic, receiving, sending
from fffo_drive.drive.canopen.config import CanopenDriveConfig
from fffo_drive.drive.canopen.port_memory import make_port
from fffo_drive.drive.canopen.service_queue import ServiceQueue
from fffo_drive.drive.cia402 import GOAL_ENABLED
from fffo_drive.drive.port import (
    exchange_counts,
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sleep_until,
    port_sync,
)
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.core import Node
from fffo_drive.evaluation.metrics import tick_statistics
from fffo_drive.model.parameters import read_model
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime.loop import run_loop
from fffo_drive.runtime.ring import new_ring

PERIOD_NS = 500_000
NS_PER_MS = 1_000_000
FLIGHT_NS = 90_000  # from one end of the wire to the other: arbitration, frame, interrupt
COMPUTING_NS = 20_000  # between two looks at the clock at the end of a tick
NODE = 1
TPDO1, TPDO2, RPDO1, EMERGENCY, SYNC, HEARTBEAT = 0x181, 0x281, 0x201, 0x081, 0x080, 0x701

KERNEL_SEND = sending.send

Wire = Callable[[Frame, bytes, int], list[tuple[int, bytes]]]  # frame, its bytes, flight time -> (delay, bytes)


class EndlessEnd:
    """One end of the link, for `make_port`."""

    def __init__(self, end: socket.socket) -> None:
        self.rx_fd = self.tx_fd = end.fileno()


class World:
    """Host and drive. `to_drive` and `to_host` are the wire; `stalls` maps the number of a sleep to its delay."""

    def __init__(self, plant: Any = None, config: NodeConfig | None = None) -> None:
        self.now_ns = 1_000_000_000
        self.host_end, self.wire_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for end in (self.host_end, self.wire_end):
            end.setblocking(False)
        self.to_drive: Wire = lambda frame, raw, flight_ns: [(flight_ns, raw)]
        self.to_host: Wire = lambda frame, raw, flight_ns: [(flight_ns, raw)]
        self.stalls: dict[int, int] = {}
        self.refusal = 0  # errno of the kernel for what the host sends; 0: it takes frames
        self.at: list[tuple[int, Callable[[World], None]]] = []  # (tick, what happens at its SYNC), in order
        self.tick = -1
        self.sent: list[tuple[int, Frame]] = []  # what the kernel took: (tick, frame)
        self.torques: list[tuple[int, int]] = []  # what the drive applies: (tick, 0x6071)
        self.blocks: b.Blocks  # of the loop, once it lives
        self._order = count()
        self._flying: list[tuple[int, int, bool, bytes]] = []
        self._sleeps = 0
        self.node = Node(config or NodeConfig(sync_loss_tolerance_ms=50), plant or RigidBody())
        self._boot()

    # --- the drive

    def _boot(self) -> None:
        self._answer(self.node.start(self.now_ns))
        for index, sub, value, size in SET_UP:
            data = struct.pack("<BHBI", {1: 0x2F, 2: 0x2B, 4: 0x23}[size], index, sub, value & (1 << 8 * size) - 1)
            answer = self.node.handle(pack_frame(0x600 + NODE, data), self.now_ns)
            assert unpack_frame(answer[-1]).data[0] == 0x60, (hex(index), sub)
        self._answer(self.node.handle(pack_frame(0, bytes([1, NODE])), self.now_ns))
        self.advance_to(self.now_ns + NS_PER_MS)
        while self._host_receives():
            pass

    def _host_receives(self) -> bool:
        try:
            return bool(self.host_end.recv(16))
        except BlockingIOError:
            return False

    def _answer(self, frames: list[bytes]) -> None:
        for raw in frames:
            for delay_ns, arriving in self.to_host(unpack_frame(raw), raw, FLIGHT_NS):
                self._fly(delay_ns, False, arriving)

    # --- time

    def _fly(self, delay_ns: int, to_drive: bool, raw: bytes) -> None:
        heapq.heappush(self._flying, (self.now_ns + delay_ns, next(self._order), to_drive, raw))

    def advance_to(self, until_ns: int, readable: bool = False) -> None:
        """Let time pass; with `readable`, only until a frame reaches the host."""
        while True:
            landing_ns = self._flying[0][0] if self._flying else until_ns + 1
            due_ns = min(landing_ns, self.node.deadline_ns)
            if due_ns > until_ns:
                self.now_ns = max(self.now_ns, until_ns)
                return
            self.now_ns = max(self.now_ns, due_ns)
            if landing_ns > due_ns:
                self._answer(self.node.poll(self.now_ns))
                continue
            _, _, to_drive, raw = heapq.heappop(self._flying)
            if to_drive:
                self._answer(self.node.handle(raw, self.now_ns))
                self.torques.append((self.tick, self.node.od.number(0x6071)))
            else:
                self.wire_end.send(raw)
                if readable:
                    return

    def sleep_until(self, deadline_ns: int) -> None:
        """The host sleeps; the drive does not."""
        self.advance_to(max(deadline_ns, self.now_ns) + self.stalls.get(self._sleeps, 0))
        self._sleeps += 1

    def wait_readable(self, timeout_ns: int) -> int:
        """ppoll."""
        before_ns = self.now_ns
        if self.wire_end_has_sent():
            return 1
        self.advance_to(before_ns + timeout_ns, readable=True)
        return int(self.wire_end_has_sent())

    def wire_end_has_sent(self) -> bool:
        """Something waits for the host."""
        try:
            return bool(self.host_end.recv(16, socket.MSG_PEEK))
        except BlockingIOError:
            return False

    def take(self) -> None:
        """What the host has sent starts to fly."""
        while True:
            try:
                raw = self.wire_end.recv(16)
            except BlockingIOError:
                return
            frame = unpack_frame(raw)
            self.sent.append((self.tick, frame))
            for delay_ns, arriving in self.to_drive(frame, raw, FLIGHT_NS):
                self._fly(delay_ns, True, arriving)

    def say(self, can_id: int, data: bytes = bytes(8), **flags: bool) -> None:
        """Somebody puts a frame on the bus."""
        self.wire_end.send(pack_frame(can_id, data, **flags))

    def tell(self, raw: bytes) -> None:
        """Somebody says something to the drive."""
        self._answer(self.node.handle(raw, self.now_ns))


SET_UP = (
    (0x1006, 0, 500, 4), (0x60C2, 1, 5, 1), (0x60C2, 2, -4, 1),
    (0x1400, 1, 0x80000201, 4), (0x1400, 2, 1, 1), (0x1600, 0, 0, 1), (0x1600, 1, 0x60400010, 4),
    (0x1600, 2, 0x60710010, 4), (0x1600, 0, 2, 1), (0x1400, 5, 20, 2), (0x1400, 1, 0x201, 4),
    (0x1401, 1, 0x80000301, 4),
    (0x1800, 1, 0xC0000181, 4), (0x1800, 2, 1, 1), (0x1A00, 0, 0, 1), (0x1A00, 1, 0x606C0020, 4),
    (0x1A00, 2, 0x60640020, 4), (0x1A00, 0, 2, 1), (0x1800, 1, 0x40000181, 4),
    (0x1801, 1, 0xC0000281, 4), (0x1801, 2, 10, 1), (0x1A01, 0, 0, 1), (0x1A01, 1, 0x60410010, 4),
    (0x1A01, 2, 0x60770010, 4), (0x1A01, 0, 2, 1), (0x1801, 1, 0x40000281, 4),
    (0x1802, 1, 0xC0000381, 4), (0x1802, 2, 255, 1), (0x1802, 3, 20, 2), (0x1A02, 0, 0, 1), (0x1A02, 1, 0x60410010, 4),
    (0x1A02, 0, 1, 1), (0x1802, 1, 0x40000381, 4),
    (0x1017, 0, 50, 2), (0x1016, 1, 127 << 16 | 150, 4), (0x6007, 0, 3, 2), (0x605A, 0, 2, 2), (0x6060, 0, 10, 1),
)  # fmt: skip


class WorldPort(NamedTuple):
    """The product's port in this world."""

    feedback: Any
    inner: Any
    world: Any


SYNC_KERNEL, RECEIVE_KERNEL, COMMAND_KERNEL, HOUSEKEEPING_KERNEL = (
    cyclic._sync, cyclic._receive, cyclic._command, cyclic._housekeeping,
)  # fmt: skip


@port_now_ns.register(WorldPort)
def now_ns(port):
    return port.world.now_ns


@port_sleep_until.register(WorldPort)
def sleep_until(port, deadline_ns):
    port.world.sleep_until(deadline_ns)
    return 0


@port_sync.register(WorldPort)
def sync(port, tick):
    world = port.world
    world.tick = tick
    while world.at and world.at[0][0] <= tick:
        world.at.pop(0)[1](world)
    result = SYNC_KERNEL(port.inner, tick)
    world.take()
    return result


@port_receive.register(WorldPort)
def receive(port, tick, cutoff_ns):
    return RECEIVE_KERNEL(port.inner, tick, cutoff_ns)


@port_command.register(WorldPort)
def command(port, tick, controlword, current_a):
    port.world.advance_to(port.world.now_ns + COMPUTING_NS)
    sent = COMMAND_KERNEL(port.inner, tick, controlword, current_a)
    port.world.take()
    return sent


@port_housekeeping.register(WorldPort)
def housekeeping(port, tick, tripped):
    HOUSEKEEPING_KERNEL(port.inner, tick, tripped)
    port.world.take()
    return 0


class Day(NamedTuple):
    """What came of it."""

    world: World
    rows: np.ndarray
    statistics: dict[str, float]
    trip: int


def ramp_to(velocity_rps: float, step_rps: float, ticks: int) -> Profile:
    """Constant acceleration, then constant velocity."""
    values = np.minimum(np.arange(ticks) * step_rps, velocity_rps)
    return Profile("ramp", MODE_VELOCITY, PERIOD_NS * 1e-9, values, np.gradient(values, PERIOD_NS * 1e-9))


def live(
    world: World, ticks: int = 400, axis_file: str = "bad_days/axis.yaml", profile: Profile | None = None,
    change: Callable[[Any], Any] = lambda envelope: envelope, silence: int = 0, afterwards_ns: int = 0,
) -> Day:  # fmt: skip
    """Run the loop in the world: enabled at once, a profile of constant acceleration and then constant velocity.

    `change` makes another envelope of the file's. `silence`: LoopConfig.supervisor_ticks. The drive lives on for
    `afterwards_ns` when the loop has ended.
    """
    from interpreted import TESTS

    axis = read_axis(TESTS / axis_file)
    model = read_model(TESTS / "bad_input" / "files" / "model.yaml")
    section = axis.drive
    config: CanopenDriveConfig = section.drive_config(model.torque_constant_nm_per_a, PERIOD_NS)
    inner = make_port(config, EndlessEnd(world.host_end), ServiceQueue(10_000_000_000).memory)
    _replace_machine(world)
    port = WorldPort(inner.feedback, inner, world)
    blocks = world.blocks = b.new_blocks(controller_config(axis, model), 2 * ticks)
    blocks.control[b.GOAL] = GOAL_ENABLED
    blocks.control[b.TOGGLE] = TOGGLE_OFF
    b.publish_profile(blocks, profile or ramp_to(2.0, 0.02, 2 * ticks))
    ring = new_ring(4 * ticks)
    scratch = np.zeros((2, b.CONTROLLER_BLOCK_SIZE))
    loop = loop_config(axis)._replace(max_ticks=ticks, supervisor_ticks=silence)
    run_loop(port, loop, change(envelope_config(axis)), blocks, scratch, ring, world.now_ns + PERIOD_NS)
    world.advance_to(world.now_ns + afterwards_ns)
    rows = RingReader(ring).read().rows
    statistics = tick_statistics(rows, exchange_counts(port.feedback))._asdict()
    for end in (world.host_end, world.wire_end):
        end.close()
    return Day(world, rows, statistics, int(rows["trip"][-1]))


def _replace_machine(world: World) -> None:
    """Clock, waiting and the kernel's decision about a frame are the world's."""

    def send(fd, address, length, flags):
        return -world.refusal if world.refusal else KERNEL_SEND(fd, address, length, flags)

    sending.send = send
    for module in (cyclic, receiving):
        module.monotonic_ns = lambda scratch: world.now_ns
    cyclic.wait_readable = lambda scratch, fd, timeout_ns: world.wait_readable(timeout_ns)

"""The simulated drive as a process on a bus: a thin shell around `core.Node` with a clock and a link.

One thread: wait for a frame or the node's next deadline, let the node act, send. A rehearsal runs all code beforehand,
so that nothing is compiled while the bus waits.
"""

from __future__ import annotations

import dataclasses
import gc
import os
import resource
import signal
import struct
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from ....can.frame import RPDO1, SDO_REQUEST, SYNC, pack_frame
from ....can.link import Link, LinkError
from ....canopen_node.bus import NS_PER_MS
from ....canopen_node.inbox import BOXED, Box, Inbox, wait_for_frame
from ....canopen_node.sync import STATISTICS
from ....units import NS_PER_S
from ..cia402_device import STATE_NAMES
from .config import NodeConfig
from .core import Node
from .personality import Personality
from .simulated_plant import SimulatedPlant

HIGHEST_PRIORITY = 49  # below the control loop's and the kernel's interrupt threads
RUNAWAY_US = 500_000  # the kernel ends a FIFO process that has not slept for so long
RETRY_S = 0.01  # while the interface is down
DROPS_EVERY_NS = NS_PER_S
_RLIMIT_RTTIME = 15  # linux/resource.h; the module has no name for it
_SCHED_RESET_ON_FORK = 0x40000000


class NodeSummary(NamedTuple):
    """What a run of the node was."""

    duration_s: float
    syncs: int
    missed_syncs: int  # where 0x1006 gives the period
    rpdos: int
    dropped_frames: int  # lost by the receive queue; -1: unknown
    send_errors: int
    state: str  # of the CiA 402 machine, at the end

    def __str__(self) -> str:
        return (
            f"{self.duration_s:.1f} s, {self.syncs} SYNC ({self.missed_syncs} missed), "
            f"{self.rpdos} RPDO applied, {self.dropped_frames} frames dropped, "
            f"{self.send_errors} send errors, ended in state {self.state!r}"
        )


def stop_on_signals() -> threading.Event:
    """An event that SIGTERM and SIGINT set. For the main thread."""
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    return stop


def run_node(config: NodeConfig, link: Link, stop: threading.Event) -> NodeSummary:
    """Run the node on `link` until `stop` is set. Prints a line when it is ready and one when it ends.

    Raises PlantConfigError for a configuration that makes no drive.
    """
    config.validate()
    if sys.stdout.isatty():
        print("simulated drive: starting; the first start compiles for a while", flush=True)
    rehearse(config)
    node = Node(config, SimulatedPlant(config.plant))
    shell = _Shell(node, link)
    with _realtime(config.realtime_priority), _settled_memory():
        shell.begin()
        print(f"simulated drive: node {config.node_id} on {link.spec} ready", flush=True)
        shell.run(stop)
    summary = shell.summary()
    print(f"simulated drive: node {config.node_id} on {link.spec}: {summary}", flush=True)
    return summary


def rehearse(config: NodeConfig) -> None:
    """Enable, turn and stop a drive with this plant without a bus, which compiles everything."""
    plain = dataclasses.replace(config, personality=Personality(), dictionary=None)
    node = Node(plain, SimulatedPlant(config.plant))
    now_ns = 0
    node.start(now_ns)
    request = SDO_REQUEST + config.node_id
    node.handle(pack_frame(request, struct.pack("<BHBi", 0x2F, 0x6060, 0, 10)), now_ns)
    node.handle(pack_frame(0, bytes([1, config.node_id])), now_ns)
    for word in (0x06, 0x0F, 0x0F, 0x02):  # shutdown, enable operation, a turn, quick stop
        node.handle(pack_frame(RPDO1 + config.node_id, struct.pack("<H", word)), now_ns)
        node.handle(pack_frame(request, struct.pack("<BHBi", 0x2B, 0x6071, 0, 500)), now_ns)
        now_ns += 20 * NS_PER_MS
        node.handle(pack_frame(SYNC), now_ns)
        node.poll(now_ns)
    wait_for_frame(-1, Inbox().memory, 0)


class _Shell:
    """The loop and its counters."""

    def __init__(self, node: Node, link: Link) -> None:
        self.node, self.link = node, link
        self.send_errors = 0
        self.dropped = 0
        self._started_ns = self._drops_ns = time.monotonic_ns()
        self._inbox = Inbox()
        self._boxes: tuple[Box, ...] = ()
        self._bus_present = True

    def begin(self) -> None:
        """Boot-up."""
        self._started_ns = self._drops_ns = time.monotonic_ns()
        self._send(self.node.start(self._started_ns))

    def run(self, stop: threading.Event) -> None:
        """Until `stop`; looks at it at least every 10 ms."""
        node, inbox = self.node, self._inbox
        while not stop.is_set():
            if node.boxes is not self._boxes:
                self._boxes = node.boxes
                inbox.arrange(self._boxes)
            result = wait_for_frame(self.link.rx_fd, inbox.memory, node.deadline_ns)
            if result >= BOXED:
                self._open_boxes()
                result -= BOXED
            if result > 0:
                self._send(node.handle(inbox.frame(result), time.monotonic_ns()))
            elif result < 0:
                self._lose_bus()
            elif not self._bus_present:
                self._probe()
            now_ns = time.monotonic_ns()
            if now_ns >= node.deadline_ns:  # after each frame: a full bus must not stop the node's own time
                self._send(node.poll(now_ns))
            if now_ns - self._drops_ns > DROPS_EVERY_NS:
                self._count_drops(now_ns)

    def _open_boxes(self) -> None:
        """Hand over the frames that wait for a SYNC, with their times of arrival."""
        for arrival_ns, frame in self._inbox.waiting():
            self._send(self.node.handle(frame, arrival_ns))

    def _lose_bus(self) -> None:
        """The interface is down or gone."""
        self._note_bus(False)
        time.sleep(RETRY_S)

    def _probe(self) -> None:
        """See whether the interface is back."""
        try:
            frame = self.link.receive(0.0)
        except LinkError:
            self._lose_bus()
            return
        self._note_bus(True)
        if frame is not None:
            self._send(self.node.handle(frame, time.monotonic_ns()))

    def _send(self, frames: list[bytes]) -> None:
        for frame in frames:
            try:
                self.link.send(frame)
            except LinkError:
                self.send_errors += 1

    def _note_bus(self, present: bool) -> None:
        if present is not self._bus_present:
            self._bus_present = present
            self._send(self.node.bus_changed(present, time.monotonic_ns()))

    def _count_drops(self, now_ns: int) -> None:
        self._drops_ns = now_ns
        self.dropped = self.link.dropped_frames()
        od = self.node.od
        od.put(od.place(STATISTICS), 5, max(0, self.dropped))

    def summary(self) -> NodeSummary:
        """The run so far."""
        now_ns = time.monotonic_ns()
        self._count_drops(now_ns)
        number, statistics = self.node.od.number, self.node.od.place(STATISTICS)
        return NodeSummary(
            duration_s=(now_ns - self._started_ns) / NS_PER_S,
            syncs=number(statistics, 1),
            missed_syncs=number(statistics, 2),
            rpdos=number(statistics, 3),
            dropped_frames=self.dropped,
            send_errors=self.send_errors,
            state=STATE_NAMES[self.node.drive.state],
        )


@contextmanager
def _settled_memory() -> Iterator[None]:
    """Exempt existing objects from garbage collection: numba's heap would take it tens of milliseconds."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@contextmanager
def _realtime(priority: int) -> Iterator[None]:
    """SCHED_FIFO if requested and allowed; a refusal is reported once."""
    if priority <= 0:
        yield
        return
    wanted = min(priority, HIGHEST_PRIORITY)
    before = resource.getrlimit(_RLIMIT_RTTIME)
    try:
        resource.setrlimit(_RLIMIT_RTTIME, (RUNAWAY_US, before[1]))
        os.sched_setscheduler(0, os.SCHED_FIFO | _SCHED_RESET_ON_FORK, os.sched_param(wanted))
    except (PermissionError, ValueError) as error:
        print(f"simulated drive: runs without SCHED_FIFO {wanted}: {error}", flush=True)
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        resource.setrlimit(_RLIMIT_RTTIME, before)

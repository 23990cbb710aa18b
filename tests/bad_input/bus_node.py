"""The simulated drive's node on a loopback bus, in a thread of the test, and a witness of all that was asked of it."""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
from collections.abc import Callable

from node.node_rig import RigidBody

from fffo_drive.can.frame import RPDO1, SDO_REQUEST, Frame, unpack_frame
from fffo_drive.can.link import open_link
from fffo_drive.drive.simulated.cia402_device import OPERATION_ENABLED
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.core import Node

NS_PER_MS = 1_000_000
CONTROLWORD, TARGET_TORQUE = 0x6040, 0x6071
ENABLE_OPERATION = 0x0F


class BusNode:
    """`prepare` gets the node before it boots (to refuse a write, say), `after_boot` after it."""

    body = RigidBody

    def __init__(
        self,
        bus: str,
        config: NodeConfig | None = None,
        prepare: Callable[[Node], None] | None = None,
        after_boot: Callable[[Node], None] | None = None,
    ) -> None:
        self.plant = self.body()
        self.node = Node(config or NodeConfig(), self.plant)
        if prepare is not None:
            prepare(self.node)
        self._after_boot = after_boot
        self.heard: list[Frame] = []
        self.states: set[int] = set()
        self._link = open_link(bus)
        self._wake, self._waker = socket.socketpair()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> BusNode:
        self._send(self.node.start(time.monotonic_ns()))
        if self._after_boot is not None:
            self._after_boot(self.node)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._waker.send(b".")
        self._thread.join(10.0)
        for end in (self._wake, self._waker):
            end.close()
        self._link.close()

    def _run(self) -> None:
        poller = select.poll()
        poller.register(self._link.rx_fd, select.POLLIN)
        poller.register(self._wake, select.POLLIN)
        while True:
            left_ms = max(0.0, (self.node.deadline_ns - time.monotonic_ns()) / NS_PER_MS)
            if any(fd == self._wake.fileno() for fd, _ in poller.poll(left_ms)):
                return
            while (raw := self._link.receive(0.0)) is not None:
                self.heard.append(unpack_frame(raw))
                self._send(self.node.handle(raw, time.monotonic_ns()))
                self.states.add(self.node.drive.state)
            self._send(self.node.poll(time.monotonic_ns()))
            self.states.add(self.node.drive.state)

    def _send(self, frames: list[bytes]) -> None:
        for frame in frames:
            self._link.send(frame)

    def provocations(self) -> list[str]:
        """Everything that could have moved the axis: what was asked for, what the drive did, what the shaft felt."""
        found = [text for frame in self.heard if (text := self._provocation(frame))]
        if OPERATION_ENABLED in self.states:
            found.append("the drive was in Operation Enabled")
        if any(self.plant.torque_seen):
            found.append("a current flowed")
        return found

    def _provocation(self, frame: Frame) -> str | None:
        node_id = self.node.config.node_id
        if frame.can_id == RPDO1 + node_id and len(frame.data) == 4:
            controlword, torque = struct.unpack("<Hh", frame.data)
            if torque or controlword & ENABLE_OPERATION == ENABLE_OPERATION:
                return f"RPDO: controlword {controlword:#06x}, torque {torque}"
        elif frame.can_id == SDO_REQUEST + node_id and frame.data[0] >> 5 == 1:
            index, value = struct.unpack_from("<H", frame.data, 1)[0], struct.unpack_from("<i", frame.data, 4)[0]
            enables = index == CONTROLWORD and value & ENABLE_OPERATION == ENABLE_OPERATION
            if enables or (index == TARGET_TORQUE and value):
                return f"SDO: 0x{index:04X} = {value}"
        return None

"""A daemon in a thread of the test, and the simulated drive's node in another, on a loopback bus of their own.

Supervisor, API, server, loop and drive are the product's; what a process is needed for (signals, the service manager)
is in test_process.py. The axis forgives a shared machine its pauses; nothing is asserted about time.
"""

from __future__ import annotations

import asyncio
import io
import math
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from bad_input.bus_node import BusNode
from interpreted import TESTS
from node.node_rig import RigidBody

from fffo_drive.can.link import free_loopback_port
from fffo_drive.daemon.client import DaemonClient
from fffo_drive.daemon.journal import Journal
from fffo_drive.daemon.methods import Api
from fffo_drive.daemon.places import CONTROL, WATCH
from fffo_drive.daemon.server import Server
from fffo_drive.daemon.supervisor import TURN_S, Supervisor
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.core import Node
from fffo_drive.drive.simulated.node.faults import Fault
from fffo_drive.workflows.plan import make_plan

FILES = TESTS / "bad_input" / "files"
PATIENCE_S = 60.0
RATE_HZ = 500

PATIENT: dict[str, Any] = {
    "loop": {"rate_hz": RATE_HZ, "longest_profile_s": 30},
    "realtime": {"priority": 0, "lock_memory": False, "required": False},
    "profile": {"kind": "sine", "duration_s": 20, "amplitude": 1, "frequency_hz": 0.5},
}
PATIENT_DRIVE = {"heartbeat_timeout_ms": 5000, "command_timeout_ms": 5000, "listen_s": 0.1}
PATIENT_LIMITS = {
    "feedback_missing_ticks": 5000, "accept_runaway": True, "status_missing_ticks": 5000, "heartbeat_timeout_s": 20,
    "following_error_s": 20,
}  # fmt: skip
PATIENT_DAEMON = {"supervisor_timeout_s": 20, "retry_s": 0.05, "stop_timeout_s": 20, "enable_timeout_s": 20}


def axis_file(directory: Path, **daemon: Any) -> Path:
    """A patient axis with these keys of its daemon section, in a directory of its own."""
    directory.mkdir(parents=True, exist_ok=True)
    shutil.copy(FILES / "model.yaml", directory)
    axis = yaml.safe_load((FILES / "bus.yaml").read_text())
    axis.update(PATIENT)
    axis["drive"].update(PATIENT_DRIVE)
    axis["envelope"].update(PATIENT_LIMITS)
    axis["recording"] = {"directory": str(directory / "runs")}
    axis["daemon"] = {**PATIENT_DAEMON, **daemon}
    return write(directory / "axis.yaml", axis)


def write(path: Path, content: dict[str, Any]) -> Path:
    """YAML."""
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def edit(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Change an axis file as somebody with an editor would."""
    content = yaml.safe_load(path.read_text())
    change(content)
    write(path, content)


class BodyWithFriction(RigidBody):
    """Without torque it comes to rest, as an axis does."""

    friction_rps2 = 1.0

    def advance(self, until_ns: int, current_a: float) -> None:
        lost_rps = self.friction_rps2 * (until_ns - self._time_ns) / 1e9
        super().advance(until_ns, current_a)
        self.velocity_rps -= math.copysign(min(lost_rps, abs(self.velocity_rps)), self.velocity_rps)


class CommandedNode(BusNode):
    """A node that can be given calls to run on its own thread, between two frames."""

    body = BodyWithFriction

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._todo: deque[Callable[[Node], object]] = deque()

    def tell(self, what: Callable[[Node], object]) -> None:
        """Soon."""
        self._todo.append(what)

    def _send(self, frames: list[bytes]) -> None:
        super()._send(frames)
        while self._todo:
            self._todo.popleft()(self.node)


class Rig:
    """A daemon and, unless `drive` is false, a node with these faults from its boot on."""

    def __init__(
        self, directory: Path, *, drive: bool = True, uncommissioned: bool = True,
        faults: tuple[Fault, ...] = (), **daemon: Any,
    ) -> None:  # fmt: skip
        self.path = axis_file(directory / "axis", **daemon)
        self.bus = f"loopback:{free_loopback_port()}"
        self.sockets = directory / "s"
        self.journal = io.StringIO()
        self.node = self.new_node(faults) if drive else None
        self._uncommissioned = uncommissioned
        self._clients: list[DaemonClient] = []
        self._opened = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._live, daemon=True)

    def new_node(self, faults: tuple[Fault, ...] = ()) -> CommandedNode:
        """A drive on this bus."""
        return CommandedNode(self.bus, NodeConfig(sync_loss_tolerance_ms=10_000, faults=faults))

    def __enter__(self) -> Rig:
        if self.node is not None:
            self.node.__enter__()
        self._thread.start()
        assert self._opened.wait(PATIENCE_S)
        if self._error is not None:
            raise self._error
        return self

    def __exit__(self, *_: object) -> None:
        for client in self._clients:
            client.close()
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(PATIENCE_S)
        if self.node is not None:
            self.node.__exit__()
        if self._error is not None:
            raise self._error

    def _live(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            self._error = error
            self._opened.set()

    async def _serve(self) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        plan = make_plan(self.path)
        self.supervisor = Supervisor(plan, Journal({}, self.journal), self.bus, self._uncommissioned)
        self.api = Api(self.supervisor)
        self.server = Server(self.api, self.sockets, plan.axis.daemon.clients)
        await self.server.open(plan.axis.daemon.control_group)
        living = asyncio.create_task(self.supervisor.run())
        self._opened.set()
        while not self._stop.is_set() and self.supervisor.fatal is None:
            self.supervisor.turn()
            self.server.turn()
            await asyncio.sleep(TURN_S)
        await self.supervisor.close()
        await living
        await self.server.close()
        if self.supervisor.fatal is not None:
            raise self.supervisor.fatal

    def do(self, what: Callable[[], Any]) -> Any:
        """Run something on the daemon's own thread, between two turns."""

        async def call() -> Any:
            return what()

        return asyncio.run_coroutine_threadsafe(call(), self._loop).result(PATIENCE_S)

    def client(self, *, watching: bool = False) -> DaemonClient:
        """A connection, closed with the rig."""
        client = DaemonClient(self.sockets / (WATCH if watching else CONTROL), PATIENCE_S)
        self._clients.append(client)
        return client

    def until(self, state: str, client: DaemonClient | None = None) -> dict[str, Any]:
        """Wait for a state. Returns the status."""
        return self.until_status(lambda status: status["state"] == state, client)

    def until_status(
        self, condition: Callable[[dict[str, Any]], bool], client: DaemonClient | None = None
    ) -> dict[str, Any]:
        """Wait for a status that is so; the time to compile the loop, once on a machine, is not counted."""
        client = client or self.client(watching=True)
        deadline_s = time.monotonic() + PATIENCE_S
        status = client.call("status")
        while not condition(status):
            if any("compiles" in obstacle for obstacle in status["obstacles"]):
                deadline_s = time.monotonic() + PATIENCE_S
            assert time.monotonic() < deadline_s, status
            time.sleep(0.02)
            status = client.call("status")
        return status

    def events(self, kind: str) -> list[dict[str, Any]]:
        """What happened of this kind."""
        found = self.client(watching=True).call("events", limit=1000)["events"]
        return [event for event in found if event["kind"] == kind]

"""`fffo-drive serve` as a process: signals, the service manager, exit codes, and a death that nobody could prevent."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from daemon.rig import PATIENCE_S, CommandedNode, axis_file, edit
from interpreted import TESTS

from fffo_drive.can.link import free_loopback_port
from fffo_drive.cli import main
from fffo_drive.daemon.client import ClientError, DaemonClient
from fffo_drive.daemon.places import CONTROL
from fffo_drive.drive.simulated.cia402_device import OPERATION_ENABLED
from fffo_drive.drive.simulated.node.config import NodeConfig

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]


class Process:
    """A daemon, its drive, and a service manager that listens."""

    def __init__(self, directory: Path) -> None:
        self.axis = axis_file(directory / "axis", retry_s=0.2)
        edit(self.axis, lambda axis: axis["drive"].update(command_timeout_ms=1000, heartbeat_timeout_ms=3000))
        self.sockets = directory / "s"
        self.bus = f"loopback:{free_loopback_port()}"
        self.notices: list[str] = []
        self._manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._manager.bind(str(directory / "n"))
        self._manager.setblocking(False)
        self._notify = str(directory / "n")
        self._log = directory / "log"

    def __enter__(self) -> Process:
        self.node = CommandedNode(self.bus, NodeConfig(sync_loss_tolerance_ms=10_000)).__enter__()
        command = [sys.executable, "-m", "fffo_drive", "serve", str(self.axis), "--bus", self.bus]
        environment = dict(os.environ, PYTHONPATH=str(TESTS), NOTIFY_SOCKET=self._notify, WATCHDOG_USEC="1000000")
        environment.pop("RUNTIME_DIRECTORY", None)
        with self._log.open("w") as log:
            self.process = subprocess.Popen(
                [*command, "--sockets", str(self.sockets), "--uncommissioned"], stderr=log, env=environment
            )
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.node.__exit__()
        self._manager.close()

    @property
    def log(self) -> str:
        return self._log.read_text()

    def listen(self) -> list[str]:
        """Everything that the service manager was told."""
        with contextlib.suppress(BlockingIOError):
            while True:
                self.notices.append(self._manager.recv(4096).decode())
        return self.notices

    def wait(self, condition: Callable[[], object]) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline_s, self.log
            time.sleep(0.02)

    def client(self) -> DaemonClient:
        self.wait(lambda: self._answers() or self.process.poll() is not None)
        return DaemonClient(self.sockets / CONTROL, PATIENCE_S)

    def _answers(self) -> bool:
        try:
            DaemonClient(self.sockets / CONTROL, PATIENCE_S).close()
        except ClientError:
            return False
        return True

    def run_a_profile(self) -> DaemonClient:
        client = self.client()
        self.wait(lambda: client.call("status")["state"] == "ready")
        client.call("enable")
        client.act("start", profile="default")
        self.wait(lambda: client.call("status")["profile"]["sample"] > 100)
        assert self.node.node.drive.state == OPERATION_ENABLED
        return client


@pytest.fixture
def daemon(tmp_path) -> Iterator[Process]:
    with Process(tmp_path) as process:
        yield process


def test_its_life_as_the_service_manager_sees_it(daemon):
    with daemon.run_a_profile() as client:
        daemon.wait(lambda: "WATCHDOG=1" in daemon.listen())
        daemon.wait(lambda: any(line.startswith("STATUS=running sine") for line in daemon.listen()))
        assert daemon.notices[0] == "READY=1"
        edit(daemon.axis, lambda axis: axis["controller"].update(proportional_a_per_rps=0.9))
        daemon.process.send_signal(signal.SIGHUP)
        daemon.wait(lambda: daemon.listen().count("READY=1") == 2)
        assert any(line.startswith("RELOADING=1\nMONOTONIC_USEC=") for line in daemon.notices)
        assert client.call("info")["keys"]["controller.proportional_a_per_rps"] == 0.9
        daemon.axis.write_text("rubbish: [")
        daemon.process.send_signal(signal.SIGHUP)
        daemon.wait(lambda: daemon.listen().count("READY=1") == 3)
        assert client.call("status")["state"] == "running"
        assert "not reloaded, all goes on as it was" in daemon.log
    daemon.process.send_signal(signal.SIGTERM)  # in the middle of a profile
    assert daemon.process.wait(PATIENCE_S) == 0
    assert "STOPPING=1" in daemon.listen()
    assert daemon.node.node.drive.state != OPERATION_ENABLED
    assert not any(daemon.node.plant.torque_seen[-3:])
    assert "running -> stopping (disable)" in daemon.log
    assert "stopping -> ready (torque_off)" in daemon.log
    assert not daemon.sockets.exists() or not list(daemon.sockets.iterdir())


def test_killed_it_leaves_a_drive_that_stops_by_itself(daemon):
    with daemon.run_a_profile():
        daemon.process.kill()
        daemon.wait(lambda: daemon.node.node.drive.state != OPERATION_ENABLED)
        daemon.wait(lambda: not any(daemon.node.plant.torque_seen[-3:]))


def test_stopped_and_continued_it_is_in_fault_and_gives_no_torque(daemon):
    with daemon.run_a_profile() as client:
        daemon.process.send_signal(signal.SIGSTOP)
        daemon.wait(lambda: daemon.node.node.drive.state != OPERATION_ENABLED)
        daemon.process.send_signal(signal.SIGCONT)
        daemon.wait(lambda: client.call("status")["state"] == "fault")
        daemon.wait(lambda: not any(daemon.node.plant.torque_seen[-3:]))
        assert daemon.node.node.drive.state != OPERATION_ENABLED


def test_a_bad_file_exits_78_and_a_second_daemon_74(daemon, tmp_path, capsys):
    bad = tmp_path / "bad.yaml"
    bad.write_text("name: x\n")
    assert main(["serve", str(bad)]) == 78
    assert "bad.yaml:1" in capsys.readouterr().err
    assert main(["serve", str(TESTS / "bad_input" / "files" / "axis.yaml")]) == 78
    assert "drive.kind" in capsys.readouterr().err
    daemon.client().close()
    assert main(["serve", str(daemon.axis), "--bus", daemon.bus, "--sockets", str(daemon.sockets)]) == 74
    assert "another daemon" in capsys.readouterr().err
    assert daemon.process.poll() is None


def test_real_time_properties_that_are_required_and_refused_exit_77_before_anything_is_connected(tmp_path, capsys):
    axis = axis_file(tmp_path)
    edit(axis, lambda content: content["realtime"].update(cpu=100_000, required=True))
    assert main(["serve", str(axis), "--bus", f"loopback:{free_loopback_port()}", "--sockets", str(tmp_path)]) == 77
    assert "CPU 100000 for the loop" in capsys.readouterr().err

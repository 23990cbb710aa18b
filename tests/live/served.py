"""`fffo-drive serve` with the scope beside the simulated drive: two processes, as a user has them.

A slow loop on a plant that SYNC steps, with most of the period for the answer: it controls well on a machine that has
no time for it, too. The axis forgives pauses, and nothing is asserted about time.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from daemon.rig import PATIENCE_S, axis_file, edit, write
from interpreted import TESTS

from fffo_drive.can.frame import EMERGENCY, pack_frame
from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.daemon.client import DaemonClient
from fffo_drive.daemon.places import CONTROL
from fffo_drive.live.places import TOKEN_FILE, URL_FILE
from fffo_drive.workflows.simulated_process import SimulatedProcess

CONFIGS = TESTS.parent / "configs"
RATE_HZ = 100
SINE = {"kind": "sine", "duration_s": 100, "amplitude": 2, "frequency_hz": 0.5}
GENTLE = {"proportional_a_per_rps": 0.1, "integral_a_per_rev": 0.3, "accept_unproven": True}
START_S = 180.0  # until it listens, and from the end of its compiling on


class Served:
    """An axis that is served; `client` commands it beside the page."""

    def __init__(self, directory: Path) -> None:
        self.axis = axis_file(directory / "axis")
        edit(self.axis, self._prepare)
        drive = yaml.safe_load((CONFIGS / "simulated_drive.yaml").read_text())
        drive.update(step_by_sync=True, sync_loss_tolerance_ms=60_000, realtime_priority=0)
        self.bus = f"loopback:{free_loopback_port()}"
        self.sockets = directory / "s"
        self._drive = SimulatedProcess(write(directory / "drive.yaml", drive), self.bus)
        self._log = directory / "log"
        self.client: DaemonClient | None = None

    @staticmethod
    def _prepare(axis: dict[str, Any]) -> None:
        axis["loop"] |= {"rate_hz": RATE_HZ, "cutoff_share": 0.9, "longest_profile_s": 120}
        axis["controller"] |= GENTLE
        axis["controller"]["observer"]["gain_nm_per_rev"] = 0.1
        axis["profile"] = SINE
        # a page on a machine without time renews a jog in time, and is heard
        axis["daemon"] |= {"set_points": {"jog_timeout_s": 5}, "client_silence_s": 20}

    def __enter__(self) -> Served:
        self._drive.__enter__()
        command = [sys.executable, "-m", "fffo_drive", "serve", str(self.axis), "--bus", self.bus, "--uncommissioned"]
        environment = dict(os.environ, PYTHONPATH=str(TESTS))
        with self._log.open("w") as log:
            self.process = subprocess.Popen(
                [*command, "--sockets", str(self.sockets), "--scope", "0", "--foxglove", "0"],
                stderr=log, env=environment,
            )  # fmt: skip
        try:
            self.until(lambda: (self.sockets / TOKEN_FILE).exists(), START_S)
            self.client = DaemonClient(self.sockets / CONTROL, PATIENCE_S)
            self.until(lambda: self.state == "ready", START_S, self._compiles)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        if self.client is not None:
            self.client.close()
        self.process.terminate()
        try:
            self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()
            self._drive.__exit__(None, None, None)

    @property
    def log(self) -> str:
        return self._log.read_text()

    @property
    def url(self) -> str:
        return (self.sockets / URL_FILE).read_text().strip()

    @property
    def key(self) -> str:
        return (self.sockets / TOKEN_FILE).read_text().strip()

    @property
    def state(self) -> str:
        state: str = self.client.call("status")["state"]
        return state

    def _compiles(self) -> bool:
        """Whether its loop is still compiled: minutes where the cache is empty and others compile beside it."""
        return any("compiles" in obstacle for obstacle in self.client.call("status")["obstacles"])

    def until(
        self, condition: Callable[[], bool], patience_s: float = PATIENCE_S, works: Callable[[], bool] = lambda: False
    ) -> None:
        """Wait for something that a process does; the time in which it is known to work is not counted."""
        deadline_s = time.monotonic() + patience_s
        while not condition():
            if works():
                deadline_s = time.monotonic() + patience_s
            assert self.process.poll() is None, self.log
            assert time.monotonic() < deadline_s, self.log
            time.sleep(0.05)

    def rest(self) -> None:
        """No torque, no fault, friction from the reference."""
        if self.state not in ("ready", "connected", "fault"):
            self.client.call("quick_stop")
        if self.state == "fault":
            self.client.call("reset_fault")
        self.until(lambda: self.state == "ready")
        self.client.call("toggle", to="ff")

    def run(self) -> None:
        """The sine runs."""
        self.rest()
        self.client.call("enable")
        self.client.act("start", profile="default")

    def break_down(self) -> None:
        """An emergency message in the drive's name: overcurrent."""
        with open_link(self.bus) as link:
            link.send(pack_frame(EMERGENCY + 1, bytes([0x10, 0x23, 0x03, 0, 0, 0, 0, 0])))

"""The axis behind a benchmark of the daemon: kept running from pass to pass."""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Callable

from common import Figures

from fffo_drive.daemon.client import CallError, DaemonClient

TRIES = 5


class Axis:
    """The axis behind the passes: it is kept running, and its faults are counted."""

    def __init__(self, client: DaemonClient) -> None:
        self.client = client
        self.faults: defaultdict[str, list[str]] = defaultdict(list)  # names, phase by phase

    @property
    def note(self) -> str:
        """For the report."""
        return f"Faults of the axis: {sum(map(len, self.faults.values())) or 'none'} {json.dumps(self.faults)}."

    def undisturbed(self, phase: str, take: Callable[[], Figures]) -> Figures:
        """A pass during which the axis ran. One with a fault in it is counted and taken again."""
        for _ in range(TRIES):
            self.keep_running(phase)
            figures = take()
            if self.keep_running(phase):
                return figures
        raise RuntimeError(f"no pass without a fault: {dict(self.faults)}")

    def keep_running(self, phase: str) -> bool:
        """Again after the end of a profile, and after a fault. Returns whether there was none."""
        faults = len(self.faults[phase])
        for _ in range(TRIES):
            try:
                self._go_on(phase)
                return len(self.faults[phase]) == faults
            except CallError:  # a fault came between two calls
                time.sleep(1.0)
        raise RuntimeError(f"the axis does not keep running: {dict(self.faults)}")

    def _go_on(self, phase: str) -> None:
        status = self.client.call("status")
        if status["state"] == "fault":
            self.faults[phase].append(status["fault"]["name"])
            self.client.call("reset_fault")
        if status["state"] != "running":
            if self.client.call("status")["state"] != "enabled":
                self.client.call("enable")
            self.client.act("start", profile="default")

"""The simulated drive as a process of its own, started and watched by a command that needs one."""

from __future__ import annotations

import contextlib
import select
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType

from ..drive.port import BusUnavailableError

START_TIMEOUT_S = 600.0  # the first start compiles the plant: half a minute, or minutes on a busy machine
STOP_TIMEOUT_S = 5.0


class SimulatedProcess:
    """`fffo-drive sim` on a bus, from entry to exit of the context."""

    def __init__(self, file: Path, bus: str) -> None:
        self._command = [sys.executable, "-m", "fffo_drive", "sim", str(file), "--bus", bus]
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> SimulatedProcess:
        self._process = subprocess.Popen(self._command, stdout=subprocess.PIPE, text=True)
        try:
            self._wait_until_ready(self._process)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._end()

    def check(self) -> None:
        """Raises BusUnavailableError when the process has ended."""
        if self._process is not None and self._process.poll() is not None:
            raise BusUnavailableError(f"the simulated drive ended with exit code {self._process.returncode}")

    def _wait_until_ready(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            readable, _, _ = select.select([process.stdout], [], [], 0.2)
            if readable:
                line = process.stdout.readline()
                if "ready" in line:
                    return
                if not line:
                    process.wait()
            self.check()
        raise BusUnavailableError(f"the simulated drive was not ready within {START_TIMEOUT_S:g} s")

    def _end(self) -> None:
        process = self._process
        if process is None:
            return
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(STOP_TIMEOUT_S)
        if process.poll() is None:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()

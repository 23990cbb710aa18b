"""The simulated drive with a gate in its clock: the loop waits at a tick until the test has asked for something.

What is asked for between two ticks comes to the loop at the same tick every time: a run is the same, bit for bit.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from commissioning.misdeclared import OPEN_UNTIL, WAITS, wrapped

from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.jit import INTERPRETED
from fffo_drive.jit.atomic import load_acquire, store_release
from fffo_drive.runtime.session import Session, SessionConfig

PATIENCE_S = 60.0


class GatedDrive(SimulatedDrive):
    """The Python side."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.wrapped = wrapped(self.feedback, super().port)
        self.gate = self.wrapped.gate
        self.gate[OPEN_UNTIL] = 0

    @property
    def port(self) -> Any:
        return self.wrapped


class GatedRun:
    """A session whose loop runs for so many ticks at a time; between them it stands, and anything may be asked."""

    def __init__(self, config: SessionConfig, drive: GatedDrive | None = None) -> None:
        self.drive = drive or GatedDrive()
        self.drive.connect()
        self.session = Session(self.drive, config)
        self._open = 0
        self._thread: threading.Thread | None = None

    def begin(self, ticks: int) -> None:
        """A loop of at most so many ticks; it waits before the first."""
        self.session.compile()
        self._thread = threading.Thread(target=self.session.run_ticks, args=(ticks,), daemon=True)
        self._thread.start()
        self._wait()

    def ticks(self, count: int) -> None:
        """Let the loop run on for so many ticks."""
        self._open += count
        store_release(self.drive.gate, OPEN_UNTIL, self._open)
        self._wait()

    def end(self) -> None:
        """Let the loop run to its end."""
        assert self._thread is not None
        store_release(self.drive.gate, OPEN_UNTIL, np.iinfo(np.int64).max)
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()

    def _wait(self) -> None:
        assert self._thread is not None
        thread = self._thread
        until(lambda: load_acquire(self.drive.gate, WAITS) > self._open or not thread.is_alive())


def until(condition: Callable[[], bool]) -> None:
    """Give the loop's thread the processor until it is so."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.001 if INTERPRETED else 0.0001)

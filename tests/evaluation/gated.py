"""The simulated drive with a gate in its clock: the loop waits at a tick until the test has asked for something.

What is asked for between two ticks comes to the loop at the same tick every time: a run is the same, bit for bit.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fffo_drive.drive.port import (
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sleep_until,
    port_sync,
)
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.jit import INTERPRETED, njit
from fffo_drive.jit.atomic import load_acquire, store_release
from fffo_drive.runtime.session import Session, SessionConfig

OPEN_UNTIL, WAITS = 0, 1  # how many ticks may begin; how many have begun, and 1 more where the loop waits
PATIENCE_S = 60.0


class GatedPort(NamedTuple):
    """The compiled side."""

    feedback: Any
    drive: Any  # SimulatedPort
    gate: Any  # (2,) int64


@port_now_ns.register(GatedPort)
@njit
def _now_ns(port):
    return port_now_ns(port.drive)


@port_sleep_until.register(GatedPort)
@njit
def _sleep_until(port, deadline_ns):
    begun = port.gate[WAITS] + 1
    store_release(port.gate, WAITS, begun)
    while load_acquire(port.gate, OPEN_UNTIL) < begun:
        pass
    return port_sleep_until(port.drive, deadline_ns)


@port_sync.register(GatedPort)
@njit
def _sync(port, tick):
    return port_sync(port.drive, tick)


@port_receive.register(GatedPort)
@njit
def _receive(port, tick, cutoff_ns):
    return port_receive(port.drive, tick, cutoff_ns)


@port_command.register(GatedPort)
@njit
def _command(port, tick, controlword, current_a):
    return port_command(port.drive, tick, controlword, current_a)


@port_housekeeping.register(GatedPort)
@njit
def _housekeeping(port, tick, tripped):
    return port_housekeeping(port.drive, tick, tripped)


class GatedDrive(SimulatedDrive):
    """The Python side."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.gate = np.zeros(2, np.int64)

    @property
    def port(self) -> Any:
        return GatedPort(self.feedback, super().port, self.gate)


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

"""The simulated drive in process on the wall's clock: what a live run leaves in the ring, without a bus."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fffo_drive.drive.port import (
    Drive,
    DriveIdentity,
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sleep_until,
    port_sync,
)
from fffo_drive.drive.simulated.in_process import CLOCK_NS, SYNC_NS, SimulatedDrive, SimulatedPort
from fffo_drive.drive.simulated.state import SUBSTEP, SUBSTEPS_PER_S
from fffo_drive.jit import njit
from fffo_drive.jit.libc import EINTR, monotonic_ns, sleep_until


class PacedPort(NamedTuple):
    """A simulated port whose clock is CLOCK_MONOTONIC."""

    feedback: Any  # that of `simulated`, where the loop looks for it
    simulated: SimulatedPort
    scratch: np.ndarray[Any, np.dtype[np.int64]]


@port_now_ns.register(PacedPort)  # type: ignore[attr-defined]
@njit
def _now_ns(port: PacedPort) -> int:
    return monotonic_ns(port.scratch)


@port_sleep_until.register(PacedPort)  # type: ignore[attr-defined]
@njit
def _sleep_until(port: PacedPort, deadline_ns: int) -> int:
    while sleep_until(port.scratch, deadline_ns) == EINTR:
        pass
    return 0


@port_sync.register(PacedPort)  # type: ignore[attr-defined]
@njit
def _sync(port: PacedPort, tick: int) -> int:
    port.simulated.words[CLOCK_NS] = monotonic_ns(port.scratch)
    return port_sync(port.simulated, tick)


@port_receive.register(PacedPort)  # type: ignore[attr-defined]
@njit
def _receive(port: PacedPort, tick: int, cutoff_ns: int) -> int:
    return port_receive(port.simulated, tick, cutoff_ns)


@port_command.register(PacedPort)  # type: ignore[attr-defined]
@njit
def _command(port: PacedPort, tick: int, controlword: int, current_a: float) -> float:
    return port_command(port.simulated, tick, controlword, current_a)


@port_housekeeping.register(PacedPort)  # type: ignore[attr-defined]
@njit
def _housekeeping(port: PacedPort, tick: int, tripped: bool) -> int:
    return port_housekeeping(port.simulated, tick, tripped)


class PacedDrive:
    """A `Drive` around a simulated one."""

    def __init__(self, drive: SimulatedDrive) -> None:
        self._drive = drive
        self.port = PacedPort(drive.feedback, drive.port, np.zeros(2, np.int64))

    def connect(self) -> DriveIdentity:
        """Power-on is now, on the wall's clock."""
        now_ns = port_now_ns(self.port)
        words = self._drive.port.words
        words[CLOCK_NS] = words[SYNC_NS] = now_ns
        self._drive.port.state.words[SUBSTEP] = now_ns * (SUBSTEPS_PER_S // 1000) // 1_000_000
        return self._drive.connect()

    @property
    def feedback(self) -> Any:
        """The port's memory."""
        return self._drive.feedback

    @property
    def realtime(self) -> bool:
        """The clock is the wall's."""
        return True

    def close(self) -> None:
        """Leave the drive without torque."""
        self._drive.close()


def paced(drive: Drive) -> PacedDrive:
    """A simulated drive on the wall's clock. Raises TypeError for another one."""
    if not isinstance(drive, SimulatedDrive):
        raise TypeError(f"{type(drive).__name__}: only a simulated drive can be paced")
    return PacedDrive(drive)

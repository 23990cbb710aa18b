"""What the doctor says: one line a subject, how bad it is, and what to type."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class Severity(StrEnum):
    """How bad it is."""

    OK = "ok"
    WARNING = "warning"  # works, with more late ticks than need be, or could not be found out
    FAILURE = "failure"  # this loop at this rate will not work


class HostFinding(NamedTuple):
    """One line. `remedy`: what to type or to write where; empty when nothing is to be done."""

    subject: str
    level: Severity
    text: str
    remedy: str = ""


class Wanted(NamedTuple):
    """What the loop of an axis asks of the machine. Defaults are those of an axis file."""

    rate_hz: int = 2000
    priority: int = 60  # SCHED_FIFO; 0: ordinary scheduling
    cpu: int = -1  # -1: the last one that this process may use; -2: not pinned
    lock_memory: bool = True
    bus: str | None = None  # socketcan:NAME, loopback:PORT; None: not known, or the drive is simulated in process
    bitrate_hz: int = 1_000_000
    late_share: float = 0.2  # of the period: lateness from which a tick counts as late

    @property
    def period_us(self) -> float:
        """Length of a tick."""
        return 1e6 / self.rate_hz


def ok(subject: str, text: str) -> HostFinding:
    """Nothing to be done."""
    return HostFinding(subject, Severity.OK, text)


def warning(subject: str, text: str, remedy: str) -> HostFinding:
    """Goes on, and could be better."""
    return HostFinding(subject, Severity.WARNING, text, remedy)


def failure(subject: str, text: str, remedy: str) -> HostFinding:
    """Will not work."""
    return HostFinding(subject, Severity.FAILURE, text, remedy)

"""Real-time properties of the loop's thread: SCHED_FIFO, one CPU, locked pages. A refusal is reported once."""

from __future__ import annotations

import ctypes
import os
import threading
from typing import NamedTuple

PR_SET_TIMERSLACK = 29
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4

_C = ctypes.CDLL(None, use_errno=True)


class RealtimeRequest(NamedTuple):
    """Properties requested by the configuration."""

    priority: int  # SCHED_FIFO priority 1..99; 0: ordinary scheduling
    cpu: int  # CPU to pin the loop to; -1: the last one that this process may use; -2: do not pin
    lock_memory: bool


class RealtimeReport(NamedTuple):
    """Properties granted by the system. `refusals` has one sentence for each refused property."""

    fifo: bool
    cpu: int  # -1: not pinned
    locked: bool
    refusals: tuple[str, ...]


class RealtimeRefusedError(Exception):
    """Real-time properties were required by the configuration and refused by the system."""


def enter_realtime(request: RealtimeRequest) -> RealtimeReport:
    """Give the calling thread real-time properties. Call it in the loop's thread, before the first tick.

    Threads that it would start fall back to ordinary scheduling (SCHED_RESET_ON_FORK): a recorder never inherits FIFO.
    """
    refusals: list[str] = []
    _C.prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)  # the default of 50 us is added to every sleep of an ordinary thread
    cpu = _pin(request.cpu, refusals)
    locked = request.lock_memory and _lock_memory(refusals)
    fifo = request.priority > 0 and _set_fifo(request.priority, refusals)
    return RealtimeReport(fifo, cpu, locked, tuple(refusals))


def require_realtime(request: RealtimeRequest) -> None:
    """Raise RealtimeRefusedError for properties that the system would refuse, before seconds of connecting.

    Tried on a thread that ends at once. It unlocks the memory again, so do not call it while a loop is running.
    """
    reports: list[RealtimeReport] = []
    thread = threading.Thread(target=lambda: reports.append(enter_realtime(request)))
    thread.start()
    thread.join()
    if request.lock_memory:
        unlock_memory()
    if reports and reports[0].refusals:
        raise RealtimeRefusedError("; ".join(reports[0].refusals))


def _pin(cpu: int, refusals: list[str]) -> int:
    if cpu == -2:
        return -1
    allowed = os.sched_getaffinity(0)
    if len(allowed) < 2 and cpu == -1:
        return -1  # pinned to the only one anyhow
    chosen = max(allowed) if cpu == -1 else cpu
    try:
        os.sched_setaffinity(0, {chosen})
    except OSError as error:
        refusals.append(f"CPU {chosen} for the loop: {error.strerror}; allowed here: {sorted(allowed)}")
        return -1
    return chosen


def _set_fifo(priority: int, refusals: list[str]) -> bool:
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError as error:
        refusals.append(
            f"SCHED_FIFO {priority}: {error.strerror}; grant it with LimitRTPRIO= in the unit or "
            f"'rtprio {priority}' in limits.conf"
        )
        return False
    return True


def _lock_memory(refusals: list[str]) -> bool:
    """Lock pages once touched; the warm-up has touched all pages that the loop needs."""
    if _C.mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) != 0:
        reason = os.strerror(ctypes.get_errno())
        refusals.append(f"mlockall: {reason}; grant it with LimitMEMLOCK=infinity in the unit or 'memlock unlimited'")
        return False
    return True


def unlock_memory() -> None:
    """Undo mlockall for the process, so that it does not affect what runs after the loop."""
    _C.munlockall()

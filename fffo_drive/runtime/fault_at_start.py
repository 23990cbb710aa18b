"""A drive that is in fault at the start: the fault is named, and cleared by one reset if the user asked for that."""

from __future__ import annotations

import time
from collections.abc import Callable

from ..drive.cia402 import STATE_FAULT, STATUS_FAULT, state_of
from ..drive.port import NMT_OPERATIONAL, DriveRefusedError
from .session import Session

FIRST_STATUS_S = 1.0  # for the first statusword
RESET_S = 2.0  # for a fault reaction to end, and for the drive to leave fault
POLL_S = 0.02


def clear_fault(session: Session, reset: bool, command: str) -> str:
    """The fault that was cleared, in words; empty if the drive was in none. The loop of `session` runs.

    With `reset` bit 7 of the controlword rises once (CiA 402 transition 15), as for `ctl reset-fault`; without, the
    refusal names `command`, which does it. Nothing is enabled. Raises DriveRefusedError.
    """
    feedback = session.drive.port.feedback
    _wait(session, lambda: int(feedback["status_tick"][0]) >= 0, FIRST_STATUS_S)
    statusword = int(feedback["statusword"][0])
    if not statusword & STATUS_FAULT or int(feedback["status_tick"][0]) < 0:
        return ""
    words = session.drive.fault_words(statusword)
    if not reset:
        raise DriveRefusedError(f"the drive is in fault ({words}): remove the cause, then clear it with `{command}`")
    _wait(session, lambda: state_of(int(feedback["statusword"][0])) == STATE_FAULT, RESET_S)
    session.reset_fault()
    if not _wait(session, lambda: not int(feedback["statusword"][0]) & STATUS_FAULT, RESET_S):
        words = session.drive.fault_words()
        if int(feedback["nmt_state"][0]) not in (NMT_OPERATIONAL, -1):
            raise DriveRefusedError(
                f"the drive did not hear the reset ({words}): it is not operational; run the command again"
            )
        raise DriveRefusedError(f"the drive stays in fault after a reset ({words}): its cause is still there")
    return f"fault cleared: {words}"


def _wait(session: Session, condition: Callable[[], bool], timeout_s: float) -> bool:
    """Until a condition holds, the loop ends, or the time is over. True when it holds."""
    deadline_s = time.monotonic() + timeout_s
    while not condition() and session.running and time.monotonic() < deadline_s:
        time.sleep(POLL_S)
    return condition()

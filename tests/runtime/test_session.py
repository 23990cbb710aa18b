"""The loop's thread from outside: how it is asked to end, and what happens when it does not."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable

import pytest
from daemon.rig import PATIENCE_S, CommandedNode, axis_file

from fffo_drive.can.link import free_loopback_port
from fffo_drive.canopen_node.nmt import NmtState
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.jit import INTERPRETED
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime import session as sessions
from fffo_drive.runtime.realtime import RealtimeRefusedError, RealtimeRequest, require_realtime
from fffo_drive.runtime.session import LoopHungError, Session
from fffo_drive.units import NS_PER_S
from fffo_drive.workflows.plan import make_plan, open_drive, plan_session

pytestmark = [pytest.mark.slow, pytest.mark.realtime]


def until(condition: Callable[[], object]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def test_a_loop_that_hangs_is_reported_in_bounded_time_and_the_drive_is_left_without_it(tmp_path, monkeypatch):
    """It sleeps for an hour before its first tick; after a tick it might still see that it has to end."""
    monkeypatch.setattr(sessions, "STOP_TIMEOUT_S", 0.2)
    monkeypatch.setattr(sessions, "START_AHEAD_NS", 3600 * NS_PER_S)
    plan = make_plan(axis_file(tmp_path))
    bus = f"loopback:{free_loopback_port()}"
    config = plan_session(plan)
    with CommandedNode(bus, NodeConfig(sync_loss_tolerance_ms=10_000)) as node:
        drive = open_drive(plan, bus)
        drive.connect()
        session = Session(drive, config)
        session.start()
        assert node.node.nmt.state is NmtState.OPERATIONAL
        with pytest.raises(LoopHungError, match="this process has to end"):
            session.close()
        assert session.running
        assert session.status(b.FINISHED) == 0
        until(lambda: node.node.nmt.state is NmtState.PRE_OPERATIONAL)  # nothing acknowledges that command
        assert drive.port.feedback is drive.feedback  # what the thread may yet use is still there


def test_what_would_be_refused_is_known_before_anything_is_connected():
    require_realtime(RealtimeRequest(0, -2, False))
    with pytest.raises(RealtimeRefusedError, match="CPU 100000 for the loop"):
        require_realtime(RealtimeRequest(0, 100_000, False))


def test_to_compile_the_loop_takes_no_linear_algebra_and_leaves_it_to_others():
    code = (
        "import sys; from fffo_drive.drive.cia402 import state_of; state_of(0x237);"
        "print('numba' in sys.modules, 'scipy.linalg' in sys.modules);"
        "import scipy.linalg; print(scipy.linalg.det([[2.0]]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.split() == [str(not INTERPRETED), "False", "2.0"]

"""What the supervisor asks of a loop that stands between two ticks: the ramp of a stop, and what its replay says."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from evaluation.asked import AXIS, PERIOD_S, Asked

from fffo_drive.config.axis import feedforward_config
from fffo_drive.control.reference import MODE_VELOCITY, sine
from fffo_drive.daemon.connection import Connection
from fffo_drive.daemon.motion import MotionRequests
from fffo_drive.recording.reader import read_run
from fffo_drive.workflows.replay import replay_files

SINE = sine("sine", MODE_VELOCITY, 1.0, PERIOD_S, 3.0, 2.0)
ROUNDING_RPS = 1e-9


@pytest.mark.parametrize("ticks", [60, 250, 400])  # speeding up, at full speed, slowing down
def test_a_stop_of_a_running_profile_goes_on_from_where_the_reference_came_from(tmp_path, ticks):
    """The error is that of an older reference: where it forgot the one before the stop, it was the whole speed."""
    asked = Asked(tmp_path)
    plan = SimpleNamespace(axis=AXIS, model=asked.model)
    motion = MotionRequests(Connection(1, asked.run.drive, None, asked.session, None))
    asked.ask("toggle", 0.5)
    asked.ask("enable", 0.0)
    asked.run.ticks(40)
    motion.hand(SINE)
    asked.run.ticks(ticks)
    motion.brake(plan)
    ramp = motion.brake_when_settled(plan)
    asked.run.ticks(ramp.values.size + 40)
    files = asked.finish()

    rows = np.concatenate([read_run(file).rows for file in files])
    rows = rows[rows["profile_sample"] >= 0]
    begun = np.flatnonzero(np.diff(rows["profile_number"]))[0] + 1
    assert rows["profile_sample"][begun] == 0
    assert abs(rows["reference_rps"][begun]) > 1.0
    behind_ticks = feedforward_config(AXIS.controller.feedforward, asked.model, PERIOD_S).behind_ticks
    assert behind_ticks > 1.0
    times = rows["tick"].astype(float)
    older = np.interp(times - behind_ticks, times, rows["reference_rps"], left=0.0)
    np.testing.assert_allclose(rows["expected_rps"], older, atol=ROUNDING_RPS)

    report = replay_files(files)
    assert report.exact
    assert (report.profiles.as_asked, report.profiles.other) == (1, 0)  # the ramp; the sine did not run to its end

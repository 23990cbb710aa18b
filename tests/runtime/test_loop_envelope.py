"""What the loop tells the envelope: deadlines that it missed count, with the current that flowed meanwhile."""

from __future__ import annotations

import numpy as np
from runtime.scripted_port import WAKE_DELAY_NS, scripted
from runtime.test_loop import PERIOD_NS, Rig, constant_profile

from fffo_drive.control import envelope as env
from fffo_drive.control.reference import MODE_CURRENT
from fffo_drive.runtime import blocks as b

LIMITS = {"i2t_time_s": 0.02, "feedback_missing_ticks": 1000, "status_missing_ticks": 1000}
TICKS_TO_TRIP = 40  # 10 A, of which 5 A may flow for ever, for 20 ms


def first_trip(missed: int) -> int:
    """Tick of the I2t trip with 10 A from the start, when `missed` deadlines pass after ten ticks."""
    rig = Rig(scripted(200))
    b.publish_profile(rig.blocks, constant_profile(MODE_CURRENT, 10.0, 500))
    rig.port.script[10, WAKE_DELAY_NS] = missed * PERIOD_NS
    rows = rig.run(100, **LIMITS)
    tripped = rows[rows["trip"] == env.TRIP_I2T]
    assert (rows["current_command_a"][rows["trip"] == env.TRIP_NONE] == 10.0).all()
    return int(tripped["tick"][0])


def test_heat_gathers_by_the_clock_and_not_by_the_ticks_that_ran():
    whole = first_trip(0)
    assert abs(whole - TICKS_TO_TRIP) <= 1
    np.testing.assert_array_equal([first_trip(missed) for missed in (1, 10, 25)], [whole] * 3)
    assert first_trip(60) == 10 + 60  # the first tick after the gap

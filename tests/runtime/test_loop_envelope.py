"""What the loop tells the envelope: deadlines that it missed count, with the current that flowed meanwhile."""

from __future__ import annotations

import numpy as np
import pytest
from runtime.scripted_port import STATUSWORD, SWITCH_ON_DISABLED, WAKE_DELAY_NS, scripted
from runtime.test_loop import PERIOD_NS, Rig, constant_profile

from fffo_drive.control import envelope as env
from fffo_drive.control.reference import MODE_CURRENT
from fffo_drive.drive.cia402 import CONTROL_DISABLE_VOLTAGE, CONTROL_ENABLE_OPERATION, CONTROL_SWITCH_ON
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime.tick import FLAG_IGNORES_TARGET, FLAG_LOCAL_CONTROL
from fffo_drive.units import NS_PER_S

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


REMOTE, FOLLOWS, LIMITS_ITSELF = 1 << 9, 1 << 12, 1 << 11
PATIENCE = round(env.UNHEEDED_S * NS_PER_S / PERIOD_NS)


def heeded(statusword: int, served: int = REMOTE | FOLLOWS, ticks: int = PATIENCE + 50) -> np.ndarray:
    """Rows of a drive that says the same thing all the time, with torque wanted."""
    rig = Rig(scripted(ticks))
    rig.port.script[:, STATUSWORD] = statusword
    return rig.run(loop={"served_status_bits": served})


@pytest.mark.parametrize(
    ("statusword", "served", "trip"),
    [
        (0x1637, REMOTE | FOLLOWS, env.TRIP_NONE),
        (0x0637, REMOTE | FOLLOWS, env.TRIP_NOT_FOLLOWING),
        (0x0637, REMOTE, env.TRIP_NONE),  # a drive that never sets bit 12, and the file says so
        (0x0E37, REMOTE | FOLLOWS, env.TRIP_NONE),  # it limits: the row says that
        (0x1437, REMOTE | FOLLOWS, env.TRIP_LOCAL_CONTROL),
        (0x1437, FOLLOWS, env.TRIP_NONE),
        (0x0040, REMOTE | FOLLOWS, env.TRIP_LOCAL_CONTROL),  # before it is enabled
        (0x0240, REMOTE | FOLLOWS, env.TRIP_NONE),
        (0x0000, REMOTE | FOLLOWS, env.TRIP_NONE),  # it still starts
    ],
)
def test_a_drive_that_says_that_it_does_not_heed_us_trips_after_its_time(statusword, served, trip):
    rows = heeded(statusword, served)
    assert rows["trip"][-1] == trip
    assert (rows["trip"][: PATIENCE - 1] == env.TRIP_NONE).all()
    local = rows["flags"] & FLAG_LOCAL_CONTROL != 0
    assert local.all() if trip == env.TRIP_LOCAL_CONTROL else not local.any()
    assert (rows["flags"] & FLAG_IGNORES_TARGET != 0)[: PATIENCE - 1].all() == (trip == env.TRIP_NOT_FOLLOWING)


def test_a_drive_in_local_control_is_not_led_towards_enabled():
    rig = Rig(scripted(200))
    rig.port.script[:100, STATUSWORD] = 0x0031  # ready to switch on, bit 9 is 0
    rig.port.script[100:, STATUSWORD] = 0x0231
    rows = rig.run(loop={"served_status_bits": REMOTE})
    assert (rows["controlword"][:100] == CONTROL_DISABLE_VOLTAGE).all()
    assert (rows["controlword"][100:] == CONTROL_SWITCH_ON).all()
    assert (rows["trip"] == env.TRIP_NONE).all()


def test_the_law_begins_when_the_brake_has_had_its_time():
    ticks, enabled_at, delay = 200, 20, 60
    rig = Rig(scripted(ticks, velocity_rps=-1.0))
    rig.port.script[:enabled_at, STATUSWORD] = SWITCH_ON_DISABLED
    b.publish_profile(rig.blocks, constant_profile(MODE_CURRENT, 3.0, 500))
    rows = rig.run(loop={"enable_delay_ticks": delay})
    begin = enabled_at + delay
    assert (rows["current_command_a"][:begin] == 0.0).all()
    assert (rows["current_command_a"][begin:] == 3.0).all()
    assert (rows["profile_sample"][:begin] == -1).all()
    np.testing.assert_array_equal(rows["profile_sample"][begin:], np.arange(ticks - begin))
    assert (rows["controlword"][enabled_at:] == CONTROL_ENABLE_OPERATION).all()  # the drive opens its brake meanwhile


def test_deadlines_that_were_missed_are_part_of_the_enable_delay():
    rig = Rig(scripted(200))
    rig.port.script[10, WAKE_DELAY_NS] = 30 * PERIOD_NS
    b.publish_profile(rig.blocks, constant_profile(MODE_CURRENT, 3.0, 500))
    rows = rig.run(60, loop={"enable_delay_ticks": 50}, feedback_missing_ticks=1000, status_missing_ticks=1000)
    assert int(rows["tick"][rows["profile_sample"] == 0][0]) == 50


def test_bit_12_is_not_looked_at_while_the_brake_opens():
    rig = Rig(scripted(2 * PATIENCE))
    rig.port.script[: PATIENCE + 20, STATUSWORD] = 0x0637
    rig.port.script[PATIENCE + 20 :, STATUSWORD] = 0x1637
    rows = rig.run(loop={"served_status_bits": FOLLOWS, "enable_delay_ticks": PATIENCE + 10})
    assert (rows["trip"] == env.TRIP_NONE).all()

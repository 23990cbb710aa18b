"""Bad days of the loop on a fake clock: each is in the statistics under its name, and none lets torque through.

The days are in `loop_days.py`; loop, port and drive node run in one interpreter without compilation. What is counted
by the port is also tested frame by frame in tests/canopen; here the whole loop and a drive that reacts stand around it.
"""

from __future__ import annotations

import time

import pytest
from bad_days.table import HEAD, TABLE, all_days, row

from fffo_drive.control import envelope as env
from fffo_drive.drive.port import ExchangeCounts
from fffo_drive.drive.simulated import cia402_device as device
from fffo_drive.evaluation.metrics import TickStatistics
from fffo_drive.jit import libc

pytestmark = pytest.mark.slow

MISSING, LATE, DUPLICATE, BAD = "missing_feedback", "late_feedback", "duplicate_feedback", "bad_frames"
BEGIN, BACK, TICKS = 200, 260, 480
REST = TICKS - BEGIN

# day -> what the statistics say (all else 0), and the trip
COUNTED = {
    "quiet": ({}, env.TRIP_NONE),
    "late": ({MISSING: 1, LATE: 1}, env.TRIP_NONE),
    "a_period_late": ({MISSING: 1, LATE: 1}, env.TRIP_NONE),
    "duplicate": ({LATE: 1, DUPLICATE: 1}, env.TRIP_NONE),
    "reordered": ({MISSING: 1, LATE: 1}, env.TRIP_NONE),
    "missing_once": ({MISSING: 1}, env.TRIP_NONE),
    "missing_for_good": ({MISSING: REST, "nmt_exits": 1}, env.TRIP_FEEDBACK_MISSING),  # put into pre-operational
    "short": ({MISSING: 1, BAD: 1}, env.TRIP_NONE),
    "extended": ({MISSING: 1, BAD: 1}, env.TRIP_NONE),
    "remote": ({MISSING: 1, BAD: 1}, env.TRIP_NONE),
    "sync_lost_once": ({MISSING: 1}, env.TRIP_NONE),
    "sync_lost_for_good": ({MISSING: REST, "nmt_exits": 1}, env.TRIP_FEEDBACK_MISSING),
    "commands_lost": ({"emergency_count": 1}, env.TRIP_EMERGENCY),
    "send_queue_full": ({MISSING: 3, "send_errors": 9}, env.TRIP_NONE),  # SYNC, command, heartbeat
    "interface_gone": (
        {MISSING: BACK - BEGIN, "send_errors": BACK - BEGIN, "bus_losses": 1, "emergency_count": 1}, env.TRIP_BUS_OFF,
    ),
    "bus_off": ({MISSING: BACK - BEGIN, "error_frames": 2, "bus_losses": 1}, env.TRIP_BUS_OFF),
    "bus_off_within_a_tick": ({"error_frames": 2, "bus_losses": 1}, env.TRIP_BUS_OFF),
    "foreign_sync": ({LATE: 1, DUPLICATE: 1, "foreign_frames": 1}, env.TRIP_FOREIGN_COMMAND),
    "stopped_shortly": ({"late": 1, "skipped": 10}, env.TRIP_NONE),
    "stopped_long": ({"skipped": 800, MISSING: REST, "emergency_count": 3, "nmt_exits": 1}, env.TRIP_EMERGENCY),
    "rebooted": ({MISSING: REST, "boot_count": 1}, env.TRIP_REBOOT),
    "pre_operational": ({MISSING: REST, "nmt_exits": 1}, env.TRIP_NOT_OPERATIONAL),
    "stopped_by_nmt": ({MISSING: REST, "nmt_exits": 1}, env.TRIP_NOT_OPERATIONAL),
    "clock_stepped": ({}, env.TRIP_NONE),
}  # fmt: skip
HARMLESS = [day for day, (_, trip) in COUNTED.items() if trip == env.TRIP_NONE]
STOPPED = [day for day, (_, trip) in COUNTED.items() if trip != env.TRIP_NONE]


@pytest.fixture(scope="module")
def days() -> dict[str, dict]:
    return {day["day"]: day for day in all_days()}


@pytest.mark.parametrize("day", COUNTED)
def test_each_day_is_in_the_statistics(days, day):
    assert (days[day]["counts"], days[day]["trip"]) == COUNTED[day]
    assert set(days) == set(COUNTED)


def test_the_statistics_have_a_row_for_every_count_of_the_port():
    assert set(ExchangeCounts._fields) <= set(TickStatistics._fields)
    seen = {name for counts, _ in COUNTED.values() for name in counts}
    assert seen == {"late", "skipped", MISSING, *ExchangeCounts._fields} - {
        "dropped_frames",
        "warning_count",
    }  # see tests/canopen


@pytest.mark.parametrize("day", COUNTED)
def test_feedback_that_did_not_come_in_time_is_never_used(days, day):
    """While the feedback is old the row holds the last value, and two SYNCs keep their distance."""
    assert days[day]["held_but_changed"] == 0
    assert days[day]["smallest_gap"] >= 0.8


@pytest.mark.parametrize("day", HARMLESS)
def test_a_single_event_does_not_stop_the_axis(days, day):
    assert days[day]["drive_state"] == device.OPERATION_ENABLED
    assert days[day]["profile_shift"] == 0  # every tick has the sample of its number, after skipped ones too
    assert days[day]["oldest"] <= 3


@pytest.mark.parametrize("day", STOPPED)
def test_a_stop_is_a_stop(days, day):
    """No torque is asked for from the tick of the trip on, and the drive leaves Operation Enabled."""
    assert days[day]["torque_after_trip"] == 0
    assert days[day]["drive_state"] != device.OPERATION_ENABLED


@pytest.mark.parametrize("day", ["interface_gone", "bus_off"])
def test_no_stale_command_goes_out_when_the_bus_comes_back(days, day):
    """Nothing is sent while it is away; then a stop comes first, so that what the drive still holds does not act."""
    assert days[day]["away"] == []
    assert days[day]["first_back"] == [0x02, 0]
    assert days[day]["applied_back"] == 0
    assert days[day]["trip_tick"] == BEGIN


def test_a_bus_off_that_ends_within_the_tick_is_a_bus_off_all_the_same(days):
    """It is not seen as a state any more: the count of losses trips, and the first frame afterwards is a stop."""
    day = days["bus_off_within_a_tick"]
    assert day["trip_tick"] == BEGIN
    assert day["away"][0] == BEGIN
    assert day["first_command"] == [0x02, 0]


@pytest.mark.parametrize("day", ["pre_operational", "stopped_by_nmt"])
def test_a_drive_that_left_operational_stops_the_axis_when_its_heartbeat_says_so(days, day):
    """Not only when the answers, which ended with it, have been missing for feedback_missing_ticks."""
    assert BEGIN < days[day]["trip_tick"] < days["missing_for_good"]["trip_tick"]
    assert days[day]["trip_tick"] == BEGIN + 2


def test_a_process_that_was_stopped_finds_a_drive_that_stopped_by_itself(days):
    """The first thing that it sends is a quick stop: what came of the drive meanwhile is read before."""
    day = days["stopped_long"]
    assert day["trip_tick"] == BEGIN + 800
    assert day["first_back"] == [0x02, 0]
    assert day["applied_back"] == 0


def test_commands_that_stay_away_are_noticed_by_the_drive_within_its_deadline(days):
    assert days["commands_lost"]["trip_tick"] == BEGIN + 40  # command_timeout_ms: 20


def test_missing_feedback_stops_after_the_set_number(days):
    assert days["missing_for_good"]["trip_tick"] == BEGIN + 9  # feedback_missing_ticks: 10, the first has age 1


def test_a_step_of_the_wall_clock_changes_nothing(days):
    """Why: the loop reads CLOCK_MONOTONIC alone. On that day reading the wall clock was an error; same rows."""
    assert days["clock_stepped"]["rows"] == days["quiet"]["rows"]
    assert libc.CLOCK_MONOTONIC == time.CLOCK_MONOTONIC


def test_each_other_day_leaves_its_trace_in_the_rows(days):
    rows = [day["rows"] for name, day in days.items() if name not in ("clock_stepped", "quiet")]
    assert days["quiet"]["rows"] not in rows
    same = "rows_without_sender"  # a second copy of an answer is named, and changes nothing else
    assert days["duplicate"][same] == days["quiet"][same]


def test_the_table_of_bad_days_is_current(days):
    text = TABLE.read_text(encoding="utf-8")
    assert text == HEAD + "\n".join(map(row, days.values())) + "\n", "write it again: tools/bad_days_table"

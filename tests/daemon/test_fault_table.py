"""The fault table, row by row: who notices, and within which time, on the simulated drive's own clock."""

from __future__ import annotations

import pytest
from daemon.fault_table import GOES_ON, OSCILLATING_MS, QUICK, ROWS, TABLE, markdown, measured
from shared_once import once

from fffo_drive.canopen_node import emcy
from fffo_drive.control import envelope as env
from fffo_drive.drive.simulated.node.objects import OVERCURRENT, RESOLVER

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

SCRIPTED = [row for row in ROWS if row.script is not None]
STOPPING = [row for row in SCRIPTED if row.torque_ms is not None]

# script -> the trip of the envelope, and EMCY of the drive that must be among what it sent
NOTICED = {
    "host_silent": (env.TRIP_EMERGENCY, [emcy.RPDO_TIMEOUT, emcy.HEARTBEAT_LOSS]),
    "host_pauses": (env.TRIP_NONE, []),
    "clock_stepped": (env.TRIP_NONE, []),
    "answers_missing": (env.TRIP_FEEDBACK_MISSING, []),
    "statusword_missing": (env.TRIP_STATUS_MISSING, []),
    "sync_missing": (env.TRIP_FEEDBACK_MISSING, []),
    "commands_missing": (env.TRIP_EMERGENCY, [emcy.RPDO_TIMEOUT]),
    "our_heartbeat_lost": (env.TRIP_EMERGENCY, [emcy.HEARTBEAT_LOSS]),
    "drive_heartbeat_lost": (env.TRIP_HEARTBEAT, []),
    "drive_fault": (env.TRIP_EMERGENCY, [OVERCURRENT]),
    "emergency": (env.TRIP_EMERGENCY, [emcy.MANUFACTURER]),
    "warning": (env.TRIP_NONE, [0xFF42]),
    "local_control": (env.TRIP_LOCAL_CONTROL, []),
    "not_following": (env.TRIP_NOT_FOLLOWING, []),
    "drive_rebooted": (env.TRIP_REBOOT, []),
    "drive_not_operational": (env.TRIP_NOT_OPERATIONAL, []),
    "supply_lost": (env.TRIP_EMERGENCY, []),
    "resolver_lost": (env.TRIP_EMERGENCY, [RESOLVER]),
    "drive_bus_off": (env.TRIP_BUS_OFF, []),
    "bus_off": (env.TRIP_BUS_OFF, []),
    "interface_gone": (env.TRIP_BUS_OFF, []),
    "foreign_sync": (env.TRIP_FOREIGN_COMMAND, []),
    "foreign_command": (env.TRIP_FOREIGN_COMMAND, []),
    "foreign_master": (env.TRIP_FOREIGN_COMMAND, []),
    "foreign_feedback": (env.TRIP_FOREIGN_COMMAND, []),
    "foreign_heartbeat": (env.TRIP_FOREIGN_COMMAND, []),
    "foreign_nmt": (env.TRIP_FOREIGN_COMMAND, []),
    "foreign_sdo": (env.TRIP_FOREIGN_COMMAND, []),
    "keeps_torque_pre_operational": (env.TRIP_NOT_OPERATIONAL, []),
    "keeps_torque_stopped": (env.TRIP_NOT_OPERATIONAL, []),
    "keeps_torque_silent": (env.TRIP_FEEDBACK_MISSING, []),
    "supervisor_silent": (env.TRIP_NONE, []),
    "following_error": (env.TRIP_FOLLOWING_ERROR, []),
    "overspeed": (env.TRIP_OVERSPEED, []),
    "position_window": (env.TRIP_POSITION_WINDOW, []),
    "i2t": (env.TRIP_I2T, []),
    "lost_load": (env.TRIP_FOLLOWING_ERROR, []),
    "lost_load_wide_limit": (env.TRIP_OSCILLATION, []),
    "loose_coupling": (env.TRIP_FOLLOWING_ERROR, []),
    "wrong_inertia": (env.TRIP_OSCILLATION, []),
    "wrong_sign": (env.TRIP_OVERSPEED, []),
    "resonance": (env.TRIP_OVERSPEED, []),
}


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    return once(tmp_path_factory, "faults", measured)


def test_every_script_has_its_expectation(outcomes):
    assert set(outcomes) == set(NOTICED) == {row.script for row in SCRIPTED}


@pytest.mark.parametrize("row", STOPPING, ids=lambda row: row.name)
def test_no_torque_of_ours_acts_and_the_shaft_stands_within_the_bounds(outcomes, row):
    outcome = outcomes[row.script]
    assert not outcome["goes_on"]
    assert outcome["torque_ms"] <= row.torque_ms
    assert outcome["standstill_ms"] <= row.standstill_ms
    assert row.standstill_ms < 2.0 * outcome["standstill_ms"]  # a bound that says something
    assert outcome["torque_ms"] <= outcome["standstill_ms"]


@pytest.mark.parametrize("row", SCRIPTED, ids=lambda row: row.name)
def test_it_is_noticed_by_whom_the_row_says(outcomes, row):
    trip, codes = NOTICED[row.script]
    assert outcomes[row.script]["trip"] == trip
    assert set(codes) <= set(outcomes[row.script]["emcy"])


@pytest.mark.parametrize("row", [row for row in SCRIPTED if row.torque_ms is None], ids=lambda row: row.name)
def test_what_is_no_reason_to_stop_does_not_stop(outcomes, row):
    assert outcomes[row.script]["goes_on"]
    assert row.reaction in (GOES_ON, "goes on")


def test_a_quick_stop_is_shorter_than_coasting(outcomes):
    from_10_rps = [row for row in STOPPING if row.torque_ms != OSCILLATING_MS]
    quick = [outcomes[row.script] for row in from_10_rps if row.reaction.startswith(QUICK)]
    coasting = [outcomes[row.script] for row in from_10_rps if not row.reaction.startswith(QUICK)]
    braking = [outcome["standstill_ms"] - outcome["torque_ms"] for outcome in quick]
    assert max(braking) < min(outcome["standstill_ms"] - outcome["torque_ms"] for outcome in coasting)


def test_the_written_table_is_what_is_measured(outcomes):
    assert TABLE.read_text(encoding="utf-8") == markdown(outcomes), "write it again: tools/fault_table"

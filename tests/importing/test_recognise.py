"""Units and signs of what was asked for, of two inputs beside each other, and stamps that are too coarse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from importing.axis_log import PERIOD_S, truth

from fffo_drive.importing.candidates import Hints
from fffo_drive.importing.convert import converted
from fffo_drive.importing.recognise import recognise
from fffo_drive.importing.source import source_of_arrays
from fffo_drive.recording.errors import RecordingError

LOG = truth()
SPEED_RPS = np.max(np.abs(LOG.velocity_rps))


def imported(columns, **hints):
    source = source_of_arrays(Path("log"), columns)
    found = recognise(source, Hints(**hints))
    return found, converted(source, found)


# What was asked for


@pytest.mark.parametrize(("unit", "turn"), [("deg", 360.0), ("rad", 2.0 * np.pi), ("rev", 1.0), ("counts", 4096.0)])
@pytest.mark.parametrize("own", ["deg", "counts"])
def test_a_set_point_is_read_in_its_own_unit(own, unit, turn):
    columns = {
        "time_s": LOG.time_s, f"Position actual [{own}]": LOG.position_rev * {"deg": 360.0, "counts": 4096.0}[own],
        f"Position demand [{unit}]": LOG.position_rev * turn, "Current [A]": LOG.current_a,
    }  # fmt: skip
    found, log = imported(columns, counts_per_turn=4096.0)
    assert found.of("setpoint_rev").factor == pytest.approx(1.0 / turn)
    assert np.max(np.abs(log.columns["reference_rps"])) == pytest.approx(SPEED_RPS, rel=1e-3)


def test_a_set_point_without_a_unit_is_read_in_that_of_the_position():
    columns = {
        "time_s": LOG.time_s, "pos_deg": LOG.position_rev * 360.0, "pos_ref": LOG.position_rev * 360.0,
        "Current [A]": LOG.current_a,
    }  # fmt: skip
    _, log = imported(columns)
    assert np.max(np.abs(log.columns["reference_rps"])) == pytest.approx(SPEED_RPS, rel=1e-3)


@pytest.mark.parametrize("asked", ["Position demand [counts]", "Demand speed [%]"])
def test_a_reference_in_a_unit_that_nothing_explains_is_left_out(asked):
    columns = {
        "time_s": LOG.time_s, "Position actual [deg]": LOG.position_rev * 360.0,
        "Actual speed [rpm]": LOG.velocity_rps * 60.0, asked: 100.0 * LOG.velocity_rps, "Current [A]": LOG.current_a,
    }  # fmt: skip
    found, log = imported(columns)
    assert "reference_rps" not in log.columns
    assert asked in found.left
    assert any(remark.startswith(f"{asked!r} in ") and "is left out" in remark for remark in log.remarks)


@pytest.mark.parametrize("heading", ["Demand speed [rpm]", "Demand speed"])
def test_the_reference_has_the_sign_of_the_velocity(heading):
    """The encoder counts against the drive's velocity: both follow the encoder."""
    columns = {
        "time_s": LOG.time_s, "Encoder [rev]": -LOG.position_rev, "Actual speed [rpm]": 60.0 * LOG.velocity_rps,
        heading: 60.0 * LOG.velocity_rps, "Current [A]": LOG.current_a,
    }  # fmt: skip
    found, log = imported(columns)
    np.testing.assert_allclose(log.columns["reference_rps"], log.columns["velocity_rps"])
    np.testing.assert_allclose(log.columns["velocity_rps"], -LOG.velocity_rps)
    assert found.of("reference_rps").evidence == "by its name, sign reversed as that of 'Actual speed [rpm]'"


# What drives the axis


@pytest.mark.parametrize("share", ["%", "permille", "counts"])
@pytest.mark.parametrize("of_command", [True, False])
def test_a_share_beside_a_current_is_left_out(share, of_command):
    units = (share, "A") if of_command else ("A", share)
    scales = {"A": 1.0, "%": 20.0, "permille": 200.0, "counts": 1000.0}
    demand, actual = (f"Current {name} [{unit}]" for name, unit in zip(("demand", "actual"), units, strict=True))
    columns = {"time_s": LOG.time_s, "pos_rev": LOG.position_rev} | {
        name: LOG.current_a * scales[unit] for name, unit in zip((demand, actual), units, strict=True)
    }
    found, log = imported(columns)
    assert found.torque_unit == "A"
    (signal,) = {"current_a", "current_command_a"} & set(log.columns)
    assert found.of(signal).column == (actual if of_command else demand)
    np.testing.assert_allclose(log.columns[signal], LOG.current_a)
    left = demand if of_command else actual
    assert any(remark.startswith(f"{left!r} in {share} is left out") for remark in log.remarks)


def test_two_shares_have_one_scale():
    columns = {
        "time_s": LOG.time_s, "pos_rev": LOG.position_rev, "Torque demand [%]": 20.0 * LOG.current_a,
        "Torque actual [permille]": 200.0 * LOG.current_a,
    }  # fmt: skip
    found, log = imported(columns)
    assert found.torque_unit == "%"
    np.testing.assert_allclose(log.columns["current_a"], log.columns["current_command_a"])


# Time


@pytest.mark.parametrize(
    "stamps",
    [
        np.floor(LOG.time_s / (4.0 * PERIOD_S)) * 4.0 * PERIOD_S,
        np.floor(LOG.time_s / (2.0 * PERIOD_S) + 1e-6) * 2.0 * PERIOD_S,
        np.zeros(LOG.time_s.size),
        np.full(LOG.time_s.size, np.nan),
    ],
    ids=["a quarter", "half", "none", "nothing"],
)
def test_stamps_that_are_coarser_than_the_sampling_are_refused(stamps):
    columns = {"stamps": stamps, "pos_rev": LOG.position_rev, "Current [A]": LOG.current_a}
    with pytest.raises(RecordingError, match=r"'stamps'.*the stamps are rounded: give --rate HZ"):
        imported(columns, roles={"time_s": "stamps"})
    _, log = imported(columns, rate_hz=1.0 / PERIOD_S)
    np.testing.assert_allclose(log.columns["time_s"], LOG.time_s, atol=1e-9)


# Values that are not there


@pytest.mark.parametrize("kind", [list, lambda values: np.array(values, dtype=object)])
def test_nothing_among_numbers_is_a_missing_number(kind):
    current = LOG.current_a.tolist()
    current[7] = None
    source = source_of_arrays(Path("log"), {"current_a": kind(current), "note": ["x", *[None] * (len(current) - 1)]})
    assert np.flatnonzero(np.isnan(source.columns["current_a"])).tolist() == [7]
    assert source.left == {"note": "holds no numbers"}


def test_a_date_that_is_missing_costs_its_row_alone():
    stamps = np.datetime64("2026-01-01") + (1e9 * LOG.time_s).astype("timedelta64[ns]")
    stamps[5] = np.datetime64("NaT")
    source = source_of_arrays(Path("log"), {"stamp": stamps})
    assert np.flatnonzero(np.isnan(source.columns["stamp"])).tolist() == [5]
    np.testing.assert_allclose(np.delete(source.columns["stamp"] - LOG.time_s, 5), 0.0, atol=1e-8)

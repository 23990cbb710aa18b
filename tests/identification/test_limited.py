"""Samples at the drive's own limit: the command did not act there, so no fit may use it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fffo_drive.control.friction_observer import TOGGLE_OFF
from fffo_drive.drive.cia402 import STATUS_INTERNAL_LIMIT
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.drive.simulated.parameters import PlantConfig, noiseless
from fffo_drive.identification.dataset import DataError, load_record, record_of_columns, where_command_acts
from fffo_drive.identification.excitation import identification_sequence
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.identification.regression import regression_start
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.runtime.session import Session
from fffo_drive.units import inertia_nm_s2_per_rev
from fffo_drive.workflows.plan import make_plan, plan_session

ROOT = Path(__file__).resolve().parents[2]
PERIOD_S = 0.0005
FACTS = DriveFacts(torque_constant_nm_per_a=0.148, rated_current_a=5.0)
ENABLED = 0x1637


def columns_of(samples: int, limited: np.ndarray) -> dict[str, np.ndarray]:
    """A shaft that swings by a revolution, with the statusword of a drive that was limited there."""
    time_s = PERIOD_S * np.arange(samples)
    statusword = np.full(samples, ENABLED)
    statusword[limited] |= STATUS_INTERNAL_LIMIT
    return {
        "time_s": time_s, "current_command_a": np.sin(6.0 * time_s), "position_rev": np.cos(6.0 * time_s),
        "statusword": statusword,
    }  # fmt: skip


def test_a_record_without_a_limit_stays_as_it_is():
    record = record_of_columns("run", columns_of(4000, np.zeros(0, int)), FACTS)
    assert record.limited is None
    assert where_command_acts(record) is record


def test_limited_samples_go_with_ten_milliseconds_on_either_side_and_leave_a_gap():
    record = record_of_columns("run", columns_of(4000, np.arange(1000, 1003)), FACTS)
    left = where_command_acts(record)
    assert left.samples == 4000 - 3 - 2 * 20
    assert left.breaks == (980,)
    assert np.array_equal(left.position_rev[:980], record.position_rev[:980])
    assert np.array_equal(left.position_rev[980:], record.position_rev[1023:])
    assert "1.08 % of the samples are left out" in left.warnings[-1]
    assert left.limited is None


def test_gaps_in_time_stay_gaps_at_their_new_places():
    columns = columns_of(6000, np.arange(5000, 5001))
    later = {name: np.delete(values, slice(3000, 3200)) for name, values in columns.items()}
    record = record_of_columns("run", later, FACTS)
    assert record.breaks == (3000,)
    assert where_command_acts(record).breaks == (3000, 4780)


def test_a_table_says_it_too_where_its_statusword_is_declared(tmp_path):
    columns = columns_of(4000, np.arange(1000, 1003))
    log = tmp_path / "run.csv"
    np.savetxt(log, np.column_stack(list(columns.values())), "%.9g", ",", header=",".join([*columns][:3] + ["sw"]))
    declared = {name: name for name in ("time_s", "current_command_a", "position_rev")} | {"statusword": "sw"}
    record = load_record(log, FACTS.model_copy(update={"columns": declared}))
    assert record.limited is not None
    assert np.flatnonzero(record.limited).tolist() == [1000, 1001, 1002]
    assert where_command_acts(record).samples == 4000 - 3 - 2 * 20


def test_a_hexadecimal_statusword_is_read_where_it_is_declared_and_left_alone_where_it_is_not(tmp_path):
    words = ["0x1637", "0x1E37"]  # bit 11 of the second is set
    lines = [f"{PERIOD_S * k},{np.sin(0.01 * k)},{np.cos(0.01 * k)},{words[k >= 2000]}" for k in range(3000)]
    log = tmp_path / "run.csv"
    log.write_text("time_s,current_command_a,position_rev,statusword\n" + "\n".join(lines) + "\n")
    assert load_record(log, FACTS).limited is None
    declared = {name: name for name in ("time_s", "current_command_a", "position_rev", "statusword")}
    limited = load_record(log, FACTS.model_copy(update={"columns": declared})).limited
    assert np.flatnonzero(limited).tolist() == list(range(2000, 3000))


def test_a_drive_that_is_always_at_its_limit_is_refused_in_words():
    record = record_of_columns("run", columns_of(4000, np.arange(0, 4000, 30)), FACTS)
    with pytest.raises(DataError, match="reduce the amplitude"):
        where_command_acts(record)


def test_friction_and_inertia_are_recovered_from_a_chirp_that_reaches_the_voltage_limit():
    """With a DC link of 8 V two fifths of the samples are limited, and the whole chirp hides the friction."""
    plan = make_plan(ROOT / "configs" / "axis_simulated.yaml")
    plant = replace(noiseless(PlantConfig()), dc_link_v=8.0)
    drive = SimulatedDrive(plant)
    drive.connect()
    profile = identification_sequence(12.0, PERIOD_S, 0.5, 1.6, 0.05, 8.0)
    session = Session(drive, plan_session(plan, 40_000))
    session.run_profile(profile, TOGGLE_OFF)
    rows = RingReader(session.ring).read().rows
    rows = rows[rows["profile_sample"] >= 0]
    columns = {name: rows[name] for name in ("current_command_a", "position_rev", "velocity_rps", "statusword")}
    record = record_of_columns("chirp", {"time_s": PERIOD_S * np.arange(rows.size), **columns}, FACTS)
    assert 0.3 < np.mean(record.limited) < 0.5
    whole, left = (regression_start([one]) for one in (record, where_command_acts(record)))
    assert whole.coulomb_nm < 0.1 * plant.friction.coulomb_nm  # what the fit would believe
    assert whole.delay_s > 0.005
    assert left.inertia_nm_s2_per_rev == pytest.approx(inertia_nm_s2_per_rev(plant.inertia_kg_m2), rel=0.04)
    assert left.viscous_nm_per_rps == pytest.approx(plant.friction.viscous_nm_per_rps, rel=0.15)
    assert left.coulomb_nm == pytest.approx(plant.friction.coulomb_nm, rel=0.2)
    assert left.delay_s == pytest.approx(0.002, abs=0.0003)

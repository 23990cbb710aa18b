"""Logs: what cannot be fitted is refused with the reason, never fitted silently."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from identification.synthetic import PERIOD_S, chirp_record, record_of

from fffo_drive.documents import DocumentError
from fffo_drive.identification.dataset import DataError, check_record, load_record, load_records
from fffo_drive.identification.facts import DriveFacts, read_facts
from fffo_drive.identification.regression import regression_start, start_problems
from fffo_drive.recording.errors import RecordingError

FACTS = DriveFacts(torque_constant_nm_per_a=0.148, rated_current_a=8.3, resolver_bits=15, sample_rate_hz=2000)


def write_csv(path, columns):
    names = list(columns)
    with gzip.open(path, "wt") as file:
        file.write(",".join(names) + "\n")
        np.savetxt(file, np.column_stack([columns[name] for name in names]), delimiter=",", fmt="%.9g")
    return path


@pytest.fixture(scope="module")
def columns():
    record = chirp_record(4.0, lsb_rev=2.0**-15)
    velocity = np.gradient(record.position_rev, PERIOD_S)
    smooth = np.convolve(velocity, np.ones(20) / 20, "same")
    time = np.arange(record.samples) * PERIOD_S
    return {
        "time_s": time, "current_command_a": record.current_a, "velocity_rps": smooth,
        "position_rev": record.position_rev,
    }  # fmt: skip


def test_a_table_becomes_a_record(tmp_path, columns):
    record = load_record(write_csv(tmp_path / "a.csv.gz", columns), FACTS)
    assert record.period_s == pytest.approx(PERIOD_S)
    assert not record.closed_loop
    assert record.lsb_rev == 2.0**-15
    assert len(record.digest) == 64
    assert record.segments() == [slice(0, record.samples)]


@pytest.mark.parametrize(("factor", "hint"), [(60.0, "rpm given as rps"), (-1.0, "wrong sign"), (1 / 360, "degrees")])
def test_a_wrong_unit_of_the_velocity_is_named(tmp_path, columns, factor, hint):
    path = write_csv(tmp_path / "a.csv.gz", columns | {"velocity_rps": columns["velocity_rps"] * factor})
    with pytest.raises(DataError, match=hint):
        load_record(path, FACTS)


def test_a_wrong_unit_everywhere_makes_the_inertia_absurd():
    record = chirp_record(20.0, lsb_rev=2.0**-15)
    start = regression_start([record])
    assert start_problems(start, 0.148, 8.3) == []
    for factor, way in ((60.0, "small"), (1.0 / 360.0, "large")):
        wrong = start._replace(inertia_nm_s2_per_rev=start.inertia_nm_s2_per_rev / factor)
        (problem,) = start_problems(wrong, 0.148, 8.3)
        assert f"absurdly {way}" in problem
    (problem,) = start_problems(start._replace(inertia_nm_s2_per_rev=-1e-3), 0.148, 8.3)
    assert "opposite signs" in problem


def test_a_constant_command_and_too_little_motion_are_refused(tmp_path, columns):
    still = columns | {"position_rev": np.round(columns["position_rev"] * 0.0), "velocity_rps": columns["time_s"] * 0.0}
    with pytest.raises(DataError, match="too little motion"):
        load_record(write_csv(tmp_path / "a.csv.gz", still), FACTS)
    with pytest.raises(DataError, match="nothing is excited"):
        load_record(write_csv(tmp_path / "b.csv.gz", columns | {"current_command_a": columns["time_s"] * 0.0}), FACTS)


def test_all_bad_logs_are_named_at_once(tmp_path, columns):
    first = write_csv(tmp_path / "first.csv.gz", columns | {"current_command_a": columns["time_s"] * 0.0})
    with pytest.raises(DataError) as caught:
        load_records(
            [first, tmp_path / "short.csv.gz"]
            if (tmp_path / "short.csv.gz").exists()
            else [first, _short(tmp_path, columns)],
            FACTS,
        )
    assert "first.csv.gz" in str(caught.value)
    assert "short.csv.gz" in str(caught.value)


def _short(tmp_path, columns):
    return write_csv(tmp_path / "short.csv.gz", {name: values[:500] for name, values in columns.items()})


def test_nan_and_a_wrong_rate_are_refused(tmp_path, columns):
    bad = columns["position_rev"].copy()
    bad[100] = np.nan  # a gap, which is told
    found = load_record(write_csv(tmp_path / "a.csv.gz", columns | {"position_rev": bad}), FACTS)
    assert "1 of 8000 rows miss a number and are left out" in found.warnings[0]
    assert "line 102, column 'position_rev'" in found.warnings[0]
    bad[:100] = np.nan
    with pytest.raises(RecordingError, match=r"1\.26 % of its rows would be left out"):
        load_record(write_csv(tmp_path / "a.csv.gz", columns | {"position_rev": bad}), FACTS)
    with pytest.raises(DataError, match="facts declare 1000 Hz"):
        load_record(write_csv(tmp_path / "b.csv.gz", columns), FACTS.model_copy(update={"sample_rate_hz": 1000.0}))


def test_the_declared_rate_is_the_time_of_a_table_without_one(tmp_path, columns):
    path = write_csv(tmp_path / "a.csv.gz", {name: v for name, v in columns.items() if name != "time_s"})
    record = load_record(path, FACTS)
    assert record.period_s == pytest.approx(PERIOD_S)
    np.testing.assert_allclose(record.position_rev, columns["position_rev"], atol=1e-6)
    with pytest.raises(
        RecordingError, match=r"no time can be seen among the columns .*\n.*fffo-drive import .*a\.csv\.gz .*--rate HZ$"
    ):
        load_record(path, FACTS.model_copy(update={"sample_rate_hz": None}))


def test_a_gap_splits_a_record(tmp_path, columns):
    keep = np.r_[0:3000, 3400:8000]
    record = load_record(write_csv(tmp_path / "a.csv.gz", {n: v[keep] for n, v in columns.items()}), FACTS)
    assert record.breaks == (3000,)
    assert any("gap" in text for text in record.warnings)
    assert [s.stop - s.start for s in record.segments()] == [3000, 4600]


def test_without_a_position_the_velocity_is_integrated(tmp_path, columns):
    path = write_csv(tmp_path / "a.csv.gz", {n: v for n, v in columns.items() if n != "position_rev"})
    record = load_record(path, FACTS)
    assert any("integrated" in text for text in record.warnings)
    assert record.velocity_rps is None  # it would say of itself that it is not late
    assert np.ptp(record.position_rev - columns["position_rev"]) < 0.05 * np.ptp(columns["position_rev"])


def test_a_record_without_its_own_finite_numbers_is_a_problem():
    record = record_of(np.full(8000, np.nan))
    problems, _ = check_record(record)
    assert any("not a finite number" in text for text in problems)


def test_a_fast_small_motion_is_not_taken_for_a_wrong_unit(tmp_path, columns):
    """10 Hz: a difference over 20 ms alone would be 7 % short."""
    position = 0.05 * np.sin(2 * np.pi * 10.0 * columns["time_s"])
    velocity = 0.05 * 2 * np.pi * 10.0 * np.cos(2 * np.pi * 10.0 * columns["time_s"])
    fast = columns | {"position_rev": position, "velocity_rps": velocity}
    assert load_record(write_csv(tmp_path / "a.csv.gz", fast), FACTS).warnings == ()
    with pytest.raises(DataError, match=r"1\.1 times the derivative of the position\. Give the unit"):
        load_record(write_csv(tmp_path / "b.csv.gz", fast | {"velocity_rps": 1.1 * velocity}), FACTS)


def test_logs_of_one_name_stay_apart(tmp_path, columns):
    paths = []
    for directory in ("monday", "tuesday"):
        (tmp_path / directory).mkdir()
        paths.append(write_csv(tmp_path / directory / "run.csv.gz", columns))
    assert [record.name for record in load_records(paths, FACTS)] == ["monday/run", "tuesday/run"]
    assert [record.name for record in load_records([paths[0], paths[0]], FACTS)] == ["monday/run", "monday/run (2)"]


def test_facts_are_checked(tmp_path):
    path = tmp_path / "drive.yaml"
    path.write_text("torque_constant_nm_per_a: 0.148\nresolver_bit: 15\n")
    with pytest.raises(DocumentError, match="did you mean 'resolver_bits'"):
        read_facts(path)

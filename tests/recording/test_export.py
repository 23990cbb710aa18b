"""Rows as CSV and Parquet: what is written is what was recorded, and is read back as a log."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from evaluation.asked import tell
from recording.samples import BOOT_NS, WALL_NS, random_rows, same_bits, write_run
from recording.test_index import ROWS, TRIP_S, sample  # noqa: F401

from fffo_drive.cli import main
from fffo_drive.recording.errors import RecordingError
from fffo_drive.recording.export import export
from fffo_drive.recording.reader import TimeWindow, describe, read_run
from fffo_drive.recording.writer import RunWriter
from fffo_drive.workflows.replay import replay_files

pyarrow = pytest.importorskip("pyarrow")
ALL = ROWS.dtype.names


def read_back(path: Path):
    from pyarrow import csv, parquet

    return csv.read_csv(path) if path.suffix == ".csv" else parquet.read_table(path)


@pytest.mark.parametrize("name", ["a.parquet", "a.csv"])
def test_every_column_comes_back(sample, tmp_path, name):  # noqa: F811
    done = export([sample], tmp_path / name)
    assert (done.rows, done.columns) == (400, ALL)
    table = read_back(done.path)
    assert tuple(table.column_names) == ("time_s", *ALL)
    assert np.allclose(table["time_s"].to_numpy(), (ROWS["deadline_ns"] - ROWS["deadline_ns"][0]) * 1e-9, atol=1e-12)
    for column in ALL:
        assert np.array_equal(table[column].to_numpy().astype(ROWS[column].dtype), ROWS[column], equal_nan=True), column


def test_files_that_follow_each_other_become_one(tmp_path):
    rows = random_rows(300)
    parts = [write_run(tmp_path / f"{k}.mcap", rows[100 * k : 100 * k + 100]) for k in range(3)]
    whole = export(parts, tmp_path / "a.parquet", ["velocity_rps"])
    assert whole.rows == 300
    seconds = read_back(whole.path)["time_s"].to_numpy()
    assert np.allclose(seconds, (rows["deadline_ns"] - BOOT_NS) * 1e-9, atol=1e-12)
    with pytest.raises(RecordingError, match=r"0\.mcap begins before .*1\.mcap: name the files in their order"):
        export(parts[1::-1], tmp_path / "b.csv")


def test_a_window_and_columns_as_typed(sample, tmp_path, capsys):  # noqa: F811
    out = tmp_path / "a.csv"
    words = ["log", "export", str(sample), "--out", str(out), "--columns", "velocity_rps, trip", "--json"]
    assert main([*words, "--from", "0.05", "--to", "0.06"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "path": str(out),
        "rows": 20,
        "columns": ["velocity_rps", "trip"],
        "incomplete": [],
    }
    table = read_back(out)
    assert table["time_s"].to_numpy() == pytest.approx(0.05 + 5e-4 * np.arange(20), abs=1e-9)
    assert np.array_equal(table["velocity_rps"].to_numpy(), ROWS["velocity_rps"][100:120], equal_nan=True)


def test_around_the_first_event_that_says_it(sample, tmp_path, capsys, monkeypatch):  # noqa: F811
    monkeypatch.setattr("fffo_drive.cli.log.AROUND_S", 0.01)
    monkeypatch.setattr("fffo_drive.recording.export.around.__defaults__", (0.01,))
    out = tmp_path / "a.parquet"
    assert main(["log", "export", str(sample), "--out", str(out), "--around", "FOLLOWING"]) == 0
    assert "loop: trip: following error" in capsys.readouterr().err
    seconds = read_back(out)["time_s"].to_numpy()
    assert (seconds[0], seconds[-1]) == pytest.approx((TRIP_S - 0.01, TRIP_S + 0.0095), abs=1e-9)


def test_a_part_of_a_recording_is_a_recording(sample, tmp_path):  # noqa: F811
    done = export([sample], tmp_path / "part.mcap", window=TimeWindow(0.1, 0.15))
    part, whole = read_run(done.path), read_run(sample)
    assert part.complete
    assert same_bits(part.rows, whole.rows[200:300])
    assert np.array_equal(part.log_time_ns, whole.log_time_ns[200:300])
    assert part.attachments == whole.attachments
    assert part.metadata == {**whole.metadata, "part_of": f"{sample.name}, from 0.1 s to 0.15 s"}
    assert [event.text for event in part.events] == ["trip: following error"]
    assert describe(done.path) == describe(done.path, check=True)


def test_parts_of_a_run_of_several_files_keep_its_records(story_files, tmp_path):
    done = export(story_files, tmp_path / "whole.mcap")
    rows = np.concatenate([read_run(file).rows for file in story_files])
    whole = read_run(done.path)
    assert same_bits(whole.rows, rows)
    wanted = {record.sequence for file in story_files for record in read_run(file).records}
    assert {record.sequence for record in whole.records} == wanted
    assert replay_files([done.path]).exact


@pytest.fixture(scope="module")
def story_files(tmp_path_factory):
    """A run with everything that can be asked for, in several files."""
    return tell(tmp_path_factory.mktemp("story"), rotate_bytes=20_000, drain_each=True)


def test_rows_of_another_version_become_a_table_and_no_recording(tmp_path):
    old = Path(__file__).parents[1] / "releases" / "0.1.0" / "run.mcap"
    assert export([old], tmp_path / "a.csv").rows == 355
    with pytest.raises(RecordingError, match="only recordings of one run, by this version"):
        export([old], tmp_path / "a.mcap")


def test_files_of_two_runs_do_not_become_one_recording(tmp_path):
    first = write_run(tmp_path / "0.mcap", random_rows(100))
    rows = random_rows(100, first_tick=100)
    rows["deadline_ns"] -= 10**9  # the wall clock was set between the runs
    other = RunWriter(tmp_path / "1.mcap", {}, (), WALL_NS + 10**9)
    other.write_rows(rows)
    with pytest.raises(RecordingError, match="only recordings of one run, by this version"):
        export([first, other.close()], tmp_path / "a.mcap")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.mcap", "1.mcap"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "a.xlsx"], "a.xlsx: name it for its format: .csv or .parquet or .mcap"),
        (["--out", "a.csv", "--columns", "velocity_rp"], "no column 'velocity_rp': did you mean 'velocity_rps'"),
        (["--out", "a.mcap", "--columns", "trip"], "a.mcap: a recording has all columns"),
        (["--out", "a.mcap", "--from", "5"], "a.mcap: not written: no row lies from 5 s to inf s"),
        (["--out", "a.csv", "--from", "5"], "a.csv: not written: no row lies from 5 s to inf s"),
        (["--out", "a.csv", "--around", "overheated"], "no event contains 'overheated'; there are:"),
        (["--out", "a.csv", "--around", "trip", "--to", "3"], "--around sets the window"),
        (["--out", "taken.csv"], "taken.csv"),
    ],
)
def test_a_mistake_is_named_and_leaves_no_file(sample, tmp_path, monkeypatch, capsys, words, said):  # noqa: F811
    monkeypatch.chdir(tmp_path)
    Path("taken.csv").write_text("mine")
    try:
        code = main(["log", "export", str(sample), *words])
    except SystemExit as stop:
        code = stop.code
        assert said in str(stop.code)  # noqa: PT017
    else:
        assert said in capsys.readouterr().err
    assert code
    assert [path.name for path in Path().iterdir()] == ["taken.csv"]
    assert Path("taken.csv").read_text() == "mine"


def test_a_torn_file_is_exported_as_far_as_it_goes_and_told(sample, tmp_path, capsys):  # noqa: F811
    torn = tmp_path / "a.mcap.part"
    torn.write_bytes(sample.read_bytes()[: sample.stat().st_size // 2])
    assert main(["log", "export", str(torn), "--out", str(tmp_path / "a.csv")]) == 0
    assert "up to the last whole chunk" in capsys.readouterr().err
    assert read_back(tmp_path / "a.csv").num_rows == len(read_run(torn).rows)


def test_the_table_is_read_as_a_log(tmp_path):
    from fffo_drive.identification.dataset import load_records
    from fffo_drive.identification.facts import DriveFacts

    rows = random_rows(4000)
    seconds = (rows["deadline_ns"] - BOOT_NS) * 1e-9
    rows["position_rev"], rows["velocity_rps"] = np.sin(seconds), np.cos(seconds)
    rows["current_command_a"] = np.sin(3.0 * seconds)
    write_run(tmp_path / "a.mcap", rows)
    columns = ["position_rev", "velocity_rps", "current_command_a"]
    done = export([tmp_path / "a.mcap"], tmp_path / "a.csv", columns)
    (record,) = load_records([done.path], DriveFacts(torque_constant_nm_per_a=0.148, rated_current_a=8.3))
    assert record.period_s == pytest.approx(5e-4)
    assert np.allclose(record.position_rev, rows["position_rev"], atol=1e-12)

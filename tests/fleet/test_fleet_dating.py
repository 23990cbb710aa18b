"""When a run was: by its clock, its name, or a manifest; a copy of today is told."""

from __future__ import annotations

import os
from datetime import UTC, datetime

import pytest
from fleet.fleet_rig import write_run
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.cli import main
from fffo_drive.documents import DocumentError
from fffo_drive.fleet.dating import CROWD_RUNS, read_manifest, time_in_name
from fffo_drive.fleet.store import FleetStore
from fffo_drive.recording.reader import read_metadata

DAY = datetime(2026, 1, 15, 10, 28, 10, tzinfo=UTC)
TODAY_S = datetime(2026, 11, 29, tzinfo=UTC).timestamp()


def starts(store):
    return {os.path.basename(entry["path"]): entry["start"] for entry in FleetStore(str(store)).index().to_pylist()}


@pytest.fixture
def runs(tmp_path):
    """Runs in files of today."""
    folder = tmp_path / "runs"
    folder.mkdir()
    for k in range(CROWD_RUNS):
        os.utime(write_run(folder / f"axis7_2026-01-{15 + k}_10h28m10.csv", k), (TODAY_S + k,) * 2)
    return folder


def add(store, facts_file, *words):
    return main(["fleet", "add", str(store), *words, "--drive", str(facts_file), "--model", "M1"])


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("2026-01-15_10h28m10.json", DAY),
        ("run 20260115T102810 axis.csv", DAY),
        ("s3://bucket/2025-12-31/drive4-2026_01_15 10:28:10.csv", DAY),
        ("20260115.csv", DAY.replace(hour=0, minute=0, second=0)),
        ("x2026.01.15-1028.mat", DAY.replace(second=0)),
    ],
)
def test_a_date_in_a_name(name, said):
    assert time_in_name(name) == said


@given(st.datetimes(datetime(2000, 1, 1), datetime(2099, 12, 31)).map(lambda at: at.replace(microsecond=0)))
def test_any_date_in_a_name_is_that_date(at):
    for form in ("%Y-%m-%dT%H:%M:%S", "%Y%m%d_%H%M%S", "axis 3, %Y-%m-%d %Hh%Mm%S"):
        assert time_in_name(at.strftime(form) + ".csv") == at.replace(tzinfo=UTC)


@pytest.mark.parametrize("name", ["run7.csv", "20261301.csv", "2026-02-30.csv", "120260115.csv"])
def test_a_name_without_a_date_is_told(name):
    with pytest.raises(DocumentError, match="its name says no date"):
        time_in_name(name)


def test_runs_of_a_copy_are_told_and_dated_by_their_names(runs, facts_file, tmp_path, capsys):
    words = ["--from", str(runs), "--serial", "SN7"]
    assert add(tmp_path / "copied", facts_file, *words) == 0
    said = capsys.readouterr().err
    assert f"caution: SN7: {CROWD_RUNS} runs within 7 s by the dates of their files" in said
    assert add(tmp_path / "named", facts_file, *words, "--time-from", "name") == 0
    assert "caution" not in capsys.readouterr().err
    assert starts(tmp_path / "named")["axis7_2026-01-15_10h28m10.csv"] == DAY


def test_a_clock_of_a_calendar_is_honoured(facts_file, tmp_path):
    path = write_run(tmp_path / "run.csv", 1)
    head, *rows = path.read_text().splitlines()
    place = head.split(",").index("time_s")
    moved = [row.split(",") for row in rows]
    for row in moved:
        row[place] = f"{float(row[place]) + DAY.timestamp():.6f}"
    path.write_text("\n".join([head, *(",".join(row) for row in moved)]) + "\n")
    os.utime(path, (TODAY_S,) * 2)
    assert add(tmp_path / "store", facts_file, str(path), "--serial", "SN7") == 0
    first_s = float(rows[0].split(",")[place])
    assert starts(tmp_path / "store")["run.csv"].timestamp() == pytest.approx(DAY.timestamp() + first_s, abs=1e-3)


def test_a_manifest_replaces_many_calls(runs, facts_file, tmp_path):
    names = sorted(path.name for path in runs.iterdir())
    lines = [f"{name},SN{k % 2},M{k % 2},2026-03-{k + 1:02d}T08:00:00+01:00" for k, name in enumerate(names)]
    manifest = runs / "manifest.csv"
    manifest.write_text("\n".join(["path,serial,model,time", *lines, ""]))
    assert add(tmp_path / "store", facts_file, "--manifest", str(manifest)) == 0
    entries = FleetStore(str(tmp_path / "store")).index().to_pylist()
    assert len(entries) == CROWD_RUNS
    for entry in entries:
        k = names.index(os.path.basename(entry["path"]))
        assert (entry["drive"], entry["model"]) == (f"SN{k % 2}", f"M{k % 2}")
        assert entry["start"] == datetime(2026, 3, k + 1, 7, tzinfo=UTC)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("path,serials\na.csv,1\n", "line 1, column 'serials': did you mean 'serial'"),
        ("serial\nSN1\n", "line 1: no column `path`"),
        ("path,time\na.csv,yesterday\n", "line 2, time 'yesterday': a date such as"),
        ("path,temperature_degc\na.csv,warm\n", "line 2, temperature_degc 'warm': a number in degC"),
        ("path\n\n\na.csv\na.csv\n", "a.csv stands in it twice"),
        ("path\na.csv,SN1\n", "line 2: more values than the heading has"),
        ("path,serial\n,SN1\n", "line 2: no path"),
        ("path\n", "no run in it"),
    ],
)
def test_a_mistake_in_a_manifest_names_its_line(tmp_path, text, said):
    path = tmp_path / "manifest.csv"
    path.write_text(text)
    with pytest.raises(DocumentError) as caught:
        read_manifest(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_date_given_later_replaces_that_of_the_file_and_the_record_follows(runs, facts_file, tmp_path, capsys):
    store = tmp_path / "store"
    words = ["--from", str(runs), "--serial", "SN7"]
    assert add(store, facts_file, *words, "--work", "--workers", "1") == 0
    before = {row["run"]: row for row in FleetStore(str(store)).records().to_pylist()}
    capsys.readouterr()
    assert add(store, facts_file, *words, "--time-from", "name") == 0
    assert f"0 runs added, 0 known before, {CROWD_RUNS} changed" in capsys.readouterr().out
    after = {row["run"]: row for row in FleetStore(str(store)).records().to_pylist()}
    assert after.keys() == before.keys()
    for run, row in after.items():
        assert row["start"] == time_in_name(row["path"])
        unchanged = {name: value for name, value in row.items() if name != "start"}
        assert str(unchanged) == str({name: value for name, value in before[run].items() if name != "start"})
    assert starts(store)["axis7_2026-01-15_10h28m10.csv"] == DAY
    assert add(store, facts_file, *words, "--time-from", "name") == 0
    assert f"0 runs added, {CROWD_RUNS} known before" in capsys.readouterr().out
    assert FleetStore(str(store)).waiting() == []


def test_a_temperature_of_a_manifest_is_that_of_the_record(runs, facts_file, tmp_path):
    names = sorted(path.name for path in runs.iterdir())
    manifest = runs / "manifest.csv"
    lines = [f"{name},SN1,{20.5 + k if k else ''}" for k, name in enumerate(names[:3])]
    manifest.write_text("\n".join(["path,serial,temperature_degc", *lines, ""]))
    store = tmp_path / "store"
    assert add(store, facts_file, "--manifest", str(manifest), "--work", "--workers", "1") == 0
    degc = {os.path.basename(r["path"]): r["temperature_degc"] for r in FleetStore(str(store)).records().to_pylist()}
    assert [degc[name] for name in names[:3]] == [None, 21.5, 22.5]
    manifest.write_text(f"path,temperature_degc\n{names[0]},30\n")
    assert add(store, facts_file, "--manifest", str(manifest)) == 0
    degc = {os.path.basename(r["path"]): r["temperature_degc"] for r in FleetStore(str(store)).records().to_pylist()}
    assert [degc[name] for name in names[:3]] == [30.0, 21.5, 22.5]


def test_a_column_of_time_that_counts_from_zero_says_no_date(runs, facts_file, tmp_path, capsys):
    words = ["--from", str(runs), "--serial", "SN7", "--time-from", "column"]
    assert add(tmp_path / "store", facts_file, *words) == 78
    said = capsys.readouterr().err
    assert said.count("its time counts from a zero of its own, which says no date: use --time-from name") == CROWD_RUNS


@pytest.mark.parametrize("calendar", [True, False])
def test_what_is_imported_keeps_its_date(runs, facts_file, tmp_path, calendar, capsys):
    path = sorted(runs.iterdir())[0]
    if calendar:
        head, *rows = path.read_text().splitlines()
        moved = [f"{float(row.split(',')[0]) + DAY.timestamp():.6f},{row.split(',', 1)[1]}" for row in rows]
        path.write_text("\n".join([head, *moved]) + "\n")
    os.utime(path, (TODAY_S,) * 2)
    assert main(["import", str(path), "--torque-constant", "0.1", "--out", str(tmp_path / "out")]) == 0
    (made,) = (tmp_path / "out").glob("*.mcap")
    said = read_metadata(made)["date_from"]
    assert said == ("clock of the log" if calendar else "modification time of the source file")
    store = tmp_path / "store"
    assert main(["fleet", "add", str(store), str(made), "--serial", "SN7", "--model", "M1"]) == 0
    (start,) = starts(store).values()
    assert start.timestamp() == pytest.approx(DAY.timestamp() if calendar else TODAY_S, abs=1e-3)
    assert main(["fleet", "add", str(tmp_path / "s2"), str(made), "--serial", "A", "--time-from", "column"]) == (
        0 if calendar else 78
    )

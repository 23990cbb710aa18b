"""`fleet diagnose`: the raw runs on either side of a change, and what it says where files are gone."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from fleet.fleet_rig import filled_store, write_run

from fffo_drive.cli import main
from fffo_drive.documents import DocumentError
from fffo_drive.fleet import diagnosing
from fffo_drive.fleet.diagnosing import (
    BEFORE,
    NOW,
    FleetDiagnosis,
    diagnose_drives,
    file_name,
    fleet_diagnosis_report,
    subjects_of,
)
from fffo_drive.fleet.history import history
from fffo_drive.fleet.watch import Alarm, Watched
from fffo_drive.fleet.work import work
from fffo_drive.report.page import write_report
from fffo_drive.units import TWO_PI

RUNS = 12
WEEK_S = 7 * 86_400
START_S = 1_770_000_000


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Two drives with twelve weekly runs each."""
    directory = tmp_path_factory.mktemp("moved")
    for drive in ("A/1", "A2"):
        paths = [directory / f"{drive[-1]}_{number:02d}.csv" for number in range(RUNS)]
        for number, path in enumerate(paths):
            write_run(path, 100 * int(drive[-1]) + number, duration_s=4.0)
            os.utime(path, (START_S + WEEK_S * number,) * 2)
        store = filled_store(directory / "store", paths, drive=drive, model="M 1")
    work(store.place.address, store.waiting(), workers=1)
    return store


@pytest.fixture(scope="module")
def runs(store):
    """Content hashes of each drive's runs, oldest first."""
    return {drive: [str(run) for run in history(store, drive).run] for drive in ("A/1", "A2")}


def changed(drive, runs, first, earliest=None, ramp=0):
    """An alarm of a change that began with run `first`, or `earliest` already, and grew over `ramp` runs."""
    within = (runs[first if earliest is None else earliest], runs[first])
    return Alarm(
        drive, "Coulomb friction", (), 0.1, (0.08, 0.12), "Coulomb friction", None, None, ramp, runs[first],
        0.0, within, runs[-1], 0.0, (),
    )  # fmt: skip


def watched(*alarms):
    return {"M 1": Watched(alarms, (), 2, 2 * RUNS, 0.4, 0.01, ())}


def sides_of(store, runs, *alarms, most=8):
    (subject,) = subjects_of(store, watched(*alarms), [], most)
    return {side: [runs["A2"].index(run) for run in own] for side, own in subject.sides.items()}


def test_before_ends_where_the_change_may_have_begun_and_now_begins_where_it_was_complete(store, runs):
    found = sides_of(store, runs, changed("A2", runs["A2"], first=6, earliest=4, ramp=3))
    assert found == {BEFORE: [0, 1, 2, 3], NOW: [8, 9, 10, 11]}


def test_of_two_changes_the_runs_before_the_first_and_after_the_last_are_taken(store, runs):
    alarms = [changed("A2", runs["A2"], first=3), changed("A2", runs["A2"], first=7)]
    assert sides_of(store, runs, *alarms, most=2) == {BEFORE: [1, 2], NOW: [10, 11]}


def test_a_change_that_still_grows_leaves_the_last_two_runs(store, runs):
    found = sides_of(store, runs, changed("A2", runs["A2"], first=6, ramp=24))
    assert found == {BEFORE: [0, 1, 2, 3, 4, 5], NOW: [10, 11]}


def test_a_drive_that_is_asked_for_needs_no_change(store, runs):
    (subject,) = subjects_of(store, watched(), ["A/1"], 3)
    assert dict(subject.sides) == {NOW: tuple(runs["A/1"][-3:])}
    assert subjects_of(store, watched(), [], 8) == []
    with pytest.raises(DocumentError, match="--serial A3: no record of it: there is A/1, A2"):
        subjects_of(store, watched(), ["A3"], 8)


@pytest.mark.parametrize(
    ("serial", "name"), [("A7", "A7"), ("0x0000012", "0x0000012"), ("A/1 b", "A_1_b"), ("..", "_"), ("", "_")]
)
def test_a_serial_number_makes_a_directory_below_the_others(serial, name):
    assert file_name(serial) == name


@pytest.fixture(scope="module")
def real(store, tmp_path_factory):
    """A drive that did not move, diagnosed by its last two runs."""
    out = tmp_path_factory.mktemp("real")
    return diagnose_drives(store, subjects_of(store, watched(), ["A/1"], 2), out), out


def test_a_drive_without_a_change_is_diagnosed_by_its_last_runs_and_the_newest_is_the_proof(store, runs, real):
    found, out = real
    paths = write_report(fleet_diagnosis_report(found, store.place.address, out), out)
    (drive,) = json.loads(paths.json.read_text())["results"]["drives"]
    assert (drive["drive"], drive["alarms"], list(drive["sides"])) == ("A/1", [], [NOW])
    assert drive["sides"][NOW]["runs"] == runs["A/1"][-2:]
    assert "unbalance" in {f["name"] for f in drive["sides"][NOW]["effects"]}  # of the rig's truth
    own = json.loads((out / drive["sides"][NOW]["report"]).read_text())
    assert own["runs"] == {"fit": ["1_10"], "held_out": ["1_11"]}
    first, *more = diagnosing.diagnosis_lines(found)
    assert first == "A/1: no change in its own history"
    assert more[0].startswith("  now (2 runs): ")
    assert more[1:] == [f"    {out / 'M_1' / 'A_1' / NOW / 'report.html'}"]


def test_the_inertia_of_a_linear_axis_is_a_mass(store, real, tmp_path):
    drive = real[0].drives[0]
    rotary = drive.found[NOW]._replace(page=tmp_path / "report.html", report=tmp_path / "report.json")
    linear = rotary._replace(diagnosis=replace(rotary.diagnosis, units="linear"))
    rows = [
        diagnosing.fleet_diagnosis_report(FleetDiagnosis((drive._replace(found={NOW: one}),), ()), "s", tmp_path)
        .tables[0].rows[0]
        for one in (rotary, linear)
    ]  # fmt: skip
    assert [row.unit for row in rows] == ["kg m²", "kg"]
    assert rows[1].cells[0].value == pytest.approx(TWO_PI * rows[0].cells[0].value)


def test_both_sides_stand_side_by_side_and_a_file_that_is_gone_is_reported(store, runs, real, tmp_path, monkeypatch):
    seen = []

    def recorded(fit, held_out, facts, progress=None):
        seen.append(([one.name for one in fit], [one.name for one in held_out]))
        return real[0].drives[0].found[NOW].diagnosis

    monkeypatch.setattr(diagnosing, "diagnose", recorded)
    gone = next(Path(entry["path"]) for entry in store.index().to_pylist() if entry["run"] == runs["A/1"][0])
    gone.rename(tmp_path / "away.csv")
    try:
        subjects = subjects_of(store, watched(changed("A/1", runs["A/1"], first=6)), [], 8)
        found = diagnose_drives(store, subjects, tmp_path / "pages")
    finally:
        (tmp_path / "away.csv").rename(gone)
    assert seen == [
        (["1_01", "1_02", "1_03", "1_04"], ["1_05"]),
        (["1_06", "1_08", "1_09", "1_10"], ["1_07", "1_11"]),
    ]
    assert [problem.split(":")[0] for problem in found.problems] == ["A/1, before"]
    assert "it is gone since it was added" in found.problems[0]
    pages = tmp_path / "pages"
    paths = write_report(fleet_diagnosis_report(found, store.place.address, pages), pages)
    (table,) = json.loads(paths.json.read_text())["tables"]
    assert [column["label"] for column in table["columns"]] == [BEFORE, NOW]
    assert "M_1/A_1/before/report.html, M_1/A_1/now/report.html" in table["note"]


def test_mistakes_are_answered_in_one_line_before_anything_is_computed(store, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(diagnosing, "diagnose", lambda *_, **__: pytest.fail("a diagnosis was begun"))
    arguments = ["fleet", "diagnose", store.place.address, "--out", str(tmp_path / "pages")]
    assert main([*arguments, "--runs", "0"]) == 78
    assert "--runs 0: at least 1" in capsys.readouterr().err
    (tmp_path / "pages" / "M_1" / "A2" / "now").mkdir(parents=True)
    (tmp_path / "pages" / "M_1" / "A2" / "now" / "model.yaml").write_text("name: mine\n")
    assert main([*arguments, "--serial", "A2"]) == 78
    assert "not from `diagnose`" in capsys.readouterr().err
    assert main(arguments) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'pages' / 'report.html'}\n"
    page = json.loads((tmp_path / "pages" / "report.json").read_text())
    assert page["verdict"]["headline"] == "No drive changed: there is nothing to diagnose"

"""`fffo-drive fleet` as a user meets it: from runs to pages, and what it says of mistakes."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime

import duckdb
import pytest
from fleet.fleet_rig import TRUTH, write_run

from fffo_drive.cli import main

DAY_S = 86_400
START_S = int(datetime(2026, 3, 2, tzinfo=UTC).timestamp())
DRIVES, RUNS = 6, 4
OUTSIDE, CHANGED = 2, 4  # a drive with half as much friction again, and one that changed after its second run


@pytest.fixture(scope="module")
def fleet(facts_file, tmp_path_factory):
    """A store of six drives with four weekly runs each, made by the command."""
    directory = tmp_path_factory.mktemp("fleet")
    store = directory / "store"
    for drive in range(DRIVES):
        runs = directory / f"drive{drive}"
        runs.mkdir()
        for number in range(RUNS):
            more = 1.5 if drive == OUTSIDE else 1.3 if drive == CHANGED and number >= 2 else 1.0
            own = {
                name: value * (1.0 + 0.01 * ((drive * 7 + k * 3) % 5 - 2))
                for k, (name, value) in enumerate(TRUTH.items())
            }
            own["coulomb_nm"] *= more
            path = write_run(runs / f"run{number}.csv", 100 * drive + number, own)
            os.utime(path, (START_S + 7 * DAY_S * number,) * 2)
        words = ["--from", str(runs), "--drive", str(facts_file), "--serial", f"SN{drive}", "--model", "M1"]
        assert main(["fleet", "add", str(store), *words]) == 0
    assert main(["fleet", "work", str(store), "--workers", "1"]) == 0
    assert main(["fleet", "compact", str(store)]) == 0
    return store


def test_status_counts_and_names_the_drives(fleet, capsys):
    assert main(["fleet", "status", str(fleet)]) == 0
    said = capsys.readouterr().out
    assert "24 runs of 6 drives, 1 type: 100 % done" in said
    assert "M1, SN3: 4 runs, 2026-03-02 to 2026-03-23" in said
    assert main(["fleet", "status", str(fleet), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["recorded"], printed["waiting"], printed["failed"]) == (24, 0, 0)


def test_added_again_nothing_is_new_and_nothing_is_read(fleet, facts_file, capsys, monkeypatch):
    monkeypatch.setattr("fffo_drive.fleet.adding.digest_of", lambda path: pytest.fail(f"{path} was read"))
    runs = fleet.parent / "drive0"
    words = ["--from", str(runs), "--drive", str(facts_file), "--serial", "SN0", "--model", "M1"]
    assert main(["fleet", "add", str(fleet), *words, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["found"], printed["new"]) == (4, 0)


def test_the_report_names_who_stands_outside_and_draws_every_history(fleet, tmp_path, capsys):
    assert main(["fleet", "report", str(fleet), "--out", str(tmp_path / "page")]) == 0
    assert f"SN{OUTSIDE} stands outside: Coulomb friction" in capsys.readouterr().out
    printed = json.loads((tmp_path / "page" / "report.json").read_text())
    (model,) = printed["results"]["models"]
    assert (model["drives"], model["runs"]) == (DRIVES, DRIVES * RUNS)
    coulomb = next(one for one in model["spreads"] if one["name"] == "coulomb_nm")
    assert coulomb["median"] == pytest.approx(TRUTH["coulomb_nm"], rel=0.1)
    outside = {(one["drive"], one["quantity"]) for one in model["outsiders"]}
    assert (f"SN{OUTSIDE}", "coulomb_nm") in outside
    assert not any(drive not in (f"SN{OUTSIDE}", f"SN{CHANGED}") for drive, _ in outside)
    titles = {figure["title"] for figure in printed["figures"]}
    assert {f"SN{k}: Coulomb friction" for k in range(DRIVES)} <= titles
    page = (tmp_path / "page" / "report.html").read_text()
    assert "http://" not in page.replace("http://www.w3.org", "")


def test_the_history_of_named_drives_alone(fleet, tmp_path, capsys):
    assert main(["fleet", "report", str(fleet), "--serial", "SN1", "--out", str(tmp_path / "page"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["models"]
    printed = json.loads((tmp_path / "page" / "report.json").read_text())
    drawn = {figure["title"].split(":")[0] for figure in printed["figures"] if figure["name"].startswith("history")}
    assert drawn == {"SN1"}
    assert main(["fleet", "report", str(fleet), "--serial", "SN11", "--out", str(tmp_path / "other")]) == 78
    assert "SN1" in capsys.readouterr().err


def test_two_times_of_a_drive_are_compared(fleet, tmp_path, capsys):
    words = ["2026-03-01..2026-03-15", "2026-03-15..", "--store", str(fleet), "--serial", f"SN{CHANGED}"]
    assert main(["fleet", "compare", *words, "--out", str(tmp_path / "page"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["runs"] == [2, 2]
    coulomb = next(law for law in printed["laws"] if law["law"] == "Coulomb friction")
    assert coulomb["interval"][0] < 0.3 < coulomb["interval"][1]  # few runs, wide interval
    report = json.loads((tmp_path / "page" / "report.json").read_text())
    numbers = next(table for table in report["tables"] if table["name"] == "numbers")
    row = next(row for row in numbers["rows"] if row["label"] == "Coulomb friction")
    assert row["cells"][1]["value"] / row["cells"][0]["value"] == pytest.approx(1.3, abs=0.03)


def test_two_files_are_compared_without_a_store(fleet, facts_file, tmp_path, capsys):
    sides = [str(fleet.parent / f"drive{k}" / "run0.csv") for k in (0, OUTSIDE)]
    words = ["--drive", str(facts_file), "--out", str(tmp_path / "page")]
    assert main(["fleet", "compare", *sides, *words]) == 0
    said = capsys.readouterr().out
    assert "1 run against 1" in said
    for component in ("cosine", "sine"):
        assert said.count(f"\ngravity, {component} of the angle: ") == 1
    assert main(["fleet", "report", str(fleet), "--out", str(tmp_path / "page")]) == 78  # another kind of page is there
    assert "fleet-compare" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["status", "NOWHERE"], "no store here: check the path; `fffo-drive fleet add"),
        (["add", "NEW", "--from", "NOWHERE"], "NOWHERE: there is no such directory: check the path"),
        (["add", "NEW", "--from", "EMPTY"], "no run there"),
        (["add", "NEW"], "no run: name recordings"),
        (["work", "STORE", "--shard", "4/3"], "K from 1 to N"),
        (["work", "STORE", "--on", "ray:local"], "dask:local"),
        (["work", "STORE", "--workers", "0"], "at least 1"),
        (["compact", "STORE", "--keep", "-3"], "more than 0"),
        (["compare", "a..b", "..", "--store", "STORE", "--serial", "SN1", "--out", "OUT"], "is no time"),
        (
            ["compare", "2031-01-01..", "..", "--store", "STORE", "--serial", "SN1", "--out", "OUT"],
            "no record of drive",
        ),
        (["compare", "a", "b", "--store", "STORE", "--out", "OUT"], "0 runs of the store"),
        (["compare", "..", "..", "--serial", "SN1", "--out", "OUT"], "--store"),
    ],
)
def test_a_mistake_is_one_sentence(fleet, tmp_path, capsys, words, said):
    (tmp_path / "EMPTY").mkdir()
    known = {"STORE": str(fleet)} | {name: str(tmp_path / name) for name in ("NOWHERE", "NEW", "EMPTY", "OUT")}
    assert main(["fleet", *(known.get(word, word) for word in words)]) == 78
    output = capsys.readouterr().err.strip()
    assert said in output
    assert len(output.splitlines()) == 1


def test_a_table_without_facts_is_left_out_and_the_others_are_added(fleet, tmp_path, capsys):
    lonely = write_run(tmp_path / "lonely.csv", 1)
    garbage = tmp_path / "garbage.mcap"
    garbage.write_text("no recording")
    assert main(["fleet", "add", str(tmp_path / "store"), str(lonely), str(garbage)]) == 78
    output = capsys.readouterr()
    assert "--drive FILE" in output.err
    assert "garbage.mcap: not an MCAP file" in output.err
    assert "0 runs added, 0 known before, 2 not added" in output.out


def test_add_and_work_in_one_go(facts_file, tmp_path, capsys):
    run = write_run(tmp_path / "run.csv", 1)
    words = [str(run), "--drive", str(facts_file), "--work", "--workers", "1"]
    assert main(["fleet", "add", str(tmp_path / "store"), *words]) == 0
    assert "1 record made" in capsys.readouterr().out
    glob = str(tmp_path / "store" / "records" / "new" / "*.parquet")
    assert duckdb.sql(f"select drive, model from '{glob}'").fetchall() == [("axis", "axis")]

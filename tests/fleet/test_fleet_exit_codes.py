"""What `fleet add` and `fleet work` say of runs that get no record: in plain words, and by the exit code."""

from __future__ import annotations

import json

from fleet.fleet_rig import write_run

from fffo_drive.cli import main
from fffo_drive.cli.exits import printable


def test_a_run_without_a_record_is_told_by_the_exit_code(facts_file, tmp_path, capsys):
    broken, store = tmp_path / "broken.csv", tmp_path / "store"
    words = [str(broken), "--drive", str(facts_file), "--serial", "SN1", "--model", "M1"]
    broken.write_text("time_s,position_rev,current_command_a\n0,0,0\n0.002,\x1b[31m,0\n0.004,0,0\n")
    assert main(["fleet", "add", str(store), *words]) == 0
    capsys.readouterr()
    assert main(["fleet", "work", str(store), "--workers", "1"]) == 78
    said = capsys.readouterr()
    assert "broken.csv" in said.err
    assert "0 records made, 1 failed" in said.out
    assert all(sign.isprintable() or sign == "\n" for sign in said.out + said.err)
    assert main(["fleet", "work", str(store), "--workers", "1"]) == 0  # nothing is left to do
    capsys.readouterr()
    assert main(["fleet", "work", str(store), "--workers", "1", "--retry", "--json"]) == 78
    assert len(json.loads(capsys.readouterr().out)["failed"]) == 1
    assert main(["fleet", "add", str(tmp_path / "other"), *words, "--work", "--workers", "1"]) == 78


def test_what_is_no_run_beside_the_runs_is_named_and_skipped(facts_file, tmp_path, capsys):
    folder, store = tmp_path / "runs", tmp_path / "store"
    folder.mkdir()
    write_run(folder / "run.csv", 1)
    (folder / "notes.txt").write_text("oiled on Monday\n")
    words = [str(store), "--drive", str(facts_file), "--serial", "SN1", "--model", "M1"]
    assert main(["fleet", "add", *words, "--from", str(folder)]) == 0
    said = capsys.readouterr()
    assert "notes.txt" in said.err
    assert "1 run added, 0 known before, 1 skipped" in said.out
    assert main(["fleet", "work", str(store), "--workers", "1"]) == 0
    named = [words[0], str(folder / "notes.txt"), *words[1:]]
    assert main(["fleet", "add", *named]) == 78  # somebody named it
    assert "not added: " in capsys.readouterr().err


def test_control_characters_of_a_file_are_shown_as_their_escapes():
    assert printable("plain µ\nlines") == "plain µ\nlines"
    assert printable("\x1b[31mred\x07\r\x9b") == "\\x1b[31mred\\x07\\r\\x9b"

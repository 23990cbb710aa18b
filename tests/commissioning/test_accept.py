"""The line that names a record: written into the axis file when somebody agrees, and not for what has not passed."""

from __future__ import annotations

import json

import pytest
from commissioning.test_record import axis_file, record_for

from fffo_drive.cli import main
from fffo_drive.commissioning.judge import CHECKS, judged, not_done
from fffo_drive.commissioning.record import write_record
from fffo_drive.config.axis import read_axis
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.workflows.progress import CHECK_MARK, LINES_ENVIRONMENT

NAME = "canopen.commissioning.yaml"


@pytest.fixture
def identity():
    drive = SimulatedDrive()
    found = drive.connect()
    drive.close()
    return found


def test_the_line_is_written_and_the_comments_stay(tmp_path, identity, capsys):
    path = axis_file(tmp_path, named=False)
    before = path.read_text()
    write_record(tmp_path / NAME, record_for(path, identity))
    assert main(["commission", str(path), "--accept"]) == 0
    assert NAME in capsys.readouterr().out
    assert read_axis(path).commissioning == NAME
    assert path.read_text().replace(f"commissioning: {NAME}\n", "", 1) == before
    assert main(["commission", str(path), "--accept"]) == 0  # once more changes nothing


def test_no_record_one_that_failed_and_one_of_other_facts_are_refused(tmp_path, identity, capsys):
    path = axis_file(tmp_path, named=False)
    before = path.read_text()
    assert main(["commission", str(path), "--accept"]) == 78
    assert "commission the axis first" in capsys.readouterr().err
    checks = [judged(name, "ok", "fine") for name in CHECKS][:-1] + [not_done("quick_stop", "ended")]
    write_record(tmp_path / NAME, record_for(path, identity, checks))
    assert main(["commission", str(path), "--accept"]) == 78
    assert "has not passed" in capsys.readouterr().err
    write_record(tmp_path / NAME, record_for(path, identity))
    assert path.read_text() == before
    path.write_text(before.replace("rated_torque_nm: 1.2284", "rated_torque_nm: 2.5"))
    assert main(["commission", str(path), "--accept"]) == 78
    assert "rated_torque_nm was 1.2284, is 2.5" in capsys.readouterr().err


def test_each_check_is_reported_as_it_comes_with_the_motion_before_it(tmp_path, monkeypatch, capsys):
    from pathlib import Path

    monkeypatch.setenv(LINES_ENVIRONMENT, "1")
    axis = Path(__file__).resolve().parents[2] / "configs" / "axis_simulated.yaml"
    assert main(["commission", str(axis), "--out", str(tmp_path / "record.yaml")]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith(CHECK_MARK)]
    checks = [json.loads(line.removeprefix(CHECK_MARK)) for line in lines]
    assert {check["name"] for check in checks} == set(CHECKS)
    assert [check["name"] for check in checks][:2] != list(reversed(list(CHECKS)))[:2]
    sign = next(check for check in checks if check["name"] == "torque_sign")
    assert len(sign["motion"]["time_s"]) == len(sign["motion"]["velocity_rps"]) > 10
    assert max(map(abs, sign["motion"]["command_a"])) > 0

"""The record, and what asks for it: an axis on a bus is enabled with the right one only."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fffo_drive.cli import main
from fffo_drive.commissioning.judge import CHECKS, graded, judged, not_done, within
from fffo_drive.commissioning.record import (
    BoundsRecord,
    CommissioningRecord,
    DeclaredFacts,
    DriveRecord,
    content_hash,
    overall,
    read_record,
    write_record,
)
from fffo_drive.config.commissioning import declared_facts, permission
from fffo_drive.documents import DocumentError
from fffo_drive.drive.port import DriveRefusedError
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.workflows.plan import connect, make_plan, run_header

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
NAME = "canopen.commissioning.yaml"


def axis_file(tmp_path, old="", new="", named=True):
    """The shipped axis on a bus, naming a record beside it."""
    text = (CONFIGS / "axis_canopen.yaml").read_text()
    text = text.replace("models/table1.yaml", str(CONFIGS / "models" / "table1.yaml"))
    assert old in text
    text = text.replace(old, new) if old else text
    path = tmp_path / "axis.yaml"
    path.write_text(text + (f"\ncommissioning: {NAME}\n" if named else ""))
    return path


def record_for(path, identity, checks=None):
    """A record of a commissioning that found the drive with this identity."""
    plan = make_plan(path)
    facts = declared_facts(plan.axis, plan.model)
    if checks is None:
        checks = [judged(name, "ok", "fine") for name in CHECKS]
    return CommissioningRecord(
        axis="canopen", date="2026-01-02T03:04:05+00:00", tool="fffo_drive", bus="loopback:20000",
        drive=DriveRecord.of(identity), facts=facts, facts_hash=facts.digest, model="table1",
        bounds=BoundsRecord(current_a=1.0, speed_rps=2.0, travel_rev=3.0, time_s=4.0),
        verdict=overall(checks), checks=checks,
    )  # fmt: skip


@pytest.fixture
def identity():
    drive = SimulatedDrive()
    identity = drive.connect()
    drive.close()
    return identity


def granted(path, uncommissioned=False):
    plan = make_plan(path)
    return permission(path, plan.axis, plan.model, uncommissioned)


def test_a_record_comes_back_as_it_was_written(tmp_path, identity):
    limits = within(1.0, 0.1, 0.2)
    checks = [
        graded("velocity_scale", 1.15, 1.0, limits, "-", "a little off: ü", "look", {"a": 1.5}),
        not_done("delay", "not done: something"),
    ]
    written = write_record(tmp_path / NAME, record_for(axis_file(tmp_path), identity, checks))
    assert read_record(tmp_path / NAME) == written
    assert written.content_hash == content_hash(written)
    assert not list(tmp_path.glob("*.part"))


def test_a_record_that_was_edited_is_refused(tmp_path, identity):
    checks = [judged("delay", "failed", "late", "mend")]
    write_record(tmp_path / NAME, record_for(axis_file(tmp_path), identity, checks))
    text = (tmp_path / NAME).read_text()
    assert "verdict: failed" in text
    (tmp_path / NAME).write_text(text.replace("verdict: failed", "verdict: ok"))
    with pytest.raises(DocumentError, match=r"content_hash: does not match.*commission the axis again"):
        read_record(tmp_path / NAME)
    with pytest.raises(DocumentError, match="content_hash"):
        granted(axis_file(tmp_path))


@pytest.mark.parametrize(
    ("verdicts", "expected"),
    [
        (["ok", "ok"], "ok"),
        (["ok", "warning"], "warning"),
        (["warning", "failed"], "failed"),
        (["ok", "not_done"], "failed"),
        ([], "failed"),
    ],
)
def test_a_check_that_was_not_made_was_not_passed(verdicts, expected):
    names = list(CHECKS)
    assert overall([judged(names[k], verdict, "") for k, verdict in enumerate(verdicts)]) == expected


def test_verdicts_of_numbers():
    limits = within(10.0, 1.0, 3.0)
    for value, verdict in ((9.0, "ok"), (11.0, "ok"), (12.0, "warning"), (6.9, "failed"), (float("nan"), "failed")):
        check = graded("delay", value, 10.0, limits, "s", "text", "remedy")
        assert check.verdict == verdict
        assert check.remedy == ("" if verdict == "ok" else "remedy")


def test_permission_with_the_right_record(tmp_path, identity):
    path = axis_file(tmp_path)
    record = write_record(tmp_path / NAME, record_for(path, identity))
    given = granted(path)
    assert given.record == record
    drive = SimulatedDrive()
    assert connect(drive, given) == identity
    plan = make_plan(path)
    header = run_header(plan, identity, plan.toggle, given)
    assert header.metadata["commissioning"] == f"ok: {NAME} of {record.date}, SHA-256 {record.content_hash}"
    assert header.attachments[-1] == (NAME, "application/yaml", (tmp_path / NAME).read_bytes())


def test_another_drive_is_refused_and_left(tmp_path, identity):
    path = axis_file(tmp_path)
    write_record(tmp_path / NAME, record_for(path, identity._replace(serial_number=identity.serial_number + 1)))
    closed = []

    class Watched(SimulatedDrive):
        def close(self):
            closed.append(True)
            super().close()

    with pytest.raises(
        DriveRefusedError, match=r"not the drive that was commissioned.*serial_number 0x00000002.*0x00000001"
    ):
        connect(Watched(), granted(path))
    assert closed


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("counts_per_rev: 32768 ", "counts_per_rev: 65536 ", "counts_per_rev was 32768.0, is 65536.0"),
        ("velocity_units_per_rps: 32768", "velocity_units_per_rps: 60", "velocity_units_per_rps was 32768.0, is 60.0"),
        ("rated_torque_nm: 1.2284", "rated_torque_nm: 1.3\n  inverted: true", "inverted was False, is True"),
        (
            "rated_torque_nm: 1.2284",
            "rated_torque_nm: 1.2284\n  rated_torque_unit: uNm",
            "rated_torque_unit_nm was 0.001, is 1e-06",
        ),
    ],
)
def test_changed_facts_need_a_new_commissioning(tmp_path, identity, old, new, said):
    write_record(tmp_path / NAME, record_for(axis_file(tmp_path), identity))
    with pytest.raises(DocumentError) as caught:
        granted(axis_file(tmp_path, old, new))
    assert said in str(caught.value)
    assert "commission it again" in str(caught.value)


def test_the_usual_units_of_the_name_plate_leave_the_hash_of_older_records():
    """SHA-256 of the facts as they were written before the units were among them."""
    facts = {"drive_kind": "canopen", "torque_constant_nm_per_a": 0.1}
    written = {
        "counts_per_rev": None, "drive_kind": "canopen", "inverted": False, "rated_current_a": None,
        "rated_torque_nm": None, "torque_constant_nm_per_a": 0.1, "velocity_units_per_rps": None,
    }  # fmt: skip
    assert DeclaredFacts(**facts).model_dump(mode="json") == written
    counting = DeclaredFacts(**facts, rated_torque_unit_nm=1e-6)
    assert counting.model_dump(mode="json") == written | {"rated_torque_unit_nm": 1e-6}
    assert counting.digest != DeclaredFacts(**facts).digest


def test_changed_gains_do_not(tmp_path, identity):
    write_record(tmp_path / NAME, record_for(axis_file(tmp_path), identity))
    assert granted(axis_file(tmp_path, "proportional_a_per_rps: 0.975", "proportional_a_per_rps: 0.9")).record


def test_a_record_that_has_not_passed_says_why(tmp_path, identity):
    checks = [judged("delay", "failed", "9 ms", "set it"), not_done("quick_stop", "not done")]
    path = axis_file(tmp_path)
    write_record(tmp_path / NAME, record_for(path, identity, checks))
    with pytest.raises(DocumentError, match=r"axis.yaml:\d+: commissioning: .*has not passed: delay \(9 ms\)"):
        granted(path)


def test_the_simulated_drive_in_process_needs_none():
    path = CONFIGS / "axis_simulated.yaml"
    given = granted(path)
    assert given.record is None
    assert "in process" in given.note


def test_run_refuses_an_axis_on_a_bus_without_a_record(tmp_path, capsys):
    words = ["--bus", "socketcan:nosuch0", "--out", str(tmp_path / "run.mcap")]
    path = axis_file(tmp_path, named=False)
    assert main(["run", str(path), *words]) == 78
    said = capsys.readouterr().err
    assert "fffo-drive commission" in said
    assert "--uncommissioned" in said
    assert main(["run", str(axis_file(tmp_path)), *words]) == 78
    assert f"{NAME} is not there: run fffo-drive commission" in capsys.readouterr().err
    # told explicitly, it goes on to the bus
    assert main(["run", str(path), *words, "--uncommissioned"]) == 69
    assert granted(path, uncommissioned=True).note == "none: --uncommissioned was given"


def test_run_goes_on_to_the_bus_with_a_record(tmp_path, identity, capsys):
    path = axis_file(tmp_path)
    write_record(tmp_path / NAME, record_for(path, identity))
    assert main(["run", str(path), "--bus", "socketcan:nosuch0", "--out", str(tmp_path / "run.mcap")]) == 69


@pytest.mark.slow
def test_the_command_writes_the_record_that_it_prints(tmp_path, capsys):
    out = tmp_path / "records" / "record.yaml"
    axis = CONFIGS / "axis_simulated.yaml"
    assert main(["commission", str(axis), "--out", str(out), "--json", "--current", "2"]) == 0
    printed = json.loads(capsys.readouterr().out)
    record = read_record(out)
    assert CommissioningRecord.model_validate(printed) == record
    assert record.passed
    assert record.bounds.current_a == 2.0
    assert record.drive.device_name == "simulated drive, in process"
    assert [check.name for check in record.checks] == list(CHECKS)


@pytest.mark.slow
def test_an_axis_that_does_not_pass_has_its_record_and_its_exit_code(tmp_path, capsys):
    axis = CONFIGS / "axis_simulated.yaml"
    out = tmp_path / "record.yaml"
    assert main(["commission", str(axis), "--out", str(out), "--current", "0.1"]) == 70
    captured = capsys.readouterr()
    assert "not passed: motion" in captured.err
    assert "--current" in captured.out
    assert not read_record(out).passed


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--current", "100"], "--current 100 A: above 0 and at most 8.3"),
        (["--speed", "0"], "--speed 0 rps: above 0 and at most 25"),
        (["--travel", "-1"], "--travel -1 rev: must be above 0"),
    ],
)
def test_bounds_beyond_the_envelope_are_refused(tmp_path, words, said, capsys):
    out = ["--out", str(tmp_path / "record.yaml")]
    assert main(["commission", str(CONFIGS / "axis_simulated.yaml"), *out, *words]) == 78
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_command_has_help(capsys):
    with pytest.raises(SystemExit):
        main(["commission", "--help"])
    assert "before any loop is closed" in capsys.readouterr().out

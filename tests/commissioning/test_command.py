"""What `commission` asks, and what it says: the verdict first, readable at 80 columns."""

from __future__ import annotations

import numpy as np
import pytest
from commissioning.test_record import CONFIGS, axis_file, record_for

from fffo_drive.cli import commission, main
from fffo_drive.cli.commission import found_text, next_line, verdict_line
from fffo_drive.commissioning.estimate import HeldCurrent
from fffo_drive.commissioning.judge import CHECKS, graded, judged, not_done, within
from fffo_drive.commissioning.motion_checks import Beliefs, current_scale
from fffo_drive.commissioning.objects import NamePlate
from fffo_drive.commissioning.record import read_record
from fffo_drive.documents import DocumentError
from fffo_drive.drive.port import DriveIdentity
from fffo_drive.workflows.commission import bounds_of, commission_axis, commissioning_plan
from fffo_drive.workflows.plan import make_plan

IDENTITY = DriveIdentity(1, 2, 3, 4, "a servo drive", "1.0")
NO_BUS = ["--bus", "socketcan:nosuch0"]
BELIEFS = Beliefs(157.0, 0.00275, 0.0007, 0.067, 0.148)


@pytest.fixture
def terminal(monkeypatch):
    """Somebody at a terminal who answers with what is put into the list."""
    answers: list[str] = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda prompt: answers.pop(0))
    return answers


def test_where_nobody_can_be_asked_nothing_moves_without_yes(tmp_path, capsys, monkeypatch):
    words = ["commission", str(axis_file(tmp_path)), *NO_BUS, "--out", str(tmp_path / "record.yaml")]
    monkeypatch.setattr("sys.stdin.isatty", lambda: False)
    assert main(words) == 78
    assert "give --yes" in capsys.readouterr().err
    assert main([*words, "--yes"]) == 69  # it goes on to the bus, which is not there


@pytest.mark.parametrize(("answer", "code"), [("", 0), ("n", 0), ("no", 0), ("maybe", 0), ("y", 69), ("Yes", 69)])
def test_at_a_terminal_it_asks_and_takes_only_a_yes(tmp_path, capsys, terminal, answer, code):
    terminal.append(answer)
    assert main(["commission", str(axis_file(tmp_path)), *NO_BUS, "--out", str(tmp_path / "record.yaml")]) == code
    said = capsys.readouterr().err
    assert terminal == []
    assert "the axis will move: at most 4.15 A, 5 rps, 2 rev" in said
    assert ("nothing was moved" in said) == (code == 0)
    assert not (tmp_path / "record.yaml").exists()


def test_json_is_one_object_and_no_question(tmp_path, capsys, terminal):
    assert main(["commission", str(axis_file(tmp_path)), *NO_BUS, "--json", "--out", str(tmp_path / "r.yaml")]) == 78
    assert capsys.readouterr().out == ""


def test_a_drive_in_process_moves_nothing_and_is_not_asked_for():
    options = type("Options", (), {"yes": False, "json": False})
    assert commission._may_move(make_plan(CONFIGS / "axis_simulated.yaml"), options)


def test_one_count_is_told_before_anything_moves(tmp_path, capsys, terminal):
    terminal.append("n")
    main(["commission", str(axis_file(tmp_path)), *NO_BUS, "--out", str(tmp_path / "record.yaml")])
    assert "one per mille of 0x6071 is 0.0083 A (0.00123 Nm)" in capsys.readouterr().err


def checks(**changed):
    """All checks, ok but for these."""
    return [
        changed.get(name) or judged(name, "ok", f"{name} is fine, as a sentence of usual length has it")
        for name in CHECKS
    ]


OFF = graded("delay", 0.004, 0.00275, within(0.00275, 5e-4, 2e-3), "s", "4 ms, the model says 2.75 ms", "set delay_s")
WRONG = judged("torque_sign", "failed", "the shaft turns backwards", "swap two phases")
NOT = {name: not_done(name, "not done: torque_sign failed") for name in list(CHECKS)[5:]}


@pytest.mark.parametrize(
    ("found", "verdict", "what_next"),
    [
        (checks(), "passed: all 17 checks are ok", "commissioning: record.yaml"),
        (checks(delay=OFF), "passed, with a warning from 1 of 17 checks: delay", "commissioning: record.yaml"),
        (
            checks(torque_sign=WRONG, **NOT), "not passed: torque_sign: the shaft turns backwards", "swap two phases",
        ),
        (
            checks(**NOT), "not passed: 12 of 17 checks were not done: not done: torque_sign failed",
            "remove the cause, and commission again",
        ),
    ],
)  # fmt: skip
def test_the_verdict_says_whether_why_and_what_next(tmp_path, found, verdict, what_next):
    path = axis_file(tmp_path, named=False)
    record = record_for(path, IDENTITY, found)
    assert verdict_line(record) == verdict
    assert next_line(record, make_plan(path), tmp_path / "record.yaml").endswith(what_next)


@pytest.mark.parametrize("width", [80, 120])
def test_the_verdict_comes_first_and_the_table_reads_at_this_width(tmp_path, capsys, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    path = axis_file(tmp_path, named=False)
    found = checks(delay=OFF, torque_sign=WRONG, **{name: NOT[name] for name in ("speed_limit", "quick_stop")})
    commission._print(record_for(path, IDENTITY, found), make_plan(path), tmp_path / "record.yaml")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("canopen: not passed: torque_sign: the shaft turns backwards")
    assert lines[1] == "next: swap two phases"
    table = lines[4:]
    assert max(len(line.rstrip()) for line in table) <= width
    assert len(table) < 2.6 * len(CHECKS)
    assert sum("not done: torque_sign failed" in line for line in table) == 1  # one cause is told once
    assert any("measured 0.004 s, ok is 0.00225 to 0.00325 s" in line for line in table)


def test_what_is_not_ok_has_its_range_and_remedy_beside_it():
    assert found_text(OFF).splitlines() == [
        "4 ms, the model says 2.75 ms", "measured 0.004 s, ok is 0.00225 to 0.00325 s", "-> set delay_s"
    ]  # fmt: skip
    assert found_text(judged("motion", "ok", "it moves")) == "it moves"


@pytest.mark.parametrize("counts", [20, 22, 50, 400])
@pytest.mark.parametrize("truncation", [np.floor, np.round, np.ceil])
def test_a_drive_that_reports_in_steps_is_not_blamed_for_them(counts, truncation):
    """A right drive reports the current that flows, 1 % beside what was sent, in whole per mille of the rated one."""
    for flows in (0.99 * counts, 1.01 * counts):
        held = HeldCurrent(float(truncation(flows)) / counts, 1.0 / counts)
        assert current_scale(1.0, 50, held, NamePlate(), BELIEFS).verdict == "ok"


@pytest.mark.parametrize("factor", [0.5, 0.85, 1.15, 2**0.5, 1.73])
def test_a_wrong_rating_is_seen_beyond_the_steps(factor):
    for counts in (20, 400):
        held = HeldCurrent(round(factor * counts) / counts, 1.0 / counts)
        assert current_scale(1.0, 50, held, NamePlate(), BELIEFS).verdict != "ok"


@pytest.mark.slow
def test_commissioning_as_a_function_prints_nothing_and_returns_what_it_wrote(tmp_path, capsys):
    plan = commissioning_plan(CONFIGS / "axis_simulated.yaml")
    steps: list[str] = []
    out = tmp_path / "records" / "simulated.yaml"
    record = commission_axis(plan, bounds_of(plan, current_a=3.0), out, tell=steps.append)
    assert record.passed
    assert read_record(out) == record
    assert record.bounds.current_a == 3.0
    assert steps[0] == "listening, no voltage"
    assert capsys.readouterr() == ("", "")
    with pytest.raises(DocumentError, match="--current 99 A"):
        bounds_of(plan, current_a=99.0)

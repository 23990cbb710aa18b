"""What `commission` asks, and what it says: the verdict first, readable at 80 columns."""

from __future__ import annotations

import io
import json
from types import SimpleNamespace

import numpy as np
import pytest
from commissioning.test_record import CONFIGS, axis_file, record_for

from fffo_drive.cli import commission, main
from fffo_drive.cli.commission import Asking, found_text, next_line, verdict_line
from fffo_drive.commissioning.estimate import HeldCurrent
from fffo_drive.commissioning.judge import CHECKS, graded, judged, not_done, within
from fffo_drive.commissioning.motion_checks import Beliefs, current_scale
from fffo_drive.commissioning.objects import NamePlate
from fffo_drive.commissioning.procedure import NextMotion, NotAgreedError
from fffo_drive.commissioning.record import read_record
from fffo_drive.documents import DocumentError
from fffo_drive.drive.port import DriveIdentity
from fffo_drive.workflows.commission import bounds_of, commission_axis, commissioning_plan
from fffo_drive.workflows.plan import make_plan
from fffo_drive.workflows.progress import LINES_ENVIRONMENT, QUESTION_MARK

IDENTITY = DriveIdentity(1, 2, 3, 4, "a servo drive", "1.0")
NO_BUS = ["--bus", "socketcan:nosuch0"]
BELIEFS = Beliefs(157.0, 0.00275, 0.0007, 0.067, 0.148)


MOTION = NextMotion(("motion", "torque_sign"), "pulses, at most 2 rps and 1 rev")


@pytest.fixture
def terminal(monkeypatch):
    """Somebody at a terminal who answers with what is put into the list, and what was asked."""
    answers: list[str] = []
    asked: list[str] = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda prompt: asked.append(prompt) or answers.pop(0))
    return SimpleNamespace(answers=answers, asked=asked)


def test_where_nobody_can_be_asked_nothing_moves_without_yes(tmp_path, capsys, monkeypatch):
    words = ["commission", str(axis_file(tmp_path)), *NO_BUS, "--out", str(tmp_path / "record.yaml")]
    monkeypatch.setattr("sys.stdin.isatty", lambda: False)
    assert main(words) == 78
    assert "give --yes" in capsys.readouterr().err
    assert main([*words, "--yes"]) == 69  # it goes on to the bus, which is not there


def asking(path, **options):
    return Asking(make_plan(path), SimpleNamespace(**{"yes": False, "json": False} | options))


@pytest.mark.parametrize(
    ("answer", "agreed"), [("", False), ("n", False), ("no", False), ("maybe", False), ("y", True), ("Yes", True)]
)
def test_at_a_terminal_it_asks_before_each_motion_and_takes_only_a_yes(tmp_path, terminal, answer, agreed):
    ask = asking(axis_file(tmp_path))
    terminal.answers += [answer, "no", "y"]
    assert [ask(MOTION) for _ in range(3)] == [agreed, False, True]
    assert terminal.asked == ["motion, torque_sign: pulses, at most 2 rps and 1 rev. May it move? [y/N/all] "] * 3


def test_all_is_this_motion_and_the_rest_without_asking(tmp_path, terminal):
    ask = asking(axis_file(tmp_path))
    terminal.answers += ["y", "all"]
    assert all(ask(MOTION) for _ in range(5))
    assert len(terminal.asked) == 2
    assert asking(axis_file(tmp_path), yes=True)(MOTION)
    assert len(terminal.asked) == 2


def test_the_program_that_started_it_is_asked_in_lines_and_its_end_is_a_no(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv(LINES_ENVIRONMENT, "1")
    monkeypatch.setattr("sys.stdin", io.StringIO("yes\nno\n"))
    ask = asking(axis_file(tmp_path))
    assert [ask(MOTION) for _ in range(3)] == [True, False, False]
    questions = capsys.readouterr().err.splitlines()
    assert [json.loads(line.removeprefix(QUESTION_MARK)) for line in questions] == [
        {"checks": ["motion", "torque_sign"], "text": MOTION.text}
    ] * 3


def test_json_is_one_object_and_no_question(tmp_path, capsys, terminal):
    assert main(["commission", str(axis_file(tmp_path)), *NO_BUS, "--json", "--out", str(tmp_path / "r.yaml")]) == 78
    assert capsys.readouterr().out == ""


def test_a_drive_in_process_moves_nothing_and_is_not_asked_for():
    assert asking(CONFIGS / "axis_simulated.yaml")(MOTION)


def test_one_count_and_the_bounds_are_reported_before_anything_moves(tmp_path, capsys, terminal):
    main(["commission", str(axis_file(tmp_path)), *NO_BUS, "--out", str(tmp_path / "record.yaml")])
    said = capsys.readouterr().err
    assert "one per mille of 0x6071 is 0.0083 A (0.00123 Nm)" in said
    assert "the axis will move: at most 4.15 A, 5 rps, 2 rev" in said


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
        (checks(), "passed: all 19 checks are ok", "commissioning: record.yaml"),
        (checks(delay=OFF), "passed, with a warning from 1 of 19 checks: delay", "commissioning: record.yaml"),
        (
            checks(torque_sign=WRONG, **NOT), "not passed: torque_sign: the shaft turns backwards", "swap two phases",
        ),
        (
            checks(**NOT), "not passed: 14 of 19 checks were not done: not done: torque_sign failed",
            "remove the cause, and commission again",
        ),
    ],
)  # fmt: skip
def test_the_verdict_says_whether_why_and_what_next(tmp_path, found, verdict, what_next):
    path = axis_file(tmp_path, named=False)
    record = record_for(path, IDENTITY, found)
    assert verdict_line(record) == verdict
    assert next_line(record, make_plan(path), tmp_path / "record.yaml").endswith(what_next)
    if record.passed:
        blank = path.rename(tmp_path / "my axis.yaml")
        assert f"commission '{blank}' --accept" in next_line(record, make_plan(blank), tmp_path / "record.yaml")


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
    assert sum("not done: torque_sign failed" in line for line in table) == 1  # one cause is reported once
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


MOTIONS = ["motion", "counts_per_rev", "current_limit", "speed_limit", "position_window", "resonance", "contact"]


@pytest.mark.slow
def test_each_motion_is_asked_for_with_how_far_and_how_fast(tmp_path):
    plan = commissioning_plan(CONFIGS / "axis_simulated.yaml")
    asked: list[NextMotion] = []
    out = tmp_path / "record.yaml"
    commission_axis(plan, bounds_of(plan), out, may_move=lambda motion: asked.append(motion) or True)
    assert [motion.checks[0] for motion in asked] == MOTIONS
    assert [name for motion in asked for name in motion.checks] == list(CHECKS)[1:]  # all but standstill
    assert all("rps" in motion.text and "rev" in motion.text for motion in asked)
    assert "at most 4.15 A, 5 rps and 2 rev from here" in asked[0].text


@pytest.mark.slow
@pytest.mark.parametrize("refused", MOTIONS)
def test_what_nobody_agrees_to_is_not_made_and_no_record_is_written(tmp_path, refused):
    plan = commissioning_plan(CONFIGS / "axis_simulated.yaml")
    seen: dict[str, str] = {}
    out = tmp_path / "record.yaml"
    with pytest.raises(NotAgreedError, match=f"not agreed to: .*{refused}.*no record was written") as error:
        commission_axis(
            plan, bounds_of(plan), out, seen=lambda check, _: seen.update({check.name: check.verdict}),
            may_move=lambda motion: refused not in motion.checks,
        )  # fmt: skip
    assert ("nothing was moved" in str(error.value)) == (refused == "motion")
    assert set(seen) == set(CHECKS)
    assert (seen["standstill"], seen[refused], seen["contact"]) == ("ok", "not_done", "not_done")
    assert not out.exists()

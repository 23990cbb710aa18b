"""Jobs: commands in processes of their own, followed, refused while one runs, cancelled as Ctrl-C does."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from types import SimpleNamespace

import pytest

from fffo_drive.cli import progress
from fffo_drive.cli.progress import progress_bar
from fffo_drive.documents import DocumentError
from fffo_drive.workbench.actions import ACTIONS
from fffo_drive.workbench.jobs import NICE, BusyError, Jobs, give_way
from fffo_drive.workflows.progress import LINE_MARK, LINES_ENVIRONMENT, QUESTION_MARK

PATIENCE_S = 120.0


def finished(jobs, *words):
    ended = threading.Event()
    job = jobs.start("test", "a test", words, None, lambda _: ended.set())
    assert ended.wait(PATIENCE_S)
    return job


def test_a_command_is_followed_to_its_end():
    job = finished(Jobs(), "--version")
    assert (job.state, job.exit_code) == ("done", 0)
    assert job.as_object()["line"] == "fffo-drive --version"
    assert job.lines[0].startswith("fffo-drive ")


def test_what_the_command_refuses_is_said():
    job = finished(Jobs(), "run", "nowhere.yaml")
    assert (job.state, job.exit_code) == ("failed", 78)
    assert "nowhere.yaml" in "\n".join(job.lines)


def test_progress_is_reported_in_lines_that_are_no_output(monkeypatch, capsys):
    monkeypatch.setenv(LINES_ENVIRONMENT, "1")
    with progress_bar("diagnose", quiet=True) as tell:
        tell(0.25, "search")
    lines = capsys.readouterr().err.splitlines()
    assert all(line.startswith(LINE_MARK) for line in lines)
    said = [json.loads(line[len(LINE_MARK) :]) for line in lines]
    assert [one["share"] for one in said] == [0.0, 0.25, 1.0]
    assert [one["text"] for one in said] == ["diagnose", "diagnose: search", "diagnose"]


def test_in_a_terminal_the_bar_has_the_step_beside_it(monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    shown = []
    monkeypatch.setattr(progress.Progress, "update", lambda *_, completed, description: shown.append(description))
    with progress_bar("diagnose") as tell:
        tell(0.25, "search")
        tell(0.5)
    assert shown == ["diagnose: search", "diagnose", "diagnose"]


def test_without_a_terminal_the_share_done_is_a_line_now_and_then(monkeypatch, capsys):
    times = iter([0.0, 1.0, 11.0, 11.0, 12.0])
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: next(times)))
    with progress_bar("diagnose") as tell:
        for share in (0.1, 0.25, 0.3):
            tell(share)
    assert capsys.readouterr().err == "diagnose: 25 % done\n"


ASKS = f"""
import sys
print({QUESTION_MARK!r} + '{{"checks": ["motion"], "text": "pulses"}}', file=sys.stderr, flush=True)
print("heard", sys.stdin.readline().strip(), flush=True)
print("then", repr(sys.stdin.readline()), flush=True)
"""


@pytest.fixture
def asking(monkeypatch):
    """A job that asks once, and hears the end of what it is told."""
    real = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", lambda words, **how: real([sys.executable, "-c", ASKS], **how))
    ended = threading.Event()
    job = Jobs().start("commission", "a test", (), None, lambda _: ended.set())
    while job.question is None:
        assert job.state == "running"
    yield job
    job.process.stdin.close()
    assert ended.wait(PATIENCE_S)
    assert job.question is None
    assert job.lines[-1] == "then ''"  # with who asked for the job, the answers end, too


def test_the_question_before_a_motion_is_answered_once_and_by_its_number(asking):
    assert asking.as_object()["question"] == {"number": 1, "checks": ["motion"], "text": "pulses"}
    for number, answer, text in (
        (2, "yes", "not open any more"),
        (1, "maybe", "yes, all, no"),
        (None, "no", "not open"),
    ):
        with pytest.raises(DocumentError, match=text):
            asking.answer(number, answer)
    assert asking.answer(1, "all")["checks"] == ["motion"]
    with pytest.raises(DocumentError, match="not open any more"):
        asking.answer(1, "yes")
    while not asking.lines:
        assert asking.state == "running"
    assert asking.lines[0] == "heard all"


def test_a_question_that_nobody_answers_has_no_answer(asking):
    asking.process.stdin.close()
    while len(asking.lines) < 2:
        assert asking.exit_code in (None, 0)
    assert asking.lines[0] == "heard "


@pytest.mark.slow
@pytest.mark.parametrize("handler", [signal.default_int_handler, signal.SIG_IGN])  # ignored: begun by a script, with &
def test_one_job_runs_at_a_time_and_an_interrupt_ends_it(handler, tmp_path, monkeypatch):
    monkeypatch.setattr("fffo_drive.workbench.jobs.GRACE_S", 1e6)
    before = signal.signal(signal.SIGINT, handler)
    try:
        jobs_one_at_a_time(tmp_path)
    finally:
        signal.signal(signal.SIGINT, before)


def jobs_one_at_a_time(tmp_path):
    jobs = Jobs()
    ended = threading.Event()
    job = jobs.start("serve", "a workbench", ("workbench", "--no-browser", "--out", str(tmp_path)), None,
                     lambda _: ended.set())  # fmt: skip
    with pytest.raises(BusyError, match="a workbench is running"):
        jobs.start("other", "another", ("--version",), None, lambda _: None)
    while not any("Ctrl-C" in line for line in job.lines):
        assert job.process.poll() is None
    job.cancel()
    assert ended.wait(PATIENCE_S)
    assert job.state == "cancelled"
    assert jobs.running is None
    assert finished(jobs, "--version").state == "done"


def test_what_only_computes_gives_way_and_what_runs_a_loop_does_not():
    sleeping = [sys.executable, "-c", "import time; time.sleep(60)"]
    with subprocess.Popen(sleeping) as process:
        give_way(process.pid)
        assert os.getpriority(os.PRIO_PROCESS, process.pid) == NICE
        assert os.sched_getscheduler(process.pid) == os.SCHED_BATCH
        process.kill()
    give_way(process.pid)  # gone: no error
    computing = {"identify", "diagnose", "compare", "tune", "fleet_add", "fleet_work", "fleet_report", "fleet_diagnose"}
    assert {name for name, action in ACTIONS.items() if action.computes} == computing
    assert not any(action.moves or action.beside for action in ACTIONS.values() if action.computes)

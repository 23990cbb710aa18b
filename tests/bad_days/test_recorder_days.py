"""Bad days of the recorder around a whole run: killed, disk full, gone or stuck; and its keys in the axis file.

What the recorder does turn by turn is tested in tests/recording.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from bad_days.killed_recorders import TURN_ROWS, rows_of
from interpreted import TESTS
from recording.samples import WALL_NS, Disk, FakeClock, FakeRing, random_rows

from fffo_drive.cli import main
from fffo_drive.cli.run import _print as print_summary
from fffo_drive.config.axis import read_axis, recorder_settings
from fffo_drive.control.envelope import TRIP_NONE
from fffo_drive.control.friction_observer import TOGGLE_FEEDFORWARD
from fffo_drive.drive.port import ExchangeCounts
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.recorder import Recorder
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.recording.settings import (
    RecorderHooks,
    RecorderSettings,
    RecorderStatistics,
    RotationPolicy,
    RunHeader,
)
from fffo_drive.runtime.runs import RunOutcome, simulated_ring_rows
from fffo_drive.runtime.session import Session
from fffo_drive.workflows.plan import make_plan, open_drive, plan_session
from fffo_drive.workflows.recordings import recorded_rows

FILES = TESTS / "bad_input" / "files"
KILLS = 30
LAST_SECOND = 2000  # rows
LONG = "{kind: sine, duration_s: 5, amplitude: 5, frequency_hz: 1}"  # 10,000 rows and the tail


def axis_file(directory: Path, recording: str = "{}") -> Path:
    """The axis in process with a profile of five seconds."""
    shutil.copytree(FILES, directory, dirs_exist_ok=True)
    text = (FILES / "axis.yaml").read_text().replace("{kind: paper, duration_s: 60}", LONG)
    path = directory / "axis.yaml"
    path.write_text(f"{text}recording: {recording}\n")
    return path


# --- killed


@pytest.fixture(scope="module")
def killed(tmp_path_factory) -> tuple[Path, dict[str, int]]:
    root = tmp_path_factory.mktemp("killed")
    seeds = [str(seed) for seed in range(KILLS)]
    for seed in seeds:
        (root / seed).mkdir()
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([str(TESTS), str(TESTS.parent)]))
    script = str(TESTS / "bad_days" / "killed_recorders.py")
    done = subprocess.run(
        [sys.executable, "-W", "ignore", script, str(root), *seeds],
        env=environment, capture_output=True, text=True, timeout=150,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return root, json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(KILLS))
def test_a_kill_at_any_moment_costs_at_most_the_last_second(killed, seed, capsys):
    root, pushed = killed
    directory = root / str(seed)
    torn = sorted(directory.glob("*.part"))
    finished = sorted(directory.glob("*.mcap"))
    assert len(torn) <= 1
    whole = list(finished)
    for path in torn:
        if path.stat().st_size < 100:  # killed within the first record: there is nothing in it yet
            continue
        out = directory / "recovered.mcap"
        assert main(["log", "recover", str(path), str(out), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["bytes_in"] == path.stat().st_size
        assert main(["log", "info", str(out)]) == 0
        assert ", complete" in capsys.readouterr().out
        whole.append(out)
    runs = [read_run(path) for path in whole]
    assert all(run.complete for run in runs)
    rows = np.concatenate([run.rows for run in runs]) if runs else np.zeros(0, rows_of(0).dtype)
    saved = len(rows)
    assert pushed[str(seed)] - saved <= LAST_SECOND
    expected = [rows_of(turn) for turn in range(-(-saved // TURN_ROWS))]
    assert rows.tobytes() == b"".join(part.tobytes() for part in expected)[: rows.nbytes]


# --- the disk


class Stuck:
    """A disk whose first write after the header does not come back until it is let go."""

    def __init__(self) -> None:
        self.reached, self.let_go = threading.Event(), threading.Event()
        self.disk = Disk()
        self.armed = False
        self.disk.on_write = self._wait

    def _wait(self) -> None:
        if self.armed:
            self.reached.set()
            assert self.let_go.wait(120)


def rows_beside(directory: Path, hooks: RecorderHooks | None, spoil=lambda: None) -> tuple[np.ndarray, Recorder | None]:
    """Rows that the loop leaves in its ring while a recorder, with a disk of its kind, drains it on a thread."""
    plan = make_plan(axis_file(directory / "axis"))
    drive = open_drive(plan)
    drive.connect()
    with Session(drive, plan_session(plan, simulated_ring_rows(plan.profile, plan.axis.loop.tail_s))) as session:
        session.compile()
        recorder = None
        if hooks is not None:
            settings = RecorderSettings(drain_interval_s=0.001, flush_interval_s=0.001, retry_interval_s=0.001)
            recorder = Recorder(session.ring, directory / "disk" / "run.mcap", RunHeader(), settings, hooks)
            recorder.start()
        spoil()
        session.run_profile(plan.profile, TOGGLE_FEEDFORWARD)
        return RingReader(session.ring).read().rows, recorder


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> bytes:
    rows, _ = rows_beside(tmp_path_factory.mktemp("alone"), None)
    assert len(rows) > 10_000
    return rows.tobytes()


@pytest.mark.slow
def test_a_full_disk_leaves_the_loop_untouched(undisturbed, tmp_path):
    events = []
    disk = Disk(room=30_000)
    rows, recorder = rows_beside(tmp_path, RecorderHooks(opener=disk, on_event=events.append))
    recorder.stop()
    assert rows.tobytes() == undisturbed
    statistics = recorder.statistics
    assert statistics.write_errors > 0
    assert statistics.rows_dropped > 0
    assert statistics.rows_written + statistics.rows_dropped == len(rows)
    assert "failed: OSError" in events[0].text


@pytest.mark.slow
def test_a_disk_that_is_stuck_for_the_whole_run_leaves_the_loop_untouched(undisturbed, tmp_path):
    stuck = Stuck()
    hooks = RecorderHooks(opener=stuck.disk)
    rows, recorder = rows_beside(tmp_path, hooks, lambda: setattr(stuck, "armed", True))
    assert rows.tobytes() == undisturbed
    assert stuck.reached.wait(120)  # the recorder's thread is in the middle of a write, and the run is over
    stuck.let_go.set()
    assert recorder.stop()
    assert read_run(tmp_path / "disk" / "run.mcap").rows.tobytes() == undisturbed


@pytest.mark.slow
def test_a_directory_that_vanishes_leaves_the_loop_untouched(undisturbed, tmp_path):
    events = []
    hooks = RecorderHooks(on_event=events.append)
    rows, recorder = rows_beside(tmp_path, hooks, lambda: shutil.rmtree(tmp_path / "disk"))
    recorder.stop()
    assert rows.tobytes() == undisturbed
    statistics = recorder.statistics
    assert statistics.rows_written + statistics.rows_dropped == len(rows)
    assert any("deleted or moved" in event.text for event in events)


@pytest.mark.slow
def test_the_run_command_reports_a_disk_that_is_full(tmp_path, capsys):
    """A real limit of the kernel's (RLIMIT_FSIZE) in place of a full disk: same path, another errno."""
    axis = axis_file(tmp_path / "axis")
    assert main(["run", str(axis), "--out", str(tmp_path / "good.mcap"), "--json"]) == 0
    good = json.loads(capsys.readouterr().out)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (good["rows_written"] * 40, before[1]))
    try:
        code = main(["run", str(axis), "--out", str(tmp_path / "full.mcap"), "--json"])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    captured = capsys.readouterr()
    summary = json.loads(captured.out)
    assert code == 74
    assert "recorder: recording of full.mcap failed" in captured.err
    assert "rows are missing from the recording" in captured.err
    assert summary["fault"] is None  # the axis ran as planned
    assert summary["rows_dropped"] > 0
    assert summary["rows_written"] + summary["rows_dropped"] == good["rows_written"]
    kept = recorded_rows(sorted(tmp_path.glob("full*.mcap*")))
    whole = read_run(tmp_path / "good.mcap").rows
    assert len(kept) == summary["rows_written"]
    assert kept.tobytes() == whole[: len(kept)].tobytes()


# --- the keys of the axis file


def test_the_keys_reach_the_recorder(tmp_path):
    text = (
        "{flush_interval_s: 0.5, fsync_interval_s: 10, rotate_bytes: 50000000, rotate_s: 3600, quota_bytes: 1000000000}"
    )
    settings = recorder_settings(read_axis(axis_file(tmp_path, text)), of_service=True)
    assert settings == RecorderSettings(
        flush_interval_s=0.5, fsync_interval_s=10.0, rotation=RotationPolicy(50_000_000, 3600.0, 1_000_000_000)
    )
    own = RotationPolicy(1_000_000_000, 3600.0, 20_000_000_000)
    assert recorder_settings(read_axis(axis_file(tmp_path)), of_service=True) == RecorderSettings(rotation=own)
    nothing = "{rotate_bytes: null, rotate_s: null, quota_bytes: null}"
    assert recorder_settings(read_axis(axis_file(tmp_path, nothing)), of_service=True) == RecorderSettings()
    assert recorder_settings(read_axis(axis_file(tmp_path, "{compression: none}"))).compression == "none"


@pytest.mark.slow
def test_a_rotated_run_is_evaluated_as_one(tmp_path, capsys):
    assert main(["run", str(axis_file(tmp_path / "a")), "--out", str(tmp_path / "one" / "run.mcap"), "--json"]) == 0
    one = json.loads(capsys.readouterr().out)
    axis = axis_file(tmp_path / "b", "{rotate_bytes: 1500000, compression: none}")
    assert main(["run", str(axis), "--out", str(tmp_path / "many" / "run.mcap"), "--json"]) == 0
    many = json.loads(capsys.readouterr().out)
    assert [Path(file).name for file in many["files"]] == ["run.mcap", "run_002.mcap", "run_003.mcap"]
    assert many["metrics"] == one["metrics"]
    assert many["ticks"] == one["ticks"]


@pytest.mark.slow
def test_single_runs_delete_nothing(tmp_path, capsys):
    axis = axis_file(tmp_path / "a", "{rotate_bytes: 1000000, quota_bytes: 2000000, compression: none}")
    for number in range(3):
        assert main(["run", str(axis), "--out", str(tmp_path / "out" / f"run{number}.mcap"), "--json"]) == 0
        capsys.readouterr()
    left = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert {f"run{number}.mcap" for number in range(3)} < set(left)
    assert sum(path.stat().st_size for path in (tmp_path / "out").iterdir()) > 6_000_000


# --- the wall clock


def test_a_step_of_the_wall_clock_does_not_reach_the_recording(tmp_path, monkeypatch):
    """Why: the offset to the wall clock is taken once, when the run begins; stamps are deadlines plus that offset."""
    rows = random_rows(2000, seed=3)
    ring, clock = FakeRing(4096), FakeClock()
    recorder = Recorder(ring, tmp_path / "run.mcap", RunHeader(time_offset_ns=WALL_NS), hooks=RecorderHooks(clock))
    for begin in range(0, 2000, 100):
        ring.push(rows[begin : begin + 100])
        clock.advance_s(0.05)
        stepped_ns = WALL_NS + (-1) ** (begin // 100) * 3_600_000_000_000
        monkeypatch.setattr("time.time_ns", lambda stepped_ns=stepped_ns: stepped_ns)
        monkeypatch.setattr("time.time", lambda stepped_ns=stepped_ns: stepped_ns * 1e-9)
        recorder.event(20, "loop", "still here")
        recorder.drain_once()
    recorder.close()
    run = read_run(tmp_path / "run.mcap")
    assert (np.diff(run.log_time_ns) == 500_000).all()
    stamps = [event.time_ns for event in run.events]
    assert stamps == sorted(stamps)


# --- what is said


def outcome(**counts) -> RunOutcome:
    """A run that ended as planned, with these counts of the recorder."""
    zero = RecorderStatistics(1000, 0, 0, 0, 0, 0, 0, 0, "", (), 0)
    return RunOutcome((), TRIP_NONE, True, ExchangeCounts(), zero._replace(**counts))


def test_a_gap_in_the_recording_has_its_sentence():
    assert outcome().gap_text is None
    assert outcome(rows_lost=24).gap_text == (
        "24 of 1024 rows are missing from the recording: the disk was too slow for the ring"
    )
    assert outcome(rows_dropped=7, write_errors=1, last_error="OSError: full").gap_text == (
        "7 of 1007 rows are missing from the recording: OSError: full"
    )
    assert "within 30 s; 1000 are written" in outcome()._replace(recorder_ended=False).gap_text


def test_what_the_wire_did_is_printed_when_there_is_something(capsys):
    ticks = {"ticks": 100, "late": 1, "skipped": 2, "missing_feedback": 3, **ExchangeCounts()._asdict()}
    summary = {
        "axis": "a", "toggle": "ff", "rows_lost": 1, "rows_dropped": 4, "files": ["x.mcap"], "ticks": ticks,
        "warnings": [],
    }  # fmt: skip
    print_summary(summary)
    text = capsys.readouterr().out
    assert text.splitlines() == ["100 ticks, 1 late, 2 skipped, 3 without feedback; rows lost: 5", "x.mcap"]
    ticks |= {"duplicate_feedback": 2, "bus_losses": 1}
    print_summary(summary)
    assert "on the wire: 2 duplicate_feedback, 1 bus_losses\n" in capsys.readouterr().out

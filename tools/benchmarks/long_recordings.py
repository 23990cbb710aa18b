"""Memory and time of commands on recordings of one minute, one hour and two hours at 2 kHz."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from common import ROOT, Report, finish, main, parser, shown

from fffo_drive.cli.exits import EXIT_NOT_CONFIRMED
from fffo_drive.daemon.fleet_records import command as daemon_command
from fffo_drive.fleet.store import FleetStore
from fffo_drive.recording.reader import Run, describe, read_run
from fffo_drive.recording.run_records import RecordKind
from fffo_drive.recording.writer import RunWriter

NAME = "long_recordings"
PURPOSE = (
    "Commands as typed, each in a process of its own; `fleet add` as the daemon begins it but for the idle priority. "
    "Recordings: the rows of one run of the simulated axis again and again, with ticks, times and positions that go on."
)
AXIS = ROOT / "configs" / "axis_simulated.yaml"
BASE_S, SAMPLE_BASE_S = 60.0, 6.0
MINUTES = (1, 60, 120)
LOOK_S = 0.02
WRITE_ROWS = 4096


class Bound(NamedTuple):
    """What a command must not exceed on the longest recording, and how much faster than the recording it must be."""

    own_mb: float | None = None
    seconds: float | None = None
    times_real_time: float | None = None


BOUNDS = {
    "log info": Bound(150.0, seconds=1.0),
    "log info --check": Bound(),
    "log export, all": Bound(),
    "log export, 2 s": Bound(),
    "replay": Bound(300.0, times_real_time=30.0),
    "evaluate": Bound(300.0, times_real_time=60.0),
    "fleet add": Bound(300.0, times_real_time=60.0),
    "identify": Bound(1000.0),
    "diagnose": Bound(1000.0),
}


def words_of(command: str, path: Path, directory: Path) -> list[str]:
    """The command as it is typed."""
    if command == "fleet add":
        return [word for word in daemon_command(str(directory / f"store_{path.stem}"), [str(path)]) if word != "--idle"]
    out = str(directory / f"{path.stem}.parquet")
    own = {
        "log info": ["log", "info", str(path)],
        "log info --check": ["log", "info", "--check", str(path)],
        "log export, all": ["log", "export", str(path), "--out", out],
        "log export, 2 s": ["log", "export", str(path), "--out", out, "--from", "1", "--to", "3"],
        "replay": ["replay", str(path)],
        "identify": ["identify", str(path), "--out", str(directory / "identified")],
        "diagnose": [
            "diagnose",
            "--fit",
            str(path),
            "--held-out",
            str(directory / "base.mcap"),
            "--out",
            str(directory / "found"),
        ],
        "evaluate": ["evaluate", "--runs", str(path), "--out", str(directory / "page")],
    }
    return [sys.executable, "-m", "fffo_drive", *own[command]]


def recorded(directory: Path, seconds: float) -> Run:
    """One run of the paper's profile."""
    profile, path = directory / "profile.yaml", directory / "base.mcap"
    profile.write_text(f"profile: {{kind: paper, duration_s: {seconds:g}, seed: 1}}\n")
    words = ["run", str(AXIS), "--profile", str(profile), "--out", str(path)]
    subprocess.run([sys.executable, "-m", "fffo_drive", *words], check=True, capture_output=True)
    return read_run(path)


def write_long(run: Run, path: Path, seconds: float) -> None:
    """Its rows for so long, as of one profile."""
    attachments = [(one.name, one.media_type, one.data) for one in run.attachments.values()]
    rows = run.rows.copy()
    runs = rows["profile_sample"] >= 0
    ticks = int(rows["tick"][-1] - rows["tick"][0]) + 1
    period_ns = int(np.median(np.diff(rows["deadline_ns"])))
    times = max(1, round(seconds / (ticks * period_ns * 1e-9)))
    samples = int(rows["profile_sample"].max()) + 1
    writer = RunWriter(path, {**run.metadata, "profile_samples": str(times * samples)}, attachments, 0)
    for record in run.records:
        values = tuple(times * samples if name == "samples" else value for name, value in record.by_name.items())
        own = record._replace(values=values) if record.kind == RecordKind.PROFILE else record
        writer.write_record(own, int(rows["deadline_ns"][0]))
    travel_rev = float(rows["position_rev"][-1] - rows["position_rev"][0])
    for _ in range(times):
        for begin in range(0, len(rows), WRITE_ROWS):
            writer.write_rows(rows[begin : begin + WRITE_ROWS])
        rows["tick"] += ticks
        rows["row_number"] += len(rows)
        rows["profile_sample"][runs] += samples
        rows["position_rev"] += travel_rev
        rows["deadline_ns"] += ticks * period_ns
    writer.close({})


def peak_mb(words: list[str]) -> tuple[float, float, float]:
    """Largest memory of its own, largest with the pages of shared libraries, and processor time (s) of a process."""
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL)
    own_mb = max(_own_mb(process), default=0.0)
    _, status, usage = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status) not in (0, EXIT_NOT_CONFIRMED):
        raise RuntimeError(f"{words[-6:]}: exit code {os.waitstatus_to_exitcode(status)}")
    return own_mb, usage.ru_maxrss / 1024.0, usage.ru_utime + usage.ru_stime


def _own_mb(process: subprocess.Popen[bytes]) -> Iterator[float]:
    status = Path(f"/proc/{process.pid}/status")
    while lines := [line for line in status.read_text().splitlines() if line.startswith("RssAnon:")]:
        yield int(lines[0].split()[1]) / 1024.0
        time.sleep(LOOK_S)


def run() -> int:
    """Each command on each length."""
    options = parser(NAME, PURPOSE, 1, 1).parse_args()
    report = Report(NAME, PURPOSE)
    rows = []
    with tempfile.TemporaryDirectory() as name, shown("long recordings") as progress:
        directory = Path(name)
        base = recorded(directory, SAMPLE_BASE_S if options.sample else BASE_S)
        for number, minutes in enumerate(MINUTES):
            path, seconds = directory / f"{minutes}.mcap", 60.0 * minutes / (600.0 if options.sample else 1.0)
            write_long(base, path, max(seconds, SAMPLE_BASE_S))
            size_mb, length_s = path.stat().st_size / 1e6, describe(path)["duration_s"]
            for done, command in enumerate(BOUNDS):
                own_mb, whole_mb, used_s = peak_mb(words_of(command, path, directory))
                path.with_suffix(".parquet").unlink(missing_ok=True)
                rows.append(
                    (
                        f"{minutes} min, {size_mb:.0f} MB",
                        f"`{command}`",
                        f"{own_mb:.0f} MB",
                        f"{whole_mb:.0f} MB",
                        f"{used_s:.2f} s",
                        f"{length_s / used_s:.0f}",
                    )
                )
                if minutes == MINUTES[-1]:
                    _bounded(report, command, own_mb, used_s, length_s / used_s)
                if progress is not None:
                    progress((number + (done + 1) / len(BOUNDS)) / len(MINUTES))
            status = FleetStore(str(directory / f"store_{path.stem}")).status()
            if status.recorded != 1:
                raise RuntimeError(f"{path.name}: no record was made: {status}")
            path.unlink()
    report.table(
        (
            "recording",
            "command",
            "largest memory of its own",
            "with the pages of shared libraries",
            "processor time",
            "times real time",
        ),
        rows,
    )
    report.notes.append(
        "Memory of its own is what a control group charges to it beside the cache of files; pages of libraries are "
        "shared with other processes."
    )
    return finish(report, options)


def _bounded(report: Report, command: str, own_mb: float, used_s: float, times: float) -> None:
    bound, name = BOUNDS[command], f"{MINUTES[-1]} min, `{command}`"
    if bound.own_mb is not None:
        report.bounded(
            f"{name}: memory of its own", f"{own_mb:.0f} MB", own_mb <= bound.own_mb, f"<= {bound.own_mb:g} MB"
        )
    if bound.seconds is not None:
        report.bounded(f"{name}: processor time", f"{used_s:.2f} s", used_s <= bound.seconds, f"<= {bound.seconds:g} s")
    if bound.times_real_time is not None:
        met = times >= bound.times_real_time
        report.bounded(f"{name}: times real time", f"{times:.0f}", met, f">= {bound.times_real_time:g}")


if __name__ == "__main__":
    main(run)

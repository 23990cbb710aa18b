"""Memory of a fleet's record: the process that the daemon begins, on recordings of 5, 20 and 60 minutes at 2 kHz."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from common import ROOT, Report, finish, main, parser, shown

from fffo_drive.daemon.fleet_records import command
from fffo_drive.fleet.store import FleetStore
from fffo_drive.recording.reader import Run, read_run
from fffo_drive.recording.writer import RunWriter

NAME = "records_memory"
PURPOSE = (
    "`fffo-drive fleet add --work` in a process of its own, as the daemon begins it but for the idle priority. "
    "Recordings: the rows of one run of the simulated axis again and again, with ticks, times and positions that go on."
)
AXIS = ROOT / "configs" / "axis_simulated.yaml"
BASE_S, SAMPLE_BASE_S = 60.0, 6.0
MINUTES = (5, 20, 60)
LARGEST_MB = 300.0
LOOK_S = 0.02
WRITE_ROWS = 4096


def recorded(directory: Path, seconds: float) -> Run:
    """One run of the paper's profile."""
    profile, path = directory / "profile.yaml", directory / "base.mcap"
    profile.write_text(f"profile: {{kind: paper, duration_s: {seconds:g}, seed: 1}}\n")
    words = ["run", str(AXIS), "--profile", str(profile), "--out", str(path)]
    subprocess.run([sys.executable, "-m", "fffo_drive", *words], check=True, capture_output=True)
    return read_run(path)


def write_long(run: Run, path: Path, seconds: float) -> None:
    """Its rows for so long."""
    attachments = [(one.name, one.media_type, one.data) for one in run.attachments.values()]
    writer = RunWriter(path, dict(run.metadata), attachments, 0)
    for record in run.records:
        writer.write_record(record, int(run.rows["deadline_ns"][0]))
    rows, ticks = run.rows.copy(), int(run.rows["tick"][-1] - run.rows["tick"][0]) + 1
    travel_rev = float(run.rows["position_rev"][-1] - run.rows["position_rev"][0])
    period_ns = int(np.median(np.diff(rows["deadline_ns"])))
    for _ in range(max(1, round(seconds / (ticks * period_ns * 1e-9)))):
        for begin in range(0, len(rows), WRITE_ROWS):
            writer.write_rows(rows[begin : begin + WRITE_ROWS])
        rows["tick"] += ticks
        rows["row_number"] += len(rows)
        rows["position_rev"] += travel_rev
        rows["deadline_ns"] += ticks * period_ns
    writer.close({})


def peak_mb(words: list[str]) -> tuple[float, float, float]:
    """Largest memory of its own, largest with the pages of shared libraries, and processor time (s) of a process."""
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL)
    own_mb = max(_own_mb(process), default=0.0)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise RuntimeError(f"{words[-6:]}: exit code {os.waitstatus_to_exitcode(status)}")
    return own_mb, usage.ru_maxrss / 1024.0, usage.ru_utime + usage.ru_stime


def _own_mb(process: subprocess.Popen[bytes]) -> Iterator[float]:
    status = Path(f"/proc/{process.pid}/status")
    while lines := [line for line in status.read_text().splitlines() if line.startswith("RssAnon:")]:
        yield int(lines[0].split()[1]) / 1024.0
        time.sleep(LOOK_S)


def run() -> int:
    """Each length."""
    options = parser(NAME, PURPOSE, 1, 1).parse_args()
    report = Report(NAME, PURPOSE)
    rows = []
    with tempfile.TemporaryDirectory() as name, shown("records") as progress:
        directory = Path(name)
        base = recorded(directory, SAMPLE_BASE_S if options.sample else BASE_S)
        for number, minutes in enumerate(MINUTES):
            path = directory / f"long{minutes}.mcap"
            write_long(base, path, 60.0 * minutes * (SAMPLE_BASE_S / 300.0 if options.sample else 1.0))
            words = command(str(directory / f"store{minutes}"), [str(path)])
            words.remove("--idle")
            own, whole, seconds = peak_mb(words)
            status = FleetStore(str(directory / f"store{minutes}")).status()
            if status.recorded != 1:
                raise RuntimeError(f"{path.name}: no record was made: {status}")
            size_mb = path.stat().st_size / 1e6
            path.unlink()
            rows.append((f"{minutes} min", f"{size_mb:.0f} MB", f"{own:.0f} MB", f"{whole:.0f} MB", f"{seconds:.0f} s"))
            report.bounded(
                f"{minutes} min: memory of its own", f"{own:.0f} MB", own <= LARGEST_MB, f"<= {LARGEST_MB:g} MB"
            )
            if progress is not None:
                progress((number + 1) / len(MINUTES))
    report.table(
        ("recording", "size", "largest memory of its own", "with the pages of shared libraries", "processor time"), rows
    )
    report.notes.append(
        "Memory of its own is what a control group charges to it beside the cache of files; pages of libraries are "
        "shared with the daemon, which has them already."
    )
    return finish(report, options)


if __name__ == "__main__":
    main(run)

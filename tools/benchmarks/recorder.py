"""The recorder beside a live loop at 2 kHz (share of a core, rows lost), its file's size, and the reader's speed."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import ROOT, Figures, Report, finish, interleaved, main, paired_ratio, parser, passes_of, shown
from mcap.opcode import Opcode
from paced_port import paced

from fffo_drive.control.friction_observer import TOGGLE_FEEDFORWARD
from fffo_drive.control.reference import Profile
from fffo_drive.drive.cia402 import GOAL_DISABLED, GOAL_ENABLED
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.recorder import Recorder
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.recording.scan import Scanner, open_chunk
from fffo_drive.recording.settings import RecorderHooks, RecorderStatistics, RunHeader
from fffo_drive.recording.writer import wall_clock_offset_ns
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime.ring import HEAD, new_ring
from fffo_drive.runtime.runs import simulated_ring_rows
from fffo_drive.runtime.session import Session
from fffo_drive.signals import ROW
from fffo_drive.units import NS_PER_S
from fffo_drive.workflows.plan import Plan, make_plan, open_drive, plan_session

NAME = "recorder"
AXIS = ROOT / "configs" / "axis_simulated.yaml"
LARGEST_SHARE = 5.0  # per cent of a core
READ_ROWS = 400_000
READ_LIMIT_S = 2.0
DRAIN_S = 0.05
POLL_S = 0.5

Rows = np.ndarray[Any, np.dtype[np.void]]


class Recorded(NamedTuple):
    """What a recording cost and kept."""

    share: float  # of a core, per cent
    ticks: int  # rows that the loop wrote
    skipped: int  # ticks that the loop itself missed
    statistics: RecorderStatistics
    path: Path


def repeated(profile: Profile, seconds: float) -> Profile:
    """The profile again and again for so long."""
    count = round(seconds / profile.period_s)
    values, derivatives = (np.resize(samples, count) for samples in (profile.values, profile.derivatives))
    return profile._replace(values=values, derivatives=derivatives)


def thread_time_ns(thread_id: int) -> int:
    """CPU time of a thread of this process."""
    return int(Path(f"/proc/self/task/{thread_id}/schedstat").read_text().split()[0])


def record_live(plan: Plan, seconds: float, path: Path, progress: Callable[[float], None] | None) -> Recorded:
    """Record the closed loop at 2 kHz in real time, as a run does."""
    profile = repeated(plan.profile, seconds)
    drive = paced(open_drive(plan))
    drive.connect()
    config = plan_session(plan)._replace(longest_profile=profile.values.size, realtime_required=False)
    with Session(drive, config) as session:
        header = RunHeader({"axis": plan.axis.name}, (), wall_clock_offset_ns())
        recorder = Recorder(session.ring, path, header)  # before the loop: every row of it is to be in the file
        recorder.start()
        session.start()
        thread_id = recorder.thread_id
        assert thread_id is not None
        begin_ns, spent_ns = time.monotonic_ns(), thread_time_ns(thread_id)
        session.request(b.TOGGLE, TOGGLE_FEEDFORWARD)
        number = session.start_profile(profile)
        session.request(b.GOAL, GOAL_ENABLED)
        while session.running and session.status(b.TRIP) == 0 and session.status(b.PROFILE_DONE) != number:
            time.sleep(POLL_S)
            if progress is not None:
                progress(min(1.0, max(session.status(b.PROFILE_SAMPLE), 0) / profile.values.size))
        share = 100.0 * (thread_time_ns(thread_id) - spent_ns) / (time.monotonic_ns() - begin_ns)
        if session.status(b.TRIP) != 0:
            raise RuntimeError(f"the loop tripped ({session.status(b.TRIP)}): this measures nothing")
        session.request(b.GOAL, GOAL_DISABLED)
        session.stop()
        recorder.stop()
        ticks, skipped = int(session.ring.words[HEAD]), session.status(b.SKIPPED_TICKS)
    return Recorded(share, ticks, skipped, recorder.statistics, path)


def simulated_rows(plan: Plan, seconds: float) -> Rows:
    """Rows of a closed loop in simulated time."""
    drive = open_drive(plan)
    drive.connect()
    profile = repeated(plan.profile, seconds)
    config = plan_session(plan, simulated_ring_rows(profile, plan.axis.loop.tail_s))
    session = Session(drive, config._replace(longest_profile=profile.values.size))
    session.run_profile(profile, TOGGLE_FEEDFORWARD)
    return RingReader(session.ring).read().rows


def record_simulated(rows: Rows, period_s: float, path: Path) -> Recorded:
    """Hand rows to the recorder as a loop would, on a clock that moves with them; its CPU time is measured alone."""
    ring = new_ring(round(4.0 / period_s))
    clock_ns = [int(rows["deadline_ns"][0])]
    spent_ns = time.thread_time_ns()
    recorder = Recorder(
        ring, path, RunHeader(time_offset_ns=NS_PER_S), hooks=RecorderHooks(clock_ns=lambda: clock_ns[0])
    )
    spent_ns = time.thread_time_ns() - spent_ns
    batch = round(DRAIN_S / period_s)
    raw, slots = rows.view(f"V{ROW.itemsize}"), ring.rows.view(f"V{ROW.itemsize}")
    for begin in range(0, rows.size, batch):
        part = raw[begin : begin + batch]
        slots[np.arange(begin, begin + part.size) % slots.size] = part
        ring.words[HEAD] = begin + part.size
        clock_ns[0] = int(rows["deadline_ns"][begin + part.size - 1])
        before_ns = time.thread_time_ns()
        recorder.drain_once()
        spent_ns += time.thread_time_ns() - before_ns
    statistics = recorder.close()
    share = 100.0 * spent_ns / (rows.size * period_s * NS_PER_S)
    return Recorded(share, rows.size, 0, statistics, path)


def add_recorded(report: Report, recorded: Recorded, text: str) -> None:
    """Share of a core, rows lost, bytes a row; and the file is read back and counted."""
    run = read_run(recorded.path)
    ticks = run.rows["tick"].astype(np.int64)
    missing = recorded.ticks - len(run.rows)
    disordered = int((np.diff(ticks) <= 0).sum())
    report.figure(f"{text}: recorder's share of a core", recorded.share, "%", LARGEST_SHARE)
    report.figure(f"{text}: rows lost in the ring", recorded.statistics.rows_lost, "", 0.0)
    report.figure(f"{text}: rows missing or out of order in the file", abs(missing) + disordered, "", 0.0)
    report.figure(f"{text}: bytes a row in the MCAP file", recorded.path.stat().st_size / len(run.rows), "bytes")
    report.facts["complete"] = run.complete
    report.facts["rows"] = len(run.rows)
    report.facts["ticks"] = recorded.ticks


def read_columns(path: Path) -> Figures:
    """Seconds from the file to every column."""
    begin_ns = time.perf_counter_ns()
    columns = read_run(path).columns
    return {"seconds": (time.perf_counter_ns() - begin_ns) / NS_PER_S, "columns": float(len(columns))}


def decompress_only(path: Path) -> Figures:
    """Seconds to read, decompress and check the chunks of the file alone: what no reader can save."""
    begin_ns = time.perf_counter_ns()
    with path.open("rb") as file:
        size = sum(len(open_chunk(record.body)) for record in Scanner(file, str(path)) if record.opcode == Opcode.CHUNK)
    return {"seconds": (time.perf_counter_ns() - begin_ns) / NS_PER_S, "bytes": float(size)}


def run() -> int:
    """The command."""
    options = parser(NAME, __doc__ or "", 15, 3)
    options.add_argument(
        "--duration", type=float, help="seconds of live recording (default 600; --sample: 5, simulated)"
    )
    chosen = options.parse_args()
    plan = make_plan(AXIS)
    report = Report(NAME, "The recorder at 2 kHz, and the reader.")
    with tempfile.TemporaryDirectory(prefix="fffo_drive_benchmark_") as directory:
        path = Path(directory) / "run.mcap"
        if chosen.sample:
            rows = simulated_rows(plan, chosen.duration or 5.0)
            add_recorded(report, record_simulated(rows, plan.profile.period_s, path), "simulated time")
        else:
            duration = chosen.duration or 600.0
            with shown("recording") as progress:
                recorded = record_live(plan, duration, path, progress)
            add_recorded(report, recorded, f"{duration:g} s live")
            report.notes.append(
                f"The loop beside it ran {recorded.ticks} ticks and skipped {recorded.skipped}, because of this "
                "machine."
            )
        _add_reader(report, plan, Path(directory), passes_of(chosen), chosen.sample)
    report.notes += [
        "Live: the closed loop on the simulated drive in process at 2 kHz under FIFO, with sensor noise, in real time.",
        "Share of a core: CPU time of the recorder's thread over elapsed time.",
    ]
    return finish(report, chosen)


def _add_reader(report: Report, plan: Plan, directory: Path, passes: int, sample: bool) -> None:
    path = directory / "read.mcap"
    count = 10_000 if sample else READ_ROWS
    rows = simulated_rows(plan, count * plan.profile.period_s)[:count]
    record_simulated(rows, plan.profile.period_s, path)
    variants = {"columns": lambda: read_columns(path), "chunks": lambda: decompress_only(path)}
    with shown("reading") as progress:
        found = interleaved(variants, passes, progress)
    spent = found["columns"]["seconds"]
    seconds = spent * READ_ROWS / count
    text = f"{READ_ROWS} rows to columns"
    report.figure(f"{text} (median)", float(np.median(seconds)), "s", READ_LIMIT_S)
    report.figure(f"{text} (best pass)", float(seconds.min()), "s")
    report.ratio(f"{text}, over decompressing the chunks alone", paired_ratio(spent, found["chunks"]["seconds"]))
    report.facts["columns"] = int(found["columns"]["columns"][0])


if __name__ == "__main__":
    main(run)

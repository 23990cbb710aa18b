"""The paper's comparison, live: PI, PI+FBFO and PI+FFFO on one reference at 2 kHz over CANopen.

Starts the simulated drive as a CANopen node in its own process on its own loopback bus, brings it up, runs the three
controllers in real time, records one MCAP file per run, prints the metrics of Table II and the tick statistics, and
writes the report page to the directory of the recordings.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from ..can.link import free_loopback_port
from ..config.axis import recorder_settings
from ..control.friction_observer import TOGGLE_FEEDBACK, TOGGLE_FEEDFORWARD, TOGGLE_OFF
from ..drive.port import Drive, DriveIdentity
from ..evaluation.metrics import (
    PAPER_TABLE_2,
    ErrorMetrics,
    TickStatistics,
    percent_of_smallest,
    run_metrics,
    tick_statistics,
)
from ..recording.reader import read_run
from ..report.bench import BenchRecord, write_bench_report
from ..runtime.runs import RunOutcome, record_live, timestamp_name
from ..runtime.session import Session
from ..system.service_files import sources
from ..workflows.errors import DriveFaultError, RecordingGapError
from ..workflows.plan import Plan, make_plan, open_drive, plan_session, run_header
from ..workflows.recordings import recorder_hooks
from ..workflows.simulated_process import SimulatedProcess
from .progress import progress_bar

CONTROLLERS = {"PI": TOGGLE_OFF, "PI+FBFO": TOGGLE_FEEDBACK, "PI+FFFO": TOGGLE_FEEDFORWARD}
QUICK_S = 10.0


class BenchRun(NamedTuple):
    """One controller's run."""

    metrics: ErrorMetrics
    ticks: TickStatistics
    file: Path
    rows_lost: int
    record: BenchRecord


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument(
        "--quick", action="store_true", help=f"{QUICK_S:g} s per controller instead of the file's duration"
    )
    parser.add_argument("--bus", help="bus for drive and controller, e.g. socketcan:vcan0 (default: a loopback bus)")
    _, configs = sources()
    parser.add_argument("--config", default=str(configs / "axis_bench.yaml"), help="axis file (default: %(default)s)")
    parser.add_argument(
        "--drive", default=str(configs / "simulated_drive.yaml"), help="simulated drive (default: %(default)s)"
    )
    parser.add_argument("--out", default="runs", metavar="DIR", help="directory for the recordings (default: runs)")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else on stdout")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    plan = make_plan(options.config, tuple(CONTROLLERS.values()))
    if options.quick:
        plan = _shortened(plan)
    bus = options.bus or f"loopback:{free_loopback_port()}"
    out = Path(options.out) / timestamp_name("bench", time.time_ns())
    out.mkdir(parents=True, exist_ok=True)
    console = Console(stderr=True, quiet=options.json)
    console.print(f"simulated drive and controller on {bus}; the first start compiles the loop", soft_wrap=True)
    with SimulatedProcess(Path(options.drive), bus) as process:
        drive = open_drive(plan, bus)
        identity = drive.connect()
        console.print(f"drive: {identity.device_name}, serial {identity.serial_number}", soft_wrap=True)
        runs = _compare(plan, drive, identity, out, options.json, process)
    with console.status("drawing the report"):
        report = write_bench_report({name: run.record for name, run in runs.items()}, out)
    _report(runs, report.page, options.json)
    return 0


def _shortened(plan: Plan) -> Plan:
    """The same profile in QUICK_S: same lines, envelope compressed."""
    from ..config.axis import build_profile

    section = plan.axis.profile.model_copy(update={"duration_s": QUICK_S})
    return plan._replace(profile=build_profile(section, plan.axis.loop.period_s))


def _compare(
    plan: Plan, drive: Drive, identity: DriveIdentity, out: Path, quiet: bool, process: SimulatedProcess
) -> dict[str, BenchRun]:
    """The three runs on one loop: SYNC goes on between them, without torque."""
    runs: dict[str, BenchRun] = {}
    settings = recorder_settings(plan.axis)
    with Session(drive, plan_session(plan)) as session:
        for refusal in session.start().refusals:
            print(f"without real-time properties: {refusal}", file=sys.stderr)
        for name, toggle in CONTROLLERS.items():
            process.check()
            path = out / f"{name.lower().replace('+', '_')}.mcap"
            header = run_header(plan, identity, toggle)
            with progress_bar(f"{name:8}", quiet) as progress:
                outcome = record_live(session, plan.profile, toggle, path, header, settings, recorder_hooks(), progress)
            if outcome.fault_text is not None:
                raise DriveFaultError(f"{name}: {outcome.fault_text}; the recording is in {path}")
            if outcome.gap_text is not None:
                raise RecordingGapError(f"{name}: {outcome.gap_text}")
            runs[name] = _evaluate(plan, outcome)
    return runs


def _evaluate(plan: Plan, outcome: RunOutcome) -> BenchRun:
    """Metrics from what was recorded, read back from the files."""
    parts = tuple(read_run(file) for file in outcome.files if file.exists())
    record = BenchRecord(parts, outcome.exchange, outcome.recorder.rows_lost, plan.axis.loop.late_share)
    metrics = run_metrics(record.rows, plan.profile.period_s, plan.profile.values.size)
    ticks = tick_statistics(record.rows, outcome.exchange)
    return BenchRun(metrics, ticks, outcome.files[-1], outcome.recorder.rows_lost, record)


def _report(runs: dict[str, BenchRun], page: Path, as_json: bool) -> None:
    if as_json:
        print(json.dumps({**as_object(runs), "report": str(page)}, indent=2))
        return
    console = Console()
    console.print(_metrics_table(runs))
    console.print(_ticks_table(runs))
    for run in runs.values():
        console.print(f"{run.file}", highlight=False, soft_wrap=True)
    console.print(f"report: {page}", highlight=False, soft_wrap=True)


def as_object(runs: dict[str, BenchRun]) -> dict[str, Any]:
    """The result for programs."""
    return {
        "controllers": {name: run.metrics._asdict() for name, run in runs.items()},
        "ticks": {name: {**run.ticks._asdict(), "rows_lost": run.rows_lost} for name, run in runs.items()},
        "files": [str(run.file) for run in runs.values()],
    }


METRICS = {"ise": "ISE rps² s", "mae": "MAE rps", "max": "MAX rps", "std": "STD rps"}


def _metrics_table(runs: dict[str, BenchRun]) -> Table:
    percent = percent_of_smallest({name: run.metrics for name, run in runs.items()})
    table = Table(
        title="velocity error, % of the smallest, (% in the paper's Table II)", title_justify="left", box=SIMPLE
    )
    table.add_column("", no_wrap=True)
    for name in runs:
        table.add_column(name, justify="right", no_wrap=True)
    for key, title in METRICS.items():
        cells = [
            f"{getattr(run.metrics, key):.3g}  {percent[name][key]:3.0f} % ({PAPER_TABLE_2[name][key]:.0f})"
            for name, run in runs.items()
        ]
        table.add_row(title, *cells)
    return table


def _ticks_table(runs: dict[str, BenchRun]) -> Table:
    table = Table(title="ticks", title_justify="left", box=SIMPLE)
    table.add_column("", no_wrap=True)
    for name in runs:
        table.add_column(name, justify="right", no_wrap=True)
    columns = [_tick_cells(run) for run in runs.values()]
    for title in columns[0]:
        table.add_row(title, *(cells[title] for cells in columns))
    return table


def _tick_cells(run: BenchRun) -> dict[str, str]:
    """What the table says of one run, by the title of its row."""
    t = run.ticks
    wire_errors = t.bad_frames + t.error_frames + t.bus_losses + t.send_errors + max(t.dropped_frames, 0)
    return {
        "ticks": str(t.ticks),
        "late, skipped": f"{t.late}, {t.skipped}",
        "lateness µs, p50/p99/max": f"{t.lateness_us_p50:.0f}/{t.lateness_us_p99:.0f}/{t.lateness_us_max:.0f}",
        "no feedback, late feedback": f"{t.missing_feedback}, {t.late_feedback}",
        "errors on the wire": str(wire_errors),
        "rows lost": str(run.rows_lost),
    }

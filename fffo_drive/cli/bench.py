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
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from ..can.link import free_loopback_port
from ..config.axis import recorder_settings
from ..config.drive_section import CanopenDriveSection
from ..config.runaway import accepted_words
from ..control.friction_observer import TOGGLE_FEEDBACK, TOGGLE_FEEDFORWARD, TOGGLE_OFF
from ..documents import refuse
from ..drive.port import Drive, DriveIdentity
from ..evaluation.metrics import (
    METRIC_UNITS,
    PAPER_TABLE_2,
    TickStatistics,
    percent_of_smallest,
)
from ..recording.reader import read_run
from ..report.bench import BenchRecord, BenchResult, evaluate, write_bench_report
from ..runtime.runs import record_live, timestamp_name
from ..runtime.session import Session
from ..system.service_files import sources
from ..workflows.errors import DriveFaultError, RecordingGapError
from ..workflows.evaluate_live import NAMES, candidate_header
from ..workflows.plan import Plan, checked_plan, make_plan, open_drive, plan_session, toggle_name
from ..workflows.recordings import recorder_hooks
from ..workflows.simulated_process import SimulatedProcess
from .progress import progress_bar

CONTROLLERS = {"PI": TOGGLE_OFF, "PI+FBFO": TOGGLE_FEEDBACK, "PI+FFFO": TOGGLE_FEEDFORWARD}
QUICK_S = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument(
        "--quick", action="store_true", help=f"{QUICK_S:g} s per controller instead of the file's duration"
    )
    parser.add_argument("--bus", help="bus for drive and controller, e.g. socketcan:vcan0 (default: a loopback bus)")
    _, configs = sources()
    parser.add_argument(
        "--config", default=str(configs / "axis_bench.yaml"), help="axis file (default: the example axis_bench.yaml)"
    )
    parser.add_argument(
        "--drive",
        default=str(configs / "simulated_drive.yaml"),
        help="simulated drive (default: the example simulated_drive.yaml)",
    )
    parser.add_argument("--out", default="runs", metavar="DIR", help="directory for the recordings (default: runs)")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else on stdout")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    plan = papers(make_plan(options.config, tuple(CONTROLLERS.values())))
    if options.quick:
        plan = _shortened(plan)
    if not isinstance(plan.axis.drive, CanopenDriveSection):
        refuse(options.config, [("drive.kind", "bench needs an axis on a bus, such as the example axis_bench.yaml")])
    bus = options.bus or f"loopback:{free_loopback_port()}"
    out = Path(options.out) / timestamp_name("bench", time.time_ns())
    out.mkdir(parents=True, exist_ok=True)
    console = Console(stderr=True, quiet=options.json)
    for text in accepted_words(plan.axis, plan.model):
        console.print(f"warning: {text}", soft_wrap=True)
    console.print(f"simulated drive and controller on {bus}; the first start compiles the loop", soft_wrap=True)
    with SimulatedProcess(Path(options.drive), bus) as process:
        drive = open_drive(plan, bus)
        identity = drive.connect()
        console.print(f"drive: {identity.device_name}, serial {identity.serial_number}", soft_wrap=True)
        records = _compare(plan, drive, identity, out, options.json, process)
    with console.status("drawing the report"):
        result = evaluate(records)
        report = write_bench_report(records, result, out)
    _report(records, result, report.page, options.json)
    return 0


def papers(plan: Plan) -> Plan:
    """The same axis under the paper's law. Raises DocumentError if that is not proven stable."""
    axis = plan.axis.model_copy(update={"controller": plan.axis.controller.papers})
    return checked_plan(plan.path, axis, plan.model, tuple(CONTROLLERS.values()))


def _shortened(plan: Plan) -> Plan:
    """The same profile in QUICK_S: same lines, envelope compressed."""
    from ..config.axis import build_profile

    section = plan.axis.profile.model_copy(update={"duration_s": QUICK_S})
    return plan._replace(profile=build_profile(section, plan.axis.loop.period_s))


def _compare(
    plan: Plan, drive: Drive, identity: DriveIdentity, out: Path, quiet: bool, process: SimulatedProcess
) -> dict[str, BenchRecord]:
    """The three runs on one loop: SYNC goes on between them, without torque."""
    records: dict[str, BenchRecord] = {}
    settings = recorder_settings(plan.axis)
    with Session(drive, plan_session(plan)) as session:
        for refusal in session.start().refusals:
            print(f"without real-time properties: {refusal}", file=sys.stderr)
        for name, toggle in CONTROLLERS.items():
            process.check()
            path = out / f"{name.lower().replace('+', '_')}.mcap"
            header = candidate_header(plan, NAMES[toggle_name(toggle)], toggle, identity)
            with progress_bar(f"{name:8}", quiet) as progress:
                outcome = record_live(session, plan.profile, toggle, path, header, settings, recorder_hooks(), progress)
            if outcome.fault_text is not None:
                raise DriveFaultError(f"{name}: {outcome.fault_text}; the recording is in {path}")
            if outcome.gap_text is not None:
                raise RecordingGapError(f"{name}: {outcome.gap_text}")
            parts = tuple(read_run(file) for file in outcome.files if file.exists())
            records[name] = BenchRecord(parts, outcome.exchange, outcome.recorder.rows_lost, plan.axis.loop.late_share)
    return records


def _report(records: dict[str, BenchRecord], result: BenchResult, page: Path, as_json: bool) -> None:
    files = [str(record.parts[-1].path) for record in records.values()]
    if as_json:
        print(json.dumps({**as_object(result), "files": files, "report": str(page)}, indent=2))
        return
    console = Console()
    console.print(_metrics_table(result))
    console.print(_ticks_table(result))
    for file in files:
        console.print(file, highlight=False, soft_wrap=True)
    console.print(f"report: {page}", highlight=False, soft_wrap=True)


def as_object(result: BenchResult) -> dict[str, Any]:
    """The result for programs."""
    return {
        "controllers": {name: metrics._asdict() for name, metrics in result.metrics.items()},
        "ticks": {name: {**t._asdict(), "rows_lost": result.rows_lost[name]} for name, t in result.ticks.items()},
    }


def _metrics_table(result: BenchResult) -> Table:
    percent = percent_of_smallest(result.metrics)
    table = Table(
        title="velocity error, % of the smallest (% in the paper's Table II)", title_justify="left", box=SIMPLE
    )
    table.add_column("", no_wrap=True)
    for name in result.metrics:
        table.add_column(name, justify="right", no_wrap=True)
    for key, unit in METRIC_UNITS.items():
        cells = [
            f"{getattr(metrics, key):.3g}  {percent[name][key]:3.0f} % ({PAPER_TABLE_2[name][key]:.0f})"
            for name, metrics in result.metrics.items()
        ]
        table.add_row(f"{key.upper()} {unit}", *cells)
    return table


def _ticks_table(result: BenchResult) -> Table:
    table = Table(title="ticks", title_justify="left", box=SIMPLE)
    table.add_column("", no_wrap=True)
    for name in result.ticks:
        table.add_column(name, justify="right", no_wrap=True)
    columns = [_tick_cells(ticks, result.rows_lost[name]) for name, ticks in result.ticks.items()]
    for title in columns[0]:
        table.add_row(title, *(cells[title] for cells in columns))
    return table


def _tick_cells(t: TickStatistics, rows_lost: int) -> dict[str, str]:
    """What the table says of one run, by the title of its row."""
    return {
        "ticks": str(t.ticks),
        "late, skipped": f"{t.late}, {t.skipped}",
        "lateness µs, p50/p99/max": f"{t.lateness_us_p50:.0f}/{t.lateness_us_p99:.0f}/{t.lateness_us_max:.0f}",
        "no feedback, late feedback": f"{t.missing_feedback}, {t.late_feedback}",
        "errors on the wire": str(t.wire_errors),
        "rows lost": str(rows_lost),
    }

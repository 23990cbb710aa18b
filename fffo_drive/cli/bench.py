"""The paper's comparison, live: PI, PI+FBFO, PI+FFFO and our PI+FFFO+ on one reference at 2 kHz over CANopen.

Starts the simulated drive as a CANopen node in its own process on its own loopback bus, brings it up, runs the
controllers of the scenario `paper` in real time, records one MCAP file per run, prints the metrics of Table II and the
tick statistics, and writes the report page to the directory of the recordings.

--nearest runs the axis whose ratios come nearest to the paper's. Two of its numbers are inferred, not printed, and one
of them contradicts what is printed: the output says so.
"""

from __future__ import annotations

import argparse
import json
import time
from functools import partial
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from ..can.link import free_loopback_port
from ..config.checks import law_margins
from ..config.commissioning import Permission
from ..config.drive_section import CanopenDriveSection
from ..config.runaway import accepted_words
from ..config.scenario import Scenario, axis_of, on_axis, read_scenario
from ..documents import refuse
from ..evaluation.metrics import METRIC_UNITS, PAPER_TABLE_2, TickStatistics, bases_of, percent_of_bases
from ..recording.reader import read_run
from ..report.bench import BenchRecord, BenchResult, evaluate, timing_cautions, write_bench_report
from ..runtime.runs import timestamp_name
from ..system.service_files import sources
from ..workflows.evaluate_live import runs_on_bus
from ..workflows.plan import make_plan
from .progress import progress_bar, table_console

QUICK_S = 10.0
PRINTED, NEAREST = ("axis_bench.yaml", "simulated_drive.yaml"), ("axis_nearest.yaml", "simulated_nearest.yaml")
PRINTED_GAIN_RPS_PER_A, PRINTED_TIME_S = 26.17, 0.166  # Gh and Th, section IV-B of the paper


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument(
        "--quick", action="store_true", help=f"{QUICK_S:g} s per controller instead of the file's duration"
    )
    parser.add_argument("--bus", help="bus for drive and controller, e.g. socketcan:vcan0 (default: a loopback bus)")
    files = parser.add_mutually_exclusive_group()
    files.add_argument("--config", help=f"axis file (default: the example {PRINTED[0]})")
    files.add_argument(
        "--nearest",
        action="store_true",
        help="the axis nearest to Table II: two numbers are inferred, not printed, and the margin is small",
    )
    parser.add_argument("--drive", help=f"simulated drive (default: the example {PRINTED[1]})")
    parser.add_argument("--out", default="runs", metavar="DIR", help="directory for the recordings (default: runs)")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else on stdout")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    _, configs = sources()
    axis, drive = NEAREST if options.nearest else PRINTED
    plan = make_plan(options.config or configs / axis)  # with the checks before any run
    scenario = on_axis(read_scenario(configs / "scenarios" / "paper.yaml"), plan.path)
    if options.quick:
        scenario = _shortened(scenario)
    if not isinstance(scenario.axis.drive, CanopenDriveSection):
        problem = f"bench needs an axis on a bus, such as the example {PRINTED[0]}"
        refuse(scenario.axis_path, [("drive.kind", problem)])
    label = nearest_label(scenario) if options.nearest else ""
    console = Console(stderr=True, quiet=options.json)
    if label:
        console.print(label, soft_wrap=True, highlight=False)
    bus = options.bus or f"loopback:{free_loopback_port()}"
    out = Path(options.out) / timestamp_name("bench", time.time_ns())
    out.mkdir(parents=True, exist_ok=True)
    for text in accepted_words(plan.axis, plan.model):
        console.print(f"warning: {text}", soft_wrap=True)
    console.print(f"simulated drive and controller on {bus}; the first start compiles the loop", soft_wrap=True)
    given = Permission(None, None, "not needed: the drive is simulated")
    bar = partial(progress_bar, quiet=options.json)
    runs = runs_on_bus(scenario, bus, str(options.drive or configs / drive), out, given, bar)
    records = {}
    for run in runs:
        parts = tuple(read_run(file) for file in run.outcome.files if file.exists())
        lost, late_share = run.outcome.recorder.rows_lost, scenario.axis.loop.late_share
        records[run.controller.upper()] = BenchRecord(parts, run.outcome.exchange, lost, late_share)
    with console.status("drawing the report"):
        result = evaluate(records, label)
        report = write_bench_report(records, result, out)
    _report(records, result, report.page, options.json)
    return 0


def _shortened(scenario: Scenario) -> Scenario:
    """The same profile in QUICK_S: same lines, envelope compressed."""
    profile = scenario.axis.profile.model_copy(update={"duration_s": QUICK_S})
    return scenario._replace(file=scenario.file.model_copy(update={"reference": profile}))


def nearest_label(scenario: Scenario) -> str:
    """What is inferred, not printed, and by how much it contradicts what is printed."""
    kt, sigma = scenario.model.torque_constant_nm_per_a, scenario.model.friction.viscous_nm_per_rps.value
    observer = scenario.axis.controller.observer.gain_nm_per_rev
    margins = law_margins(axis_of(scenario, "pi+fffo"), scenario.model, observer_on=True)
    highest_s = PRINTED_TIME_S / PRINTED_GAIN_RPS_PER_A * kt / sigma
    return (
        f"Nearest point: Kt {kt:g} Nm/A and L {observer:g} Nm/rev are inferred, not printed. This Kt contradicts the "
        f"printed frequency response: viscous friction alone allows a gain of Kt / sigma = {kt / sigma:.1f} rps/A "
        f"(printed {PRINTED_GAIN_RPS_PER_A:g}) and a time constant of J / sigma = {highest_s:.3f} s "
        f"(printed {PRINTED_TIME_S:g}). PI+FFFO has a phase margin of {margins.phase_deg:.0f} deg."
    )


def _report(records: dict[str, BenchRecord], result: BenchResult, page: Path, as_json: bool) -> None:
    files = [str(record.parts[-1].path) for record in records.values()]
    if as_json:
        print(json.dumps({**as_object(result), "files": files, "report": str(page)}, indent=2))
        return
    console = table_console()
    console.print(_metrics_table(result))
    console.print(_ticks_table(result))
    for text in timing_cautions(result):
        console.print(f"caution: {text}", highlight=False, soft_wrap=True)
    for file in files:
        console.print(file, highlight=False, soft_wrap=True)
    console.print(f"report: {page}", highlight=False, soft_wrap=True)


def as_object(result: BenchResult) -> dict[str, Any]:
    """The result for programs."""
    return {
        "label": result.label,
        "percent_of": bases_of(result.metrics),
        "controllers": {name: metrics._asdict() for name, metrics in result.metrics.items()},
        "ticks": {name: {**t._asdict(), "rows_lost": result.rows_lost[name]} for name, t in result.ticks.items()},
    }


def _metrics_table(result: BenchResult) -> Table:
    percent, bases = percent_of_bases(result.metrics), set(bases_of(result.metrics).values())
    base = bases.pop() if len(bases) == 1 else "the smallest"
    table = Table(
        title=f"velocity error: value, % of {base} (% in the paper's Table II)",
        title_justify="left",
        box=SIMPLE,
        padding=(0, 0, 0, 1),
    )
    table.add_column("", no_wrap=True)
    for key, unit in METRIC_UNITS.items():
        table.add_column(f"{key.upper()} {unit}", justify="right", no_wrap=True)
    for name, metrics in result.metrics.items():
        table.add_row(name, *(_metric_cell(name, key, getattr(metrics, key), percent) for key in METRIC_UNITS))
    return table


def _metric_cell(name: str, key: str, value: float, percent: dict[str, dict[str, float]]) -> str:
    printed = f"({PAPER_TABLE_2[name][key]:.0f})" if name in PAPER_TABLE_2 else ""
    return f"{value:.3g} {percent[name][key]:3.0f} {printed:5}"


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

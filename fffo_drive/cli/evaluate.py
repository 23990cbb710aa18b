"""Compare controllers: over many seeds on the simulated drive in process, on recorded runs, or on a bus.

  fffo-drive evaluate configs/scenarios/paper.yaml --controllers pi,pi+fffo --out DIR
  fffo-drive evaluate SCENARIO --peers         other laws as well, with the margins of pi+fffo+
  fffo-drive evaluate --runs pi.mcap pi_fffo.mcap --out DIR
  fffo-drive evaluate SCENARIO --bus [BUS]     a scenario whose axis is on a bus, in real time, one run after another

Writes report.html and report.json to DIR and prints the metrics. Each seed draws other noise and other phases of the
reference.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rich.box import SIMPLE
from rich.table import Table

from ..config.commissioning import permission
from ..config.scenario import (
    Scenario,
    law_cautions,
    read_scenario,
    reference_of,
    yardstick_of,
)
from ..documents import DocumentError
from ..evaluation.campaign import Evaluation
from ..evaluation.measures import Yardstick
from ..evaluation.summary import Summary, summarise
from ..report.document import SourceFile, provenance, source_file, source_log
from ..report.evaluate import KINDS, METRICS, EvaluationSource, evaluation_report, missing_text
from ..report.page import refuse_other_report, write_report
from ..runtime.runs import timestamp_name
from ..workflows.errors import DriveFaultError
from ..workflows.evaluate import narrowed, run_published, run_seeds
from ..workflows.evaluate_live import BEFORE, evaluate_on_bus, evaluate_recordings
from .progress import progress_bar, table_console


class Compared(NamedTuple):
    """The runs of a comparison, and what they rest on."""

    title: str
    subtitle: str
    evaluations: list[Evaluation]
    yardstick: Yardstick
    percent_of: str | None
    cautions: list[str]
    files: list[SourceFile]
    published: frozenset[str] = frozenset()  # names of laws that are not the scenario's


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("scenario", nargs="?", metavar="SCENARIO", help="scenario file (configs/scenarios/*.yaml)")
    parser.add_argument(
        "--controllers", metavar="NAMES", help="controllers of the scenario, comma-separated (default: all)"
    )
    parser.add_argument("--seeds", type=int, metavar="N", help="number of seeds (default: the scenario's)")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one per core)")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--runs", nargs="+", metavar="FILE", help="evaluate recordings (.mcap) instead of running")
    source.add_argument(
        "--bus", nargs="?", const="", metavar="BUS", help="run on a bus in real time (default: the axis file's bus)"
    )
    source.add_argument(
        "--peers",
        action="store_true",
        help="run other laws as well: plain PI with all integral action, published ones (LuGre, generalised Maxwell "
        "slip, disturbance and extended state observer, reduced-order friction observer), and the drive's own velocity "
        "loop with and without torque from the PC",
    )
    parser.add_argument("--node", metavar="FILE", help="with --bus: start this simulated drive on the bus")
    parser.add_argument(
        "--uncommissioned", action="store_true", help="enable a drive on a bus without a commissioning record"
    )
    parser.add_argument("--out", metavar="DIR", help="directory of the report (default: runs/evaluate_TIME)")
    parser.add_argument("--json", action="store_true", help="print report.json's results and nothing else on stdout")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    out = Path(options.out or Path("runs") / timestamp_name("evaluate", time.time_ns()))
    scenario = _scenario(options)
    refuse_other_report(out, "evaluate")
    out.mkdir(parents=True, exist_ok=True)
    if options.runs:
        compared = _compared_recordings(options.runs, scenario)
    else:
        if scenario is None:
            raise DocumentError("give a SCENARIO or --runs FILE...")
        compared = _compared_scenario(scenario, options, out)
    try:
        summary = summarise(compared.evaluations, compared.percent_of)
    except ValueError as error:
        raise DriveFaultError(str(error)) from None
    facts = {"seeds": str(len(summary.seeds)), "controllers": ", ".join(summary.controllers)}
    source = EvaluationSource(
        compared.title,
        compared.subtitle,
        compared.yardstick,
        compared.cautions,
        provenance(compared.files, facts),
        compared.published,
    )
    report = evaluation_report(source, summary, compared.evaluations)
    paths = write_report(report, out)
    if options.json:
        print(json.dumps(json.loads(paths.json.read_text(encoding="utf-8"))["results"], indent=2))
        return 0
    print_summary(summary)
    for caution in (text for text in report.verdict.cautions if text not in summary.failures):
        print(f"caution: {caution}", file=sys.stderr)
    print(f"{paths.page}\n{paths.json}")
    return 0


def _scenario(options: argparse.Namespace) -> Scenario | None:
    if options.scenario is None:
        return None
    names = [name.strip() for name in options.controllers.split(",")] if options.controllers else None
    return narrowed(read_scenario(options.scenario), names, options.seeds)


def _compared_scenario(scenario: Scenario, options: argparse.Namespace, out: Path) -> Compared:
    file = scenario.file
    cautions = law_cautions(scenario)
    published: list[Evaluation] = []
    bar = partial(progress_bar, quiet=options.json)
    if options.bus is not None:
        own_node = options.node is not None  # a simulated drive of the scenario's own needs no commissioning
        given = permission(
            scenario.axis_path, scenario.axis, scenario.model, uncommissioned=own_node or options.uncommissioned
        )
        evaluations = evaluate_on_bus(scenario, options.bus or None, options.node, out, given, bar)
        where = "on a bus, in real time"
    else:
        if options.peers:  # first: where they cannot be run, nothing is
            with bar("other laws") as progress:
                published, left = run_published(scenario, options.workers, progress)
            cautions = [*cautions, _caution_about_fits(left)]
        with bar(f"{file.name:8}") as progress:
            evaluations = run_seeds(scenario, options.workers, progress)
        if published:
            ticks = reference_of(scenario, file.first_seed).values.size * file.seeds
            cautions = [*cautions, caution_about_envelope(evaluations, ticks)]
        evaluations = [*evaluations, *published]
        where = "on the simulated drive in process"
    others = dict.fromkeys(one.candidate for one in published)
    return Compared(
        f"Evaluation of {file.name}",
        f"{', '.join([*file.controllers, *others])} {where}, {file.seeds} seeds.",
        evaluations,
        yardstick_of(file),
        file.percent_of,
        cautions,
        [source_file(path.name, path.read_bytes(), text=True) for path in (scenario.path, scenario.axis_path)],
        frozenset(others),
    )


def _caution_about_fits(left: Sequence[float]) -> str:
    shares = ", ".join(
        f"{name} {100.0 * share:.0f} %" for name, share in zip(("2SEP", "LuGre", "GMS"), left, strict=True)
    )
    return (
        "The other laws have the margins of pi+fffo+, and its gains, inertia torque and preview where they have such. "
        "drive: PI at 8 kHz in the drive, with its own delay. Their friction models are fitted "
        "to one run on the same simulated axis and then given the scenario's model error. "
        f"Friction that the fit leaves unexplained: {shares}. luenberger+ follows Ruderman (arXiv 2504.21316) in part: "
        "its tangent stiffness, from the 2SEP fit, and the choice of its poles are this project's."
    )


def caution_about_envelope(evaluations: Sequence[Evaluation], ticks: int) -> str:
    """How often the envelope, which the other laws lack, changed a command. `ticks`: of each controller."""
    counts: dict[str, int] = {}
    for one in evaluations:
        counts[one.candidate] = counts.get(one.candidate, 0) + (one.envelope_ticks or 0)
    changed = ", ".join(f"of {name} in {count} of {ticks} ticks" for name, count in counts.items() if count)
    return (
        f"Of the laws compared, {', '.join(counts)} ran with the envelope (limits of current, slew rate and I2t), the "
        f"others without it. It changed {f'the command {changed}' if changed else 'no command'}."
    )


def _compared_recordings(files: Sequence[str], scenario: Scenario | None) -> Compared:
    yardstick, evaluations, cautions = evaluate_recordings(
        files, None if scenario is None else yardstick_of(scenario.file)
    )
    return Compared(
        f"Evaluation of {len(files)} recordings",
        "Recorded runs; runs of one controller count as seeds, in the order given.",
        evaluations,
        yardstick,
        (BEFORE if any(one.candidate == BEFORE for one in evaluations) else None)
        if scenario is None
        else scenario.file.percent_of,
        cautions,
        [source_log(Path(name)) for name in files],
    )


def print_summary(summary: Summary) -> None:
    """The metrics on the terminal."""
    console = table_console()
    for kind in KINDS:
        if f"{kind}.ise" not in summary.figures:
            continue
        base = summary.figures[f"{kind}.ise"].base
        title = f"error against {KINDS[kind]} (rps, ISE rps² s), and % of {base}"
        table = Table(title=title, title_justify="left", box=SIMPLE, padding=0, collapse_padding=True)
        table.add_column("", no_wrap=True)
        for title in (*METRICS.values(), "lag ms"):
            table.add_column(title, justify="right", no_wrap=True)
        for controller in summary.controllers:
            cells = []
            for key in METRICS:
                comparison = summary.figures[f"{kind}.{key}"]
                value, percent = comparison.absolute[controller].value, comparison.percent[controller].value
                cells.append(f"{value:.3g} {percent:4.3g}%")
            name = f"{kind}.lag.mean_absolute_ms"
            missing = missing_text(summary, name, controller)
            cells.append(missing or f"{summary.figure(name, controller):.2f}")
            table.add_row(controller, *cells)
        console.print(table)
    for failure in summary.failures:
        console.print(failure, highlight=False, soft_wrap=True)

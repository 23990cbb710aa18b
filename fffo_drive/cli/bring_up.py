"""Write the axis file of a drive on a bus, without moving anything.

fffo-drive bring-up socketcan:can0 --out axis.yaml

Checks that the bus has no other master, scans it (also for nodes without an id, by LSS), reads the drive's objects,
lists what keeps it from Operation Enabled, measures the highest rate that drive, bus and this machine allow (SYNC and
feedback, the drive stays disabled), and writes the axis file and a first model, each value with its source.

At a terminal it asks for values that no drive reports; they can also be given as options. For the measurement the
drive's PDOs, its monitoring and the objects of its profile are set up as for a run; nothing is stored in the drive. The
next step is `fffo-drive commission`, which moves the axis.

exit codes: 0 ready to be commissioned, 69 no node answers or the bus is not free, 70 the drive is not ready,
78 the files exist already, or a value is unknown
"""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

from ..system.findings import HostFinding, Severity
from ..workflows.bring_up import BringUpReport, Wishes, bring_up_axis
from ..workflows.drive_facts import OPTIONS, Answers
from ..workflows.load_range import inertia_range
from ..workflows.rate_trial import RateTrial
from .exits import EXIT_BAD_INPUT, EXIT_DRIVE_FAULT, EXIT_OK, EXIT_UNAVAILABLE
from .reset import add_reset_option

WIDTH = 80
MARKS = {Severity.FAILURE: "in the way", Severity.WARNING: "look at", Severity.OK: "ok"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("bus", metavar="BUS", help="socketcan:can0 or loopback:PORT")
    parser.add_argument("--node", type=int, metavar="ID", help="the drive's node id (default: the drive that is found)")
    parser.add_argument("--out", default="axis.yaml", metavar="FILE", help="axis file to write (default: %(default)s)")
    parser.add_argument("--force", action="store_true", help="overwrite files")
    parser.add_argument("--assign", type=int, metavar="ID", help="give this id to the one node that has none (LSS)")
    parser.add_argument("--bitrate", type=int, metavar="HZ", help="bit rate of the bus (default: the interface's)")
    parser.add_argument(
        "--seconds", type=float, default=2.0, metavar="S", help="seconds of measurement at each rate (2)"
    )
    parser.add_argument("--no-measure", action="store_true", help="do not measure: read objects and write files only")
    add_reset_option(parser)
    parser.add_argument("--yes", action="store_true", help="do not ask: accept assumed values; nothing moves")
    parser.add_argument("--json", action="store_true", help="print one JSON object, do not ask")
    known = parser.add_argument_group("values that the drive does not report, or reports wrongly")
    for name, (option, text) in OPTIONS.items():
        known.add_argument(option, dest=name, type=_above_zero, metavar="NUMBER", help=text)
    known.add_argument(
        "--profile",
        metavar="NAME",
        help="profile of its family, if vendor and product do not identify it (`fffo-drive config drives`)",
    )
    known.add_argument(
        "--inertia", dest="inertia_kg_m2", type=_above_zero, metavar="KGM2", help="inertia of motor and load"
    )
    known.add_argument(
        "--inertia-range",
        dest="inertia_range_kg_m2",
        type=_above_zero,
        nargs=2,
        metavar=("LEAST", "LARGEST"),
        help="the same with the least and with the largest load, if the load changes: all margins hold over it",
    )


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    if not 0.1 <= options.seconds <= 600.0:
        raise SystemExit("fffo-drive bring-up: --seconds: 0.1 to 600")
    if options.reset_fault and options.no_measure:
        raise SystemExit("fffo-drive bring-up: --reset-fault: the measurement resets it: not with --no-measure")
    may_ask = sys.stdin.isatty() and not (options.yes or options.json)
    answers = Answers(**{name: getattr(options, name) for name in Answers._fields})
    if answers.counts_per_rev is not None:
        answers = answers._replace(counts_per_rev=round(answers.counts_per_rev))
    if answers.inertia_range_kg_m2 is not None:
        answers = answers._replace(inertia_range_kg_m2=inertia_range(*answers.inertia_range_kg_m2))
    wishes = Wishes(
        options.bus, Path(options.out), options.node, options.assign, answers, options.profile,
        options.bitrate, options.force, not options.no_measure, options.seconds, options.reset_fault,
    )  # fmt: skip
    report = bring_up_axis(wishes, Terminal(may_ask, quiet=options.json))
    if options.json:
        print(json.dumps(report.as_json(), indent=2))
    else:
        print("\n".join(report_lines(report)))
    code = exit_code(report)
    if code == EXIT_OK and may_ask and report.axis_file is not None:
        return _lead_on(report.axis_file)
    return code


def exit_code(report: BringUpReport) -> int:
    """What a script sees."""
    if report.ready:
        return EXIT_OK
    if report.missing or (report.node_id is None and report.nodes and not any(one.remark for one in report.nodes)):
        return EXIT_BAD_INPUT
    return EXIT_UNAVAILABLE if report.node_id is None else EXIT_DRIVE_FAULT


def _above_zero(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: a number above 0 is needed")
    return value


class Terminal:
    """Progress on stderr, questions where somebody can answer."""

    def __init__(self, may_ask: bool, quiet: bool) -> None:
        self._may_ask, self._quiet = may_ask, quiet
        self._shows = not quiet and sys.stderr.isatty()
        self._shown = ""

    def tell(self, text: str) -> None:
        """A line."""
        if not self._quiet:
            self._wipe()
            indent = len(text) - len(text.lstrip())
            print(
                textwrap.fill(text, WIDTH, subsequent_indent=" " * (indent + 2), break_on_hyphens=False),
                file=sys.stderr,
            )

    def progress(self, share: float) -> None:
        """Beside it, on a terminal."""
        shown = f"  {share:4.0%}"
        if self._shows and shown != self._shown:
            print(f"\r{shown}", end="", file=sys.stderr, flush=True)
            self._shown = shown

    def _wipe(self) -> None:
        if self._shown:
            print("\r" + " " * len(self._shown) + "\r", end="", file=sys.stderr)
            self._shown = ""

    def ask(self, question: str, proposal: str) -> str | None:
        """None where nobody can be asked."""
        if not self._may_ask:
            return None
        self._wipe()
        text = textwrap.fill(f"{question} [{proposal}] ", WIDTH)
        try:
            return input(f"{text} ").strip() or proposal
        except EOFError:
            return None


def _lead_on(axis_file: Path) -> int:
    """Offer the next step, which moves the axis; no is the answer of who types nothing."""
    try:
        answer = input("start it now? The axis will move a little, within limits [y/N] ")
    except EOFError:
        return EXIT_OK
    if answer.strip().lower() not in ("y", "yes"):
        return EXIT_OK
    from . import main

    return main(["commission", str(axis_file)])


def report_lines(report: BringUpReport) -> Iterator[str]:
    """The whole report, for 80 columns; the verdict first."""
    yield ""
    yield from _wrapped(report.verdict)
    for finding in report.findings:
        if finding.level is not Severity.OK:
            yield from _finding(finding)
    if report.trials:
        yield ""
        yield from _trials(report)
    if report.facts:
        yield ""
        yield "values of the axis file:"
        for name, fact in report.facts.items():
            shown = f"{fact.value:.10g}" if isinstance(fact.value, int | float) else str(fact.value)
            yield from _wrapped(f"  {name}: {shown}   ({fact.source})", 4)
    if report.notes:
        yield ""
        yield from _wrapped(f"profile {report.profile} of its family:", 2)
        for note in report.notes:
            yield from _wrapped(f"  {note}", 4)
    fine = [one for one in report.findings if one.level is Severity.OK]
    if fine:
        yield ""
        yield from _wrapped("ok: " + "; ".join(one.text for one in fine), 2)
    if report.axis_file is not None:
        yield ""
        yield f"written: {report.axis_file}, {report.model_file}"
        yield f"{'next: ' if report.ready else 'then: '}   {report.next_command}"


def _finding(finding: HostFinding) -> Iterator[str]:
    yield from _wrapped(f"  {MARKS[finding.level]}: {finding.subject}: {finding.text}", 4)
    if finding.remedy:
        yield from _wrapped(f"    -> {finding.remedy}", 7)


def _trials(report: BringUpReport) -> Iterator[str]:
    yield "without torque, in us         50 % / 99 % / highest"
    if report.adapter is not None:
        yield f"  frame sent to received      {report.adapter.adapter_us.text}"
        yield f"  SDO request to answer       {report.adapter.answer_us.text}"
    for trial in report.trials:
        if not trial.refused:
            yield from _trial(trial)
    if report.choice is not None:
        rate = "no rate fits" if report.choice.rate_hz is None else f"{report.choice.rate_hz} Hz"
        yield from _wrapped(f"rate: {rate}. {report.choice.reason}", 2)


def _trial(trial: RateTrial) -> Iterator[str]:
    yield (f"  {trial.rate_hz:>4} Hz  SYNC to feedback    {trial.turnaround_us.text}, jitter {trial.jitter_us:.0f}")
    yield f"           loop wakes late     {trial.lateness_us.text}, SYNC jitter {trial.sync_jitter_us:.0f}"
    yield (
        f"           of {trial.ticks} ticks: {trial.missing} without feedback, {trial.late} late, {trial.skipped} "
        "skipped; "
        f"bus {trial.bus_load:.0%}"
    )


def _wrapped(text: str, indent: int = 0) -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent=" " * indent, break_on_hyphens=False) or [""]

"""Check signs, scales, delay and limits of an axis before any loop is closed, and write a record of it.

The axis moves: small current pulses of both signs grow until it turns a little. The program asks before each motion;
answer `all` or give --yes, and it does not ask again. Current, speed, travel and time are limited, and it stops at the
first unexpected result. `fffo-drive run` enables a drive on a bus only with a record that has passed, that is for this
drive and these declared facts, and that the axis file names under `commissioning:`. The program asks before it writes
that line; --accept writes it later, without motion.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
from pathlib import Path

from rich.box import SIMPLE
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..commissioning.motion import PulseMotion
from ..commissioning.procedure import NextMotion, NotAgreedError
from ..commissioning.record import FAILED, NOT_DONE, OK, WARNING, CheckRecord, CommissioningRecord
from ..config.drive_section import CanopenDriveSection
from ..config.resolution import coarse_words, resolution_lines
from ..config.runaway import accepted_words
from ..workflows.commission import accept_record, bounds_of, commission_axis, commissioning_plan, record_path
from ..workflows.errors import DriveFaultError
from ..workflows.plan import Plan
from ..workflows.progress import CHECK_MARK, LINES_ENVIRONMENT, QUESTION_MARK
from .exits import UnconfirmedError
from .progress import table_console
from .reset import add_reset_option

PICTURE_POINTS = 300  # of a motion, for a page
COLOURS = {"ok": "green", "warning": "yellow", "failed": "red", "not_done": "dim"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("config", metavar="AXIS", help="axis file (YAML)")
    parser.add_argument("--bus", help="bus instead of the file's: socketcan:can0, loopback:PORT")
    parser.add_argument(
        "--out",
        metavar="FILE",
        help="record to write (default: the file's commissioning, else NAME.commissioning.yaml)",
    )
    add_reset_option(parser)
    parser.add_argument("--yes", action="store_true", help="do not ask before each motion")
    parser.add_argument("--accept", action="store_true", help="enter the passed record in AXIS; nothing moves")
    parser.add_argument("--json", action="store_true", help="print the record as one JSON object")
    bounds = parser.add_argument_group(
        "bounds", "the defaults come from the envelope of the axis file and are within it"
    )
    bounds.add_argument("--current", type=float, metavar="A", help="largest current (default: half the continuous)")
    bounds.add_argument("--speed", type=float, metavar="RPS", help="largest speed (default: 5, or half the limit)")
    bounds.add_argument("--travel", type=float, metavar="REV", help="largest travel from here (default: 2)")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    plan = commissioning_plan(Path(options.config))
    out = Path(options.out) if options.out else record_path(plan)
    if options.accept:
        print(f"{plan.path}: commissioning: {accept_record(plan, out)}")
        return 0
    bounds = bounds_of(plan, options.current, options.speed, options.travel)
    console = Console(stderr=True, quiet=options.json)
    for line in resolution_lines(plan.axis, plan.model):
        console.print(line, soft_wrap=True, highlight=False)
    for text in (*accepted_words(plan.axis, plan.model), *coarse_words(plan.axis, plan.model)):
        console.print(f"warning: {text}", soft_wrap=True, highlight=False)
    console.print(
        f"the axis will move: at most {bounds.current_a:g} A, {bounds.speed_rps:g} rps, {bounds.travel_rev:g} rev from "
        "here; Ctrl-C stops it",
        soft_wrap=True, highlight=False,
    )  # fmt: skip
    may_move = Asking(plan, options)

    def tell(text: str) -> None:
        console.print(f"  {text}", soft_wrap=True, highlight=False)

    try:
        record = commission_axis(plan, bounds, out, options.bus, tell, _seen, may_move, options.reset_fault)
    except NotAgreedError as error:
        raise UnconfirmedError(str(error)) from None
    if options.json:
        print(json.dumps(record.model_dump(mode="json"), indent=2))
    else:
        _print(record, plan, out)
    if not record.passed:
        failed = [check.name for check in record.checks if check.verdict == FAILED]
        raise DriveFaultError(f"not passed: {', '.join(failed) or 'not all checks were done'}; the record is in {out}")
    asks = not options.json and not _named(plan, out) and sys.stdin.isatty()
    if asks and _agreed(f"write `commissioning: {os.path.relpath(out, plan.path.parent)}` into {plan.path}?"):
        accept_record(plan, out)
    return 0


def _named(plan: Plan, out: Path) -> bool:
    """The axis file names this record already; a simulated axis needs it too, for the margins of its law."""
    return plan.axis.commissioning == os.path.relpath(out, plan.path.parent)


def _agreed(question: str) -> bool:
    return input(f"{question} [y/N] ").strip().lower() in ("y", "yes")


def _seen(check: CheckRecord, motion: PulseMotion | None) -> None:
    """For a program that started this one: a check, and the motion before it."""
    if not os.environ.get(LINES_ENVIRONMENT):
        return
    columns: dict[str, list[float]] = {}
    if motion is not None and motion.size:
        stride = max(1, -(-motion.size // PICTURE_POINTS))
        for name in ("time_s", "command_a", "velocity_rps", "position_rev"):
            columns[name] = [float(f"{value:.4g}") for value in getattr(motion, name)[::stride]]
    content = {**check.model_dump(mode="json"), "motion": columns}
    print(CHECK_MARK + json.dumps(content), file=sys.stderr, flush=True)


class Asking:
    """Whether the next motion may be made: asked at the terminal, or of the program that started this one."""

    def __init__(self, plan: Plan, options: argparse.Namespace) -> None:
        """A drive in process moves nothing. Raises UnconfirmedError where nobody can be asked."""
        self._all = options.yes or not isinstance(plan.axis.drive, CanopenDriveSection)
        self._program = bool(os.environ.get(LINES_ENVIRONMENT))
        if not self._all and not self._program and (options.json or not sys.stdin.isatty()):
            raise UnconfirmedError(
                "commission moves the axis and there is no terminal to ask at: make sure that it may move, and give "
                "--yes"
            )

    def __call__(self, motion: NextMotion) -> bool:
        """Ask, unless the rest may be made without."""
        if self._all:
            return True
        if self._program:
            print(QUESTION_MARK + json.dumps(motion._asdict()), file=sys.stderr, flush=True)
            answer = sys.stdin.readline()
        else:
            answer = input(f"{', '.join(motion.checks)}: {motion.text}. May it move? [y/N/all] ")
        answer = answer.strip().lower()
        self._all = answer in ("a", "all")
        return self._all or answer in ("y", "yes")


def verdict_line(record: CommissioningRecord) -> str:
    """Passed or not, and why, in one sentence."""
    of = {
        verdict: [check for check in record.checks if check.verdict == verdict]
        for verdict in (FAILED, WARNING, NOT_DONE)
    }
    if of[FAILED]:
        first = of[FAILED][0]
        others = f" (and {len(of[FAILED]) - 1} more)" if len(of[FAILED]) > 1 else ""
        return f"not passed: {first.name}{others}: {first.text}"
    if of[NOT_DONE]:
        return f"not passed: {len(of[NOT_DONE])} of {len(record.checks)} checks were not done: {of[NOT_DONE][0].text}"
    if of[WARNING]:
        names = ", ".join(check.name for check in of[WARNING])
        return f"passed, with a warning from {len(of[WARNING])} of {len(record.checks)} checks: {names}"
    return f"passed: all {len(record.checks)} checks are ok"


def next_line(record: CommissioningRecord, plan: Plan, out: Path) -> str:
    """What to do now, in one sentence."""
    if not record.passed:
        remedy = next((check.remedy for check in record.checks if check.verdict == FAILED and check.remedy), "")
        return remedy or "remove the cause, and commission again"
    name, place = os.path.relpath(out, plan.path.parent), shlex.quote(str(plan.path))
    if _named(plan, out):
        return f"fffo-drive run {place}"
    return f"fffo-drive commission {place} --accept, which adds the line commissioning: {name}"


def _print(record: CommissioningRecord, plan: Plan, out: Path) -> None:
    console = table_console()
    console.print(f"[bold]{record.axis}: {escape(verdict_line(record))}[/]", soft_wrap=True, highlight=False)
    console.print(f"next: {escape(next_line(record, plan, out))}", soft_wrap=True, highlight=False)
    drive = record.drive
    name = drive.device_name or f"vendor 0x{drive.vendor_id:X}, product 0x{drive.product_code:X}"
    console.print(f"drive: {name}; record: {out}", soft_wrap=True, highlight=False, markup=False)
    table = Table(box=SIMPLE, show_edge=False)
    table.add_column("check", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    table.add_column("found")
    missing: str | None = None  # one cause has many results: reported once
    for check in record.checks:
        found = "the same" if check.verdict == NOT_DONE and check.text == missing else found_text(check)
        missing = check.text if check.verdict == NOT_DONE else missing
        verdict = f"[{COLOURS[check.verdict]}]{check.verdict.replace('_', ' ')}[/]"
        table.add_row(check.name, verdict, escape(found))
    console.print(table)


def found_text(check: CheckRecord) -> str:
    """What was found; of what is not ok also the range that is, and what to do."""
    lines = [check.text]
    if check.verdict != OK and check.measured is not None:
        lines.append(f"measured {_number(check.measured, check.unit)}, ok is {_range(check)}")
    if check.remedy:
        lines.append(f"-> {check.remedy}")
    return "\n".join(lines)


def _number(value: float, unit: str) -> str:
    return f"{value:.4g}" if unit == "-" else f"{value:.4g} {unit}"


def _range(check: CheckRecord) -> str:
    low, high = check.lowest, check.highest
    if low is None:
        return f"at most {_number(high, check.unit)}" if high is not None else "any"
    return f"{low:.4g} to {_number(high, check.unit)}" if high is not None else f"at least {_number(low, check.unit)}"

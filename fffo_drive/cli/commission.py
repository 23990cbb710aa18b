"""Check signs, scales, delay and limits of an axis before any loop is closed, and write a record of it.

The axis moves: small current pulses of both signs grow until it turns a little. Current, speed, travel and time are
bounded, and the first surprise ends it. `fffo-drive run` enables a drive on a bus only with a record that has passed,
for this drive and these declared facts: name it under `commissioning:` in the axis file.
"""

from __future__ import annotations

import argparse
import json
import os
from datetime import UTC, datetime
from pathlib import Path

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from .. import __version__
from ..commissioning.bounds import Bounds, BoundsError, make_bounds
from ..commissioning.procedure import Outcome, commission
from ..commissioning.record import (
    FAILED,
    BoundsRecord,
    CheckRecord,
    CommissioningRecord,
    DriveRecord,
    overall,
    write_record,
)
from ..config.axis import beside, build_profile, model_of, read_axis
from ..config.checks import bus_problems, require
from ..config.commissioning import declared_facts
from ..config.drive_section import CanopenDriveSection
from ..model.parameters import content_hash
from .drives import Plan, open_drive, plan_session
from .exits import DriveFaultError

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
    parser.add_argument("--json", action="store_true", help="print the record as one JSON object")
    bounds = parser.add_argument_group("bounds", "defaults are made from the file's envelope, and stay inside it")
    bounds.add_argument("--current", type=float, metavar="A", help="largest current (default: half the continuous)")
    bounds.add_argument("--speed", type=float, metavar="RPS", help="largest speed (default: 5, or half the limit)")
    bounds.add_argument("--travel", type=float, metavar="REV", help="largest travel from here (default: 2)")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    plan = _plan(Path(options.config))
    out = Path(options.out) if options.out else _default_path(plan)
    session = plan_session(plan)
    try:
        bounds = make_bounds(session.envelope, options.current, options.speed, options.travel)
    except BoundsError as error:
        require(plan.path, [f"envelope: {error}"])
        raise
    _claim(out)
    drive = open_drive(plan, options.bus)
    console = Console(stderr=True, quiet=options.json)
    console.print(
        f"the axis will move: at most {bounds.current_a:g} A, {bounds.speed_rps:g} rps, {bounds.travel_rev:g} rev from "
        "here; Ctrl-C stops it",
        soft_wrap=True,
    )
    try:
        outcome = commission(
            drive, session, plan.model, declared_facts(plan.axis, plan.model), bounds,
            lambda text: console.print(f"  {text}", soft_wrap=True, highlight=False),
        )  # fmt: skip
    except BoundsError as error:
        require(plan.path, [f"envelope.position_window_rev: {error}"])
        raise
    record = write_record(out, make_record(plan, outcome, bounds, options.bus))
    if options.json:
        print(json.dumps(record.model_dump(mode="json"), indent=2))
    else:
        _print(record, plan, out)
    if not record.passed:
        failed = [check.name for check in record.checks if check.verdict == FAILED]
        raise DriveFaultError(f"not passed: {', '.join(failed) or 'not all checks were made'}; the record is in {out}")
    return 0


def _plan(path: Path) -> Plan:
    """The axis file, as far as commissioning needs it: law and profile may still be unfinished."""
    axis = read_axis(path)
    model = model_of(path, axis)
    require(path, bus_problems(axis, model))
    return Plan(path, axis, model, build_profile(axis.profile, axis.loop.period_s))


def _default_path(plan: Plan) -> Path:
    return beside(plan.path, plan.axis.commissioning or f"{plan.axis.name}.commissioning.yaml")


def _claim(out: Path) -> None:
    """See that the record can be written before anything moves. Raises OSError."""
    out.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(out.parent, os.W_OK):
        raise PermissionError(13, "no record can be written here", str(out.parent))


def make_record(plan: Plan, outcome: Outcome, bounds: Bounds, bus: str | None = None) -> CommissioningRecord:
    """The record of what was found."""
    section = plan.axis.drive
    facts = declared_facts(plan.axis, plan.model)
    return CommissioningRecord(
        axis=plan.axis.name,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        tool=f"fffo_drive {__version__}",
        bus=(bus or section.bus) if isinstance(section, CanopenDriveSection) else "in process",
        drive=DriveRecord.of(outcome.identity),
        facts=facts,
        facts_hash=facts.digest,
        model=f"{plan.model.name}, SHA-256 {content_hash(plan.model)}",
        bounds=BoundsRecord(**bounds._asdict()),
        verdict=overall(outcome.checks),
        checks=outcome.checks,
    )


def _print(record: CommissioningRecord, plan: Plan, out: Path) -> None:
    console = Console()
    table = Table(title=f"{record.axis}: {record.drive.device_name}", title_justify="left", box=SIMPLE)
    table.add_column("check", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    table.add_column("measured", justify="right", no_wrap=True)
    table.add_column("ok", justify="right", no_wrap=True)
    table.add_column("found")
    for check in record.checks:
        verdict = f"[{COLOURS[check.verdict]}]{check.verdict.replace('_', ' ')}[/]"
        table.add_row(check.name, verdict, *_numbers(check), check.text)
    console.print(table)
    for check in record.checks:
        if check.remedy:
            console.print(f"{check.name}: {check.remedy}", soft_wrap=True, highlight=False)
    console.print(f"{record.verdict}: {out}", soft_wrap=True, highlight=False)
    name = os.path.relpath(out, plan.path.parent)
    if record.passed and plan.axis.commissioning != name and isinstance(plan.axis.drive, CanopenDriveSection):
        console.print(f"add to {plan.path}:  commissioning: {name}", soft_wrap=True, highlight=False)


def _numbers(check: CheckRecord) -> tuple[str, str]:
    """Measured value, and the range that is ok."""
    if check.measured is None:
        return "", ""
    unit = "" if check.unit == "-" else f" {check.unit}"
    low, high = check.lowest, check.highest
    if low is None:
        limits = f"≤ {high:.3g}" if high is not None else ""
    else:
        limits = f"{low:.3g} .. {high:.3g}" if high is not None else f"≥ {low:.3g}"
    return f"{check.measured:.4g}{unit}", limits

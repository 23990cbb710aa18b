"""Put a diagnosed model in service on an axis: show its gates, and enter it in the axis file if all of them pass.

The drive must be disabled. AXIS.adoptions.yaml records the previous model; --rollback restores it. From the next
start (or `fffo-drive ctl reload` of a daemon) the controller compensates every effect that can be compensated, and a
monitor takes an effect out of service if tracking is worse with it (controller.effects.monitor).

Exit codes: 0 adopted (with --dry-run: all gates passed), 65 held-out runs do not confirm it or are missing, 70 the
axis's daemon has torque on, 74 the axis file cannot be written, 78 a file is missing or damaged, or the model is of
another axis, 1 any other gate refuses it.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from ..config.axis import read_axis
from ..daemon.serving import torque_on
from ..documents import DocumentError
from ..workflows.adopt import adopt, roll_back
from ..workflows.adoption_gates import DISABLED, HELD_OUT, SAME_AXIS, Gate
from .exits import EXIT_BAD_INPUT, EXIT_DRIVE_FAULT, EXIT_NOT_CONFIRMED, EXIT_REFUSED
from .progress import table_console

# the first that applies, in this order
EXIT_OF_GATE = {SAME_AXIS: EXIT_BAD_INPUT, DISABLED: EXIT_DRIVE_FAULT, HELD_OUT: EXIT_NOT_CONFIRMED}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("model", metavar="MODEL", nargs="?", help="model file that `fffo-drive diagnose` wrote")
    parser.add_argument("--axis", metavar="AXIS", required=True, help="axis file to enter the model in")
    parser.add_argument("--report", metavar="FILE", help="report of the diagnosis (default: report.json next to MODEL)")
    parser.add_argument("--sockets", metavar="DIR", help="directory of the daemon's sockets (default: search for it)")
    parser.add_argument("--dry-run", action="store_true", help="show the gates, change nothing")
    parser.add_argument("--rollback", action="store_true", help="restore the previous model")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    axis_path = Path(options.axis)
    if options.rollback:
        if options.model:
            raise DocumentError("--rollback restores the previous model: leave MODEL out")
        return _roll_back(axis_path, options.json)
    if not options.model:
        raise DocumentError("give a model file or --rollback: fffo-drive adopt MODEL --axis AXIS")
    model_path = Path(options.model)
    axis = read_axis(axis_path)
    serving = torque_on(axis.name, Path(options.sockets) if options.sockets else None)
    report_path = Path(options.report) if options.report else None
    result = adopt(axis_path, axis, model_path, report_path, serving, options.dry_run)
    found, passed, adopted, weak = list(result.gates), result.passed, result.entry, result.refused_effects
    if options.json:
        print(json.dumps({
            "adopted": adopted is not None, "passed": passed, "gates": [gate._asdict() for gate in found],
            "former": adopted.former if adopted else None, "model": str(model_path), "axis": str(axis_path),
        }, indent=2))  # fmt: skip
    else:
        print_gates(found)
        if adopted is not None:
            print(f"{axis_path}: model: {adopted.model}, before: {adopted.former} (--rollback restores it)")
            if serving is not None:
                print("a daemon serves this axis: `fffo-drive ctl reload` loads the model into it")
    if passed:
        return 0
    hint = f"; `controller.effects.out_of_service: [{', '.join(weak)}]` leaves it out" if weak else ""
    print(f"fffo-drive adopt: {refusal(found)}{hint}", file=sys.stderr)
    return exit_code(found)


def refused(found: list[Gate]) -> list[Gate]:
    """The gates that speak against an adoption, the gravest first."""
    order = list(EXIT_OF_GATE)
    against = [gate for gate in found if not gate.passed]
    return sorted(against, key=lambda gate: order.index(gate.name) if gate.name in order else len(order))


def refusal(found: list[Gate]) -> str:
    """Why a model is not adopted, in one sentence."""
    first, *others = refused(found)
    more = f"; and {', '.join(gate.name for gate in others)}" if others else ""
    return f"not adopted: {first.name}: {first.text}{more}"


def exit_code(found: list[Gate]) -> int:
    """The exit code of a refusal."""
    return EXIT_OF_GATE.get(refused(found)[0].name, EXIT_REFUSED)


def print_gates(found: Sequence[Gate], stderr: bool = False) -> None:
    """The gates as a table; on stderr if a result follows on stdout."""
    table = Table(box=None, pad_edge=False)
    for column in ("gate", "", "found"):
        table.add_column(column)
    for gate in found:
        table.add_row(gate.name, "[green]passed[/]" if gate.passed else "[red]REFUSED[/]", gate.text)
    table_console(stderr).print(table)


def _roll_back(axis_path: Path, as_json: bool) -> int:
    last = roll_back(axis_path)
    if as_json:
        print(json.dumps({"rolled_back": last.model, "model": last.former, "axis": str(axis_path)}, indent=2))
    else:
        print(f"{axis_path}: model: {last.former}; {last.model}, adopted {last.date}, is out of service")
    return 0

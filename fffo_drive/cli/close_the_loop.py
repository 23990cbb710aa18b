"""Run, record, diagnose, adopt and run again, and show the tracking error before and after.

AXIS is an axis file whose drive may move: in process, or on a bus (with --sim FILE a simulated drive is started there).
It records the axis's own profile, an identification current and the recipe that separates effects. The run of the
profile is held out: it is not used to choose effects. Everything is written to DIR, including a new axis file; AXIS
itself is not changed. DIR/report.html and report.json have the tracking error before and after, DIR/diagnosis the
findings.

With a simulated drive the timeouts are longer. If the machine is too busy, a run is repeated; if that is not enough,
all runs are repeated at 1000 or 500 Hz. On hardware a disturbed run is an error.

Exit codes: 0 adopted, or nothing found; 1 not adopted: a gate refuses the finding, or no effect in it can be
compensated; 65 not adopted: the held-out run does not confirm the finding; 69 no bus; 70 drive fault, or this machine
can keep none of the rates; 74 disk error; 77 real-time rights refused; 78 bad input.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ..documents import DocumentError
from ..report.circle import KINDS, CircleSource, Tracking, as_object
from ..runtime.runs import timestamp_name
from ..workflows.adoption_gates import Gate
from ..workflows.circle import QUICK_S, close_the_loop, keeps_no_rate
from ..workflows.circle_runs import CircleWish
from .adopt import exit_code, print_gates, refusal
from .exits import EXIT_NOT_CONFIRMED
from .progress import progress_bar, table_console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("axis", metavar="AXIS", help="axis file (YAML) with a velocity profile")
    parser.add_argument("--out", metavar="DIR", help="output directory (default: runs/circle_TIME)")
    parser.add_argument("--drive", metavar="FACTS", help="declared facts (default: from the axis file)")
    parser.add_argument("--sim", metavar="FILE", help="the simulated drive of this file, in process or on the bus")
    parser.add_argument("--bus", help="bus instead of the file's: socketcan:can0, loopback:PORT")
    parser.add_argument("--rate", type=int, metavar="HZ", help="loop rate of all runs instead of the file's")
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"runs of {QUICK_S:g} s without the recipe: separates fewer effects",
    )
    parser.add_argument(
        "--uncommissioned", action="store_true", help="enable a drive on a bus without a commissioning record"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    console = Console(stderr=True, quiet=options.json)
    closed = close_the_loop(
        Path(options.axis),
        Path(options.out or Path("runs") / timestamp_name("circle", time.time_ns())),
        CircleWish(Path(options.sim) if options.sim else None, options.bus, options.rate, options.uncommissioned),
        facts=Path(options.drive) if options.drive else None,
        quick=options.quick,
        say=lambda text: console.print(text, soft_wrap=True, highlight=False),
        bar=partial(progress_bar, quiet=options.json),
        diagnose=partial(_diagnose, options.json),
        show_gates=partial(_show_gates, options.json),
    )
    found = list(closed.gates)
    if options.json:
        print(json.dumps(as_object(closed.source), indent=2))
    else:
        _print(closed.source, closed.page)
    if closed.trouble:
        raise keeps_no_rate(closed.trouble)
    if found and not closed.adopted:
        print(f"fffo-drive close-the-loop: {refusal(found)}", file=sys.stderr)
        return exit_code(found)
    return 0


def _diagnose(
    quiet: bool, facts: Path, fit: Sequence[Path], held_out: Sequence[Path], out: Path, without: Sequence[str]
) -> None:
    """`fffo-drive diagnose` on the recorded runs; what it prints goes to stderr, or nowhere."""
    from . import diagnose

    parser = argparse.ArgumentParser()
    diagnose.add_arguments(parser)
    words = ["--drive", str(facts), "--fit", *map(str, fit), "--held-out", *map(str, held_out), "--out", str(out)]
    words += ["--without", *without] if without else []
    with contextlib.ExitStack() as stack:
        if quiet:
            words.append("--json")
            sink = stack.enter_context(open("/dev/null", "w", encoding="utf-8"))
            stack.enter_context(contextlib.redirect_stdout(sink))
        else:
            stack.enter_context(contextlib.redirect_stdout(sys.stderr))
        code = diagnose.execute(parser.parse_args(words))
    if code not in (0, EXIT_NOT_CONFIRMED):
        raise DocumentError(f"{out}: the diagnosis ended with exit code {code}")


def _show_gates(quiet: bool, found: Sequence[Gate]) -> None:
    if found and not quiet:
        print_gates(found, stderr=True)


def _print(source: CircleSource, page: Path) -> None:
    print(f"found: {', '.join(source.effects) or 'nothing'} ({source.verdict})")
    for name, reason in source.not_compensated.items():
        print(f"not compensated: {name}: {reason}")
    table = Table("tracking error", "before", "after", "change", box=None, pad_edge=False)
    for name, before, after in _rows(source.tracking):
        change_text = "-" if after is None else f"{100.0 * (after / before - 1.0):+.1f} %"
        table.add_row(name, f"{before:.4g}", "-" if after is None else f"{after:.4g}", change_text)
    table_console().print(table)
    print(page.parent / "diagnosis" / "report.html")
    print(page.parent / "axis.yaml")
    print(page)


def _rows(tracking: Tracking) -> Iterator[tuple[str, float, float | None]]:
    """Lines of the table: every metric, measured and of the shaft where it is known."""
    for kind, pair in tracking.metrics.items():
        for key, unit in (("ise", "rps^2 s"), ("mae", "rps"), ("max", "rps")):
            after = None if pair.after is None else float(getattr(pair.after, key))
            yield f"{KINDS[kind]}: {key.upper()} {unit}", float(getattr(pair.before, key)), after

"""The whole circle on one axis: run, record, diagnose, adopt, run again; the tracking error before and after.

AXIS is an axis file whose drive may move: in process, or on a bus (with --sim FILE a simulated drive is started there).
Its own profile, an identification current and the recipe that separates effects are recorded; the profile's run is held
out from the choice of effects. Everything is written to DIR, with an axis file of its own: AXIS stays as it is.
DIR/report.html and report.json have the tracking error before and after, DIR/diagnosis what was found.

On the simulated drive the limits on silence are widened, a run that a busy machine has spoiled is made again, and all
of them at 1000 or 500 Hz where it cannot keep the rate; on hardware a spoiled run is an error.

Exit codes: 0 adopted, or nothing was found; 1 something was found and a gate refuses it, or it does not carry over to
the run that was held out; 69 no bus; 70 the drive, or a machine that keeps no rate; 74 the disk; 78 bad input.
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

from ..config.adoption import Gate
from ..documents import DocumentError
from ..report.circle import CircleSource, Tracking, as_object
from ..runtime.runs import timestamp_name
from ..workflows.circle import QUICK_S, close_the_loop, keeps_no_rate
from ..workflows.circle_runs import CircleWish
from .adopt import print_gates, refusal
from .exits import EXIT_NOTHING_CARRIES_OVER
from .progress import progress_bar

EXIT_NOT_ADOPTED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("axis", metavar="AXIS", help="axis file (YAML); its profile is a velocity")
    parser.add_argument("--out", metavar="DIR", help="directory for everything (default: runs/circle_TIME)")
    parser.add_argument("--drive", metavar="FACTS", help="declared facts (default: from the axis file)")
    parser.add_argument("--sim", metavar="FILE", help="the simulated drive of this file, in process or on the bus")
    parser.add_argument("--bus", help="bus instead of the file's: socketcan:can0, loopback:PORT")
    parser.add_argument("--rate", type=int, metavar="HZ", help="loop rate of all runs instead of the file's")
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"runs of {QUICK_S:g} s, and no recipe: separates fewer effects",
    )
    parser.add_argument("--uncommissioned", action="store_true", help="enable a drive on a bus without its record")
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
    )
    found = list(closed.gates)
    if options.json:
        print(json.dumps(as_object(closed.source), indent=2))
    else:
        _print(closed.source, found, closed.page)
    if closed.trouble:
        raise keeps_no_rate(closed.trouble)
    if found and not closed.adopted:
        print(f"fffo-drive close-the-loop: {refusal(found)}", file=sys.stderr)
        return EXIT_NOT_ADOPTED
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
    if code not in (0, EXIT_NOTHING_CARRIES_OVER):
        raise DocumentError(f"{out}: the diagnosis ended with exit code {code}")


def _print(source: CircleSource, found: list[Gate], page: Path) -> None:
    if found:
        print_gates(found)
    print(f"found: {', '.join(source.effects) or 'nothing'} ({source.verdict})")
    for name, reason in source.not_compensated.items():
        print(f"not compensated: {name}: {reason}")
    table = Table("tracking error", "before", "after", "change", box=None, pad_edge=False)
    for name, before, after in _rows(source.tracking):
        change_text = "-" if after is None else f"{100.0 * (after / before - 1.0):+.1f} %"
        table.add_row(name, f"{before:.4g}", "-" if after is None else f"{after:.4g}", change_text)
    Console().print(table)
    print(page.parent / "diagnosis" / "report.html")
    print(page.parent / "axis.yaml")
    print(page)


def _rows(tracking: Tracking) -> Iterator[tuple[str, float, float | None]]:
    """Lines of the table: every metric, measured and of the shaft where it is known."""
    for kind, pair in tracking.metrics.items():
        for key, unit in (("ise", "rps^2 s"), ("mae", "rps"), ("max", "rps")):
            after = None if pair.after is None else float(getattr(pair.after, key))
            yield f"{kind} {key.upper()} {unit}", float(getattr(pair.before, key)), after

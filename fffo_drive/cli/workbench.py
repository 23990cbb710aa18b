"""Open the workbench: record, identify, tune, diagnose and adopt in a browser, on this machine.

AXIS is an axis file. Recordings of any program can be given as well or instead (with --drive, the facts about their
drive). Every button runs a command in its own process, which can be cancelled; the page shows the command and its
progress, and the results are written to --out. The page asks before a drive on a bus moves.

--fleet STORE shows a fleet's records in a tab of their own, and makes its records and its report.

You can give others an address with fewer rights: `look` shows everything, `stop` also cancels a job, `move` also
records, adds files, identifies, diagnoses and compares, `tune` also changes gains and models. workbench.log records who
did what.

Ctrl-C ends it, with what it has started; a run in progress brakes to standstill first. Not a safety function: keep the
emergency stop at hand.
"""

from __future__ import annotations

import argparse
import signal
import webbrowser
from pathlib import Path

from ..config.axis import read_axis
from ..documents import DocumentError
from ..identification.facts import read_facts
from ..roles import ROLES
from ..workbench import shelf
from ..workbench.bench import Workbench
from ..workbench.server import WorkbenchServer


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("files", nargs="*", metavar="AXIS|RUN", help="axis file (YAML), recordings")
    parser.add_argument(
        "--drive", metavar="FILE", help="declared facts about the drive of other programs' recordings (YAML)"
    )
    parser.add_argument(
        "--sockets", metavar="DIR", help="socket directory of the axis' daemon (default: found by name)"
    )
    parser.add_argument(
        "--fleet", metavar="STORE", help="fleet's store: directory or URL (default: daemon.fleet of the axis file)"
    )
    parser.add_argument("--out", metavar="DIR", default="runs/workbench", help="output directory (%(default)s)")
    parser.add_argument("--port", type=int, default=0, help="port on this machine (default: a free one)")
    parser.add_argument("--no-browser", action="store_true", help="print the addresses, open no browser")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand, until Ctrl-C."""
    axes = [Path(name) for name in options.files if Path(name).suffix in (".yaml", ".yml")]
    runs = [Path(name) for name in options.files if Path(name) not in axes]
    if len(axes) > 1:
        raise DocumentError(f"{axes[1]}: a workbench has one axis file, and {axes[0]} was given first")
    for path in runs:
        if not shelf.is_recording(path):
            raise DocumentError(f"{path}: neither an axis file (.yaml) nor a recording ({', '.join(shelf.RECORDINGS)})")
        if not path.exists():
            raise DocumentError(f"{path}: no such file")
    for path in axes:
        read_axis(path)
    facts = None if options.drive is None else Path(options.drive).resolve()
    if facts is not None:
        read_facts(facts)
    axis = axes[0].resolve() if axes else None
    sockets = Path(options.sockets).resolve() if options.sockets else None
    given = tuple(path.resolve() for path in runs)
    bench = Workbench(Path(options.out).resolve(), axis, facts, given, sockets, options.fleet)
    try:
        server = WorkbenchServer(bench, options.port)
    except (OSError, OverflowError) as error:
        raise DocumentError(f"--port {options.port}: {error}; give another one, or leave it out") from None
    for number in (signal.SIGTERM, signal.SIGHUP):  # as Ctrl-C: what was started here does not outlive it
        if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup leaves it
            signal.signal(number, signal.default_int_handler)
    server.start()
    try:
        for role in reversed(ROLES):
            print(f"{role:>5}: {server.url(role)}", flush=True)
        print("Ctrl-C ends it", flush=True)
        if not options.no_browser:
            webbrowser.open(server.url(ROLES[-1]))
        server.wait()
    except KeyboardInterrupt:
        return 0
    finally:
        server.close()

"""Read recordings.

fffo-drive log info FILE...       rows, columns with units, metadata, events, and whether the file is complete
fffo-drive log export FILE... --out OUT.csv   rows as CSV or Parquet; with OUT.mcap a part of a recording
fffo-drive log recover IN OUT     write a complete file from an incomplete one (NAME.mcap.part)
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

from ..documents import sentence
from ..recording.export import AROUND_S, around, export
from ..recording.reader import TimeWindow, describe
from ..recording.recover import recover
from .exits import printable
from .progress import progress_bar

INFO = "show rows, columns with units, metadata and events of a recording, and whether it is complete"
EXPORT = "write rows as CSV or Parquet, or a part of a recording; files that follow each other become one"
RECOVER = "write a complete file from an incomplete one"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    info = actions.add_parser("info", help=INFO, description=sentence(INFO))
    info.add_argument("files", metavar="FILE", nargs="+", help="recording (.mcap, .mcap.part)")
    info.add_argument("--check", action="store_true", help="read every row and its checksums, not the index alone")
    info.add_argument("--json", action="store_true", help="print one JSON object, or a list of them")
    table = actions.add_parser("export", help=EXPORT, description=sentence(EXPORT))
    table.add_argument(
        "files", metavar="FILE", nargs="+", help="recordings (.mcap, .mcap.part), in their order in time"
    )
    table.add_argument(
        "--out", metavar="OUT", required=True, help="file to write (.csv, .parquet, .mcap); must not exist"
    )
    table.add_argument("--columns", metavar="NAME,NAME", default="", help="these columns, beside time_s")
    table.add_argument(
        "--from", metavar="S", dest="from_s", type=float, default=0.0, help="from here on, seconds from the first row"
    )
    table.add_argument("--to", metavar="S", dest="to_s", type=float, default=math.inf, help="up to here")
    table.add_argument(
        "--around",
        metavar="TEXT",
        help=f"{AROUND_S:g} s on each side of the first event of the first file that contains this",
    )
    table.add_argument("--json", action="store_true", help="print one JSON object")
    rescue = actions.add_parser("recover", help=RECOVER, description=sentence(RECOVER))
    rescue.add_argument("torn", metavar="IN", help="incomplete recording (NAME.mcap.part)")
    rescue.add_argument("whole", metavar="OUT", help="file to write; must not exist")
    rescue.add_argument("--json", action="store_true", help="print one JSON object")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    return {"recover": _recover, "export": _export, "info": _info}[options.action](options)


def _info(options: argparse.Namespace) -> int:
    described = [describe(file, options.check) for file in options.files]
    if options.json:
        print(json.dumps(described[0] if len(described) == 1 else described, indent=2))
        return 0
    for entry in described:
        _print(entry)
    return 0


def _print(entry: dict[str, Any]) -> None:
    state = "complete" if entry["complete"] else f"TORN: {entry['reason']}"
    rate = f", {1.0 / entry['period_s']:.6g} Hz" if entry["period_s"] else ""
    print(printable(f"{entry['file']}: {entry['rows']} rows, {entry['duration_s']:.3f} s{rate}, {state}"))
    for title in ("metadata", "summary"):
        for key, value in entry[title].items():
            print(printable(f"  {key}: {value}"))
    for name, attachment in entry["attachments"].items():
        print(printable(f"  attachment {name}: {attachment['bytes']} bytes"))
    for event in entry["events"]:
        print(printable(f"  event {event}"))
    for record in entry["records"]:
        number = f" {record['number']}" if record["number"] else ""
        print(printable(f"  record {record['sequence']}: {record['kind']}{number}"))
    columns = ", ".join(name if unit == "-" else f"{name} [{unit}]" for name, unit in entry["columns"].items())
    print(printable(f"  columns: {columns}"))


def _export(options: argparse.Namespace) -> int:
    paths = [Path(file) for file in options.files]
    window = TimeWindow(options.from_s, options.to_s)
    if options.around is not None:
        if window != TimeWindow():
            raise SystemExit("fffo-drive log export: --around sets the window: leave out --from and --to")
        window, event = around(paths[0], options.around)
        print(printable(f"around {event.time} {event.source}: {event.text}"), file=sys.stderr)
    columns = [name.strip() for name in options.columns.split(",") if name.strip()]
    with progress_bar("export", options.json) as bar:
        done = export(paths, Path(options.out), columns, window, bar or (lambda share: None))
    for reason in done.incomplete:
        print(f"warning: {printable(reason)}", file=sys.stderr)
    if options.json:
        print(json.dumps({**done._asdict(), "path": str(done.path)}, indent=2))
    else:
        print(f"{done.path}: {done.rows} rows, {len(done.columns) + 1} columns")
    return 0


def _recover(options: argparse.Namespace) -> int:
    report = recover(Path(options.torn), Path(options.whole))
    if options.json:
        print(json.dumps({key: str(v) if isinstance(v, Path) else v for key, v in report._asdict().items()}, indent=2))
        return 0
    reason = "the file was complete" if report.was_complete else report.reason
    print(f"{report.path_out}: {report.rows} rows in {report.messages} messages; {reason}; ", end="")
    print(f"{report.bytes_discarded} of {report.bytes_in} bytes discarded")
    return 0

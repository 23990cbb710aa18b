"""Read recordings.

fffo-drive log info FILE...       rows, columns with units, metadata, events, and whether the file is complete
fffo-drive log recover IN OUT     write a complete file from an incomplete one (NAME.mcap.part)
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from ..documents import sentence
from ..recording.reader import read_run
from ..recording.recover import recover

INFO = "show rows, columns with units, metadata and events of a recording, and whether it is complete"
RECOVER = "write a complete file from an incomplete one"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    info = actions.add_parser("info", help=INFO, description=sentence(INFO))
    info.add_argument("files", metavar="FILE", nargs="+", help="recording (.mcap, .mcap.part)")
    info.add_argument("--json", action="store_true", help="print one JSON object, or a list of them")
    rescue = actions.add_parser("recover", help=RECOVER, description=sentence(RECOVER))
    rescue.add_argument("torn", metavar="IN", help="incomplete recording (NAME.mcap.part)")
    rescue.add_argument("whole", metavar="OUT", help="file to write; must not exist")
    rescue.add_argument("--json", action="store_true", help="print one JSON object")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    return _recover(options) if options.action == "recover" else _info(options)


def _info(options: argparse.Namespace) -> int:
    described = [read_run(file).describe() for file in options.files]
    if options.json:
        print(json.dumps(described[0] if len(described) == 1 else described, indent=2))
        return 0
    for entry in described:
        _print(entry)
    return 0


def _print(entry: dict[str, Any]) -> None:
    state = "complete" if entry["complete"] else f"TORN: {entry['reason']}"
    rate = f", {1.0 / entry['period_s']:.6g} Hz" if entry["period_s"] else ""
    print(f"{entry['file']}: {entry['rows']} rows, {entry['duration_s']:.3f} s{rate}, {state}")
    for title in ("metadata", "summary"):
        for key, value in entry[title].items():
            print(f"  {key}: {value}")
    for name, attachment in entry["attachments"].items():
        print(f"  attachment {name}: {attachment['bytes']} bytes")
    for event in entry["events"]:
        print(f"  event {event}")
    for record in entry["records"]:
        number = f" {record['number']}" if record["number"] else ""
        print(f"  record {record['sequence']}: {record['kind']}{number}")
    columns = ", ".join(name if unit == "-" else f"{name} [{unit}]" for name, unit in entry["columns"].items())
    print(f"  columns: {columns}")


def _recover(options: argparse.Namespace) -> int:
    report = recover(Path(options.torn), Path(options.whole))
    if options.json:
        print(json.dumps({key: str(v) if isinstance(v, Path) else v for key, v in report._asdict().items()}, indent=2))
        return 0
    reason = "the file was complete" if report.was_complete else report.reason
    print(f"{report.path_out}: {report.rows} rows in {report.messages} messages; {reason}; ", end="")
    print(f"{report.bytes_discarded} of {report.bytes_in} bytes discarded")
    return 0

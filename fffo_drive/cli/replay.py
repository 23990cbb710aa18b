"""Run recordings through the control law and the envelope again, and compare.

Without --with, replay uses the parameters, effects and limits of the recording, each where it was in force. Every term
and command must be the same, bit for bit (exit code 1 if not). With --with FILE, an axis file or a model file, that
law is run on the recorded feedback and compared with the recording.

Several files are replayed as one, in the order given; the continuations of a rotated file are included. A recording of
an older version, which does not name its parameters, is replayed with the axis file and the model in it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from pathlib import Path

from ..evaluation.replay_runs import ReplayReport
from ..workflows.replay import replay_files, with_continuations
from .exits import EXIT_REFUSED


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("runs", metavar="RUN", nargs="+", help="recordings (.mcap) in the order they were written")
    parser.add_argument("--with", dest="other", metavar="FILE", help="axis or model file to compare with the recording")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    files = with_continuations(Path(run) for run in options.runs)
    report = replay_files(files, options.other)
    if options.json:
        print(json.dumps(as_json(report, files), indent=2))
    else:
        print("\n".join(sentences(files, report, options.other)))
    return 0 if report.exact or options.other else EXIT_REFUSED


def as_json(report: ReplayReport, files: Iterable[Path]) -> dict[str, object]:
    """For --json."""
    return {
        "files": [str(file) for file in files],
        "exact": report.exact,
        **report._asdict(),
        "blocks": [used._asdict() for used in report.blocks],
        "profiles": report.profiles._asdict(),
        "live": report.live._asdict(),
    }


def sentences(files: list[Path], report: ReplayReport, other: str | None) -> list[str]:
    """For people."""
    name = str(files[0]) if len(files) == 1 else f"{files[0]} and {len(files) - 1} more"
    lines = [f"{name}: {_outcome(report, other)}"]
    if other is None and report.names_blocks:
        lines += [
            f"  parameters {used.parameters}, effects {used.effects}, model {used.model[:12] or 'not named'}: "
            f"{used.rows} rows"
            for used in report.blocks
        ]
        whole = report.profiles
        if whole.as_asked or whole.other:
            said = f", {whole.other} with other samples than commanded" if whole.other else ""
            lines.append(f"  complete profiles: {whole.as_asked} as commanded{said}")
        live = report.live
        if any(live):
            said = f", {live.other} with a different one" if live.other else ""
            said += f", {live.not_followed} not followed" if live.not_followed else ""
            lines.append(f"  rows with live set points: {live.as_asked} with the same reference{said}")
    if report.not_replayed:
        lines.append(
            f"  {report.not_replayed} rows not replayed: the recording lacks the beginning of that motion or rows of it"
        )
    lines += [f"  torn: {reason}" for reason in report.torn]
    if not report.names_blocks:
        lines.append("  a recording of an older version: the axis file and the model in it were used for all its rows")
    return lines


def _outcome(report: ReplayReport, other: str | None) -> str:
    if other is not None:
        found = f"; its envelope finds a fault elsewhere ({report.first_trip})" if report.trips_elsewhere else ""
        return (
            f"{report.rows} rows; {other} requests a current that differs from the recorded one by "
            f"{report.rms_difference_a:.4g} A (rms), at most {report.largest_difference_a:.4g} A; the command "
            "differs by "
            f"{report.rms_command_difference_a:.4g} A (rms){found}"
        )
    if report.all_identical == report.all_rows and report.rows:
        return (
            f"{report.rows} rows, every term and command reproduced bit for bit "
            f"({report.all_rows} rows including standstill)"
        )
    if not report.rows:
        return "no row with the law active could be replayed"
    return (
        f"{report.all_identical} of {report.all_rows} rows reproduced, first difference at tick "
        f"{report.first_difference_tick} ({report.first_difference}), at most {report.largest_difference_a:.3g} A"
    )

"""Put a recorded run through the law again.

Without --with, the axis file and model in the recording are used, and every term and command must come out the same,
bit for bit (exit code 1 when not). With --with AXIS, that file's law is run on the recorded feedback and compared.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from ..config.axis import AxisFile, controller_config, envelope_config, model_of, read_axis
from ..config.effects import compensation_table
from ..documents import DocumentError
from ..evaluation.replay import ReplayReport, replay
from ..model.parameters import ModelFile
from ..recording.reader import Run, read_run

EXIT_DIFFERENT = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("run", metavar="RUN", help="recording (.mcap)")
    parser.add_argument(
        "--with", dest="other", metavar="AXIS", help="axis file whose law is compared with the recorded one"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    run = read_run(options.run)
    if options.other:
        axis = read_axis(options.other)
        model = model_of(options.other, axis)
    else:
        axis, model = recorded_files(run)
    report = replay(run.rows, controller_config(axis, model), envelope_config(axis), compensation_table(axis, model))
    if options.json:
        print(json.dumps({**report._asdict(), "replayed": None, "exact": report.exact}, indent=2))
    else:
        print(_sentence(options.run, report, bool(options.other)))
    return 0 if report.exact or options.other else EXIT_DIFFERENT


def recorded_files(run: Run) -> tuple[AxisFile, ModelFile]:
    """The axis file and the model that a recording carries. Raises DocumentError when they are not there."""
    with tempfile.TemporaryDirectory() as directory:
        for attachment in run.attachments.values():
            (Path(directory) / Path(attachment.name).name).write_bytes(attachment.data)
        for name in run.attachments:
            path = Path(directory) / Path(name).name
            if b"fffo_drive/axis/" in path.read_bytes():
                axis = read_axis(path)
                flat = axis.model_copy(update={"model": Path(axis.model).name})
                return axis, model_of(path, flat)
    raise DocumentError(f"{run.path}: holds no axis file; name one with --with")


def _sentence(name: str, report: ReplayReport, other: bool) -> str:
    if other:
        return (
            f"{name}: {report.rows} rows; the other law asks for {report.rms_difference_a:.4g} A (rms), at most "
            f"{report.largest_difference_a:.4g} A, beside the recorded current"
        )
    if report.exact:
        return f"{name}: {report.rows} rows, every term and command reproduced bit for bit"
    return (
        f"{name}: {report.identical} of {report.rows} rows reproduced, first difference at tick "
        f"{report.first_difference_tick}, at most {report.largest_difference_a:.3g} A"
    )

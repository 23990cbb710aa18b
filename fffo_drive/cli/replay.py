"""Put recorded runs through the law and the envelope again.

Without --with, the blocks, effects and limits in the recording are used, each where it was in force, and every term and
command must come out the same, bit for bit (exit code 1 when not). With --with FILE, an axis file or a model file, that
law is run on the recorded feedback and compared.

Several files are replayed as one, in the order given; a file that was continued after rotation brings its continuations
along. A recording of an older version, which does not name its blocks, is replayed with the axis file and the model
that it carries.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ..config.axis import AxisFile, controller_config, envelope_config, model_of, read_axis
from ..config.effects import compensation_table
from ..control.controller import pack_controller
from ..documents import DocumentError
from ..evaluation.replay_runs import Law, Replayer, ReplayReport, session_id
from ..model.parameters import ModelFile, read_model
from ..recording.reader import Run, read_metadata, read_run

EXIT_DIFFERENT = 1
MODEL_FORMAT = "fffo_drive/model/"
AXIS_FORMAT = b"fffo_drive/axis/"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("runs", metavar="RUN", nargs="+", help="recordings (.mcap) in the order they were written")
    parser.add_argument(
        "--with", dest="other", metavar="FILE", help="axis or model file whose law is compared with the recorded one"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    files = with_continuations(Path(run) for run in options.runs)
    report = replay_files(files, options.other)
    if options.json:
        print(json.dumps(as_json(report, files), indent=2))
    else:
        print("\n".join(sentences(files, report, options.other)))
    return 0 if report.exact or options.other else EXIT_DIFFERENT


def replay_files(files: Iterable[Path], other: str | None = None) -> ReplayReport:
    """Replay recordings, one after the other. `other`: an axis or a model file. Raises DocumentError."""
    replayer: Replayer | None = None
    for file in files:
        run = read_run(file)
        if replayer is None:
            replayer = Replayer(None if other is None else _other_law(other, run))
        fallback = None
        if session_id(run.records) is None and other is None:
            fallback = _law_of(*recorded_files(run))
        try:
            replayer.take(run.rows, run.records, fallback)
        except KeyError as error:
            raise DocumentError(f"{file}: a record in it has no {error}: it cannot be replayed here") from None
        except ValueError as error:
            raise DocumentError(f"{file}: {error}; replay it with the version that wrote it") from None
    assert replayer is not None
    return replayer.report


def with_continuations(files: Iterable[Path]) -> list[Path]:
    """Each file with those beside it that continue it, unless they are given themselves."""
    given = list(files)
    found: list[Path] = []
    for file in given:
        found.append(file)
        found += [other for other in _continuations(file) if other not in given]
    return found


def _continuations(file: Path) -> Iterator[Path]:
    """NAME_002.mcap, NAME_003.mcap ... that say that they continue this file, also one that is being written."""
    stem = file.name.removesuffix(".part").removesuffix(".mcap")
    for other in sorted((*file.parent.glob(f"{stem}_[0-9]*.mcap"), *file.parent.glob(f"{stem}_[0-9]*.mcap.part"))):
        if other != file and read_metadata(other).get("continues") == f"{stem}.mcap":
            yield other


def _law_of(axis: AxisFile, model: ModelFile) -> Law:
    return Law(
        np.array(pack_controller(controller_config(axis, model))),
        compensation_table(axis, model),
        envelope_config(axis),
    )


def _other_law(file: str, run: Run) -> Law:
    """The law of an axis file; of a model file, with the axis file in the recording."""
    try:
        is_model = MODEL_FORMAT in Path(file).read_text(encoding="utf-8", errors="replace")
    except OSError:
        is_model = False  # reading it as an axis file says what is wrong
    if is_model:
        return _law_of(recorded_files(run)[0], read_model(file))
    axis = read_axis(file)
    return _law_of(axis, model_of(file, axis))


def recorded_files(run: Run) -> tuple[AxisFile, ModelFile]:
    """The axis file and the model that a recording carries. Raises DocumentError when they are not there."""
    with tempfile.TemporaryDirectory() as directory:
        for attachment in run.attachments.values():
            (Path(directory) / Path(attachment.name).name).write_bytes(attachment.data)
        for name in run.attachments:
            path = Path(directory) / Path(name).name
            if AXIS_FORMAT in path.read_bytes():
                axis = read_axis(path)
                flat = axis.model_copy(update={"model": Path(axis.model).name})
                return axis, model_of(path, flat)
    raise DocumentError(f"{run.path}: holds no axis file; name one with --with")


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
            said = f", {whole.other} with samples other than asked for" if whole.other else ""
            lines.append(f"  profiles that ran from end to end: {whole.as_asked} as asked for{said}")
        live = report.live
        if any(live):
            said = f", {live.other} with another one" if live.other else ""
            said += f", {live.not_followed} not followed" if live.not_followed else ""
            lines.append(f"  rows by live set points: {live.as_asked} with the reference made again{said}")
    if report.not_replayed:
        lines.append(
            f"  {report.not_replayed} rows not replayed: the recording does not hold the begin of that motion, "
            "or rows of it are missing"
        )
    if not report.names_blocks:
        lines.append("  a recording of an older version: the axis file and the model in it were used for all its rows")
    return lines


def _outcome(report: ReplayReport, other: str | None) -> str:
    if other is not None:
        found = f"; its envelope finds a fault elsewhere ({report.first_trip})" if report.trips_elsewhere else ""
        return (
            f"{report.rows} rows; {other} asks for {report.rms_difference_a:.4g} A (rms), at most "
            f"{report.largest_difference_a:.4g} A, beside the recorded current, and commands "
            f"{report.rms_command_difference_a:.4g} A (rms) beside it{found}"
        )
    if report.all_identical == report.all_rows and report.rows:
        return (
            f"{report.rows} rows, every term and command reproduced bit for bit ({report.all_rows} with those at rest)"
        )
    if not report.rows:
        return "no row in which the law acted could be replayed"
    return (
        f"{report.all_identical} of {report.all_rows} rows reproduced, first difference at tick "
        f"{report.first_difference_tick} ({report.first_difference}), at most {report.largest_difference_a:.3g} A"
    )

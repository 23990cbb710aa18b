"""Replay of recordings through law and envelope: with the parameters that were in force, or with another law."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ..config.axis import AxisFile, controller_config, envelope_config, model_of, read_axis
from ..config.effects import compensation_table
from ..control.controller import pack_controller
from ..control.own_law import ControlLaw
from ..documents import DocumentError
from ..evaluation.replay_runs import ReplayedLaw, Replayer, ReplayReport, session_id
from ..model.parameters import ModelFile, read_model
from ..recording.reader import RowBlocks, Run, groups, read_metadata, read_run, read_without_rows
from ..recording.rotation import CONTINUES, SUFFIX, later_segments, run_name

MODEL_FORMAT = "fffo_drive/model/"
AXIS_FORMAT = b"fffo_drive/axis/"


def replay_files(files: Iterable[Path], other: str | None = None, controller: ControlLaw | None = None) -> ReplayReport:
    """Replay recordings, one after the other. `other`: an axis or a model file. Raises DocumentError.

    `controller`: that of a user's own with which they were made.
    """
    replayer: Replayer | None = None
    torn: list[str] = []
    for file in files:
        run = read_without_rows(file)  # its records name what the rows refer to by number
        torn += [run.reason] if run.reason else []
        if replayer is None:
            replayer = Replayer(None if other is None else _other_law(other, run), controller)
        named = session_id(run.records) is not None
        fallback = None if named or other is not None else _law_of(*recorded_files(run))
        try:
            if named and "row_number" in (run.rows.dtype.names or ()):
                for rows, _ in groups(RowBlocks(file)):
                    replayer.take(rows, run.records)
            else:  # of an older version: only all rows together have a beginning
                replayer.take(read_run(file).rows, run.records, fallback)
        except KeyError as error:
            raise DocumentError(f"{file}: a record in it has no {error}: it cannot be replayed here") from None
        except ValueError as error:
            raise DocumentError(f"{file}: {error}; replay it with the version that wrote it") from None
    if replayer is None:
        raise DocumentError("no recording is given: there is nothing to replay")
    return replayer.report._replace(torn=tuple(torn))


def with_continuations(files: Iterable[Path]) -> list[Path]:
    """Each file with the files beside it that continue it, unless those are given too."""
    given = list(files)
    found: list[Path] = []
    for file in given:
        found.append(file)
        found += [other for other in _continuations(file) if other not in given]
    return found


def _continuations(file: Path) -> Iterator[Path]:
    """NAME_002.mcap, NAME_003.mcap ... that continue this file by their metadata; also one that is being written."""
    for other in later_segments(file):
        if read_metadata(other).get(CONTINUES) == f"{run_name(file)}{SUFFIX}":
            yield other


def _law_of(axis: AxisFile, model: ModelFile) -> ReplayedLaw:
    return ReplayedLaw(
        np.array(pack_controller(controller_config(axis, model))),
        compensation_table(axis, model),
        envelope_config(axis),
    )


def _other_law(file: str, run: Run) -> ReplayedLaw:
    """The law of an axis file; of a model file, with the axis file in the recording."""
    try:
        is_model = MODEL_FORMAT in Path(file).read_text(encoding="utf-8", errors="replace")
    except OSError:
        is_model = False  # reading it as an axis file reports the error
    if is_model:
        return _law_of(recorded_files(run)[0], read_model(file))
    axis = read_axis(file)
    return _law_of(axis, model_of(file, axis))


def recorded_files(run: Run) -> tuple[AxisFile, ModelFile]:
    """The axis file and the model in a recording. Raises DocumentError if it has none.

    The axis file is the one that says so; in a recording of a run, else the first. Its model follows it.
    """
    with tempfile.TemporaryDirectory() as directory:
        paths = [Path(directory) / Path(name).name for name in run.attachments]
        for path, attachment in zip(paths, run.attachments.values(), strict=True):
            path.write_bytes(attachment.data)
        first = paths[0] if paths and "axis" in run.metadata else None
        chosen = next((path for path in paths if AXIS_FORMAT in path.read_bytes()), first)
        if chosen is not None:
            axis = read_axis(chosen)
            following = [path.name for path in paths[paths.index(chosen) + 1 :]]
            flat = axis.model_copy(update={"model": (following or [Path(axis.model).name])[0]})
            return axis, model_of(chosen, flat)
    raise DocumentError(run.lacks("contains no axis file; give one with --with"))

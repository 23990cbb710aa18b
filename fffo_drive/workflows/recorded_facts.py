"""The facts of an axis: from a file, or from the recordings, which contain them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .. import formats
from ..config.axis import AxisFile
from ..config.drive_section import CanopenDriveSection, SimulatedDriveSection
from ..documents import DocumentError, check, did_you_mean, parse, refuse
from ..identification.facts import DriveFacts, read_facts
from ..importing.candidates import Hints
from ..importing.convert import FACTS_NAME
from ..importing.log import saying_how_to_import
from ..importing.read import RECORDINGS, read_source
from ..model.parameters import ModelFile
from ..recording.errors import RecordingError
from ..recording.reader import Run, read_without_rows
from .replay import recorded_files

SIMULATED_RESOLVER_BITS = 15


def facts_for(file: str | None, logs: Sequence[str | Path]) -> DriveFacts:
    """The facts in `file`, else those in the recordings.

    Raises DocumentError for a log without facts, for recordings of different axes, and for `columns` that a log does
    not have; RecordingError for a file that is no log.
    """
    if file is not None:
        given = read_facts(file)
        refuse(file, [problem for log in logs for problem in _columns_not_in(log, given)])
        return given
    found: DriveFacts | None = None
    for log in logs:
        if not str(log).endswith(RECORDINGS):
            with saying_how_to_import(Path(log), Hints()):
                read_source(log, rows=False)
            raise DocumentError(
                f"{log}: a table has no facts about its drive: give them with --drive FILE, or convert the log with "
                "`fffo-drive import`"
            )
        own = facts_in(read_without_rows(log))
        if found is not None and own.model_copy(update={"name": found.name}) != found:
            raise DocumentError(f"{log}: its facts are not those of {logs[0]}: give logs of one axis")
        found = own
    assert found is not None
    return found


def _columns_not_in(log: str | Path, facts: DriveFacts) -> list[tuple[str, str]]:
    """(key, what is wrong) of `columns` that name none of a table. An unreadable log is reported by its reader."""
    declared = facts.hints().columns
    if not declared or str(log).endswith(RECORDINGS):
        return []
    try:
        source = read_source(log, rows=False)
    except (RecordingError, OSError):
        return []
    return [
        (f"columns.{one.signal}", f"{log} has no column {one.column!r}: {did_you_mean(one.column, source.columns)}")
        for one in declared
        if one.column not in source.columns and one.column not in source.left
    ]


def facts_in(run: Run) -> DriveFacts:
    """Facts in a recording: those of an import, or from the axis file and the model of a run."""
    attached = run.attachments.get(FACTS_NAME)
    if attached is not None:
        name = f"{run.path}, {FACTS_NAME}"
        data, lines = parse(attached.data.decode("utf-8", "replace"), name)
        return check(data, DriveFacts, name, lines)
    try:
        axis, model = recorded_files(run)
    except DocumentError as error:
        raise DocumentError(run.lacks("has no facts about its drive: give them with --drive FILE")) from error
    return DriveFacts.model_validate(facts_of_axis(axis, model))


def facts_of_axis(axis: AxisFile, model: ModelFile, absolute_angle: bool | None = None) -> dict[str, Any]:
    """What an axis file declares about the drive. In process the angle is the same in every run."""
    section = axis.drive
    on_bus = isinstance(section, CanopenDriveSection)
    return {
        "format": formats.FACTS.word,
        "name": axis.name,
        "torque_constant_nm_per_a": model.torque_constant_nm_per_a,
        **_resolution(section),
        "absolute_angle": not on_bus if absolute_angle is None else absolute_angle,
    }


def _resolution(section: SimulatedDriveSection | CanopenDriveSection) -> dict[str, Any]:
    """The sensor's, as facts have it."""
    counts = section.counts if isinstance(section, CanopenDriveSection) else 1 << SIMULATED_RESOLVER_BITS
    bits = counts.bit_length() - 1
    return {"resolver_bits": bits} if counts == 1 << bits and bits >= 8 else {"position_lsb_rev": 1.0 / counts}

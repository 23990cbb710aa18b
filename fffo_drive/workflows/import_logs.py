"""Logs of other programs into recordings: columns recognised or given; facts of the axis; what the data can show."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import yaml
from pydantic import Field

from ..documents import DocumentError, StrictRecord, check, did_you_mean, parse, read_text, refuse
from ..identification.coverage import Coverage, coverage_of
from ..identification.cyclic import CyclicError, cyclic_error
from ..identification.dataset import DataError, distinct_names, load_record, one_rate, record_of_columns
from ..identification.facts import DriveFacts, facts_of, facts_text
from ..importing.candidates import POSITION_REV, RECOGNISED, VELOCITY_RPS, Guess, Hints, Recognition
from ..importing.convert import FACTS_NAME, Converted, assumed, converted, write_recording
from ..importing.joints import chosen, dataset_files, episodes_of
from ..importing.read import read_source, short_name
from ..importing.recognise import recognise
from ..importing.source import Source, TraceDrive
from ..importing.times import runs_of
from ..importing.units import UNITS, unit_of
from ..recording.errors import RecordingError
from .trace_drive import SCALES

MAP_NAME = "map.yaml"
PICTURE_NAME = "data.png"
COLUMNS_NAME = "columns.png"


class ImportMap(StrictRecord):
    """Columns and units of the logs of an axis, as an import writes them for the next one."""

    roles: Annotated[dict[str, str | None], Field(description="signal: column; empty: none")] = Field(
        default_factory=dict
    )
    units: Annotated[dict[str, str], Field(description="column: unit")] = Field(default_factory=dict)
    rate_hz: Annotated[float | None, Field(gt=0, description="where no column is the time")] = None
    counts_per_turn: Annotated[float | None, Field(gt=0, description="of a position in counts")] = None
    linear: Annotated[bool, Field(description="m and N instead of rev and Nm")] = False
    eds: Annotated[list[str], Field(description="of the drive in a trace of a CAN bus: files, from here; profiles")] = (
        Field(default_factory=list)
    )
    node: Annotated[str | None, Field(description="of the drive: [CHANNEL:]ID")] = None
    scales: Annotated[dict[str, float], Field(description="of the drive, as in a drive section")] = Field(
        default_factory=dict
    )
    joint: Annotated[str | None, Field(description="of a robot's log: name, number or all")] = None
    facts: Annotated[dict[str, Any], Field(description="of the axis, as `facts.yaml`")] = Field(default_factory=dict)


class RecognisedLog(NamedTuple):
    """A log of another program, the recognised columns, and the signals in this project's units."""

    source: Source
    found: Recognition
    log: Converted


class Imported(NamedTuple):
    """Recordings of one axis, and the checks that an identification makes before it begins."""

    recordings: list[Path]
    columns_picture: Path
    data_picture: Path
    problems: list[str]  # why a recording cannot be fitted
    warnings: list[str]
    coverage: Coverage | None  # None where no recording can be fitted
    cyclic: CyclicError | None  # of the position sensor; None where there is none, or it cannot be seen


def recognised(source: Source, hints: Hints) -> RecognisedLog:
    """Recognise the columns of a log, given the user's hints. Raises RecordingError, also for rows that do not fit."""
    found = recognise(source, hints)
    return RecognisedLog(source, found, usable(str(source.path), converted(source, found, hints.drop), found))


def usable(name: str, log: Converted, found: Recognition) -> Converted:
    """The log without its velocity, where that keeps it from a fit and the position does not."""
    if VELOCITY_RPS not in log.columns or POSITION_REV not in log.columns:
        return log
    facts = facts_of({}, found.linear)
    try:
        record_of_columns(name, log.columns, facts)
    except DataError as error:
        rest = {key: values for key, values in log.columns.items() if key != VELOCITY_RPS}
        try:
            record_of_columns(name, rest, facts)
        except DataError:
            return log
        reason = str(error).removeprefix(f"{name}: ")
        return log._replace(
            columns=rest,
            remarks=(*log.remarks, f"the velocity is left out, it contradicts the position: {reason}"),
        )
    return log


def _recognised_runs(runs: Sequence[Source], hints: Hints) -> list[RecognisedLog]:
    """The runs of one file, which have one meaning: that of the longest."""
    longest = max(runs, key=lambda run: run.rows)
    first = recognised(longest, hints)
    if len(runs) == 1:
        return [first]
    known = _meaning_of(first.found, hints)
    return [first if run is longest else _as_unsure(recognised(run, known), first.found) for run in runs]


def _meaning_of(found: Recognition, hints: Hints) -> Hints:
    """What was recognised in one run, for the others."""
    roles = dict.fromkeys(RECOGNISED, "") | {guess.signal: guess.column for guess in found.guesses}
    place = found.of("position_rev")
    return replace(
        hints,
        roles={**roles, **hints.roles},
        units={g.column: g.unit for g in found.guesses if g.unit in UNITS} | dict(hints.units),
        rate_hz=hints.rate_hz or (1.0 / found.period_s if found.period_s else None),
        counts_per_turn=1.0 / abs(place.factor) if place and place.unit == "counts" else hints.counts_per_turn,
        linear=found.linear,
    )


def _as_unsure(one: RecognisedLog, first: Recognition) -> RecognisedLog:
    """A run with the assumptions of another one of its file, whose columns and units it was given."""
    open_ones = {guess.signal: guess for guess in first.guesses if not guess.sure}
    guesses = tuple(
        guess._replace(sure=False, evidence=open_ones[guess.signal].evidence) if guess.signal in open_ones else guess
        for guess in one.found.guesses
    )
    return one._replace(found=one.found._replace(guesses=guesses))


def recognised_logs(
    paths: Sequence[str | Path], hints: Hints, map_file: Path | None = None
) -> list[RecognisedLog]:  # fmt: skip
    """Logs of one axis, read and recognised. `map_file`: that `hints` are of.

    Raises RecordingError that names the file and the option to give, DocumentError for columns of the map that a log
    does not have.
    """
    read = [source for path in paths for source in _read(Path(path), hints)]
    found: list[RecognisedLog] = []
    for sources in chosen(read, hints.joint).values():
        if map_file is not None:
            refuse(map_file, [problem for source in sources for problem in _not_in(source, hints, read_map(map_file))])
        whole = [source for source in sources if not source.of_dataset]
        found += [one for source in whole for one in _recognised_runs(runs_of(source, hints), hints)]
        episodes = [source for source in sources if source.of_dataset]
        found += _recognised_episodes(episodes, hints) if episodes else []
    return found


def _read(path: Path, hints: Hints) -> list[Source]:
    """A log; the episodes of a LeRobot dataset, or of one of its files."""
    if not path.is_dir():
        source = read_source(path, hints.drive)
        parts = episodes_of(source)
        return [replace(part, of_dataset=True) for part in parts] if len(parts) > 1 else parts
    files = dataset_files(path)
    return [replace(part, of_dataset=True) for file in files for part in episodes_of(read_source(file, hints.drive))]


def _recognised_episodes(episodes: Sequence[Source], hints: Hints) -> list[RecognisedLog]:
    """The episodes of one joint, which have one meaning; one in which it does not move is left out and named."""
    longest = max(episodes, key=lambda run: run.rows)
    first = recognised(longest, hints)
    known = _meaning_of(first.found, hints)
    found: list[RecognisedLog] = []
    left: list[str] = []
    for one in episodes:
        try:
            found.append(first if one is longest else _as_unsure(recognised(one, known), first.found))
        except RecordingError as error:
            left.append(str(error))
    if left:
        told = f"{len(left)} of {len(episodes)} episodes are left out, the first: {left[0]}"
        head = found[0]
        found[0] = head._replace(log=head.log._replace(remarks=(*head.log.remarks, told)))
    return found


def _not_in(source: Source, hints: Hints, mapping: ImportMap) -> list[tuple[str, str]]:
    """(key, what is wrong) of the columns that a map names and a log does not have, where nobody said otherwise."""
    roles = {key: name for key, name in mapping.roles.items() if name and hints.roles.get(key) == name}
    named = [(f"roles.{key}", name) for key, name in roles.items()]
    named += [(f"units.{name}", name) for name in mapping.units if name not in roles.values()]
    return [
        (key, f"{source.path} has no column {name!r}: {did_you_mean(name, source.columns)}")
        for key, name in named
        if name not in source.columns
    ]


def assumptions(logs: Sequence[RecognisedLog]) -> list[Guess]:
    """Assumptions that names, units and data leave open, over all logs, each once."""
    found = {(g.signal, g.column, g.unit): g for one in logs for g in one.found.guesses if not g.sure}
    return list(found.values())


def read_map(path: Path) -> ImportMap:
    """The map of columns that an earlier import wrote. Raises DocumentError."""
    data, lines = parse(read_text(path), str(path))
    if not isinstance(data, dict):
        raise DocumentError(f"{path}: not a map of columns: give the {MAP_NAME} of an import")
    found = check(data, ImportMap, str(path), lines)
    signals = [key for key in found.roles if key not in RECOGNISED]
    problems = [(f"roles.{key}", f"no signal {key!r}: {did_you_mean(key, RECOGNISED)}") for key in signals]
    units = {column: unit for column, unit in found.units.items() if unit_of(unit) is None}
    problems += [
        (f"units.{name}", f"unknown unit {unit!r}: {did_you_mean(unit, UNITS)}") for name, unit in units.items()
    ]
    problems += [(f"scales.{key}", did_you_mean(key, SCALES)) for key in found.scales if key not in SCALES]
    refuse(path, problems)
    beside = [str(path.parent / name) if (path.parent / name).is_file() else name for name in found.eds]
    return found.model_copy(update={"eds": beside})


def known_units(units: dict[str, str]) -> dict[str, str]:
    """Units of columns, spelled as this project does. Raises RecordingError for an unknown one."""
    known = {}
    for column, given in units.items():
        unit = unit_of(str(given))
        if unit is None:
            raise RecordingError(f"unit {given!r} of column {column!r}: {did_you_mean(str(given), UNITS)}")
        known[column] = unit
    return known


def write_import(logs: Sequence[RecognisedLog], hints: Hints, declared: dict[str, Any], out: Path) -> Imported:
    """Write DIR/NAME.mcap of each log, the facts, the map and two pictures. Raises RecordingError.

    `declared`: facts of the axis (identification.facts). Logs of two axes, and files that are there already, are
    errors.
    """
    found = logs[0].found
    if any(one.found.linear != found.linear or one.found.torque_unit != found.torque_unit for one in logs):
        raise RecordingError(
            "the logs are from different axes: their inputs have different units; import them one by one"
        )
    facts = facts_of(declared, found.linear)
    out.mkdir(parents=True, exist_ok=True)
    names = distinct_names([_plain_name(one.source) for one in logs])
    paths = [out / f"{name.replace('/', '_')}.mcap" for name in names]
    taken = next((path for path in paths if path.exists()), None)
    if taken is not None:
        raise RecordingError(f"{taken}: exists already and is not overwritten: give another --out")
    for one, path in zip(logs, paths, strict=True):
        write_recording(path, one.source.path, one.log, facts_text(facts), found.linear, assumed(one.found))
    (out / FACTS_NAME).write_text(facts_text(facts), encoding="utf-8")
    _draw_columns(out / COLUMNS_NAME, logs[0])
    (out / MAP_NAME).write_text(yaml.safe_dump(_map(hints, found, declared, out), sort_keys=False), encoding="utf-8")
    done = _checked(paths, facts, out)
    if found.torque_unit in ("Nm", "N") and facts.torque_constant_nm_per_a != 1.0:
        done.warnings.append(
            f"the input is in {found.torque_unit} already and is multiplied by the torque constant of "
            f"{facts.torque_constant_nm_per_a:g} as well: leave the constant out, or give the input's unit"
        )
    return done


def _draw_columns(path: Path, one: RecognisedLog) -> None:
    from ..report.columns import column_figures
    from ..report.static import write_overview  # loads slowly

    rows = column_figures(one.found.guesses, one.log.columns, one.found.torque_unit, one.found.linear)
    write_overview(rows, [path])


def _plain_name(source: Source) -> Path:
    """The path, with the joint and the number of the run where the file holds several."""
    path = source.path
    if not source.joint and not source.run:
        return path
    parts = [short_name(path), source.joint, f"run{source.run}" if source.run else ""]
    return path.with_name("_".join(filter(None, parts)).replace("/", "."))


def _map(hints: Hints, found: Recognition, declared: dict[str, Any], out: Path) -> dict[str, Any]:
    """What was recognised, as `read_map` takes it; names of files as they are from the directory `out`."""
    drive = hints.drive or TraceDrive()
    files = [os.path.relpath(name, out) if Path(name).is_file() else name for name in drive.files]
    scales = {key: value for key, value in drive.scales.items() if key != SCALES[0]}  # that is `counts_per_turn`
    of_trace = {"eds": files, "node": drive.node, "scales": scales, "joint": hints.joint}
    return {
        "roles": {signal: "" for signal, column in hints.roles.items() if not column}
        | {guess.signal: guess.column for guess in found.guesses},
        "units": {guess.column: guess.unit for guess in found.guesses if guess.unit in UNITS},
        "rate_hz": None if found.period_s is None else 1.0 / found.period_s,
        "counts_per_turn": hints.counts_per_turn,
        "linear": found.linear,
        **{key: value for key, value in of_trace.items() if value},
        "facts": declared,
    }


def _checked(paths: list[Path], facts: DriveFacts, out: Path) -> Imported:
    """Checks before an identification, what the recordings can show, and the error of their position sensor."""
    problems: list[str] = []
    records = []
    for path in paths:
        try:
            records.append(load_record(path, facts))
        except RecordingError as error:
            problems.append(str(error))
    warnings = [warning for record in records for warning in record.warnings]
    result = Imported(paths, out / COLUMNS_NAME, out / PICTURE_NAME, problems, warnings, None, None)
    if not records:
        return result
    records = one_rate(records)
    coverage = coverage_of(records)
    from ..report.coverage import coverage_figures
    from ..report.static import write_overview  # loads slowly

    write_overview(coverage_figures(records, coverage, facts.units == "linear"), [result.data_picture])
    try:
        cyclic = cyclic_error(records)
    except DataError as error:
        cyclic = None
        warnings.append(str(error))
    return result._replace(coverage=coverage, cyclic=cyclic)

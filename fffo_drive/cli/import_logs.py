"""Take in logs that other programs made: recognise their columns, show on what grounds, write recordings of ours.

LOG is text of any delimiter (metadata and unit lines, decimal comma, no names), an export of EPOS Studio or TwinCAT
Scope, MATLAB (.mat), JSON records, NPZ, Parquet, or an MCAP of another program. Each becomes DIR/NAME.mcap, which
`identify` and `diagnose` take as it is; DIR/facts.yaml holds what is declared about the axis.

What neither names nor units nor the data decide is an assumption, marked with "?". On a terminal it is asked before
anything is written, one by one; --yes takes the assumptions as they are. DIR/columns.png shows what each column was
taken for, DIR/data.png what the data can show. --map FILE gives them beforehand: the DIR/map.yaml that
an earlier import wrote.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from ..documents import DocumentError, read_text
from ..identification.coverage import Coverage, coverage_lines, coverage_of
from ..identification.cyclic import CyclicError, cyclic_error, cyclic_lines
from ..identification.dataset import DataError, distinct_names, load_record, one_rate
from ..identification.facts import DriveFacts
from ..importing.convert import FACTS_NAME, Converted, converted, facts_of, usable, write_facts, write_recording
from ..importing.read import read_source
from ..importing.recognise import (
    COMMAND_A,
    CURRENT_A,
    ENCODER_REV,
    POSITION_REV,
    REFERENCE_RPS,
    SETPOINT_REV,
    TIME_S,
    VELOCITY_RPS,
    Guess,
    Hints,
    Recognition,
    recognise,
)
from ..importing.source import Source
from ..importing.units import UNITS, unit_of
from ..recording.errors import RecordingError, did_you_mean
from ..units import name_on, text_on, unit_in

MAP_NAME = "map.yaml"
PICTURE_NAME = "data.png"
COLUMNS_NAME = "columns.png"
OTHER_SUFFIXES = {".json", ".npz", ".npy", ".parquet", ".pq", ".feather", ".log", ".dat", ".asc"}
MAP_KEYS = {"roles", "units", "rate_hz", "counts_per_turn", "linear", "facts"}
SAY_IT = "say what it is with --unit, --position, --velocity, --command and their like"
ROLES = {
    "time": TIME_S, "position": POSITION_REV, "velocity": VELOCITY_RPS, "command": COMMAND_A, "current": CURRENT_A,
    "reference": REFERENCE_RPS, "setpoint": SETPOINT_REV, "reference_encoder": ENCODER_REV,
}  # fmt: skip
DECLARED = ("torque_constant_nm_per_a", "gear_ratio", "pole_pairs", "slots", "absolute_angle", "load_gravity_nm")


class _Log(NamedTuple):
    source: Source
    found: Recognition
    log: Converted


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("logs", metavar="LOG", nargs="+", help="files of one axis")
    parser.add_argument("--out", required=True, metavar="DIR", help="directory for recordings, facts.yaml and map.yaml")
    parser.add_argument("--yes", action="store_true", help="take assumptions without asking")
    parser.add_argument("--map", metavar="FILE", help=f"columns and units: the {MAP_NAME} of an earlier import")
    roles = parser.add_argument_group("which column is what (default: recognised; '' for none)")
    for role, signal in ROLES.items():
        roles.add_argument(f"--{role.replace('_', '-')}", metavar="COLUMN", help=f"column of {signal}")
    roles.add_argument(
        "--unit",
        action="append",
        default=[],
        metavar="COLUMN=UNIT",
        help="unit of a column: " + ", ".join(UNITS).replace("%", "%%"),
    )
    roles.add_argument("--rate", type=float, metavar="HZ", help="samples a second, where there is no time")
    roles.add_argument("--counts-per-turn", type=float, metavar="N", help="of a position in counts")
    axis = parser.add_argument_group("the axis")
    axis.add_argument(
        "--torque-constant", type=float, metavar="NM_PER_A", help="Nm for a unit of the input (linear: N)"
    )
    axis.add_argument("--linear", action="store_true", help="a linear axis: m and N in place of rev and Nm")
    axis.add_argument("--gear-ratio", type=float, metavar="N", help="motor speed over output speed")
    axis.add_argument("--pole-pairs", type=int, metavar="N")
    axis.add_argument("--slots", type=int, metavar="N")
    axis.add_argument(
        "--load-gravity",
        dest="load_gravity_nm",
        type=float,
        metavar="NM",
        help="largest torque of the load's weight, at the motor",
    )
    axis.add_argument("--absolute-angle", action="store_true", help="the angle's zero is the same in every run")
    parser.add_argument("--json", action="store_true", help="print what was recognised as JSON; asks nothing")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    hints, declared = _told(options)
    sources = [read_source(Path(path)) for path in options.logs]
    logs = [_take(source, hints) for source in sources]
    if not options.json:
        _print_tables(logs)
    if _assumed(logs) and not options.yes and not options.map:
        if options.json or not sys.stdin.isatty():
            raise RecordingError(f"what is marked with '?' is an assumption: take it with --yes, or {SAY_IT}")
        asked = _asked(sources, logs, hints)
        if asked is None:
            print("nothing was written")
            return 0
        logs, hints = asked
    found = logs[0].found
    if any(one.found.linear != found.linear or one.found.torque_unit != found.torque_unit for one in logs):
        raise RecordingError("the logs are not of one axis: their inputs have different units; import them one by one")
    facts = facts_of(found, declared)
    out = Path(options.out)
    out.mkdir(parents=True, exist_ok=True)
    paths = [
        out / f"{name.replace('/', '_')}.mcap"
        for name in distinct_names([_plain_name(one.source.path) for one in logs])
    ]
    taken = next((path for path in paths if path.exists()), None)
    if taken is not None:
        raise RecordingError(f"{taken}: is there already, and is not overwritten: choose another --out")
    for one, path in zip(logs, paths, strict=True):
        write_recording(path, one.source.path, one.log, facts)
    write_facts(out / FACTS_NAME, facts)
    _draw_columns(out / COLUMNS_NAME, logs[0])
    (out / MAP_NAME).write_text(yaml.safe_dump(_map(hints, found, declared), sort_keys=False), encoding="utf-8")
    problems, coverage, cyclic = _checked(paths, facts, options.json)
    if options.json:
        print(
            json.dumps(
                {
                    "logs": [_as_json(*pair) for pair in zip(logs, paths, strict=True)],
                    "problems": problems,
                    "shows": None if coverage is None else coverage._asdict(),
                    "cyclic_error": None if cyclic is None else cyclic.as_plain(),
                },
                indent=2,
            )
        )
        return 0
    if "torque_constant_nm_per_a" not in declared and found.torque_unit not in ("Nm", "N"):
        print(
            f"no torque constant is given: torque is in units of the input ({found.torque_unit}), and inertia and "
            "friction with it; --torque-constant makes them Nm"
        )
    if coverage is not None:
        print("\n".join(coverage_lines(coverage, found.linear)))
    if cyclic is not None:
        print("\n".join(cyclic_lines(cyclic)))
    print("\n".join(str(path) for path in (*paths, out / COLUMNS_NAME, out / PICTURE_NAME)))
    if not problems:
        print(f"next: fffo-drive identify {' '.join(str(path) for path in paths)} --out {out / 'model'}")
    return 0


def _told(options: argparse.Namespace) -> tuple[Hints, dict[str, Any]]:
    """What the user says: of columns and units, and of the axis. The command line stands before the map."""
    told: dict[str, Any] = {}
    if options.map:
        told = yaml.safe_load(read_text(Path(options.map))) or {}
        if not isinstance(told, dict) or set(told) - MAP_KEYS:
            raise DocumentError(f"{options.map}: not a map of columns: {MAP_NAME} of an import is wanted")
    roles = dict(told.get("roles") or {})
    roles |= {signal: value for role, signal in ROLES.items() if (value := getattr(options, role)) is not None}
    units = dict(told.get("units") or {})
    for text in options.unit:
        column, equals, unit = text.rpartition("=")
        if not equals:
            raise RecordingError(f"--unit {text}: COLUMN=UNIT is wanted")
        units[column] = unit
    for column, unit in units.items():
        known = unit_of(str(unit))
        if known is None:
            raise RecordingError(f"unit {unit!r} of column {column!r}: {did_you_mean(str(unit), UNITS)}")
        units[column] = known
    if options.rate is not None and not options.rate > 0.0:
        raise RecordingError(f"--rate {options.rate:g}: a positive number of samples a second is wanted")
    hints = Hints(
        options.rate or told.get("rate_hz"), options.counts_per_turn or told.get("counts_per_turn"),
        options.linear or bool(told.get("linear")), roles, units,
    )  # fmt: skip
    declared = dict(told.get("facts") or {})
    given = {"torque_constant_nm_per_a": options.torque_constant} | {
        name: getattr(options, name) or None for name in DECLARED[1:]
    }
    return hints, declared | {name: value for name, value in given.items() if value is not None}


def _take(source: Source, hints: Hints) -> _Log:
    found = recognise(source, hints)
    return _Log(source, found, usable(str(source.path), converted(source, found), found))


def _print_tables(logs: Sequence[_Log]) -> None:
    for one in logs:
        print("\n".join(_table(one)))


def _assumed(logs: Sequence[_Log]) -> list[Guess]:
    """Assumptions of all logs, each once."""
    found = {(g.signal, g.column, g.unit): g for one in logs for g in one.found.guesses if not g.sure}
    return list(found.values())


def _asked(sources: Sequence[Source], logs: list[_Log], hints: Hints) -> tuple[list[_Log], Hints] | None:
    """The logs once every assumption was taken or put right at the terminal; None to write nothing."""
    print("Each assumption: Enter takes it; a unit or another column puts it right; - leaves it out; q writes nothing.")
    taken: set[tuple[str, str, str]] = set()
    while True:
        guess = next((g for g in _assumed(logs) if (g.signal, g.column, g.unit) not in taken), None)
        if guess is None:
            return logs, hints
        answer = input(f"{guess.signal} is {guess.column!r} [{guess.unit}] ({guess.evidence}): ").strip()
        unit = unit_of(answer) if answer else None
        if answer == "q":
            return None
        if not answer:
            taken.add((guess.signal, guess.column, guess.unit))
            continue
        if answer in sources[0].columns or answer == "-":
            told = replace(hints, roles={**hints.roles, guess.signal: "" if answer == "-" else answer})
        elif unit is not None:
            told = replace(hints, units={**hints.units, guess.column: unit})
        else:
            print(f"{answer!r} is neither a unit nor a column: {did_you_mean(answer, [*UNITS, *sources[0].columns])}")
            continue
        try:
            logs = [_take(source, told) for source in sources]
        except RecordingError as error:
            print(error)
            continue
        hints = told
        _print_tables(logs)


def _draw_columns(path: Path, one: _Log) -> None:
    from ..report.columns import column_figures
    from ..report.static import write_overview  # loads slowly

    rows = column_figures(one.found.guesses, one.log.columns, one.found.torque_unit, one.found.linear)
    write_overview(rows, [path])


def _plain_name(path: Path) -> Path:
    """The path without what says of which kind the file is."""
    return path.with_suffix("") if path.suffix.lower() in OTHER_SUFFIXES else path


def _table(one: _Log) -> list[str]:
    """What was recognised, for people."""
    lines = [f"{one.source.path}: {one.source.rows} rows"]
    for guess in one.found.guesses:
        mark = " " if guess.sure else "?"
        name = name_on(guess.signal, unit_in(guess.signal), one.found.linear)
        grounds = text_on(guess.evidence, one.found.linear)
        lines.append(f" {mark} {name:18s} {guess.column!r} [{guess.unit}]: {grounds}")
    if one.found.left:
        lines.append("   not used: " + ", ".join(map(repr, one.found.left)))
    return lines + [f"   note: {remark}" for remark in one.log.remarks]


def _as_json(one: _Log, path: Path) -> dict[str, Any]:
    return {
        "file": str(one.source.path), "recording": str(path), "rows": one.source.rows,
        "signals": {guess.signal: guess._asdict() for guess in one.found.guesses},
        "not_used": list(one.found.left), "remarks": list(one.log.remarks), "linear": one.found.linear,
        "torque_unit": one.found.torque_unit,
    }  # fmt: skip


def _map(hints: Hints, found: Recognition, declared: dict[str, Any]) -> dict[str, Any]:
    """What was recognised, as --map takes it."""
    return {
        "roles": {signal: "" for signal, column in hints.roles.items() if not column}
        | {guess.signal: guess.column for guess in found.guesses},
        "units": {guess.column: guess.unit for guess in found.guesses if guess.unit in UNITS},
        "rate_hz": None if found.period_s is None else 1.0 / found.period_s,
        "counts_per_turn": hints.counts_per_turn,
        "linear": found.linear,
        "facts": declared,
    }


def _checked(
    paths: list[Path], facts: DriveFacts, quiet: bool
) -> tuple[list[str], Coverage | None, CyclicError | None]:
    """What an identification would say of the recordings before it begins, what they show, and of their sensor."""
    problems, records = [], []
    for path in paths:
        try:
            record = load_record(path, facts)
        except RecordingError as error:
            problems.append(str(error))
            if not quiet:
                print(f"not usable for a fit: {error}", file=sys.stderr)
            continue
        records.append(record)
        if not quiet:
            for warning in record.warnings:
                print(f"warning: {warning}", file=sys.stderr)
    if not records:
        return problems, None, None
    records = one_rate(records)
    coverage = coverage_of(records)
    from ..report.coverage import coverage_figures
    from ..report.static import write_overview  # loads slowly

    linear = facts.units == "linear"
    write_overview(coverage_figures(records, coverage, linear), [paths[0].parent / PICTURE_NAME])
    try:
        cyclic = cyclic_error(records)
    except DataError as error:
        cyclic = None
        if not quiet:
            print(f"warning: {error}", file=sys.stderr)
    return problems, coverage, cyclic

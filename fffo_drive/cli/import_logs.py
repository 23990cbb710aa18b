"""Convert logs of other programs to recordings: recognise their columns, give the reasons, write MCAP.

LOG is text with any delimiter (also with metadata and unit lines, decimal commas or no column names), an export of EPOS
Studio or TwinCAT Scope, MATLAB (.mat), JSON records, NPZ, Parquet, an MCAP of another program, a LeRobot dataset
(--joint), or a trace of a CAN bus (candump, ASC, TRC, BLF, python-can CSV) with the EDS or DCF of the drive (--eds).
Each becomes DIR/NAME.mcap, which `identify` and `diagnose` read directly; DIR/facts.yaml holds the declared facts about
the axis.

Whatever names, units and data leave undecided is an assumption, marked with "?". At a terminal the program asks for
each one before it writes; --yes accepts all of them. DIR/columns.png shows how each column was interpreted,
DIR/data.png what the data can show. --map FILE gives columns and units in advance: DIR/map.yaml of an earlier import.
"""

from __future__ import annotations

import argparse
import json
import math
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..documents import did_you_mean
from ..identification.coverage import coverage_lines
from ..identification.cyclic import cyclic_lines
from ..importing.can_trace import NodeNeededError
from ..importing.candidates import COMMAND_A, CURRENT_A, ROLES, Guess, Hints, Recognition
from ..importing.joints import JointNeededError
from ..importing.source import TraceDrive
from ..importing.times import RateNeededError
from ..importing.units import UNITS, unit_of
from ..recording.errors import RecordingError
from ..units import name_on, text_on, unit_in
from ..workflows.import_logs import (
    MAP_NAME,
    Imported,
    ImportMap,
    RecognisedLog,
    assumptions,
    known_units,
    read_map,
    recognised,
    recognised_logs,
    write_import,
)
from ..workflows.trace_drive import SCALES, trace_drive
from .exits import printable

SAY_IT = "say what it is with --unit, --position, --velocity, --command and their like"
DECLARED = ("torque_constant_nm_per_a", "gear_ratio", "pole_pairs", "slots", "absolute_angle", "load_gravity_nm")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("logs", metavar="LOG", nargs="+", help="files of one axis")
    parser.add_argument("--out", required=True, metavar="DIR", help="directory for recordings, facts.yaml and map.yaml")
    parser.add_argument("--yes", action="store_true", help="accept assumptions without asking")
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
    roles.add_argument(
        "--rate", type=float, metavar="HZ", help="samples per second, if no column is a time (a row number is none)"
    )
    roles.add_argument(
        "--drop", action="store_true", help="accept that more than 1 %% of the rows are left out (no number, no time)"
    )
    roles.add_argument(
        "--counts-per-turn", type=float, metavar="N", help="counts per revolution of a position in counts"
    )
    parser.add_argument_group("a log of a robot").add_argument(
        "--joint",
        metavar="NAME",
        help="of vectors with a number a joint (LeRobot, JointState, matrices): name or number, or all",
    )
    trace = parser.add_argument_group("a trace of a CAN bus")
    trace.add_argument(
        "--eds",
        action="append",
        default=[],
        metavar="FILE",
        help="EDS or DCF of the drive; a drive profile (a file, or a name that `config drives` lists); an axis file. "
        "May be given twice: the mapping of the PDOs from one, scales from the other",
    )
    trace.add_argument("--node", metavar="ID", help="node id of the drive, or CHANNEL:ID (default: the only one)")
    trace.add_argument("--velocity-units", type=float, metavar="N", help="0x606C at one revolution per second")
    trace.add_argument("--rated-torque", type=float, metavar="NM", help="rated torque of the motor (0x6076)")
    trace.add_argument("--rated-current", type=float, metavar="A", help="rated current of the motor (0x6075)")
    axis = parser.add_argument_group("the axis")
    axis.add_argument(
        "--torque-constant",
        type=float,
        metavar="NM_PER_A",
        help="Nm per A of the command (linear: N per A; 1 if the command is a torque or a force)",
    )
    axis.add_argument("--linear", action="store_true", help="a linear axis: m and N instead of rev and Nm")
    axis.add_argument("--gear-ratio", type=float, metavar="N", help="motor speed over output speed")
    axis.add_argument("--pole-pairs", type=int, metavar="N", help="pole pairs of the motor")
    axis.add_argument("--slots", type=int, metavar="N", help="stator slots of the motor")
    axis.add_argument(
        "--load-gravity",
        dest="load_gravity_nm",
        type=float,
        metavar="NM",
        help="largest torque of the load's weight, at the motor",
    )
    axis.add_argument("--absolute-angle", action="store_true", help="the angle's zero is the same in every run")
    parser.add_argument("--json", action="store_true", help="print the recognised columns as JSON; does not ask")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    hints, declared = _from_options(options)
    logs, hints = _recognised(options, hints)
    if not options.json:
        _print_tables(logs)
    grave = [(one, text) for one in logs for text in one.found.grave]
    if grave and (options.yes or options.map):
        one, text = grave[0]
        raise RecordingError(
            f"{one.source.said}: {text}: the inertia depends on it by more than a tenth, which --yes does not decide: "
            f"{SAY_IT}"
        )
    if assumptions(logs) and not options.yes and not options.map:
        if options.json or not sys.stdin.isatty():
            raise RecordingError(f"lines marked with '?' are assumptions: accept them with --yes, or {SAY_IT}")
        asked = _asked(logs, hints)
        if asked is None:
            print("nothing was written")
            return 0
        logs, hints = asked
    joints = list(dict.fromkeys(one.source.joint for one in logs))
    written = []
    for joint in joints:  # an axis each
        own = [one for one in logs if one.source.joint == joint]
        out = Path(options.out) / joint.replace("/", ".") if len(joints) > 1 else Path(options.out)
        done = write_import(own, hints, declared, out)
        written.append(_as_json(own, done))
        if not options.json:
            _print(own[0].found, done, "torque_constant_nm_per_a" in declared, out)
            if assumptions(own):
                print(f"assumed: {'; '.join(_as_assumed(guess, own[0].found) for guess in assumptions(own))}")
    if options.json:
        print(json.dumps(written[0] if len(written) == 1 else written, indent=2))
    return 0


def _recognised(options: argparse.Namespace, hints: Hints) -> tuple[list[RecognisedLog], Hints]:
    """The logs, recognised; at a terminal the rate, node or joint that nothing in a log says is asked for."""
    map_file = Path(options.map) if options.map else None
    while True:
        try:
            return recognised_logs(options.logs, hints, map_file), hints
        except (RateNeededError, NodeNeededError, JointNeededError) as error:
            if options.yes or options.json or not sys.stdin.isatty():
                if isinstance(error, JointNeededError):
                    words = [*options.logs, "--joint", error.joint, "--out", options.out]
                    raise RecordingError(f"{error}: fffo-drive import {shlex.join(words)}") from error
                raise
            print(error)
            asked = error
        if isinstance(asked, NodeNeededError):
            hints = replace(hints, drive=replace(hints.drive or TraceDrive(), node=input("node id: ").strip()))
            continue
        if isinstance(asked, JointNeededError):
            hints = replace(hints, joint=input("joint: ").strip())
            continue
        answer = input("samples per second: ").strip()
        try:
            hints = replace(hints, rate_hz=_positive("--rate", float(answer), "samples per second"))
        except ValueError:
            raise RecordingError(f"{answer!r} is no number of samples per second") from None


def _positive(name: str, value: float, what: str) -> float:
    if not 0.0 < value < math.inf:
        raise RecordingError(f"{name} {value:g}: give a positive number of {what}")
    return value


def _as_assumed(guess: Guess, found: Recognition) -> str:
    name = name_on(guess.signal, unit_in(guess.signal), found.linear)
    unit = found.torque_unit if guess.signal in (COMMAND_A, CURRENT_A) else "a unit of its own"
    return f"{name} is {guess.column!r} in {unit if guess.unit == '-' else guess.unit}"


def _print(found: Recognition, done: Imported, has_constant: bool, out: Path) -> None:
    for problem in done.problems:
        print(f"not usable for a fit: {printable(problem)}", file=sys.stderr)
    for warning in done.warnings:
        print(f"warning: {printable(warning)}", file=sys.stderr)
    if not has_constant and found.torque_unit not in ("Nm", "N"):
        print(
            f"no torque constant given: torque is in units of the input ({found.torque_unit}), and inertia and "
            "friction with it; --torque-constant makes them Nm"
        )
    if done.coverage is not None:
        print("\n".join(coverage_lines(done.coverage, found.linear)))
    if done.cyclic is not None:
        print("\n".join(cyclic_lines(done.cyclic)))
    print("\n".join(str(path) for path in (*done.recordings, done.columns_picture, done.data_picture)))
    if not done.problems:
        words = ["identify", *map(str, done.recordings), "--out", str(out / "model")]
        print(f"next: fffo-drive {shlex.join(words)}")


def _from_options(options: argparse.Namespace) -> tuple[Hints, dict[str, Any]]:
    """What the user says: of columns and units, and of the axis. The command line stands before the map."""
    mapping = read_map(Path(options.map)) if options.map else ImportMap()
    roles = {signal: column or "" for signal, column in mapping.roles.items()}
    roles |= {signal: value for role, signal in ROLES.items() if (value := getattr(options, role)) is not None}
    units = dict(mapping.units)
    for text in options.unit:
        column, equals, unit = text.rpartition("=")
        if not equals:
            raise RecordingError(f"--unit {text}: give COLUMN=UNIT")
        units[column] = unit
    for name, value, what in (
        ("--rate", options.rate, "samples per second"), ("--counts-per-turn", options.counts_per_turn, "counts"),
        ("--velocity-units", options.velocity_units, "units"), ("--rated-torque", options.rated_torque, "Nm"),
        ("--rated-current", options.rated_current, "A"),
    ):  # fmt: skip
        if value is not None:
            _positive(name, value, what)
    hints = Hints(
        options.rate or mapping.rate_hz, options.counts_per_turn or mapping.counts_per_turn,
        options.pole_pairs or mapping.facts.get("pole_pairs"), options.drop, options.linear or mapping.linear, roles,
        known_units(units),
    )  # fmt: skip
    declared = dict(mapping.facts)
    own = (hints.counts_per_turn, options.velocity_units, options.rated_torque, options.rated_current)
    constant = options.torque_constant or declared.get("torque_constant_nm_per_a")
    scales = mapping.scales | {key: value for key, value in zip(SCALES, own, strict=True) if value is not None}
    drive = trace_drive(options.eds or mapping.eds, options.node or mapping.node, scales, constant)
    hints = replace(hints, drive=drive, joint=options.joint or mapping.joint)
    if drive.torque_constant_nm_per_a is not None:
        declared["torque_constant_nm_per_a"] = drive.torque_constant_nm_per_a
    given = {"torque_constant_nm_per_a": options.torque_constant} | {
        name: getattr(options, name) or None for name in DECLARED[1:]
    }
    return hints, declared | {name: value for name, value in given.items() if value is not None}


def _print_tables(logs: Sequence[RecognisedLog]) -> None:
    """A table for each log; a line for an episode of a data set that has the same meaning as the one before."""
    told: list[tuple[str, str]] = []
    for one in logs:
        meaning = [(guess.signal, guess.column) for guess in one.found.guesses]
        alike = one.source.of_dataset and meaning == told
        print("\n".join([f"{one.source.said}: {one.source.rows} rows, likewise"] if alike else _table(one)))
        told = meaning


def _asked(logs: list[RecognisedLog], hints: Hints) -> tuple[list[RecognisedLog], Hints] | None:
    """The logs once every assumption was taken or put right at the terminal; None to write nothing."""
    print(
        "For each assumption: Enter accepts it, a unit or another column corrects it, - leaves it out, q quits "
        "without writing."
    )
    sources = [one.source for one in logs]
    taken: set[tuple[str, str, str]] = set()
    while True:
        guess = next((g for g in assumptions(logs) if (g.signal, g.column, g.unit) not in taken), None)
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
            corrected = replace(hints, roles={**hints.roles, guess.signal: "" if answer == "-" else answer})
        elif unit is not None:
            corrected = replace(hints, units={**hints.units, guess.column: unit})
        else:
            print(f"{answer!r} is neither a unit nor a column: {did_you_mean(answer, [*UNITS, *sources[0].columns])}")
            continue
        try:
            logs = [recognised(source, corrected) for source in sources]
        except RecordingError as error:
            print(error)
            continue
        hints = corrected
        _print_tables(logs)


def _table(one: RecognisedLog) -> list[str]:
    """What was recognised, for people."""
    lines = [f"{one.source.said}: {one.source.rows} rows"]
    for guess in one.found.guesses:
        mark = " " if guess.sure else "?"
        name = name_on(guess.signal, unit_in(guess.signal), one.found.linear)
        grounds = text_on(guess.evidence, one.found.linear)
        lines.append(f" {mark} {name:18s} {guess.column!r} [{guess.unit}]: {grounds}")
    if one.found.left:
        lines.append("   not used: " + ", ".join(map(repr, one.found.left)))
    return lines + [f"   note: {remark}" for remark in one.log.remarks]


def _as_json(logs: Sequence[RecognisedLog], done: Imported) -> dict[str, Any]:
    return {
        "logs": [
            {
                "file": str(one.source.path), "recording": str(path), "rows": one.source.rows,
                "signals": {guess.signal: guess._asdict() for guess in one.found.guesses},
                "not_used": list(one.found.left), "remarks": list(one.log.remarks), "linear": one.found.linear,
                "torque_unit": one.found.torque_unit,
            }
            for one, path in zip(logs, done.recordings, strict=True)
        ],
        "problems": done.problems,
        "shows": None if done.coverage is None else done.coverage._asdict(),
        "cyclic_error": None if done.cyclic is None else done.cyclic.as_plain(),
    }  # fmt: skip

"""A log as it is opened everywhere: by the columns that are declared, by our own names, or recognised without a doubt.

Nothing is guessed here: a log that leaves a doubt is refused with the line of `import` that answers it.
"""

from __future__ import annotations

import contextlib
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from .. import units
from ..documents import did_you_mean
from ..recording.errors import RecordingError
from ..signals import MEASURED_TORQUE, REFERENCE_POSITION, SIGNALS, TEMPERATURE
from .candidates import (
    COMMAND_A,
    CURRENT_A,
    ROLES,
    TIME_S,
    AnswerNeededError,
    DeclaredColumn,
    Guess,
    Hints,
    Recognition,
)
from .convert import Converted, converted
from .evidence import says_nothing
from .joints import chosen, episodes_of
from .read import read_source, short_name
from .recognise import recognise
from .source import Source, source_of_arrays
from .times import RateNeededError, runs_of
from .units import UNITS, unit_of

STATUSWORD = "statusword"  # read where it is declared: other programs may write it in hexadecimal
OURS = {TIME_S: "s"} | {
    s.name: s.unit for s in (*SIGNALS, REFERENCE_POSITION, TEMPERATURE, MEASURED_TORQUE) if s.dtype == "<f8"
}
SIGNAL_UNITS = OURS | {STATUSWORD: "-"}
READ_DIRECTLY = "A"  # unit of the input that needs no word about the torque constant


def read_log(path: Path | str, hints: Hints | None = None) -> Converted:
    """Signals of a log of any kind, (n,) each in our units, `time_s` among them on the clock of the log.

    `hints.rate_hz` gives the time where no column does. Raises RecordingError for what cannot be used or leaves a
    doubt, OSError for what cannot be opened.
    """
    path, hints = Path(path), hints or Hints()
    with saying_how_to_import(path, hints):
        source = read_source(path, hints.drive)
        log = _as_declared(source, hints) if _declared(source, hints) else _without_doubt(source, hints)
    return log._replace(remarks=tuple(f"{source.said}: {remark}" for remark in log.remarks))


def log_of_arrays(name: str, arrays: Mapping[str, Any], hints: Hints | None = None) -> Converted:
    """Signals of arrays (n,) by any name, as `import` reads a file that has them as columns; `doubts` are its own.

    Raises RecordingError for what cannot be recognised, and for a doubt that changes the inertia by more than a tenth.
    """
    hints = hints or Hints()
    source = source_of_arrays(Path(name), arrays)
    ((source,),) = chosen([_one_run(source, hints)], hints.joint).values()
    found = recognise(source, hints)
    if found.grave:
        raise RecordingError(f"{name}: {found.grave[0]}: the inertia depends on it: say it by `columns` or `units`")
    return converted(source, found, hints.drop, from_zero=False)


@contextlib.contextmanager
def saying_how_to_import(path: Path, hints: Hints) -> Iterator[None]:
    """Where a log needs an answer: RecordingError with the line of `import` that gives it."""
    try:
        yield
    except AnswerNeededError as error:
        raise RecordingError(f"{error}\n  import it with: {_import_line(path, hints, error.options)}") from error


def _import_line(path: Path, hints: Hints, options: str) -> str:
    words = ["fffo-drive", "import", str(path), "--out", f"{short_name(path)}_imported"]
    words += ["--linear"] if hints.linear else []
    words += ["--pole-pairs", str(hints.pole_pairs)] if hints.pole_pairs else []
    return f"{shlex.join(words)} {options}".rstrip()


def _declared(source: Source, hints: Hints) -> tuple[DeclaredColumn, ...]:
    """The columns that are declared, else those that are named as signals are, with their time; none: to recognise."""
    if hints.columns:
        return hints.columns
    named = [DeclaredColumn(name, name) for name in source.columns if name in OURS]
    timed = TIME_S in source.columns or hints.rate_hz is not None
    return tuple(named) if timed and any(one.signal != TIME_S for one in named) else ()


def _as_declared(source: Source, hints: Hints) -> Converted:
    """What is declared and nothing else: columns that are left out for what they hold are no news."""
    guesses: list[Guess] = []
    problems: list[str] = []
    for column in _declared(source, hints):
        try:
            guesses.append(_taken(source, column, hints.linear))
        except RecordingError as error:
            problems.append(str(error))
    time = next((guess.column for guess in guesses if guess.signal == TIME_S), None)
    if time is None and hints.rate_hz is None:
        problems.append(f"nothing gives {TIME_S}: {did_you_mean(TIME_S, source.columns)}")
    if problems:
        raise RecordingError(f"{source.path}: " + "\n  ".join(problems))
    if time is not None:
        source = _one_run(source, Hints(roles={TIME_S: time}))
    still = [guess for guess in guesses if says_nothing(source.columns[guess.column])]
    remarks = tuple(f"column {g.column!r} ({g.signal}) is {source.columns[g.column][0]:g} throughout" for g in still)
    period_s = None if time is not None or hints.rate_hz is None else 1.0 / hints.rate_hz
    found = Recognition(tuple(guesses), period_s, hints.linear, READ_DIRECTLY, None, (), remarks)
    return converted(replace(source, left={}), found, hints.drop, from_zero=False)


def _taken(source: Source, declared: DeclaredColumn, linear: bool) -> Guess:
    """A declared column with its factor to our unit. Raises RecordingError saying what is wrong with it."""
    name, signal, unit, scale, offset = declared
    if name not in source.columns:
        why = source.left.get(name) or did_you_mean(name, source.columns)
        raise RecordingError(f"no column {name!r}: {why}")
    if f"{name} (2)" in source.columns:
        raise RecordingError(f"column {name!r} stands several times in the heading")
    if signal not in SIGNAL_UNITS:
        raise RecordingError(f"column {name!r}: no signal {signal!r}: {did_you_mean(signal, SIGNAL_UNITS)}")
    if not math.isfinite(scale) or scale == 0.0 or not math.isfinite(offset):
        raise RecordingError(f"column {name!r}: scale {scale}, offset {offset}")
    own = units.unit_on(SIGNAL_UNITS[signal], linear)
    able = [own, *(u for u in UNITS if own in UNITS and UNITS[u].measures == UNITS[own].measures)]
    able += ["V", "mV"] if own == "A" else []  # an amplifier's input takes the place of the current command
    given = own if unit in (None, own) else unit_of(str(unit))
    if given not in able:
        axis = "a linear" if linear else "a rotary"
        hint = did_you_mean(str(unit), able)
        raise RecordingError(f"column {name!r}: {unit!r} is no unit of {signal} on {axis} axis: {hint}")
    factor = UNITS[given].factor if given in UNITS and given != own else 1.0
    return Guess(signal, name, given, scale * factor, None, None, "declared", True, offset * factor)


def _one_run(source: Source, hints: Hints) -> Source:
    """The run that a log holds. Raises AnswerNeededError for one whose clock begins anew."""
    runs = [run for part in episodes_of(source) for run in runs_of(part, hints)]
    if len(runs) > 1:
        raise AnswerNeededError(f"{source.path}: holds {len(runs)} runs, and a log of one is needed")
    return runs[0]


def _without_doubt(source: Source, hints: Hints) -> Converted:
    """A log that is recognised. Raises AnswerNeededError where a column, a unit or the axis is open."""
    rate, hints = hints.rate_hz, replace(hints, rate_hz=None)
    ((source,),) = chosen([_one_run(source, hints)], hints.joint).values()
    try:
        found = recognise(source, hints)
    except RateNeededError:
        if rate is None:
            raise
        hints = replace(hints, rate_hz=rate)
        found = recognise(source, hints)
    doubts = [guess for guess in found.guesses if not guess.sure]
    if doubts:
        told = "; ".join(f"is {g.column!r} [{g.unit}] {g.signal}? {g.evidence}" for g in doubts)
        raise AnswerNeededError(f"{source.path}: {told}", _answer(source, hints, found.torque_unit, doubts))
    if found.linear != hints.linear:
        kinds = ("a linear", "a rotary") if found.linear else ("a rotary", "a linear")
        raise AnswerNeededError(
            f"{source.path}: has the units of {kinds[0]} axis, and {kinds[1]} one is declared (`units` of the facts)"
        )
    if found.torque_unit != READ_DIRECTLY:
        raise AnswerNeededError(
            f"{source.path}: what drives the axis is in {found.torque_unit}, and is read directly as a current in A",
            "" if found.torque_unit in ("Nm", "N") else "--torque-constant NM_PER_A",
        )
    log = converted(source, found, hints.drop, from_zero=False)
    read = "read as " + ", ".join(f"{g.signal} = {g.column!r} [{g.unit}]" for g in found.guesses)
    return log._replace(remarks=(read, *log.remarks))


def _answer(source: Source, hints: Hints, torque_unit: str, doubts: Sequence[Guess]) -> str:
    """Options of `import` that take what is open as it is; where they leave a doubt, --yes as well."""
    options = {signal: f"--{role.replace('_', '-')}" for role, signal in ROLES.items()}
    roles = {guess.signal: guess.column for guess in doubts if guess.signal in options}
    of_input = {guess.column: torque_unit for guess in doubts if guess.signal in (COMMAND_A, CURRENT_A)}
    assumed = of_input | {guess.column: guess.unit for guess in doubts if guess.unit in UNITS}
    known = {column: unit for column, unit in assumed.items() if unit in UNITS}
    words = [word for signal, column in roles.items() for word in (options[signal], column)]
    words += [word for column, unit in known.items() for word in ("--unit", f"{column}={unit}")]
    answered = replace(hints, roles={**hints.roles, **roles}, units={**hints.units, **known})
    try:
        settled = all(guess.sure for guess in recognise(source, answered).guesses)
    except RecordingError:
        settled = False
    return shlex.join(words if settled else [*words, "--yes"])

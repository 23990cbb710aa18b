"""What a log may be: the columns with what their headings say, the user's hints, and the guesses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple, NoReturn

from ..arrays import Floats
from ..documents import did_you_mean
from ..recording.errors import RecordingError
from ..signals import MEASURED_TORQUE, REFERENCE_POSITION, TEMPERATURE
from .conventions import conventional
from .evidence import (
    WORD,
    Register,
    Wrap,
    bridged,
    offset_of,
    register_of,
    relation,
    says_nothing,
    signed,
    unwrapped,
    wrap_of,
)
from .names import INPUTS, POSITION, VELOCITY, Meaning, meaning_of
from .source import Source, TraceDrive
from .units import COUNT, ELECTRIC, FORCE, LENGTH, PACE, UNITS, turn_of

TIME_S, POSITION_REV, VELOCITY_RPS, REFERENCE_RPS = "time_s", "position_rev", "velocity_rps", "reference_rps"
COMMAND_A, CURRENT_A = "current_command_a", "current_a"
ENCODER_REV = REFERENCE_POSITION.name
TEMPERATURE_DEGC = TEMPERATURE.name
MEASURED_TORQUE_NM = MEASURED_TORQUE.name
SETPOINT_REV = "setpoint_rev"  # a position that was asked for: its derivative is the reference
RECOGNISED = (
    TIME_S,
    POSITION_REV,
    VELOCITY_RPS,
    COMMAND_A,
    CURRENT_A,
    REFERENCE_RPS,
    SETPOINT_REV,
    ENCODER_REV,
    TEMPERATURE_DEGC,
    MEASURED_TORQUE_NM,
)
MOST_LISTED = 40  # columns in a message
ROLES = {  # options of `import` that say which column is a signal
    "time": TIME_S,
    "position": POSITION_REV,
    "velocity": VELOCITY_RPS,
    "command": COMMAND_A,
    "current": CURRENT_A,
    "reference": REFERENCE_RPS,
    "setpoint": SETPOINT_REV,
    "reference_encoder": ENCODER_REV,
    "torque_sensor": MEASURED_TORQUE_NM,
}
GRAVE = 0.1  # share of the inertia that a doubt may change under --yes
SAME = 0.999  # correlation of two columns that are one signal, or of a reference with what follows it


class AnswerNeededError(RecordingError):
    """A log about which only its user can say more; `options`: of `import`, that say it."""

    def __init__(self, text: str, options: str = "") -> None:
        super().__init__(text)
        self.options = options


class DeclaredColumn(NamedTuple):
    """`column` of a file, times `scale`, plus `offset`, is `signal` in `unit` (None: the signal's own)."""

    column: str
    signal: str
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Hints:
    """What the user says beforehand."""

    rate_hz: float | None = None
    counts_per_turn: float | None = None
    pole_pairs: int | None = None  # of a speed in electrical turns
    drop: bool = False  # leave out more than converting may leave out by itself
    linear: bool = False
    roles: Mapping[str, str] = field(default_factory=dict)  # signal -> column, "" for none
    units: Mapping[str, str] = field(default_factory=dict)  # column -> unit
    drive: TraceDrive | None = None  # whose PDOs a trace of a CAN bus holds
    joint: str | None = None  # of a robot's log: a name, a number, or all of them
    columns: tuple[DeclaredColumn, ...] = ()  # all that are read, where they are given: nothing is recognised


class Guess(NamedTuple):
    """One column as a signal of ours: value = raw * factor + shift, once wraps are undone."""

    signal: str
    column: str
    unit: str  # "-": none that is known
    factor: float
    wrap: float | None
    register: Register | None  # of a signed number that is stored without its sign
    evidence: str
    sure: bool  # False: an assumption
    shift: float = 0.0


class Recognition(NamedTuple):
    """All guesses of one log."""

    guesses: tuple[Guess, ...]
    period_s: float | None  # where there is no time
    linear: bool
    torque_unit: str  # of the command: A, Nm, N, V, or the column's own
    enable: str | None  # column that says when the axis is under torque
    left: tuple[str, ...]  # columns that are not used
    remarks: tuple[str, ...]
    grave: tuple[str, ...] = ()  # doubts about which the inertia depends by more than a tenth: for nobody but the user

    def of(self, signal: str) -> Guess | None:
        """The guess for a signal."""
        return next((guess for guess in self.guesses if guess.signal == signal), None)


class Option(NamedTuple):
    """A unit that a column may be in."""

    unit: str  # "-": one of its own
    factor: float | None  # ours in one of it; None: what the other columns make it
    score: float  # log of how likely it is before the others are looked at
    said: str


class Column(NamedTuple):
    """A column with what its heading says; signs that its register lost are restored."""

    name: str
    values: Floats
    unit: str | None
    meaning: Meaning
    register: Register | None


class Candidates:
    """The columns of a source, the guesses about them, and why each is one."""

    def __init__(self, source: Source, hints: Hints) -> None:
        self.source = source
        self.hints = hints = replace(hints, roles={**source.roles, **hints.roles}) if source.roles else hints
        self.guesses: dict[str, Guess] = {}
        self.remarks: list[str] = []
        self.doubts: dict[str, str] = {}  # signal: why its column is an assumption
        self.grave: list[str] = []  # doubts that change the inertia by more than a tenth
        unknown = [name for name in (*hints.roles.values(), *hints.units) if name and name not in source.columns]
        if unknown:
            raise RecordingError(f"{source.path}: no column {unknown[0]!r}: {did_you_mean(unknown[0], source.columns)}")
        self.columns = {}
        known, program = ({}, "") if hints.linear else conventional(source.columns)
        known = {name: unit for name, unit in known.items() if name not in source.units | dict(hints.units)}
        if known:
            self.remarks.append(
                f"units as {program} means them: " + ", ".join(f"{name!r} in {unit}" for name, unit in known.items())
            )
        for name, values in source.columns.items():
            unit = hints.units.get(name, source.units.get(name, known.get(name)))
            meaning = meaning_of(name, unit)
            register = None
            typed = name in source.roles.values()  # by what the file itself says: no number lost its sign
            if meaning.quantity in (POSITION, VELOCITY, *INPUTS) and not typed:
                register = register_of(values, counter=meaning.quantity == POSITION)
                if register is None and meaning.quantity != POSITION:
                    register = offset_of(values, *(() if unit in (None, "counts") else (WORD,)))
            self.columns[name] = Column(name, signed(values, register), unit, meaning, register)
        self.linear = hints.linear or any(
            c.unit and UNITS[c.unit].measures in (LENGTH, PACE, FORCE) for c in self.columns.values()
        )

    def _take(
        self, signal: str, column: Column, unit: str, factor: float, said: str, sure: bool, wrap: float | None = None
    ) -> None:
        self.guesses[signal] = Guess(signal, column.name, unit, factor, wrap, None, said, sure)

    def _free(self) -> list[Column]:
        used = {guess.column for guess in self.guesses.values()}
        return [c for c in self.columns.values() if c.name not in used]

    def _refuse(self, what: str, how: str, error: type[AnswerNeededError] = AnswerNeededError) -> NoReturn:
        names = list(self.source.columns)
        more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
        listed = ", ".join(map(repr, names[:MOST_LISTED])) + more
        raise error(
            f"{self.source.path}: {what} can be seen among the columns {listed}: say it with {how}",
            how.rpartition(" or ")[2],
        )

    def _hinted(self, signal: str) -> Column | None:
        name = self.hints.roles.get(signal)
        return self.columns.get(name) if name else None

    def _candidates(self, signal: str, quantity: str, asked: bool) -> list[Column]:
        """The columns of a quantity by name, measured before unsaid; what the user said alone."""
        if signal in self.hints.roles:
            hinted = self._hinted(signal)
            return [hinted] if hinted else []
        found = [
            c
            for c in self._free()
            if c.meaning.quantity == quantity and c.meaning.asked == asked and not c.meaning.aside
        ]
        return sorted(found, key=lambda c: (not c.meaning.measured, c.meaning.by_device))

    def _pick(self, signal: str, quantity: str, asked: bool) -> Column | None:
        """The first candidate; the others are named."""
        found = self._candidates(signal, quantity, asked)
        if found[1:]:
            self._name_others(signal, found[0], found[1:])
        return found[0] if found else None

    def _name_others(self, signal: str, taken: Column, others: list[Column], doubt: bool = False) -> None:
        names = ", ".join(repr(c.name) for c in others)
        self.remarks.append(f"{taken.name!r} is taken as {signal}; other candidates: {names}")
        if doubt:
            self._doubt(signal, f"others may be it as well: {names}")

    def _doubt(self, signal: str, text: str, inertia_ratio: float = 1.0) -> None:
        """Make the guess of a signal an assumption, for a reason. `inertia_ratio`: of another reading to this one."""
        if not abs(math.log(max(abs(inertia_ratio), 1e-12))) < math.log(1.0 + GRAVE):
            self.grave.append(text)
        self.doubts[signal] = "; ".join(filter(None, [self.doubts.get(signal), text]))

    def _wrap(self, column: Column) -> Wrap | None:
        """The wraps of a position, whole turns first where its unit or the user tells what a turn is."""
        counted = column.unit is None or UNITS[column.unit].measures == COUNT
        return wrap_of(column.values, self.hints.counts_per_turn if counted else turn_of(column.unit))

    def _running(self, column: Column) -> Floats:
        """A position without wraps, missing samples bridged."""
        wrap = self._wrap(column)
        return bridged(column.values if wrap is None or wrap.at is None else unwrapped(column.values, wrap.at))

    @staticmethod
    def _size(column: Column) -> float:
        """Ours in one of its unit, where that is written."""
        return UNITS[column.unit].factor if column.unit else 1.0

    def _level(self, column: Column) -> Floats:
        return self._running(column) if column.meaning.quantity == POSITION else bridged(column.values)

    def _same(self, one: Column, other: Column) -> bool:
        """Whether two columns are one signal, in whatever unit."""
        a, b = self._level(one), self._level(other)
        return abs(relation(a - a.mean(), b - b.mean()).correlation) > SAME

    def _known(self, column: Column, *measures: str) -> bool:
        """Whether a column has a unit of one of these kinds, of which the size is known."""
        if column.unit is None or UNITS[column.unit].measures not in measures or says_nothing(column.values):
            return False
        said = {ELECTRIC: self.hints.pole_pairs, "counts": self.hints.counts_per_turn}
        return said.get(column.unit, 1) is not None

    def _factor(self, unit: str | None) -> float:
        """Ours in one of a unit: of electrical turns by the pole pairs, of counts by those of a turn."""
        assert unit is not None
        said = {ELECTRIC: self.hints.pole_pairs, "counts": self.hints.counts_per_turn}
        return UNITS[unit].factor / (said.get(unit) or 1)

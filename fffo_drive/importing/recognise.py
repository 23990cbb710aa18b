"""Which column is which signal, in which unit and with which sign: by names, units and what the data say of each other.

Nothing is decided in silence: each guess has its evidence, and what neither names nor data decide is an assumption
that says so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..documents import did_you_mean
from ..recording.errors import RecordingError
from ..signals import REFERENCE_POSITION
from .evidence import (
    Wrap,
    bridged,
    driven_by,
    is_flag,
    is_time,
    likely_counts,
    relation,
    rises,
    says_nothing,
    signed,
    smooth_derivative,
    smoothed,
    stamp_wrap_of,
    stored_without_sign,
    unwrapped,
    wrap_of,
)
from .names import ENABLE, INPUTS, POSITION, VELOCITY, Meaning, meaning_of
from .source import Source
from .units import ANGLE, COUNT, FORCE, LENGTH, PACE, SHARE, TIME, TORQUE, UNITS, VOLTAGE, turn_of, unknown_unit

TIME_S, POSITION_REV, VELOCITY_RPS, REFERENCE_RPS = "time_s", "position_rev", "velocity_rps", "reference_rps"
COMMAND_A, CURRENT_A = "current_command_a", "current_a"
ENCODER_REV = REFERENCE_POSITION.name
SETPOINT_REV = "setpoint_rev"  # a position that was asked for: its derivative is the reference
RECOGNISED = (
    TIME_S, POSITION_REV, VELOCITY_RPS, COMMAND_A, CURRENT_A, REFERENCE_RPS, SETPOINT_REV, ENCODER_REV,
)  # fmt: skip
MOST_LISTED = 40  # columns in a message
PLAUSIBLE_HZ = (5.0, 50_000.0)  # of the rate of a log
LIKE = 0.9  # correlation of a velocity with the derivative of the position
SAME = 0.999  # ... of a reference with what follows it
LEAST_STEPPING = 0.5  # of the stamps; with fewer the clock is coarser than the sampling
EXPLAINED = 0.3  # of a column by inertia and friction, for one that has no name
SLOPE_TOLERANCE = 0.05
SPEED_UNITS = {"rps": 1.0, "rpm": 60.0, "rad/s": 2.0 * math.pi, "deg/s": 360.0}  # of one turn a second
ANGLE_UNITS = {"rev": 1.0, "rad": 2.0 * math.pi, "deg": 360.0}  # of one turn


@dataclass(frozen=True)
class Hints:
    """What the user says beforehand."""

    rate_hz: float | None = None
    counts_per_turn: float | None = None
    linear: bool = False
    roles: Mapping[str, str] = field(default_factory=dict)  # signal -> column, "" for none
    units: Mapping[str, str] = field(default_factory=dict)  # column -> unit


class Guess(NamedTuple):
    """One column as a signal of ours: value = raw * factor, once wraps are undone."""

    signal: str
    column: str
    unit: str  # "-": none that is known
    factor: float
    wrap: float | None
    unsigned: float | None  # the range of a signed number that is stored without its sign
    evidence: str
    sure: bool  # False: an assumption


class Recognition(NamedTuple):
    """All guesses of one log."""

    guesses: tuple[Guess, ...]
    period_s: float | None  # where there is no time
    linear: bool
    torque_unit: str  # of the command: A, Nm, N, V, or the column's own
    enable: str | None  # column that says when the axis is under torque
    left: tuple[str, ...]  # columns that are not used
    remarks: tuple[str, ...]

    def of(self, signal: str) -> Guess | None:
        """The guess for a signal."""
        return next((guess for guess in self.guesses if guess.signal == signal), None)


class _Column(NamedTuple):
    name: str
    values: Floats
    unit: str | None
    meaning: Meaning


def recognise(source: Source, hints: Hints | None = None) -> Recognition:
    """Guess all signals of a source. Raises RecordingError where no time, no motion or no input can be recognised."""
    return _Recogniser(source, hints or Hints()).run()


class _Recogniser:
    def __init__(self, source: Source, hints: Hints) -> None:
        self.source, self.hints = source, hints
        self.guesses: dict[str, Guess] = {}
        self.remarks: list[str] = []
        unknown = [name for name in (*hints.roles.values(), *hints.units) if name and name not in source.columns]
        if unknown:
            raise RecordingError(f"{source.path}: no column {unknown[0]!r}: {did_you_mean(unknown[0], source.columns)}")
        self.columns = {}
        for name, values in source.columns.items():
            unit = hints.units.get(name, source.units.get(name))
            self.columns[name] = _Column(name, values, unit, meaning_of(name, unit))
        self.linear = hints.linear or any(
            c.unit and UNITS[c.unit].measures in (LENGTH, PACE, FORCE) for c in self.columns.values()
        )

    def run(self) -> Recognition:
        period_s = self._time()
        enable = next((c.name for c in self._free() if c.meaning.quantity == ENABLE and is_flag(c.values)), None)
        if enable:
            self.columns.pop(enable)
        for name in [c.name for c in self._free() if says_nothing(c.values) and not c.meaning.asked]:
            self.columns.pop(name)
        position = self._pick(POSITION_REV, POSITION, asked=False)
        velocity = self._pick(VELOCITY_RPS, VELOCITY, asked=False)
        if position is None and velocity is None:
            position, velocity = self._pair_by_data()
        if position is None and velocity is None:
            position = self._pick(POSITION_REV, POSITION, asked=True)
        if position is None and velocity is None:
            self._refuse("neither a position nor a velocity", "--position COLUMN or --velocity COLUMN")
        self._motion_units(position, velocity)
        self._reference_encoder()
        self._references()
        torque_unit = self._inputs()
        self._refuse_unknown_units()
        used = {guess.column for guess in self.guesses.values()} | {enable}
        left = tuple(name for name in self.source.columns if name not in used)
        return Recognition(
            tuple(self.guesses.values()), period_s, self.linear, torque_unit, enable, left, tuple(self.remarks)
        )

    # what all steps share

    def _free(self) -> list[_Column]:
        used = {guess.column for guess in self.guesses.values()}
        return [c for c in self.columns.values() if c.name not in used]

    def _refuse(self, what: str, how: str) -> None:
        names = list(self.source.columns)
        more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
        listed = ", ".join(map(repr, names[:MOST_LISTED])) + more
        raise RecordingError(f"{self.source.path}: {what} can be seen among the columns {listed}: say it with {how}")

    def _refuse_unknown_units(self) -> None:
        """A unit that the file writes and that is not known is no reason to assume another one."""
        for name in dict.fromkeys(guess.column for guess in self.guesses.values()):
            text = None if self.columns[name].unit else unknown_unit(name)
            if text is not None:
                raise RecordingError(
                    f"{self.source.path}: column {name!r}: unknown unit {text!r} (say it with --unit "
                    f"'{name}=UNIT'): {did_you_mean(text, UNITS)}"
                )

    def _hinted(self, signal: str) -> _Column | None:
        name = self.hints.roles.get(signal)
        return self.columns.get(name) if name else None

    def _pick(self, signal: str, quantity: str, asked: bool) -> _Column | None:
        """The column of a quantity by name: measured before unsaid, the first of several."""
        if signal in self.hints.roles:
            return self._hinted(signal)
        found = [
            c for c in self._free()
            if c.meaning.quantity == quantity and c.meaning.asked == asked and not c.meaning.aside
        ]  # fmt: skip
        found.sort(key=lambda c: not c.meaning.measured)
        others = [c.name for c in found[1:]]
        if others:
            self.remarks.append(
                f"{found[0].name!r} is taken as {signal}; other candidates: {', '.join(map(repr, others))}"
            )
        return found[0] if found else None

    # time

    def _time(self) -> float | None:
        if self.hints.rate_hz is not None:
            return 1.0 / self.hints.rate_hz
        columns = list(self.columns.values())
        hinted = self._hinted(TIME_S)
        named = [c for c in columns if c.meaning.quantity == TIME and rises(c.values)]
        first = columns[:1] if columns and columns[0].meaning.quantity is None and is_time(columns[0].values) else []
        anywhere = [c for c in columns if c.meaning.quantity is None and is_time(c.values)]
        found = next(iter([hinted] if hinted else [*named, *first, *anywhere]), None)
        if found is None:
            if self.source.period_s is not None:
                self.remarks.append(f"no column of time: {1.0 / self.source.period_s:.6g} Hz, as the file declares")
                return self.source.period_s
            self._refuse("no time", "--time COLUMN or --rate HZ")
        assert found is not None
        steps = np.abs(np.diff(found.values[np.isfinite(found.values)]))
        if not float(np.mean(steps > 0.0) if steps.size else 0.0) > LEAST_STEPPING:
            raise RecordingError(
                f"{self.source.path}: column {found.name!r} repeats in most rows, the stamps are rounded: "
                "give --rate HZ"
            )
        step = float(np.median(steps))
        unit, sure = found.unit, True
        evidence = f"unit {unit}, " if unit else ""
        if unit is None or UNITS[unit].measures != TIME:
            whole = bool(np.array_equal(found.values, np.round(found.values)))
            order = ("ms", "us", "ns", "s") if whole else ("s", "ms", "us", "ns")
            able = [u for u in order if PLAUSIBLE_HZ[0] <= 1.0 / max(step * UNITS[u].factor, 1e-300) <= PLAUSIBLE_HZ[1]]
            unit = able[0] if able else "s"
            sure = len(able) == 1 or (unit == "s" and not whole)
            others = [f"in {u} it would be {1.0 / (step * UNITS[u].factor):.4g} Hz" for u in able[1:]]
            evidence = "; ".join([f"in {unit} the rate is plausible", *others]) + "; "
        factor = UNITS[unit].factor
        wrap = stamp_wrap_of(found.values)
        self.guesses[TIME_S] = Guess(
            TIME_S, found.name, unit, factor, wrap, None,
            f"{evidence}{1.0 / (step * factor):.6g} Hz" + (f", wraps at {wrap:g}" if wrap else ""), sure,
        )  # fmt: skip
        return None

    def _time_s(self) -> Floats:
        """Stamps for derivatives: an even grid where they do not rise."""
        guess = self.guesses.get(TIME_S)
        rows = self.source.rows
        if guess is None:
            period_s = 1.0 / self.hints.rate_hz if self.hints.rate_hz else self.source.period_s or 1.0
            return np.asarray(np.arange(rows) * period_s, dtype=np.float64)
        raw = self.source.columns[guess.column]
        time_s = (unwrapped(raw, guess.wrap) if guess.wrap else raw) * guess.factor
        steps = np.diff(bridged(time_s))
        usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0
        steps = np.where(steps < 0.0, usual, steps)  # a log that begins anew
        return np.asarray(np.concatenate([[0.0], np.cumsum(steps)]) + np.arange(rows) * usual * 1e-9)

    # position and velocity

    def _wrap(self, column: _Column) -> Wrap | None:
        """The wraps of a position, whole turns first where its unit or the user tells what a turn is."""
        counted = column.unit is None or UNITS[column.unit].measures == COUNT
        return wrap_of(column.values, self.hints.counts_per_turn if counted else turn_of(column.unit))

    def _running(self, column: _Column) -> Floats:
        """A position without wraps, missing samples bridged."""
        wrap = self._wrap(column)
        return bridged(column.values if wrap is None or wrap.at is None else unwrapped(column.values, wrap.at))

    def _pair_by_data(self) -> tuple[_Column | None, _Column | None]:
        """Of columns without a name, the pair of which one is the derivative of the other."""
        time_s = self._time_s()
        free = [c for c in self._free() if c.meaning.quantity is None and not c.meaning.aside]
        best: tuple[float, _Column, _Column] | None = None
        for one in free:
            rate, _ = smooth_derivative(self._running(one), time_s)
            for other in free:
                if other is not one:
                    alike = abs(relation(smoothed(bridged(other.values)), rate).correlation)
                    if alike > LIKE and (best is None or alike > best[0]):
                        best = (alike, one, other)
        return (None, None) if best is None else best[1:]

    def _motion_units(self, position: _Column | None, velocity: _Column | None) -> None:
        """Units, wraps and signs of position and velocity, each from what is known of the other."""
        slope = alike = None
        if position is not None and velocity is not None:
            rate, _ = smooth_derivative(self._running(position), self._time_s())
            slope, alike = relation(smoothed(bridged(velocity.values)), rate)
            if abs(alike) < 0.5:
                self.remarks.append(
                    f"{velocity.name!r} is not the derivative of {position.name!r} (r = {alike:.2f}): it is left out"
                )
                velocity = slope = alike = None
        if position is not None:
            self._position(position, velocity, slope)
        if velocity is not None:
            self._velocity(velocity, position, slope, alike)

    def _position(self, column: _Column, velocity: _Column | None, slope: float | None) -> None:
        jumps = self._wrap(column)
        wrap = None if jumps is None else jumps.at
        unit, evidence, sure = column.unit, [], True
        counts = self.hints.counts_per_turn
        measures = UNITS[unit].measures if unit else None
        if self.linear:
            unit = unit if unit and measures == LENGTH else "m"
            factor, sure = UNITS[unit].factor, measures == LENGTH
            evidence.append(f"unit {unit}" if sure else "m is assumed")
        elif measures == COUNT or (unit is None and counts is not None):
            unit = "counts"
            counts, text = self._counts(wrap, velocity, slope, counts)
            factor, sure = 1.0 / counts, text != ""
            evidence.append(text or "one wrap is assumed to be one turn")
        elif unit is not None and measures != SHARE:
            factor = UNITS[unit].factor
            evidence.append(f"unit {unit}")
        else:
            unit, text, sure = self._angle_unit(wrap, velocity, slope)
            factor = UNITS[unit].factor
            evidence.append(text)
        if jumps is not None:
            evidence.append(_said_of(jumps))
            sure = sure and jumps.sure
        self.guesses[POSITION_REV] = Guess(
            POSITION_REV, column.name, unit, factor, wrap, None, ", ".join(evidence), sure
        )

    def _counts(
        self, wrap: float | None, velocity: _Column | None, slope: float | None, given: float | None
    ) -> tuple[float, str]:
        """Counts of a turn: as given, by a velocity whose unit is known, or one wrap."""
        if given is not None:
            return given, f"{given:g} counts a turn, as given"
        if velocity is not None and velocity.unit in SPEED_UNITS and slope:
            found = SPEED_UNITS[velocity.unit] / abs(slope)
            whole = likely_counts(found)
            return whole, f"{whole:g} counts a turn, by {velocity.name!r} in {velocity.unit}"
        if wrap is not None:
            return wrap, ""
        raise RecordingError(
            f"{self.source.path}: the position is in counts, and nothing says how many make a turn: --counts-per-turn N"
        )

    def _angle_unit(self, wrap: float | None, velocity: _Column | None, slope: float | None) -> tuple[str, str, bool]:
        """The unit of an angle that the file does not say: by its wrap, by the velocity, or rad by assumption."""
        for unit, turn in ANGLE_UNITS.items():
            if wrap is not None and any(abs(wrap / (k * turn) - 1.0) < 1e-6 for k in (1, 2)):
                return unit, f"{unit}, because it wraps at {wrap:.6g}", True
        if wrap is not None and wrap >= 256.0:
            raise RecordingError(
                f"{self.source.path}: the position looks like counts (it wraps at {wrap:g}): "
                "--counts-per-turn N, and --unit COLUMN=counts"
            )
        if velocity is not None and velocity.unit in SPEED_UNITS and slope:
            turn = SPEED_UNITS[velocity.unit] / abs(slope)  # of the position's own unit
            found = next((u for u, size in ANGLE_UNITS.items() if abs(turn / size - 1.0) < SLOPE_TOLERANCE), None)
            if found is None:
                raise RecordingError(
                    f"{self.source.path}: a turn is {turn:.5g} of the position's unit by {velocity.name!r} in "
                    f"{velocity.unit}: say --counts-per-turn {likely_counts(turn):g}, or the unit of one of them"
                )
            return found, f"{found}, by {velocity.name!r} in {velocity.unit}", True
        if slope:
            pairs = [
                (a, b) for a, turn in ANGLE_UNITS.items() for b, speed in SPEED_UNITS.items()
                if abs(abs(slope) * turn / speed - 1.0) < SLOPE_TOLERANCE
            ]  # fmt: skip
            if len(pairs) == 1:
                return pairs[0][0], f"{pairs[0][0]}, as the velocity is {slope:.4g} times its derivative", True
            if (hint := self._full_turn()) and any(pair[0] == "rad" for pair in pairs):
                return "rad", f"rad, as {hint}", True
        return "rad", "rad is assumed", False

    def _full_turn(self) -> str | None:
        """A reference that stands at whole multiples of 2 pi: a speed in rad/s that somebody meant in turns."""
        for c in self.columns.values():
            if c.meaning.asked and c.meaning.quantity == VELOCITY:
                level = float(np.nanmedian(np.abs(c.values)))
                turns = level / (2.0 * math.pi)
                if turns > 0.05 and abs(turns * 2.0 - round(turns * 2.0)) < 1e-4 and round(turns * 2.0) > 0:
                    return f"{c.name!r} stands at {level:.6g}, {turns:.3g} times 2 pi"
        return None

    def _velocity(self, column: _Column, position: _Column | None, slope: float | None, alike: float | None) -> None:
        unit, sure, evidence = column.unit, True, ""
        own = POSITION_REV if position is not None else ""
        if self.linear:
            known = unit is not None and UNITS[unit].measures == PACE
            unit = unit if known and unit else "m/s"
            evidence, sure = f"unit {unit}", known or slope is not None
        elif unit is not None and UNITS[unit].measures not in (COUNT, SHARE):
            evidence = f"unit {unit}"
        elif slope and own:
            turns = abs(slope) / self.guesses[own].factor  # of its unit, at a turn a second
            able = {u: size for u, size in SPEED_UNITS.items() if abs(turns / size - 1.0) < SLOPE_TOLERANCE}
            unit = next(iter(able), "")
            if not unit:
                return self._odd_velocity(column, slope)
            evidence, sure = f"{unit}, by the derivative of the position", self.guesses[own].sure
        else:
            unit, evidence, sure = "rad/s", "rad/s is assumed", False
        factor = UNITS[unit].factor
        if slope and own:
            ratio = slope * factor / self.guesses[own].factor
            if abs(abs(ratio) - 1.0) > 3.0 * SLOPE_TOLERANCE:
                self.remarks.append(
                    f"{column.name!r} in {unit} is {ratio:.4g} times the derivative of {self.guesses[own].column!r}: "
                    "it is left out"
                )
                return None
            evidence += f"; r = {alike:.3f} with the derivative of the position"
            if slope < 0.0:
                factor, evidence = -factor, evidence + ", sign reversed"
        self.guesses[VELOCITY_RPS] = Guess(VELOCITY_RPS, column.name, unit, factor, None, None, evidence, sure)
        return None

    def _odd_velocity(self, column: _Column, slope: float) -> None:
        """A velocity in a unit of its own: scaled by the position."""
        factor = self.guesses[POSITION_REV].factor / slope
        self.guesses[VELOCITY_RPS] = Guess(
            VELOCITY_RPS, column.name, "-", factor, None, None, "scaled by the derivative of the position", True
        )

    def _reference_encoder(self) -> None:
        """A second sensor of the position: as given, or the column of its own name."""
        position = self.guesses.get(POSITION_REV)
        hinted = self._hinted(ENCODER_REV) if ENCODER_REV in self.hints.roles else self.columns.get(ENCODER_REV)
        if hinted is None or position is None:
            return
        one, other = self._running(hinted), self._running(self.columns[position.column])
        found = relation(one - one.mean(), other - other.mean())
        if abs(found.correlation) < LIKE:
            self._refuse(
                f"no reference encoder ({hinted.name!r} does not follow {position.column!r})", "--reference-encoder"
            )
        own = position.factor / found.slope  # the scale of the position: the rest of it follows from the data
        if hinted.unit is not None and UNITS[hinted.unit].measures == ANGLE:
            own = math.copysign(UNITS[hinted.unit].factor, found.slope)
        evidence = f"r = {found.correlation:.6f} with {position.column!r}" + (", sign reversed" if own < 0.0 else "")
        jumps = self._wrap(hinted)
        if jumps is not None:
            evidence += f", {_said_of(jumps)}"
        self.guesses[ENCODER_REV] = Guess(
            ENCODER_REV, hinted.name, hinted.unit or "-", own, None if jumps is None else jumps.at, None, evidence,
            jumps is None or jumps.sure,
        )  # fmt: skip

    # references

    def _references(self) -> None:
        reference = self._pick(REFERENCE_RPS, VELOCITY, asked=True)
        if reference is not None:
            self._reference(reference)
        followed = self.guesses.get(POSITION_REV)
        if followed is None:
            return
        asked = self._pick(SETPOINT_REV, POSITION, asked=True) or self._follows(followed)
        if asked is not None and asked.name != followed.column:
            self._setpoint(asked, followed)

    def _reference(self, column: _Column) -> None:
        """A velocity that was asked for: in its own unit, else in that of the motion, with the sign of the velocity."""
        velocity, position = self.guesses.get(VELOCITY_RPS), self.guesses.get(POSITION_REV)
        followed = velocity or position
        assert followed is not None
        evidence = "by its name"
        if column.unit is not None and UNITS[column.unit].measures not in (COUNT, SHARE):
            factor, unit, sure = math.copysign(UNITS[column.unit].factor, followed.factor), column.unit, True
        elif column.unit not in (None, self.columns[followed.column].unit):
            return self._leave_out(column, followed)
        elif velocity is not None:
            factor, unit, sure = velocity.factor, velocity.unit, velocity.sure
        else:
            factor, unit, sure = followed.factor, f"{followed.unit}/s", followed.sure
        if factor < 0.0:
            evidence += f", sign reversed as that of {followed.column!r}"
        self.guesses[REFERENCE_RPS] = Guess(REFERENCE_RPS, column.name, unit, factor, None, None, evidence, sure)
        return None

    def _setpoint(self, column: _Column, followed: Guess) -> None:
        """A position that was asked for: in its own unit, else in that of the position."""
        measures = UNITS[column.unit].measures if column.unit else None
        counts = self.hints.counts_per_turn
        unit, factor = column.unit or followed.unit, followed.factor
        if measures == (LENGTH if self.linear else ANGLE):
            factor = math.copysign(UNITS[unit].factor, followed.factor)
        elif measures == COUNT and counts is not None:
            factor = math.copysign(1.0 / counts, followed.factor)
        elif column.unit not in (None, followed.unit):
            return self._leave_out(column, followed)
        # a set point may step by a turn: it wraps where the position does
        jumps = self._wrap(column) if followed.wrap is not None else None
        evidence = "by its name" if column.meaning.asked else f"{followed.column!r} follows it"
        self.guesses[SETPOINT_REV] = Guess(
            SETPOINT_REV, column.name, unit, factor, None if jumps is None else jumps.at, None, evidence, True
        )
        return None

    def _leave_out(self, column: _Column, other: Guess) -> None:
        self.remarks.append(
            f"{column.name!r} in {column.unit} is left out: nothing says what that is beside {other.column!r} in "
            f"{other.unit}"
        )

    def _follows(self, position: Guess) -> _Column | None:
        """A column without a name that the position follows."""
        own = self._running(self.columns[position.column])
        for c in self._free():
            if c.meaning.quantity is None and SETPOINT_REV not in self.hints.roles:
                other = bridged(c.values)
                found = relation(other - other.mean(), own - own.mean())
                if found.correlation > SAME and abs(found.slope - 1.0) < SLOPE_TOLERANCE:
                    return c
        return None

    # what drives the axis

    def _inputs(self) -> str:
        velocity, acceleration = self._motion()
        found: dict[str, _Column] = {}
        for signal, asked in ((COMMAND_A, True), (CURRENT_A, False)):
            for quantity in INPUTS:
                if signal not in found and (column := self._pick(signal, quantity, asked)) is not None:
                    found[signal] = column
        measured = found.get(CURRENT_A)
        if (
            COMMAND_A not in found
            and measured
            and measured.meaning.quantity == VOLTAGE
            and not measured.meaning.measured
        ):
            found = {COMMAND_A: measured}  # what an amplifier is given
        kinds = {signal: c.meaning.quantity or "" for signal, c in found.items()}
        if len(set(kinds.values())) == 2:  # a current beside a torque: one unit for both
            worse = max(found, key=lambda s: (INPUTS.index(kinds[s]), s == CURRENT_A))
            self.remarks.append(f"{found[worse].name!r} is left out: the other input is a {kinds[COMMAND_A]}")
            del found[worse]
        raw = {signal for signal, c in found.items() if c.unit and UNITS[c.unit].measures in (SHARE, COUNT)}
        if len(raw) == 1 and len(found) == 2:  # of a rated value that nobody knows: no scale beside the other
            share = found.pop(raw.pop())
            self.remarks.append(
                f"{share.name!r} in {share.unit} is left out: the other input, {next(iter(found.values())).name!r}, "
                "has a unit"
            )
        if not found:
            unnamed = [c for c in self._free() if c.meaning.quantity is None and not is_flag(c.values)]
            shares = {c.name: driven_by(c.values, velocity, acceleration).share for c in unnamed}
            name = max(shares, key=lambda n: shares[n], default=None)
            if name is None or shares[name] < EXPLAINED:
                self._refuse("no current or torque", "--command COLUMN")
            assert name is not None
            found[COMMAND_A] = self.columns[name]
        if COMMAND_A not in found:
            self.remarks.append(f"no command: {found[CURRENT_A].name!r}, which is measured, stands in for it")
        unit = self._input_unit(next(iter(found.values())))
        for signal, column in found.items():
            self.guesses[signal] = self._input(signal, column, unit, velocity, acceleration)
        return unit

    def _motion(self) -> tuple[Floats, Floats]:
        """Velocity and acceleration (n,) in our units."""
        time_s = self._time_s()
        guess = self.guesses.get(POSITION_REV)
        if guess is not None:
            return smooth_derivative(self._running(self.columns[guess.column]) * guess.factor, time_s)
        own = self.guesses[VELOCITY_RPS]
        velocity = bridged(self.source.columns[own.column]) * own.factor
        return velocity, smooth_derivative(velocity, time_s)[0]

    def _input_unit(self, column: _Column) -> str:
        if column.unit is None:
            return {TORQUE: "N" if self.linear else "Nm", VOLTAGE: "V"}.get(column.meaning.quantity or "", "A")
        measures = UNITS[column.unit].measures
        return {TORQUE: "Nm", FORCE: "N", VOLTAGE: "V", SHARE: column.unit, COUNT: column.unit}.get(measures, "A")

    def _input(
        self, signal: str, column: _Column, unit_of_inputs: str, velocity: Floats, acceleration: Floats
    ) -> Guess:
        unit = column.unit
        factor = UNITS[unit].factor / UNITS[unit_of_inputs].factor if unit else 1.0
        whole = stored_without_sign(column.values)
        values = signed(column.values, whole)
        driven = driven_by(values, velocity, acceleration)
        evidence = f"{100.0 * max(driven.share, 0.0):.0f} % of it is inertia and friction"
        if unit is None:
            evidence = f"no unit is given, {self._input_unit(column)} is assumed; {evidence}"
        if whole is not None:
            evidence += f"; stored as an unsigned number (0 to {whole:g}), sign restored"
        if driven.against and driven.share > EXPLAINED:
            factor, evidence = -factor, evidence + "; it opposes the motion, so its sign is reversed"
        return Guess(signal, column.name, unit or "-", factor, None, whole, evidence, unit is not None)


def _said_of(wrap: Wrap) -> str:
    """What the jumps of a position mean, in words."""
    if wrap.sure:
        return f"wraps at {wrap.at:.6g}, unwrapped"
    meant = "neither a turn nor a known range" if wrap.at is None else f"unwrapped at {wrap.at:.6g} by assumption"
    return f"jumps by {wrap.jump:.6g}, {meant} (--counts-per-turn N, --unit COLUMN=UNIT)"

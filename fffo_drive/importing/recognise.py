"""Which column is which signal, in which unit and with which sign: by names, units and what the data say of each other.

Nothing is decided in silence: each guess has its evidence, and what neither names nor data decide is an assumption
that says so.
"""

from __future__ import annotations

import math
import shlex

import numpy as np

from ..arrays import Floats
from ..documents import did_you_mean
from .candidates import (
    COMMAND_A,
    CURRENT_A,
    MEASURED_TORQUE_NM,
    POSITION_REV,
    REFERENCE_RPS,
    SAME,
    SETPOINT_REV,
    TEMPERATURE_DEGC,
    TIME_S,
    VELOCITY_RPS,
    AnswerNeededError,
    Column,
    Guess,
    Hints,
    Recognition,
)
from .evidence import (
    OFFSET,
    are_whole,
    bridged,
    driven_by,
    is_flag,
    register_of,
    relation,
    says_nothing,
    sign_bit_of,
    signed,
    smoothed,
)
from .motion import CLOSE, CONTRADICTING, EXPLAINS, LIKE, MEASURED, SPEED_UNITS, Motions
from .names import ENABLE, INPUTS, POSITION, VELOCITY, names_a_sensor
from .source import Source
from .units import ANGLE, COUNT, CURRENT, FORCE, LENGTH, SHARE, TORQUE, UNITS, VOLTAGE, unknown_unit
from .units import TEMPERATURE as TEMPERATURE_OF

EXPLAINED = 0.3  # of a column by inertia and friction, for one that has no name
PERFECT = 0.99  # ... of a measured one; what a model or a controller computed has more
COMPUTED, ITSELF = -3.0, -20.0  # log, of a measured column that is explained so well, and of the velocity itself
OF_THE_CURRENT = 0.99  # correlation of a torque that no heading calls that of a sensor
SAME_INERTIA = 0.02  # of two columns either of which may be taken
NOTHING = -10.0
QUANTITIES = {CURRENT: 0.0, TORQUE: -1.0, VOLTAGE: -4.0}  # log, of each of what may drive an axis
SIGN_GAIN = 0.5  # of what inertia and friction leave of a column: less is left of it with its sign
LARGEST_A = 200.0  # of a servo axis: more are mA
PLAUSIBLE_A = (0.5, 40.0)  # peaks of a current of which nobody says the unit, and which has digits below one
PLAUSIBLE_MA = (400.0, 40e3)  # likewise; less may be a share of the rated current
PLAUSIBLE_DEGC = (-40.0, 150.0)  # of a motor


def recognise(source: Source, hints: Hints | None = None) -> Recognition:
    """Guess all signals of a source. Raises RecordingError where no time, no motion or no input can be recognised."""
    return _Recogniser(source, hints or Hints()).run()


class _Recogniser(Motions):
    def run(self) -> Recognition:
        time = self._time()
        enable = next((c.name for c in self._free() if c.meaning.quantity == ENABLE and is_flag(c.values)), None)
        if enable:
            self.columns.pop(enable)
        for name in [c.name for c in self._free() if says_nothing(c.values) and not c.meaning.asked]:
            self.columns.pop(name)
        position, velocity = self._motion_columns()
        if position is None and velocity is None:
            position = self._pick(POSITION_REV, POSITION, asked=True)
        if position is None and velocity is None:
            self._refuse("neither a position nor a velocity", "--velocity COLUMN or --position COLUMN")
        self._motion_units(time, position, velocity)
        self._reference_encoder()
        self._references()
        torque_unit = self._inputs()
        self._temperature()
        self._refuse_unknown_units()
        self._tell_registers_and_doubts()
        used = {guess.column for guess in self.guesses.values()} | {enable}
        left = tuple(name for name in self.source.columns if name not in used)
        period_s = None if TIME_S in self.guesses else self._period_s
        return Recognition(
            tuple(self.guesses.values()),
            period_s,
            self.linear,
            torque_unit,
            enable,
            left,
            tuple(self.remarks),
            tuple(self.grave),
        )

    def _refuse_unknown_units(self) -> None:
        """A unit that the file writes and that is not known is no reason to assume another one."""
        for name in dict.fromkeys(guess.column for guess in self.guesses.values()):
            text = None if self.columns[name].unit else unknown_unit(name)
            if text is not None:
                raise AnswerNeededError(
                    f"{self.source.path}: column {name!r}: unknown unit {text!r} (say it with --unit "
                    f"'{name}=UNIT'): {did_you_mean(text, UNITS)}",
                    f"--unit {shlex.quote(f'{name}=UNIT')}",
                )

    def _tell_registers_and_doubts(self) -> None:
        for signal, guess in self.guesses.items():
            register = self.columns[guess.column].register
            evidence = guess.evidence + (f"; {register.said}" if register else "")
            doubt = self.doubts.get(signal) or self.source.doubts.get(guess.column)
            if register is not None and register.kind == OFFSET and signal not in self.hints.roles:
                doubt = doubt or f"{register.at:g} is assumed to stand for zero"
            self.guesses[signal] = guess._replace(
                register=register, evidence=evidence + (f"; {doubt}" if doubt else ""), sure=guess.sure and not doubt
            )

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

    def _reference(self, column: Column) -> None:
        """A velocity that was asked for: in its own unit, else in that of the motion, with the sign of the velocity."""
        velocity, position = self.guesses.get(VELOCITY_RPS), self.guesses.get(POSITION_REV)
        followed = velocity or position
        assert followed is not None
        evidence = "by its name"
        if column.unit is not None and UNITS[column.unit].measures not in (COUNT, SHARE):
            factor, unit, sure = math.copysign(UNITS[column.unit].factor, followed.factor), column.unit, True
        elif column.unit not in (None, self.columns[followed.column].unit):
            return self._leave_out(column, followed)
        else:
            factor, unit, sure = self._unit_that_is_followed(column, velocity or followed)
        if factor < 0.0:
            evidence += f", sign reversed as that of {followed.column!r}"
        self._take(REFERENCE_RPS, column, unit, factor, evidence, sure)
        return None

    def _unit_that_is_followed(self, column: Column, followed: Guess) -> tuple[float, str, bool]:
        """Factor and unit of a velocity that was asked for in no unit: that in which the motion follows it."""
        motion = self._motion()[0]
        asked = bridged(column.values)
        found = relation(motion, asked)
        sign = math.copysign(1.0, followed.factor)
        unit = followed.unit if followed.signal == VELOCITY_RPS else f"{followed.unit}/s"
        if self.linear or abs(found.correlation) < LIKE:
            return followed.factor, unit, followed.sure
        away, other = min((abs(math.log(abs(found.slope) / UNITS[u].factor)), u) for u in SPEED_UNITS)
        if away > CONTRADICTING:
            return followed.factor, unit, followed.sure
        return sign * UNITS[other].factor, other, followed.sure

    def _setpoint(self, column: Column, followed: Guess) -> None:
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
        self._take(SETPOINT_REV, column, unit, factor, evidence, True, None if jumps is None else jumps.at)
        return None

    def _leave_out(self, column: Column, other: Guess) -> None:
        self.remarks.append(
            f"{column.name!r} in {column.unit} is left out: nothing says what that is beside {other.column!r} in "
            f"{other.unit}"
        )

    def _follows(self, position: Guess) -> Column | None:
        """A column without a name that the position follows."""
        own = self._running(self.columns[position.column])
        for c in self._free():
            if c.meaning.quantity is None and SETPOINT_REV not in self.hints.roles:
                other = bridged(c.values)
                found = relation(other - other.mean(), own - own.mean())
                if found.correlation > SAME and abs(found.slope - 1.0) < CONTRADICTING:
                    return c
        return None

    def _inputs(self) -> str:
        velocity, acceleration = self._motion()
        for column in self._free():
            if column.meaning.quantity in INPUTS:
                self.columns[column.name] = self._with_sign(column, velocity, acceleration)
        found: dict[str, Column] = {}
        for signal, asked in ((COMMAND_A, True), (CURRENT_A, False)):
            taken = self._pick_input(signal, asked, velocity, acceleration)
            found |= {} if taken is None else {signal: taken}
        measured = found.get(CURRENT_A)
        if (
            COMMAND_A not in found
            and measured
            and measured.meaning.quantity == VOLTAGE
            and not measured.meaning.measured
        ):
            found = {COMMAND_A: measured}  # what an amplifier is given
        self._torque_sensor(found, velocity, acceleration)
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
            unnamed = [self._with_sign(c, velocity, acceleration) for c in unnamed]
            self.columns |= {c.name: c for c in unnamed}
            likely = {c.name: self._likely(c, velocity, acceleration, False) for c in unnamed}
            able = sorted((c for c in unnamed if likely[c.name] > EXPLAINED * EXPLAINS), key=lambda c: -likely[c.name])
            if not able:
                self._refuse("no current or torque", "--command COLUMN")
            found[COMMAND_A] = able[0]
            if able[1:]:
                self._doubt(COMMAND_A, f"others may be it as well: {', '.join(repr(c.name) for c in able[1:])}")
        if COMMAND_A not in found:
            self.remarks.append(f"no command: {found[CURRENT_A].name!r}, which is measured, stands in for it")
        unit = self._input_unit(next(iter(found.values())))
        for signal, column in found.items():
            self.guesses[signal] = self._input(signal, column, unit, velocity, acceleration)
        return unit

    def _pick_input(self, signal: str, asked: bool, velocity: Floats, acceleration: Floats) -> Column | None:
        """The likeliest of what may drive the axis; a close second that is another signal is a doubt."""
        if signal in self.hints.roles:
            hinted = self._hinted(signal)
            if hinted is not None:
                self.columns[hinted.name] = hinted = self._with_sign(hinted, velocity, acceleration)
            return hinted
        able = [c for quantity in INPUTS for c in self._candidates(signal, quantity, asked)]
        if not able:
            return None
        scores = {c.name: self._likely(c, velocity, acceleration, not asked) for c in able}
        able.sort(key=lambda c: -scores[c.name])
        taken, *others = able
        if scores[taken.name] < NOTHING:
            self._doubt(signal, "it is the velocity itself under another name")
        others = [c for c in others if not self._is_torque_sensor(c, taken)]
        rivals = [c for c in others if scores[c.name] > scores[taken.name] - CLOSE and not self._same(c, taken)]
        doubts = []
        for rival in rivals:
            own, other = (driven_by(c.values, velocity, acceleration) for c in (taken, rival))
            alike = rival.meaning.quantity == taken.meaning.quantity and own.inertia != 0.0
            ratio = other.inertia * self._size(rival) / (own.inertia * self._size(taken)) if alike else math.inf
            if abs(abs(ratio) - 1.0) < SAME_INERTIA and (own.share > PERFECT) == (other.share > PERFECT):
                continue  # it does not matter which
            doubts.append(rival)
            told = (f"{c.name!r} {100.0 * max(d.share, 0.0):.3g} %" for c, d in ((taken, own), (rival, other)))
            said = f"inertia and friction explain {', '.join(told)} (above 99 %: not measured, computed)"
            self._doubt(signal, said + (f"; by it the inertia is {ratio:.3g} times this" if alike else ""), ratio)
        if others:
            self._name_others(signal, taken, others, doubt=bool(doubts))
        return taken

    def _torque_sensor(self, found: dict[str, Column], velocity: Floats, acceleration: Floats) -> None:
        """A torque in a unit beside a current: measured by a sensor, or the current times a constant."""
        current = found.get(CURRENT_A) or found.get(COMMAND_A)
        hinted = self._hinted(MEASURED_TORQUE_NM) if MEASURED_TORQUE_NM in self.hints.roles else None
        if current is None or (hinted is None and MEASURED_TORQUE_NM in self.hints.roles):
            return
        torques = [c for c in self._candidates(MEASURED_TORQUE_NM, TORQUE, False) if self._is_torque_sensor(c, current)]
        torques = [c for c in torques if abs(relation(smoothed(bridged(c.values)), velocity).correlation) < SAME]
        column = hinted or next(iter(torques), None)
        if column is None or column.name in {c.name for s, c in found.items() if s == COMMAND_A}:
            return
        unit = column.unit or ("N" if self.linear else "Nm")
        factor = UNITS[unit].factor
        own = relation(column.values * factor, bridged(current.values) * self._size(current))
        if abs(own.correlation) > OF_THE_CURRENT and hinted is None and not names_a_sensor(column.name):
            self.remarks.append(
                f"{column.name!r} is {own.slope:.4g} Nm/A times {current.name!r}: the drive computed it, or "
                f"--torque-sensor {shlex.quote(column.name)}"
            )
        else:
            if found.get(CURRENT_A) is column:
                del found[CURRENT_A]
            factor = math.copysign(factor, own.slope) * (
                -1.0 if self._opposes(current, velocity, acceleration) else 1.0
            )
            evidence = f"measured beside {current.name!r}, {own.slope:.4g} times it (r = {own.correlation:.3f})"
            self._take(MEASURED_TORQUE_NM, column, unit, factor, evidence, column.unit is not None)

    @staticmethod
    def _opposes(column: Column, velocity: Floats, acceleration: Floats) -> bool:
        driven = driven_by(column.values, velocity, acceleration)
        return driven.against and driven.share > EXPLAINED

    def _likely(self, column: Column, velocity: Floats, acceleration: Floats, measured: bool) -> float:
        """Log of how likely a column drives the axis: by its heading, and by how inertia and friction explain it."""
        if abs(relation(smoothed(bridged(column.values)), velocity).correlation) > SAME:
            return ITSELF
        share = max(driven_by(column.values, velocity, acceleration).share, 0.0)
        said = MEASURED * (measured and column.meaning.measured) + QUANTITIES.get(column.meaning.quantity or "", 0.0)
        return said + EXPLAINS * share + (COMPUTED if measured and share > PERFECT else 0.0)

    def _is_torque_sensor(self, column: Column, input_: Column) -> bool:
        """Whether a column is a torque in a unit beside a current, and no multiple of it."""
        kinds = (TORQUE, CURRENT) if not self.linear else (FORCE, CURRENT)
        known = column.unit is not None and UNITS[column.unit].measures == kinds[0]
        return known and input_.meaning.quantity == CURRENT and not column.meaning.asked

    def _with_sign(self, column: Column, velocity: Floats, acceleration: Floats) -> Column:
        """An input with the sign in its highest bit, where inertia and friction explain that so much better.

        Friction lets a current jump through zero: its steps alone do not show the bit, as those of a velocity do.
        """
        if column.meaning.quantity is None and (known := register_of(column.values)) is not None:
            return column._replace(values=signed(column.values, known), register=known)
        found = sign_bit_of(column.values)
        if column.register is not None or found is None:
            return column
        values = signed(column.values, found)
        before, after = (driven_by(one, velocity, acceleration).share for one in (column.values, values))
        better = after > EXPLAINED and 1.0 - after < SIGN_GAIN * (1.0 - before)
        return column._replace(values=values, register=found) if better else column

    def _input_unit(self, column: Column) -> str:
        if column.unit is None:
            return {TORQUE: "N" if self.linear else "Nm", VOLTAGE: "V"}.get(column.meaning.quantity or "", "A")
        measures = UNITS[column.unit].measures
        return {TORQUE: "Nm", FORCE: "N", VOLTAGE: "V", SHARE: column.unit, COUNT: column.unit}.get(measures, "A")

    def _input(self, signal: str, column: Column, unit_of_inputs: str, velocity: Floats, acceleration: Floats) -> Guess:
        unit, sure = column.unit, column.unit is not None
        driven = driven_by(column.values, velocity, acceleration)
        evidence = f"{100.0 * max(driven.share, 0.0):.0f} % of it is inertia and friction"
        if unit is None and column.meaning.quantity == CURRENT:
            peak = float(np.nanquantile(np.abs(column.values), 0.99))
            unit = "A" if peak < LARGEST_A else "mA"
            low, high = PLAUSIBLE_A if unit == "A" else PLAUSIBLE_MA
            sure = low < peak < high and not are_whole(column.values)
            how = f"is {unit} by its peaks of {peak:.3g}" if sure or unit != "A" else "A is assumed"
            evidence = f"no unit is given, {how}; {evidence}"
        elif unit is None:
            evidence = f"no unit is given, {self._input_unit(column)} is assumed; {evidence}"
        factor = UNITS[unit].factor / UNITS[unit_of_inputs].factor if unit else 1.0
        if self._opposes(column, velocity, acceleration):
            factor, evidence = -factor, evidence + "; it opposes the motion, so its sign is reversed"
        return Guess(signal, column.name, unit or "-", factor, None, None, evidence, sure)

    def _temperature(self) -> None:
        column = self._pick(TEMPERATURE_DEGC, TEMPERATURE_OF, asked=False)
        if column is not None:
            evidence = "unit degC" if column.unit else "degC is assumed"
            low, high = float(np.nanmin(column.values)), float(np.nanmax(column.values))
            sure = column.unit is not None or (PLAUSIBLE_DEGC[0] < low and high < PLAUSIBLE_DEGC[1])
            self._take(TEMPERATURE_DEGC, column, column.unit or "degC", 1.0, evidence, sure)

"""Position and velocity of a log as one statement: their columns, units, wraps and signs, and the unit of the time.

Columns are chosen by what does not depend on units: words, the derivative of one being the other, what drives the axis
explaining the acceleration. Units are chosen together: of all that time, position and velocity may be in, those that
make the velocity the derivative of the position. Scores are logarithms of likelihoods; a close second is a doubt.
"""

from __future__ import annotations

import itertools
import math
import re
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from .candidates import (
    ENCODER_REV,
    POSITION_REV,
    TIME_S,
    VELOCITY_RPS,
    AnswerNeededError,
    Column,
    Option,
)
from .evidence import Driven, Wrap, are_whole, bridged, driven_by, likely_counts, relation, smooth_derivative, smoothed
from .names import INPUTS, POSITION, VELOCITY
from .times import NICE_RATE, PLAUSIBLE_HZ, RateNeededError, Times
from .units import ANGLE, COUNT, ELECTRIC, LENGTH, PACE, SHARE, UNITS

MOTIONS = {POSITION_REV, VELOCITY_RPS}
LIKE = 0.9  # correlation of a velocity with the derivative of the position
LEAST_LIKE = 0.5  # likewise: with less it is another one
CLOSE = 3.0  # of two statements, the log of a likelihood of 20: less is a doubt
MEASURED, BY_DEVICE = 3.5, -3.5  # log, of "actual" in a heading; of a heading that says a part of the motor alone
UNLIKE = 12.0  # log, of a correlation of 0 in place of 1
STANDS = 4.0  # log, of a joint whose range is a tenth of the least of one that moves
EXPLAINS = 5.0  # log, of all of what drives the axis in place of nothing of it
MISFIT, LEFT_OUT, OWN_UNIT = -8.0, -6.0, -5.5  # log: units contradict, no velocity, a scale that is no unit
SLOPE_SD = 0.01  # of the ratio of a velocity to the derivative of the position
SCALE_SD = 0.05  # likewise, of a velocity whose unit is written: a filter may have taken some of it
CONTRADICTING = 0.15  # likewise, beyond which units that are written contradict each other
LESS_USUAL = 0.3  # log, of each unit after the most usual
WHOLE_PAIRS = 0.05  # how far pole pairs may be from a whole number
FULL_TURNS = 3.0  # log, of a reference at whole turns
MOVES = 0.05  # of the largest range of positions in one unit: a joint that stands has less
PLAUSIBLE_RPS = 500.0  # 30,000 rpm: few motors turn faster
SPEED_UNITS = ("rps", "rpm", "rad/s", "deg/s")
ANGLE_UNITS = ("rad", "rev", "deg")
LENGTH_UNITS, PACE_UNITS = ("m", "mm", "um"), ("m/s", "mm/s")
COUNTER_WRAP = 256.0  # smallest range of a counter
CONTRADICTIONS = {  # what one column has to be multiplied by to be the derivative of the other
    180.0 / math.pi: "180/pi: one of them is in radians and called degrees, or the other way",
    2.0 * math.pi: "2 pi: one of them is in turns and called radians, or the other way",
    360.0: "360: one of them is in turns and called degrees, or the other way",
    60.0: "60: one of them is per minute and called per second, or the other way",
    60.0 / (2.0 * math.pi): "60/(2 pi): a speed in rad/s is called rpm, or the other way",
    6.0: "6: a speed in deg/s is called rpm, or the other way",
    10.0: "10: one of them is in tenths, or a decimal point is lost",
    1000.0: "1000: a thousandth of a unit, of one of them or of the time",
}


class Units(NamedTuple):
    """A statement of units: time, position and velocity, with the factors that the others make of those without one."""

    time: Option | None
    position: Option | None
    velocity: Option | None
    factors: tuple[float, float, float]  # of the three; 1 for none
    score: float


class Motions(Times):
    """Position and velocity: the columns, and with the time their units, wraps and signs."""

    _for_now = 1.0  # of the unit of the time while it is open

    def _motion_columns(self) -> tuple[Column | None, Column | None]:
        """Position and velocity: by their names, and of several by what moves, is a derivative, and is driven."""
        places = self._candidates(POSITION_REV, POSITION, asked=False)
        speeds = self._candidates(VELOCITY_RPS, VELOCITY, asked=False)
        named = bool(places or speeds)
        if not named:
            places = speeds = [c for c in self._free() if c.meaning.quantity is None and not c.meaning.aside]
        if named and len(places) < 2 and len(speeds) < 2:
            return next(iter(places), None), next(iter(speeds), None)
        driven = {c.name: self._driven(c) for c in (places or speeds)}
        scores: dict[tuple[str, str], float] = {}
        first: list[Column | None] = [*places] or [None]
        second: list[Column | None] = [*speeds] or [None]
        for place, speed in itertools.product(first, second):
            if place is speed:
                continue
            score = sum(self._said_and_moving(c, of) for c, of in ((place, places), (speed, speeds)) if c)
            if place is not None and speed is not None:
                rate = smooth_derivative(self._running(place), self._time_s())[0]
                alike = abs(relation(smoothed(bridged(speed.values)), rate).correlation)
                if not named and alike < LIKE:
                    continue
                score -= UNLIKE * (1.0 - alike)
            moving = place or speed
            assert moving is not None
            names = (place.name if place else "", speed.name if speed else "")
            scores[names] = score + EXPLAINS * max(driven[moving.name].share, 0.0)
        if not scores:
            return None, None
        best = max(scores, key=lambda pair: scores[pair])
        close = {name for pair in scores for name in pair if scores[pair] > scores[best] - CLOSE}
        for signal, name, every in ((POSITION_REV, best[0], places), (VELOCITY_RPS, best[1], speeds)):
            taken, others = self.columns.get(name), [c for c in every if c.name != name]
            if taken is None or not others or not named:
                continue
            rivals = [c for c in others if c.name in close and not self._same(c, taken)]
            self._name_others(signal, taken, others, doubt=bool(rivals))
            for rival in rivals if name in driven and driven[name].inertia else []:
                size = driven[rival.name].inertia / driven[name].inertia
                ratio = abs(size * self._size(taken) / self._size(rival))
                self._doubt(signal, f"by {rival.name!r} the inertia is {ratio:.3g} times this", ratio)
        return self.columns.get(best[0]), self.columns.get(best[1])

    def _driven(self, column: Column) -> Driven:
        """By a position or velocity, what inertia and friction explain of the input of which they explain the most."""
        level = self._running(column) if column.meaning.quantity != VELOCITY else bridged(column.values)
        rate, change = smooth_derivative(level, self._time_s())
        moved = (rate, change) if column.meaning.quantity != VELOCITY else (level, rate)
        inputs = [c for c in self._free() if c.meaning.quantity in INPUTS and not c.meaning.aside]
        found = [driven_by(c.values, *moved) for c in inputs]
        return max(found, key=lambda one: one.share, default=Driven(0.0, 0.0, False))

    def _said_and_moving(self, column: Column, others: list[Column]) -> float:
        """Log of what the heading says of a column, and of its range among numbered ones."""
        family = [c for c in others if re.sub(r"\d+", "#", c.name) == re.sub(r"\d+", "#", column.name)]
        largest = max(float(np.ptp(self._level(c))) for c in family)
        own = float(np.ptp(self._level(column))) / (MOVES * largest) if largest > 0.0 else 1.0
        said = MEASURED * column.meaning.measured + BY_DEVICE * column.meaning.by_device
        return said + (STANDS * math.log10(max(own, 1e-3)) if own < 1.0 else 0.0)

    def _motion_units(self, time: list[Option], position: Column | None, velocity: Column | None) -> None:
        """Units, wraps and signs of time, position and velocity, the likeliest of all that they may be together."""
        slope = alike = 0.0
        if position is not None and velocity is not None:
            rate, _ = smooth_derivative(self._running(position), self._time_s())
            slope, alike = relation(smoothed(bridged(velocity.values)), rate)
            if abs(alike) < LEAST_LIKE:
                self.remarks.append(
                    f"{velocity.name!r} is not the derivative of {position.name!r} (r = {alike:.2f}): it is left out"
                )
                self._doubt(POSITION_REV, f"it is not the integral of {velocity.name!r}")
                velocity = None
        jumps = None if position is None else self._wrap(position)
        places: list[Option | None] = [None] if position is None else [*self._units_of_place(position, jumps)]
        speeds: list[Option | None] = [None] if velocity is None else [*self._units_of_speed(velocity, position)]
        every = self._together(time, places, speeds, slope, alike)
        if not every:
            self._refuse_units(time, position, velocity)
        best, *others = every
        close = [one for one in others if one.score > best.score - CLOSE]
        open_ones = [
            any(abs(one.factors[k] / best.factors[k] - 1.0) > NICE_RATE for one in close if one[k] is not None)
            for k in range(3)
        ]
        both = ((position, best.position), (velocity, best.velocity))
        told = [f"{c.name!r} in {o.unit}" for c, o in both if c and o and o.unit == c.unit]
        by_motion = f"by {' and '.join(told)}" if len(told) == 2 else ""
        if best.time is not None:
            self._time_of(best, every, time, by_motion, open_ones[0])
        if position is not None and best.position is not None:
            self._position(position, velocity, best, jumps, open_ones[1])
        if velocity is not None:
            self._velocity(velocity, position, best, slope, alike, open_ones[2])
        fastest = float(np.quantile(np.abs(self._motion()[0]), 0.99)) if self.guesses.keys() & MOTIONS else 0.0
        if fastest > PLAUSIBLE_RPS and not self.linear:
            signal = POSITION_REV if POSITION_REV in self.guesses else VELOCITY_RPS
            if self.guesses[signal].column not in self.hints.units:
                pace = f"it moves at {fastest:.4g} rps, {60.0 * fastest:.4g} rpm"
                if position is not None and position.unit in (None, "counts") and are_whole(position.values):
                    pace += ": in counts, --counts-per-turn N"
                self._doubt(signal, pace, math.inf)

    def _together(
        self, time: list[Option], places: list[Option | None], speeds: list[Option | None], slope: float, alike: float
    ) -> list[Units]:
        """All statements of units, the likeliest first; at most one factor of each is what the others make it."""
        for_now = self._for_now = self.guesses[TIME_S].factor if time else 1.0
        both = places[0] is not None and speeds[0] is not None
        found = []
        able = itertools.product([*time] if time else [None], places, [*speeds, None] if both else speeds)
        for t, p, v in able:
            given = [1.0 if one is None else one.factor for one in (t, p, v)]
            score = sum(one.score for one in (t, p, v) if one is not None)
            free = [k for k, factor in enumerate(given) if factor is None]
            if both and v is None:
                score += LEFT_OUT
            if p is not None and p.factor is None and len(speeds) > 1:
                continue  # any unit of the velocity makes counts of a turn
            if free and (len(free) > 1 or p is None or v is None or abs(alike) < LIKE):
                continue
            if p is not None and v is not None:
                second, turn, speed = (1.0 if factor is None else factor for factor in given)
                ratio = abs(slope) * speed * (second / for_now if t is not None else 1.0) / turn
                if free:
                    given[free[0]] = (for_now / ratio, ratio, 1.0 / ratio)[free[0]]
                else:
                    sd = max(SCALE_SD if len(places) == len(speeds) == 1 else SLOPE_SD, 1.0 - abs(alike))
                    score += max(MISFIT, -0.5 * (math.log(ratio) / sd) ** 2)
            factors = tuple(1.0 if factor is None else factor for factor in given)
            found.append(Units(t, p, v, (factors[0], factors[1], factors[2]), score))
        return sorted(found, key=lambda one: -one.score)

    def _refuse_units(self, time: list[Option], position: Column | None, velocity: Column | None) -> None:
        """Nothing makes a factor of what has none."""
        if time and time[0].factor is None:
            raise RateNeededError(
                f"{self.source.path}: {self.guesses[TIME_S].column!r} counts rows and is no time, and nothing else "
                "says how many a second has: give --rate HZ",
                "--rate HZ",
            )
        if position is not None and position.unit == "counts":
            raise AnswerNeededError(
                f"{self.source.path}: the position is in counts, and nothing says how many make a turn: "
                "--counts-per-turn N",
                "--counts-per-turn N",
            )
        assert velocity is not None
        raise AnswerNeededError(
            f"{self.source.path}: column {velocity.name!r} is in electrical turns a minute: give --pole-pairs N",
            "--pole-pairs N",
        )

    def _time_of(self, best: Units, every: list[Units], time: list[Option], by_motion: str, doubtful: bool) -> None:
        """The time as the statement has it. Raises RateNeededError for rows at a rate that no log has."""
        assert best.time is not None
        if best.time.factor is None and not PLAUSIBLE_HZ[0] <= 1.0 / best.factors[0] <= PLAUSIBLE_HZ[1]:
            self._refuse_units(time, None, None)
        written = self.columns[self.guesses[TIME_S].column].unit
        moved = by_motion and best.velocity is not None and len(time) > 1 and best.time.unit != written
        said = f"{best.time.unit}, {by_motion}; " if moved else ""
        option = (
            best.time._replace(said=best.time.said.partition("in " + best.time.unit + " the rate")[0])
            if moved
            else best.time
        )
        called = written in (None, best.time.unit) or written not in UNITS or best.time.factor is None
        self._time_taken(
            option, best.factors[0], said or (by_motion if best.time.factor is None else ""), called and not doubtful
        )

    def _motion(self) -> tuple[Floats, Floats]:
        """Velocity and acceleration (n,) in our units."""
        time_s = self._time_s()
        guess = self.guesses.get(POSITION_REV)
        if guess is not None:
            return smooth_derivative(self._running(self.columns[guess.column]) * guess.factor, time_s)
        own = self.guesses[VELOCITY_RPS]
        velocity = bridged(self.columns[own.column].values) * own.factor
        return velocity, smooth_derivative(velocity, time_s)[0]

    def _units_of_place(self, column: Column, jumps: Wrap | None) -> list[Option]:
        """The units that a position may be in: what is written or given, else by its wrap, else any."""
        wrap = None if jumps is None else jumps.at
        unit, counts = column.unit, self.hints.counts_per_turn
        measures = UNITS[unit].measures if unit else None
        if self.linear:
            if unit and measures == LENGTH:
                return [Option(unit, UNITS[unit].factor, 0.0, f"unit {unit}")]
            return [Option(u, UNITS[u].factor, -LESS_USUAL * k, u) for k, u in enumerate(LENGTH_UNITS)]
        if measures == COUNT or (unit is None and counts is not None):
            if counts is not None:
                return [Option("counts", 1.0 / counts, 0.0, f"{counts:g} counts a turn, as given")]
            free = Option("counts", None, 0.0, "")
            turn = (
                [] if wrap is None else [Option("counts", 1.0 / wrap, OWN_UNIT, "one wrap is assumed to be one turn")]
            )
            return [free, *turn]
        if unit is not None and measures != SHARE:
            return [Option(unit, UNITS[unit].factor, 0.0, f"unit {unit}")]
        turns = {u: 1.0 / UNITS[u].factor for u in ANGLE_UNITS}
        wraps = [u for u, turn in turns.items() if wrap and any(abs(wrap / (k * turn) - 1.0) < 1e-6 for k in (1, 2))]
        if wraps:
            return [Option(u, UNITS[u].factor, 0.0, f"{u}, because it wraps at {wrap:.6g}") for u in wraps]
        if wrap is not None and wrap >= COUNTER_WRAP:
            raise AnswerNeededError(
                f"{self.source.path}: the position looks like counts (it wraps at {wrap:g}): "
                "--counts-per-turn N, and --unit COLUMN=counts",
                "--counts-per-turn N",
            )
        hint = self._full_turn()
        angles = [
            Option("rad", UNITS["rad"].factor, FULL_TURNS, f"rad, as {hint}")
            if hint and u == "rad"
            else Option(u, UNITS[u].factor, -LESS_USUAL * k, u)
            for k, u in enumerate(ANGLE_UNITS)
        ]
        return [*angles, Option("counts", None, OWN_UNIT, "")] if are_whole(column.values) else angles

    def _units_of_speed(self, column: Column, position: Column | None) -> list[Option]:
        """The units that a velocity may be in: what is written, else any; beside a position one of its own as well."""
        unit = column.unit
        measures = UNITS[unit].measures if unit else None
        if self.linear:
            if unit and measures == PACE:
                return [Option(unit, UNITS[unit].factor, 0.0, f"unit {unit}")]
            how = "is assumed" if position is None else "by the derivative of the position"
            return [
                Option(u, UNITS[u].factor, -LESS_USUAL * k, f"{u}, {how}" if position else f"{u} {how}")
                for k, u in enumerate(PACE_UNITS)
            ]
        if unit == ELECTRIC and self.hints.pole_pairs is None:
            return [Option(ELECTRIC, None, 0.0, "")]
        if unit is not None and measures not in (COUNT, SHARE):
            said = f"unit {unit}" + (f" of {self.hints.pole_pairs} pole pairs" if unit == ELECTRIC else "")
            return [Option(unit, self._factor(unit), 0.0, said)]
        if position is None:
            every = ("rad/s", *(u for u in SPEED_UNITS if u != "rad/s"))
            return [Option(u, UNITS[u].factor, -LESS_USUAL * k, f"{u} is assumed") for k, u in enumerate(every)]
        known_ones = [Option(u, UNITS[u].factor, 0.0, f"{u}, by the derivative of the position") for u in SPEED_UNITS]
        return [*known_ones, Option("-", None, OWN_UNIT, "scaled by the derivative of the position")]

    def _full_turn(self) -> str | None:
        """A reference that stands at whole multiples of 2 pi: a speed in rad/s that somebody meant in turns."""
        for c in self.columns.values():
            if c.meaning.asked and c.meaning.quantity == VELOCITY:
                level = float(np.nanmedian(np.abs(c.values)))
                turns = level / (2.0 * math.pi)
                if turns > 0.05 and abs(turns * 2.0 - round(turns * 2.0)) < 1e-4 and round(turns * 2.0) > 0:
                    return f"{c.name!r} stands at {level:.6g}, {turns:.3g} times 2 pi"
        return None

    def _position(
        self, column: Column, velocity: Column | None, best: Units, jumps: Wrap | None, doubtful: bool
    ) -> None:
        option, factor, said = best.position, best.factors[1], ""
        assert option is not None
        told = "" if velocity is None or best.velocity is None else f"by {velocity.name!r} in {best.velocity.unit}"
        if option.factor is None:
            whole = likely_counts(1.0 / factor)
            factor, said = 1.0 / whole, f"{whole:g} counts a turn, {told}"
        elif option.said == option.unit:  # nothing of the column itself says it
            said = f"{option.unit}, {told}" if told and not doubtful else f"{option.unit} is assumed"
        sure = not doubtful and "assumed" not in (said or option.said)
        evidence = [said or option.said]
        if jumps is not None:
            evidence.append(_said_of(jumps))
            sure = sure and jumps.sure
        self._take(
            POSITION_REV, column, option.unit, factor, ", ".join(evidence), sure, None if jumps is None else jumps.at
        )

    def _velocity(
        self, column: Column, position: Column | None, best: Units, slope: float, alike: float, doubtful: bool
    ) -> None:
        """A velocity in the unit of the statement; one that contradicts the position is left out and asked about."""
        option, factor = best.velocity, best.factors[2]
        own = None if position is None else self.guesses[POSITION_REV]
        if own is None:
            assert option is not None
            self._take(
                VELOCITY_RPS, column, option.unit, factor, option.said, not doubtful and "assumed" not in option.said
            )
            return
        second = best.factors[0] / self._for_now if best.time is not None else 1.0
        if option is None:
            unit = column.unit or "its own unit"
            given = UNITS[column.unit].factor if column.unit else 1.0
            return self._contradicts(column, unit, slope * given * second / own.factor)
        said, sure = option.said, not doubtful and own.sure
        if option.unit == ELECTRIC and option.factor is None:
            pairs = UNITS[ELECTRIC].factor / factor
            if not own.sure or round(pairs) < 1 or abs(pairs / round(pairs) - 1.0) > WHOLE_PAIRS:
                self._refuse_units([], None, column)
            factor = UNITS[ELECTRIC].factor / round(pairs)
            said = f"{round(pairs)} pole pairs, by the derivative of the position"
        elif column.unit == option.unit:
            sure = not doubtful
        if option.factor is None:
            sure = sure and (abs(alike) > LIKE)
        ratio = slope * factor * second / own.factor
        if abs(abs(ratio) - 1.0) > CONTRADICTING:
            return self._contradicts(column, option.unit, ratio)
        evidence = f"{said}; r = {alike:.3f} with the derivative of the position"
        if slope < 0.0:
            factor, evidence = -factor, evidence + ", sign reversed"
        self._take(VELOCITY_RPS, column, option.unit, factor, evidence, sure)
        return None

    def _contradicts(self, column: Column, unit: str, ratio: float) -> None:
        """A velocity that its unit keeps from being the derivative of the position: it is left out."""
        own, size = self.guesses[POSITION_REV], max(abs(ratio), 1.0 / abs(ratio))
        meant = next((text for at, text in CONTRADICTIONS.items() if abs(size / at - 1.0) < NICE_RATE), None)
        if meant is None and round(size) > 1 and abs(size / round(size) - 1.0) < NICE_RATE:
            side = "output" if abs(ratio) > 1.0 else "motor"
            meant = f"a gear of {size:.0f} (the angle is that of the {side}), or {size:.0f} pole pairs"
        told = f"{column.name!r} in {unit} is {ratio:.4g} times the derivative of {own.column!r} in {own.unit}"
        self.remarks.append(f"{told}: it is left out")
        if own.column not in self.hints.units:
            self._doubt(POSITION_REV, f"{told} ({meant or 'which no unit explains'})", ratio)

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
        wrap, sure = (None, True) if jumps is None else (jumps.at, jumps.sure)
        self._take(ENCODER_REV, hinted, hinted.unit or "-", own, evidence, sure, wrap)


def _said_of(wrap: Wrap) -> str:
    """What the jumps of a position mean, in words."""
    if wrap.sure:
        return f"wraps at {wrap.at:.6g}, unwrapped"
    meant = "neither a turn nor a known range" if wrap.at is None else f"unwrapped at {wrap.at:.6g} by assumption"
    return f"jumps by {wrap.jump:.6g}, {meant} (--counts-per-turn N, --unit COLUMN=UNIT)"

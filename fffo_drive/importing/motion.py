"""Position and velocity of a log: the columns, their units, wraps and signs."""

from __future__ import annotations

import math
import re

import numpy as np

from ..arrays import Floats
from .candidates import ENCODER_REV, POSITION_REV, VELOCITY_RPS, AnswerNeededError, Column
from .evidence import Wrap, bridged, likely_counts, relation, smooth_derivative, smoothed
from .names import POSITION, VELOCITY
from .times import LIKE, NICE_RATE, SLOPE_TOLERANCE, Times
from .units import ANGLE, COUNT, ELECTRIC, LENGTH, PACE, SHARE, SPEED, UNITS

MOTIONS = {POSITION_REV, VELOCITY_RPS}
NEAREST = 0.5  # of the distance of the second: two pairs of units may both be within the tolerance
MOVES = 0.05  # of the largest range of positions in one unit: a joint that stands has less
PLAUSIBLE_RPS = 500.0  # 30,000 rpm: few motors turn faster
SPEED_UNITS = {u: 1.0 / UNITS[u].factor for u in ("rps", "rpm", "rad/s", "deg/s")}  # of one turn a second
ANGLE_UNITS = {u: 1.0 / UNITS[u].factor for u in ("rev", "rad", "deg")}  # of one turn
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


class Motions(Times):
    """Position and velocity: units, wraps and signs of each from what is known of the other."""

    def _named_motion(self) -> tuple[Column | None, Column | None]:
        """Position and velocity by their names; of several those that move, one the derivative of the other."""
        places = self._moving(self._candidates(POSITION_REV, POSITION, asked=False))
        speeds = self._moving(self._candidates(VELOCITY_RPS, VELOCITY, asked=False))
        if len(places) < 2 and len(speeds) < 2:
            return next(iter(places), None), next(iter(speeds), None)
        time_s = self._time_s()
        rates = {c.name: smooth_derivative(self._running(c), time_s)[0] for c in places}
        alike = {
            (p.name, v.name): abs(relation(smoothed(bridged(v.values)), rates[p.name]).correlation)
            for p in places
            for v in speeds
        }
        fitting = [pair for pair, r in alike.items() if r > LIKE]
        best = next(iter(fitting or sorted(alike, key=lambda pair: -alike[pair])), ("", ""))
        place = next((c for c in places if c.name == best[0]), next(iter(places), None))
        speed = next((c for c in speeds if c.name == best[1]), next(iter(speeds), None))
        for signal, taken, all_of in ((POSITION_REV, place, places), (VELOCITY_RPS, speed, speeds)):
            others = [c for c in all_of if c is not taken]
            if taken is not None and others:
                told = {name for pair in fitting for name in pair}
                rivals = [c for c in others if not fitting or c.name in told] if alike else others
                rivals = [
                    c for c in rivals if not self._same(c, taken) and c.meaning.measured >= taken.meaning.measured
                ]
                self._name_others(signal, taken, others, doubt=bool(rivals))
        return place, speed

    def _moving(self, candidates: list[Column]) -> list[Column]:
        """Of numbered joints those that move: one that stands is within a small share of the largest range."""
        alike = [re.sub(r"\d+", "#", c.name) for c in candidates]
        ranges = [float(np.ptp(self._level(c))) for c in candidates]
        largest = [max(r for r, other in zip(ranges, alike, strict=True) if other == one) for one in alike]
        return [c for c, own, most in zip(candidates, ranges, largest, strict=True) if own >= MOVES * most]

    def _pair_by_data(self) -> tuple[Column | None, Column | None]:
        """Of columns without a name, the pair of which one is the derivative of the other."""
        time_s = self._time_s()
        free = [c for c in self._free() if c.meaning.quantity is None and not c.meaning.aside]
        best: tuple[float, Column, Column] | None = None
        for one in free:
            rate, _ = smooth_derivative(self._running(one), time_s)
            for other in free:
                if other is not one:
                    alike = abs(relation(smoothed(bridged(other.values)), rate).correlation)
                    if alike > LIKE and (best is None or alike > best[0]):
                        best = (alike, one, other)
        return (None, None) if best is None else best[1:]

    def _motion_units(self, position: Column | None, velocity: Column | None) -> None:
        """Units, wraps and signs of position and velocity, each from what is known of the other."""
        slope = alike = None
        if position is not None and velocity is not None:
            rate, _ = smooth_derivative(self._running(position), self._time_s())
            slope, alike = relation(smoothed(bridged(velocity.values)), rate)
            if abs(alike) < 0.5:
                self.remarks.append(
                    f"{velocity.name!r} is not the derivative of {position.name!r} (r = {alike:.2f}): it is left out"
                )
                self._doubt(POSITION_REV, f"it is not the integral of {velocity.name!r}")
                velocity = slope = alike = None
        if position is not None:
            self._position(position, velocity, slope)
        if velocity is not None:
            self._velocity(velocity, position, slope, alike)
        fastest = float(np.quantile(np.abs(self._motion()[0]), 0.99)) if self.guesses.keys() & MOTIONS else 0.0
        if fastest > PLAUSIBLE_RPS and not self.linear:
            signal = POSITION_REV if POSITION_REV in self.guesses else VELOCITY_RPS
            if self.guesses[signal].column not in self.hints.units:
                self._doubt(signal, f"it moves at {fastest:.4g} rps, {60.0 * fastest:.4g} rpm")

    def _motion(self) -> tuple[Floats, Floats]:
        """Velocity and acceleration (n,) in our units."""
        time_s = self._time_s()
        guess = self.guesses.get(POSITION_REV)
        if guess is not None:
            return smooth_derivative(self._running(self.columns[guess.column]) * guess.factor, time_s)
        own = self.guesses[VELOCITY_RPS]
        velocity = bridged(self.columns[own.column].values) * own.factor
        return velocity, smooth_derivative(velocity, time_s)[0]

    def _position(self, column: Column, velocity: Column | None, slope: float | None) -> None:
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
        self._take(POSITION_REV, column, unit, factor, ", ".join(evidence), sure, wrap)

    def _counts(
        self, wrap: float | None, velocity: Column | None, slope: float | None, given: float | None
    ) -> tuple[float, str]:
        """Counts of a turn: as given, by a velocity whose unit is known, or one wrap."""
        if given is not None:
            return given, f"{given:g} counts a turn, as given"
        if velocity is not None and self._known(velocity, SPEED) and slope:
            found = 1.0 / (self._factor(velocity.unit) * abs(slope))
            whole = likely_counts(found)
            return whole, f"{whole:g} counts a turn, by {velocity.name!r} in {velocity.unit}"
        if wrap is not None:
            return wrap, ""
        raise AnswerNeededError(
            f"{self.source.path}: the position is in counts, and nothing says how many make a turn: "
            "--counts-per-turn N",
            "--counts-per-turn N",
        )

    def _angle_unit(self, wrap: float | None, velocity: Column | None, slope: float | None) -> tuple[str, str, bool]:
        """The unit of an angle that the file does not say: by its wrap, by the velocity, or rad by assumption."""
        for unit, turn in ANGLE_UNITS.items():
            if wrap is not None and any(abs(wrap / (k * turn) - 1.0) < 1e-6 for k in (1, 2)):
                return unit, f"{unit}, because it wraps at {wrap:.6g}", True
        if wrap is not None and wrap >= 256.0:
            raise AnswerNeededError(
                f"{self.source.path}: the position looks like counts (it wraps at {wrap:g}): "
                "--counts-per-turn N, and --unit COLUMN=counts",
                "--counts-per-turn N",
            )
        if velocity is not None and self._known(velocity, SPEED) and slope:
            turn = 1.0 / (self._factor(velocity.unit) * abs(slope))  # of the position's own unit
            found = next((u for u, size in ANGLE_UNITS.items() if abs(turn / size - 1.0) < SLOPE_TOLERANCE), None)
            if found is None:
                raise AnswerNeededError(
                    f"{self.source.path}: a turn is {turn:.5g} of the position's unit by {velocity.name!r} in "
                    f"{velocity.unit}: say --counts-per-turn {likely_counts(turn):g}, or the unit of one of them",
                    f"--counts-per-turn {likely_counts(turn):g}",
                )
            return found, f"{found}, by {velocity.name!r} in {velocity.unit}", True
        if slope and velocity is not None and velocity.unit != ELECTRIC:
            away = {
                (a, b): abs(abs(slope) * turn / speed - 1.0)
                for a, turn in ANGLE_UNITS.items()
                for b, speed in SPEED_UNITS.items()
            }
            pairs = sorted((pair for pair in away if away[pair] < SLOPE_TOLERANCE), key=lambda pair: away[pair])
            if pairs and all(away[pairs[0]] < NEAREST * away[other] for other in pairs[1:]):
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

    def _velocity(self, column: Column, position: Column | None, slope: float | None, alike: float | None) -> None:
        unit, sure, evidence = column.unit, True, ""
        own = POSITION_REV if position is not None else ""
        if self.linear:
            known = unit is not None and UNITS[unit].measures == PACE
            unit = unit if known and unit else "m/s"
            evidence, sure = f"unit {unit}", known or slope is not None
        elif unit == ELECTRIC and self.hints.pole_pairs is None:
            return self._electric_velocity(column, slope if own else None)
        elif unit is not None and UNITS[unit].measures not in (COUNT, SHARE):
            evidence = f"unit {unit}" + (f" of {self.hints.pole_pairs} pole pairs" if unit == ELECTRIC else "")
        elif slope and own:
            turns = abs(slope) / self.guesses[own].factor  # of its unit, at a turn a second
            able = {u: size for u, size in SPEED_UNITS.items() if abs(turns / size - 1.0) < SLOPE_TOLERANCE}
            unit = next(iter(able), "")
            if not unit:
                return self._odd_velocity(column, slope, alike or 0.0)
            evidence, sure = f"{unit}, by the derivative of the position", self.guesses[own].sure
        else:
            unit, evidence, sure = "rad/s", "rad/s is assumed", False
        factor = self._factor(unit)
        if slope and own:
            ratio = slope * factor / self.guesses[own].factor
            if abs(abs(ratio) - 1.0) > 3.0 * SLOPE_TOLERANCE:
                return self._contradicts(column, unit, ratio)
            evidence += f"; r = {alike:.3f} with the derivative of the position"
            if slope < 0.0:
                factor, evidence = -factor, evidence + ", sign reversed"
        self._take(VELOCITY_RPS, column, unit, factor, evidence, sure)
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
            self._doubt(POSITION_REV, f"{told} ({meant or 'which no unit explains'})")

    def _electric_velocity(self, column: Column, slope: float | None) -> None:
        """A velocity in electrical turns of a motor whose pole pairs nobody gave: the position tells them."""
        known = slope is not None and self.guesses[POSITION_REV].sure
        pairs = abs(slope or 0.0) * UNITS[ELECTRIC].factor / self.guesses[POSITION_REV].factor if known else 0.0
        if round(pairs) < 1 or abs(pairs / round(pairs) - 1.0) > SLOPE_TOLERANCE:
            raise AnswerNeededError(
                f"{self.source.path}: column {column.name!r} is in electrical turns a minute: give --pole-pairs N",
                "--pole-pairs N",
            )
        factor = math.copysign(UNITS[ELECTRIC].factor / round(pairs), slope or 1.0)
        evidence = f"{round(pairs)} pole pairs, by the derivative of the position"
        self._take(VELOCITY_RPS, column, ELECTRIC, factor, evidence, self.guesses[POSITION_REV].sure)

    def _odd_velocity(self, column: Column, slope: float, alike: float) -> None:
        """A velocity in a unit of its own: scaled by the position."""
        own = self.guesses[POSITION_REV]
        factor = own.factor / slope
        evidence = f"scaled by the derivative of the position; r = {alike:.3f} with it"
        self._take(VELOCITY_RPS, column, "-", factor, evidence, abs(alike) > LIKE and own.sure)

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

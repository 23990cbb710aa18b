"""The time of a log: which column, in which unit, and where a new run begins."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from ..arrays import Floats
from .candidates import POSITION_REV, TIME_S, VELOCITY_RPS, AnswerNeededError, Candidates, Column, Hints
from .evidence import (
    DAY_S,
    begins_anew,
    bridged,
    counts_rows,
    is_time,
    relation,
    rises,
    smooth_derivative,
    smoothed,
    stamp_wrap_of,
    unwrapped,
)
from .names import POSITION, VELOCITY
from .source import Source
from .units import ANGLE, COUNT, LENGTH, PACE, SPEED, TIME, UNITS

PLAUSIBLE_HZ = (5.0, 50_000.0)  # of the rate of a log
LIKE = 0.9  # correlation of a velocity with the derivative of the position
LEAST_STEPPING = 0.5  # of the stamps; with fewer the clock is coarser than the sampling
SLOPE_TOLERANCE = 0.05
NICE_RATE = 0.005  # how far a rate from a motion may be from a round one


FIRST_TRUE_CLOCK = datetime(2000, 1, 1, tzinfo=UTC)  # a log with an earlier time counts from its own zero
LAST_TRUE_CLOCK = datetime(2100, 1, 1, tzinfo=UTC)  # later ones are counts of something else


def clock_time(seconds: float) -> datetime | None:
    """A time on a clock that counts from 1970, UTC; None for one that counts from something else."""
    if not FIRST_TRUE_CLOCK.timestamp() <= seconds < LAST_TRUE_CLOCK.timestamp():
        return None
    return datetime.fromtimestamp(seconds, UTC)


class RateNeededError(AnswerNeededError):
    """Nothing in a log says how fast it was sampled: `Hints.rate_hz` does."""


class Times(Candidates):
    """The time of a log: stamps with their unit, or rows that a rate makes one."""

    def time_column(self) -> Column | None:
        """The column of time: as given, by its name, or one that rises as stamps do; a count of rows last."""
        columns = list(self.columns.values())
        hinted = self._hinted(TIME_S)
        named = [c for c in columns if c.meaning.quantity == TIME and rises(c.values)]
        first = columns[:1] if columns and columns[0].meaning.quantity is None and is_time(columns[0].values) else []
        anywhere = [c for c in columns if c.meaning.quantity is None and is_time(c.values)]
        found = sorted([*named, *first, *anywhere], key=self._is_row_number)
        return next(iter([hinted] if hinted else found), None)

    def _is_row_number(self, column: Column) -> bool:
        timed = column.unit is not None and UNITS[column.unit].measures == TIME
        return not timed and counts_rows(column.values)

    def _time(self) -> float | None:
        if self.hints.rate_hz is not None:
            return 1.0 / self.hints.rate_hz
        found = self.time_column()
        if found is None or self._is_row_number(found):
            return self._rate_without_time(found)
        steps = np.abs(np.diff(found.values[np.isfinite(found.values)]))
        if not float(np.mean(steps > 0.0) if steps.size else 0.0) > LEAST_STEPPING:
            raise RateNeededError(
                f"{self.source.path}: column {found.name!r} repeats in most rows, the stamps are rounded: "
                "give --rate HZ",
                "--rate HZ",
            )
        unit, evidence, sure = self._time_unit(found, float(np.median(steps)))
        wrap = stamp_wrap_of(found.values, DAY_S / UNITS[unit].factor)
        rate_hz = 1.0 / (float(np.median(steps)) * UNITS[unit].factor)
        evidence += f"{rate_hz:.6g} Hz" + (f", wraps at {wrap:g}" if wrap else "")
        self._take(TIME_S, found, unit, UNITS[unit].factor, evidence, sure, wrap)
        return None

    def _rate_without_time(self, counter: Column | None) -> float | None:
        """The period of a log whose rows are counted at most: as the file declares, or by a motion with units."""
        declared = self.source.period_s
        if declared is not None:
            self.remarks.append(f"no column of time: {1.0 / declared:.6g} Hz, as the file declares")
            return declared
        if counter is None:
            self._refuse("no time", "--time COLUMN or --rate HZ", RateNeededError)
        rate_hz, pair = self._per_second(np.arange(self.source.rows, dtype=np.float64))
        if rate_hz is None or not PLAUSIBLE_HZ[0] <= rate_hz <= PLAUSIBLE_HZ[1]:
            raise RateNeededError(
                f"{self.source.path}: {counter.name!r} counts rows and is no time, and nothing else says how many a "
                "second has: give --rate HZ",
                "--rate HZ",
            )
        nice = [float(f"{rate_hz:.2g}"), 1e3 / round(1e3 / rate_hz) if rate_hz < 1e3 else rate_hz]
        rate_hz = next((one for one in nice if abs(rate_hz / one - 1.0) < NICE_RATE), rate_hz)
        evidence = f"it counts rows; {rate_hz:.6g} Hz, by {pair}"
        self._take(TIME_S, counter, "-", 1.0 / rate_hz, evidence, True, stamp_wrap_of(counter.values))
        return None

    def _time_unit(self, column: Column, step: float) -> tuple[str, str, bool]:
        """The unit of stamps, its evidence, and whether it is sure: by a plausible rate, or by a motion with units."""
        unit = column.unit if column.unit and UNITS[column.unit].measures == TIME else None
        whole = bool(np.array_equal(column.values, np.round(column.values)))
        order = ("ms", "us", "ns", "s") if whole else ("s", "ms", "us", "ns")
        rates = {u: 1.0 / max(step * UNITS[u].factor, 1e-300) for u in order}
        able = [u for u in order if PLAUSIBLE_HZ[0] <= rates[u] <= PLAUSIBLE_HZ[1]]
        if unit is not None and (column.name in self.hints.units or unit not in rates or unit in able or not able):
            return unit, f"unit {unit}, ", True
        per_second, pair = self._per_second(self._going_on(column.values)) if len(able) > 1 or unit else (None, "")
        moved = [u for u in able if per_second and abs(per_second * UNITS[u].factor - 1.0) < SLOPE_TOLERANCE]
        wrong = f"in {unit}, as it is called, it would be {rates[unit]:.4g} Hz; " if unit else ""
        if moved:
            return moved[0], f"{wrong}{moved[0]}, by {pair}; ", not wrong
        found = able[0] if able else "s"
        others = [f"in {u} it would be {rates[u]:.4g} Hz" for u in able[1:]]
        sure = not wrong and (len(able) == 1 or (found == "s" and not whole))
        return found, wrong + "; ".join([f"in {found} the rate is plausible", *others]) + "; ", sure

    def _per_second(self, raw: Floats) -> tuple[float | None, str]:
        """How much of `raw` (n,), which rises, a second is, and the position and velocity with units that say so."""
        best: tuple[float, float, str] | None = None
        speeds = [c for c in self._candidates(VELOCITY_RPS, VELOCITY, asked=False) if self._known(c, SPEED, PACE)]
        for place in self._candidates(POSITION_REV, POSITION, asked=False):
            if not speeds or not self._known(place, ANGLE, LENGTH, COUNT):
                continue
            rate = smooth_derivative(self._running(place) * self._factor(place.unit), raw)[0]
            for speed in speeds:
                slope, alike = relation(smoothed(bridged(speed.values)) * self._factor(speed.unit), rate)
                if abs(alike) > LIKE and (best is None or abs(alike) > best[0]):
                    best = (
                        abs(alike),
                        abs(slope),
                        f"{place.name!r} in {place.unit} and {speed.name!r} in {speed.unit}",
                    )
        return (None, "") if best is None else best[1:]

    @staticmethod
    def _going_on(raw: Floats) -> Floats:
        """Stamps for derivatives, in their own unit: as if a log that begins anew went on."""
        steps = np.diff(bridged(raw))
        usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0
        steps = np.where(steps < 0.0, usual, steps)
        return np.asarray(np.concatenate([[0.0], np.cumsum(steps)]) + np.arange(raw.size) * usual * 1e-9)

    def _time_s(self) -> Floats:
        """Stamps for derivatives: an even grid where they do not rise."""
        guess = self.guesses.get(TIME_S)
        rows = self.source.rows
        if guess is None:
            period_s = 1.0 / self.hints.rate_hz if self.hints.rate_hz else self.source.period_s or 1.0
            return np.asarray(np.arange(rows) * period_s, dtype=np.float64)
        raw = self.source.columns[guess.column]
        return self._going_on((unwrapped(raw, guess.wrap) if guess.wrap else raw) * guess.factor)


def runs_of(source: Source, hints: Hints) -> list[Source]:
    """The runs that a log holds, each as a source of its own: a new one begins where the clock does.

    A run that is the same as the one before, of a log that was written twice, is left out and named.
    """
    column = None if hints.rate_hz else Times(source, hints).time_column()
    if column is None or stamp_wrap_of(column.values, _day(column)):
        return [source]
    runs: list[Source] = []
    found = begins_anew(column.values)
    for number, part in enumerate(found, 1):
        one = source.part(part, number if len(found) > 1 else 0)
        if runs and all(np.array_equal(v, one.columns[n], equal_nan=True) for n, v in runs[-1].columns.items()):
            runs[-1] = replace(runs[-1], remarks=(*runs[-1].remarks, f"run {number} is the same and is left out"))
            continue
        runs.append(one)
    return runs


def _day(column: Column) -> float:
    """A day in the unit of a time."""
    known = column.unit is not None and UNITS[column.unit].measures == TIME
    return DAY_S / (UNITS[column.unit].factor if known and column.unit else 1.0)

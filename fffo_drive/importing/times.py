"""The time of a log: which column, in which unit, and where a new run begins."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from ..arrays import Floats
from .candidates import TIME_S, AnswerNeededError, Candidates, Column, Hints, Option
from .evidence import (
    DAY_S,
    are_whole,
    begins_anew,
    bridged,
    counts_rows,
    is_time,
    rises,
    stamp_wrap_of,
    unwrapped,
)
from .source import Source
from .units import TIME, UNITS

PLAUSIBLE_HZ = (5.0, 50_000.0)  # of the rate of a log
LEAST_STEPPING = 0.5  # of the stamps; with fewer the clock is coarser than the sampling
ROUNDED = 2.5  # median steps: what rounding makes of one
IMPLAUSIBLE, LIE, UNLIKELY = -8.0, -5.0, -4.0  # log of a rate that no log has, of a wrong heading, of ms with digits
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
        found = sorted([*named, *first, *anywhere], key=lambda c: (self._is_row_number(c), not _goes_on(c.values)))
        return next(iter([hinted] if hinted else found), None)

    def _is_row_number(self, column: Column) -> bool:
        timed = column.unit is not None and UNITS[column.unit].measures == TIME
        return not timed and counts_rows(column.values)

    def _time(self) -> list[Option]:
        """The units that the time may be in; the likeliest is first and taken for now. None where a rate is known."""
        if self.hints.rate_hz is not None:
            return []
        found = self.time_column()
        counted = found is None or self._is_row_number(found)
        if counted and self.source.period_s is not None:
            self.remarks.append(f"no column of time: {1.0 / self.source.period_s:.6g} Hz, as the file declares")
            return []
        if found is None:
            self._refuse("no time", "--time COLUMN or --rate HZ", RateNeededError)
        steps = np.abs(np.diff(found.values[np.isfinite(found.values)]))
        if not _goes_on(found.values):
            raise RateNeededError(
                f"{self.source.path}: column {found.name!r} repeats in most rows, the stamps are rounded: "
                "give --rate HZ",
                "--rate HZ",
            )
        within = steps[steps < ROUNDED * np.median(steps)]  # without the gaps; stamps may be rounded
        options = [Option("-", None, 0.0, "it counts rows; ")]
        if not counted:
            options = self._units_of_time(found, float(within.mean()))
        self._take(TIME_S, found, options[0].unit, options[0].factor or 1.0, "", True)
        return options

    def _units_of_time(self, column: Column, step: float) -> list[Option]:
        unit = column.unit if column.unit and UNITS[column.unit].measures == TIME else None
        whole = are_whole(column.values)
        order = ("ms", "us", "ns", "s") if whole else ("s", "ms", "us", "ns")
        rates = {u: 1.0 / max(step * UNITS[u].factor, 1e-300) for u in (unit, *order) if u is not None}
        able = [u for u in rates if PLAUSIBLE_HZ[0] <= rates[u] <= PLAUSIBLE_HZ[1]]
        if unit is not None and (column.name in self.hints.units or not able):
            return [Option(unit, UNITS[unit].factor, 0.0, f"unit {unit}, ")]
        wrong = f"in {unit}, as it is called, it would be {rates[unit]:.4g} Hz; " if unit else ""
        found = []
        for u in rates:
            score = (0.0 if u in able else IMPLAUSIBLE) + (LIE if unit and u != unit else 0.0)
            said = f"unit {unit}, " if u == unit else wrong + f"in {u} the rate is plausible; "
            if unit is None and u in able:
                others = "".join(f"in {o} it would be {rates[o]:.4g} Hz; " for o in able if o != u)
                score += UNLIKELY * min(1, able.index(u)) if not whole and order[0] in able else -float(able.index(u))
                said = f"in {u} the rate is plausible; {others}"
            found.append(Option(u, UNITS[u].factor, score, said))
        return sorted(found, key=lambda one: -one.score)

    def _time_taken(self, option: Option, factor: float, said: str, sure: bool) -> None:
        """The time in the unit that was found, with its rate and where it begins anew."""
        column = self.columns[self.guesses[TIME_S].column]
        if option.factor is None:
            per_second = 1.0 / factor
            nice = [float(f"{per_second:.2g}"), 1e3 / round(1e3 / per_second) if per_second < 1e3 else per_second]
            per_second = next((one for one in nice if abs(per_second / one - 1.0) < NICE_RATE), per_second)
            self._take(
                TIME_S,
                column,
                "-",
                1.0 / per_second,
                f"{option.said}{per_second:.6g} Hz, {said}",
                True,
                stamp_wrap_of(column.values),
            )
            return
        steps = np.abs(np.diff(column.values[np.isfinite(column.values)]))
        rate_hz = 1.0 / (float(steps[steps < ROUNDED * np.median(steps)].mean()) * factor)
        wrap = stamp_wrap_of(column.values, DAY_S / factor)
        evidence = f"{option.said}{said}{rate_hz:.6g} Hz" + (f", wraps at {wrap:g}" if wrap else "")
        self._take(TIME_S, column, option.unit, factor, evidence, sure, wrap)

    @staticmethod
    def _going_on(raw: Floats) -> Floats:
        """Stamps for derivatives, in their own unit: as if a log that begins anew went on."""
        steps = np.diff(bridged(raw))
        usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0
        steps = np.where(steps < 0.0, usual, steps)
        return np.asarray(np.concatenate([[0.0], np.cumsum(steps)]) + np.arange(raw.size) * usual * 1e-9)

    @property
    def _period_s(self) -> float:
        """Of a log without a time, as the user or the file says."""
        return 1.0 / self.hints.rate_hz if self.hints.rate_hz else self.source.period_s or 1.0

    def _time_s(self) -> Floats:
        """Stamps for derivatives: an even grid where they do not rise."""
        guess = self.guesses.get(TIME_S)
        rows = self.source.rows
        if guess is None:
            return np.asarray(np.arange(rows) * self._period_s, dtype=np.float64)
        raw = self.source.columns[guess.column]
        return self._going_on((unwrapped(raw, guess.wrap) if guess.wrap else raw) * guess.factor)


def _goes_on(stamps: Floats) -> bool:
    """Whether most stamps (n,) differ from the one before."""
    steps = np.diff(stamps[np.isfinite(stamps)])
    return bool(steps.size and float(np.mean(steps != 0.0)) > LEAST_STEPPING)


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

"""Whether compensated effects still help on this axis: windows with and without them, in a sequential test.

A trial alternates windows with and without the tried effects (with, without, without, with, ...: a trend cancels). Of
each pair the logarithm of the ratio of the squared tracking errors counts; its mean is tested after every pair, at a
level that holds for all looks together. Worse: out of service. Better, or no difference after the last pair: in
service.

First all effects are tried together. Then each of several: together no worse, each against all the others; together
worse, each by itself, beginning with none in service. What is left is watched by a cumulative sum of its squared error
against what it was in the trial; when that has grown the next trial begins, so that what is another load or another
reference is not taken for a wrong model. What was taken out stays out until the model is put in service again.

`monitor_step` is pure: one window in, the state after it and what is to be in service out. Effects are bits, as in the
row: bit k is the k-th effect in the order in which they are compensated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from ..control.compensation import RAMP_S
from ..control.reference import MODE_VELOCITY

Rows = np.ndarray[Any, np.dtype[np.void]]


class Phase(Enum):
    """Activity of the monitor."""

    TRIAL = "trial"
    SERVICE = "in service"
    OUT = "out of service"


class MonitorConfig(NamedTuple):
    """Parameters of the test."""

    window_s: float = 1.0  # evaluated, after the ramp
    least_pairs: int = 4
    most_pairs: int = 24
    level_sds: float = 3.3  # a pair of looks at 5 % would be 1.96; held for up to 24 looks, and 1 % in all
    tolerated_percent: float = 2.0  # increase of the squared error that does not count as worse
    alarm_sds: float = 10.0  # cumulative sum that starts another trial
    slack_sds: float = 1.0  # growth of a window that is not accumulated
    least_motion_rps: float = 0.05  # rms of the reference in a window that counts


class Window(NamedTuple):
    """One window of the loop."""

    squared_error_rps2: float  # mean
    effects: int  # bits in service
    moves: bool


class Moments(NamedTuple):
    """Running mean and standard deviation (Welford)."""

    number: int = 0
    mean: float = 0.0
    squares: float = 0.0  # sum of squared deviations

    def added(self, value: float) -> Moments:
        """The moments with one more number."""
        number = self.number + 1
        change = value - self.mean
        mean = self.mean + change / number
        return Moments(number, mean, self.squares + change * (value - mean))

    @property
    def sd(self) -> float:
        """Standard deviation; 1 with fewer than two numbers."""
        return math.sqrt(self.squares / (self.number - 1)) if self.number > 1 else 1.0


class EffectTrial(NamedTuple):
    """A trial of some effects on top of others."""

    base: int  # bits in service in every window
    tried: int  # bits in service in every other one
    number: int = 0  # windows so far
    pending: float = math.nan  # logarithm of the first window of the pair
    ratios: Moments = Moments()  # logarithms of with over without
    with_them: Moments = Moments()  # logarithms of the squared error
    without: Moments = Moments()

    @property
    def wanted(self) -> int:
        """Bits wanted in the next window: with, without, without, with, with, ..."""
        return self.base | self.tried if self.number % 4 in (0, 3) else self.base


class MonitorState(NamedTuple):
    """Memory of the monitor."""

    trial: EffectTrial | None  # None: the kept effects are in service
    kept: int  # bits not removed by a trial
    queue: tuple[int, ...] = ()  # to be tried one by one
    usual: Moments = Moments()  # logarithm of the squared error in service
    growth: float = 0.0  # cumulative sum in service, in standard deviations

    @property
    def phase(self) -> Phase:
        """The present activity."""
        if self.trial is not None:
            return Phase.TRIAL
        return Phase.SERVICE if self.kept else Phase.OUT

    @property
    def wanted(self) -> int:
        """Bits wanted in service now."""
        return self.kept if self.trial is None else self.trial.wanted


class EffectVerdict(NamedTuple):
    """The result of a trial, or the reason for another trial."""

    effects: int  # bits to which it applies
    worse: bool
    change: float = math.nan  # of the squared error with them, as a logarithm; NaN: it has grown in service
    pairs: int = 0


class Decision(NamedTuple):
    """The effects to be in service next."""

    effects: int  # bits
    verdict: EffectVerdict | None = None


def monitor_start(effects: int = 1) -> MonitorState:
    """Begin a trial of these bits together."""
    return MonitorState(EffectTrial(0, effects), effects)


def monitor_step(config: MonitorConfig, state: MonitorState, window: Window) -> tuple[MonitorState, Decision]:
    """Evaluate one window. A window without motion, or with other effects than requested, does not count."""
    if not window.moves or window.squared_error_rps2 <= 0.0 or window.effects != state.wanted:
        return state, Decision(state.wanted)
    logarithm = math.log(window.squared_error_rps2)
    if state.trial is None:
        return _watched(config, state, logarithm) if state.kept else (state, Decision(0))
    trial = _with_window(state.trial, logarithm)
    worse = _outcome(config, trial)
    if worse is None:
        state = state._replace(trial=trial)
        return state, Decision(state.wanted)
    state = _after(state, trial, worse)
    return state, Decision(state.wanted, EffectVerdict(trial.tried, worse, trial.ratios.mean, trial.ratios.number))


def _with_window(trial: EffectTrial, logarithm: float) -> EffectTrial:
    """The trial with one more window of the wanted kind."""
    with_them = trial.wanted != trial.base
    number, pending = trial.number + 1, trial.pending
    if with_them:
        trial = trial._replace(with_them=trial.with_them.added(logarithm))
    else:
        trial = trial._replace(without=trial.without.added(logarithm))
    if math.isnan(pending):
        return trial._replace(number=number, pending=logarithm)
    ratio = logarithm - pending if with_them else pending - logarithm
    return trial._replace(number=number, pending=math.nan, ratios=trial.ratios.added(ratio))


def _outcome(config: MonitorConfig, trial: EffectTrial) -> bool | None:
    """Whether the effects make tracking worse; None while undecided."""
    ratios = trial.ratios
    if not math.isnan(trial.pending) or ratios.number < config.least_pairs:
        return None
    reach = config.level_sds * ratios.sd / math.sqrt(ratios.number)
    # with few pairs the standard deviation is uncertain: Student's tails, by the usual approximation
    reach *= 1.0 + config.level_sds * config.level_sds / (4.0 * (ratios.number - 1))
    tolerated = math.log1p(0.01 * config.tolerated_percent)
    if ratios.mean - reach > tolerated:
        return True
    if ratios.mean + reach < tolerated or ratios.number >= config.most_pairs:
        return False
    return None


def _after(state: MonitorState, trial: EffectTrial, worse: bool) -> MonitorState:
    """The next trial, or service."""
    kept = trial.base if worse else trial.base | trial.tried
    several = _bits(trial.tried)
    queue = several if len(several) > 1 else state.queue
    if queue:
        others = kept & ~queue[0]
        return MonitorState(EffectTrial(others, queue[0]), kept, queue[1:])
    return MonitorState(None, kept, (), trial.without if worse else trial.with_them)


def _bits(effects: int) -> tuple[int, ...]:
    return tuple(1 << k for k in range(effects.bit_length()) if effects >> k & 1)


def _watched(config: MonitorConfig, state: MonitorState, logarithm: float) -> tuple[MonitorState, Decision]:
    sds = (logarithm - state.usual.mean) / max(state.usual.sd, 0.05)
    growth = max(0.0, state.growth + sds - config.slack_sds)
    if growth < config.alarm_sds:
        state = state._replace(growth=growth)
        return state, Decision(state.wanted)
    again = monitor_start(state.kept)
    return again, Decision(again.wanted, EffectVerdict(state.kept, False))


def sentence(verdict: EffectVerdict, names: Sequence[str]) -> str:
    """A verdict in words; `names` by the number of the bit."""
    said = ", ".join(names[k] if k < len(names) else f"effect {k}" for k in range(8) if verdict.effects >> k & 1)
    if math.isnan(verdict.change):
        return f"tracking error has grown: {said} tried again"
    change = f"squared tracking error {100.0 * math.expm1(verdict.change):+.0f} % in {verdict.pairs} pairs of windows"
    return f"{said} {'taken out of service' if verdict.worse else 'in service'}: {change}"


class EffectMonitor:
    """Cuts rows of the loop into windows and decides which effects are in service. `observe` gets each row once.

    `names` of the compensated effects, in the order of their bits.
    """

    def __init__(self, period_s: float, names: Sequence[str] = ("effects",), config: MonitorConfig | None = None):
        self.config = config or MonitorConfig()
        self.names = tuple(names)
        self.state = monitor_start((1 << len(self.names)) - 1)
        self.effects = self.state.wanted  # bits wanted in service now
        self._settling = math.ceil(2.0 * RAMP_S / period_s)
        self._samples = max(1, round(self.config.window_s / period_s))
        self._skip = self._settling
        self._error = self._reference = 0.0
        self._count = 0

    def observe(self, rows: Rows) -> list[Decision]:
        """Decisions with a verdict or a change; the last one applies."""
        found: list[Decision] = []
        for begin in range(0, rows.size, self._samples):
            part = rows[begin : begin + self._samples]
            acting = (part["mode"] == MODE_VELOCITY) & (part["effects"] == self.effects)
            found += self._take(part, acting)
        return found

    def sentence(self, verdict: EffectVerdict) -> str:
        """A verdict in words."""
        return sentence(verdict, self.names)

    def _take(self, part: Rows, acting: np.ndarray[Any, np.dtype[np.bool_]]) -> list[Decision]:
        if not acting.all():
            # the law was inactive, or the request was not yet in force: the window restarts after it
            self._restart()
            part = part[int(np.flatnonzero(~acting)[-1]) + 1 :]
        found: list[Decision] = []
        while part.size:
            if self._skip > 0:
                skipped = min(self._skip, part.size)
                self._skip -= skipped
                part = part[skipped:]
                continue
            taken = min(self._samples - self._count, part.size)
            self._error += float(np.sum(part["error_rps"][:taken] ** 2))
            self._reference += float(np.sum(part["reference_rps"][:taken] ** 2))
            self._count += taken
            part = part[taken:]
            if self._count < self._samples:
                continue
            moves = math.sqrt(self._reference / self._count) > self.config.least_motion_rps
            window = Window(self._error / self._count, self.effects, moves)
            self.state, decision = monitor_step(self.config, self.state, window)
            changed = decision.effects != self.effects
            self._error = self._reference = 0.0
            self._count = 0
            if changed or decision.verdict is not None:
                found.append(decision)
            if changed:
                self.effects = decision.effects
                self._restart()
                break  # what follows in this batch is still of the former kind
        return found

    def _restart(self) -> None:
        self._skip, self._count = self._settling, 0
        self._error = self._reference = 0.0

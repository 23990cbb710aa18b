"""Whether compensated effects help on this axis today: windows with them and without, compared by a sequential test.

A trial alternates windows with and without the feed-forward of effects (with, without, without, with, ...: a trend
cancels). Of each pair the logarithm of the ratio of the squared tracking errors counts; its mean is tested after every
pair, at a level that holds for all looks together. Worse: out of service. Better, or no difference after the last pair:
in service. In service the squared error is watched by a cumulative sum against what it was in the trial; when it has
grown the next trial begins, so that what is another load or another reference is not taken for a wrong model.

`monitor_step` is pure: one window in, the state after it and what is to be in service out.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from ..control.compensation import RAMP_S
from ..control.reference import MODE_VELOCITY

Rows = np.ndarray[Any, np.dtype[np.void]]


class Phase(Enum):
    """What the monitor does."""

    TRIAL = "trial"
    SERVICE = "in service"
    OUT = "out of service"


class MonitorConfig(NamedTuple):
    """How the test is made."""

    window_s: float = 1.0  # that counts, behind the ramp
    least_pairs: int = 4
    most_pairs: int = 24
    level_sds: float = 3.3  # a pair of looks at 5 % would be 1.96; held for up to 24 looks, and 1 % in all
    tolerated_percent: float = 2.0  # of the squared error: worse than by this is worse
    alarm_sds: float = 10.0  # cumulative sum that starts another trial
    slack_sds: float = 1.0  # of a window's growth that is not added up
    least_motion_rps: float = 0.05  # rms of the reference in a window that counts


class Window(NamedTuple):
    """One window of the loop."""

    squared_error_rps2: float  # mean
    with_effects: bool
    moves: bool


class MonitorState(NamedTuple):
    """Memory of the monitor."""

    phase: Phase
    number: int  # windows of the trial so far
    pending: float  # logarithm of the first window of the pair; NaN: none yet
    pairs: int
    mean: float  # of the logarithm of with over without
    squares: float  # sum of squared deviations
    usual: float  # mean logarithm with effects
    usual_squares: float
    windows: int  # with effects, in the trial
    growth: float  # cumulative sum in service, in standard deviations


class Decision(NamedTuple):
    """What is to be done next."""

    with_effects: bool
    verdict: str  # empty, or a sentence for the event log
    worse: bool


def monitor_start() -> MonitorState:
    """A trial begins."""
    return MonitorState(Phase.TRIAL, 0, math.nan, 0, 0.0, 0.0, 0.0, 0.0, 0, 0.0)


def wants_effects(state: MonitorState) -> bool:
    """Whether the next window is one with effects: in a trial with, without, without, with."""
    if state.phase is Phase.TRIAL:
        return state.number % 4 in (0, 3)
    return state.phase is Phase.SERVICE


def monitor_step(config: MonitorConfig, state: MonitorState, window: Window) -> tuple[MonitorState, Decision]:
    """One window. A window that does not move, or is of the other kind than was asked for, does not count."""
    if not window.moves or window.squared_error_rps2 <= 0.0 or window.with_effects != wants_effects(state):
        return state, Decision(wants_effects(state), "", False)
    logarithm = math.log(window.squared_error_rps2)
    if state.phase is Phase.TRIAL:
        return _tried(config, state, window, logarithm)
    if state.phase is Phase.SERVICE:
        return _watched(config, state, logarithm)
    return state, Decision(False, "", False)


def _tried(
    config: MonitorConfig, state: MonitorState, window: Window, logarithm: float
) -> tuple[MonitorState, Decision]:
    windows, usual, usual_squares = state.windows, state.usual, state.usual_squares
    if window.with_effects:
        windows, usual, usual_squares = _welford(windows, usual, usual_squares, logarithm)
    state = state._replace(number=state.number + 1, windows=windows, usual=usual, usual_squares=usual_squares)
    if math.isnan(state.pending):
        state = state._replace(pending=logarithm)
        return state, Decision(wants_effects(state), "", False)
    ratio = logarithm - state.pending if window.with_effects else state.pending - logarithm
    pairs, mean, squares = _welford(state.pairs, state.mean, state.squares, ratio)
    state = state._replace(pending=math.nan, pairs=pairs, mean=mean, squares=squares)
    if pairs < config.least_pairs:
        return state, Decision(wants_effects(state), "", False)
    reach = config.level_sds * math.sqrt(squares / (pairs - 1) / pairs)
    # few pairs know their own spread badly: Student's tails, by the usual approximation for the level
    reach *= 1.0 + config.level_sds * config.level_sds / (4.0 * (pairs - 1))
    tolerated = math.log1p(0.01 * config.tolerated_percent)
    change = f"{100.0 * math.expm1(mean):+.0f} % in {pairs} pairs of windows"
    if mean - reach > tolerated:
        out = state._replace(phase=Phase.OUT)
        return out, Decision(False, f"effects out of service: squared tracking error {change}", True)
    if mean + reach < tolerated or pairs >= config.most_pairs:
        kept = state._replace(phase=Phase.SERVICE, growth=0.0)
        return kept, Decision(True, f"effects stay in service: squared tracking error {change}", False)
    return state, Decision(wants_effects(state), "", False)


def _watched(config: MonitorConfig, state: MonitorState, logarithm: float) -> tuple[MonitorState, Decision]:
    spread = math.sqrt(state.usual_squares / max(1, state.windows - 1)) if state.windows > 1 else 1.0
    sds = (logarithm - state.usual) / max(spread, 0.05)
    growth = max(0.0, state.growth + sds - config.slack_sds)
    if growth < config.alarm_sds:
        return state._replace(growth=growth), Decision(True, "", False)
    again = monitor_start()
    return again, Decision(wants_effects(again), "tracking error has grown: effects are tried again", False)


def _welford(count: int, mean: float, squares: float, value: float) -> tuple[int, float, float]:
    count += 1
    change = value - mean
    mean += change / count
    return count, mean, squares + change * (value - mean)


class EffectMonitor:
    """Cuts rows of the loop into windows, and says what is to be in service. `observe` is given every row once."""

    def __init__(self, period_s: float, config: MonitorConfig | None = None) -> None:
        self.config = config or MonitorConfig()
        self.state = monitor_start()
        self.with_effects = wants_effects(self.state)
        self._settling = math.ceil(2.0 * RAMP_S / period_s)
        self._samples = max(1, round(self.config.window_s / period_s))
        self._skip = self._settling
        self._error = self._reference = 0.0
        self._count = 0

    def observe(self, rows: Rows) -> list[Decision]:
        """Decisions with a sentence or a change in them; the last one holds."""
        found: list[Decision] = []
        for begin in range(0, rows.size, self._samples):
            part = rows[begin : begin + self._samples]
            acting = (part["mode"] == MODE_VELOCITY) & ((part["effects"] != 0) == self.with_effects)
            found += self._take(part, acting)
        return found

    def _take(self, part: Rows, acting: np.ndarray[Any, np.dtype[np.bool_]]) -> list[Decision]:
        if not acting.all():
            # the law rested, or the request has not come through: the window begins anew behind it
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
            window = Window(self._error / self._count, self.with_effects, moves)
            self.state, decision = monitor_step(self.config, self.state, window)
            changed = decision.with_effects != self.with_effects
            self._error = self._reference = 0.0
            self._count = 0
            if changed or decision.verdict:
                found.append(decision)
            if changed:
                self.with_effects = decision.with_effects
                self._restart()
                break  # what follows in this batch is still of the former kind
        return found

    def _restart(self) -> None:
        self._skip, self._count = self._settling, 0
        self._error = self._reference = 0.0

"""Control effort: the current that a law commands, and the part of it that is noise."""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats

HIGH_FROM_HZ = 100.0  # far above reference (10 Hz) and loop (24 Hz): friction's steps at reversals, and noise
NOISE_FROM_HZ = 200.0  # nearly all noise: with 1/K = 1/778 rev, friction takes some 5 ms to reverse
FILTER_ORDER = 4
EDGE_S = 0.05  # omitted at both ends, where a profile that does not begin and end at rest has steps


class ControlEffort(NamedTuple):
    """Effort of the command on the bus."""

    rms_a: float
    high_rms_a: float  # above HIGH_FROM_HZ
    noise_rms_a: float  # above NOISE_FROM_HZ
    variation_a_per_s: float  # mean of |difference from sample to sample| per time


def control_effort(command_a: Floats, period_s: float) -> ControlEffort:
    """Effort of a command (n,). NaN if the rate is too low or the record too short."""
    sums = EffortSums(period_s)
    sums.take(command_a)
    return sums.effort()


class EffortSums:
    """The effort of a command, taken part by part."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._bands = [_Above(period_s, from_hz) for from_hz in (HIGH_FROM_HZ, NOISE_FROM_HZ)]
        self._samples, self._squares, self._variation = 0, 0.0, 0.0
        self._last_a: Floats = np.zeros(0)

    def take(self, command_a: Floats) -> None:
        """More samples (n,)."""
        self._samples += command_a.size
        self._squares += float(np.sum(command_a * command_a))
        self._variation += float(np.abs(np.diff(command_a, prepend=self._last_a)).sum())
        self._last_a = command_a[-1:].copy() if command_a.size else self._last_a
        for band in self._bands:
            band.take(command_a)

    def effort(self) -> ControlEffort:
        """Of all samples."""
        variation = self._variation / (self._samples - 1) / self._period_s if self._samples > 1 else 0.0
        high_a, noise_a = (band.rms_a() for band in self._bands)
        return ControlEffort(math.sqrt(self._squares / self._samples), high_a, noise_a, variation)


class _Above:
    """A command above a frequency, without EDGE_S at both ends."""

    def __init__(self, period_s: float, from_hz: float) -> None:
        self._edge = round(EDGE_S / period_s)
        self._filter = _high_pass(period_s, from_hz) if from_hz < 0.45 / period_s else None
        self._memory = None if self._filter is None else np.zeros((self._filter.shape[0], 2))
        self._omitted = 0  # at the begin
        self._waiting: Floats = np.zeros(0)  # the last ones, which may be the end
        self._samples, self._squares = 0, 0.0

    def take(self, command_a: Floats) -> None:
        if self._filter is None:
            return
        from scipy.signal import sosfilt  # loads slowly

        filtered, self._memory = sosfilt(self._filter, command_a, zi=self._memory)
        begin = min(self._edge - self._omitted, filtered.size)
        self._omitted += begin
        known = np.concatenate([self._waiting, filtered[begin:]])
        sure, self._waiting = np.split(known, [max(0, known.size - self._edge)])
        self._samples += sure.size
        self._squares += float(np.sum(sure * sure))

    def rms_a(self) -> float:
        return math.sqrt(self._squares / self._samples) if self._samples else float("nan")


@functools.cache
def _high_pass(period_s: float, from_hz: float) -> Any:
    from scipy.signal import butter

    return butter(FILTER_ORDER, from_hz, "highpass", fs=1.0 / period_s, output="sos")

"""Control effort: the current that a law commands, and the part of it that is noise."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from .metrics import rms

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
    high_a, noise_a = (_rms_above(command_a, period_s, from_hz) for from_hz in (HIGH_FROM_HZ, NOISE_FROM_HZ))
    variation = float(np.abs(np.diff(command_a)).mean() / period_s) if command_a.size > 1 else 0.0
    return ControlEffort(rms(command_a), high_a, noise_a, variation)


def _rms_above(command_a: Floats, period_s: float, from_hz: float) -> float:
    edge = round(EDGE_S / period_s)
    if from_hz >= 0.45 / period_s or command_a.size <= 2 * edge:
        return float("nan")
    from scipy.signal import sosfilt  # loads slowly

    return rms(sosfilt(_high_pass(period_s, from_hz), command_a)[edge:-edge])


@functools.cache
def _high_pass(period_s: float, from_hz: float) -> Any:
    from scipy.signal import butter

    return butter(FILTER_ORDER, from_hz, "highpass", fs=1.0 / period_s, output="sos")

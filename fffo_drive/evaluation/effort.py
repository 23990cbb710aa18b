"""Control effort: how much current a law asks for, and how much of that is noise that no motion needs."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import butter, sosfilt

from .metrics import Floats

NOISE_FROM_HZ = 100.0  # far above reference (10 Hz) and loop (24 Hz): what is there heats and sounds
FILTER_ORDER = 4


class ControlEffort(NamedTuple):
    """Of the command on the wire."""

    rms_a: float
    noise_rms_a: float  # above NOISE_FROM_HZ
    variation_a_per_s: float  # mean of |difference from sample to sample| per time


def control_effort(command_a: Floats, period_s: float) -> ControlEffort:
    """Effort of a command (n,). NaN noise where the rate is too low to tell."""
    noise_a = float("nan")
    if NOISE_FROM_HZ < 0.45 / period_s:
        noise_a = _rms(sosfilt(_high_pass(period_s), command_a))
    variation = float(np.abs(np.diff(command_a)).mean() / period_s) if command_a.size > 1 else 0.0
    return ControlEffort(_rms(command_a), noise_a, variation)


@functools.cache
def _high_pass(period_s: float) -> Any:
    return butter(FILTER_ORDER, NOISE_FROM_HZ, "highpass", fs=1.0 / period_s, output="sos")


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values * values)))

"""Current profiles of commissioning: pulses of both signs, short enough to be stopped by friction alone."""

from __future__ import annotations

import numpy as np

from ..arrays import Floats
from ..control.reference import MODE_CURRENT, Profile

LEAD_S = 0.05  # zero current before and after a pulse
PULSE_S = 0.04
LONGEST_PULSE_S = 0.32
SHORTEST_REST_S = 0.15  # zero current between pulses of one profile

# shares of the pulse's length, and its levels: corners in mid-motion, which tell delay from gain
MEASURING_SHAPE = ((0.5, 1.0), (0.25, 0.1), (0.25, 1.0))


def current_profile(name: str, period_s: float, values: Floats) -> Profile:
    """An open-loop current profile of samples (A)."""
    return Profile(name, MODE_CURRENT, period_s, values, np.zeros_like(values))


def _level(duration_s: float, period_s: float, level_a: float) -> Floats:
    return np.full(max(1, round(duration_s / period_s)), level_a)


def single_pulse(amplitude_a: float, length_s: float, period_s: float) -> Profile:
    """One pulse between zero currents."""
    parts = [(LEAD_S, 0.0), (length_s, amplitude_a), (LEAD_S, 0.0)]
    return current_profile("pulse", period_s, np.concatenate([_level(d, period_s, a) for d, a in parts]))


def measuring_pairs(amplitude_a: float, length_s: float, rest_s: float, period_s: float, pairs: int) -> Profile:
    """Pairs of pulses with corners in them (MEASURING_SHAPE), each followed by zero current for `rest_s`."""
    parts: list[tuple[float, float]] = [(LEAD_S, 0.0)]
    for number in range(2 * pairs):
        sign = -1.0 if number % 2 else 1.0
        parts += [(share * length_s, sign * level * amplitude_a) for share, level in MEASURING_SHAPE]
        parts.append((rest_s, 0.0))
    return current_profile("measure", period_s, np.concatenate([_level(d, period_s, a) for d, a in parts]))


def holding_current(current_a: float, duration_s: float, period_s: float) -> Profile:
    """A constant current that does not move the axis, in and out along ramps."""
    n = max(2, round(duration_s / period_s))
    ramp = np.minimum(1.0, np.minimum(np.arange(n), np.arange(n)[::-1]) / max(1.0, 0.1 * n))
    return current_profile("hold", period_s, current_a * ramp)

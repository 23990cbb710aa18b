"""Stability of the loop with observer: condition (14) in torque units, and margins with the delay in the loop.

With lambda(e) = L e the estimate adds L / s to the controller (its worst case: the estimate's own decay helps), so the
open loop in torque units is

    G(s) = (Kp Kt + (Ki Kt + L) / s) / (J s + D) exp(-Td s)

and (14) reads Ki Kt + L >= 2 B. It belongs to the loop with observer and is not a margin: L is chosen with the delay.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

SWEEP_LOW_HZ = 1e-2
SWEEP_HIGH_HZ = 1e4
SWEEP_POINTS = 20_000


class LinearAxis(NamedTuple):
    """The axis linearised at one amplitude."""

    inertia_nm_s2_per_rev: float
    damping_nm_per_rps: float  # D of (17); the smallest one, sigma, is the worst case
    delay_s: float
    torque_constant_nm_per_a: float


class Margins(NamedTuple):
    """Margins of the open loop; infinite where there is no crossing."""

    phase_deg: float
    gain: float
    crossover_hz: float


def condition_14_nm_per_rev(
    integral_a_per_rev: float, torque_constant_nm_per_a: float, observer_gain_nm_per_rev: float,
    attraction_nm_per_rev: float,
) -> float:  # fmt: skip
    """Ki Kt + L - 2 B in Nm/rev: not negative where (14) holds."""
    return integral_a_per_rev * torque_constant_nm_per_a + observer_gain_nm_per_rev - 2.0 * attraction_nm_per_rev


def loop_margins(
    axis: LinearAxis, proportional_a_per_rps: float, integral_a_per_rev: float, observer_gain_nm_per_rev: float,
    error_filter_s: float = 0.0,
) -> Margins:  # fmt: skip
    """Phase and gain margin of PI plus observer on the linearised axis, with its delay and the error's filter."""
    omega = 2.0 * math.pi * np.geomspace(SWEEP_LOW_HZ, SWEEP_HIGH_HZ, SWEEP_POINTS)
    s = 1j * omega
    kt = axis.torque_constant_nm_per_a
    controller = proportional_a_per_rps * kt + (integral_a_per_rev * kt + observer_gain_nm_per_rev) / s
    rational = controller / (1.0 + error_filter_s * s) / (axis.inertia_nm_s2_per_rev * s + axis.damping_nm_per_rps)
    magnitude = np.abs(rational)
    phase_deg = np.degrees(np.unwrap(np.angle(rational)) - omega * axis.delay_s)

    below = np.flatnonzero((magnitude[:-1] >= 1.0) & (magnitude[1:] < 1.0))
    phase_margin_deg = min((180.0 + float(phase_deg[i]) for i in below), default=math.inf)
    # the gain margin counts downward crossings of -180 degrees, where more gain encircles -1
    beyond = np.flatnonzero((phase_deg[:-1] > -180.0) & (phase_deg[1:] <= -180.0))
    gain_margin = min((1.0 / float(magnitude[i]) for i in beyond), default=math.inf)
    crossover_hz = float(omega[below[-1]] / (2.0 * math.pi)) if below.size else math.nan
    return Margins(phase_margin_deg, gain_margin, crossover_hz)

"""One procedure for all laws: the largest integral action with the required margins on the linear axis.

Laws with a friction model have the loop of PI plus L (identification.tuning chooses it). A disturbance observer has

    T = -C(s) w,   C = (Kp Kt / (1 + Tf s) + Q J s) / (1 - Q exp(-Td s)),   open loop  C exp(-Td s) / (J s + D)

with Tf of the error's filter, which is outside the observer. It rejects a slow disturbance like an integral with gain
Kp Kt / (n / wo + Td), where n is the order of Q.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...control.stability import LinearAxis, Margins, margins_of, sweep_rad_per_s
from ...identification.tuning import Wish, largest_that

SLOWEST_SHARE = 0.02  # of the crossover at which the delay takes 90 deg
CROSSOVERS = 25
LARGEST_BANDWIDTH = 4.0  # over one by the delay


class ObserverGains(NamedTuple):
    """A proportional gain and the bandwidth of its disturbance observer."""

    proportional_a_per_rps: float
    bandwidth_rad_per_s: float
    margins: Margins


def observer_margins(
    axis: LinearAxis, proportional_a_per_rps: float, bandwidth: float, order: int, error_filter_s: float = 0.0
) -> Margins:
    """Margins of P with a disturbance observer of bandwidth `bandwidth` (rad/s) and the error's filter."""
    omega = sweep_rad_per_s()
    s = 1j * omega
    late = np.exp(-axis.delay_s * s)
    low_pass = (bandwidth / (s + bandwidth)) ** order
    inertia = axis.inertia_nm_s2_per_rev * s
    proportional = proportional_a_per_rps * axis.torque_constant_nm_per_a / (1.0 + error_filter_s * s)
    controller = (proportional + low_pass * inertia) / (1.0 - low_pass * late)
    rational = controller / (inertia + axis.damping_nm_per_rps)
    return margins_of(omega, rational, axis.delay_s)


def observer_gains(axis: LinearAxis, order: int, wish: Wish, error_filter_s: float = 0.0) -> ObserverGains:
    """Gains with the required margins and the largest integral action. Raises ValueError if there are none."""
    fastest = 0.5 * math.pi / axis.delay_s
    found = [
        _gains_at(axis, float(crossover), order, wish, error_filter_s)
        for crossover in fastest * np.geomspace(1.0, SLOWEST_SHARE, CROSSOVERS)
    ]
    held = [gains for gains in found if gains.bandwidth_rad_per_s > 0.0]
    if not held:
        raise ValueError("no proportional gain has the required margins")
    return max(
        held, key=lambda gains: gains.proportional_a_per_rps / (order / gains.bandwidth_rad_per_s + axis.delay_s)
    )


def _gains_at(axis: LinearAxis, crossover: float, order: int, wish: Wish, error_filter_s: float) -> ObserverGains:
    """At a crossover (rad/s) of P alone, with the largest bandwidth that has the margins; 0 where none has."""
    proportional = crossover * axis.inertia_nm_s2_per_rev / axis.torque_constant_nm_per_a

    def margins(bandwidth: float) -> Margins:
        return observer_margins(axis, proportional, bandwidth, order, error_filter_s)

    bandwidth = largest_that(LARGEST_BANDWIDTH / axis.delay_s, lambda bandwidth: wish.is_met(margins(bandwidth)))
    return ObserverGains(proportional, bandwidth, margins(bandwidth))

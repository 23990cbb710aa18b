"""One procedure for all laws: the largest integral action with the required margins on the linear axis.

Laws with a friction model driven by the reference have the loop of PI plus L, designed by identification.tuning. For a
law with a disturbance observer, and in sliding for the friction observer that measures the position,

    T = -C(s) w,   C = (C0 / (1 + Tf s) + Q J s exp(Tx s)) / (1 - Q exp(-(Td - Tx) s)),   C0 = Kp Kt (1 + 1 / (Ti s))
    open loop  C exp(-Td s) / (J s + D),   Q = product of wi / (s + wi)

Tf is the time constant of the error's filter, which is outside the observer. Tx is the lag of the velocity in the error
behind the observer's measurement. The loop rejects a slow disturbance like an integral with gain
Kp Kt / (sum of 1 / wi + Td - Tx). 1 / Ti of a PI is given and does not change.
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


class ObserverForm(NamedTuple):
    """What is known of an observer before its gains are chosen."""

    beyond_rad_per_s: tuple[float, ...]  # of each pole of Q: by how much it is faster than the bandwidth
    integral_per_s: float = 0.0  # 1 / Ti of the feedback beside it; 0: P alone
    earlier_s: float = 0.0  # Tx


class ObserverGains(NamedTuple):
    """A proportional gain and the bandwidth of the observer beside it, its slowest pole."""

    proportional_a_per_rps: float
    bandwidth_rad_per_s: float
    margins: Margins


def observer_margins(axis: LinearAxis, proportional_a_per_rps: float, bandwidth: float, form: ObserverForm) -> Margins:
    """Margins of P or PI with an observer of bandwidth `bandwidth` (rad/s) and the error's filter."""
    omega = sweep_rad_per_s()
    s = 1j * omega
    low_pass = np.ones_like(s)
    for beyond in form.beyond_rad_per_s:
        low_pass = low_pass * (bandwidth + beyond) / (s + bandwidth + beyond)
    inertia = axis.inertia_nm_s2_per_rev * s
    feedback = proportional_a_per_rps * axis.torque_constant_nm_per_a * (1.0 + form.integral_per_s / s)
    feedback = feedback / (1.0 + axis.error_filter_s * s)
    known = low_pass * np.exp((form.earlier_s - axis.delay_s) * s)
    controller = (feedback + low_pass * inertia * np.exp(form.earlier_s * s)) / (1.0 - known)
    rational = controller / (inertia + axis.damping_nm_per_rps)
    return margins_of(omega, rational, axis.delay_s)


def observer_gains(axis: LinearAxis, form: ObserverForm, wish: Wish) -> ObserverGains:
    """Gains with the required margins and the largest integral action. Raises ValueError if there are none."""
    fastest = 0.5 * math.pi / axis.delay_s
    best: ObserverGains | None = None
    for crossover in fastest * np.geomspace(1.0, SLOWEST_SHARE, CROSSOVERS):
        found = _better_at(axis, float(crossover), form, wish, best)
        best = found or best
    if best is None:
        raise ValueError("no proportional gain has the required margins")
    return best


def _integral_action(axis: LinearAxis, form: ObserverForm, proportional_a_per_rps: float, bandwidth: float) -> float:
    """Kp over the lag of the observer behind a slow disturbance."""
    behind_s = sum(1.0 / (bandwidth + beyond) for beyond in form.beyond_rad_per_s)
    return proportional_a_per_rps / (behind_s + axis.delay_s - form.earlier_s)


def _better_at(
    axis: LinearAxis, crossover: float, form: ObserverForm, wish: Wish, best: ObserverGains | None
) -> ObserverGains | None:
    """At a crossover (rad/s) of P alone, with the largest bandwidth that has the margins; None where it is not better.

    The bandwidth that would do as well as the best so far is tried first: most crossovers end there.
    """
    proportional = crossover * axis.inertia_nm_s2_per_rev / axis.torque_constant_nm_per_a
    most = LARGEST_BANDWIDTH / axis.delay_s

    def holds(bandwidth: float) -> bool:
        return wish.is_met(observer_margins(axis, proportional, bandwidth, form))

    if best is not None:
        asked = _integral_action(axis, form, best.proportional_a_per_rps, best.bandwidth_rad_per_s)
        below = largest_that(most, lambda wide: _integral_action(axis, form, proportional, wide) <= asked)
        if not holds(below):
            return None
    bandwidth = largest_that(most, holds)
    if bandwidth == 0.0:
        return None
    found = ObserverGains(proportional, bandwidth, observer_margins(axis, proportional, bandwidth, form))
    if best is not None and _integral_action(axis, form, proportional, bandwidth) <= asked:
        return None
    return found

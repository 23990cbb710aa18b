"""Two-state elasto-plastic (2SEP) friction: one exact step for simulation, observer and fit.

With F = z1 + B|w| z2 the paper's (2)-(7) are one first-order equation for the friction torque F:

    dF/dt = Omega K |w| exp(-K x) + B w - (B |w| / |S(w)|) F + lambda(e)
    S(w)  = sgn(w) (Fc + (Fs - Fc) exp(-(|w| / Vs)^delta)) + sigma w
    x     = travel since the last reversal, Omega set at the reversal from F(t_r)

The model has lambda = 0; the observer adds lambda(e) = L e. At constant w over a step the solution is closed (with
d = |w| h, s = sgn w, b = B / |S|, E = exp(-b d)):

    F+ = F E + s |S| (1 - E) + Omega K exp(-K x) (exp(-K d) - E) / (b - K) + lambda h (1 - E) / (b d)

z1 crosses in 86 us at 15 rps and the lag pole reaches 500 1/s: Euler at 2 kHz overshoots, and stepping z1 and the lag
one after the other is wrong by most of Fc at a fast reversal. Torque in Nm, w in rps, travel in rev.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..jit import njit

# How the hysteresis amplitude Omega follows from F at the reversal (4)
OMEGA_CLIPPED = 0  # sgn(w) max(0, Fc - sgn(w) F): equals the paper's wherever sgn(w) F <= Fc, and never drives z1 away
OMEGA_SIGNED = 1  # sgn(w) Fc - F: bounded, but drops F from Fs towards Fc at every micro-reversal
OMEGA_LITERAL = 2  # sgn(w) |sgn(w) Fc - F|, the text of (2): unstable once sgn(w) F > Fc

# Below this share of Vs the Stribeck exponential is at its limit; a power of zero or an overflow is never computed.
STRIBECK_FLOOR = 1e-9
SLIDING_FROM, SLIDING_POINTS = 1e-4, 100  # of the highest speed: where the search for the least friction begins
PRESLIDING_OVER = 40.0  # travel since the reversal, in 1/K: exp(-40) of Omega is below the last digit of F


class FrictionConfig(NamedTuple):
    """Constants of the 2SEP model (Table I), scalars. `stribeck_exponent` < 0 is the literal, rising curve."""

    coulomb_nm: float  # Fc
    static_nm: float  # Fs
    stribeck_velocity_rps: float  # Vs
    stribeck_exponent: float  # delta
    viscous_nm_per_rps: float  # sigma
    stiffness_per_rev: float  # K
    attraction_nm_per_rev: float  # B
    omega_form: int  # OMEGA_*


class FrictionState(NamedTuple):
    """Memory of the 2SEP model, scalars."""

    torque_nm: float  # F
    travel_rev: float  # x_r >= 0, since the last reversal
    omega_nm: float  # signed hysteresis amplitude since the last reversal
    direction: float  # sgn(w) of the present motion: -1, 0 (never moved), 1


REST = FrictionState(0.0, 0.0, 0.0, 0.0)


@njit
def steady_friction_nm(config: FrictionConfig, velocity_rps: float) -> float:
    """|S(w)|: magnitude of the steady-state friction torque at a constant velocity (>= Fc for the classical curve)."""
    speed = abs(velocity_rps)
    share = stribeck_share(speed / config.stribeck_velocity_rps, config.stribeck_exponent)
    excess_nm = config.static_nm - config.coulomb_nm
    return config.coulomb_nm + excess_nm * share + config.viscous_nm_per_rps * speed


@njit
def stribeck_share(ratio: float, exponent: float) -> float:
    """Share of Fs - Fc that acts at a speed of `ratio` Vs."""
    if ratio > STRIBECK_FLOOR:
        return math.exp(-math.pow(ratio, exponent))
    return 1.0 if exponent > 0.0 else 0.0


def steady_friction_along(config: FrictionConfig, velocity_rps: Floats) -> Floats:
    """`steady_friction_nm` of many velocities, arrays (n,), without the compiler."""
    speeds_rps = np.abs(velocity_rps)
    ratios = speeds_rps / config.stribeck_velocity_rps
    moving = np.exp(-np.power(np.maximum(ratios, STRIBECK_FLOOR), config.stribeck_exponent))
    shares = np.where(ratios > STRIBECK_FLOOR, moving, 1.0 if config.stribeck_exponent > 0.0 else 0.0)
    excess_nm = config.static_nm - config.coulomb_nm
    return np.asarray(config.coulomb_nm + excess_nm * shares + config.viscous_nm_per_rps * speeds_rps)


def least_sliding_nm(config: FrictionConfig, highest_rps: float) -> float:
    """The smallest steady-state friction torque at any speed up to `highest_rps`.

    A fit that sees few slow speeds may put Fc at almost zero, under a Stribeck curve that never gets there.
    """
    return float(steady_friction_along(config, highest_rps * np.geomspace(SLIDING_FROM, 1.0, SLIDING_POINTS)).min())


@njit
def hysteresis_amplitude_nm(config: FrictionConfig, torque_nm: float, direction: float) -> float:
    """Signed Omega of (4) at a reversal towards `direction` (+-1) with friction torque F(t_r)."""
    distance_nm = config.coulomb_nm - direction * torque_nm
    if config.omega_form == OMEGA_CLIPPED:
        distance_nm = max(0.0, distance_nm)
    elif config.omega_form == OMEGA_LITERAL:
        distance_nm = abs(distance_nm)
    return direction * distance_nm


@njit
def _mean_decay(exponent: float) -> float:
    """(1 - exp(-u)) / u for u >= 0: mean of exp(-v) over v in 0..u, 1 at u = 0."""
    if exponent < 1e-12:
        return 1.0
    return -math.expm1(-exponent) / exponent


@njit
def torque_after(
    torque_nm: float, steady_nm: float, lag_per_rev: float, omega_nm: float, stiffness_per_rev: float,
    travel_rev: float, distance_rev: float,
) -> float:  # fmt: skip
    """F+ of a surface over a distance, without observation: towards `steady_nm`, `travel_rev` after a reversal."""
    share = -math.expm1(-lag_per_rev * distance_rev)  # 1 - E
    torque_nm = torque_nm + (steady_nm - torque_nm) * share
    if stiffness_per_rev * travel_rev > PRESLIDING_OVER:
        return torque_nm
    # (exp(-K d) - exp(-b d)) / (b - K), written so that b -> K has its limit and nothing overflows
    slower_per_rev = min(lag_per_rev, stiffness_per_rev)
    gap_per_rev = abs(lag_per_rev - stiffness_per_rev)
    overlap_rev = distance_rev * math.exp(-slower_per_rev * distance_rev) * _mean_decay(gap_per_rev * distance_rev)
    return torque_nm + omega_nm * stiffness_per_rev * math.exp(-stiffness_per_rev * travel_rev) * overlap_rev


@njit
def friction_step(
    config: FrictionConfig, state: FrictionState, velocity_rps: float, observation_nm_per_s: float, period_s: float
) -> FrictionState:
    """Friction after `period_s` at constant velocity (7), solved exactly; lambda(e) is constant over the step."""
    direction = state.direction
    travel_rev = state.travel_rev
    omega_nm = state.omega_nm
    if velocity_rps > 0.0:
        sign = 1.0
    elif velocity_rps < 0.0:
        sign = -1.0
    else:
        sign = 0.0
    speed_rps = abs(velocity_rps)
    if sign != direction and sign != 0.0:
        omega_nm = hysteresis_amplitude_nm(config, state.torque_nm, sign)
        travel_rev = 0.0
        direction = sign

    distance_rev = speed_rps * period_s
    steady_nm = steady_friction_nm(config, speed_rps)
    lag_per_rev = config.attraction_nm_per_rev / steady_nm  # b
    torque_nm = torque_after(
        state.torque_nm, direction * steady_nm, lag_per_rev, omega_nm, config.stiffness_per_rev, travel_rev,
        distance_rev,
    )  # fmt: skip
    if observation_nm_per_s != 0.0:
        torque_nm += observation_nm_per_s * period_s * _mean_decay(lag_per_rev * distance_rev)
    return FrictionState(torque_nm, travel_rev + distance_rev, omega_nm, direction)


@njit
def settled_friction(config: FrictionConfig, velocity_rps: float) -> FrictionState:
    """The state after a long motion at this velocity: F = S(w), presliding saturated. At w = 0: no friction."""
    if velocity_rps > 0.0:
        direction = 1.0
    elif velocity_rps < 0.0:
        direction = -1.0
    else:
        return FrictionState(0.0, 0.0, 0.0, 0.0)
    return FrictionState(direction * steady_friction_nm(config, velocity_rps), 0.0, 0.0, direction)

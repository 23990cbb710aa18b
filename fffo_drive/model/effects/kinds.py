"""Pieces that several laws are made of: waves, hysteresis, lags. Kernels without memory of their own."""

from __future__ import annotations

import math

from ...jit import njit
from . import slots as s
from .slots import Floats

TURN = 2.0 * math.pi
LEAST_LEVEL = 0.05  # of a surface, however much an effect takes away
PRESLIDING_OVER = 40.0  # exp(-40) of anything is nothing


@njit
def wave(cosine: float, sine: float, turns: float) -> float:
    """cosine cos(2 pi turns) + sine sin(2 pi turns)."""
    angle = TURN * turns
    return cosine * math.cos(angle) + sine * math.sin(angle)


@njit
def sign_of(value: float) -> float:
    """1, -1, or 0."""
    if value > 0.0:
        return 1.0
    return -1.0 if value < 0.0 else 0.0


@njit
def approach(value: float, goal: float, distance: float, length: float) -> float:
    """A first-order approach to `goal`, exact over `distance` (travel or time) with its `length`."""
    return goal + (value - goal) * math.exp(-distance / length)


@njit
def settled(elapsed: float, length: float) -> float:
    """1 - exp(-elapsed/length)."""
    return -math.expm1(-elapsed / length)


@njit
def steady_contact_nm(signals: Floats, speed_rps: float) -> float:
    """Level of the Stribeck curve at a speed, without its viscous part."""
    ratio = speed_rps / signals[s.STRIBECK_VELOCITY_RPS]
    exponent = signals[s.STRIBECK_EXPONENT]
    falling = 1.0 if exponent > 0.0 else 0.0
    if ratio > 1e-9:
        falling = math.exp(-math.pow(ratio, exponent))
    return float(signals[s.COULOMB_NM] + (signals[s.STATIC_NM] - signals[s.COULOMB_NM]) * falling)


@njit
def level_response(signals: Floats, memory: Floats, change: float) -> float:
    """What friction gains where the contact's level (Fc and Fs) is (1 + change) times as high; memory[0:4].

    The difference D of two 2SEP surfaces (2)-(7) on the same motion, one of them with the level S1 = S + change Sc:

        dD/dx = (Omega1 - Omega) K exp(-K x) + (B/S1) (change F Sc/S - D),    Sc: S(w) without its viscous part

    It follows a change of the level over the travel S1/B, keeps still at rest, and begins anew where friction does.
    memory: D, Omega1 - Omega, direction and F before.
    """
    direction = signals[s.DIRECTION]
    if direction == 0.0:
        memory[0] = 0.0
        memory[1] = 0.0
    scale = max(LEAST_LEVEL, 1.0 + change)
    friction_nm = signals[s.FRICTION_NM]
    if direction != memory[2]:
        memory[2] = direction
        coulomb_nm = signals[s.COULOMB_NM]
        missing_nm = coulomb_nm - direction * memory[3]
        missing_there_nm = scale * coulomb_nm - direction * (memory[3] + memory[0])
        memory[1] = direction * (max(0.0, missing_there_nm) - max(0.0, missing_nm))
    memory[3] = friction_nm
    speed_rps = abs(signals[s.VELOCITY_RPS])
    distance_rev = speed_rps * signals[s.STEP_S]
    if distance_rev == 0.0:
        return float(memory[0])
    contact_nm = signals[s.CONTACT_LEVEL_NM]
    if contact_nm <= 0.0:
        contact_nm = steady_contact_nm(signals, speed_rps)
    steady_nm = contact_nm + signals[s.VISCOUS_NM_PER_RPS] * speed_rps
    there_nm = steady_nm + (scale - 1.0) * contact_nm
    goal_nm = (scale - 1.0) * friction_nm * contact_nm / steady_nm
    memory[0] = approach(memory[0], goal_nm, distance_rev, there_nm / signals[s.ATTRACTION_NM_PER_REV])
    stiffness_per_rev = signals[s.STIFFNESS_PER_REV]
    before = stiffness_per_rev * max(0.0, signals[s.TRAVEL_REV] - distance_rev)
    if before < PRESLIDING_OVER:
        memory[0] += memory[1] * math.exp(-before) * -math.expm1(-stiffness_per_rev * distance_rev)
    return float(memory[0])

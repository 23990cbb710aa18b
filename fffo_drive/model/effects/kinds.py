"""Building blocks of several laws: waves, hysteresis, lags. Kernels without their own memory."""

from __future__ import annotations

import math

from ...arrays import Floats
from ...jit import njit
from ...units import TWO_PI
from ..friction import PRESLIDING_OVER, stribeck_share, torque_after
from . import slots as s

LEAST_LEVEL = 0.05  # smallest level of a surface, whatever an effect subtracts
LEVEL_MEMORY = 6  # slots that surface_response keeps; over_step has another, the second after them


@njit
def wave(cosine: float, sine: float, turns: float) -> float:
    """cosine cos(2 pi turns) + sine sin(2 pi turns)."""
    angle = TWO_PI * turns
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
    share = stribeck_share(speed_rps / signals[s.STRIBECK_VELOCITY_RPS], signals[s.STRIBECK_EXPONENT])
    return float(signals[s.COULOMB_NM] + (signals[s.STATIC_NM] - signals[s.COULOMB_NM]) * share)


@njit
def before_step(signals: Floats, memory: Floats, slot: int, value: float) -> float:
    """A value as the step began: of instants that of the one before, kept in memory[slot]; else it is held over it."""
    before = memory[slot] if signals[s.AT_INSTANTS] != 0.0 else value
    memory[slot] = value
    return float(before)


@njit
def over_step(signals: Floats, memory: Floats, value: float) -> float:
    """A value in the middle of the step that ends here, where a surface moved on. memory[LEVEL_MEMORY + 1]: before."""
    return 0.5 * (before_step(signals, memory, LEVEL_MEMORY + 1, value) + value)


@njit
def level_response(signals: Floats, memory: Floats, change: float) -> float:
    """Increase of friction if the contact's level (Fc and Fs) is (1 + change) times as high."""
    return surface_response(signals, memory, change, 0.0)


@njit
def surface_response(signals: Floats, memory: Floats, change: float, viscous_nm_per_rps: float) -> float:
    """Increase of friction on a surface of another level and a larger viscous coefficient; memory[0:LEVEL_MEMORY].

    The difference D of two 2SEP surfaces (2)-(7) on the same motion, both by their exact step: one has |S|, the other
    |S| + change Sc + viscous |w|, with Sc the part of |S| without viscous friction. The base surface begins each step
    with the friction in the signals, so that all other influences are in both. The distance is that of the travel: the
    speed of a sample is not the mean of its step, and a presliding that is crossed in one or two steps would not add
    up. memory: D, Omega of both surfaces, direction, F and travel before.
    """
    direction = signals[s.DIRECTION]
    before_nm, there_nm = memory[4], memory[4] + memory[0]
    scale = max(LEAST_LEVEL, 1.0 + change)
    if direction != memory[3]:
        memory[3] = direction
        coulomb_nm = signals[s.COULOMB_NM]
        memory[1] = direction * max(0.0, coulomb_nm - direction * before_nm)
        memory[2] = direction * max(0.0, scale * coulomb_nm - direction * there_nm)
        memory[5] = 0.0
    travel_rev = memory[5]
    distance_rev = signals[s.TRAVEL_REV] - travel_rev
    memory[4], memory[5] = signals[s.FRICTION_NM], signals[s.TRAVEL_REV]
    if direction == 0.0:
        memory[0] = 0.0
    if direction == 0.0 or distance_rev <= 0.0:
        return float(memory[0])
    speed_rps = distance_rev / signals[s.STEP_S]
    contact_nm = signals[s.CONTACT_LEVEL_NM]
    if contact_nm <= 0.0:
        contact_nm = steady_contact_nm(signals, speed_rps)
    level_nm = contact_nm + signals[s.VISCOUS_NM_PER_RPS] * speed_rps
    other_nm = max(LEAST_LEVEL * level_nm, level_nm + (scale - 1.0) * contact_nm + viscous_nm_per_rps * speed_rps)
    rate, stiffness_per_rev = signals[s.ATTRACTION_NM_PER_REV], signals[s.STIFFNESS_PER_REV]
    if stiffness_per_rev * travel_rev < PRESLIDING_OVER:
        memory[0] = torque_after(
            there_nm, direction * other_nm, rate / other_nm, memory[2], stiffness_per_rev, travel_rev, distance_rev
        ) - torque_after(
            before_nm, direction * level_nm, rate / level_nm, memory[1], stiffness_per_rev, travel_rev, distance_rev
        )
    else:
        memory[0] = approach(there_nm, direction * other_nm, distance_rev, other_nm / rate) - approach(
            before_nm, direction * level_nm, distance_rev, level_nm / rate
        )
    return float(memory[0])

"""The plant's own friction, in four kinds. None shares code with `fffo_drive.model`.

*Five surfaces.* The torque is the sum over the frictional surfaces f1 to f5 of the paper's Fig. 2b: four
bearings and the teeth of the gear. Each surface is an elasto-plastic element (Dupont et al., 2002): elastic up
to a share of its friction level, sliding at the level. The level follows the Stribeck curve over a sliding
distance, in which the contacts renew themselves. This gives frictional lag, and a break-away peak that depends
on the torque rate. Surfaces that break away one after another give presliding its hysteresis.

*Single surface.* The two-state model with elasto-plasticity (2SEP) as paper/NOTES.md derives it, by its exact
step.

*LuGre.* Bristles that bend from the first torque on and slip at the Stribeck level (Canudas de Wit, Olsson, Astrom and
Lischinsky, "A new model for control of systems with friction", IEEE TAC 40, 1995). Their damping fades with speed,
which keeps the contact dissipative (Olsson, 1996).

*Maxwell slip.* Parallel springs that break away one after another, so that a reversal within a stroke closes an inner
hysteresis loop (generalised Maxwell slip, Al-Bender, Lampaert and Swevers, IEEE TAC 50, 2005).

All columns are at the motor shaft: torque Nm, angle rev, speed rev/s. The step takes the speed as constant over it; it
is stable at any stiffness: exact, and linearly implicit for the five surfaces. Friction that opposes positive speed is
positive.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ...jit import njit

Table = np.ndarray[Any, np.dtype[np.float64]]

FIVE_SURFACES = 0
SINGLE_2SEP = 1
LUGRE = 2
MAXWELL_SLIP = 3

# columns of the parameter table; one row a surface
COULOMB_NM = 0
RISE_NM = 1  # stiction minus Coulomb level
VISCOUS_NM_PER_RPS = 2
PER_STRIBECK_RPS = 3  # 1/Vs
STRIBECK_EXPONENT = 4
STIFFNESS = 5  # Nm/rev of the elastic contact; single: K in 1/rev
ELASTIC_SHARE = 6  # surfaces: share of the level below which the contact is elastic
DAMPING = 6  # LuGre: Nm/rps of the bristles
MEMORY = 7  # surfaces: 1/rev, one over the sliding distance that renews the level; single: B in Nm/rev
ATTRACTION = 7  # Maxwell slip: rate in Nm/s at which a slipping element follows the level
TABLE_COLUMNS = 8

# columns of the state, surfaces: contact torque, and share of the stiction rise in force (1 at rest)
CONTACT_NM = 0
STICTION = 1
SLIPS = 1  # Maxwell slip: direction (+-1) in which the element slips; 0: it sticks
# columns of the state, single surface
FRICTION_NM = 0
OMEGA_NM = 1
TRAVEL_REV = 2
DIRECTION = 3
STATE_COLUMNS = 4

_NEGLIGIBLE = 25.0  # exp(-25) of a level is far below what can be measured


class FrictionScales(NamedTuple):
    """Factors of effects and temperature on the friction; 1: no change."""

    level: float  # multiplies Coulomb and stiction level
    stiction: float  # multiplies the rise from Coulomb to stiction level
    viscous: float


@njit
def stribeck_share(ratio: float, exponent: float) -> float:
    """exp(-ratio^exponent) with ratio = |w|/Vs: share of the stiction rise at a steady speed."""
    if exponent == 2.0:
        ratio = ratio * ratio
    elif exponent != 1.0:
        ratio = math.pow(ratio, exponent)
    return math.exp(-ratio) if ratio < _NEGLIGIBLE else 0.0


@njit
def _contact_step(load_nm: float, level_nm: float, elastic_share: float, pull_nm: float) -> float:
    """One elasto-plastic contact over a step that would load it by `pull_nm` if it were elastic; > 0 along the motion.

    dz = k dx (1 - alpha z/g): alpha = y^2 (3 - 2 y) rises from 0 (elastic, or unloading) at the load elastic_share * g
    to 1 at g. Linearly implicit with the alpha at the start of the step, so stable at any stiffness. Loading never
    exceeds the level; a contact above it (the level fell) slides down to it.
    """
    if load_nm <= elastic_share * level_nm:
        return min(level_nm, load_nm + pull_nm)
    if load_nm >= level_nm:
        return (load_nm + pull_nm) * (level_nm / (level_nm + pull_nm))
    yielding_nm = load_nm - elastic_share * level_nm  # y = yielding/span, without a division of its own
    span_nm = (1.0 - elastic_share) * level_nm
    whole = span_nm * span_nm * span_nm
    alpha_of_whole = yielding_nm * yielding_nm * (3.0 * span_nm - 2.0 * yielding_nm)
    return min(level_nm, (load_nm + pull_nm) * (level_nm * whole / (level_nm * whole + alpha_of_whole * pull_nm)))


@njit(inline="always")
def surfaces_step(table: Table, state: Table, velocity_rps: float, step_s: float, scales: FrictionScales) -> float:
    """Friction torque of all surfaces (Nm) after one step at a constant speed. Updates `state`."""
    direction = 1.0 if velocity_rps > 0.0 else -1.0
    speed_rps = abs(velocity_rps)
    travel_rev = speed_rps * step_s
    load_nm = 0.0  # along the motion
    viscous = 0.0
    for k in range(table.shape[0]):
        viscous += table[k, VISCOUS_NM_PER_RPS]
        contact_nm = direction * state[k, CONTACT_NM]
        if speed_rps > 0.0:
            renewed = travel_rev * table[k, MEMORY]
            kept = 1.0 / (1.0 + renewed)  # beside the exponential, not after it
            steady = stribeck_share(speed_rps * table[k, PER_STRIBECK_RPS], table[k, STRIBECK_EXPONENT])
            stiction = (state[k, STICTION] + renewed * steady) * kept
            state[k, STICTION] = stiction
            level_nm = scales.level * (table[k, COULOMB_NM] + scales.stiction * table[k, RISE_NM] * stiction)
            contact_nm = _contact_step(contact_nm, level_nm, table[k, ELASTIC_SHARE], table[k, STIFFNESS] * travel_rev)
            state[k, CONTACT_NM] = direction * contact_nm
        load_nm += contact_nm
    return direction * load_nm + scales.viscous * viscous * velocity_rps


@njit
def single_step(
    table: Table,
    state: Table,
    velocity_rps: float,
    step_s: float,
    scales: FrictionScales,
) -> float:
    """Friction torque (Nm) of the 2SEP surface after one step at constant speed: paper/NOTES.md, "The exact
    step".

    F+ = F E + s |S| (1 - E) + Omega K exp(-K x) (exp(-K d) - E)/(b - K), with d = |w| h, b = B/|S|, E =
    exp(-b d) and x the travel since the reversal. Omega is the clipped one: s max(0, Fc - s F at the
    reversal).
    """
    friction_nm = state[0, FRICTION_NM]
    if velocity_rps == 0.0:
        return float(friction_nm)
    direction = 1.0 if velocity_rps > 0.0 else -1.0
    speed_rps = abs(velocity_rps)
    travel_rev = speed_rps * step_s
    coulomb_nm = scales.level * table[0, COULOMB_NM]
    if direction != state[0, DIRECTION]:
        state[0, DIRECTION] = direction
        state[0, TRAVEL_REV] = 0.0
        missing = coulomb_nm - direction * friction_nm
        state[0, OMEGA_NM] = direction * missing if missing > 0.0 else 0.0
    steady = stribeck_share(speed_rps * table[0, PER_STRIBECK_RPS], table[0, STRIBECK_EXPONENT])
    rise_nm = scales.level * scales.stiction * table[0, RISE_NM]
    level_nm = coulomb_nm + rise_nm * steady + scales.viscous * table[0, VISCOUS_NM_PER_RPS] * speed_rps
    stiffness_per_rev = table[0, STIFFNESS]
    rate_per_rev = table[0, MEMORY] / level_nm
    kept = math.exp(-rate_per_rev * travel_rev)
    before_rev = state[0, TRAVEL_REV]
    difference = rate_per_rev - stiffness_per_rev
    if abs(difference) * travel_rev < 1e-6:
        response_rev = travel_rev * kept * (1.0 + 0.5 * difference * travel_rev)
    else:
        response_rev = (math.exp(-stiffness_per_rev * travel_rev) - kept) / difference
    excitation_nm = state[0, OMEGA_NM] * stiffness_per_rev * math.exp(-stiffness_per_rev * before_rev)
    friction_nm = friction_nm * kept + direction * level_nm * (1.0 - kept) + excitation_nm * response_rev
    state[0, FRICTION_NM] = friction_nm
    state[0, TRAVEL_REV] = before_rev + travel_rev
    return float(friction_nm)


@njit
def _level_nm(table: Table, row: int, speed_rps: float, scales: FrictionScales) -> float:
    """Stribeck level without viscous friction."""
    steady = stribeck_share(speed_rps * table[row, PER_STRIBECK_RPS], table[row, STRIBECK_EXPONENT])
    return float(scales.level * (table[row, COULOMB_NM] + scales.stiction * table[row, RISE_NM] * steady))


@njit
def lugre_step(table: Table, state: Table, velocity_rps: float, step_s: float, scales: FrictionScales) -> float:
    """Friction torque (Nm) of LuGre bristles after one step at constant speed, exact.

    With c = s0 z: dc/dt = s0 v (1 - c sgn(v) / g(v)), torque = c + s1(v) dz/dt + s2 v, s1(v) = s1 exp(-(v/Vs)^2).
    """
    bristles_nm = state[0, CONTACT_NM]
    if velocity_rps == 0.0:
        return float(bristles_nm)
    direction = 1.0 if velocity_rps > 0.0 else -1.0
    speed_rps = abs(velocity_rps)
    end_nm = direction * _level_nm(table, 0, speed_rps, scales)
    stiffness = table[0, STIFFNESS]
    moved_nm = (end_nm - bristles_nm) * (1.0 - math.exp(-stiffness * speed_rps * step_s / abs(end_nm)))
    state[0, CONTACT_NM] = bristles_nm + moved_nm
    fading = stribeck_share(speed_rps * table[0, PER_STRIBECK_RPS], 2.0)
    bending_rps = moved_nm / (stiffness * step_s)
    viscous = scales.viscous * table[0, VISCOUS_NM_PER_RPS]
    return float(bristles_nm + moved_nm + table[0, DAMPING] * fading * bending_rps + viscous * velocity_rps)


@njit
def maxwell_slip_step(table: Table, state: Table, velocity_rps: float, step_s: float, scales: FrictionScales) -> float:
    """Friction torque (Nm) of parallel Maxwell slip elements after one step at constant speed, exact in each phase.

    An element that sticks is a spring, until it reaches its share of the level; one that slips follows that share,
    dF/dt = C (1 - F/S), and sticks again when the motion reverses.
    """
    direction = 1.0 if velocity_rps > 0.0 else -1.0
    speed_rps = abs(velocity_rps)
    total_nm = 0.0
    for k in range(table.shape[0]):
        torque_nm = state[k, CONTACT_NM]
        if speed_rps > 0.0:
            load_nm = direction * torque_nm
            level_nm = _level_nm(table, k, speed_rps, scales)
            slips = direction * state[k, SLIPS] > 0.0
            if slips:
                load_nm = level_nm + (load_nm - level_nm) * math.exp(-table[k, ATTRACTION] * step_s / level_nm)
            else:
                load_nm += table[k, STIFFNESS] * speed_rps * step_s
                if load_nm >= level_nm:
                    load_nm = level_nm
                    slips = True
            state[k, SLIPS] = direction if slips else 0.0
            torque_nm = direction * load_nm
            state[k, CONTACT_NM] = torque_nm
        total_nm += torque_nm + scales.viscous * table[k, VISCOUS_NM_PER_RPS] * velocity_rps
    return float(total_nm)


@njit(inline="always")
def friction_after(
    kind: int, table: Table, state: Table, velocity_rps: float, step_s: float, scales: FrictionScales
) -> float:
    """Friction torque (Nm) of a kind after one step at a constant speed. Updates `state`."""
    if kind == FIVE_SURFACES:
        return surfaces_step(table, state, velocity_rps, step_s, scales)
    if kind == SINGLE_2SEP:
        return single_step(table, state, velocity_rps, step_s, scales)
    if kind == LUGRE:
        return lugre_step(table, state, velocity_rps, step_s, scales)
    return maxwell_slip_step(table, state, velocity_rps, step_s, scales)

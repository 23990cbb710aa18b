"""The plant: from the command that the drive has taken to the motion of the shaft, in sub-steps of 1/22 kHz.

    J dw/dt = T(i) - F(w, ...) + what effects add

A sub-step computes the friction at its initial speed, then advances speed and angle; this keeps the energy of elastic
contacts bounded. Advancing by 11 sub-steps gives the same bits as advancing 11 times by one. Without effects their
code is skipped.
"""

from __future__ import annotations

from ...jit import njit
from ...units import TWO_PI
from . import state as at
from .current_loop import current_step, transport_step
from .effects.stages import Effects, effects_on_demand, effects_on_sensor, effects_on_shaft, effects_on_torque
from .friction import FrictionScales, friction_after
from .noise import random_normal
from .resolver import resolver_step
from .state import STEP_S, SUBSTEPS_PER_S, Floats, Integers, PlantParameters, PlantState

_ROUGH_RPS = 0.5  # speed at which half of the roughness acts


@njit
def _roughness(c: Floats, x: Floats, words: Integers) -> float:
    """Coloured torque from surface roughness, which no model explains. Zero at rest."""
    if c[at.ROUGHNESS_NM] == 0.0:
        return 0.0
    x[at.ROUGH_NM] = c[at.ROUGHNESS_KEPT] * x[at.ROUGH_NM] + c[at.ROUGHNESS_NM] * random_normal(words)
    speed_rps = abs(x[at.VELOCITY_RPS])
    return float(x[at.ROUGH_NM] * speed_rps / (speed_rps + _ROUGH_RPS))


@njit
def _warm_up(c: Floats, x: Floats) -> None:
    current_a = x[at.CURRENT_A]
    loss_w = c[at.RESISTANCE_OHM] * current_a * current_a
    loss_w += TWO_PI * abs(x[at.FRICTION_NM] * x[at.VELOCITY_RPS])
    x[at.TEMPERATURE_K] += c[at.WARMING_K_PER_W] * loss_w - c[at.COOLING] * x[at.TEMPERATURE_K]


@njit
def _move(c: Floats, x: Floats, torque_nm: float) -> float:
    """Speed and angle after the sub-step under a net torque (Nm). Returns the angle (rev)."""
    velocity_rps = x[at.VELOCITY_RPS]
    next_rps = velocity_rps + c[at.SPEED_PER_TORQUE] * torque_nm
    x[at.VELOCITY_RPS] = next_rps
    angle_rev = x[at.ANGLE_REV] + 0.5 * (velocity_rps + next_rps) * STEP_S
    x[at.ANGLE_REV] = angle_rev
    return float(angle_rev)


@njit
def plant_advance(parameters: PlantParameters, state: PlantState, command_a: float, substeps: int) -> None:
    """Advance by a number of sub-steps of 1/22 kHz (11 a tick of 2 kHz) with one held command (A)."""
    c, x, words = parameters.numbers, state.values, state.words
    table, contacts, line = parameters.friction, state.friction, state.delay_line
    friction_kind = parameters.integers[at.FRICTION_KIND]
    transport = parameters.integers[at.TRANSPORT_STEPS]
    effects = Effects(
        parameters.integers[at.FIRST_OF_STAGE :],
        parameters.effects,
        parameters.effect_parameters,
        state.effect_memory,
        state.signals,
    )
    with_effects = parameters.effects.shape[0] > 0
    for _ in range(substeps):
        demand_a = transport_step(line, words, transport, c[at.TRANSPORT_FRACTION], command_a)
        if with_effects:
            time_s = words[at.SUBSTEP] * STEP_S
            demand_a = effects_on_demand(effects, time_s, x[at.VELOCITY_RPS], x[at.ANGLE_REV], demand_a)
        current_a = current_step(c, x, words, demand_a)
        torque_nm = float(c[at.TORQUE_CONSTANT] * current_a)
        temperature_k = x[at.TEMPERATURE_K]
        level = float(1.0 + c[at.COULOMB_PER_K] * temperature_k)
        scales = FrictionScales(level, 1.0, float(1.0 + c[at.VISCOUS_PER_K] * temperature_k))
        if with_effects:
            torque_nm, scales = effects_on_torque(effects, current_a, torque_nm, scales)
        velocity_rps = float(x[at.VELOCITY_RPS])
        friction_nm = friction_after(friction_kind, table, contacts, velocity_rps, STEP_S, scales)
        added_nm = 0.0
        if with_effects:
            added_nm, added_friction_nm = effects_on_shaft(effects, friction_nm)
            friction_nm += added_friction_nm
        friction_nm += _roughness(c, x, words)
        x[at.FRICTION_NM] = friction_nm
        x[at.TORQUE_NM] = torque_nm
        sensed_rev = _move(c, x, torque_nm - friction_nm + added_nm - float(c[at.OFFSET_NM_PER_K] * temperature_k))
        _warm_up(c, x)
        if with_effects:
            sensed_rev = effects_on_sensor(effects, sensed_rev)
        resolver_step(c, x, words, sensed_rev)
        words[at.SUBSTEP] += 1


@njit
def substeps_due(state: PlantState, elapsed_ns: int) -> int:
    """Sub-steps still to run until `elapsed_ns` since power-on (0 when the plant is not behind).

    Integer arithmetic, so that no error accumulates: 22 sub-steps are a millisecond.
    """
    due = elapsed_ns * (SUBSTEPS_PER_S // 1000) // 1_000_000 - int(state.words[at.SUBSTEP])
    return due if due > 0 else 0

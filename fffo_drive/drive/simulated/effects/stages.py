"""The stages of a sub-step at which effects act, with their inputs and results."""

from __future__ import annotations

from typing import NamedTuple

from ....jit import njit
from ....jit.by_address import call_on_vectors
from ..friction import FrictionScales
from ..state import Floats, Integers
from . import slots


class Effects(NamedTuple):
    """The effects of a plant, as its sub-steps run them, in the order of their stages."""

    first: Integers  # (N_STAGES + 1,); effects first[stage] to first[stage + 1] belong to a stage
    addresses: Integers  # (effects,)
    parameters: Floats  # (effects, slots.MAX_PARAMETERS)
    memory: Floats  # (effects, slots.MEMORY_SLOTS)
    signals: Floats  # (slots.N_SLOTS,)


@njit
def _run_stage(effects: Effects, stage: int) -> None:
    first = effects.first[stage]
    beyond = effects.first[stage + 1]
    for k in range(first, beyond):
        call_on_vectors(effects.addresses[k], effects.signals, effects.parameters[k], effects.memory[k])


@njit
def effects_on_demand(effects: Effects, time_s: float, velocity_rps: float, angle_rev: float, demand_a: float) -> float:
    """Begin a sub-step for the effects, and let them change the current demand (A)."""
    signals = effects.signals
    signals[slots.TIME_S] = time_s
    signals[slots.VELOCITY_RPS] = velocity_rps
    signals[slots.ANGLE_REV] = angle_rev
    signals[slots.COMMAND_A] = demand_a
    _run_stage(effects, slots.COMMAND)
    return float(signals[slots.COMMAND_A])


@njit
def effects_on_torque(
    effects: Effects, current_a: float, torque_nm: float, scales: FrictionScales
) -> tuple[float, FrictionScales]:
    """Motor torque (Nm) and scales of the base friction, as the effects change them."""
    signals = effects.signals
    signals[slots.CURRENT_A] = current_a
    signals[slots.TORQUE_NM] = torque_nm
    signals[slots.LEVEL_SCALE] = scales.level
    signals[slots.STICTION_SCALE] = scales.stiction
    signals[slots.VISCOUS_SCALE] = scales.viscous
    _run_stage(effects, slots.TORQUE)
    _run_stage(effects, slots.LEVEL)
    changed = FrictionScales(
        float(signals[slots.LEVEL_SCALE]),
        float(signals[slots.STICTION_SCALE]),
        float(signals[slots.VISCOUS_SCALE]),
    )
    return float(signals[slots.TORQUE_NM]), changed


@njit
def effects_on_shaft(effects: Effects, friction_nm: float) -> tuple[float, float]:
    """Torque and friction (Nm) that effects add on the shaft."""
    signals = effects.signals
    signals[slots.FRICTION_NM] = friction_nm
    signals[slots.ADDED_TORQUE_NM] = 0.0
    signals[slots.ADDED_FRICTION_NM] = 0.0
    _run_stage(effects, slots.LOAD)
    return float(signals[slots.ADDED_TORQUE_NM]), float(signals[slots.ADDED_FRICTION_NM])


@njit
def effects_on_sensor(effects: Effects, angle_rev: float) -> float:
    """The angle (rev) that the resolver sees."""
    signals = effects.signals
    signals[slots.ANGLE_REV] = angle_rev
    signals[slots.SENSED_REV] = angle_rev
    _run_stage(effects, slots.SENSOR)
    return float(signals[slots.SENSED_REV])

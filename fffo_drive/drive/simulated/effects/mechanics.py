"""Effects of the mechanics behind the shaft and of the sensor: elasticity, backlash, resolver error."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from ....jit import njit
from ....units import TWO_PI
from . import slots as s
from .declaration import PlantEffect, PlantParameter, Values
from .slots import Vector

if TYPE_CHECKING:
    from ..parameters import PlantConfig

_CREEP_RPS = 0.02  # speed at which the load's own friction acts in full


@njit
def _joint(load_share: float, frequency_hz: float, inertia: float) -> tuple[float, float]:
    """Inertia of the load, and stiffness (Nm/rev) that gives motor against load this resonance."""
    load_inertia = load_share * inertia
    angular = TWO_PI * frequency_hz
    return load_inertia, angular * angular * load_inertia * (1.0 - load_share)


@njit
def elasticity(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A share of the inertia hangs on a damped spring. memory: speed of the load, twist of the spring."""
    load_share, frequency_hz, damping = parameters[0], parameters[1], parameters[2]
    load_inertia, stiffness = _joint(load_share, frequency_hz, signals[s.INERTIA_NM_S2_PER_REV])
    reduced_inertia = load_inertia * (1.0 - load_share)
    slip_rps = signals[s.VELOCITY_RPS] - memory[0]
    twist_rev = memory[1] + slip_rps * signals[s.STEP_S]
    joint_nm = stiffness * twist_rev + 2.0 * damping * TWO_PI * frequency_hz * reduced_inertia * slip_rps
    memory[0] += joint_nm / load_inertia * signals[s.STEP_S]
    memory[1] = twist_rev
    signals[s.ADDED_TORQUE_NM] -= joint_nm


@njit
def backlash(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A share of inertia and friction lies behind a gap. memory: speed of the load, lead of the motor in the
    gap.

    The flanks are stiff, damped, and only push. In the gap the motor turns without the load.
    """
    gap_rev, load_share, friction_share, contact_hz = (
        parameters[0],
        parameters[1],
        parameters[2],
        parameters[3],
    )
    step_s = signals[s.STEP_S]
    load_inertia, stiffness = _joint(load_share, contact_hz, signals[s.INERTIA_NM_S2_PER_REV])
    damping = 0.5 * stiffness / (TWO_PI * contact_hz)
    slip_rps = signals[s.VELOCITY_RPS] - memory[0]
    lead_rev = memory[1] + slip_rps * step_s
    joint_nm = 0.0
    if lead_rev > 0.5 * gap_rev:
        joint_nm = max(0.0, stiffness * (lead_rev - 0.5 * gap_rev) + damping * slip_rps)
    elif lead_rev < -0.5 * gap_rev:
        joint_nm = min(0.0, stiffness * (lead_rev + 0.5 * gap_rev) + damping * slip_rps)
    grip = memory[0] / _CREEP_RPS
    grip = min(1.0, max(-1.0, grip))
    drag_nm = friction_share * signals[s.COULOMB_NM] * grip
    memory[0] += (joint_nm - drag_nm) / load_inertia * step_s
    memory[1] = lead_rev
    signals[s.ADDED_TORQUE_NM] -= joint_nm


@njit
def resolver_error(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """Eccentricity and winding errors: first and second harmonics of the angle are read on top of it."""
    angle_rev = signals[s.ANGLE_REV]
    error_rev = parameters[0] * math.cos(TWO_PI * (angle_rev + parameters[1]))
    error_rev += parameters[2] * math.cos(TWO_PI * (2.0 * angle_rev + parameters[3]))
    signals[s.SENSED_REV] += error_rev


def _elasticity(config: PlantConfig, values: Values) -> PlantConfig:
    return replace(config, motor_inertia_share=config.motor_inertia_share - values["load_share"])


def _backlash(config: PlantConfig, values: Values) -> PlantConfig:
    friction = config.friction.scaled(level=1.0 - values["friction_share"])
    return replace(_elasticity(config, values), friction=friction)


EFFECTS = (
    PlantEffect(
        "elasticity",
        s.LOAD,
        elasticity,
        (
            PlantParameter("load_share", "-", 0.4, 0.0, 0.9, "share of the inertia behind the spring", True),
            PlantParameter("frequency_hz", "Hz", 45.0, 0.5, 1500.0, "resonance of motor against load"),
            PlantParameter("damping", "-", 0.03, 0.0, 1.0, "damping ratio of that resonance"),
        ),
        "elastic joint: two masses on a spring",
        _elasticity,
    ),
    PlantEffect(
        "backlash",
        s.LOAD,
        backlash,
        (
            PlantParameter("gap_rev", "rev", 0.02, 0.0, 1.0, "width of the gap at the motor shaft", True),
            PlantParameter("load_share", "-", 0.3, 0.01, 0.9, "share of the inertia behind the gap"),
            PlantParameter("friction_share", "-", 0.3, 0.0, 0.9, "share of the friction level behind the gap"),
            PlantParameter("contact_hz", "Hz", 250.0, 10.0, 1500.0, "resonance of the closed joint: its stiffness"),
        ),
        "gap between motor and load",
        _backlash,
    ),
    PlantEffect(
        "resolver_error",
        s.SENSOR,
        resolver_error,
        (
            PlantParameter("first_rev", "rev", 0.001, 0.0, 0.05, "amplitude once a revolution", True),
            PlantParameter("first_phase_rev", "rev", 0.0, -1.0, 1.0, "its phase, as a share of the period"),
            PlantParameter("second_rev", "rev", 0.0005, 0.0, 0.05, "amplitude twice a revolution", True),
            PlantParameter("second_phase_rev", "rev", 0.0, -1.0, 1.0, "its phase, as a share of the period"),
        ),
        "position error periodic in the motor angle",
    ),
)

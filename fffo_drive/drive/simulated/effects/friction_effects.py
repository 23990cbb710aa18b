"""Effects on the base friction, and friction beside it: asymmetry, shape, dwell, load, place, drift, drag."""

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


@njit
def direction_of(velocity_rps: float) -> float:
    """1, -1, or 0 at rest."""
    if velocity_rps > 0.0:
        return 1.0
    return -1.0 if velocity_rps < 0.0 else 0.0


@njit
def asymmetric_coulomb(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """The friction level is higher in positive direction and lower in negative."""
    signals[s.LEVEL_SCALE] *= 1.0 + parameters[0] * direction_of(signals[s.VELOCITY_RPS])


@njit
def asymmetric_viscous(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """The viscous coefficient is higher in positive direction and lower in negative."""
    signals[s.VISCOUS_SCALE] *= 1.0 + parameters[0] * direction_of(signals[s.VELOCITY_RPS])


@njit
def dwell_stiction(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """Contacts age: adhesion grows at rest and is lost by travel.

    memory[0]: adhesion from 0 to 1. At rest it approaches 1 with the time constant, in motion it decays with
    travel.
    """
    rise_share, time_constant_s, release_rev, rest_rps = (
        parameters[0],
        parameters[1],
        parameters[2],
        parameters[3],
    )
    speed_rps = abs(signals[s.VELOCITY_RPS])
    step_s = signals[s.STEP_S]
    if speed_rps < rest_rps:
        memory[0] += (1.0 - memory[0]) * step_s / time_constant_s
    else:
        memory[0] *= math.exp(-speed_rps * step_s / release_rev)
    signals[s.LEVEL_SCALE] *= 1.0 + rise_share * memory[0]


@njit
def load_dependent_friction(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """Transmitted torque loads the teeth: the level rises in proportion to it."""
    signals[s.LEVEL_SCALE] += parameters[0] * abs(signals[s.TORQUE_NM]) / signals[s.COULOMB_NM]


@njit
def position_dependent_friction(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """The level varies along the travel: a wave, and a window (a worn or a tight place) once a period."""
    wave_share, window_share, period_rev = parameters[0], parameters[1], parameters[2]
    centre_rev, width_rev = parameters[3], parameters[4]
    angle_rev = signals[s.ANGLE_REV]
    scale = 1.0 + wave_share * math.cos(TWO_PI * angle_rev / period_rev)
    periods = (angle_rev - centre_rev) / period_rev
    away_rev = period_rev * (periods - math.floor(periods + 0.5))
    if abs(away_rev) < 0.5 * width_rev:
        scale += window_share
    signals[s.LEVEL_SCALE] *= scale


@njit
def friction_ripple(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """The level varies with the motor angle: a ripple that changes its sign with the direction."""
    share, order, phase_rev = parameters[0], parameters[1], parameters[2]
    signals[s.LEVEL_SCALE] *= 1.0 + share * math.cos(TWO_PI * (order * signals[s.ANGLE_REV] + phase_rev))


@njit
def _drift(signals: Vector, share: float, time_constant_s: float) -> float:
    return 1.0 + share * (1.0 - math.exp(-signals[s.TIME_S] / time_constant_s))


@njit
def coulomb_drift(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """The level drifts with the time since power-on."""
    signals[s.LEVEL_SCALE] *= _drift(signals, parameters[0], parameters[1])


@njit
def viscous_drift(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """The viscous coefficient drifts with the time since power-on."""
    signals[s.VISCOUS_SCALE] *= _drift(signals, parameters[0], parameters[1])


@njit
def thermal_drift(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """Friction warms the lubricant, which thins it: the viscous coefficient falls as work is done.

    memory[0]: temperature rise in kelvin, first order in the power that base friction turns into heat.
    """
    per_k, k_per_w, time_constant_s = parameters[0], parameters[1], parameters[2]
    power_w = TWO_PI * abs(signals[s.FRICTION_NM] * signals[s.VELOCITY_RPS])
    memory[0] += (power_w * k_per_w - memory[0]) * signals[s.STEP_S] / time_constant_s
    signals[s.VISCOUS_SCALE] *= math.exp(per_k * memory[0])


@njit
def quadratic_drag(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A fan or churned oil: torque with the square of the speed."""
    velocity_rps = signals[s.VELOCITY_RPS]
    signals[s.ADDED_FRICTION_NM] += parameters[0] * velocity_rps * abs(velocity_rps)


def _stribeck_shape(config: PlantConfig, values: Values) -> PlantConfig:
    friction = config.friction.scaled(rise=1.0 + values["rise_share"], stribeck_velocity=1.0 + values["velocity_share"])
    return replace(config, friction=friction)


def _presliding_shape(config: PlantConfig, values: Values) -> PlantConfig:
    return replace(config, friction=config.friction.scaled(stiffness=1.0 + values["stiffness_share"]))


def _frictional_lag(config: PlantConfig, values: Values) -> PlantConfig:
    return replace(config, friction=config.friction.scaled(memory=1.0 + values["length_share"]))


_SHARE = PlantParameter("share", "-", 0.2, -0.9, 0.9, "change of the level in positive direction, as a share", True)
_DRIFT = (
    PlantParameter("share", "-", 0.3, -0.9, 5.0, "final change, as a share", True),
    PlantParameter("time_constant_s", "s", 60.0, 0.1, 100_000.0, "time constant"),
)

EFFECTS = (
    PlantEffect(
        "asymmetric_coulomb",
        s.LEVEL,
        asymmetric_coulomb,
        (_SHARE,),
        "friction level differs between the directions",
    ),
    PlantEffect(
        "asymmetric_viscous",
        s.LEVEL,
        asymmetric_viscous,
        (_SHARE._replace(default=0.3, meaning="change of the coefficient in positive direction, as a share"),),
        "viscous friction differs between the directions",
    ),
    PlantEffect(
        "stribeck_shape",
        s.PREPARED,
        None,
        (
            PlantParameter("rise_share", "-", 0.4, -1.0, 5.0, "change of the rise from Coulomb to stiction", True),
            PlantParameter("velocity_share", "-", 1.0, -0.9, 20.0, "change of the Stribeck velocity", True),
        ),
        "a Stribeck curve that differs from the configured one",
        _stribeck_shape,
    ),
    PlantEffect(
        "presliding_shape",
        s.PREPARED,
        None,
        (PlantParameter("stiffness_share", "-", -0.7, -0.95, 20.0, "change of the contacts' stiffness", True),),
        "contacts softer or stiffer than configured",
        _presliding_shape,
    ),
    PlantEffect(
        "frictional_lag",
        s.PREPARED,
        None,
        (PlantParameter("length_share", "-", 3.0, -0.95, 50.0, "change of the sliding distance of the memory", True),),
        "friction follows the Stribeck curve over a different distance",
        _frictional_lag,
    ),
    PlantEffect(
        "dwell_stiction",
        s.LEVEL,
        dwell_stiction,
        (
            PlantParameter("rise_share", "-", 0.8, 0.0, 10.0, "rise of the level after a long rest, as a share", True),
            PlantParameter("time_constant_s", "s", 3.0, 0.01, 10_000.0, "time constant of the rise"),
            PlantParameter("release_rev", "rev", 0.03, 0.0001, 10.0, "travel over which it is lost"),
            PlantParameter("rest_rps", "rps", 0.05, 0.0001, 10.0, "speed below which the contact counts as at rest"),
        ),
        "break-away torque grows with the time at rest",
    ),
    PlantEffect(
        "load_dependent_friction",
        s.LEVEL,
        load_dependent_friction,
        (PlantParameter("share", "-", 0.1, 0.0, 0.9, "friction per transmitted torque", True),),
        "friction grows with the transmitted torque",
    ),
    PlantEffect(
        "position_dependent_friction",
        s.LEVEL,
        position_dependent_friction,
        (
            PlantParameter("wave_share", "-", 0.25, -0.9, 0.9, "amplitude of the wave, as a share of the level", True),
            PlantParameter("window_share", "-", 0.0, -0.9, 10.0, "change inside the window, as a share", True),
            PlantParameter("period_rev", "rev", 8.0, 0.1, 10_000.0, "period along the travel"),
            PlantParameter("centre_rev", "rev", 0.0, -10_000.0, 10_000.0, "centre of the window"),
            PlantParameter("width_rev", "rev", 1.0, 0.001, 10_000.0, "width of the window"),
        ),
        "friction level varies along the travel: a wave, a window, or both",
    ),
    PlantEffect(
        "friction_ripple",
        s.LEVEL,
        friction_ripple,
        (
            PlantParameter("share", "-", 0.25, 0.0, 0.9, "amplitude as a share of the level", True),
            PlantParameter("order", "1/rev", 2.0, 0.001, 1000.0, "periods in a motor revolution"),
            PlantParameter("phase_rev", "rev", 0.0, -1.0, 1.0, "phase, as a share of the period"),
        ),
        "friction level varies with the motor angle",
    ),
    PlantEffect("coulomb_drift", s.LEVEL, coulomb_drift, _DRIFT, "friction level drifts with time"),
    PlantEffect("viscous_drift", s.LEVEL, viscous_drift, _DRIFT, "viscous friction drifts with time"),
    PlantEffect(
        "thermal_drift",
        s.LEVEL,
        thermal_drift,
        (
            PlantParameter("per_k", "1/K", -0.03, -0.2, 0.2, "relative change of viscous friction per kelvin", True),
            PlantParameter("k_per_w", "K/W", 4.0, 0.0, 1000.0, "temperature rise per watt of friction loss"),
            PlantParameter("time_constant_s", "s", 40.0, 0.1, 100_000.0, "thermal time constant"),
        ),
        "viscous friction falls as friction warms the lubricant",
    ),
    PlantEffect(
        "quadratic_drag",
        s.LOAD,
        quadratic_drag,
        (PlantParameter("drag_nm_per_rps2", "Nm s^2/rev^2", 1e-4, -1e-4, 0.01, "torque per speed squared", True),),
        "drag that grows with the square of the speed",
    ),
)

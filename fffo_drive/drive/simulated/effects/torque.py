"""Effects between command and shaft torque: offset, cogging, ripple, saturation, dead zone, lag, delay."""

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
def torque_offset(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A constant torque."""
    signals[s.ADDED_TORQUE_NM] += parameters[0]


@njit
def cogging(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A torque that is periodic in the motor angle and keeps its sign when the direction changes."""
    amplitude_nm, order, phase_rev = parameters[0], parameters[1], parameters[2]
    signals[s.ADDED_TORQUE_NM] += amplitude_nm * math.sin(TWO_PI * (order * signals[s.ANGLE_REV] + phase_rev))


@njit
def unbalance(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """Weight of the load: a torque that is periodic in the angle of the gear's output."""
    output_rev = signals[s.ANGLE_REV] / signals[s.GEAR_RATIO]
    signals[s.ADDED_TORQUE_NM] += parameters[0] * math.sin(TWO_PI * (output_rev + parameters[1]))


@njit
def periodic_disturbance(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A torque that is periodic in time, such as a neighbouring machine makes."""
    amplitude_nm, frequency_hz, phase_rev = parameters[0], parameters[1], parameters[2]
    signals[s.ADDED_TORQUE_NM] += amplitude_nm * math.sin(TWO_PI * (frequency_hz * signals[s.TIME_S] + phase_rev))


@njit
def torque_ripple(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """The torque constant varies with the motor angle: a ripple in proportion to the current."""
    share, order, phase_rev = parameters[0], parameters[1], parameters[2]
    signals[s.TORQUE_NM] *= 1.0 + share * math.cos(TWO_PI * (order * signals[s.ANGLE_REV] + phase_rev))


@njit
def torque_saturation(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """The iron saturates: T = Kt i/(1 + share (i/rated)^2)."""
    ratio = signals[s.CURRENT_A] / signals[s.RATED_CURRENT_A]
    signals[s.TORQUE_NM] /= 1.0 + parameters[0] * ratio * ratio


@njit
def dead_zone(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """The amplifier gives no current below a threshold, and that much less above it."""
    width_a = parameters[0]
    demand_a = signals[s.COMMAND_A]
    if demand_a > width_a:
        signals[s.COMMAND_A] = demand_a - width_a
    elif demand_a < -width_a:
        signals[s.COMMAND_A] = demand_a + width_a
    else:
        signals[s.COMMAND_A] = 0.0


@njit
def current_lag(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A first-order lag in front of the current loop (an undocumented set-point filter)."""
    memory[0] += (signals[s.COMMAND_A] - memory[0]) * (1.0 - math.exp(-signals[s.STEP_S] / parameters[0]))
    signals[s.COMMAND_A] = memory[0]


def _delay(config: PlantConfig, values: Values) -> PlantConfig:
    return replace(config, extra_delay_s=config.extra_delay_s + values["delay_s"])


def _voltage_limit(config: PlantConfig, values: Values) -> PlantConfig:
    return replace(config, dc_link_v=config.dc_link_v * (1.0 - values["drop_share"]))


_ORDER = PlantParameter("order", "1/rev", 12.0, 0.001, 1000.0, "periods in a motor revolution")
_PHASE = PlantParameter("phase_rev", "rev", 0.0, -1.0, 1.0, "phase, as a share of the period")

EFFECTS = (
    PlantEffect(
        "torque_offset",
        s.LOAD,
        torque_offset,
        (PlantParameter("torque_nm", "Nm", 0.01, -0.5, 0.5, "the torque", True),),
        "constant torque on the shaft (an offset of the current has the same effect)",
    ),
    PlantEffect(
        "cogging",
        s.LOAD,
        cogging,
        (PlantParameter("amplitude_nm", "Nm", 0.008, 0.0, 0.5, "amplitude", True), _ORDER, _PHASE),
        "torque periodic in the motor angle, of the same sign in both directions",
    ),
    PlantEffect(
        "torque_ripple",
        s.TORQUE,
        torque_ripple,
        (
            PlantParameter("share", "-", 0.08, 0.0, 0.9, "amplitude as a share of the torque", True),
            _ORDER._replace(default=6.0),
            _PHASE,
        ),
        "ripple periodic in the motor angle, in proportion to the current",
    ),
    PlantEffect(
        "unbalance",
        s.LOAD,
        unbalance,
        (PlantParameter("amplitude_nm", "Nm", 0.015, 0.0, 0.5, "amplitude at the motor shaft", True), _PHASE),
        "weight of the load: torque periodic in the output angle",
    ),
    PlantEffect(
        "periodic_disturbance",
        s.LOAD,
        periodic_disturbance,
        (
            PlantParameter("amplitude_nm", "Nm", 0.008, 0.0, 0.5, "amplitude", True),
            PlantParameter("frequency_hz", "Hz", 7.3, 0.001, 1000.0, "frequency"),
            _PHASE,
        ),
        "torque periodic in time",
    ),
    PlantEffect(
        "torque_saturation",
        s.TORQUE,
        torque_saturation,
        (PlantParameter("share", "-", 0.3, 0.0, 1.0, "s in T = Kt i/(1 + s (i/rated)^2)", True),),
        "torque grows less than in proportion to the current",
    ),
    PlantEffect(
        "dead_zone",
        s.COMMAND,
        dead_zone,
        (PlantParameter("width_a", "A", 0.08, 0.0, 5.0, "threshold of the current", True),),
        "dead zone of the amplifier",
    ),
    PlantEffect(
        "current_lag",
        s.COMMAND,
        current_lag,
        (PlantParameter("time_constant_s", "s", 0.004, 0.0, 1.0, "time constant", True),),
        "first-order lag of the current beyond the configured loop",
    ),
    PlantEffect(
        "delay",
        s.PREPARED,
        None,
        (PlantParameter("delay_s", "s", 0.003, 0.0, 0.1, "delay added to the configured one", True),),
        "dead time beyond the configured delay",
        _delay,
    ),
    PlantEffect(
        "voltage_limit",
        s.PREPARED,
        None,
        (PlantParameter("drop_share", "-", 0.7, 0.0, 0.95, "share of the DC-link voltage that is missing", True),),
        "weak supply: the current falls short at speed",
        _voltage_limit,
    ),
)

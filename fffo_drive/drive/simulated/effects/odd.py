"""Effects that no library has, to test whether a diagnosis finds what it has no name for.

They occur on real machines, in shapes that no term of a friction model has.
"""

from __future__ import annotations

import math

from ....jit import njit
from ....units import TWO_PI
from . import slots as s
from .declaration import PlantEffect, PlantParameter
from .friction_effects import direction_of
from .slots import Vector


@njit
def odd_speed_band(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A bump of friction in a band of speed, where a part of the structure resonates and absorbs power."""
    amplitude_nm, centre_rps, width_rps = parameters[0], parameters[1], parameters[2]
    velocity_rps = signals[s.VELOCITY_RPS]
    away = (abs(velocity_rps) - centre_rps) / width_rps
    bump_nm = amplitude_nm * math.exp(-away * away)
    signals[s.ADDED_FRICTION_NM] += bump_nm * direction_of(velocity_rps)


@njit
def odd_direction_angle(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """Friction that helps in one half of the output turn, hinders in the other: sgn(w) cos(output angle)."""
    output_rev = signals[s.ANGLE_REV] / signals[s.GEAR_RATIO]
    torque_nm = parameters[0] * math.cos(TWO_PI * (output_rev + parameters[1]))
    signals[s.ADDED_FRICTION_NM] += torque_nm * direction_of(signals[s.VELOCITY_RPS])


@njit
def odd_fatigue(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """Thixotropic grease: friction falls as the grease is worked, and recovers with time.

    memory[0]: share that is lost, 0 to 1.
    """
    share, travel_rev, recovery_s = parameters[0], parameters[1], parameters[2]
    step_s = signals[s.STEP_S]
    worked = abs(signals[s.VELOCITY_RPS]) * step_s / travel_rev
    memory[0] += worked * (1.0 - memory[0]) - memory[0] * step_s / recovery_s
    signals[s.LEVEL_SCALE] *= 1.0 - share * memory[0]


@njit
def odd_stick_patch(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A sticky patch on the motor's turn that acts only at low speed."""
    amplitude_nm, centre_rev, width_rev, fades_rps = (
        parameters[0],
        parameters[1],
        parameters[2],
        parameters[3],
    )
    velocity_rps = signals[s.VELOCITY_RPS]
    turns = signals[s.ANGLE_REV] - centre_rev
    away_rev = turns - math.floor(turns + 0.5)
    if abs(away_rev) < 0.5 * width_rev:
        grip_nm = amplitude_nm / (1.0 + abs(velocity_rps) / fades_rps)
        signals[s.ADDED_FRICTION_NM] += grip_nm * max(-1.0, min(1.0, velocity_rps / 0.02))


@njit
def odd_current_heating(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """The winding warms the front bearing, whose preload rises: Coulomb friction follows the square of the
    current.

    memory[0]: the square of the current over the rated one, low-pass filtered.
    """
    share, time_constant_s = parameters[0], parameters[1]
    ratio = signals[s.CURRENT_A] / signals[s.RATED_CURRENT_A]
    memory[0] += (ratio * ratio - memory[0]) * signals[s.STEP_S] / time_constant_s
    signals[s.LEVEL_SCALE] *= 1.0 + share * memory[0]


@njit
def odd_two_levels(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A seal lip that lifts off above a speed and touches down again only below a lower one.

    memory[0]: 1 when lifted.
    """
    share, lifts_rps, lies_rps = parameters[0], parameters[1], parameters[2]
    speed_rps = abs(signals[s.VELOCITY_RPS])
    if speed_rps > lifts_rps:
        memory[0] = 1.0
    elif speed_rps < lies_rps:
        memory[0] = 0.0
    if memory[0] == 0.0:
        signals[s.LEVEL_SCALE] *= 1.0 + share


@njit
def odd_alternate_turns(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A damaged tooth that meets its partner every so many turns: friction higher during one turn of them."""
    share, turns = parameters[0], parameters[1]
    period = signals[s.ANGLE_REV] / turns
    if (period - math.floor(period)) * turns < 1.0:
        signals[s.LEVEL_SCALE] *= 1.0 + share


@njit
def odd_eddy_brake(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """Iron losses: a drag in proportion to speed and to the current squared, w (i/rated)^2."""
    ratio = signals[s.CURRENT_A] / signals[s.RATED_CURRENT_A]
    signals[s.ADDED_FRICTION_NM] += parameters[0] * signals[s.VELOCITY_RPS] * ratio * ratio


@njit
def odd_late_kick(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A loose part that follows after a reversal and knocks once, some travel later.

    memory: direction, travel since it last changed.
    """
    amplitude_nm, after_rev, width_rev = parameters[0], parameters[1], parameters[2]
    velocity_rps = signals[s.VELOCITY_RPS]
    direction = direction_of(velocity_rps)
    if direction != 0.0 and direction != memory[0]:
        memory[0] = direction
        memory[1] = 0.0
    memory[1] += abs(velocity_rps) * signals[s.STEP_S]
    away = (memory[1] - after_rev) / width_rev
    if abs(away) < 1.0:
        signals[s.ADDED_FRICTION_NM] += memory[0] * amplitude_nm * (1.0 - away * away)


@njit
def odd_cable(signals: Vector, parameters: Vector, memory: Vector) -> None:
    """A cable wound up by the travel pulls back and slips at its clamp: a soft spring with limited reach.

    memory: wound travel in rev, within the reach.
    """
    torque_nm, reach_rev = parameters[0], parameters[1]
    wound_rev = memory[0] + signals[s.VELOCITY_RPS] * signals[s.STEP_S]
    memory[0] = max(-reach_rev, min(reach_rev, wound_rev))
    signals[s.ADDED_TORQUE_NM] -= torque_nm * memory[0] / reach_rev


def _amplitude(default: float) -> PlantParameter:
    return PlantParameter("amplitude_nm", "Nm", default, -0.5, 0.5, "amplitude", True)


def _share(default: float, meaning: str, high: float = 10.0) -> PlantParameter:
    return PlantParameter("share", "-", default, -0.9, high, meaning, True)


EFFECTS = (
    PlantEffect(
        "odd_speed_band",
        s.LOAD,
        odd_speed_band,
        (
            _amplitude(0.012),
            PlantParameter("centre_rps", "rps", 6.0, 0.0, 50.0, "speed of the bump"),
            PlantParameter("width_rps", "rps", 1.0, 0.01, 50.0, "its half width, to 1/e"),
        ),
        "friction bump in a band of speed",
    ),
    PlantEffect(
        "odd_direction_angle",
        s.LOAD,
        odd_direction_angle,
        (
            _amplitude(0.012),
            PlantParameter("phase_rev", "rev", 0.0, -1.0, 1.0, "phase, as a share of the output turn"),
        ),
        "torque in proportion to sgn(w) cos(output angle)",
    ),
    PlantEffect(
        "odd_fatigue",
        s.LEVEL,
        odd_fatigue,
        (
            _share(0.35, "share of the level that is lost by travel", 0.9),
            PlantParameter("travel_rev", "rev", 20.0, 0.01, 100_000.0, "travel over which it is lost"),
            PlantParameter("recovery_s", "s", 8.0, 0.01, 100_000.0, "time over which it recovers"),
        ),
        "friction falls with travel and recovers with time",
    ),
    PlantEffect(
        "odd_stick_patch",
        s.LOAD,
        odd_stick_patch,
        (
            _amplitude(0.02),
            PlantParameter("centre_rev", "rev", 0.3, -1.0, 1.0, "motor angle of the patch"),
            PlantParameter("width_rev", "rev", 0.08, 0.001, 1.0, "its width"),
            PlantParameter("fades_rps", "rps", 1.0, 0.001, 50.0, "speed at which half of it is left"),
        ),
        "sticky patch on the motor's turn, at low speed",
    ),
    PlantEffect(
        "odd_current_heating",
        s.LEVEL,
        odd_current_heating,
        (
            _share(5.0, "rise of the level at rated current, as a share", 100.0),
            PlantParameter("time_constant_s", "s", 5.0, 0.01, 100_000.0, "time constant of the warming"),
        ),
        "heating by the square of the current raises Coulomb friction",
    ),
    PlantEffect(
        "odd_two_levels",
        s.LEVEL,
        odd_two_levels,
        (
            _share(0.4, "rise of the level while the seal touches"),
            PlantParameter("lifts_rps", "rps", 7.0, 0.01, 50.0, "speed above which it lifts"),
            PlantParameter("lies_rps", "rps", 2.0, 0.0, 50.0, "speed below which it touches down"),
        ),
        "friction switches between two levels, with a hysteresis in speed",
    ),
    PlantEffect(
        "odd_alternate_turns",
        s.LEVEL,
        odd_alternate_turns,
        (
            _share(0.4, "rise of the level during the turn"),
            PlantParameter("turns", "-", 3.0, 1.0, 1000.0, "turns from one to the next"),
        ),
        "friction is higher during one motor turn of several",
    ),
    PlantEffect(
        "odd_eddy_brake",
        s.LOAD,
        odd_eddy_brake,
        (PlantParameter("brake_nm_per_rps", "Nm/rps", 0.03, 0.0, 1.0, "at rated current", True),),
        "drag in proportion to speed and current squared",
    ),
    PlantEffect(
        "odd_late_kick",
        s.LOAD,
        odd_late_kick,
        (
            _amplitude(0.03),
            PlantParameter("after_rev", "rev", 0.15, 0.0, 100.0, "travel after the reversal"),
            PlantParameter("width_rev", "rev", 0.05, 0.0001, 100.0, "half width of the knock"),
        ),
        "a knock some travel after each reversal",
    ),
    PlantEffect(
        "odd_cable",
        s.LOAD,
        odd_cable,
        (
            PlantParameter("torque_nm", "Nm", 0.015, -0.5, 0.5, "pull at the end of the reach", True),
            PlantParameter("reach_rev", "rev", 1.5, 0.01, 10_000.0, "travel until it slips"),
        ),
        "a spring along the travel that slips at its end",
    ),
)

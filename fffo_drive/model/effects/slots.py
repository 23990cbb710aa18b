"""Inputs and outputs of a law: slots of the float64 vector `signals`.

    J dw/dt = Kt i(t - Td) - F(2SEP) - E,    E = sum of the effects: the torque that they take away

A law reads the motion, the torque and the constants of the axis, adds its torque to LOAD_NM (a feed-forward adds the
same to the command) and the error of the sensor to SENSOR_REV. Angles are of the motor shaft, multi-turn, in the
datum of the run. The first N_MOTION slots are the motion and come with each step; the rest is derived or constant.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Floats
from ..axis import AxisConfig

# the motion, in the order of the columns of a followed record
TIME_S = 0  # since the start of the run
VELOCITY_RPS = 1
ACCELERATION_RPS2 = 2
MOTOR_ANGLE_REV = 3  # in the middle of the step, where torque acts
SENSOR_ANGLE_REV = 4  # at its end, when the sensor measures
CURRENT_A = 5  # the command as it acts: Td late
FRICTION_NM = 6  # of the 2SEP model
TRAVEL_REV = 7  # since the last reversal
DIRECTION = 8  # -1, 0 (never moved), 1: of the present or last motion
CONTACT_LEVEL_NM = 9  # level of the Stribeck curve at this speed, without its viscous part; 0: computed when needed
N_MOTION = 10

# derived at each step
MOTOR_TORQUE_NM = 10  # Kt times the current
CONTACT_NM = 11  # friction without its viscous part: follows the force between the surfaces; zero before any motion
GRIP = 12  # -1 to 1: contact over the Coulomb level: progress and direction of presliding
REST_S = 13  # time at rest so far; in motion: of the last rest
SLIDE_REV = 14  # travel since the last rest
RESTING = 15  # 1 at rest
LOAD_NM = 16  # out
SENSOR_REV = 17  # out: measured position minus true angle

# constants of the axis
STEP_S = 18
INERTIA_NM_S2_PER_REV = 19
TORQUE_CONSTANT_NM_PER_A = 20
COULOMB_NM = 21
STATIC_NM = 22
STRIBECK_VELOCITY_RPS = 23
STRIBECK_EXPONENT = 24
VISCOUS_NM_PER_RPS = 25
STIFFNESS_PER_REV = 26
ATTRACTION_NM_PER_REV = 27
REST_SPEED_RPS = 28  # below it the axis rests
AT_INSTANTS = 29  # 1: the motion is that of instants, as in a record; 0: of the middle of each step
N_SLOTS = 30
_PLACES = {
    place: name.lower()
    for name, place in globals().copy().items()
    if name[0] != "_" and name.isupper() and not name.startswith("N_")
}
SIGNAL_NAMES = tuple(_PLACES[place] for place in range(N_SLOTS))

MAX_PARAMETERS = 132
MEMORY_SLOTS = 72

REST_SPEED_DEFAULT_RPS = 0.02  # some counts of a 15-bit resolver in the memory of a filter; creep in presliding is less


class AxisFacts(NamedTuple):
    """Inputs of an effect in addition to the axis."""

    rest_speed_rps: float = REST_SPEED_DEFAULT_RPS


def new_signals(axis: AxisConfig, step_s: float, facts: AxisFacts | None = None) -> Floats:
    """The vector at rest, with the constants of an axis. (N_SLOTS,)"""
    signals = np.zeros(N_SLOTS)
    friction = axis.friction
    for slot, value in (
        (STEP_S, step_s),
        (INERTIA_NM_S2_PER_REV, axis.inertia_nm_s2_per_rev),
        (TORQUE_CONSTANT_NM_PER_A, axis.torque_constant_nm_per_a),
        (COULOMB_NM, friction.coulomb_nm),
        (STATIC_NM, friction.static_nm),
        (STRIBECK_VELOCITY_RPS, friction.stribeck_velocity_rps),
        (STRIBECK_EXPONENT, friction.stribeck_exponent),
        (VISCOUS_NM_PER_RPS, friction.viscous_nm_per_rps),
        (STIFFNESS_PER_REV, friction.stiffness_per_rev),
        (ATTRACTION_NM_PER_REV, friction.attraction_nm_per_rev),
        (REST_SPEED_RPS, (facts or AxisFacts()).rest_speed_rps),
    ):
        signals[slot] = value
    return signals

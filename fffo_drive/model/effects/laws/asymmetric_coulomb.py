"""Friction between the surfaces is stronger one way than the other."""

from __future__ import annotations

import math

from ....jit import njit
from .. import slots as s
from ..kinds import approach, steady_contact_nm
from ..law import STRENGTH, Law, Parameter, no_shape
from ..slots import Floats


@njit
def asymmetric_coulomb(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = share D: what the 2SEP equations (2)-(7) add in first order where Fc and S(w) are (1 +- share) times as high.

        dD/dx = (Fc - D(t_r)) K exp(-K x) + (B/S) (sgn(w) F Sc/S - D),    Sc: S(w) without its viscous part

    Even in the direction, zero before any motion, frozen at rest. memory: D, Omega's part, direction and F before.
    """
    direction = signals[s.DIRECTION]
    speed_rps = abs(signals[s.VELOCITY_RPS])
    coulomb_nm = signals[s.COULOMB_NM]
    if direction != memory[2]:
        memory[2] = direction
        memory[1] = coulomb_nm - memory[0] if coulomb_nm > direction * memory[3] else 0.0
    distance_rev = speed_rps * signals[s.STEP_S]
    if distance_rev > 0.0:
        contact_nm = steady_contact_nm(signals, speed_rps)
        steady_nm = contact_nm + signals[s.VISCOUS_NM_PER_RPS] * speed_rps
        goal_nm = direction * signals[s.FRICTION_NM] * contact_nm / steady_nm
        memory[0] = approach(memory[0], goal_nm, distance_rev, steady_nm / signals[s.ATTRACTION_NM_PER_REV])
        stiffness_per_rev = signals[s.STIFFNESS_PER_REV]
        before_rev = max(0.0, signals[s.TRAVEL_REV] - distance_rev)
        built = math.exp(-stiffness_per_rev * before_rev) * -math.expm1(-stiffness_per_rev * distance_rev)
        memory[0] += memory[1] * built
    memory[3] = signals[s.FRICTION_NM]
    signals[s.LOAD_NM] += parameters[0] * memory[0]


LAW = Law(
    name="asymmetric_coulomb",
    axis="direction",
    kernel=asymmetric_coulomb,
    parameters=(
        Parameter(
            "share",
            "-",
            STRENGTH,
            -0.95,
            0.95,
            0.1,
            "excess in positive direction, as a share of the contact's friction, missing in the other",
        ),
    ),
    search=no_shape,
    meaning="Coulomb and Stribeck friction differ between the directions",
    compensable=True,
    regime="sliding; frozen at rest",
    lookalikes=("torque_offset", "unbalance", "asymmetric_viscous"),
    experiment=(
        "rest and slow creep: an offset acts there, this does not; several speeds: the excess does not grow with speed"
    ),
    picture="direction",
)

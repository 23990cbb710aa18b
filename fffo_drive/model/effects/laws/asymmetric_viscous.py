"""Viscous friction is stronger one way than the other."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import surface_response
from ..law import STRENGTH, Law, Parameter, no_shape


@njit
def asymmetric_viscous(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """The viscous coefficient is so much larger in positive direction, smaller in the other."""
    viscous = parameters[0] * signals[s.DIRECTION]
    signals[s.LOAD_NM] += surface_response(signals, memory, 0.0, viscous)


LAW = Law(
    name="asymmetric_viscous",
    axis="velocity",
    kernel=asymmetric_viscous,
    parameters=(
        Parameter(
            "excess_nm_per_rps",
            "Nm/rps",
            STRENGTH,
            -1e6,
            1e6,
            1e-3,
            "excess of the viscous coefficient in positive direction; as much is missing in the other",
        ),
    ),
    search=no_shape,
    meaning="viscous friction differs between the directions",
    plain_name="speed-dependent friction that differs between the directions",
    cause="lubricant that is pumped, or a seal lip that lifts, one way only",
    remedy="look at lubrication and seals; the controller compensates it",
    compensable=True,
    regime="sliding, growing with speed",
    lookalikes=("torque_offset", "asymmetric_coulomb", "quadratic_drag"),
    experiment="constant speeds at three or more levels, both ways: the even part grows in proportion to speed",
    motions=("staircase",),
    picture="velocity",
    figure="friction",
    level=True,
)

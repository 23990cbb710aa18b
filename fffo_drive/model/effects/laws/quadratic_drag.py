"""Drag with the square of the speed: a fan, or churned oil."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..law import STRENGTH, Law, Parameter, no_shape


@njit
def quadratic_drag(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = drag w |w|."""
    velocity_rps = signals[s.VELOCITY_RPS]
    signals[s.LOAD_NM] += parameters[0] * velocity_rps * abs(velocity_rps)


LAW = Law(
    name="quadratic_drag",
    axis="velocity",
    kernel=quadratic_drag,
    parameters=(Parameter("drag_nm_per_rps2", "Nm/rps2", STRENGTH, -1e6, 1e6, 1e-4, "torque per speed squared"),),
    search=no_shape,
    meaning="drag that grows with the square of the speed",
    plain_name="drag that grows with the square of the speed",
    cause="air or oil that is churned: a fan, a gear in an oil bath",
    remedy="check the oil level; the controller compensates it",
    compensable=True,
    regime="fast sliding",
    lookalikes=("viscous_drift", "torque_saturation", "load_dependent_friction"),
    experiment="constant speeds at four or more levels, up to the highest",
    motions=("staircase",),
    picture="velocity",
    figure="friction",
)

"""A constant torque, or an offset of the current."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..law import STRENGTH, Law, Parameter, no_shape


@njit
def torque_offset(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = offset."""
    signals[s.LOAD_NM] += parameters[0]


LAW = Law(
    name="torque_offset",
    axis="torque",
    kernel=torque_offset,
    parameters=(Parameter("torque_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "the torque that is lost"),),
    search=no_shape,
    meaning="constant torque, for example from a current offset",
    plain_name="constant torque",
    cause="an offset of the current measurement, a cable or spring that pulls, a weight on a vertical axis",
    remedy="calibrate the current offset in the drive with the motor at rest; what is left is compensated",
    compensable=True,
    regime="everywhere, also at rest",
    lookalikes=("asymmetric_coulomb", "unbalance"),
    experiment="reverse the mounting or the sign of the motor; at rest an offset acts, asymmetric friction does not",
    motions=("dwells", "staircase"),
    picture="torque",
    figure="friction",
    rung=0,
)

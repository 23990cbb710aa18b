"""Friction between the surfaces is stronger one way than the other."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import level_response
from ..law import STRENGTH, Law, Parameter, no_shape


@njit
def asymmetric_coulomb(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """Fc and Fs are (1 +- share) times as high, by direction; E is the difference in 2SEP friction."""
    signals[s.LOAD_NM] += level_response(signals, memory, parameters[0] * signals[s.DIRECTION])


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
            "excess in positive direction, as a share of the contact's friction; as much is missing in the other",
        ),
    ),
    search=no_shape,
    meaning="Coulomb and Stribeck friction differ between the directions",
    plain_name="friction that differs between the directions",
    cause="a seal, a bearing preload or a gear flank that rubs more one way",
    remedy="look at seals and preload; the controller compensates it",
    compensable=True,
    regime="sliding; frozen at rest",
    lookalikes=("torque_offset", "unbalance", "asymmetric_viscous"),
    experiment=("at rest and in slow creep an offset acts, this does not; at several speeds the excess stays the same"),
    motions=("dwells", "staircase", "creep"),
    picture="direction",
    figure="friction",
    level=True,
    rung=0,
)

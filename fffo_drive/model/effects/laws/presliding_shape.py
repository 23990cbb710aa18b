"""Before it slides the contact is softer or stiffer than one exponential."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import approach, sign_of
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, over


def _search(context: SearchContext) -> list[Shape]:
    return over("length_ratio", [0.1, 0.3, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0])


@njit
def presliding_shape(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = torque (z2 - z1): a part of the friction builds up over another travel.

    z1, z2 (memory): elasto-plastic contacts, dz/dx = K (sgn w - z), the first with the model's stiffness. Both are +-1
    in sliding, so that E acts between reversal and break-away only.
    """
    distance_rev = abs(signals[s.VELOCITY_RPS]) * signals[s.STEP_S]
    if distance_rev > 0.0:
        direction = sign_of(signals[s.VELOCITY_RPS])
        length_rev = 1.0 / signals[s.STIFFNESS_PER_REV]
        memory[0] = approach(memory[0], direction, distance_rev, length_rev)
        memory[1] = approach(memory[1], direction, distance_rev, parameters[1] * length_rev)
    signals[s.LOAD_NM] += parameters[0] * (memory[1] - memory[0])


LAW = Law(
    name="presliding_shape",
    axis="travel_since_reversal",
    kernel=presliding_shape,
    parameters=(
        Parameter("torque_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "friction that builds up over the second travel"),
        Parameter(
            "length_ratio",
            "-",
            SHAPE,
            0.001,
            1000.0,
            5.0,
            "ratio of the second travel to that of the model, 1/K",
            logarithmic=True,
        ),
    ),
    search=_search,
    meaning="friction builds up after a reversal in two stages",
    plain_name="contact that gives way in two stages",
    cause="two contacts of different stiffness, such as a seal and a bearing",
    remedy="nothing to repair: it is part of the friction model",
    compensable=True,
    form=True,
    regime="presliding",
    lookalikes=("frictional_lag", "backlash", "elasticity", "stribeck_shape"),
    experiment=(
        "reversals at two or more accelerations: over travel the shape stays the same; torques below break-away at rest"
    ),
    motions=("triangles",),
    picture="travel_since_reversal",
    figure="reversal",
)

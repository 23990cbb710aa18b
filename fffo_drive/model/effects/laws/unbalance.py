"""Weight of the load: a torque over the turn of the gear's output."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import wave
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, over


def _search(context: SearchContext) -> list[Shape]:
    return over("ratio", [context.gear_ratio or 1.0])


@njit
def unbalance(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = cos, sin of the output angle."""
    signals[s.LOAD_NM] += wave(parameters[0], parameters[1], signals[s.MOTOR_ANGLE_REV] / parameters[2])


LAW = Law(
    name="unbalance",
    axis="output_angle",
    kernel=unbalance,
    parameters=(
        Parameter("cos_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "cosine of the wave, at the motor shaft"),
        Parameter("sin_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "sine of the wave"),
        Parameter(
            "ratio",
            "-",
            SHAPE,
            0.001,
            1000000.0,
            1.0,
            "motor turns in a turn of the output",
            logarithmic=True,
            held=True,
            span=True,
        ),
    ),
    search=_search,
    meaning="weight of the load: one period per turn of the output, the same in both directions",
    plain_name="weight of an unbalanced load",
    cause="the load's centre of mass is not on the axis of rotation",
    remedy="the controller compensates it; a rotor that should be in balance needs a counterweight",
    compensable=True,
    regime="everywhere, also at rest",
    lookalikes=("torque_offset", "position_dependent_friction", "cogging"),
    experiment=(
        "half a turn of the output or more, both ways: the torque keeps its sign; with another payload it changes"
    ),
    motions=("creep",),
    picture="output_angle",
    per_run=("cos_nm", "sin_nm"),
    rung=1,
    fold=lambda values: ("motor_angle", values["ratio"]),
    wave="plain",
    rotary=True,
)

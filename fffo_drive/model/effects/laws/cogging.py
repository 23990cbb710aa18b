"""A torque that varies with the motor angle and keeps its sign: magnets against teeth."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import wave
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, folded_over_order, motor_orders, over


def _search(context: SearchContext) -> list[Shape]:
    return over("order", motor_orders(context, half=True, slow=context.slow_orders))


@njit
def cogging(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = cos, sin of an order of the motor turn."""
    signals[s.LOAD_NM] += wave(parameters[0], parameters[1], parameters[2] * signals[s.MOTOR_ANGLE_REV])


LAW = Law(
    name="cogging",
    axis="motor_angle",
    kernel=cogging,
    parameters=(
        Parameter("cos_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "cosine of the wave"),
        Parameter("sin_nm", "Nm", STRENGTH, -1e6, 1e6, 0.01, "sine of the wave"),
        Parameter("order", "1/rev", SHAPE, 0.001, 10000.0, 1.0, "periods in a motor turn"),
    ),
    search=_search,
    meaning="torque that varies with the motor angle and keeps its sign",
    plain_name="cogging",
    cause="the motor's magnets against the teeth of its stator",
    remedy="a motor with skewed slots has less of it; the controller compensates it",
    compensable=True,
    regime="everywhere, also at rest",
    lookalikes=("torque_ripple", "friction_ripple", "resolver_error", "unbalance"),
    experiment=(
        "slow constant speed over many periods, both ways at two loads: sign and size stay; at two speeds: size stays"
    ),
    motions=("creep", "pairs"),
    picture="motor_angle",
    figure="order",
    per_run=("cos_nm", "sin_nm"),
    rung=2,
    fold=folded_over_order,
    wave="plain",
)

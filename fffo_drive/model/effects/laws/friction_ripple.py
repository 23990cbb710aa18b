"""Friction between the surfaces varies with the motor angle."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import level_response, over_step, wave
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, folded_over_order, motor_orders, over


def _search(context: SearchContext) -> list[Shape]:
    return over("order", motor_orders(context, half=True, slow=context.slow_level_orders))


@njit
def friction_ripple(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """Fc and Fs are 1 + (cos, sin of an order of the motor turn) times as high: E turns its sign with the direction."""
    turns = parameters[2] * over_step(signals, memory, signals[s.MOTOR_ANGLE_REV])
    signals[s.LOAD_NM] += level_response(signals, memory, wave(parameters[0], parameters[1], turns))


LAW = Law(
    name="friction_ripple",
    axis="motor_angle",
    kernel=friction_ripple,
    parameters=(
        Parameter(
            "cos_share", "-", STRENGTH, -10.0, 10.0, 0.1, "cosine of the wave, as a share of the contact's friction"
        ),
        Parameter("sin_share", "-", STRENGTH, -10.0, 10.0, 0.1, "sine of the wave"),
        Parameter("order", "1/rev", SHAPE, 0.001, 10000.0, 1.0, "periods in a motor turn"),
    ),
    search=_search,
    meaning="friction varies with the motor angle",
    plain_name="friction that varies within a motor turn",
    cause="a bearing, seal or gear that is out of round or out of line",
    remedy="check bearing, seal and coupling for run-out; the controller compensates it",
    compensable=True,
    regime="sliding",
    lookalikes=("cogging", "torque_ripple", "position_dependent_friction"),
    experiment=(
        "slow constant speed over many periods, both ways: the ripple changes sign with the direction, cogging does not"
    ),
    motions=("creep",),
    picture="motor_angle",
    figure="order",
    per_run=("cos_share", "sin_share"),
    level=True,
    fold=folded_over_order,
    wave="friction",
)

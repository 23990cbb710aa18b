"""The torque constant falls where the iron saturates."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, over

ROUNDS = 6


def _search(context: SearchContext) -> list[Shape]:
    return over("knee_a", [context.highest_current_a * ratio for ratio in (0.25, 0.5, 1.0, 2.0)])


@njit
def torque_saturation(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = share torque r^2/(1 + r^2), r = |i|/knee: the torque constant falls from Kt to (1 - share) Kt past a knee."""
    ratio = signals[s.CURRENT_A] / parameters[1]
    square = ratio * ratio
    signals[s.LOAD_NM] += parameters[0] * signals[s.MOTOR_TORQUE_NM] * square / (1.0 + square)


@njit
def _inverse(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """The E that the wanted torque needs: what is added is lost in part too. Some rounds of T + E -> E."""
    wanted_nm = signals[s.MOTOR_TORQUE_NM] + signals[s.LOAD_NM]
    reach_nm = signals[s.TORQUE_CONSTANT_NM_PER_A] * parameters[1]
    lost_nm = 0.0
    for _ in range(ROUNDS):
        torque_nm = wanted_nm + lost_nm
        square = torque_nm * torque_nm / (reach_nm * reach_nm)
        lost_nm = parameters[0] * torque_nm * square / (1.0 + square)
    signals[s.LOAD_NM] += lost_nm


LAW = Law(
    name="torque_saturation",
    axis="current",
    kernel=torque_saturation,
    parameters=(
        Parameter("share", "-", STRENGTH, -1.0, 1.0, 0.1, "share of the torque that is lost far beyond the knee"),
        Parameter("knee_a", "A", SHAPE, 1e-06, 1000000.0, 5.0, "current at which half of it is lost", logarithmic=True),
    ),
    search=_search,
    meaning="the torque constant falls at high current",
    plain_name="torque that falls short at high current",
    cause="iron of the motor that saturates, or magnets that are hot",
    remedy="stay below that current or take a larger motor; the controller compensates it",
    place=lambda values: f"above about {values['knee_a']:.3g} A",
    compensable=True,
    regime="high current",
    lookalikes=("load_dependent_friction", "voltage_limit", "quadratic_drag", "dead_zone"),
    experiment=(
        "accelerate and brake with the same torque: saturation keeps the sign of the torque, friction "
        "that of the motion"
    ),
    motions=("pairs",),
    picture="current",
    figure="transfer",
    feedforward=_inverse,
    acts_on="torque",
)

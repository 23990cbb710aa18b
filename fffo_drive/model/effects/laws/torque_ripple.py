"""The torque constant varies with the motor angle."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import wave
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape, folded_over_order, motor_orders, over


def _search(context: SearchContext) -> list[Shape]:
    return over("order", motor_orders(context))


@njit
def torque_ripple(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = motor torque (cos, sin of an order of the motor turn)."""
    turns = parameters[2] * signals[s.MOTOR_ANGLE_REV]
    signals[s.LOAD_NM] += signals[s.MOTOR_TORQUE_NM] * wave(parameters[0], parameters[1], turns)


@njit
def _inverse(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """The E that the wanted torque needs: what is added is rippled too."""
    ripple = wave(parameters[0], parameters[1], parameters[2] * signals[s.MOTOR_ANGLE_REV])
    wanted_nm = signals[s.MOTOR_TORQUE_NM] + signals[s.LOAD_NM]
    signals[s.LOAD_NM] += wanted_nm * ripple / max(0.1, 1.0 - ripple)


LAW = Law(
    name="torque_ripple",
    axis="motor_angle",
    kernel=torque_ripple,
    parameters=(
        Parameter("cos_share", "-", STRENGTH, -0.9, 0.9, 0.05, "cosine of the wave, as a share of the torque"),
        Parameter("sin_share", "-", STRENGTH, -0.9, 0.9, 0.05, "sine of the wave"),
        Parameter("order", "1/rev", SHAPE, 0.001, 10000.0, 1.0, "periods in a motor turn"),
    ),
    search=_search,
    meaning="the torque constant varies with the motor angle",
    plain_name="torque ripple",
    cause="a torque constant that varies with the motor angle: winding, or commutation that is off",
    remedy="check the commutation offset in the drive; the controller compensates it",
    compensable=True,
    regime="high torque",
    lookalikes=("cogging", "friction_ripple", "resolver_error"),
    experiment="the same slow speed at two loads: the ripple grows with the torque, cogging does not",
    motions=("creep", "pairs"),
    picture="motor_angle",
    figure="order",
    per_run=("cos_share", "sin_share"),
    feedforward=_inverse,
    acts_on="torque",
    fold=folded_over_order,
    wave="torque",
)

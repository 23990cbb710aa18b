"""Back-EMF leaves too little voltage for the current at speed."""

from __future__ import annotations

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..kinds import sign_of
from ..law import SHAPE, STRENGTH, Law, Parameter, SearchContext, Shape


def _search(context: SearchContext) -> list[Shape]:
    highest_nm = max(context.highest_torque_nm, context.static_nm)
    return [
        {"stall_nm": stall * highest_nm, "no_load_rps": speed * context.highest_rps}
        for stall in (0.5, 1.0, 2.0, 4.0)
        for speed in (0.8, 1.05, 1.3, 1.8)
    ]


@njit
def voltage_limit(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = share (torque beyond the limit), in the motor quadrants: limit = stall (1 - |w|/no-load speed)."""
    direction = sign_of(signals[s.VELOCITY_RPS])
    limit_nm = parameters[1] * max(0.0, 1.0 - abs(signals[s.VELOCITY_RPS]) / parameters[2])
    excess_nm = direction * signals[s.MOTOR_TORQUE_NM] - limit_nm
    if excess_nm > 0.0:
        signals[s.LOAD_NM] += parameters[0] * direction * excess_nm


LAW = Law(
    name="voltage_limit",
    axis="velocity",
    kernel=voltage_limit,
    parameters=(
        Parameter(
            "share",
            "-",
            STRENGTH,
            -1.5,
            1.5,
            1.0,
            "share of the excess that is lost; 1: a hard limit",
            plausible=(0.0, 1.2),
        ),
        Parameter(
            "stall_nm", "Nm", SHAPE, 1e-09, 10000000.0, 1.0, "limit of the torque at standstill", logarithmic=True
        ),
        Parameter(
            "no_load_rps", "rps", SHAPE, 1e-06, 1000000.0, 20.0, "speed at which no torque is left", logarithmic=True
        ),
    ),
    search=_search,
    meaning="too little voltage for the current at speed",
    plain_name="too little voltage at speed",
    cause="the back EMF leaves no voltage for the current",
    remedy="raise the bus voltage, or lower speed or acceleration: no controller can make up for it",
    place=lambda values: f"driving fast, towards {values['no_load_rps']:.3g} rps",
    compensable=False,
    regime="high speed with high driving torque",
    lookalikes=("torque_saturation", "quadratic_drag", "current_lag"),
    experiment=(
        "drive and brake at the highest speed: braking has all the voltage; compare commanded and measured current"
    ),
    motions=("pairs",),
    picture="velocity",
    figure="limit",
    acts_on="command",
    shown_by_current=True,
    needs_current=True,
)

"""What has no name: a curve over one axis, straight lines between knots, constant outside of where the data were.

A finding that is in no list is called `unknown:AXIS` and carried by this law.
"""

from __future__ import annotations

import math

from ....jit import njit
from .. import slots as s
from ..kinds import approach
from ..law import SHAPE, STRENGTH, Axis, Law, Parameter, SearchContext, Shape
from ..slots import Floats

UNKNOWN = "unknown:"
KNOTS = 24
FIRST_X = 5
FIRST_Y = FIRST_X + KNOTS

# how the axes of a finding are numbered in the law's first parameter
AXIS_CODES: dict[Axis, int] = {
    "time": 0, "velocity": 1, "direction": 2, "acceleration": 3, "motor_angle": 4, "output_angle": 5, "current": 6,
    "torque": 7, "dwell": 8, "travel_since_reversal": 9, "frequency": 10, "memory": 11,
}  # fmt: skip
KNOWN_AHEAD = frozenset(
    float(AXIS_CODES[word])
    for word in ("velocity", "direction", "acceleration", "motor_angle", "output_angle", "current", "torque", "dwell",
                 "travel_since_reversal", "memory", "time")
)  # fmt: skip

PLAIN = 0.0  # the curve is a torque
FRICTION = 1.0  # the curve is friction: times GRIP, -1 to 1
VISCOUS = 2.0  # the curve is a coefficient of viscous friction: times the velocity


@njit
def abscissa(signals: Floats, code: float, scale: float, of_current: float, memory: Floats) -> float:
    """Where on the axis the motion is. Angles are modulo `scale`, which is the time constant of a memory."""
    if code == 0.0:
        return float(signals[s.TIME_S])
    if code == 1.0:
        return float(signals[s.VELOCITY_RPS])
    if code == 2.0:
        return float(signals[s.GRIP])
    if code == 3.0:
        return float(signals[s.ACCELERATION_RPS2])
    if code == 4.0 or code == 5.0:
        angle_rev = float(signals[s.MOTOR_ANGLE_REV])
        return angle_rev - scale * math.floor(angle_rev / scale) if scale > 0.0 else angle_rev
    if code == 6.0:
        return float(signals[s.CURRENT_A])
    if code == 7.0:
        return float(signals[s.MOTOR_TORQUE_NM])
    if code == 8.0:
        return float(signals[s.REST_S])
    if code == 9.0:
        return float(signals[s.TRAVEL_REV])
    if code == 11.0:
        kept = abs(signals[s.VELOCITY_RPS]) if of_current == 0.0 else signals[s.CURRENT_A] * signals[s.CURRENT_A]
        memory[0] = approach(memory[0], kept, signals[s.STEP_S], max(scale, 1e-9))
        return float(memory[0])
    return 0.0


@njit
def lookup(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = curve(axis), or that times GRIP, or times velocity.

    Parameters: axis, kind, scale, count, of_current, then knots and values.
    """
    count = int(parameters[3])
    if count < 1:
        return
    x = abscissa(signals, parameters[0], parameters[2], parameters[4], memory)
    low, high = 0, count - 1
    if x <= parameters[FIRST_X]:
        torque_nm = parameters[FIRST_Y]
    elif x >= parameters[FIRST_X + high]:
        torque_nm = parameters[FIRST_Y + high]
    else:
        while high - low > 1:
            middle = (low + high) // 2
            if parameters[FIRST_X + middle] <= x:
                low = middle
            else:
                high = middle
        left, right = parameters[FIRST_X + low], parameters[FIRST_X + high]
        share = (x - left) / (right - left) if right > left else 0.0
        torque_nm = parameters[FIRST_Y + low] + share * (parameters[FIRST_Y + high] - parameters[FIRST_Y + low])
    if parameters[1] == FRICTION:
        torque_nm *= signals[s.GRIP]
    elif parameters[1] == VISCOUS:
        torque_nm *= signals[s.VELOCITY_RPS]
    signals[s.LOAD_NM] += torque_nm


def _no_search(context: SearchContext) -> list[Shape]:
    return []


LAW = Law(
    name="lookup",
    axis="velocity",
    kernel=lookup,
    parameters=(
        Parameter("axis", "-", SHAPE, 0.0, 11.0, 1.0, "number of the axis in AXIS_CODES; unknown:AXIS says it itself"),
        Parameter("kind", "-", SHAPE, 0.0, 2.0, 0.0, "the curve is 0: a torque; 1: friction, with its sign; 2: Nm/rps"),
        Parameter("scale", "-", SHAPE, 0.0, 1e9, 0.0, "period of an angle, rev; time constant of a memory, s"),
        Parameter("count", "-", SHAPE, 0.0, float(KNOTS), 0.0, "number of knots"),
        Parameter("of_current", "-", SHAPE, 0.0, 1.0, 0.0, "a memory of 0: the speed; 1: the squared current, in A2"),
        *(Parameter(f"x{k:02d}", "-", SHAPE, -1e9, 1e9, 0.0, f"place of knot {k}, rising") for k in range(KNOTS)),
        *(Parameter(f"y{k:02d}", "Nm", STRENGTH, -1e6, 1e6, 0.01, f"torque at knot {k}") for k in range(KNOTS)),
    ),
    search=_no_search,
    meaning="a curve over one axis, for what is in no list",
    compensable=True,
    regime="inside the visited range; constant outside",
    lookalikes=(),
    experiment="a wider range of this axis, with the others held",
    motions=("staircase", "triangles", "dwells", "pairs", "biased_sines", "coast_downs", "creep"),
    picture="velocity",
)  # fmt: skip

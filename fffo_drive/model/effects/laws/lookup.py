"""What has no name: a curve over one axis, or a table over two; straight lines between knots, constant outside of them.

A finding that is in no list is called `unknown:AXIS` and carried by this law.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from ....jit import njit
from .. import slots as s
from ..kinds import TURN, approach
from ..law import SHAPE, STRENGTH, Axis, Law, Parameter, SearchContext, Shape
from ..slots import Floats

UNKNOWN = "unknown:"
KNOTS = 24  # of a curve, and of the first axis of a table
LEVELS = 4  # knots of the second axis of a table
VALUES = KNOTS * LEVELS
FIRST_X = 8
FIRST_Z = FIRST_X + KNOTS
FIRST_Y = FIRST_Z + LEVELS
NO_AXIS = -1.0

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
RESPONSE = 3.0  # the curve is over frequency: a share of the motor torque, in phase and a quarter of a period late
WOUND = 4.0  # the curve is over the reach of what is wound up by the travel, and slips at its end: rev
BRAKE = 5.0  # the curve is a drag: times the sign of the velocity, which unlike GRIP does not wait for presliding
BANDS = 12  # knots of a response
DAMPING = 0.5  # of a band: neighbours whose frequencies have a ratio of 2 meet half way


@njit
def abscissa(signals: Floats, code: float, scale: float, of_current: float, memory: Floats) -> float:
    """Where on the axis the motion is. Angles are modulo `scale`, which is the time constant of a memory.

    A memory without a length, of the speed, is the speed itself.
    """
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
def between(x: float, parameters: Floats, first: int, count: int) -> tuple[int, float]:
    """The knot at or before x, and which share of the way to the next it is; the ends hold beyond them."""
    low, high = 0, count - 1
    if high == 0 or x <= parameters[first]:
        return 0, 0.0
    if x >= parameters[first + high]:
        return high - 1, 1.0
    while high - low > 1:
        middle = (low + high) // 2
        if parameters[first + middle] <= x:
            low = middle
        else:
            high = middle
    left, right = parameters[first + low], parameters[first + high]
    return low, (x - left) / (right - left) if right > left else 0.0


@njit
def on_curve(parameters: Floats, first: int, count: int, knot: int, share: float) -> float:
    """Between the value of a knot and that of the next."""
    left = parameters[first + knot]
    return float(left + share * (parameters[first + min(knot + 1, count - 1)] - left))


@njit
def response(signals: Floats, parameters: Floats, memory: Floats, count: int) -> float:
    """The motor torque through a bank of bands, one a knot: shares of what is in phase, then of what is late.

    x' = w (2 D (u - x) - y), y' = w x: at the band's own frequency x is u, and y is u a quarter of a period late.
    """
    step_s, torque_nm = signals[s.STEP_S], signals[s.MOTOR_TORQUE_NM]
    load_nm = 0.0
    for k in range(count):
        turn = TURN * parameters[FIRST_X + k] * step_s
        x, y = memory[2 * k], memory[2 * k + 1]
        x += turn * (2.0 * DAMPING * (torque_nm - x) - y)
        y += turn * x
        memory[2 * k], memory[2 * k + 1] = x, y
        load_nm += parameters[FIRST_Y + k] * x + parameters[FIRST_Y + count + k] * y
    return load_nm


@njit
def wound(signals: Floats, parameters: Floats, memory: Floats, count: int) -> float:
    """Stops of Prandtl and Ishlinskii, one a knot: springs that pull back by their value once they slip, at the reach.

    Any hysteresis that follows the travel, at whatever rate, is a sum of them.
    """
    travel_rev = signals[s.VELOCITY_RPS] * signals[s.STEP_S]
    load_nm = 0.0
    for k in range(count):
        reach_rev = parameters[FIRST_X + k]
        memory[k] = min(reach_rev, max(-reach_rev, memory[k] + travel_rev))
        load_nm += parameters[FIRST_Y + k] * memory[k] / max(reach_rev, 1e-9)
    return load_nm


@njit
def lookup(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = curve(axis) or table(axis, across), or that times GRIP, or times velocity; a response over frequency; stops.

    Parameters: axis, kind, scale, count, of_current, across, across_scale, levels, then the knots of both axes, and the
    values: all knots of the first level, then of the next.
    """
    count, levels = int(parameters[3]), int(parameters[7])
    if count < 1:
        return
    if parameters[1] == RESPONSE:
        signals[s.LOAD_NM] += response(signals, parameters, memory, min(count, BANDS))
        return
    if parameters[1] == WOUND:
        signals[s.LOAD_NM] += wound(signals, parameters, memory, count)
        return
    x = abscissa(signals, parameters[0], parameters[2], parameters[4], memory)
    knot, share = between(x, parameters, FIRST_X, count)
    if parameters[5] < 0.0 or levels < 1:
        torque_nm = on_curve(parameters, FIRST_Y, count, knot, share)
    else:
        z = abscissa(signals, parameters[5], parameters[6], 0.0, memory[1:])
        level, part = between(z, parameters, FIRST_Z, levels)
        torque_nm = on_curve(parameters, FIRST_Y + level * count, count, knot, share)
        if part > 0.0:
            next_nm = on_curve(parameters, FIRST_Y + (level + 1) * count, count, knot, share)
            torque_nm += part * (next_nm - torque_nm)
    if parameters[1] == FRICTION:
        torque_nm *= signals[s.GRIP]
    elif parameters[1] == VISCOUS:
        torque_nm *= signals[s.VELOCITY_RPS]
    elif parameters[1] == BRAKE:
        torque_nm *= max(-1.0, min(1.0, signals[s.VELOCITY_RPS] / signals[s.REST_SPEED_RPS]))
    signals[s.LOAD_NM] += torque_nm


def _no_search(context: SearchContext) -> list[Shape]:
    return []


def values_of(shapes: Mapping[str, float]) -> int:
    """How many values a curve or a table has."""
    if shapes.get("kind", PLAIN) == RESPONSE:
        return 2 * int(shapes.get("count", 0.0))
    return int(shapes.get("count", 0.0)) * (max(1, int(shapes.get("levels", 0.0))) if is_table(shapes) else 1)


def is_table(shapes: Mapping[str, float]) -> bool:
    """Whether there is a second axis."""
    return shapes.get("across", NO_AXIS) >= 0.0


def code_of(word: str) -> float:
    """Number of an axis. Raises KeyError for a word that is none."""
    return float({str(axis): code for axis, code in AXIS_CODES.items()}[word])


def across_axis(shapes: Mapping[str, float]) -> Axis:
    """The second axis of a table."""
    return next(word for word, code in AXIS_CODES.items() if code == shapes["across"])


def across_word(shapes: Mapping[str, float]) -> str:
    """The second axis of a table in words; empty for a curve."""
    if not is_table(shapes):
        return ""
    word = across_axis(shapes)
    return "speed" if word == "memory" and shapes.get("across_scale", 0.0) == 0.0 else word


LAW = Law(
    name="lookup",
    axis="velocity",
    kernel=lookup,
    parameters=(
        Parameter("axis", "-", SHAPE, 0.0, 11.0, 1.0, "number of the axis in AXIS_CODES; unknown:AXIS says it itself"),
        Parameter(
            "kind", "-", SHAPE, 0.0, 5.0, 0.0,
            "0: a torque; 1: friction; 2: Nm/rps; 3: shares of the motor torque; 4: springs that slip; 5: a drag",
        ),
        Parameter("scale", "-", SHAPE, 0.0, 1e9, 0.0, "period of an angle, rev; time constant of a memory, s"),
        Parameter("count", "-", SHAPE, 0.0, float(KNOTS), 0.0, "number of knots"),
        Parameter("of_current", "-", SHAPE, 0.0, 1.0, 0.0, "a memory of 0: the speed; 1: the squared current, in A2"),
        Parameter("across", "-", SHAPE, NO_AXIS, 11.0, NO_AXIS, "number of the second axis of a table; -1: a curve"),
        Parameter("across_scale", "-", SHAPE, 0.0, 1e9, 0.0, "scale of the second axis; a memory of 0 s: the speed"),
        Parameter("levels", "-", SHAPE, 0.0, float(LEVELS), 0.0, "number of knots of the second axis"),
        *(Parameter(f"x{k:02d}", "-", SHAPE, -1e9, 1e9, 0.0, f"place of knot {k}, rising") for k in range(KNOTS)),
        *(Parameter(f"z{k:02d}", "-", SHAPE, -1e9, 1e9, 0.0, f"place of level {k}, rising") for k in range(LEVELS)),
        *(Parameter(f"y{k:02d}", "Nm", STRENGTH, -1e6, 1e6, 0.01, f"torque at value {k}") for k in range(VALUES)),
    ),
    search=_no_search,
    meaning="a curve over one axis or a table over two, for what is in no list",
    compensable=True,
    regime="inside the visited range; constant outside",
    lookalikes=(),
    experiment="a wider range of this axis, with the others held",
    motions=("staircase", "triangles", "dwells", "pairs", "biased_sines", "coast_downs", "creep"),
    picture="velocity",
)  # fmt: skip

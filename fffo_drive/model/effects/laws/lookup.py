"""What has no name: a curve over one axis, or a table over two; straight lines between knots, constant outside of them.

A finding that is in no list is called `unknown:AXIS` and carried by this law.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from ....arrays import Floats
from ....documents import StrictRecord
from ....jit import njit
from ....units import TWO_PI
from .. import slots as s
from ..kinds import approach
from ..law import SHAPE, STRENGTH, Axis, Law, Parameter, SearchContext, Shape

UNKNOWN = "unknown:"
KNOTS = 24  # of a curve, and of the first axis of a table
LEVELS = 4  # knots of the second axis of a table
VALUES = KNOTS * LEVELS
FIRST_X = 8
FIRST_Z = FIRST_X + KNOTS
FIRST_Y = FIRST_Z + LEVELS
NO_AXIS = -1.0
SPEED: Final = "speed"  # a memory of the speed without a length, as a second axis

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
KindWord = Literal["torque", "friction", "viscous", "response", "wound", "drag"]
KINDS: dict[KindWord, tuple[float, str]] = {  # as model files call them, with the unit of their values
    "torque": (PLAIN, "Nm"), "friction": (FRICTION, "Nm"), "viscous": (VISCOUS, "Nm/rps"), "response": (RESPONSE, "-"),
    "wound": (WOUND, "Nm"), "drag": (BRAKE, "Nm"),
}  # fmt: skip
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
        turn = TWO_PI * parameters[FIRST_X + k] * step_s
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
    return SPEED if word == "memory" and shapes.get("across_scale", 0.0) == 0.0 else word


class CurveModel(StrictRecord):
    """A free curve or table as a model file and a report have it; the kernel takes `packed_curve` of it.

    A table has a row of values for each level. A response has two rows: the share of the motor torque in phase, and the
    share a quarter of a period late.
    """

    kind: Annotated[KindWord, Field(description="what the values are, see KINDS")]
    unit: Annotated[str, Field(description="of the values")]
    scale: Annotated[float, Field(ge=0, description="period of an angle, rev; time constant of a memory, s")] = 0.0
    of_current: Annotated[bool, Field(description="memory of the squared current (A2) instead of the speed")] = False
    knots: Annotated[list[float], Field(description="values of the variable, ascending")]
    across: Annotated[Axis | Literal["speed"] | None, Field(description="second variable of a table")] = None
    across_scale: Annotated[float, Field(ge=0, description="as scale, for the second variable")] = 0.0
    levels: Annotated[list[float], Field(description="values of the second variable, ascending")] = Field(
        default_factory=list
    )
    values: Annotated[list[float] | list[list[float]], Field(description="one per knot; in a table one row per level")]
    sd: Annotated[
        list[float | None] | list[list[float | None]] | None, Field(description="of the values; null: not fitted")
    ] = None


def packed_curve(curve: CurveModel) -> dict[str, float]:
    """Parameters of the law by their names, but for the axis, which the name of the effect says."""
    found = {
        "kind": KINDS[curve.kind][0], "scale": curve.scale, "of_current": float(curve.of_current),
        "count": float(len(curve.knots)),
    }  # fmt: skip
    if curve.across is not None:
        found["across"] = code_of("memory" if curve.across == SPEED else curve.across)
        found |= {"across_scale": curve.across_scale, "levels": float(len(curve.levels))}
    return found | _numbered("x", curve.knots) | _numbered("z", curve.levels) | _numbered("y", _flat(curve.values))


def packed_sd(curve: CurveModel) -> dict[str, float]:
    """Standard deviations of the values by the law's names, where they were fitted."""
    return {name: sd for name, sd in _numbered("y", _flat(curve.sd or [])).items() if sd is not None}


def curve_model(packed: Mapping[str, float], sd: Mapping[str, float | None]) -> CurveModel:
    """The curve of packed parameters and of the standard deviations of its values: the inverse of `packed_curve`."""
    word = next(word for word, (code, _) in KINDS.items() if code == packed.get("kind", PLAIN))
    count, table = int(packed.get("count", 0.0)), is_table(packed)
    names = [f"y{k:02d}" for k in range(values_of(packed))]
    spread = [sd.get(name) for name in names]

    def rows(numbers: list[Any]) -> list[Any]:
        in_rows = table or word == "response"
        return [numbers[k : k + count] for k in range(0, len(numbers), count)] if in_rows else numbers

    return CurveModel.model_validate(
        {
            "kind": word,
            "unit": KINDS[word][1],
            "scale": float(packed.get("scale", 0.0)),
            "of_current": packed.get("of_current", 0.0) != 0.0,
            "knots": [float(packed[f"x{k:02d}"]) for k in range(count)],
            "across": across_word(packed) or None,
            "across_scale": float(packed.get("across_scale", 0.0)) if table else 0.0,
            "levels": [float(packed[f"z{k:02d}"]) for k in range(int(packed.get("levels", 0.0)))] if table else [],
            "values": rows([float(packed.get(name, 0.0)) for name in names]),
            "sd": rows([None if one is None else float(one) for one in spread])
            if any(one is not None for one in spread)
            else None,
        }
    )


def _flat(rows: Sequence[Any]) -> list[Any]:
    return [one for row in rows for one in (row if isinstance(row, list) else (row,))]


def _numbered(letter: str, numbers: Sequence[Any]) -> dict[str, Any]:
    return {f"{letter}{k:02d}": number for k, number in enumerate(numbers)}


def curve_errors(curve: CurveModel) -> list[tuple[str, str]]:
    """(key, what is wrong with it): places that do not rise or are too many, values that do not fit them."""
    errors = []
    levels = (0, 0) if curve.across is None else (1, LEVELS)
    if curve.across is not None and curve.kind in ("response", "wound"):
        errors.append(("across", f"a curve of kind {curve.kind} has one axis"))
    for key, places, (least, most) in (
        ("knots", curve.knots, (1, BANDS if curve.kind == "response" else KNOTS)),
        ("levels", curve.levels, levels),
    ):
        if not least <= len(places) <= most:
            errors.append((key, f"{len(places)} places, where {least} to {most} are allowed"))
        if any(right <= left for left, right in pairwise(places)):
            errors.append((key, "places have to rise"))
    if curve.unit != KINDS[curve.kind][1]:
        errors.append(("unit", f"{curve.unit!r}, where values of kind {curve.kind} are in {KINDS[curve.kind][1]}"))
    count = len(curve.knots)
    rows = 2 if curve.kind == "response" else len(curve.levels)
    sizes = [count] * rows if rows else count
    for key, given in (("values", curve.values), ("sd", curve.sd)):
        if given is not None and _sizes(given) != sizes:
            errors.append((key, "one number a knot is needed; of a table a row a level; of a response two rows"))
    return errors


def _sizes(rows: Sequence[Any]) -> int | list[int]:
    return [len(row) for row in rows] if any(isinstance(row, list) for row in rows) else len(rows)


def _held(name: str, low: float, high: float, typical: float, meaning: str, span: bool = False) -> Parameter:
    return Parameter(name, "-", SHAPE, low, high, typical, meaning, held=True, span=span)


LAW = Law(
    name="lookup",
    axis="velocity",
    kernel=lookup,
    parameters=(
        _held("axis", 0.0, 11.0, 1.0, "number of the axis in AXIS_CODES; unknown:AXIS says it itself"),
        _held(
            "kind", 0.0, 5.0, 0.0,
            "0: a torque; 1: friction; 2: Nm/rps; 3: shares of the motor torque; 4: springs that slip; 5: a drag",
        ),
        _held("scale", 0.0, 1e9, 0.0, "period of an angle, rev; time constant of a memory, s", span=True),
        _held("count", 0.0, float(KNOTS), 0.0, "number of knots"),
        _held("of_current", 0.0, 1.0, 0.0, "a memory of 0: the speed; 1: the squared current, in A2"),
        _held("across", NO_AXIS, 11.0, NO_AXIS, "number of the second axis of a table; -1: a curve"),
        _held("across_scale", 0.0, 1e9, 0.0, "scale of the second axis; a memory of 0 s: the speed"),
        _held("levels", 0.0, float(LEVELS), 0.0, "number of knots of the second axis"),
        *(_held(f"x{k:02d}", -1e9, 1e9, 0.0, f"place of knot {k}, rising") for k in range(KNOTS)),
        *(_held(f"z{k:02d}", -1e9, 1e9, 0.0, f"place of level {k}, rising") for k in range(LEVELS)),
        *(Parameter(f"y{k:02d}", "Nm", STRENGTH, -1e6, 1e6, 0.01, f"torque at value {k}") for k in range(VALUES)),
    ),
    search=_no_search,
    meaning="a curve over one axis or a table over two, for what is in no list",
    plain_name="an unknown torque",
    cause="unknown: the curve shows what it varies with",
    remedy="look at the curve; the controller compensates it where the reference determines that axis",
    compensable=True,
    regime="within the range that the runs cover; constant beyond it",
    lookalikes=(),
    experiment="a wider range of this axis, with the others held",
    motions=("staircase", "triangles", "dwells", "pairs", "biased_sines", "coast_downs", "creep"),
    picture="velocity",
    acts_on="torque",  # over current, torque and frequency it does
    rung=4,
)  # fmt: skip

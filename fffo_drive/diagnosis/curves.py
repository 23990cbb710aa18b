"""Non-parametric effects: free curves over one axis, tables over two axes, springs along the travel.

Each is a table of the library's `lookup` law, so it is refitted, written to a model file and (over an axis that a
feed-forward knows) compensated like any other effect. Knots are placed where the data are.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..model.effects import slots
from ..model.effects.laws.lookup import (
    BRAKE,
    FRICTION,
    KNOTS,
    PLAIN,
    UNKNOWN,
    VISCOUS,
    WOUND,
    across_axis,
    across_word,
    code_of,
    is_table,
    values_of,
)
from ..model.effects.registry import axis_of_effect
from .rows import DiagnosisRows, Filter
from .scenes import Scene, load_along

FAR = 1e6
CURVE_KNOTS = 12
FINE_KNOTS = 22  # knots on an axis with structure at every scale, and on an angle
MOTOR_PERIODS_REV = (1.0, 2.0, 3.0, 4.0, 5.0)  # periods at which the same parts of the machine meet again
PERIODS = 3.0  # a motion must cover at least so many periods before an angle is used as an axis
ANGLES = ("motor_angle", "output_angle")
SCALELESS = ("dwell", "travel_since_reversal")
LEAST_REACH_REV = 0.05  # shortest travel that winds up a spring: longer than presliding
COARSE = 5  # knots on each axis of a coarse table
LEVEL_SHARES = (0.05, 0.35, 0.65, 0.95)  # a fine table has a level at each of these quantiles of the rows
INNER = (0.002, 0.998)  # quantiles between which knots are placed


class CurveAxis(NamedTuple):
    """One axis of the search for curves."""

    word: str
    kind: float  # kind of the lookup law
    scale: float  # period of an angle in rev, or time constant of a memory in s
    of_current: float = 0.0  # a memory of the squared current, not of the speed


SPEED = CurveAxis("memory", FRICTION, 0.0)  # a memory of zero length
TABLE_AXES = (  # in each pair the axis with the finer knots is first
    CurveAxis("motor_angle", PLAIN, 1.0), CurveAxis("output_angle", PLAIN, 0.0), CurveAxis("velocity", PLAIN, 0.0),
    CurveAxis("travel_since_reversal", FRICTION, 0.0), CurveAxis("time", FRICTION, 0.0),
    CurveAxis("current", PLAIN, 0.0), CurveAxis("memory", FRICTION, 3.0), CurveAxis("acceleration", PLAIN, 0.0),
)  # fmt: skip
OVER_SPEED = ("motor_angle", "output_angle", "travel_since_reversal", "time", "memory")


class CurvePair(NamedTuple):
    """A table over two axes; the first has the finer knots."""

    along: CurveAxis
    across: CurveAxis

    @property
    def name(self) -> str:
        """Name of its residual channel."""
        drag = " (drag)" if self.along.kind == BRAKE else ""
        return f"{self.along.word} x {across_word(self.shapes)}{drag}"

    @property
    def shapes(self) -> dict[str, float]:
        """The two axes as shapes of the lookup law."""
        return {
            "kind": self.along.kind, "scale": self.along.scale,
            "across": code_of(self.across.word), "across_scale": self.across.scale,
        }  # fmt: skip


class Curve(NamedTuple):
    """A curve or a table at the rows; a table with the curves over each of its axes alone."""

    name: str  # unknown:AXIS
    shapes: dict[str, float]
    columns: Floats  # (m, k)
    beside: Floats | None = None  # (m, j) of a table: the curves over its two axes
    pair: CurvePair | None = None


def axes_of(turns: float) -> list[CurveAxis]:
    """All axes that a motion over this many turns supports."""
    found = [
        CurveAxis("time", FRICTION, 0.0), CurveAxis("velocity", PLAIN, 0.0), CurveAxis("acceleration", PLAIN, 0.0),
        CurveAxis("current", PLAIN, 0.0), CurveAxis("dwell", FRICTION, 0.0),
        CurveAxis("travel_since_reversal", FRICTION, 0.0),
        CurveAxis("memory", FRICTION, 0.5), CurveAxis("memory", FRICTION, 3.0), CurveAxis("memory", FRICTION, 12.0),
        CurveAxis("direction", PLAIN, 0.0), CurveAxis("torque", FRICTION, 0.0),
    ]  # fmt: skip
    found += [CurveAxis("memory", FRICTION, time_constant_s, 1.0) for time_constant_s in (1.0, 4.0, 16.0)]
    for period_rev in MOTOR_PERIODS_REV:
        if turns > PERIODS * period_rev:
            found += [CurveAxis("motor_angle", kind, period_rev) for kind in (PLAIN, FRICTION, BRAKE)]
    found += [CurveAxis("output_angle", kind, 0.0) for kind in (PLAIN, FRICTION, BRAKE)]
    found += [CurveAxis(word, VISCOUS, 0.0) for word in ("time", "current", "output_angle")]
    return [*found, CurveAxis("memory", VISCOUS, 3.0), CurveAxis("memory", VISCOUS, 12.0)]


def curves(rows: DiagnosisRows, scenes: Sequence[Scene]) -> Iterator[Curve]:
    """A curve over every axis, and springs along the travel. Sampled at the rows without a filter: they change
    slowly.
    """
    for axis in axes_of(rows.turns):
        knots = knots_of(_moving(scenes, abscissa(scenes, axis)), axis)
        if knots.size >= 4:
            shapes = {**_shapes(axis.kind, knots), "scale": axis.scale, "of_current": axis.of_current}
            at = rows.joined(abscissa(scenes, axis))
            weight = rows.joined(factor(scene, axis.kind) for scene in scenes)
            yield Curve(UNKNOWN + axis.word, shapes, linear_basis(at, knots) * weight[:, None])
    yield from _springs(rows, scenes)


def _springs(rows: DiagnosisRows, scenes: Sequence[Scene]) -> Iterator[Curve]:
    travel = np.concatenate([s.motion[s.moving > 0.0, slots.TRAVEL_REV] for s in scenes])
    furthest_rev = 0.5 * float(np.quantile(travel, 0.99)) if travel.size else 0.0
    if furthest_rev >= 4.0 * LEAST_REACH_REV:
        shapes = _shapes(WOUND, np.geomspace(LEAST_REACH_REV, furthest_rev, CURVE_KNOTS))
        parts = [curve_columns(scene, UNKNOWN + "memory", shapes, rows.laws) for scene in scenes]
        yield Curve(UNKNOWN + "memory", shapes, np.concatenate(parts))


def pairs_of(turns: float) -> list[CurvePair]:
    """All pairs that are searched: torque with velocity as one axis, friction and drag with speed as one axis."""
    axes = {axis.word: axis for axis in TABLE_AXES if axis.word != "motor_angle" or turns > PERIODS}
    found = [_pair(first, second) for first, second in itertools.combinations(axes.values(), 2)]
    found += [CurvePair(axes[word]._replace(kind=FRICTION), SPEED) for word in OVER_SPEED if word in axes]
    return found + [CurvePair(axes[word]._replace(kind=BRAKE), SPEED) for word in ANGLES if word in axes]


def _pair(first: CurveAxis, second: CurveAxis) -> CurvePair:
    frictional = FRICTION in (first.kind, second.kind) and "velocity" not in (first.word, second.word)
    return CurvePair(first._replace(kind=FRICTION if frictional else PLAIN), second)


def coarse_tables(rows: DiagnosisRows, scenes: Sequence[Scene]) -> Iterator[Curve]:
    """A coarse table over every pair that the data cover."""
    hat: dict[tuple[str, float], Floats | None] = {}
    for pair in pairs_of(rows.turns):
        for axis in pair:
            if (axis.word, axis.scale) not in hat:
                at = rows.joined(abscissa(scenes, axis))
                knots = np.unique(np.quantile(at[rows.kept], np.linspace(0.01, 0.99, COARSE)))
                hat[axis.word, axis.scale] = (
                    linear_basis(np.clip(at, knots[0], knots[-1]), knots) if knots.size >= 3 else None
                )
        first, second = (hat[axis.word, axis.scale] for axis in pair)
        if first is not None and second is not None:
            weight = rows.joined(factor(scene, pair.along.kind) for scene in scenes)[:, None]
            table = (first[:, :, None] * second[:, None, :]).reshape(first.shape[0], -1)
            beside = np.concatenate([first, second], axis=1)
            yield Curve(UNKNOWN + pair.along.word, pair.shapes, table * weight, beside * weight, pair)


def fine_table(rows: DiagnosisRows, scenes: Sequence[Scene], pair: CurvePair) -> Curve | None:
    """A fine table over a pair, as the lookup law stores it."""
    places = [abscissa(scenes, axis) for axis in pair]
    knots = knots_of(_moving(scenes, places[0]), pair.along)
    if knots.size > KNOTS:
        knots = knots[np.unique(np.rint(np.linspace(0, knots.size - 1, KNOTS)).astype(int))]
    levels = np.unique(np.quantile(_moving(scenes, places[1]), LEVEL_SHARES))
    if knots.size < 4 or levels.size < 2:
        return None
    name = UNKNOWN + pair.along.word
    shapes = {**pair.shapes, "count": float(knots.size), "levels": float(levels.size)}
    shapes |= {f"x{k:02d}": float(x) for k, x in enumerate(knots)}
    shapes |= {f"z{k:02d}": float(z) for k, z in enumerate(levels)}
    parts = [curve_columns(scene, name, shapes, rows.laws) for scene in scenes]
    return Curve(name, shapes, np.concatenate(parts), pair=pair)


def kind_of_curve(curve: Curve) -> str:
    """Name by which `without` leaves out a kind: the channel of a table, `kind(axis)` of a curve."""
    if curve.pair is not None:
        return curve.pair.name
    kinds = {PLAIN: "torque", FRICTION: "friction", VISCOUS: "viscous", WOUND: "wound", BRAKE: "drag"}
    current = ", current" if curve.shapes.get("of_current", 0.0) else ""
    turns = curve.shapes.get("scale", 0.0)
    period = f", {turns:g}" if curve.name.removeprefix(UNKNOWN) in ANGLES and turns > 1.0 else ""
    return f"{kinds[curve.shapes['kind']]}({curve.name.removeprefix(UNKNOWN)}{current}{period})"


def _moving(scenes: Sequence[Scene], places: Sequence[Floats]) -> Floats:
    return np.concatenate([p[s.moving > 0.0] for p, s in zip(places, scenes, strict=True)])


def _shapes(kind: float, knots: Floats) -> dict[str, float]:
    return {"kind": kind, "count": float(knots.size)} | {f"x{k:02d}": float(x) for k, x in enumerate(knots)}


def knots_of(places: Floats, axis: CurveAxis) -> Floats:
    """Knots where the data are: a compromise between equal steps of the range and equal numbers of samples."""
    if not places.size:
        return np.zeros(0)
    low, high = (float(x) for x in np.quantile(places, INNER))
    if not high > low:
        return np.zeros(0)
    if axis.scale > 0.0 and axis.word in ANGLES:
        return np.linspace(0.0, axis.scale, FINE_KNOTS)
    shares = np.linspace(0.0, 1.0, CURVE_KNOTS)
    if axis.word in SCALELESS:
        small = max(float(np.quantile(places[places > 0.0], 0.05)), 1e-3 * high) if (places > 0.0).any() else low
        found = np.geomspace(small, high, FINE_KNOTS)
    else:
        found = 0.5 * (np.quantile(places, INNER[0] + (INNER[1] - INNER[0]) * shares) + low + (high - low) * shares)
    distinct = [float(found[0])]
    for x in found[1:]:
        if x - distinct[-1] > (0.0 if axis.word in SCALELESS else 0.01 * (high - low)):
            distinct.append(float(x))
    return np.array(distinct)


def axes_of_curve(name: str, shapes: Mapping[str, float]) -> list[tuple[CurveAxis, Floats]]:
    """The axes of a curve or table, with the knots on each."""
    knots = np.array([shapes[f"x{k:02d}"] for k in range(int(shapes["count"]))])
    own = CurveAxis(axis_of_effect(name), shapes["kind"], shapes.get("scale", 0.0), shapes.get("of_current", 0.0))
    found = [(own, knots)]
    if is_table(shapes):
        levels = np.array([shapes[f"z{k:02d}"] for k in range(int(shapes["levels"]))])
        found.append((CurveAxis(across_axis(shapes), PLAIN, shapes["across_scale"]), levels))
    return found


def curve_columns(scene: Scene, name: str, shapes: Mapping[str, float], filter_: Filter) -> Floats:
    """Torque per unit of each value of a curve or table, at the rows of a scene. (m, values)"""
    if shapes["kind"] == WOUND:  # each spring has a state of its own
        units = (load_along(scene, name, {**shapes, f"y{k:02d}": 1.0}) for k in range(values_of(shapes)))
        return np.stack([filter_.rows(unit) for unit in units], axis=1)
    weight = factor(scene, shapes["kind"])
    first, *second = (linear_basis(abscissa([scene], axis)[0], knots).T for axis, knots in axes_of_curve(name, shapes))
    levels = [weight] if not second else [hat * weight for hat in second[0]]
    return np.stack([filter_.rows(hat * level) for level in levels for hat in first], axis=1)


def linear_basis(places: Floats, knots: Floats) -> Floats:
    """Linear interpolation weights, one column per knot; beyond the last one its value holds. (n, k)"""
    return np.stack([np.interp(places, knots, unit) for unit in np.eye(knots.size)], axis=1)


def factor(scene: Scene, kind: float) -> Floats:
    """Factor by which a kind of curve is multiplied along a scene; zero at rest. (l,)"""
    if kind == FRICTION:
        return grip(scene) * scene.moving
    if kind == BRAKE:
        return np.clip(scene.motion[:, slots.VELOCITY_RPS] / slots.REST_SPEED_DEFAULT_RPS, -1.0, 1.0) * scene.moving
    return scene.motion[:, slots.VELOCITY_RPS] * scene.moving if kind == VISCOUS else scene.moving


def grip(scene: Scene) -> Floats:
    """Fraction of presliding that is passed, with the direction: -1 to 1, as the laws see it. (l,)"""
    friction = scene.axis.friction
    contact = scene.motion[:, slots.FRICTION_NM] - friction.viscous_nm_per_rps * scene.motion[:, slots.VELOCITY_RPS]
    return np.asarray(np.clip(contact / friction.coulomb_nm, -1.0, 1.0))


def abscissa(scenes: Sequence[Scene], axis: CurveAxis) -> list[Floats]:
    """Coordinate of the motion on an axis, stretch by stretch, from a lookup whose curve is the identity."""
    identity = {
        "kind": PLAIN, "scale": axis.scale, "of_current": axis.of_current, "count": 2.0,
        "x00": -FAR, "x01": FAR, "y00": -FAR, "y01": FAR,
    }  # fmt: skip
    return [load_along(s._replace(moving=np.ones(s.moving.size)), UNKNOWN + axis.word, identity) for s in scenes]

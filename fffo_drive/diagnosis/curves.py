"""Non-parametric effects: free curves over one axis, springs along the travel.

Each is a curve of the library's `lookup` law, so it is refitted, written to a model file and (over an axis that a
feed-forward knows) compensated like any other effect. Knots are placed where the data are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..model.effects import slots
from ..model.effects.laws.lookup import (
    BRAKE,
    FRICTION,
    PLAIN,
    UNKNOWN,
    VISCOUS,
    WOUND,
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
INNER = (0.002, 0.998)  # quantiles between which knots are placed


class CurveAxis(NamedTuple):
    """One axis of the search for curves."""

    word: str
    kind: float  # kind of the lookup law
    scale: float  # period of an angle in rev, or time constant of a memory in s
    of_current: float = 0.0  # a memory of the squared current, not of the speed


class Curve(NamedTuple):
    """A curve at the rows."""

    name: str  # unknown:AXIS
    shapes: dict[str, float]
    columns: Floats  # (m, k)


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


def kind_of_curve(curve: Curve) -> str:
    """Name by which `without` leaves out a kind: `kind(axis)`."""
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


def curve_columns(scene: Scene, name: str, shapes: Mapping[str, float], filter_: Filter) -> Floats:
    """Torque per unit of each value of a curve, at the rows of a scene. (m, values)"""
    if shapes["kind"] == WOUND:  # each spring has a state of its own
        units = (load_along(scene, name, {**shapes, f"y{k:02d}": 1.0}) for k in range(values_of(shapes)))
        return np.stack([filter_.rows(unit) for unit in units], axis=1)
    axis = CurveAxis(axis_of_effect(name), shapes["kind"], shapes.get("scale", 0.0), shapes.get("of_current", 0.0))
    knots = np.array([shapes[f"x{k:02d}"] for k in range(int(shapes["count"]))])
    basis = linear_basis(abscissa([scene], axis)[0], knots) * factor(scene, shapes["kind"])[:, None]
    return np.stack([filter_.rows(column) for column in basis.T], axis=1)


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

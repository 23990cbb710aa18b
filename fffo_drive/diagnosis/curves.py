"""Curves and tables of the `lookup` law along a motion: where on their axes it is, and what each value gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..model.effects import slots
from ..model.effects.laws.lookup import (
    BRAKE,
    FRICTION,
    PLAIN,
    RESPONSE,
    UNKNOWN,
    VISCOUS,
    WOUND,
    across_axis,
    is_table,
    values_of,
)
from ..model.effects.registry import axis_of_effect
from .candidates import Scene, load_along
from .paths import Filter

Floats = npt.NDArray[np.float64]

FAR = 1e6


class Axis(NamedTuple):
    """One axis of the search."""

    word: str
    kind: float  # of the lookup
    scale: float  # period of an angle in rev, or time constant of a memory in s
    of_current: float = 0.0  # a memory of the squared current, not of the speed


def axes_of_curve(name: str, shapes: Mapping[str, float]) -> list[tuple[Axis, Floats]]:
    """The axes of a curve or a table, and the knots on each."""
    knots = np.array([shapes[f"x{k:02d}"] for k in range(int(shapes["count"]))])
    own = Axis(axis_of_effect(name), shapes["kind"], shapes.get("scale", 0.0), shapes.get("of_current", 0.0))
    found = [(own, knots)]
    if is_table(shapes):
        levels = np.array([shapes[f"z{k:02d}"] for k in range(int(shapes["levels"]))])
        found.append((Axis(across_axis(shapes), PLAIN, shapes["across_scale"]), levels))
    return found


def has_states(shapes: Mapping[str, float]) -> bool:
    """Whether the values stand for bands or springs with a state of their own, in place of places on an axis."""
    return shapes["kind"] in (RESPONSE, WOUND)


def curve_columns(scene: Scene, name: str, shapes: Mapping[str, float], filter_: Filter) -> Floats:
    """What each value of a curve or table gives, per unit of it, at the rows of a scene. (m, values)"""
    if has_states(shapes):
        units = (load_along(scene, name, {**shapes, f"y{k:02d}": 1.0}) for k in range(values_of(shapes)))
        return np.stack([filter_.rows(unit) for unit in units], axis=1)
    weight = factor(scene, shapes["kind"])
    first, *second = (hats(abscissa([scene], axis)[0], knots).T for axis, knots in axes_of_curve(name, shapes))
    levels = [weight] if not second else [hat * weight for hat in second[0]]
    return np.stack([filter_.rows(hat * level) for level in levels for hat in first], axis=1)


def hats(places: Floats, knots: Floats, beyond: float | None = None) -> Floats:
    """Straight lines between knots, one column a knot; beyond the last its end holds, or `beyond` stands. (n, k)"""
    return np.stack([np.interp(places, knots, unit, right=beyond) for unit in np.eye(knots.size)], axis=1)


def factor(scene: Scene, kind: float) -> Floats:
    """What a curve of a kind is times, along a scene; zero at rest. (l,)"""
    if kind == FRICTION:
        return grip(scene) * scene.moving
    if kind == BRAKE:
        return np.clip(scene.motion[:, slots.VELOCITY_RPS] / slots.REST_SPEED_DEFAULT_RPS, -1.0, 1.0) * scene.moving
    return scene.motion[:, slots.VELOCITY_RPS] * scene.moving if kind == VISCOUS else scene.moving


def grip(scene: Scene) -> Floats:
    """How far presliding is crossed, and which way: -1 to 1, as the laws see it. (l,)"""
    friction = scene.axis.friction
    contact = scene.motion[:, slots.FRICTION_NM] - friction.viscous_nm_per_rps * scene.motion[:, slots.VELOCITY_RPS]
    return np.asarray(np.clip(contact / friction.coulomb_nm, -1.0, 1.0))


def abscissa(scenes: Sequence[Scene], axis: Axis) -> list[Floats]:
    """Where on an axis the motion is, stretch by stretch: the lookup's own, from a curve that is the identity."""
    identity = {
        "kind": PLAIN, "scale": axis.scale, "of_current": axis.of_current, "count": 2.0,
        "x00": -FAR, "x01": FAR, "y00": -FAR, "y01": FAR,
    }  # fmt: skip
    return [
        load_along(
            Scene(s.stretch, s.motion, s.commanded, s.axis, np.ones(s.moving.size)), UNKNOWN + axis.word, identity
        )
        for s in scenes
    ]

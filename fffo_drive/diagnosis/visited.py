"""Where on its axes a free curve was learnt: beyond the places that the teaching runs visited it knows nothing."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ..model.effects.laws.lookup import PLAIN, RESPONSE, UNKNOWN, WOUND, across_axis, is_table
from ..model.effects.registry import axis_of_effect
from .candidates import Effect, Scene
from .free_curves import Axis, abscissa

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

TAUGHT_ROWS = 40.0  # near a knot, for its value to be known
TOUCHED = 0.02  # share of a row that a knot has, for its value to matter


def taught(effects: Sequence[Effect], scenes: Sequence[Scene], step: int, teaching: Mask) -> Mask:
    """Rows at which the free curves among the effects have values that the rows of `teaching` say. (m,)

    Time does not come back: a curve over it has to carry on by itself, and is asked everywhere.
    """
    known = np.ones(teaching.size, dtype=bool)
    for effect in effects:
        if effect.name.startswith(UNKNOWN) and effect.shapes["kind"] not in (RESPONSE, WOUND):
            known &= _taught(effect, scenes, step, teaching)
    return known


def _taught(effect: Effect, scenes: Sequence[Scene], step: int, teaching: Mask) -> Mask:
    along = [
        (axis, places) for axis, places in _axes(effect.shapes, axis_of_effect(effect.name)) if axis.word != "time"
    ]
    known = np.ones(teaching.size, dtype=bool)
    if not along:
        return known
    sides = [
        _sides(np.concatenate([part[::step] for part in abscissa(scenes, axis)]), places) for axis, places in along
    ]
    corners = [
        (tuple(place for place, _ in corner), np.prod([share for _, share in corner], axis=0))
        for corner in itertools.product(*sides)
    ]
    rows = np.zeros([places.size for _, places in along])
    for place, share in corners:
        np.add.at(rows, tuple(index[teaching] for index in place), share[teaching])
    for place, share in corners:
        known &= (share < TOUCHED) | (rows[place] >= TAUGHT_ROWS)
    return known


def _axes(shapes: Mapping[str, float], word: str) -> list[tuple[Axis, Floats]]:
    """The axes of a curve or a table, and the knots on each."""
    knots = np.array([shapes[f"x{k:02d}"] for k in range(int(shapes["count"]))])
    found = [(Axis(word, PLAIN, shapes["scale"], shapes.get("of_current", 0.0)), knots)]
    if is_table(shapes):
        levels = np.array([shapes[f"z{k:02d}"] for k in range(int(shapes["levels"]))])
        found.append((Axis(across_axis(shapes), PLAIN, shapes["across_scale"]), levels))
    return found


def _sides(at: Floats, knots: Floats) -> list[tuple[npt.NDArray[np.int64], Floats]]:
    """The knots on both sides of each row, and which share of it each has."""
    left = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, knots.size - 2)
    share = np.clip((at - knots[left]) / (knots[left + 1] - knots[left]), 0.0, 1.0)
    return [(left, 1.0 - share), (left + 1, share)]

"""Where on its axes a free curve was learnt: beyond the places that the teaching runs visited it knows nothing."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..model.effects.laws.lookup import UNKNOWN
from .candidates import Effect, Scene
from .curves import abscissa, axes_of_curve, has_states

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
        if effect.name.startswith(UNKNOWN) and not has_states(effect.shapes):
            known &= _taught(effect, scenes, step, teaching)
    return known


def _taught(effect: Effect, scenes: Sequence[Scene], step: int, teaching: Mask) -> Mask:
    along = [(axis, places) for axis, places in axes_of_curve(effect.name, effect.shapes) if axis.word != "time"]
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


def _sides(at: Floats, knots: Floats) -> list[tuple[npt.NDArray[np.int64], Floats]]:
    """The knots on both sides of each row, and which share of it each has."""
    left = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, knots.size - 2)
    share = np.clip((at - knots[left]) / (knots[left + 1] - knots[left]), 0.0, 1.0)
    return [(left, 1.0 - share), (left + 1, share)]

"""Does the measured current show it? What acts between command and current is seen there, without any mechanics.

A limit of the voltage or a lag of the current loop leaves the measured current short of its command by just what the
motion misses. Where a current was measured, a law of that kind is believed only if the current says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..model.effects.registry import law_of
from .base import NAMES, delayed
from .candidates import Effect, Scene, load_along
from .fitting import Data, Fitted, consistent_scenes

Floats = npt.NDArray[np.float64]

LEAST_SHARE = 0.5  # of what the measured current is short of, that an effect has to account for
LONGEST_SAMPLES = 20
FINENESS = 2  # delays tried a sample
MOST_INSIDE = 0.2  # of the motion inside a dead zone: there the residual explains itself


class Shortage(NamedTuple):
    """Torque that the measured current is short of its command, which takes so long to be measured."""

    delays_s: Floats  # (k,)
    rows_nm: Floats  # (k, m)


def shortage(data: Data) -> Shortage | None:
    """What the measured current is short of, under each delay that may lie between; None where none was measured."""
    if any(stretch.measured_a is None for stretch in data.stretches):
        return None
    delays = np.arange(0, LONGEST_SAMPLES * FINENESS) / FINENESS
    found = np.empty((delays.size, data.rows.time_s.size))
    for stretch, (begin, end) in zip(data.stretches, data.rows.bounds, strict=True):
        assert stretch.measured_a is not None
        for k, delay in enumerate(delays):
            short_a = delayed(stretch.current_a, float(delay)) - stretch.measured_a
            found[k, begin:end] = data.rows.filter.rows(stretch.torque_constant_nm_per_a * short_a)
    return Shortage(delays * data.rows.filter.period_s, found)


def believed(data: Data, short: Shortage | None, fitted: Fitted) -> bool:
    """Whether the current, commanded and measured, lets the last effect stand."""
    effect = fitted.effects[-1]
    if effect.name == "dead_zone":
        return effect.shapes["width_a"] <= driving_a(consistent_scenes(data, fitted.physical, ()))
    if law_of(effect.name).shown_by_current and short is not None:
        return shown_share(data, short, fitted, effect) >= LEAST_SHARE
    return True


def driving_a(scenes: Sequence[Scene]) -> float:
    """Current below which only MOST_INSIDE of the motion is made, A: a dead zone that is wider cannot be told."""
    parts = [np.abs(s.commanded_thinned[s.moving > 0.0]) for s in scenes]
    moving = np.concatenate(parts)
    return float(np.quantile(moving, MOST_INSIDE)) if moving.size else 0.0


def shown_share(data: Data, short: Shortage, fitted: Fitted, effect: Effect) -> float:
    """Share of the squared shortage that an effect accounts for: 1 for what acts on the command, 0 or less for others.

    The delay of the measurement is free on both sides: a delay alone takes in much of a lag.
    """
    acts_s = float(fitted.physical[NAMES.index("delay_s")])
    kept = data.rows.kept
    without = float(np.min(np.sum(short.rows_nm[:, kept] ** 2, axis=1)))
    loads = [
        (np.arange(scene.stretch.samples) * scene.stretch.law_period_s,
         load_along(scene, effect.name, effect.values(scene.stretch.run)))
        for scene in consistent_scenes(data, fitted.physical, fitted.effects)
    ]  # fmt: skip
    errors = []
    for delay_s, rows_nm in zip(short.delays_s, short.rows_nm, strict=True):
        # the effect acts with the torque, the current is measured at a time of its own
        moved = [data.rows.laws.rows(np.interp(time_s - delay_s + acts_s, time_s, load)) for time_s, load in loads]
        errors.append(float(np.sum((rows_nm - np.concatenate(moved))[kept] ** 2)))
    return 1.0 - min(errors) / without if without > 0.0 else 0.0

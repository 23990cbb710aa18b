"""Where a residual lives that no single axis shows: at events that are rare, and over two axes at once.

A mean over a run hides what happens in a hundredth of it. Break-aways, reversals and jerks therefore have curves of
their own, over the travel or the time since. Pairs of axes are scored beyond what the two explain one by one.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..identification.facts import DriveFacts
from ..identification.prediction import THREADS
from ..model.effects import slots
from ..model.effects.laws.lookup import FRICTION
from .candidates import Scene
from .evidence import Evidence, Score, orthonormal, score, whiten
from .free_curves import Axis, abscissa, axes_of, grip
from .results import Channel
from .screening import Surrogates

Floats = npt.NDArray[np.float64]

LAGS_S = (0.0, 0.01, 0.02, 0.04, 0.08, 0.15)  # after an event over time: knots of its curve
TRAVELS = (0.0, 1.0, 3.0, 10.0, 30.0, 100.0)  # after an event over travel, in lengths of presliding
LONG_REST_S = 0.1
JERK_QUANTILE = 0.98
PAIR_KNOTS = 5
PAIR_WORDS = ("time", "velocity", "acceleration", "current", "travel_since_reversal", "motor_angle", "output_angle")
PAIR_MEMORY_S = 3.0


class Place(NamedTuple):
    """What is scored as one channel."""

    name: str
    columns: Floats  # (m, k) torque at the rows
    beside: Floats | None  # (m, j) what has to be explained otherwise; None: nothing
    samples: int


def places(evidence: Evidence, scenes: Sequence[Scene], facts: DriveFacts) -> list[Place]:
    """All events and pairs that the data have."""
    return [*_events(evidence, scenes), *_pairs(evidence, scenes, facts)]


def where(
    evidences: tuple[Evidence, Evidence], scenes: Sequence[Scene], facts: DriveFacts, rate: float, seed: int = 5
) -> tuple[Channel, ...]:
    """Channels of a residual before and after; significant against the largest of as many surrogates of each."""
    found = places(evidences[0], scenes, facts)
    shares, significant = [], []
    for evidence in evidences:
        with ThreadPoolExecutor(THREADS) as pool:
            scores = list(pool.map(partial(_score, evidence), found))
        surrogates = Surrogates(evidence, seed)
        for s in scores:
            surrogates.take(s)
        limit = float(np.quantile(surrogates.maxima, 1.0 - rate))
        shares.append([s.explained / max(evidence.energy, 1e-300) for s in scores])
        significant.append([surrogates.statistic(s) > limit for s in scores])
    return tuple(
        Channel(place.name, shares[0][k], shares[1][k], significant[0][k], significant[1][k], place.samples)
        for k, place in enumerate(found)
    )


def _score(evidence: Evidence, place: Place) -> Score:
    if place.beside is None:
        return score(evidence, place.columns)
    white = whiten(evidence.rows, evidence.whitening, place.beside)
    white = white - evidence.basis @ (evidence.basis.T @ white)
    more = orthonormal(white)
    left = evidence.residual - more @ (more.T @ evidence.residual)
    return score(evidence._replace(residual=left, basis=np.concatenate([evidence.basis, more], axis=1)), place.columns)


def _events(evidence: Evidence, scenes: Sequence[Scene]) -> list[Place]:
    rows = evidence.rows
    step = rows.laws.step
    size = 1.0 / scenes[0].axis.friction.stiffness_per_rev
    grips = np.concatenate([grip(s)[::step] for s in scenes])
    since = np.concatenate([_since_rest(s)[::step] for s in scenes])
    travel = np.concatenate([s.motion[::step, slots.TRAVEL_REV] for s in scenes])
    jerks = [_since_jerk(s) for s in scenes]
    lag, sign = (np.concatenate([jerk[k][::step] for jerk in jerks]) for k in (0, 1))
    lengths = size * np.array(TRAVELS)
    shapes = (
        ("break_away", _hats(since, lengths) * grips[:, None], since < lengths[-1]),
        ("reversal", _hats(np.where(since < 1e3, np.inf, travel), lengths) * grips[:, None], travel < lengths[-1]),
        ("jerk", _hats(lag, np.array(LAGS_S)) * sign[:, None], lag < LAGS_S[-1]),
    )
    return [Place(name, columns, None, int((inside & rows.kept).sum())) for name, columns, inside in shapes]


def _hats(places_: Floats, knots: Floats) -> Floats:
    """Straight lines between knots, one column a knot; nothing beyond the last. (m, k)"""
    found = np.empty((places_.size, knots.size))
    for k in range(knots.size):
        unit = np.zeros(knots.size)
        unit[k] = 1.0
        found[:, k] = np.interp(places_, knots, unit, right=0.0)
    found[places_ > knots[-1]] = 0.0
    return found


def _since_rest(scene: Scene) -> Floats:
    """Travel since a rest of some length, inf before the first. (l,)"""
    rest = scene.stretch.rest
    period_s = scene.stretch.law_period_s
    found = np.full(rest.size, np.inf)
    ends = np.flatnonzero(rest[:-1] & ~rest[1:]) + 1
    path = np.cumsum(np.abs(scene.stretch.velocity_rps)) * period_s
    for begin, end in itertools.pairwise([*ends, rest.size]):
        before = rest[max(0, begin - round(LONG_REST_S / period_s)) : begin]
        if before.all():
            found[begin:end] = path[begin:end] - path[begin]
    return found


def _since_jerk(scene: Scene) -> tuple[Floats, Floats]:
    """Time since the acceleration jumped, and which way. (l,) each"""
    period_s = scene.stretch.law_period_s
    acceleration = scene.motion[:, slots.ACCELERATION_RPS2]
    change = np.diff(acceleration, prepend=acceleration[0])
    jump = np.abs(change)
    limit = float(np.quantile(jump, JERK_QUANTILE))
    index = np.arange(jump.size)
    last = np.maximum.accumulate(np.where(jump > limit, index, -1))
    lag = np.where(last >= 0, (index - last) * period_s, np.inf)
    return lag, np.where(last >= 0, np.sign(change)[np.maximum(last, 0)], 0.0)


def _pairs(evidence: Evidence, scenes: Sequence[Scene], facts: DriveFacts) -> list[Place]:
    rows = evidence.rows
    step = rows.laws.step
    turns = float(np.ptp(rows.position_rev))
    axes: dict[str, Axis] = {}
    for axis in axes_of(facts, turns):
        if axis.word in PAIR_WORDS or (axis.word == "memory" and axis.scale == PAIR_MEMORY_S):
            axes.setdefault(axis.word, axis)
    grips = np.concatenate([grip(s)[::step] for s in scenes])
    curves = {}
    for word, axis in axes.items():
        at = np.concatenate([place[::step] for place in abscissa(scenes, axis)])
        knots = np.unique(np.quantile(at[rows.kept], np.linspace(0.01, 0.99, PAIR_KNOTS)))
        if knots.size >= 3:
            curves[word] = _hats(np.clip(at, knots[0], knots[-1]), knots)
    found = []
    for first, second in itertools.combinations(curves, 2):
        frictional = FRICTION in (axes[first].kind, axes[second].kind) and "velocity" not in (first, second)
        weight = grips if frictional else np.ones(grips.size)
        a, b = curves[first] * weight[:, None], curves[second] * weight[:, None]
        both = (a[:, :, None] * curves[second][:, None, :]).reshape(a.shape[0], -1)
        name = f"{first} x {second}"
        found.append(Place(name, both, np.concatenate([a, b], axis=1), int(rows.kept.sum())))
    return found

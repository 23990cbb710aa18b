"""Where a residual lives: over each axis, at events that are rare, and over two axes at once.

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

from ..identification.prediction import THREADS
from ..model.effects import slots
from ..model.effects.laws.lookup import UNKNOWN
from .candidates import Scene
from .curves import grip, hats
from .evidence import Evidence, Score, score
from .free_curves import free_trials
from .pairs import coarse_tables, score_beyond
from .results import Channel
from .screening import Surrogates

Floats = npt.NDArray[np.float64]

LAGS_S = (0.0, 0.01, 0.02, 0.04, 0.08, 0.15)  # after an event over time: knots of its curve
TRAVELS = (0.0, 1.0, 3.0, 10.0, 30.0, 100.0)  # after an event over travel, in lengths of presliding
LONG_REST_S = 0.1
JERK_QUANTILE = 0.98


class Place(NamedTuple):
    """What is scored as one channel."""

    name: str
    columns: Floats  # (m, k) torque at the rows
    beside: Floats | None  # (m, j) what has to be explained otherwise; None: nothing
    samples: int


class Lives(NamedTuple):
    """Channels of a residual before and after."""

    axes: tuple[Channel, ...]  # over one axis
    beyond: tuple[Channel, ...]  # what no axis shows by itself: at events, and over pairs beyond their axes


def over_axes(evidence: Evidence, scenes: Sequence[Scene]) -> list[Place]:
    """Over each axis the curve that explains most of this residual."""
    return [
        Place(trial.name.removeprefix(UNKNOWN), trial.columns.values, None, int(evidence.rows.kept.sum()))
        for trial in free_trials(evidence, scenes)
    ]


def beyond_axes(evidence: Evidence, scenes: Sequence[Scene]) -> list[Place]:
    """All events and pairs that the data have."""
    rows = evidence.rows
    pairs = [Place(c.pair.name, c.columns, c.beside, int(rows.kept.sum())) for c in coarse_tables(rows, scenes)]
    return [*_events(evidence, scenes), *pairs]


def where(evidences: tuple[Evidence, Evidence], scenes: Sequence[Scene], rate: float, seed: int = 5) -> Lives:
    """Channels of a residual before and after; significant against the largest of as many surrogates of each."""
    axes = over_axes(evidences[0], scenes)
    found = axes + beyond_axes(evidences[0], scenes)
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
    channels = tuple(
        Channel(place.name, shares[0][k], shares[1][k], significant[0][k], significant[1][k], place.samples)
        for k, place in enumerate(found)
    )
    return Lives(channels[: len(axes)], channels[len(axes) :])


def _score(evidence: Evidence, place: Place) -> Score:
    if place.beside is None:
        return score(evidence, place.columns)
    return score_beyond(evidence, place.columns, place.beside)


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
        ("break_away", hats(since, lengths, 0.0) * grips[:, None], since < lengths[-1]),
        ("reversal", hats(np.where(since < 1e3, np.inf, travel), lengths, 0.0) * grips[:, None], travel < lengths[-1]),
        ("jerk", hats(lag, np.array(LAGS_S), 0.0) * sign[:, None], lag < LAGS_S[-1]),
    )
    return [Place(name, columns, None, int((inside & rows.kept).sum())) for name, columns, inside in shapes]


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

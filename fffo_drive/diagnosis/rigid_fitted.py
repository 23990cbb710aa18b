"""A rigid axis fitted with terms: its columns, what it leaves, and means of that over an axis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..identification.facts import DriveFacts
from ..model.effects.registry import LAWS
from .rigid_data import BASE, RigidRun, decimated, effect_columns
from .rigid_search import RigidTerm, matrix_of, resampled

Floats = npt.NDArray[np.float64]

BINS = 40


class RigidFitted(NamedTuple):
    """Base and effects with their numbers."""

    terms: tuple[RigidTerm, ...]
    values: Floats  # base first, then the strengths in order
    sd: Floats

    def span(self, which: int) -> slice:
        begin = len(BASE) + sum(len(term.strengths) for term in self.terms[:which])
        return slice(begin, begin + len(self.terms[which].strengths))


def fitted_to(run: RigidRun, terms: Sequence[RigidTerm]) -> RigidFitted:
    matrix = matrix_of(run, terms)
    values: Floats = np.asarray(np.linalg.lstsq(matrix, run.force, rcond=None)[0], dtype=np.float64)
    draws = resampled(run, matrix, np.random.default_rng(3))
    return RigidFitted(tuple(terms), values, np.asarray(draws.std(axis=0)))


def columns_of(run: RigidRun, term: RigidTerm) -> Floats:
    names, columns = effect_columns(run, term.name, term.shape)
    return np.asarray(columns[:, [names.index(name) for name in term.strengths]])


def is_periodic(term: RigidTerm, facts: DriveFacts) -> bool:
    return bool(set(LAWS[term.name].per_run) & set(term.strengths)) and not facts.absolute_angle


def residual_of(run: RigidRun, fitted: RigidFitted, facts: DriveFacts, own: bool) -> Floats:
    """Force that is left (m,). `own`: the run that was fitted, whose datum periodic effects have."""
    left = run.force - run.base @ fitted.values[: len(BASE)]
    for k, term in enumerate(fitted.terms):
        if own or not is_periodic(term, facts):
            left = left - columns_of(run, term) @ fitted.values[fitted.span(k)]
    return np.asarray(left)


def abscissa_of(run: RigidRun, term: RigidTerm) -> tuple[Floats, str, str]:
    """The axis of a picture: values at the rows, label, unit."""
    if "order" in term.shape:
        return (
            np.mod(run.position * term.shape["order"], 1.0),
            f"position, periods of {1 / term.shape['order']:.4g} m",
            "",
        )
    lag = decimated(np.gradient(run.motion[:, 5], run.record.period_s)[:, None])[:, 0]
    return {
        "time": (run.time_s, "time", "s"),
        "acceleration": (run.acceleration, "acceleration", "m/s2"),
        "travel_since_reversal": (
            np.log10(np.maximum(run.travel, 1e-7)),
            "log10 of the travel since the reversal",
            "m",
        ),
        "output_angle": (run.position, "position", "m"),
        "motor_angle": (run.position, "position", "m"),
        "memory": (lag * run.axis.torque_constant_nm_per_a, "slope of the motor force", "N/s"),
        "frequency": (lag * run.axis.torque_constant_nm_per_a, "slope of the motor force", "N/s"),
    }.get(LAWS[term.name].picture, (run.velocity, "velocity", "m/s"))


def binned(x: Floats, y: Floats, edges: Floats) -> tuple[Floats, Floats]:
    """Means of y in bins of x, and the half width of their 95 % intervals (nan in empty bins)."""
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, edges.size - 2)
    count = np.bincount(place, minlength=edges.size - 1).astype(float)
    count[count == 0.0] = np.nan
    mean = np.bincount(place, y, edges.size - 1) / count
    square = np.bincount(place, y * y, edges.size - 1) / count
    return mean, 1.96 * np.sqrt(np.maximum(square - mean * mean, 0.0) / count)


def edges_of(x: Floats) -> Floats:
    """Bins with as many rows each, so that none is empty."""
    return np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)))


def explained_by(x: Floats, left: Floats, edges: Floats) -> float:
    mean, _ = binned(x, left, edges)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, edges.size - 2)
    return float(1.0 - np.sum((left - mean[place]) ** 2) / np.sum(left**2))

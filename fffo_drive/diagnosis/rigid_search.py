"""The search for effects of a rigid axis: forward, with thresholds from surrogates of the whole search, and backward.

What a refit of the base explains is projected out of residual and candidates alike. Surrogates shift the residual round
the run, half of them backwards, and turn the sign of whole pieces, one sign for all repeats of a piece: its colour, its
peaks and its repetition stay, its relation to the motion goes. The threshold is a quantile of the largest score of the
whole library over these surrogates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import optimize, stats

from ..identification.ranking import first_best, lower, ranked
from ..model.effects.law import SearchContext, Shape
from ..model.effects.registry import LAWS
from .rigid_data import RigidRun, cycle_rows, effect_columns, longest_rest_s

Floats = npt.NDArray[np.float64]

Kept = dict[tuple[str | float, ...], tuple[tuple[str, ...], Floats]]

SURROGATES = 999
FALSE_ALARMS = 0.01
LEAST_EXPLAINED = 0.03  # of the squared residual that is left: less is not worth a term
DISTINCT = 1e-3  # share of a candidate's square that the terms before it must leave
FOLDS = 6
RESAMPLES = 500
MOST_TERMS = 8
SHORTEST_DWELL_S = 0.2  # without a rest of this length nothing is said about rests
PEAKS = 6
FINE_BINS = 8  # of the shortest period
GUARD_S = 0.15  # surrogates are shifted by at least this much
ALIKE = 0.8  # collinearity from which two effects may be one
HALVES = 3.0  # a strength may differ by this factor between the halves of the run
# not of a rigid base: what needs presliding of the 2SEP model, the table, and what the base itself has
LEFT_OUT = ("lookup", "torque_offset", "asymmetric_coulomb", "voltage_limit", "backlash", "dead_zone")


@dataclass(frozen=True)
class RigidTerm:
    """One effect in the model, with its columns along the fit run."""

    name: str
    shape: Shape
    strengths: tuple[str, ...]
    columns: Floats  # (m, k)
    probability: float = 1.0  # that chance makes such a score somewhere in the library


class Rival(NamedTuple):
    """Another law in the place of a term."""

    name: str
    loss_ratio: float
    collinearity: float
    not_told_apart: bool


@dataclass
class RigidSearch:
    """What the search found, and what it looked at."""

    terms: list[RigidTerm] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)  # of each term
    explained: list[float] = field(default_factory=list)  # of what the terms before left
    kept: Kept = field(default_factory=dict)  # columns along the fit run
    rejected: list[tuple[RigidTerm, str, float]] = field(default_factory=list)  # with reason and what it would explain


def context_of(run: RigidRun, residual: Floats, gear_ratio: float | None) -> SearchContext:
    """Facts of the data over which the library lays its grids."""
    friction = run.axis.friction
    return SearchContext(
        duration_s=run.record.duration_s,
        period_s=run.record.period_s,
        lowest_rps=0.01 * float(np.abs(run.velocity).max()),
        highest_rps=float(np.abs(run.velocity).max()),
        slow_rps=float(np.quantile(np.abs(run.velocity), 0.1)),
        low_rev=float(run.position.min()),
        high_rev=float(run.position.max()),
        highest_current_a=float(np.abs(run.record.current_a).max()),
        highest_torque_nm=float(np.abs(run.force).max()),
        coulomb_nm=friction.coulomb_nm,
        static_nm=friction.static_nm,
        stiffness_per_rev=friction.stiffness_per_rev,
        attraction_nm_per_rev=friction.attraction_nm_per_rev,
        gear_ratio=gear_ratio,
        orders=_peaks(run.position, residual, 0.4 / (run.row_period_s * float(np.median(np.abs(run.velocity))))),
        frequencies_hz=_peaks(run.time_s, residual, 0.4 / run.row_period_s),
    )


def _peaks(along: Floats, residual: Floats, highest: float) -> tuple[float, ...]:
    """The strongest orders of the residual along an axis that need not be even: sums over fine bins, transformed."""
    reach = float(np.ptp(along))
    bins = math.ceil(FINE_BINS * highest * reach)
    place = np.minimum(((along - along.min()) / reach * bins).astype(np.int64), bins - 1)
    size = 1 << (4 * bins - 1).bit_length()
    power = np.abs(np.fft.rfft(np.bincount(place, residual, bins), size)) ** 2
    grid = np.arange(power.size) * bins / (reach * size)
    inner = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] > power[2:])) + 1
    inner = inner[(grid[inner] > 2.0 / reach) & (grid[inner] < highest)]
    return tuple(float(grid[k]) for k in ranked(inner.tolist(), key=lambda k: -power[k])[:PEAKS])


def candidates(run: RigidRun, context: SearchContext, kept: Kept) -> list[RigidTerm]:
    """Every law of the library with every shape of its search. `kept`: columns of earlier calls."""
    found = []
    without = {*LEFT_OUT, *(() if longest_rest_s(run) > SHORTEST_DWELL_S else ("dwell_stiction",))}
    for name, law in LAWS.items():
        if name in without:
            continue
        for shape in law.search(context):
            key: tuple[str | float, ...] = (name, *shape.values())
            if key not in kept:
                kept[key] = effect_columns(run, name, shape)
            names, columns = kept[key]
            used = np.flatnonzero(np.abs(columns).max(axis=0) > 0.0)
            if used.size and np.isfinite(columns).all():
                found.append(RigidTerm(name, shape, tuple(names[k] for k in used), columns[:, used]))
    return found


class _Scores(NamedTuple):
    gains: Floats  # of each candidate: squared residual that it takes away
    probabilities: Floats


def _orthonormal(columns: Floats) -> Floats:
    scale = np.linalg.norm(columns, axis=0)
    basis, _ = np.linalg.qr(columns / np.where(scale > 0.0, scale, 1.0))
    return np.asarray(basis)


def _screen(run: RigidRun, known: Floats, trials: Sequence[RigidTerm], generator: np.random.Generator) -> _Scores:
    """Gain of every candidate beside `known` (m, p), and the chance of such a score anywhere in the library."""
    basis = _orthonormal(known)
    residual = run.force - basis @ (basis.T @ run.force)
    parts, owner = [], []
    for number, trial in enumerate(trials):
        left = trial.columns - basis @ (basis.T @ trial.columns)
        keep = np.linalg.norm(left, axis=0) ** 2 > DISTINCT * np.linalg.norm(trial.columns, axis=0) ** 2
        if keep.any():
            parts.append(_orthonormal(left[:, keep]))
            owner += [number] * int(keep.sum())
    directions = np.concatenate(parts, axis=1)
    owners = np.array(owner)
    turned = _surrogates(run, residual, generator)
    turned -= basis @ (basis.T @ turned)
    gains: Floats = np.bincount(owners, (directions.T @ residual) ** 2, len(trials)).astype(np.float64)
    first = np.flatnonzero(np.diff(owners, prepend=-1))  # directions of one trial stand together
    chance = np.zeros((len(trials), SURROGATES))
    chance[owners[first]] = np.add.reduceat((directions.T @ turned) ** 2, first, axis=0)
    typical = chance.mean(axis=1) + 1e-12 * float(residual @ residual)
    largest = (chance / typical[:, None]).max(axis=0)
    scores = gains / typical
    above = (largest[None, :] >= scores[:, None]).sum(axis=1)
    return _Scores(gains, (1.0 + above) / (1.0 + SURROGATES))


def _surrogates(run: RigidRun, residual: Floats, generator: np.random.Generator) -> Floats:
    """The residual (m, SURROGATES) shifted round the run, half of them backwards, and whole pieces with another sign.

    A shift alone leaves what has half the period of the motion where it is, a sign alone what happens in one piece.
    """
    size = residual.size
    cycle = cycle_rows(run.velocity) or size
    guard = max(1, round(GUARD_S / run.row_period_s))
    offsets = generator.integers(guard, max(guard + 1, cycle - guard), SURROGATES)
    offsets = offsets + cycle * generator.integers(0, max(1, size // cycle), SURROGATES)
    rows = (np.arange(size)[:, None] + offsets[None, :]) % size
    backwards = generator.random(SURROGATES) < 0.5
    rows[:, backwards] = rows[::-1, backwards]
    signs = generator.choice([-1.0, 1.0], (int(run.window.max()) + 1, SURROGATES))[run.window]
    return np.asarray(signs * residual[rows])


def error_of(run: RigidRun, matrix: Floats) -> float:
    """Squared error of a least-squares fit of the force on columns (m, p)."""
    basis = _orthonormal(matrix)
    left = run.force - basis @ (basis.T @ run.force)
    return float(left @ left)


def matrix_of(run: RigidRun, terms: Sequence[RigidTerm]) -> Floats:
    """Base and effects beside each other."""
    return np.concatenate([run.base, *(term.columns for term in terms)], axis=1)


def refined(run: RigidRun, term: RigidTerm, others: Sequence[RigidTerm]) -> RigidTerm:
    """The term with its shape found between the points of the grid."""
    best = term
    for key, value in term.shape.items():
        if not value > 0.0:
            continue
        reach = 0.02 if key in ("order", "frequency_hz", "ratio") else 1.0
        found = optimize.minimize_scalar(
            lambda x, start=best, key=key: error_of(run, matrix_of(run, [*others, _moved(run, start, key, x)])),
            bounds=(-reach, reach), method="bounded", options={"maxiter": 14},
        )  # fmt: skip
        trial = _moved(run, best, key, float(found.x))
        if error_of(run, matrix_of(run, [*others, trial])) < error_of(run, matrix_of(run, [*others, best])):
            best = trial
    return best


def _moved(run: RigidRun, term: RigidTerm, key: str, log_ratio: float) -> RigidTerm:
    """The term with one of its shapes scaled."""
    shape = {**term.shape, key: term.shape[key] * float(np.exp(log_ratio))}
    names, columns = effect_columns(run, term.name, shape)
    picked = [names.index(name) for name in term.strengths]
    return RigidTerm(term.name, shape, term.strengths, columns[:, picked], term.probability)


def resampled(run: RigidRun, matrix: Floats, generator: np.random.Generator) -> Floats:
    """Coefficients (RESAMPLES, p) with whole pieces of the motion weighted at random (Rubin, 1981), repeats alike."""
    pieces = int(run.window.max()) + 1
    squares = np.zeros((pieces, matrix.shape[1], matrix.shape[1]))
    products = np.zeros((pieces, matrix.shape[1]))
    scale = np.linalg.norm(matrix, axis=0)
    scaled = matrix / scale
    for piece in range(pieces):
        rows = scaled[run.window == piece]
        squares[piece] = rows.T @ rows
        products[piece] = rows.T @ run.force[run.window == piece]
    # weights and not counts: a draw without any slow piece, or without one direction, would have no answer
    weights = pieces * generator.dirichlet(np.ones(pieces), RESAMPLES)
    count = matrix.shape[1]
    normal = (weights @ squares.reshape(pieces, -1)).reshape(-1, count, count) + 1e-9 * np.eye(count)
    solved = np.linalg.solve(normal, (weights @ products)[:, :, None])[:, :, 0]
    return np.asarray(solved / scale, dtype=np.float64)


def _objection(run: RigidRun, terms: Sequence[RigidTerm], which: int, generator: np.random.Generator) -> str:
    """What speaks against a term when everything is refitted; empty when nothing does."""
    matrix = matrix_of(run, terms)
    begin = run.base.shape[1] + sum(term.columns.shape[1] for term in terms[:which])
    own = slice(begin, begin + terms[which].columns.shape[1])
    values = np.linalg.lstsq(matrix, run.force, rcond=None)[0]
    draws = resampled(run, matrix, generator)[:, own]
    covariance = np.atleast_2d(np.cov(draws, rowvar=False))
    distance = float(values[own] @ np.linalg.pinv(covariance) @ values[own])
    if stats.chi2.sf(distance, values[own].size) > FALSE_ALARMS:
        return "its strength is not surely other than zero when whole pieces of the motion are weighted at random"
    half = run.time_s < 0.5 * (run.time_s[0] + run.time_s[-1])
    sizes = [float(np.linalg.norm(np.linalg.lstsq(matrix[p], run.force[p], rcond=None)[0][own])) for p in (half, ~half)]
    if max(sizes) > HALVES * min(sizes):
        return "its strength is not the same in both halves of the run"
    fewer = np.delete(matrix, np.arange(own.start, own.stop), axis=1)
    if left_out_error(run, matrix) >= left_out_error(run, fewer):
        return "pieces of the motion that are left out are not foretold better with it"
    return ""


def left_out_error(run: RigidRun, matrix: Floats) -> float:
    """Squared error on pieces of the motion that the fit did not see, each with all its repeats."""
    total = 0.0
    for fold in range(FOLDS):
        hidden = run.window % FOLDS == fold
        if not hidden.any() or hidden.all():
            continue
        values = np.linalg.lstsq(matrix[~hidden], run.force[~hidden], rcond=None)[0]
        total += float(np.sum((run.force[hidden] - matrix[hidden] @ values) ** 2))
    return total


def search(run: RigidRun, gear_ratio: float | None = None, seed: int = 1) -> RigidSearch:
    """Forward and backward, until no candidate is beyond chance, worth a term and without objection."""
    generator = np.random.default_rng(seed)
    found = RigidSearch()
    basis = _orthonormal(run.base)
    residual = run.force - basis @ (basis.T @ run.force)
    barred: set[str] = set()
    while len(found.terms) < MOST_TERMS:
        trials = [t for t in candidates(run, context_of(run, residual, gear_ratio), found.kept) if t.name not in barred]
        known = matrix_of(run, found.terms)
        scores = _screen(run, known, trials, generator)
        passed = np.where(scores.probabilities <= FALSE_ALARMS, scores.gains, 0.0)
        chosen = first_best(range(passed.size), key=lambda k: -passed[k])
        left = float(residual @ residual)
        if passed[chosen] <= 0.0:
            break
        term = trials[chosen]
        probability = float(scores.probabilities[chosen])
        term = refined(run, RigidTerm(term.name, term.shape, term.strengths, term.columns, probability), found.terms)
        share = 1.0 - error_of(run, matrix_of(run, [*found.terms, term])) / left
        if share < LEAST_EXPLAINED:
            found.rejected.append(
                (term, f"beyond chance, but explains only {100 * share:.1f} % of what is left", share)
            )
            break
        objection = _objection(run, [*found.terms, term], len(found.terms), generator)
        if objection:
            barred.add(term.name)
            found.rejected.append((term, objection, share))
            continue
        found.terms.append(term)
        found.explained.append(share)
        found.reasons.append(
            f"{LAWS[term.name].meaning}: explains {100 * share:.0f} % of what was left; chance over the whole library "
            f"p = {probability:.3f}; pieces that were left out are foretold better; the same in both halves of the run"
        )
        barred |= _repeated(term)
        _drop_idle(run, found, generator)
        basis = _orthonormal(matrix_of(run, found.terms))
        residual = run.force - basis @ (basis.T @ run.force)
    return found


def _repeated(term: RigidTerm) -> set[str]:
    """Laws that come once; a wave may come again with another order."""
    return set() if {"order", "ratio", "period_rev", "frequency_hz"} & set(term.shape) else {term.name}


def _drop_idle(run: RigidRun, found: RigidSearch, generator: np.random.Generator) -> None:
    """Take out earlier terms that the later ones have made idle."""
    for k in range(len(found.terms) - 2, -1, -1):
        objection = _objection(run, found.terms, k, generator)
        if objection:
            found.rejected.append((found.terms[k], f"taken out again: {objection}", found.explained[k]))
            for items in (found.terms, found.reasons, found.explained):
                del items[k]


def rivals(
    run: RigidRun, found: RigidSearch, which: int, gear_ratio: float | None = None, seed: int = 1
) -> list[Rival]:
    """The best shape of every other law in the place of a term, all else refitted; the nearest first."""
    generator = np.random.default_rng(seed)
    terms = found.terms
    others = [term for k, term in enumerate(terms) if k != which]
    basis = _orthonormal(matrix_of(run, others))
    residual = run.force - basis @ (basis.T @ run.force)
    own = _orthonormal(terms[which].columns - basis @ (basis.T @ terms[which].columns))
    errors_own = residual - own @ (own.T @ residual)
    best: dict[str, tuple[float, float, Floats]] = {}
    for trial in candidates(run, context_of(run, residual, gear_ratio), found.kept):
        if trial.name == terms[which].name:
            continue
        left = trial.columns - basis @ (basis.T @ trial.columns)
        if np.linalg.norm(left) ** 2 < DISTINCT * np.linalg.norm(trial.columns) ** 2:
            continue
        direction = _orthonormal(left)
        errors = residual - direction @ (direction.T @ residual)
        loss = float(errors @ errors)
        if trial.name not in best or lower(loss, best[trial.name][0]):
            force = own @ (own.T @ residual)
            alike = float(np.linalg.norm(direction.T @ force)) / max(float(np.linalg.norm(force)), 1e-300)
            best[trial.name] = (loss, alike, errors)
    found_rivals = []
    base = float(errors_own @ errors_own)
    for name, (loss, alike, errors) in best.items():
        pieces = np.bincount(run.window, errors**2 - errors_own**2)
        drawn = generator.choice(pieces, (RESAMPLES, pieces.size)).sum(axis=1)
        found_rivals.append(Rival(name, loss / base, alike, alike > ALIKE and bool(np.quantile(drawn, 0.05) < 0.0)))
    return ranked(found_rivals, key=lambda rival: rival.loss_ratio)

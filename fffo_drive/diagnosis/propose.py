"""Score every effect at every shape on the residual of the current model: likelihood gain and its p-value.

The base and the accepted effects are projected out of residual and columns alike (Frisch and Waugh, 1933), so that
nothing is proposed that a refit of them could explain.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..identification.criterion import DISTINCT, Folds, clipped, sandwich_p
from ..identification.facts import DriveFacts
from ..identification.ladder import HIGHEST_ORDER, SLOW_QUANTILE
from ..identification.ranking import ranked
from ..identification.threads import in_threads
from ..least_squares import spectrum, sums_by
from ..model.effects import slots
from ..model.effects.law import SearchContext, Shape
from ..model.effects.registry import LAWS, law_of
from ..units import MAD_TO_SD
from .base import NAMES
from .curves import Curve, CurvePair, coarse_tables, curves, fine_table, kind_of_curve
from .fitting import Data, Fitted, consistent_scenes
from .scenes import Columns, Effect, Factors, Scene, effect_of, strength_columns, with_datum
from .spectra import HIGHEST_ORDER as TURN_ORDER
from .spectra import frequency_peaks, order_peaks, slow_orders

LONG_WAVES = 64  # half periods of a linear travel that are tried as waves
PEAKS = 4  # lines of each spectrum that become shapes
COLLINEAR = 1e-8  # eigenvalue relative to the largest, below which columns of one candidate count as dependent
WAVE_RUNG, LAW_RUNG, TABLE_RUNG = 2, 3, 4  # waves at the machine's orders; all laws and curves; tables over two axes
SHAPES_AT_ONCE = 16  # shapes per matrix product
INSIDE_SHARE = 0.2  # largest share of the motion inside a dead zone, where the residual would explain itself


class Evidence(NamedTuple):
    """White residual with all that is refitted projected out; candidates are scored against it."""

    residual: Floats  # (q,)
    basis: Floats  # (q, b) orthonormal
    folds: Folds  # indices among the rows that count, (q,) each
    level_nm: Floats  # (q,) noise level
    negligible_nm: float  # rms torque of a negligible effect

    @property
    def energy(self) -> float:
        """Remaining sum of squares."""
        return float(self.residual @ self.residual)


class Score(NamedTuple):
    """What a candidate's columns explain."""

    explained: float  # decrease of the sum of squares
    strengths: Floats  # (k,) by least squares
    rank: int
    p: float  # p-value of this candidate alone, before correction for the search


class Proposal(NamedTuple):
    """An effect at a particular shape."""

    name: str
    kind: str  # candidates of one kind compete: the law, or the kind of curve
    rung: int
    effect: Effect
    columns: Floats  # (m, k) at the rows
    score: Score

    @property
    def without_columns(self) -> Proposal:
        """The proposal alone: the columns of all proposals take a fifth of the memory, and a refit needs none."""
        return self._replace(columns=np.zeros((0, 0)))

    @property
    def worth(self) -> float:
        """Its log-likelihood gain minus the BIC penalty of its free numbers."""
        numbers = self.score.rank + sum(not p.held for p in law_of(self.name).shapes if p.name in self.effect.shapes)
        return self.score.explained - numbers * 10.0


def evidence_of(data: Data, fitted: Fitted, known: Floats, negligible_nm: float = 0.0) -> Evidence:
    """`known` (q, b): white sensitivities of everything that is refitted. Outliers are pulled in."""
    basis = orthonormal(known)
    residual = clipped(fitted.white)
    residual = residual - basis @ (basis.T @ residual)
    return Evidence(residual, basis, data.folds, 1.0 / data.weight[data.used], negligible_nm)


def orthonormal(columns: Floats, tolerance: float = 1e-9) -> Floats:
    """Orthonormal basis of the columns (q, k), without (nearly) dependent ones. (q, <=k)"""
    return np.asarray(columns @ spectrum(columns.T @ columns).basis(tolerance))


class _Solved(NamedTuple):
    """Least squares of the residual on columns, both with the refitted part projected out."""

    explained: float
    strengths: Floats  # (k,)
    turn: Floats  # (k, rank) maps columns to orthonormal ones

    def score(self, p: float = 1.0) -> Score:
        """Score with this p-value."""
        return Score(self.explained, self.strengths, self.turn.shape[1], p)


def _solved(squares: Floats, gram: Floats, product: Floats) -> _Solved:
    """`squares` (k,) of the original columns; `gram` (k, k) and `product` (k,) with the residual, after projection."""
    left = np.diag(gram)
    use = (left > DISTINCT * squares) & (left > 0.0)
    turn = spectrum(np.where(np.outer(use, use), gram, 0.0)).basis(COLLINEAR)
    total = product @ turn
    return _Solved(float(total @ total), turn @ total, turn)


def score(evidence: Evidence, white: Floats, load: Floats | None = None) -> Score:
    """Score white columns (q, k). `load` (q,): the effect's own torque, where the residual already excludes it."""
    shared, square = evidence.basis.T @ white, white.T @ white
    found = _solved(np.diag(square), square - shared.T @ shared, evidence.residual @ white)
    if not found.turn.shape[1]:
        return found.score()
    axes = white @ found.turn - evidence.basis @ (shared @ found.turn)
    residual = evidence.residual
    left = residual - axes @ (axes.T @ residual)
    whole = residual if load is None else left + load
    window = evidence.folds.window
    with_it, beside_it, squares = (sums_by(window, values * axes) for values in (whole[:, None], left[:, None], axes))
    own_nm = evidence.level_nm * (axes @ (axes.T @ whole))
    negligible = evidence.negligible_nm**2 / max(float(np.mean(own_nm**2)), 1e-300)
    return found.score(sandwich_p(with_it, beside_it, squares.sum(axis=1), negligible))


def scores(evidence: Evidence, white: Floats, sizes: Sequence[int]) -> list[Score]:
    """Scores without p-values of candidates whose white columns (q, sum of sizes) are concatenated."""
    shared, whole = evidence.basis.T @ white, white.T @ white
    gram, product = whole - shared.T @ shared, evidence.residual @ white
    ends = np.cumsum(sizes)
    own = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
    return [_solved(np.diag(whole)[k], gram[k, k], product[k]).score() for k in own]


def quick_score(evidence: Evidence, white: Floats) -> Score:
    """`score` of one candidate without a p-value."""
    return scores(evidence, white, [white.shape[1]])[0]


def beside(evidence: Evidence, white: Floats) -> Evidence:
    """The evidence with white columns (q, j) projected out as well."""
    more = orthonormal(white - evidence.basis @ (evidence.basis.T @ white))
    left = evidence.residual - more @ (more.T @ evidence.residual)
    return evidence._replace(residual=left, basis=np.concatenate([evidence.basis, more], axis=1))


class Search:
    """All candidates of one data set, round by round; what does not depend on the model is computed once."""

    def __init__(self, facts: DriveFacts, without: frozenset[str], ablate: frozenset[str]) -> None:
        self.facts, self.without, self.ablate = facts, without, ablate
        self.tried = 0  # candidates so far, over all rounds
        self._kept: dict[tuple[str | float, ...], Columns] = {}

    def proposals(
        self, data: Data, fitted: Fitted, evidence: Evidence, rung: int, names: frozenset[str] | None = None
    ) -> list[Proposal]:
        """The best shape of every law up to a rung, and all curves, or those of `names`; on the last rung tables."""
        scenes = consistent_scenes(data, fitted.physical, fitted.effects)
        if rung == TABLE_RUNG:
            chosen = self._tables(data, evidence, scenes)
        else:
            chosen = self._laws(data, fitted, evidence, scenes, rung)
            chosen += self._curves(data, evidence, scenes, names) if rung == LAW_RUNG else []
        # only the best candidate needs a p-value
        return [found._replace(score=score(evidence, data.white(found.columns))) for found in chosen]

    def _laws(
        self, data: Data, fitted: Fitted, evidence: Evidence, scenes: Sequence[Scene], rung: int
    ) -> list[Proposal]:
        """The best shape of every law up to a rung."""
        work = list(self._shapes(search_context(data, fitted, scenes, self.facts), rung))
        parts = [work[k : k + SHAPES_AT_ONCE] for k in range(0, len(work), SHAPES_AT_ONCE)]
        best: dict[str, Proposal] = {}
        factors: Factors = {}
        scored = in_threads(lambda part: self._scored(data, evidence, scenes, factors, part), parts)
        for found in itertools.chain.from_iterable(scored):
            if found.score.rank and (found.kind not in best or found.worth > best[found.kind].worth):
                best[found.kind] = found
        self.tried += len(work)
        return [more for found in best.values() for more in self._with_datum(data, evidence, found)]

    def _shapes(self, context: SearchContext, rung: int) -> Iterator[tuple[str, Shape]]:
        """Laws up to a rung, and their shapes."""
        for name, law in LAWS.items():
            if name in self.without or law.in_base or law.name == "lookup" or law.rung > rung:
                continue
            if law.rotary and self.facts.units != "rotary":
                continue
            yield from ((name, shape) for shape in law.search(context))

    def _scored(
        self, data: Data, evidence: Evidence, scenes: Sequence[Scene], factors: Factors,
        part: Sequence[tuple[str, Shape]],
    ) -> list[Proposal]:  # fmt: skip
        columns = [self._columns(data, scenes, factors, name, shape) for name, shape in part]
        white = data.white(np.concatenate([one.values for one in columns], axis=1))
        found = scores(evidence, white, [len(one.names) for one in columns])
        return [
            proposal(data, name, name, shape, one, own)
            for (name, shape), one, own in zip(part, columns, found, strict=True)
        ]

    def _columns(self, data: Data, scenes: Sequence[Scene], factors: Factors, name: str, shape: Shape) -> Columns:
        key: tuple[str | float, ...] = (name, *shape.values())
        columns = self._kept.get(key)
        if columns is None:
            columns = strength_columns(data.rows, scenes, name, shape, factors)
            if law_of(name).acts_on == "motion" and not law_of(name).wave:
                # each refit computes them again: for a proposal those of the first model suffice
                self._kept[key] = columns._replace(values=columns.values.astype(np.float32))
        return columns

    def _with_datum(self, data: Data, evidence: Evidence, found: Proposal) -> list[Proposal]:
        """A wave with one datum for all runs, and one with a datum per run; of a single run the latter alone."""
        per_run = set(law_of(found.name).per_run) & set(found.effect.strengths)
        if self.facts.absolute_angle or "datum" in self.ablate or not per_run:
            return [found]
        one = Columns(tuple(found.effect.strengths), (-1,) * len(found.effect.strengths), found.columns)
        columns = with_datum(one, found.name, data.rows)
        scored = quick_score(evidence, data.white(columns.values))
        own = proposal(data, found.name, found.kind, dict(found.effect.shapes), columns, scored)
        return [found, own] if data.runs > 1 else [own]

    def _curves(
        self, data: Data, evidence: Evidence, scenes: Sequence[Scene], names: frozenset[str] | None
    ) -> list[Proposal]:
        """All curves over one axis, or those of `names`."""
        if names is not None and not names:
            return []
        wanted = (
            one for one in curves(data.rows, scenes) if self._wanted(one) and (names is None or one.name in names)
        )
        found = list(in_threads(lambda curve: self._of_curve(data, evidence, curve), wanted))
        self.tried += len(found)
        return [one for one in found if one.score.rank]

    def _tables(self, data: Data, evidence: Evidence, scenes: Sequence[Scene]) -> list[Proposal]:
        """Fine tables over the pairs whose coarse tables explain most beyond the two single-axis curves."""
        coarse = filter(self._wanted, coarse_tables(data.rows, scenes))
        pairs = list(in_threads(lambda one: _beyond(data, evidence, one), coarse))
        best = [pair for pair, _ in ranked(pairs, key=lambda item: -item[1])[:TABLES]]

        def proposed(pair: CurvePair) -> Proposal | None:
            fine = fine_table(data.rows, scenes, pair)
            return None if fine is None else self._of_curve(data, evidence, fine)

        found = filter(None, in_threads(proposed, best))
        self.tried += len(pairs)
        return [one for one in found if one.score.rank]

    def _wanted(self, curve: Curve) -> bool:
        return "curves" not in self.ablate and not {curve.name, kind_of_curve(curve)} & self.without

    def _of_curve(self, data: Data, evidence: Evidence, curve: Curve) -> Proposal:
        names = tuple(f"y{k:02d}" for k in range(curve.columns.shape[1]))
        columns = Columns(names, (-1,) * len(names), curve.columns)
        scored = quick_score(evidence, data.white(columns.values))
        return proposal(data, curve.name, kind_of_curve(curve), curve.shapes, columns, scored)


def _beyond(data: Data, evidence: Evidence, curve: Curve) -> tuple[CurvePair, float]:
    """The axis curves of a coarse table, and what it explains beyond them."""
    assert curve.beside is not None
    assert curve.pair is not None
    return curve.pair, quick_score(beside(evidence, data.white(curve.beside)), data.white(curve.columns)).explained


TABLES = 3  # pairs of axes that get a fine table


def proposal(data: Data, name: str, kind: str, shape: Shape, columns: Columns, scored: Score) -> Proposal:
    """An effect at a shape, with its best strengths."""
    effect = effect_of(name, shape, columns, scored.strengths, data.runs)
    return Proposal(name, kind, law_of(name).rung, effect, columns.values.astype(np.float32), scored)


def machine_orders(facts: DriveFacts) -> set[float]:
    """Orders that the machine's design gives: turn, pole pairs, slots and gear."""
    orders = {1.0, 2.0, 3.0}
    if facts.pole_pairs is not None:
        orders |= {float(facts.pole_pairs * k) for k in (1, 2, 6, 12)}
    if facts.slots is not None:
        orders |= {float(facts.slots), 2.0 * facts.slots}
        if facts.pole_pairs is not None:
            orders.add(float(np.lcm(facts.slots, 2 * facts.pole_pairs)))
    return orders


def search_context(data: Data, fitted: Fitted, scenes: Sequence[Scene], facts: DriveFacts) -> SearchContext:
    """Limits for the grids, from the data, with the orders and frequencies that stand out."""
    rows, residual_nm = data.rows, np.clip(fitted.residual_nm, *_limits(data, fitted))
    value = {name: float(fitted.physical[k]) for k, name in enumerate(NAMES)}
    speed = np.abs(rows.velocity_rps[rows.kept])
    kt = facts.torque_constant_nm_per_a
    torque_nm = np.concatenate([rows.laws.rows(kt * s.motion[:, slots.CURRENT_A]) for s in scenes])
    sign = np.tanh(rows.velocity_rps / max(0.02 * float(np.quantile(speed, 0.95)), 1e-12))
    scaled = torque_nm / max(float(np.sqrt(np.mean(torque_nm**2))), 1e-12)
    slow_rps = float(np.quantile(speed, SLOW_QUANTILE))
    highest = rows.filter.cutoff_hz / max(slow_rps, 1e-9)
    rotary = facts.units == "rotary"
    scanned = (TURN_ORDER if rotary else highest,)
    orders = {
        p.place for values in (1.0, sign, scaled) for p in order_peaks(rows, residual_nm * values, PEAKS, *scanned)
    }
    if not rotary:  # its period is unknown: half periods of the travel
        orders |= {0.5 * k / rows.turns for k in range(4, LONG_WAVES)}
    if rotary:  # rotary axis: every whole order is tried
        orders |= {float(k) for k in range(1, int(min(HIGHEST_ORDER, highest)) + 1)}
        orders |= {k for k in machine_orders(facts) if k <= highest}
    driving = np.concatenate([np.abs(s.commanded_thinned[s.moving > 0.0]) for s in scenes])
    longest = max(end - begin for begin, end in rows.bounds) * rows.filter.row_period_s
    return SearchContext(
        duration_s=float(np.ptp(rows.time_s)) if facts.units == "rotary" else longest,
        period_s=rows.filter.period_s,
        lowest_rps=float(np.quantile(speed, 0.02)),
        highest_rps=float(np.quantile(speed, 0.999)),
        low_rev=float(rows.position_rev.min()),
        high_rev=float(rows.position_rev.max()),
        highest_current_a=float(np.quantile(np.abs(torque_nm), 0.9999)) / kt,
        highest_torque_nm=float(np.quantile(np.abs(torque_nm), 0.9999)),
        driving_a=float(np.quantile(driving, INSIDE_SHARE)) if driving.size else 0.0,
        coulomb_nm=value["coulomb_nm"],
        static_nm=value["static_nm"],
        stiffness_per_rev=value["stiffness_per_rev"],
        attraction_nm_per_rev=value["attraction_nm_per_rev"],
        gear_ratio=facts.gear_ratio,
        pole_pairs=facts.pole_pairs,
        slots=facts.slots,
        slow_rps=slow_rps,
        orders=tuple(sorted(orders)),
        slow_orders=slow_orders(rows, residual_nm),
        slow_level_orders=slow_orders(rows, residual_nm * sign),
        frequencies_hz=tuple(p.place for p in frequency_peaks(rows, residual_nm, PEAKS)),
        first_s=float(rows.time_s.min()),
    )


def _limits(data: Data, fitted: Fitted) -> tuple[float, float]:
    level = MAD_TO_SD * float(np.median(np.abs(fitted.residual_nm[data.used])))
    return -6.0 * level, 6.0 * level

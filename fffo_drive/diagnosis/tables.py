"""What is tried last, against what was selected: tables over two axes, and a response over frequency.

A table is tried in the place of everything, of one effect, or beside all; a response, which can stand in for any joint
or lag, beside all.
A law that fits half of an interaction takes the place of what is in no list, and the next one fills what it leaves.
What is tried here has to explain more than the laws that it replaces, by the margin of any free curve, to be worth its
many numbers, to carry over to other runs, and to be beyond chance. Where a free curve was needed beside a law, the law
is not what it was taken for: no margin protects them then, and a single curve is tried in the place of both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np

from ..identification.prediction import THREADS
from ..identification.ranking import first_best, lower, ranked
from ..model.effects.law import Law
from ..model.effects.laws.lookup import UNKNOWN
from ..model.effects.registry import law_of
from .candidates import Scene
from .evidence import Evidence, score
from .fitting import Fitted, best_gain, cost, polished, refit
from .free_curves import FREQUENCY, response_trial
from .pairs import Coarse, coarse_tables, score_beyond, table_trial
from .removal import MATERIAL_SHARE
from .screening import Surrogates, Trial, comparable, false_alarm_probability
from .selection import (
    CURVE_MARGIN,
    Contest,
    Selection,
    beside,
    evidence_of,
    renewed,
    replace_effect,
    within_reason,
    worth_it,
)
from .transfer import transfer

LEAST_CARRIED = 0.7  # of the gain on a run that has to be there when the run is left out: more than of a law
COARSE_SHARE = 0.7  # of what the replaced effects explain, that a coarse table has to
TOGETHER = 0.1  # of what a pair explains, that its axes do not explain one by one
FINE_TABLES = 8  # pairs that get a fine table ...
REFITTED = 2  # ... and of those, that are refitted


class Offer(NamedTuple):
    """A selection with a table in it."""

    kept: tuple[int, ...]  # of the selected effects
    trial: Trial
    without: Fitted  # with the kept effects alone
    fitted: Fitted
    replaced_gain: float  # of the effects whose place it takes
    margin: float  # share of its gain that they may not reach
    probability: float

    @property
    def gain(self) -> float:
        """What the table explains beside the kept effects."""
        return best_gain(self.without, self.fitted)


def with_table(selected: Selection, rate: float, told: Callable[[float], None]) -> Selection:
    """The selection, or the same with a table over two axes where that is what it lacked."""
    data, matrix, fitted = selected.data, selected.sensitivities, selected.fitted
    everything = tuple(range(len(fitted.effects)))
    ways = {(), everything, *(tuple(k for k in everything if k != out) for out in everything)}
    tables = coarse_tables(data.rows, evidence_of(data, matrix, selected.base)[1])
    fewest_laws_first = sorted(ways, key=lambda way: (len(way), way))
    for number, kept in enumerate(fewest_laws_first):
        told(number / len(ways))
        offers = list(_offers(selected, kept, tables, rate))
        if offers:
            return _accepted(selected, first_best(offers, key=lambda offer: cost(offer.fitted, data)))
    return selected


def _offers(selected: Selection, kept: tuple[int, ...], tables: Sequence[Coarse], rate: float) -> Iterator[Offer]:
    """Tables beside the kept effects that are better than what was selected."""
    data, matrix, fitted = selected.data, selected.sensitivities, selected.fitted
    others = [fitted.effects[k] for k in kept]
    adding = len(others) == len(fitted.effects)
    if adding:
        without = fitted
    else:
        without = refit(data, matrix, fitted.physical, others, iterations=3) if others else selected.base
    replaced_gain = best_gain(without, fitted)
    replaced = [e.name for k, e in enumerate(fitted.effects) if k not in kept]
    mixed = len(replaced) > 1 and any(name.startswith(UNKNOWN) for name in replaced)
    margin = 1.0 if mixed else CURVE_MARGIN
    evidence, scenes = evidence_of(data, matrix, without)
    trials = _promising(evidence, scenes, tables, replaced_gain / margin, rate)
    if mixed and not others:
        trials += [t for t in selected.curves[:REFITTED] if t.name != FREQUENCY]
    respond = adding and not any(over_frequency(law_of(e.name)) for e in others)
    response = response_trial(evidence, scenes) if respond else None
    if response is not None and response.explained >= MATERIAL_SHARE * evidence.energy:
        trials.append(response)
    trials = [trial for trial in trials if trial.name not in {e.name for e in others}]
    with ThreadPoolExecutor(THREADS) as pool:
        results = list(pool.map(partial(beside, data, matrix, without), trials))
    for trial, result in zip(trials, results, strict=True):
        offer = Offer(kept, trial, without, result, replaced_gain, margin, 1.0)
        if replaced_gain >= margin * offer.gain or not _worth_it(selected, offer):
            continue
        better = polished(data, result, rounds=2)
        offer = offer._replace(trial=replace_effect(trial, better.effects[-1]), fitted=better)
        if not lower(cost(better, data), cost(fitted, data)):
            continue
        if not transfer(data, matrix, better, without).carries(LEAST_CARRIED):
            continue
        offer = offer._replace(probability=_probability(selected, offer, tables))
        if offer.probability <= rate:
            yield offer


def over_frequency(law: Law) -> bool:
    """Whether a law is a joint, a delay or a lookalike of one.

    What it leaves over is no response of its own: where the motion dies out, the noise of its acceleration would be
    taken for one.
    """
    return law.joint or any(law_of(name).in_base for name in (law.name, *law.lookalikes))


def _worth_it(selected: Selection, offer: Offer) -> bool:
    data, result = selected.data, offer.fitted
    if not within_reason(data, result, len(result.effects) - 1):
        return False
    return worth_it(data, selected.sensitivities, offer.without, result, _contest(selected, offer))


def _promising(
    evidence: Evidence, scenes: Sequence[Scene], tables: Sequence[Coarse], wanted: float, rate: float
) -> list[Trial]:
    """The pairs that explain most, of those that explain something together that they do not one by one.

    Beside what was selected that has to be beyond chance; in its place the rest has, and the margin is what counts.
    """
    with ThreadPoolExecutor(THREADS) as pool:
        whole = list(pool.map(lambda c: score(evidence, c.columns), tables))
        beyond = list(pool.map(lambda c: score_beyond(evidence, c.columns, c.beside), tables))
        surrogates = Surrogates(evidence, seed=7)
        for one in beyond:
            surrogates.take(one)
        limit = float(np.quantile(surrogates.maxima, 1.0 - rate)) if tables and not wanted else 0.0
        able = [
            k
            for k, one in enumerate(beyond)
            if surrogates.statistic(one) > limit
            and one.explained >= TOGETHER * whole[k].explained
            and whole[k].explained >= COARSE_SHARE * wanted
        ]
        able = ranked(able, key=lambda k: -whole[k].explained)[:FINE_TABLES]
        trials = list(pool.map(lambda k: table_trial(evidence, scenes, tables[k].pair), able))
    least = max(wanted, MATERIAL_SHARE * evidence.energy)
    found = [trial for trial in trials if trial is not None and trial.explained >= least]
    return ranked(found, key=lambda trial: -trial.explained)[:REFITTED]


def _probability(selected: Selection, offer: Offer, tables: Sequence[Coarse]) -> float:
    """That noise alone, of what is left, would do as well in a search over all pairs."""
    evidence, _ = evidence_of(selected.data, selected.sensitivities, offer.fitted)
    surrogates = Surrogates(evidence, seed=11)
    with ThreadPoolExecutor(THREADS) as pool:
        for one in pool.map(partial(score, evidence), [c.columns for c in tables]):
            surrogates.take(one)
    statistic = comparable(np.array([offer.gain / offer.fitted.loss]), offer.trial.rank)
    return false_alarm_probability(float(statistic[0]), np.sort(surrogates.maxima))


def _contest(selected: Selection, offer: Offer) -> Contest:
    """The table against what it replaces."""
    name = offer.trial.name
    out = [k for k in range(len(selected.contests)) if k not in offer.kept]
    gains = {selected.contests[k].chosen: offer.replaced_gain for k in out}
    return Contest(name, {**gains, name: offer.gain}, {name: offer.trial})


def _accepted(selected: Selection, offer: Offer) -> Selection:
    data, base, fitted, matrix = renewed(selected.data, selected.base, offer.fitted)
    return selected._replace(
        data=data, base=base, fitted=fitted, sensitivities=matrix,
        contests=(*(selected.contests[k] for k in offer.kept), _contest(selected, offer)),
        probabilities=(*(selected.probabilities[k] for k in offer.kept), offer.probability),
        left=None,
    )  # fmt: skip

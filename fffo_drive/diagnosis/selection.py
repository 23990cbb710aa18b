"""Which effects: forward one at a time, every rival refitted with all parameters before one is chosen, then backward.

A regressor that explains most in the search need not be right: a base that was fitted without the effect is bent, and
several laws look alike until the base is free again. Rivals are therefore refitted first and compared after. What is
chosen has to be significant over the whole search (by surrogates of the residual that is left after it), material, and
worth its parameters; an earlier choice is tried against its rivals again once the later ones are there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..identification.facts import DriveFacts
from ..identification.prediction import THREADS
from ..identification.ranking import first_best, lower, ranked
from ..model.effects.laws.lookup import UNKNOWN
from ..model.effects.registry import axis_of_effect, law_of
from .candidates import Effect, Scene
from .current_side import believed, shortage
from .evidence import Evidence, make_evidence
from .fitting import (
    Data,
    Fitted,
    at_rest,
    best_gain,
    consistent_scenes,
    cost,
    effect_jacobian,
    evaluate,
    from_start,
    loaded_sensitivities,
    loads_of,
    polished,
    raw_share,
    refit,
    slots_of,
)
from .free_curves import FREQUENCY, free_trials
from .removal import MATERIAL_SHARE, backward
from .screening import Screening, Trial, comparable, false_alarm_probability, penalised, screen, search_context
from .startup import noise_model
from .transfer import of_one_size

Floats = npt.NDArray[np.float64]

MOST_EFFECTS = 3
CONTENDERS = 6
LEAST_SHARE = 0.1  # of what the best trial explains, for a rival to be refitted
MATERIAL_PERCENT = 1.5  # rms of the torque of an effect over that of friction, where it acts
FAMILY_SHARE = 0.85  # of the gain of the chosen one, for a rival to be of its family
LATER_SHARE = 0.15  # of the rms of an earlier effect, base projected out, for a later one ...
SAME_AXIS_SHARE = 0.3  # ... and of an earlier one on the same axis
MOST_PERCENT = 150.0  # rms of an effect over that of friction: beyond, it is no effect beside a base
LEAST_PERCENT = 0.5  # rms of an effect over that of friction, base projected out
RENEWALS = 8
MUCH_PROMISED = 0.2  # of the residual: a trial that promises so much ...
KEPT_PROMISE = 0.75  # ... and keeps less than this share of it once the base is free, is fitted from the base's start
POLISHED = 3  # rivals whose fit is carried on ...
UNSETTLED = 6.0  # ... where they are within this ratio of the best
RIVAL_SHARE = 0.25  # of the gain of the chosen one, for a rival to be tried again
SETTLED = 0.003  # relative fall of the loss at which a model is not refitted again
CURVE_SHARE = 0.5  # of what the best law explains, for a free curve to be refitted
CURVE_MARGIN = 0.8  # a law that explains this share of what a free curve explains is preferred to it


@dataclass(frozen=True)
class Contest:
    """One round: the chosen effect and those that were refitted in its place."""

    chosen: str
    gains: dict[str, float]  # fall of the white loss times rows, by name, all parameters refitted
    trials: dict[str, Trial]


class Selection(NamedTuple):
    """What was selected, and on what grounds."""

    data: Data
    base: Fitted  # without effects, at the final noise model
    fitted: Fitted  # with them
    sensitivities: Floats
    contests: tuple[Contest, ...]  # one an effect, in the order of `fitted.effects`
    probabilities: tuple[float, ...]  # false alarm, over the whole search
    screenings: tuple[Screening, ...]
    curves: tuple[Trial, ...]  # free curves of the first round, beside the base alone
    left: tuple[str, float, float] | None  # significant and material, but refused: name, share, probability


class Search(NamedTuple):
    """What does not change from round to round."""

    facts: DriveFacts
    false_alarm_rate: float
    told: Callable[[float, str], None]


def known_columns(data: Data, matrix: Floats, fitted: Fitted, scenes: Sequence[Scene]) -> Floats:
    """Sensitivities of everything that is refitted anyway: base, and numbers of the accepted effects."""
    if not fitted.effects:
        return matrix
    slots = slots_of(fitted.effects, True, float(np.ptp(data.rows.position_rev)))
    return np.concatenate([matrix, effect_jacobian(data, fitted.effects, slots, scenes)], axis=1)


def evidence_of(data: Data, matrix: Floats, fitted: Fitted) -> tuple[Evidence, list[Scene]]:
    """What is left to explain beside a fitted model."""
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    known = known_columns(data, matrix, fitted, scenes)
    return make_evidence(data.rows, data.whitening, fitted.residual_nm, known), scenes


def select(data: Data, base: Fitted, matrix: Floats, search: Search) -> Selection:
    """Add effects until nothing significant and material is left, then remove and exchange."""
    fitted = base
    contests: list[Contest] = []
    probabilities: list[float] = []
    screenings: list[Screening] = []
    curves: tuple[Trial, ...] = ()
    left: tuple[str, float, float] | None = None
    pending: tuple[float, int] | None = None
    span = 0.9 / (MOST_EFFECTS + 1)
    for number in range(MOST_EFFECTS + 1):
        evidence, scenes = evidence_of(data, matrix, fitted)
        context = search_context(data.rows, scenes, fitted.physical, fitted.residual_nm, search.facts)
        begin = number * span
        screening = screen(
            evidence, scenes, context, search.facts.absolute_angle, search.false_alarm_rate,
            told=partial(_part_told, search, begin, 0.6 * span),
        )  # fmt: skip
        screenings.append(screening)
        if pending is not None:
            # noise of what is left after the last one was taken out: the surrogates of its own significance
            probabilities.append(false_alarm_probability(pending[0], screening.surrogate_maxima))
        if number == MOST_EFFECTS or not screening.trials:
            break
        search.told(begin + 0.6 * span, "refit")
        free = free_trials(evidence, scenes)
        curves = curves or tuple(free)
        contest, best = contend(data, matrix, fitted, evidence, screening, free)
        if best is None or not worth_it(data, matrix, fitted, best, contest):
            if best is not None:
                left = _left(data, fitted, best, contest, screening, evidence)
            break
        gain = best_gain(fitted, best)
        rank = contest.trials[contest.chosen].rank
        variance = best.loss
        pending = (float(comparable(np.array([gain / variance]), rank)[0]), rank)
        contests.append(contest)
        fitted = best
        data, base, fitted, matrix = renewed(data, base, fitted)
        if len(contests) > 1:
            fitted, contests = exchange(data, matrix, fitted, contests)
    fitted, stay = backward(data, matrix, fitted, probabilities, search.false_alarm_rate)
    contests, probabilities = [contests[k] for k in stay], [probabilities[k] for k in stay]
    return Selection(data, base, fitted, matrix, tuple(contests), tuple(probabilities), tuple(screenings), curves, left)


def _part_told(search: Search, begin: float, span: float, share: float) -> None:
    search.told(begin + span * share, "search")


def contend(
    data: Data, matrix: Floats, fitted: Fitted, evidence: Evidence, screening: Screening, free: Sequence[Trial]
) -> tuple[Contest, Fitted | None]:
    """Refit every rival beside what is accepted; the cheapest is chosen.

    A free curve is chosen only where it explains what no law of the library explains, by a margin. A response over
    frequency takes no part: it can stand in for any joint or lag, and is tried last.
    """
    taken = {e.name for e in fitted.effects}
    trials = [t for t in screening.trials if t.name not in taken or law_of(t.name).per_run]  # waves may be several
    if not trials:
        return Contest("", {}, {}), None
    top = max(penalised(t, evidence) for t in trials)
    picked = [t for t in trials if penalised(t, evidence) >= LEAST_SHARE * top][:CONTENDERS]
    alike = {name for t in picked[:1] for name in law_of(t.name).lookalikes}
    picked += [t for t in trials if t.name in alike and t not in picked and t.explained > 0.02 * top][:3]

    laws = len(picked)
    curves = [t for t in free if t.name not in taken and t.name != FREQUENCY]
    picked += [t for t in curves if t.explained >= CURVE_SHARE * top][:2]

    one = partial(beside, data, matrix, fitted)
    with ThreadPoolExecutor(THREADS) as pool:
        results = list(pool.map(one, picked))
    if not results:
        return Contest("", {}, {}), None
    losses = [r.loss if within_reason(data, r, len(r.effects) - 1) else np.inf for r in results]
    by_loss = ranked(range(len(losses)), key=losses.__getitem__)
    first = [k for k in by_loss if losses[k] < UNSETTLED * min(losses)][:POLISHED]
    with ThreadPoolExecutor(THREADS) as pool:
        for k, result in zip(first, pool.map(lambda k: polished(data, results[k]), first), strict=True):
            results[k] = result
    equal = [of_one_size(data, r, len(r.effects) - 1) for r in results]
    gains = {t.name: best_gain(fitted, r) for t, r in zip(picked, equal, strict=True)}
    costs = [cost(r, data) for r in equal]
    short = shortage(data) if any(law_of(t.name).shown_by_current for t in picked) else None
    for k, result in enumerate(results):
        if within_reason(data, result, len(result.effects) - 1) and believed(data, short, result):
            continue
        costs[k] = np.inf
        gains[picked[k].name] = 0.0
    if not np.isfinite(min(costs)):
        return Contest("", gains, {}), None
    order = first_best(range(laws), key=costs.__getitem__) if laws else 0
    if len(picked) > laws:
        curve = first_best(range(laws, len(picked)), key=costs.__getitem__)
        own = gains[picked[order].name] if laws else 0.0
        if lower(costs[curve], costs[order]) and own < CURVE_MARGIN * gains[picked[curve].name]:
            order = curve
    found = {t.name: replace_effect(t, r.effects[-1]) for t, r in zip(picked, results, strict=True)}
    return Contest(picked[order].name, gains, found), results[order]


def beside(data: Data, matrix: Floats, fitted: Fitted, trial: Trial) -> Fitted:
    """A trial refitted beside what is accepted.

    Its strengths were found with the base projected out. Where law and base look alike they stand against a change of
    the base that was never made, and the fit begins far out: then it begins with nothing of the law. Where the base has
    bent to take in much of what the law explains, and does not give it back, the fit begins where that of the base did.
    """
    found = refit(data, matrix, fitted.physical, [*fitted.effects, trial.effect], iterations=3)
    if found.loss > fitted.loss:
        nothing = {name: np.zeros_like(values) for name, values in trial.effect.strengths.items()}
        effects = [*fitted.effects, replace(trial.effect, strengths=nothing)]
        found = refit(data, matrix, fitted.physical, effects, iterations=4)
    promised = trial.explained / max(float(fitted.white @ fitted.white), 1e-300)
    if promised < MUCH_PROMISED or 1.0 - found.loss / fitted.loss > KEPT_PROMISE * promised:
        return found
    again = from_start(data, [*fitted.effects, trial.effect])
    return again if lower(again.loss, found.loss) else found


def replace_effect(trial: Trial, effect: Effect) -> Trial:
    """The trial with its refitted numbers."""
    return trial._replace(effect=effect, shapes=dict(effect.shapes))


def effect_rms(data: Data, fitted: Fitted, number: int, matrix: Floats | None = None) -> tuple[float, float]:
    """Rms torque of one effect over the rms friction torque, in percent: over all kept rows, and where it acts."""
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    loads = loads_of(scenes, [fitted.effects[number]])
    load = np.concatenate([data.rows.laws.rows(x) for x in loads])
    friction = np.concatenate([data.rows.laws.rows(s.motion[:, 6]) for s in scenes])
    kept = data.rows.kept
    if matrix is not None:
        coefficients, *_ = np.linalg.lstsq(matrix[kept], load[kept], rcond=None)
        load = load - matrix @ coefficients
    scale = max(float(np.sqrt(np.mean(friction[kept] ** 2))), 1e-300)
    acting = acting_rows(load, kept)
    whole = float(np.sqrt(np.mean(load[kept] ** 2)))
    there = float(np.sqrt(np.mean(load[acting] ** 2))) if acting.any() else 0.0
    return 100.0 * whole / scale, 100.0 * there / scale


def acting_rows(load_nm: Floats, kept: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Rows at which an effect acts: where its torque is a quarter and more of nearly the largest. (m,)"""
    if not kept.any():
        return kept
    high = float(np.quantile(np.abs(load_nm[kept]), 0.995))
    return np.asarray(kept & (np.abs(load_nm) >= 0.25 * high)) if high > 0.0 else np.zeros_like(kept)


def within_reason(data: Data, fitted: Fitted, number: int) -> bool:
    """False for a torque so large that it only stands against the base's: a fit that ran away along a valley."""
    with np.errstate(over="ignore", invalid="ignore"):
        whole, _ = effect_rms(data, fitted, number)
    return bool(np.isfinite(whole)) and whole <= MOST_PERCENT


def worth_it(data: Data, matrix: Floats, before: Fitted, after: Fitted, contest: Contest) -> bool:
    """Large enough to matter, in the residual and in torque, and beside what was found before.

    No law has quite the form of what it describes: what it leaves over looks like a small effect of the same axis.
    """
    share = max(1.0 - after.loss / before.loss, raw_share(data, before, after))
    _, there = effect_rms(data, after, len(after.effects) - 1)
    if share < MATERIAL_SHARE or there < MATERIAL_PERCENT:
        return False
    own, _ = effect_rms(data, after, len(after.effects) - 1, matrix)
    axis = axis_of_effect(contest.chosen)
    for number, other in enumerate(before.effects):
        least = SAME_AXIS_SHARE if axis_of_effect(other.name) == axis else LATER_SHARE
        if own < least * effect_rms(data, after, number, matrix)[0]:
            return False
    return own >= LEAST_PERCENT


def _left(
    data: Data, fitted: Fitted, best: Fitted, contest: Contest, screening: Screening, evidence: Evidence
) -> tuple[str, float, float] | None:
    trial = contest.trials[contest.chosen]
    variance = evidence.energy / max(1, evidence.residual.size)
    statistic = float(comparable(np.array([trial.explained / variance]), trial.rank)[0])
    probability = false_alarm_probability(statistic, screening.surrogate_maxima)
    return contest.chosen, 1.0 - best.loss / fitted.loss, probability


def renewed(data: Data, base: Fitted, fitted: Fitted) -> tuple[Data, Fitted, Fitted, Floats]:
    """Noise model and sensitivities at the new model, refitted until it stays; and the plain base beside it."""
    unbent = from_start(data, fitted.effects)
    fitted = unbent if lower(unbent.loss, fitted.loss) else fitted
    for _ in range(RENEWALS):
        data = at_rest(data, fitted.physical, fitted.effects)
        data = noise_model(data, fitted.physical, fitted.residual_nm)
        matrix = loaded_sensitivities(data, fitted.physical, fitted.effects)
        begin = evaluate(data, fitted.physical, fitted.effects)[0]
        fitted = refit(data, matrix, fitted.physical, fitted.effects, iterations=3)
        if 1.0 - fitted.loss / begin.loss < SETTLED:
            break
    plain = refit(at_rest(data, base.physical, ()), matrix, base.physical, (), iterations=3)
    return data, plain, fitted, matrix


def exchange(data: Data, matrix: Floats, fitted: Fitted, contests: list[Contest]) -> tuple[Fitted, list[Contest]]:
    """Try each accepted effect against its rivals again, now that the others are there."""
    for number, contest in enumerate(contests):
        others = [e for k, e in enumerate(fitted.effects) if k != number]
        taken = {e.name for e in others}
        rivals = [t for name, t in contest.trials.items() if name != contest.chosen and name not in taken]
        rivals = [
            t
            for t in rivals
            if not t.name.startswith(UNKNOWN)
            and contest.gains.get(t.name, 0.0) > RIVAL_SHARE * contest.gains[contest.chosen]
        ][:4]
        without = refit(data, matrix, fitted.physical, others, iterations=3)

        sets = [[*fitted.effects[:number], t.effect, *fitted.effects[number + 1 :]] for t in rivals]
        start = fitted.physical
        with ThreadPoolExecutor(THREADS) as pool:
            results = list(pool.map(partial(refit, data, matrix, start), sets))
        gains = {t.name: best_gain(without, r) for t, r in zip(rivals, results, strict=True)}
        gains[contest.chosen] = best_gain(without, fitted)
        trials = dict(contest.trials)
        for t, r in zip(rivals, results, strict=True):
            trials[t.name] = replace_effect(t, r.effects[number])
        trials[contest.chosen] = replace_effect(trials[contest.chosen], fitted.effects[number])
        costs = [cost(r, data) for r in results]
        k = first_best(range(len(costs)), key=costs.__getitem__) if costs else 0
        margin = CURVE_MARGIN if contest.chosen.startswith(UNKNOWN) else 0.0
        better = bool(costs) and lower(costs[k], cost(fitted, data))
        if better or (costs and margin and gains[rivals[k].name] > margin * gains[contest.chosen]):
            fitted = results[k]
            contests[number] = Contest(rivals[k].name, gains, trials)
        else:
            contests[number] = replace(contest, gains=gains, trials=trials)
    return fitted, contests


def family(contest: Contest) -> list[str]:
    """At most two rivals that explain nearly as much as the chosen one."""
    own = contest.gains[contest.chosen]
    near = [(g, name) for name, g in contest.gains.items() if name != contest.chosen and g >= FAMILY_SHARE * own]
    if not contest.chosen.startswith(UNKNOWN):
        near = [(g, name) for g, name in near if not name.startswith(UNKNOWN)]
    return [name for _, name in ranked(near, key=lambda one: -one[0])[:2]]

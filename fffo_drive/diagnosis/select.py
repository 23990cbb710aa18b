"""Model selection: rung by rung up the ladder, then in free competition; judged by the likelihood of unseen rows.

Contenders are refitted with everything else before they are compared, because the best regressor beside a base that was
fitted without it need not be the right one. Effects whose gain equals the best one's within the spread of the blocks
form its family; within it the lower rung and the fewest numbers win. Accepted effects are judged again when others have
been added.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..identification.criterion import (
    Folds,
    Gain,
    gain,
    strength_variation,
    unseen_loss,
)
from ..identification.facts import DriveFacts
from ..identification.ladder import LEAST_SHARE, MOST_EFFECTS, AcceptedEffect, Ladder
from ..identification.ranking import ranked
from ..identification.runs import CONTRADICTION_SHARE
from ..identification.threads import in_threads
from ..model.effects.laws.lookup import UNKNOWN
from ..model.effects.registry import axis_of_effect, law_of
from .base import NAMES
from .fitting import (
    Data,
    Fitted,
    evaluate,
    fit,
    load_of,
    numbers_of,
    on_command,
    rigid_of,
    share_gone,
)
from .gates import ReferenceAxis, implausibility, objection
from .propose import LAW_RUNG, TABLE_RUNG, WAVE_RUNG, Evidence, Proposal, Search, evidence_of, quick_score, score
from .scenes import Effect
from .scored import (
    LADDER_ITERATIONS,
    ScoredFit,
    base_of,
    chance,
    columns_of,
    renewed,
    scored_fit,
    settled,
    without,
)

ITERATIONS = 6  # of a contender's fit ...
TRIED = 12  # proposals whose gain is computed ...
TRIED_A_KIND = 2  # ... at most this many of one kind on a rung ...
REFITTED = 4  # ... of them, laws that are refitted, those beyond chance first ...
CURVES_REFITTED = 2  # ... and curves that are refitted
KEPT = 0.75  # a refit that keeps less of its promised gain is repeated from another start
LAW_OF_CURVE = 0.75  # laws with more than this share of a curve's gain take precedence over it ...
LAWS_FOR_CURVE = 3  # ... at most so many


class Contender(NamedTuple):
    """A proposal, and the loss of each row (q,) with its columns added, under a fit of the other folds."""

    proposal: Proposal
    unseen: Floats


@dataclass(frozen=True)
class Accepted:
    """The evidence for an accepted effect."""

    name: str
    gain: Gain  # given all others
    p: float  # over the whole search
    share: float  # of the squared residual that the others leave
    family: tuple[str, ...]  # effects that the data cannot distinguish from it
    rivals: tuple[tuple[str, float], ...]  # refitted in its place, with their gains
    tried: int
    variation: float = 0.0  # coefficient of variation of its strength over the blocks, in the final model


class Refused(NamedTuple):
    """An effect with enough evidence that was rejected for another reason."""

    name: str
    reason: str
    share: float
    p: float


State = tuple[Data, ScoredFit, list[Accepted]]  # of a search: what is fitted to, the model, the evidence for it
Names = frozenset[str] | None  # of free curves; None: all


class FirstRungs(NamedTuple):
    """The model of the ladder's first rungs, and the evidence for it at its noise levels."""

    data: Data
    scored: ScoredFit
    accepted: tuple[Accepted, ...]

    @property
    def fitted(self) -> Fitted:
        """The model."""
        return self.scored.fitted


class Selection(NamedTuple):
    """The selected model, and the evidence for it."""

    data: Data
    base: Fitted  # without effects, at the final noise levels
    fitted: Fitted
    matrix: Floats
    accepted: tuple[Accepted, ...]  # in the order of `fitted.effects`
    refused: tuple[Refused, ...]
    first: tuple[Proposal, ...]  # all candidates of the first free round, best first
    first_p: float  # smallest p-value of that round, times the number of candidates
    ladder: FirstRungs
    inertia_ratios: tuple[float, ...]  # of each run, where the runs contradict each other in the inertia
    negligible_nm: float  # rms torque of a negligible effect

    def of_first_rungs(self, reason: str) -> Selection:
        """The first rungs alone; the effects above them are refused for this reason."""
        data, scored, accepted = self.ladder
        kept = {note.name for note in accepted}
        gone = [Refused(n.name, reason, n.share, n.p) for n in self.accepted if n.name not in kept]
        return self._replace(
            data=data, base=base_of(data), fitted=scored.fitted, matrix=scored.matrix,
            accepted=_varying(data, scored, accepted), refused=(*self.refused, *gone),
        )  # fmt: skip


class DiagnosisSettings(NamedTuple):
    """Settings of a diagnosis."""

    false_alarm_rate: float = 0.01  # over the whole search
    without: frozenset[str] = frozenset()  # laws, `unknown:AXIS`, kinds of curves or pairs to leave out
    ablate: frozenset[str] = frozenset()  # entries of diagnose.MECHANISMS to switch off
    cutoff_hz: float | None = None  # cut-off of the shared filter; None: from the data


class Selector:
    """The search over one data set."""

    def __init__(self, facts: DriveFacts, rules: DiagnosisSettings, progress: Callable[[float, str], None]) -> None:
        self.facts, self.rate, self.ablate, self.progress = facts, rules.false_alarm_rate, rules.ablate, progress
        self.search = Search(facts, rules.without, rules.ablate)
        self.refused: dict[str, Refused] = {}
        self.barred: set[str] = set()
        self.visited: set[tuple[tuple[str, ...], ...]] = {()}
        self.first: tuple[Proposal, ...] = ()
        self.first_p = 1.0
        self.reference: ReferenceAxis | None = None
        self.ladder: FirstRungs | None = None
        self.inertia_ratios: tuple[float, ...] = ()
        self.share = 0.0  # of the search that is done: effects also go

    def run(self, data: Data, climbed: Ladder) -> Selection:
        """From the first rungs on let all effects compete. `data` as they are at the start."""
        whole = data
        data, scored, accepted = self._first_rungs(data, climbed)
        self.ladder = FirstRungs(data, scored, tuple(accepted))
        reference = ReferenceAxis.of(data, scored.fitted, scored.matrix)
        self.reference = reference.beside(climbed.start.inertia_nm_s2_per_rev)
        for rung in (LAW_RUNG, TABLE_RUNG):
            data, scored, accepted = self._climbed(whole, data, scored, accepted, rung)
        return self._finished(whole, *self._pruned(data, scored, accepted, refit=True))

    def _climbed(
        self, whole: Data, data: Data, scored: ScoredFit, accepted: list[Accepted], rung: int, curves: Names = None
    ) -> State:
        """Add effects of one rung until none remains."""
        while len(accepted) < MOST_EFFECTS:
            self.share = max(self.share, (len(accepted) + rung / 5.0) / (MOST_EFFECTS + 1.0))
            self.progress(self.share, "search")
            found = self._round(data, scored, accepted, rung, curves)
            if found is None:
                break
            accepted = found[2]
            data, scored = self._freed(whole, *found[:2])
        return data, scored, accepted

    def _finished(self, whole: Data, data: Data, scored: ScoredFit, accepted: list[Accepted]) -> Selection:
        """Put laws in the place of curves, which may come back for what is left, and judge what stands."""
        curves = accepted
        data, scored, accepted = self._replaced_curves(data, scored, accepted)
        if accepted is not curves:
            names = frozenset(note.name for note in curves if note.name.startswith(UNKNOWN))
            data, scored, accepted = self._climbed(whole, data, scored, accepted, LAW_RUNG, names)
        for k, note in enumerate(accepted):  # a law that is needed even beside a curve over its own axis
            if _set_aside(scored, k) != (containing := _set_aside(scored, k, True)):
                accepted[k] = self._judged(data, scored, k, note, True, containing)
        assert self.ladder is not None
        return Selection(
            data, base_of(data), scored.fitted, scored.matrix, _varying(data, scored, accepted),
            tuple(self.refused.values()), self.first, self.first_p, self.ladder, self.inertia_ratios,
            self._negligible_nm,
        )  # fmt: skip

    def _first_rungs(self, data: Data, climbed: Ladder) -> State:
        """The effects of the first rungs in a fit with the base: a rigid one, where the full friction is not needed."""
        effects = [effect_at_start(one, data.runs, self.facts.absolute_angle) for one in climbed.accepted]
        self.search.tried += climbed.tried
        rigid = rigid_of(data)
        found = settled(rigid, fit(rigid, rigid.start, effects, LADDER_ITERATIONS))
        data, scored = self._freed(data, *found)
        accepted = [
            Accepted(one.candidate.name, one.gain, 0.0, one.share, one.candidate.family, (), climbed.tried)
            for one in climbed.accepted
        ]
        return self._pruned(data, scored, accepted)

    def _freed(self, whole: Data, data: Data, scored: ScoredFit) -> tuple[Data, ScoredFit]:
        """Free the full friction of a rigid base, where the data determine it beside the effects."""
        if data.free == whole.free or self.facts.units == "linear":
            return data, scored
        freed = data._replace(free=whole.free, start=whole.start)
        static, coulomb = (NAMES.index(name) for name in ("static_nm", "coulomb_nm"))
        physical = scored.fitted.physical.copy()
        physical[static] *= whole.start[static] / whole.start[coulomb]
        found = scored_fit(freed, fit(freed, physical, scored.fitted.effects, LADDER_ITERATIONS))
        if not gain(scored.unseen, found.unseen, data.folds).holds:
            return data, scored
        return settled(freed, found.fitted)

    def _round(
        self, data: Data, scored: ScoredFit, accepted: list[Accepted], rung: int, curves: Names = None
    ) -> State | None:
        """Add one effect, of free curves one of these names (None: all); None where none remains on this rung."""
        evidence = self._evidence(data, scored.fitted, scored.matrix)
        proposals = self.search.proposals(data, scored.fitted, evidence, rung, curves)
        tried = self.search.tried
        if rung == LAW_RUNG and not self.first:
            self.first = tuple(one.without_columns for one in ranked(proposals, key=lambda one: -one.worth))
            self.first_p = min([1.0, *(one.score.p * tried for one in proposals)])
        laws, free = self._contenders(data, scored, evidence, proposals, tried)
        del proposals  # with their columns
        believed = self._believed(data, scored, evidence, laws, tried)
        free = _beyond_laws(scored, believed, free, evidence.folds)[:CURVES_REFITTED]
        believed += self._believed(data, scored, evidence, free, tried)
        if rung == LAW_RUNG and self._contradicted(data, scored, evidence, believed):
            return None
        if not believed:
            return None
        best = max(believed, key=lambda item: item[2].value)
        family = [item for item in believed if not _worse(best[1], item[1], evidence.folds)]
        # every friction has some form; an effect beside it must be distinguishable from the form
        chosen = min(
            family,
            key=lambda item: (
                not law_of(item[0].name).form, item[0].rung, numbers_of(item[1].fitted), -item[2].value
            ),
        )  # fmt: skip
        note = Accepted(
            chosen[0].name, chosen[2], min(1.0, chosen[0].score.p * tried), 0.0,
            tuple(dict.fromkeys(item[0].name for item in family if item[0].name != chosen[0].name)),
            tuple((item[0].name, item[2].value) for item in believed if item[0].name != chosen[0].name), tried,
        )  # fmt: skip
        found = self._pruned(*renewed(data, chosen[1].fitted), [*accepted, note])
        reason = implausibility(found[0], found[1].fitted, self.reference, self.ablate)
        if reason:  # a reason that arose at the noise levels of the new model
            self.barred.add(chosen[0].name)
            self.refused[chosen[0].name] = Refused(
                chosen[0].name, reason, share_gone(scored.fitted, chosen[1].fitted), note.p
            )
            return self._round(data, scored, accepted, rung, curves)
        state = tuple(sorted((e.name, *(f"{v:.2g}" for v in e.shapes.values())) for e in found[1].fitted.effects))
        if state in self.visited:  # a cycle: adding one effect removes another, and the reverse
            return None
        self.visited.add(state)
        return found

    def _replaced_curves(self, data: Data, scored: ScoredFit, accepted: list[Accepted]) -> State:
        """Put laws in the place of each free curve where together they have most of the curve's gain.

        A curve that holds two effects at once beats each law alone, and one accepted before another effect had absorbed
        part of that effect. Laws are tried on the base of the whole model: one that was refitted without the curve has
        absorbed what a law would explain.
        """
        curves = [note.name for note in accepted if note.name.startswith(UNKNOWN)]
        for names in dict.fromkeys([tuple(curves), *((name,) for name in curves)]):  # all at once, then each
            others = [k for k, note in enumerate(accepted) if note.name not in names]
            if len(others) == len(accepted):
                continue  # replaced, or it went with another curve
            left = [scored.fitted.effects[k] for k in others]
            bare, _ = evaluate(data, scored.fitted.physical, left)
            alone = scored_fit(data, fit(data, bare.physical, left)).unseen
            least = LAW_OF_CURVE * gain(alone, scored.unseen, data.folds).value
            ratios, self.visited = self.inertia_ratios, {()}
            laws = (data, scored_fit(data, bare), [accepted[k] for k in others])
            while len(laws[2]) < min(MOST_EFFECTS, len(others) + LAWS_FOR_CURVE * len(names)):
                more = self._round(*laws, LAW_RUNG, frozenset())
                if more is None:
                    break
                laws = more
            fitted = laws[1].fitted
            unseen = scored_fit(data, fit(data, fitted.physical, fitted.effects)).unseen
            if gain(alone, unseen, data.folds).value > least:
                data, scored, accepted = laws
            self.inertia_ratios = ratios  # without the curve, runs may seem to contradict each other
        return data, scored, accepted

    def _contradicted(
        self, data: Data, scored: ScoredFit, evidence: Evidence, believed: Sequence[tuple[Proposal, ScoredFit, Gain]]
    ) -> bool:
        """Whether a separate inertia per run explains unseen rows, and no effect explains them better."""
        rows = data.rows
        inertia = scored.fitted.physical[NAMES.index("inertia_nm_s2_per_rev")]
        columns = np.stack(
            [np.where(rows.run == k, inertia * rows.acceleration_rps2, 0.0) for k in range(data.runs)], axis=1
        )
        own = quick_score(evidence, data.white(columns))
        if data.runs < 2 or own.explained < LEAST_SHARE * evidence.energy:
            return False
        matrix = np.concatenate([scored.matrix, data.white(columns)], axis=1)
        loss = unseen_loss(scored.fitted.white, matrix, evidence.folds)
        if not gain(scored.unseen, loss, evidence.folds).holds:
            return False
        if any(not gain(result.unseen, loss, evidence.folds).holds for _, result, _ in believed):
            return False
        if float(np.ptp(own.strengths)) <= CONTRADICTION_SHARE:
            return False
        self.inertia_ratios = tuple(1.0 + own.strengths - own.strengths[np.argmin(np.abs(own.strengths))])
        return True

    def _contenders(
        self, data: Data, scored: ScoredFit, evidence: Evidence, proposals: Sequence[Proposal], tried: int
    ) -> tuple[list[Contender], list[Contender]]:
        """Laws, and free curves beyond chance, the largest linear gain first.

        A curve is linear: a refit does not change its p-value. A law may be far from its best shape and beside a base
        that is biased without it: where its p-value does not rule out chance, that of the refit may.
        """
        taken = {e.name for e in scored.fitted.effects}
        able = [
            one for one in proposals
            if (one.score.p * tried <= self.rate or not one.name.startswith(UNKNOWN))
            and one.score.explained > LEAST_SHARE * evidence.energy
            and (one.name not in taken or law_of(one.name).wave) and one.name not in self.barred
        ]  # fmt: skip
        picked: list[Proposal] = []
        for one in ranked(able, key=lambda one: -one.worth):
            if sum(other.name == one.name for other in picked) < TRIED_A_KIND and len(picked) < TRIED:
                picked.append(one)
        losses = list(in_threads(lambda one: _linear(data, scored, one, evidence.folds), picked))
        gains = [gain(scored.unseen, loss, evidence.folds) for loss in losses]
        order = [k for k in ranked(range(len(picked)), key=lambda k: -gains[k].value) if gains[k].holds]
        found = [Contender(picked[k].without_columns, losses[k]) for k in order]
        laws = [one for one in found if not one.proposal.name.startswith(UNKNOWN)]
        laws.sort(key=lambda one: one.proposal.score.p * tried > self.rate)  # those beyond chance already come first
        return laws[:REFITTED], [one for one in found if one.proposal.name.startswith(UNKNOWN)]

    def _believed(
        self, data: Data, scored: ScoredFit, evidence: Evidence, contenders: Sequence[Contender], tried: int
    ) -> list[tuple[Proposal, ScoredFit, Gain]]:
        """Contenders beyond chance, at the latest when refitted with everything, with enough gain and no objection."""
        both = "two_starts" not in self.ablate

        def refit(one: Contender) -> ScoredFit:
            promised = one.proposal.score.explained / evidence.energy
            return scored_fit(data, refitted(data, scored.fitted, one.proposal, promised, both))

        fits = list(in_threads(refit, contenders))
        found = []
        for (one, _), result in zip(contenders, fits, strict=True):
            own = gain(scored.unseen, result.unseen, evidence.folds)
            share = share_gone(scored.fitted, result.fitted)
            p = one.score.p * tried
            if p > self.rate:
                p = self._chance(data, scored, result, len(result.fitted.effects) - 1, tried)
            if not own.holds or share < LEAST_SHARE or p > self.rate:
                continue
            reason = objection(data, result.fitted, self.reference, self.ablate)
            if reason:
                self.refused.setdefault(one.name, Refused(one.name, reason, share, min(1.0, p)))
                continue
            found.append((one._replace(score=one.score._replace(p=p / tried)), result, own))
        return found

    def _evidence(self, data: Data, fitted: Fitted, known: Floats) -> Evidence:
        """The evidence that candidates are scored against, with the negligible torque."""
        return evidence_of(data, fitted, known, self._negligible_nm)

    @property
    def _negligible_nm(self) -> float:
        return 0.0 if self.reference is None or "least_torque" in self.ablate else self.reference.negligible_nm

    def _pruned(self, data: Data, scored: ScoredFit, accepted: list[Accepted], refit: bool = False) -> State:
        """Drop the effects that no longer explain enough, the weakest first, by their present gains.

        Without `refit` an effect that looks superfluous is judged by a refit of the others, and any other by one step
        of them. If any effect acts on the command, all are refitted: its regressor contains the residual, and one step
        does not show what it can absorb.
        """
        refit = refit or any(on_command(effect) for effect in scored.fitted.effects)
        while accepted:
            judged = [
                self._judged(data, scored, number, note, refit, _set_aside(scored, number))
                for number, note in enumerate(accepted)
            ]
            if len(accepted) == 1 and judged[0].share >= LEAST_SHARE:
                # it was judged at its acceptance and nothing has been added since
                return data, scored, [replace(judged[0], p=accepted[0].p or judged[0].p)]
            weakest = None
            for k in ranked(range(len(judged)), key=lambda k: judged[k].gain.value):
                if self._is_idle(judged[k]) and "drop" not in self.ablate:
                    judged[k] = self._judged(data, scored, k, accepted[k], True, _set_aside(scored, k))
                    if self._is_idle(judged[k]):
                        weakest = k
                        break
            if weakest is None:
                return data, scored, judged
            del accepted[weakest]
            left = [e for k, e in enumerate(scored.fitted.effects) if k != weakest]
            data, scored = renewed(data, fit(data, scored.fitted.physical, left))
        return data, scored, accepted

    def _is_idle(self, note: Accepted) -> bool:
        return not note.gain.holds or note.share < LEAST_SHARE or note.p > self.rate

    def _judged(
        self, data: Data, scored: ScoredFit, number: int, note: Accepted, refit: bool, aside: Sequence[int]
    ) -> Accepted:
        """Gain, share and p-value of one effect given all others but those set `aside`."""
        beside = without(data, scored, aside, refit)
        alone = without(data, scored, [*aside, number], refit)
        place = number - sum(k < number for k in aside)
        return replace(
            note, gain=gain(alone.unseen, beside.unseen, data.folds),
            share=share_gone(alone.fitted, beside.fitted), p=self._chance(data, alone, beside, place, note.tried),
        )  # fmt: skip

    def _chance(self, data: Data, alone: ScoredFit, beside: ScoredFit, number: int, tried: int) -> float:
        """p-value of one effect of `beside`, over the whole search; `alone` is the model without it.

        By a test of its numbers beside all others, which is exact for a curve. For a law twice the smaller of that,
        which sees what is rare, and the P test, which sees what other parameters could carry as well.
        """
        own = columns_of(data, beside, number)
        evidence = self._evidence(data, beside.fitted, np.delete(beside.matrix, np.r_[own], axis=1))
        p = score(evidence, beside.matrix[:, own], load_of(data, beside.fitted, number)).p
        if not beside.fitted.effects[number].name.startswith(UNKNOWN):
            numbers = own.stop - own.start
            p = 2.0 * min(p, chance(data, alone.fitted, beside.fitted, numbers, evidence.negligible_nm))
        return min(1.0, p * tried)


def effect_at_start(one: AcceptedEffect, runs: int, absolute: bool) -> Effect:
    """An effect of the first rungs with its strengths; of a single run a wave has a datum of its own."""
    candidate, law = one.candidate, law_of(one.candidate.name)
    shapes = {p.name: p.typical for p in law.shapes} | dict(candidate.shape)
    by_run = one.coefficients.reshape(runs if candidate.per_run else 1, len(candidate.strengths))
    own = candidate.per_run or (runs == 1 and not absolute)
    per_run = frozenset(law.per_run) & frozenset(candidate.strengths) if own else frozenset()
    return Effect(candidate.name, shapes, dict(zip(candidate.strengths, by_run.T, strict=True)), per_run)


def _beyond_laws(
    scored: ScoredFit, believed: Sequence[tuple[Proposal, ScoredFit, Gain]], free: list[Contender], folds: Folds
) -> list[Contender]:
    """Curves with a larger gain than any law; other curves need no refit.

    A law with most of a curve's gain takes precedence: the curve may have absorbed another effect as well.
    """
    if not believed:
        return free
    _, law, most = max(believed, key=lambda item: item[2].value)
    return [
        one for one in free
        if gain(law.unseen, one.unseen, folds).holds
        and LAW_OF_CURVE * gain(scored.unseen, one.unseen, folds).value > most.value
    ]  # fmt: skip


def _worse(best: ScoredFit, other: ScoredFit, folds: Folds) -> bool:
    """Whether unseen rows distinguish the two."""
    return best is not other and gain(other.unseen, best.unseen, folds).holds


def _linear(data: Data, scored: ScoredFit, one: Proposal, folds: Folds) -> Floats:
    """Loss of unseen rows with a proposal's columns added, without a nonlinear refit."""
    own = data.white(one.columns)
    prior = np.zeros(scored.matrix.shape[1] + own.shape[1])
    return unseen_loss(scored.fitted.white, np.concatenate([scored.matrix, own], axis=1), folds, prior)


def refitted(data: Data, fitted: Fitted, one: Proposal, promised: float, two_starts: bool) -> Fitted:
    """A proposal refitted with everything from the current model; `promised`: the share that its columns explain.

    Its linear strengths belong to a base that would move too; it therefore starts at zero strength, and the first step
    moves both. A base fitted without the effect is biased and may be far from its optimum: a refit that keeps less than
    KEPT of the promise is repeated from a rigid base, as on the ladder.
    """
    nothing = replace(one.effect, strengths={name: np.zeros_like(v) for name, v in one.effect.strengths.items()})
    found = fit(data, fitted.physical, [*fitted.effects, nothing], ITERATIONS)
    if not two_starts or one.name.startswith(UNKNOWN) or 1.0 - found.energy / fitted.energy > KEPT * promised:
        return found
    rigid = rigid_of(data)
    simple = fit(rigid, rigid.start, [*fitted.effects, one.effect], ITERATIONS)
    again = fit(data, simple.physical, simple.effects, ITERATIONS)
    return again if again.loss < found.loss else found


def _set_aside(scored: ScoredFit, number: int, own_axis: bool = False) -> list[int]:
    """Free curves that one effect is not judged beside: all for one of the first rungs, as they hold a constant; with
    `own_axis` those over the axis of a law, which contain it.
    """
    effects = scored.fitted.effects
    law = law_of(effects[number].name)
    if effects[number].name.startswith(UNKNOWN):
        return []
    return [
        k for k, e in enumerate(effects)
        if e.name.startswith(UNKNOWN)
        and (law.rung <= WAVE_RUNG or (own_axis and axis_of_effect(e.name) == law.axis))
    ]  # fmt: skip


def _varying(data: Data, scored: ScoredFit, accepted: Sequence[Accepted]) -> tuple[Accepted, ...]:
    """The evidence with each strength's variation; an effect found beside another cannot replace it."""
    kept = {note.name for note in accepted}
    return tuple(
        replace(one, family=tuple(n for n in one.family if n not in kept), variation=_variation(data, scored, k))
        for k, one in enumerate(accepted)
    )


def _variation(data: Data, scored: ScoredFit, number: int) -> float:
    """Coefficient of variation of an effect's strength over the blocks."""
    left_out = [columns_of(data, scored, k) for k in (number, *_set_aside(scored, number, True))]
    beside = np.delete(scored.matrix, np.concatenate([np.r_[part] for part in left_out]), axis=1)
    load = load_of(data, scored.fitted, number)
    return strength_variation(load, beside, scored.fitted.white, data.folds)

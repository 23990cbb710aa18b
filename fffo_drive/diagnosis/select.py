"""Which effects: rung by rung up the ladder, then in free competition; each judged by what it explains of unseen rows.

Contenders are refitted with everything else before they are compared: a regressor that explains most beside a base that
was fitted without it need not be right. What explains as much as the best, within the spread of the blocks, is its
family; in it the lower rung and the fewest numbers win. What stands is judged again once the others are there.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from ..identification.criterion import Folds, Gain, clipped, gain, huber, robust_residual, unseen_loss
from ..identification.facts import DriveFacts
from ..identification.ladder import GRAVITY_PERIODS
from ..identification.ranking import ranked
from ..identification.runs import CONTRADICTION_SHARE
from ..identification.threads import in_threads
from ..model.effects.laws.lookup import UNKNOWN
from ..model.effects.registry import LAWS, law_of
from .base import NAMES, RIGID
from .fitting import (
    Data,
    Fitted,
    at_rest,
    consistent_scenes,
    evaluate,
    fit,
    jacobian,
    on_command,
    share_gone,
    slots_of,
    torque_of,
    unseen,
    with_levels,
)
from .gates import ReferenceAxis, misshapen, objection
from .propose import LAW_RUNG, TABLE_RUNG, WAVE_RUNG, Evidence, Proposal, Search, evidence_of, quick_score, score
from .scenes import Effect, load_rows, strength_columns

Floats = npt.NDArray[np.float64]

MOST_EFFECTS = 6
ROUNDS = 8  # in which levels of noise and model are brought to agree ...
SETTLED = 0.1  # ... so that the model moves by less than so many levels of noise
ITERATIONS = 6  # of a contender's fit ...
LADDER_ITERATIONS = 8  # ... and of those of the first rungs
TRIED = 12  # proposals whose gain is computed ...
TRIED_A_KIND = 2  # ... and of those so many of one rung's kind
REFITTED = 4  # ... and of those, laws that are refitted ...
CURVES_REFITTED = 2  # ... and curves
KEPT = 0.75  # of what its columns promise: a refit that keeps less of it is tried from another start
LAW_OF_CURVE = 0.75  # of a curve's gain: a law that gains more comes before it
LEAST_SHARE = 0.02  # of the squared residual that an effect has to take away
CURVE_OF_REST = 0.2  # of what is left and could be explained, that a curve without a name has to take away


class Standing(NamedTuple):
    """A hypothesis with what it is compared by."""

    fitted: Fitted
    matrix: Floats  # (q, p) white sensitivities of everything that is fitted
    unseen: Floats  # (q,) loss of each row by a fit of the other folds


class Contender(NamedTuple):
    """A proposal, and the loss of each row (q,) with its columns beside everything, by a fit of the other folds."""

    proposal: Proposal
    unseen: Floats


@dataclass(frozen=True)
class Accepted:
    """Why an effect stands."""

    name: str
    gain: Gain  # given all others
    p: float  # over everything that was searched
    share: float  # of the squared residual that the others leave
    family: tuple[str, ...]  # what the data do not tell from it
    rivals: tuple[tuple[str, float], ...]  # refitted in its place, with their gains
    tried: int


class Refused(NamedTuple):
    """What explained enough, and was not believed."""

    name: str
    reason: str
    share: float
    p: float


class Selection(NamedTuple):
    """What was selected, and on what grounds."""

    data: Data
    base: Fitted  # without effects, at the final levels of noise
    fitted: Fitted
    matrix: Floats
    accepted: tuple[Accepted, ...]  # in the order of `fitted.effects`
    refused: tuple[Refused, ...]
    first: tuple[Proposal, ...]  # everything of the first free round, best first
    first_p: float  # the smallest chance of that round, times what was tried
    ladder: Fitted  # of the first rungs
    inertia_ratios: tuple[float, ...]  # of each run, where the runs contradict each other in it
    negligible_nm: float  # rms torque of what is too small to be an effect


class Rules(Protocol):
    """Of a diagnosis' settings, what a search goes by."""

    @property
    def false_alarm_rate(self) -> float:
        """Over the whole search."""

    @property
    def without(self) -> frozenset[str]:
        """Laws and curves that are left out."""

    @property
    def ablate(self) -> frozenset[str]:
        """Mechanisms that are switched off."""


class Selector:
    """The search over one data set."""

    def __init__(self, facts: DriveFacts, rules: Rules, told: Callable[[float, str], None]) -> None:
        self.facts, self.rate, self.ablate, self.told = facts, rules.false_alarm_rate, rules.ablate, told
        self.search = Search(facts, rules.without, rules.ablate)
        self.refused: dict[str, Refused] = {}
        self.barred: set[str] = set()
        self.visited: set[tuple[tuple[str, ...], ...]] = {()}
        self.first: tuple[Proposal, ...] = ()
        self.first_p = 1.0
        self.reference: ReferenceAxis | None = None
        self.ladder: Fitted | None = None
        self.inertia_ratios: tuple[float, ...] = ()

    def run(self, data: Data) -> Selection:
        """Up the ladder, then all that are left in free competition. `data` as they start."""
        whole = data
        data, standing, accepted = self._ladder(data)
        self.reference = ReferenceAxis.of(data, standing.fitted, standing.matrix)
        for rung in (WAVE_RUNG, LAW_RUNG, TABLE_RUNG):
            while len(accepted) < MOST_EFFECTS:
                self.told((len(accepted) + rung / 5.0) / (MOST_EFFECTS + 1.0), "search")
                found = self._round(data, standing, accepted, rung)
                if found is None:
                    break
                accepted = found[2]
                data, standing = self._freed(whole, *found[:2])
            if rung == WAVE_RUNG:
                self.ladder = standing.fitted
                self.reference = self.reference.and_then(ReferenceAxis.of(data, standing.fitted, standing.matrix))
        data, standing, accepted = self._pruned(data, standing, accepted, refit=True)
        plain = base_of(data)
        assert self.ladder is not None
        stands = {note.name for note in accepted}  # what stands beside an effect does not stand in its place
        accepted = [replace(one, family=tuple(n for n in one.family if n not in stands)) for one in accepted]
        return Selection(
            data, plain, standing.fitted, standing.matrix, tuple(accepted), tuple(self.refused.values()),
            self.first, self.first_p, self.ladder, self.inertia_ratios, self._negligible_nm,
        )  # fmt: skip

    def without_doubtful(self, found: Selection, rest_share: float) -> Selection | None:
        """The selection without its weakest curve, where that takes away little beside what is left and could be
        explained (`rest_share` of the squared residual): it may be a part of that. None where there is none."""
        curves = [k for k, one in enumerate(found.accepted) if one.name.startswith(UNKNOWN)]
        weakest = min(curves, key=lambda k: found.accepted[k].share, default=None)
        if weakest is None or found.accepted[weakest].share >= CURVE_OF_REST * rest_share or "rest" in self.ablate:
            return None
        one = found.accepted[weakest]
        reason = f"it explains {100.0 * one.share:.0f} %, little compared with the residual that nothing explains"
        self.refused[one.name] = Refused(one.name, reason, one.share, one.p)
        effects = [e for k, e in enumerate(found.fitted.effects) if k != weakest]
        accepted = [note for note in found.accepted if note is not one]
        begin = fit(found.data, found.fitted.physical, effects, LADDER_ITERATIONS)
        data, standing, accepted = self._pruned(*settled(found.data, begin), accepted, refit=True)
        return found._replace(
            data=data, base=base_of(data), fitted=standing.fitted, matrix=standing.matrix, accepted=tuple(accepted),
            refused=tuple(self.refused.values()),
        )  # fmt: skip

    def _ladder(self, data: Data) -> tuple[Data, Standing, list[Accepted]]:
        """The first rungs: of all sets of their laws the smallest that unseen rows do not tell from the best.

        They are fitted beside a rigid base from the start: a base that was fitted without them, or that is
        freer than the data determine, bends. The friction of the whole base is then a rung of its own.
        """
        rigid = rigid_of(data)
        laws = [name for name, law in LAWS.items() if law.rung < WAVE_RUNG and name not in self.search.without]
        if self.facts.units != "rotary" or data.rows.turns < GRAVITY_PERIODS * (self.facts.gear_ratio or 1.0):
            laws.remove("unbalance")
        laws = [name for name in laws if "ladder" not in self.ablate and self._distinct(rigid, name)]
        sets = [chosen for size in range(len(laws) + 1) for chosen in itertools.combinations(laws, size)]

        def fitted(data: Data, chosen: tuple[str, ...]) -> Standing:
            own = [starting_effect(name, self.facts) for name in chosen]
            return stand(data, fit(data, data.start, own, LADDER_ITERATIONS))

        standings = list(in_threads(lambda chosen: fitted(rigid, chosen), sets))
        chosen = self._smallest(rigid, sets, standings)
        simple = standings[chosen]
        whole, bare = in_threads(lambda own: fitted(data, own), (sets[chosen], ()))
        folds = folds_used(data)
        if self.facts.units == "linear" or not gain(simple.unseen, whole.unseen, folds).holds:
            data, whole, bare = rigid, simple, standings[0]
        share = share_gone(bare.fitted, whole.fitted)
        if not sets[chosen] or share < LEAST_SHARE:
            return *settled(data, bare.fitted), []
        accepted = [
            Accepted(name, gain(bare.unseen, whole.unseen, folds), 0.0, share, family, (), len(sets))
            for name, family in zip(sets[chosen], self._families(sets, standings, chosen, folds), strict=True)
        ]
        data, standing = settled(data, whole.fitted)
        return self._pruned(data, standing, accepted)

    def _freed(self, whole: Data, data: Data, standing: Standing) -> tuple[Data, Standing]:
        """The friction of the whole base, where the ladder did without and an effect has made room for it since."""
        if data.free == whole.free or self.facts.units == "linear":
            return data, standing
        freed = data._replace(free=whole.free, start=whole.start)
        static, coulomb = (NAMES.index(name) for name in ("static_nm", "coulomb_nm"))
        physical = standing.fitted.physical.copy()
        physical[static] *= whole.start[static] / whole.start[coulomb]
        found = stand(freed, fit(freed, physical, standing.fitted.effects, LADDER_ITERATIONS))
        if not gain(standing.unseen, found.unseen, folds_used(data)).holds:
            return data, standing
        return settled(freed, found.fitted)

    def _smallest(self, data: Data, sets: Sequence[tuple[str, ...]], standings: Sequence[Standing]) -> int:
        """The smallest sets of which one is not worse than the best; of these the first that is not worse than they.

        A constant torque stands before a friction that differs by direction.
        """
        folds = folds_used(data)

        def best(of: Sequence[int]) -> Standing:
            return standings[min(of, key=lambda k: float(standings[k].unseen.sum()))]

        first = best(range(len(sets)))
        size = min(len(own) for own, one in zip(sets, standings, strict=True) if not _worse(first, one, folds))
        alike = [k for k, own in enumerate(sets) if len(own) == size]
        return next(k for k in alike if not _worse(best(alike), standings[k], folds))

    def _families(
        self, sets: Sequence[tuple[str, ...]], standings: Sequence[Standing], chosen: int, folds: Folds
    ) -> list[tuple[str, ...]]:
        """Of each law of the chosen set, what could stand in its place."""
        own = sets[chosen]
        found = []
        for name in own:
            rest = set(own) - {name}
            found.append(tuple(
                next(iter(set(other) - rest)) for other, one in zip(sets, standings, strict=True)
                if len(other) == len(own) and rest < set(other) and name not in other
                and not _worse(standings[chosen], one, folds)
            ))  # fmt: skip
        return found

    def _distinct(self, data: Data, name: str) -> bool:
        """Whether the base cannot say what a law says: where all runs turn one way, it can say a constant torque."""
        start = evaluate(data, data.start, ())[0]
        effect = starting_effect(name, self.facts)
        own = strength_columns(data.rows, consistent_scenes(data, data.start, ()), name, effect.shapes).values
        return quick_score(evidence_of(data, start, jacobian(data, start)), data.white(own)).rank > 0

    def _round(
        self, data: Data, standing: Standing, accepted: list[Accepted], rung: int
    ) -> tuple[Data, Standing, list[Accepted]] | None:
        """One more effect; None where none is left on this rung."""
        evidence = self._evidence(data, standing.fitted, standing.matrix)
        proposals = self.search.proposals(data, standing.fitted, evidence, rung)
        tried = self.search.tried
        if rung == LAW_RUNG and not self.first:
            self.first = tuple(ranked(proposals, key=lambda one: -one.worth))
            self.first_p = min([1.0, *(one.score.p * tried for one in proposals)])
        laws, free = self._contenders(data, standing, evidence, proposals, tried)
        believed = self._believed(data, standing, evidence, laws, tried)
        free = _beyond_laws(standing, believed, free, evidence.folds)[:CURVES_REFITTED]
        believed += self._believed(data, standing, evidence, free, tried)
        if rung == LAW_RUNG and self._contradicted(data, standing, evidence, believed):
            return None
        if not believed:
            return None
        best = max(believed, key=lambda item: item[2].value)
        family = [item for item in believed if not _worse(best[1], item[1], evidence.folds)]
        # every axis has a friction of some form; an effect beside it has to be told from that
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
        reason = misshapen(found[0], found[1].fitted, self.reference, self.ablate)
        if reason:  # it became so at the noise of the new model
            self.barred.add(chosen[0].name)
            self.refused[chosen[0].name] = Refused(
                chosen[0].name, reason, share_gone(standing.fitted, chosen[1].fitted), note.p
            )
            return self._round(data, standing, accepted, rung)
        state = tuple(sorted((e.name, *(f"{v:.2g}" for v in e.shapes.values())) for e in found[1].fitted.effects))
        if state in self.visited:  # what is added throws out what was there, and the other way round
            return None
        self.visited.add(state)
        return found

    def _contradicted(
        self, data: Data, standing: Standing, evidence: Evidence, believed: Sequence[tuple[Proposal, Standing, Gain]]
    ) -> bool:
        """Whether an inertia for each run explains unseen rows, and no effect explains them better."""
        rows = data.rows
        inertia = standing.fitted.physical[NAMES.index("inertia_nm_s2_per_rev")]
        columns = np.stack(
            [np.where(rows.run == k, inertia * rows.acceleration_rps2, 0.0) for k in range(data.runs)], axis=1
        )
        own = quick_score(evidence, data.white(columns))
        if data.runs < 2 or own.explained < LEAST_SHARE * evidence.energy:
            return False
        matrix = np.concatenate([standing.matrix, data.white(columns)], axis=1)
        loss = unseen_loss(standing.fitted.white, matrix, evidence.folds)
        if not gain(standing.unseen, loss, evidence.folds).holds:
            return False
        if any(not gain(result.unseen, loss, evidence.folds).holds for _, result, _ in believed):
            return False
        if float(np.ptp(own.strengths)) <= CONTRADICTION_SHARE:
            return False
        self.inertia_ratios = tuple(1.0 + own.strengths - own.strengths[np.argmin(np.abs(own.strengths))])
        return True

    def _contenders(
        self, data: Data, standing: Standing, evidence: Evidence, proposals: Sequence[Proposal], tried: int
    ) -> tuple[list[Contender], list[Contender]]:
        """Laws and free curves beyond chance, the largest linear gain first."""
        taken = {e.name for e in standing.fitted.effects}
        able = [
            one for one in proposals
            if one.score.p * tried <= self.rate and one.score.explained > LEAST_SHARE * evidence.energy
            and (one.name not in taken or law_of(one.name).wave) and one.name not in self.barred
        ]  # fmt: skip
        picked: list[Proposal] = []
        for one in ranked(able, key=lambda one: -one.worth):
            if sum(other.name == one.name for other in picked) < TRIED_A_KIND and len(picked) < TRIED:
                picked.append(one)
        losses = list(in_threads(lambda one: _linear(data, standing, one, evidence.folds), picked))
        gains = [gain(standing.unseen, loss, evidence.folds) for loss in losses]
        order = [k for k in ranked(range(len(picked)), key=lambda k: -gains[k].value) if gains[k].holds]
        found = [Contender(picked[k], losses[k]) for k in order]
        laws = [one for one in found if not one.proposal.name.startswith(UNKNOWN)]
        return laws[:REFITTED], [one for one in found if one.proposal.name.startswith(UNKNOWN)]

    def _believed(
        self, data: Data, standing: Standing, evidence: Evidence, contenders: Sequence[Contender], tried: int
    ) -> list[tuple[Proposal, Standing, Gain]]:
        """Contenders refitted with everything, that still explain enough and to which nothing is objected."""
        both = "two_starts" not in self.ablate

        def stands(one: Contender) -> Standing:
            promised = one.proposal.score.explained / evidence.energy
            return stand(data, refitted(data, standing.fitted, one.proposal, promised, both))

        standings = list(in_threads(stands, contenders))
        found = []
        for (one, _), result in zip(contenders, standings, strict=True):
            own = gain(standing.unseen, result.unseen, evidence.folds)
            share = share_gone(standing.fitted, result.fitted)
            if not own.holds or share < LEAST_SHARE:
                continue
            reason = objection(data, result.fitted, self.reference, self.ablate)
            if reason:
                self.refused.setdefault(one.name, Refused(one.name, reason, share, one.score.p * tried))
                continue
            found.append((one, result, own))
        return found

    def _evidence(self, data: Data, fitted: Fitted, known: Floats) -> Evidence:
        """What candidates are scored against, with what is too small to be one of them."""
        return evidence_of(data, fitted, known, self._negligible_nm)

    @property
    def _negligible_nm(self) -> float:
        return 0.0 if self.reference is None or "least_torque" in self.ablate else self.reference.negligible_nm

    def _pruned(
        self, data: Data, standing: Standing, accepted: list[Accepted], refit: bool = False
    ) -> tuple[Data, Standing, list[Accepted]]:
        """Drop what explains too little now that the others are there, the weakest first; gains are those of today.

        Without `refit` only what is in doubt is judged by a refit of the others, all else by one step of them; but
        what acts on the command has the residual in it, and a step does not show what it can take in.
        """
        refit = refit or any(on_command(effect) for effect in standing.fitted.effects)
        while accepted:
            judged = [self._judged(data, standing, number, note, refit) for number, note in enumerate(accepted)]
            if len(accepted) == 1 and judged[0].share >= LEAST_SHARE:
                # it was judged when it was accepted, at the noise of then: nothing has come since
                return data, standing, [replace(judged[0], p=accepted[0].p or judged[0].p)]
            weakest = None
            for k in ranked(range(len(judged)), key=lambda k: judged[k].gain.value):
                if self._is_idle(judged[k]) and "drop" not in self.ablate:
                    judged[k] = self._judged(data, standing, k, accepted[k], True)
                    if self._is_idle(judged[k]):
                        weakest = k
                        break
            if weakest is None:
                return data, standing, judged
            del accepted[weakest]
            left = [e for k, e in enumerate(standing.fitted.effects) if k != weakest]
            data, standing = renewed(data, fit(data, standing.fitted.physical, left))
        return data, standing, accepted

    def _is_idle(self, note: Accepted) -> bool:
        return not note.gain.holds or note.share < LEAST_SHARE or note.p > self.rate

    def _judged(self, data: Data, standing: Standing, number: int, note: Accepted, refit: bool) -> Accepted:
        """One effect given all others: its gain, share and chance.

        What the first rungs have found is judged beside the laws: a free curve holds a constant too.
        """
        effects = standing.fitted.effects
        aside = [k for k, e in enumerate(effects) if e.name.startswith(UNKNOWN)]
        if law_of(effects[number].name).rung > WAVE_RUNG:
            aside = []
        beside = without(data, standing, aside, refit)
        alone = without(data, standing, [*aside, number], refit)
        place = number - sum(k < number for k in aside)
        return replace(
            note, gain=gain(alone.unseen, beside.unseen, folds_used(data)),
            share=share_gone(alone.fitted, beside.fitted), p=self._chance(data, beside, place, note),
        )  # fmt: skip

    def _chance(self, data: Data, standing: Standing, number: int, note: Accepted) -> float:
        """Of one effect, given all the others that stand; as it was where they leave hardly anything of its columns."""
        own = columns_of(data, standing, number)
        scenes = consistent_scenes(data, standing.fitted.physical, standing.fitted.effects)
        load = data.white(load_rows(data.rows, scenes, standing.fitted.effects[number]))
        others = np.delete(standing.matrix, np.arange(own.start, own.stop), axis=1)
        found = score(self._evidence(data, standing.fitted, others), standing.matrix[:, own], load)
        return min(1.0, found.p * note.tried) if found.rank else note.p


def _beyond_laws(
    standing: Standing, believed: Sequence[tuple[Proposal, Standing, Gain]], free: list[Contender], folds: Folds
) -> list[Contender]:
    """Curves that say more of unseen rows than any law: the others need no fit. Where a law says most of what a curve
    does, the law comes first: the curve may have taken in another effect as well."""
    if not believed:
        return free
    _, law, most = max(believed, key=lambda item: item[2].value)
    return [
        one for one in free
        if gain(law.unseen, one.unseen, folds).holds
        and LAW_OF_CURVE * gain(standing.unseen, one.unseen, folds).value > most.value
    ]  # fmt: skip


def _worse(best: Standing, other: Standing, folds: Folds) -> bool:
    """Whether unseen rows tell the two apart."""
    return best is not other and gain(other.unseen, best.unseen, folds).holds


def _linear(data: Data, standing: Standing, one: Proposal, folds: Folds) -> Floats:
    """Loss of unseen rows with a proposal's columns beside everything, nothing refitted nonlinearly."""
    own = data.white(one.columns)
    prior = np.zeros(standing.matrix.shape[1] + own.shape[1])
    return unseen_loss(standing.fitted.white, np.concatenate([standing.matrix, own], axis=1), folds, prior)


def stand(data: Data, fitted: Fitted) -> Standing:
    """A fit with its sensitivities and unseen losses."""
    matrix = jacobian(data, fitted)
    return Standing(fitted, matrix, unseen(data, fitted, matrix))


def without(data: Data, standing: Standing, numbers: Sequence[int], refit: bool) -> Standing:
    """What stands without some of the effects: all else refitted, or moved by one robust step of least squares."""
    if not numbers:
        return standing
    fitted = standing.fitted
    effects = [e for k, e in enumerate(fitted.effects) if k not in numbers]
    if refit:
        return stand(data, fit(data, fitted.physical, effects))
    gone = [fitted.effects[k] for k in numbers]
    load = torque_of(data, consistent_scenes(data, fitted.physical, fitted.effects), gone)
    own = np.concatenate([np.r_[columns_of(data, standing, k)] for k in numbers])
    others = np.delete(standing.matrix, own, axis=1)
    target = fitted.white + data.white(load)
    left = robust_residual(target, others)
    residual_nm = fitted.residual_nm.copy()
    residual_nm[data.used] = left / data.weight[data.used]
    moved = Fitted(fitted.physical, tuple(effects), float(huber(left).mean()), residual_nm, left)
    return Standing(moved, others, unseen_loss(target, others, folds_used(data)))


def folds_used(data: Data) -> Folds:
    """Folds of the rows that count."""
    return Folds(*(part[data.used] for part in data.rows.folds))


def numbers_of(fitted: Fitted) -> int:
    """Free numbers of all effects."""
    return len(slots_of(fitted.effects, 1.0))


def columns_of(data: Data, standing: Standing, number: int) -> slice:
    """The columns of one effect in the matrix of what is fitted."""
    slots = slots_of(standing.fitted.effects, data.rows.turns)
    own = [k for k, slot in enumerate(slots) if slot.effect == number]
    first = standing.matrix.shape[1] - len(slots)
    return slice(first + own[0], first + own[-1] + 1)


def refitted(data: Data, fitted: Fitted, one: Proposal, promised: float, two_starts: bool) -> Fitted:
    """A proposal refitted with everything, from where the model is; `promised`: share that its columns explain.

    Its best strengths stand beside a change of the base that was not made: it begins with none, and the first step
    makes both. A base that was fitted without the effect bends to take it in, and may not find back from where that
    led: what keeps less than KEPT of its promise is fitted from where the base began, too.
    """
    nothing = replace(one.effect, strengths={name: np.zeros_like(v) for name, v in one.effect.strengths.items()})
    found = fit(data, fitted.physical, [*fitted.effects, nothing], ITERATIONS)
    if not two_starts or one.name.startswith(UNKNOWN) or 1.0 - found.energy / fitted.energy > KEPT * promised:
        return found
    again = fit(data, data.start, [*fitted.effects, one.effect], ITERATIONS)
    return again if again.loss < found.loss else found


def starting_effect(name: str, facts: DriveFacts) -> Effect:
    """A law without strength, at its own shape."""
    law = law_of(name)
    shapes = {p.name: facts.gear_ratio or p.typical if p.name == "ratio" else p.typical for p in law.shapes}
    return Effect(name, shapes, {p.name: np.zeros(1) for p in law.strengths})


def rigid_of(data: Data) -> Data:
    """The data with a rigid base: friction of one level."""
    start = data.start.copy()
    start[NAMES.index("static_nm")] = start[NAMES.index("coulomb_nm")]
    return data._replace(free=RIGID, start=start)


def base_of(data: Data) -> Fitted:
    """The base model alone, fitted from the start at the levels of noise as they are."""
    found = fit(data, data.start, (), LADDER_ITERATIONS)
    for _ in range(ROUNDS):
        before, found = found, fit(at_rest(data, found.physical, ()), found.physical, ())
        if _moved(data, before, found) < SETTLED:
            break
    return found


def settled(data: Data, fitted: Fitted) -> tuple[Data, Standing]:
    """`renewed` until the levels of noise and the model agree."""
    for _ in range(ROUNDS):
        data, standing = renewed(data, fitted)
        change, fitted = _moved(data, fitted, standing.fitted), standing.fitted
        if change < SETTLED:
            break
    return data, standing


def _moved(data: Data, before: Fitted, after: Fitted) -> float:
    """How far a model moved: rms over the rows, in levels of noise, outliers pulled in."""
    return float(np.sqrt(np.mean(clipped(data.white(after.residual_nm - before.residual_nm)) ** 2)))


def renewed(data: Data, fitted: Fitted) -> tuple[Data, Standing]:
    """Levels of noise and balance at rest of the new model, refitted."""
    data = at_rest(data, fitted.physical, fitted.effects)
    begin = evaluate(data, fitted.physical, fitted.effects)[0]
    data = with_levels(data, begin)
    return data, stand(data, fit(data, fitted.physical, fitted.effects))

"""The search, decision by decision: what the ladder takes, who wins a family, what is dropped, and when it stops."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from diagnosis.planted import FACTS, INERTIA, effect, left, nothing, only, planted, runs, started
from diagnosis.planted import begun as planted_begun
from scipy import stats

from fffo_drive.diagnosis import gates, select
from fffo_drive.diagnosis.base import BASE, NAMES, RIGID
from fffo_drive.diagnosis.diagnose import DiagnosisSettings
from fffo_drive.diagnosis.fitting import Fitted, fit, share_gone
from fffo_drive.diagnosis.gates import ReferenceAxis
from fffo_drive.diagnosis.propose import LAW_RUNG, Proposal, Score, Search
from fffo_drive.diagnosis.scored import ScoredFit, base_of, chance, renewed, scored_fit, settled, without
from fffo_drive.diagnosis.select import (
    LAW_OF_CURVE,
    Accepted,
    Contender,
    Selector,
    effect_at_start,
    refitted,
)
from fffo_drive.identification.criterion import SMALLEST_P, Gain, gain

OFFSET_NM = 0.006
WAVE_NM = 0.006
CURVES = frozenset({"curves"})


def constant(motion):
    return np.full(motion.time_s.size, OFFSET_NM)


def wave(motion):
    return WAVE_NM * np.cos(2.0 * np.pi * 5.0 * motion.position_rev)


def waves(motion):
    return wave(motion) + WAVE_NM * np.cos(2.0 * np.pi * 2.0 * motion.position_rev)


def gravity(motion):
    return 0.01 * np.sin(2.0 * np.pi * motion.position_rev)


def drag(motion):
    return 3e-5 * motion.velocity_rps * np.abs(motion.velocity_rps)


def peaked(motion):
    """Of which a wave explains nine tenths, and a curve all."""
    turns = 2.0 * np.pi * 2.0 * motion.position_rev
    return WAVE_NM * (np.cos(turns) + 0.3 * np.cos(3.0 * turns))


LOADS = {f.__name__: f for f in (nothing, constant, wave, waves, gravity, drag, peaked)}


@cache
def begun(load="nothing", *laws, facts=FACTS):
    """Data as a search over these laws begins with them, of two runs, and the first rungs."""
    return at_start(runs(LOADS[load], LOADS[load], duration_s=10.0), *laws, facts=facts)


def at_start(records, *laws, facts=FACTS):
    """The same for other runs."""
    return planted_begun(records, facts, only(*laws) if laws else frozenset())


def bare(load):
    """The same without first rungs."""
    return begun(load, "quadratic_drag")


def data_with(load="nothing"):
    """The data alone."""
    return begun(load)[0]


def selector(*laws, ablate=CURVES, rate=0.01, facts=FACTS):
    """A search over these laws alone."""
    rules = DiagnosisSettings(rate, only(*laws) if laws else frozenset(), frozenset(ablate))
    return Selector(facts, rules, lambda share, text: None)


@cache
def found(load, *laws, ablate=CURVES, rate=0.01):
    """What a search finds on an axis."""
    return selector(*laws, ablate=ablate, rate=rate).run(*begun(load, *laws))


def names(selection):
    return [e.name for e in selection.fitted.effects]


@cache
def at_the_start(load="nothing", *laws):
    """(data, scored, evidence) before the first round, without the ladder."""
    data = data_with(load)
    data, scored = settled(data, base_of(data))
    return data, scored, select.evidence_of(data, scored.fitted, scored.matrix)


# The ladder


def test_the_smallest_set_wins_and_a_constant_torque_before_friction_that_differs_by_direction():
    """While the axis slides both are one constant: the registry's first is taken, the other is its family."""
    selection = found("constant", "torque_offset", "asymmetric_coulomb", "unbalance")
    assert names(selection) == ["torque_offset"]
    (note,) = selection.accepted
    assert selection.fitted.effects[0].strengths["torque_nm"][0] == pytest.approx(OFFSET_NM, rel=0.05)
    assert "asymmetric_coulomb" in note.family or not note.family
    assert note.gain.holds
    assert SMALLEST_P <= note.p < 0.01


def test_without_an_effect_the_ladder_takes_nothing():
    assert names(found("nothing", "torque_offset", "asymmetric_coulomb", "unbalance")) == []


def test_gravity_is_the_ladders():
    selection = found("gravity", "torque_offset", "asymmetric_coulomb", "unbalance")
    assert names(selection) == ["unbalance"]
    wave_nm = selection.fitted.effects[0].strengths
    assert np.hypot(wave_nm["cos_nm"][0], wave_nm["sin_nm"][0]) == pytest.approx(0.01, rel=0.05)
    assert names(found("gravity", "torque_offset")) == []
    few_turns = FACTS.model_copy(update={"gear_ratio": 1000.0})  # less than a quarter of the output's turn
    assert not begun("gravity", "torque_offset", "unbalance", facts=few_turns)[1].accepted


def test_what_is_left_out_is_not_on_the_ladder():
    data, climbed = begun("constant", "unbalance")
    assert not climbed.accepted
    _, scored, accepted = selector("unbalance")._first_rungs(data, climbed)
    assert accepted == []
    assert scored.fitted.effects == ()


def test_what_the_base_can_say_is_none_of_the_ladder():
    """Where all runs turn one way a constant torque and Coulomb friction are one thing."""
    whole = runs(constant, constant, peak_a=0.15, bias_a=0.4, duration_s=10.0)
    inner = slice(1500, -1500)
    one_way = [replace(one, position_rev=one.position_rev[inner], current_a=one.current_a[inner]) for one in whole]
    begin = at_start(one_way, "torque_offset")
    assert not begin[1].accepted
    assert names(selector("torque_offset").run(*begin)) == []
    assert len(selector("torque_offset")._first_rungs(*begun("constant", "torque_offset"))[2]) == 1


def test_a_wave_of_a_single_run_has_a_datum_of_its_own_unless_the_angle_is_absolute():
    (one,) = at_start(runs(wave, duration_s=10.0), "cogging")[1].accepted
    assert effect_at_start(one, 1, absolute=False).per_run == {"cos_nm", "sin_nm"}
    assert effect_at_start(one, 1, absolute=True).per_run == frozenset()
    assert effect_at_start(one, 1, absolute=True).sizes() == []
    assert effect_at_start(one, 1, absolute=False).sizes() == pytest.approx([WAVE_NM], rel=0.1)


# The rounds


def test_a_wave_is_found_among_the_laws_with_its_chance():
    selection = selector("cogging", "quadratic_drag").run(*bare("wave"))
    assert names(selection) == ["cogging"]
    assert selection.fitted.effects[0].shapes["order"] == pytest.approx(5.0, abs=0.01)
    (note,) = selection.accepted
    assert note.tried > 20
    assert note.p <= 1e-6
    assert selection.first_p == pytest.approx(min(one.score.p for one in selection.first) * note.tried)
    assert selection.first[0].name == "cogging"


def test_the_chance_is_over_everything_that_was_tried_and_computed_for_what_stands():
    data, scored, _ = at_the_start("wave")
    fitted = fit(data, scored.fitted.physical, [effect("cogging", {"cos_nm": 0.001, "sin_nm": 0.0}, order=5.0)])
    note = Accepted("cogging", Gain(1.0, 0.1, np.zeros(1)), 0.5, 0.1, (), (), 1000)
    alone, scored = scored, scored_fit(data, fitted)
    assert selector()._chance(data, alone, scored, 0, note.tried) == pytest.approx(2000 * SMALLEST_P)
    for refit in (False, True):
        judged = selector()._judged(data, scored, 0, note, refit, [])
        assert judged.p == pytest.approx(2000 * SMALLEST_P)
    assert without(data, scored, [0], True).fitted.effects == ()
    assert selector()._is_idle(replace(judged, p=0.5))  # by now it may be chance
    (kept,) = selector()._pruned(data, scored, [note])[2]  # alone it was judged when it was accepted
    assert kept.p == note.p


def test_a_full_lag_stands_though_its_strength_is_that_of_the_delay():
    """With all of the torque behind a lag, the column of its strength is that of the delay."""
    lag_s = 0.008
    records = runs(LOADS["wave"], LOADS["wave"], duration_s=10.0, lag_s=lag_s)
    selection = selector("current_lag", "cogging").run(*at_start(records, "current_lag", "cogging"))
    assert sorted(names(selection)) == ["cogging", "current_lag"]
    lag = names(selection).index("current_lag")
    assert selection.fitted.effects[lag].shapes["tau_s"] == pytest.approx(lag_s, rel=0.05)
    assert selection.fitted.effects[lag].strengths["share"][0] == pytest.approx(1.0, abs=0.1)
    assert selection.accepted[lag].p < 1e-6
    assert selection.accepted[lag].variation == 0.0  # a strength that is not determined cannot be said to vary


@pytest.mark.parametrize("numbers", [1, 3])
def test_the_chance_of_what_two_fits_differ_by_is_never_too_small(numbers):
    """Least squares on noise, with a base of four columns and with `numbers` more."""
    data, _, _ = at_the_start()
    chances = []
    for seed in range(200):
        draw = np.random.default_rng([numbers, seed])
        columns, noise = draw.normal(size=(data.used.size, 4 + numbers)), draw.normal(size=data.used.size)
        alone, beside = (
            Fitted(data.start, (), 0.0, left, left)
            for own in (columns[:, :4], columns)
            for left in [noise - own @ np.linalg.lstsq(own, noise)[0]]
        )
        chances.append(chance(data, alone, beside, numbers))
    assert stats.kstest(chances, "uniform", alternative="greater").pvalue > 0.01
    assert np.median(chances) < 0.7


def test_laws_beyond_chance_come_first_and_what_is_barred_is_not_contended():
    data, scored, evidence = at_the_start("waves")
    search = selector()
    proposals = search.search.proposals(data, scored.fitted, evidence, LAW_RUNG)
    first, second = search._contenders(data, scored, evidence, proposals, search.search.tried)[0][:2]
    best = first.proposal.effect
    less = [one._replace(score=one.score._replace(p=1.0)) if one.effect is best else one for one in proposals]
    now = search._contenders(data, scored, evidence, less, search.search.tried)[0]
    assert now[0].proposal.name == second.proposal.name
    search = selector("cogging")
    search.barred.add("cogging")
    assert "cogging" not in {one.proposal.name for one in search._contenders(data, scored, evidence, proposals, 1)[0]}


def test_what_explains_less_than_a_share_of_what_is_left_is_none():
    data, scored, evidence = at_the_start("wave")
    search = selector("cogging")
    proposals = search.search.proposals(data, scored.fitted, evidence, LAW_RUNG)
    (one,) = proposals
    small = one._replace(score=one.score._replace(explained=0.019 * evidence.energy))
    assert search._contenders(data, scored, evidence, [small], 1)[0] == []
    large = one._replace(score=one.score._replace(explained=0.021 * evidence.energy))
    assert len(search._contenders(data, scored, evidence, [large], 1)[0]) == 1


def test_no_more_are_refitted_than_are_allowed_and_two_of_a_kind():
    data, scored, evidence = at_the_start("wave")
    search = selector("cogging", "torque_ripple", "friction_ripple", "periodic_disturbance", "quadratic_drag")
    (one,) = [
        p for p in search.search.proposals(data, scored.fitted, evidence, LAW_RUNG)
        if p.name == "cogging"
    ]  # fmt: skip
    same, _ = search._contenders(data, scored, evidence, [one] * 5, 1)
    assert len(same) == select.TRIED_A_KIND
    kinds = [one._replace(name=name) for name in ("cogging", "unbalance", "torque_ripple")] * 2
    many, _ = search._contenders(data, scored, evidence, kinds, 1)
    assert len(many) == select.REFITTED


def believed(data, scored, *laws):
    """(proposal, scored, gain) of models that leave these losses: `laws` are (name, rung, numbers, loss a row)."""
    rows = data.used.size
    items = []
    for name, rung, count, loss in laws:
        shapes = {"order": 5.0} if name == "cogging" else {}
        strengths = [p.name for p in select.law_of(name).strengths][:count]
        own = effect(name, dict.fromkeys(strengths, 1e-4), **shapes)
        unseen = scored.unseen - loss + 0.01 * np.sin(0.1 * np.arange(rows))
        proposal = Proposal(name, name, rung, own, np.zeros((1, 1)), Score(1.0, np.zeros(1), 1, 1e-9))
        model = ScoredFit(scored.fitted._replace(effects=(own,)), scored.matrix, unseen)
        items.append((proposal, model, gain(scored.unseen, unseen, data.folds)))
    return items


@pytest.fixture
def round_of(monkeypatch):
    """The choice of one round among given models, nothing refitted: (name, family, rivals)."""

    def choose(*laws):
        data, scored, _ = at_the_start()
        search = selector("quadratic_drag")
        items = believed(data, scored, *laws)
        monkeypatch.setattr(search, "_contenders", lambda *a: ([1], []))
        monkeypatch.setattr(search, "_believed", lambda d, s, e, contenders, t: items if contenders else [])
        monkeypatch.setattr(search, "_contradicted", lambda *a: False)
        monkeypatch.setattr(search, "_pruned", lambda d, s, accepted: (d, s, accepted))
        monkeypatch.setattr(select, "objection", lambda *a: "")
        monkeypatch.setattr(select, "renewed", lambda d, f: (d, next(m for _, m, _ in items if m.fitted is f)))
        result = search._round(data, scored, [], LAW_RUNG)
        return None if result is None else (result[2][0].name, result[2][0].family, result[2][0].rivals)

    return choose


def test_in_a_family_the_lower_rung_wins_and_then_fewer_numbers(round_of):
    name, family, rivals = round_of(("quadratic_drag", 3, 1, 0.2), ("cogging", 2, 2, 0.2))
    assert name == "cogging"
    assert family == ("quadratic_drag",)
    assert [rival for rival, _ in rivals] == ["quadratic_drag"]
    assert round_of(("cogging", 3, 2, 0.2), ("quadratic_drag", 3, 1, 0.2))[0] == "quadratic_drag"
    assert round_of(("torque_offset", 3, 1, 0.2), ("quadratic_drag", 3, 1, 0.20001))[0] == "quadratic_drag"


def test_in_a_family_the_form_of_the_friction_wins_even_over_a_lower_rung(round_of):
    name, family, _ = round_of(("cogging", 2, 2, 0.2), ("stribeck_shape", 3, 1, 0.2))
    assert (name, family) == ("stribeck_shape", ("cogging",))


def test_a_law_that_says_most_of_what_a_curve_does_comes_first():
    """0.2 nats a row of a law: a curve with 0.25 waits, one with 0.5 does not, and one that is no better is no use."""
    data, scored, _ = at_the_start()
    laws = believed(data, scored, ("quadratic_drag", 3, 1, 0.2))
    curves = [Contender(None, scored.unseen - loss) for loss in (0.25, 0.5, 0.19)]
    folds = data.folds
    assert select._beyond_laws(scored, laws, curves, folds) == [curves[1]]
    assert select._beyond_laws(scored, [], curves, folds) == curves
    assert LAW_OF_CURVE * 0.25 < 0.2


def test_what_unseen_rows_tell_apart_is_no_family(round_of):
    name, family, _ = round_of(("quadratic_drag", 3, 1, 0.3), ("cogging", 2, 2, 0.1))
    assert name == "quadratic_drag"
    assert family == ()


def test_a_round_without_anything_believed_is_the_end_of_a_rung(round_of):
    assert round_of() is None


def test_an_effect_to_which_something_is_objected_is_refused_with_the_reason(monkeypatch):
    monkeypatch.setattr(select, "objection", lambda data, fitted, reference, ablate: "implausible for a machine")
    selection = selector("cogging").run(*bare("wave"))
    assert names(selection) == []
    (refused,) = selection.refused
    assert (refused.name, refused.reason) == ("cogging", "implausible for a machine")
    assert refused.p < 0.01


def test_a_wave_swallows_no_command_and_is_not_asked_whether_it_shrinks_the_axis(monkeypatch):
    monkeypatch.setattr(gates, "shrinking", lambda data, fitted, reference: "it shrinks")
    assert names(selector("cogging").run(*bare("wave"))) == ["cogging"]
    assert names(selector("quadratic_drag").run(*bare("drag"))) == []


def test_what_becomes_misshapen_once_the_noise_is_that_of_the_new_model_is_refused(monkeypatch):
    monkeypatch.setattr(select, "implausibility", lambda data, fitted, reference, ablate: "implausible for a machine")
    selection = selector("cogging").run(*bare("wave"))
    assert names(selection) == []
    assert [(one.name, one.reason) for one in selection.refused] == [("cogging", "implausible for a machine")]


def test_no_more_effects_than_are_allowed(monkeypatch):
    assert names(found("waves", "cogging")) == ["cogging", "cogging"]
    monkeypatch.setattr(select, "MOST_EFFECTS", 1)
    assert names(selector("cogging").run(*bare("waves"))) == ["cogging"]


def test_a_curve_stands_only_where_it_says_more_than_any_law():
    law = selector("cogging", ablate=frozenset()).run(*bare("wave"))
    assert names(law) == ["cogging"]
    assert any(one.name == "unknown:motor_angle" and one.score.p < 0.01 / law.accepted[0].tried for one in law.first)
    free = found("wave", "torque_offset", ablate=frozenset())
    assert names(free)[0] == "unknown:motor_angle"
    assert not names(found("wave", "torque_offset"))


@pytest.mark.parametrize(
    ("load", "law", "stand"),
    [
        ("wave", "cogging", ["cogging"]),
        ("peaked", "cogging", ["cogging"]),
        ("waves", "cogging", ["cogging", "cogging"]),
        ("waves", "unbalance", ["unknown:motor_angle"]),
    ],
)
def test_laws_take_the_place_of_a_curve_where_together_they_have_most_of_its_gain(load, law, stand):
    """Of all, and of nine tenths of what the curve explains; two that have half of it each; and none."""
    before = found(load, "torque_offset", ablate=frozenset())
    assert names(before)[0] == "unknown:motor_angle"
    search = selector(law, ablate=())
    scored = scored_fit(before.data, before.fitted)
    _, after, accepted = search._replaced_curves(before.data, scored, list(before.accepted))
    assert [e.name for e in after.fitted.effects][: len(stand)] == stand
    assert [note.name for note in accepted] == [e.name for e in after.fitted.effects]
    assert (after is scored) == (law == "unbalance")


def test_no_more_laws_are_tried_for_a_curve_than_are_allowed(monkeypatch):
    monkeypatch.setattr(select, "LAWS_FOR_CURVE", 1)
    before = found("waves", "torque_offset", ablate=frozenset())
    scored = scored_fit(before.data, before.fitted)
    search = selector("cogging", ablate=())
    assert search._replaced_curves(before.data, scored, list(before.accepted))[1] is scored


def test_what_a_curve_over_another_laws_axis_is_judged_beside():
    curve = found("wave", "torque_offset", ablate=frozenset()).fitted.effects[0]
    over_speed = replace(curve, name="unknown:velocity")
    laws = [
        effect("quadratic_drag", {"drag_nm_per_rps2": 1e-6}),
        effect("torque_ripple", {"cos_share": 0.1}, order=5.0),
    ]
    effects = (*laws, effect("cogging", {"cos_nm": 1e-3}, order=5.0), curve, over_speed)
    scored = ScoredFit(Fitted(np.zeros(1), effects, 1.0, np.zeros(1), np.zeros(1)), np.zeros((1, 1)), np.zeros(1))
    assert [select._set_aside(scored, k) for k in range(5)] == [[], [], [3, 4], [], []]
    assert [select._set_aside(scored, k, own_axis=True) for k in range(5)] == [[4], [3], [3, 4], [], []]


def test_a_law_that_is_needed_beside_a_curve_over_its_axis_is_judged_without_it():
    data, _, _ = at_the_start("waves")
    curve = found("waves", "torque_offset", ablate=frozenset()).fitted.effects[0]
    ripple = effect("friction_ripple", {"cos_share": 0.05, "sin_share": 0.0}, order=3.0)
    both = scored_fit(data, fit(data, data.start, [ripple, curve], iterations=8))
    note = Accepted("friction_ripple", Gain(1.0, 0.1, np.zeros(1)), 0.0, 0.1, (), (), 10)
    beside, alone = (
        selector()._judged(data, both, 0, note, True, select._set_aside(both, 0, own_axis))
        for own_axis in (False, True)
    )
    assert beside.share != pytest.approx(alone.share)
    apart = [fit(data, both.fitted.physical, effects) for effects in ((), (both.fitted.effects[0],))]
    assert alone.share == pytest.approx(share_gone(*apart))


def test_a_curve_is_held_where_only_a_datum_is_fitted():
    selection = found("wave", "torque_offset", ablate=frozenset())
    curve = selection.fitted.effects[0]
    strengths = {"cos_nm": np.full(2, 1e-4), "sin_nm": np.zeros(2)}
    wave = replace(effect("cogging", {}, order=3.0), strengths=strengths, per_run=frozenset(strengths))
    own = fit(selection.data, selection.fitted.physical, [wave, curve], datum_alone=True)
    assert own.effects[1] is curve
    assert (own.effects[0].strengths["cos_nm"] != 1e-4).all()


def test_chance_is_judged_after_the_refit_of_a_law_and_before_that_of_a_curve(monkeypatch):
    """Beside a base that is biased without it a law may look like chance; a curve is the same before and after."""
    proposals = Search.proposals

    def poor(self, data, fitted, evidence, rung, names=None):
        found = proposals(self, data, fitted, evidence, rung, names)
        return [one._replace(score=one.score._replace(p=1.0)) for one in found]

    monkeypatch.setattr(Search, "proposals", poor)
    selection = selector("cogging").run(*bare("wave"))
    assert names(selection) == ["cogging"]
    assert selection.accepted[0].p < 0.01  # that of the refit
    assert names(selector("torque_offset", ablate=()).run(*bare("wave"))) == []
    monkeypatch.setattr(select.Selector, "_chance", lambda self, data, alone, beside, number, tried: 1.0)
    assert names(selector("cogging").run(*bare("wave"))) == []


def test_a_drag_is_found_though_the_base_has_bent_to_take_it_in():
    data, scored, _ = at_the_start("drag")
    own = effect("quadratic_drag", {"drag_nm_per_rps2": 1e-6})
    one = Proposal("quadratic_drag", "quadratic_drag", 3, own, np.zeros((1, 1)), Score(1.0, np.zeros(1), 1, 0.0))
    _, kept = renewed(data, refitted(data, scored.fitted, one, promised=1.0, two_starts=True))
    assert kept.fitted.effects[0].strengths["drag_nm_per_rps2"][0] == pytest.approx(3e-5, rel=0.1)


def test_the_reference_of_the_gates_is_the_axis_by_the_first_rungs():
    search = selector("torque_offset", "cogging")
    search.run(*begun("constant", "torque_offset", "cogging"))
    assert isinstance(search.reference, ReferenceAxis)
    assert search.reference.inertia_nm_s2_per_rev == pytest.approx(INERTIA, rel=0.02)
    assert [e.name for e in search.ladder.fitted.effects] == ["torque_offset"]


# Dropping


def pruned(load, *effects, ablate=CURVES):
    data, scored, _ = at_the_start(load)
    fitted = fit(data, scored.fitted.physical, effects, iterations=8)
    notes = [Accepted(e.name, Gain(9.0, 1.0, np.zeros(1)), 1e-9, 0.5, (), (), 1) for e in effects]
    return selector(ablate=ablate)._pruned(data, scored_fit(data, fitted), notes)


def test_a_surplus_effect_is_dropped_when_a_better_one_is_there_and_gains_are_those_of_today():
    surplus = effect("stribeck_shape", {"bump_nm": 1e-4}, speed_rps=3.0)
    true = effect("torque_offset", {"torque_nm": OFFSET_NM})
    for order in ((surplus, true), (true, surplus)):
        _, scored, accepted = pruned("constant", *order)
        assert [e.name for e in scored.fitted.effects] == ["torque_offset"]
        assert [note.name for note in accepted] == ["torque_offset"]
        assert accepted[0].gain.value > 100.0
        assert accepted[0].share > 0.3
    _, scored, _ = pruned("constant", surplus, true, ablate=CURVES | {"drop"})
    assert len(scored.fitted.effects) == 2


def test_the_last_effect_goes_as_well_where_nothing_is_left_of_it():
    _, scored, accepted = pruned("nothing", effect("torque_offset", {"torque_nm": 1e-5}))
    assert accepted == []
    assert scored.fitted.effects == ()


def test_what_gains_among_the_outliers_takes_away_what_the_loss_falls_by():
    """Rare rows far out count straight, not square: taking them away at a small cost of the bulk is a gain."""
    data, scored, _ = at_the_start()
    far = np.zeros(scored.fitted.residual_nm.size)
    far[data.used[::10]] = 0.02
    before = left(data, scored.fitted, far)
    after = left(data, scored.fitted, 0.2 * scored.fitted.residual_nm)
    assert after.energy > before.energy - 9.0 * 0.1 * data.used.size
    assert share_gone(before, after) == pytest.approx(1.0 - after.loss / before.loss)
    assert share_gone(before, after) > 0.3


# What comes back


def test_the_friction_of_the_whole_base_comes_back_where_unseen_rows_ask_for_it():
    whole = data_with()
    rigid = select.rigid_of(whole)
    scored = scored_fit(rigid, fit(rigid, rigid.start, ()))
    freed, better = selector()._freed(whole, rigid, scored)
    assert (rigid.free, freed.free) == (RIGID, BASE)
    assert better.fitted.physical[NAMES.index("static_nm")] == pytest.approx(0.04, rel=0.1)
    linear = FACTS.model_copy(update={"units": "linear"})
    assert selector(facts=linear)._freed(whole, rigid, scored)[0] is rigid


# Runs that contradict each other


def of_two_payloads(ratio):
    first, second = planted(seed=1, name="a"), planted(seed=2, name="b", begin_s=14.0)
    third = planted(seed=3, name="c", begin_s=28.0, inertia=ratio * INERTIA)
    return [first, second, third]


def test_runs_of_another_inertia_contradict_each_other_and_the_search_stops():
    laws = ("torque_offset", "quadratic_drag", "cogging", "asymmetric_viscous")
    selection = selector(*laws).run(*at_start(of_two_payloads(1.34), *laws))
    ratios = np.array(selection.inertia_ratios)
    assert names(selection) == []
    assert ratios.size == 3
    assert 1.15 < ratios[2] / ratios[0] < 1.4  # outliers are pulled in: it is understated
    assert ratios[1] / ratios[0] == pytest.approx(1.0, rel=0.02)


def test_runs_of_one_inertia_and_a_single_run_contradict_nothing():
    assert found("wave", "cogging", "quadratic_drag").inertia_ratios == ()
    alone = at_start([planted(duration_s=10.0)], "quadratic_drag")
    assert selector("quadratic_drag").run(*alone).inertia_ratios == ()


def test_an_inertia_that_differs_by_less_than_counts_is_no_contradiction(monkeypatch):
    monkeypatch.setattr(select, "CONTRADICTION_SHARE", 0.5)
    selection = selector("quadratic_drag").run(*at_start(of_two_payloads(1.34), "quadratic_drag"))
    assert selection.inertia_ratios == ()


def test_an_effect_that_explains_unseen_rows_better_than_an_inertia_for_each_run_is_no_contradiction():
    data = started(of_two_payloads(1.34))
    data, scored = settled(data, base_of(data))
    evidence = select.evidence_of(data, scored.fitted, scored.matrix)
    search = selector()
    poor = believed(data, scored, ("quadratic_drag", 3, 1, 0.01))
    good = believed(data, scored, ("quadratic_drag", 3, 1, 0.9 * float(scored.unseen.mean())))
    assert search._contradicted(data, scored, evidence, poor)
    assert not selector()._contradicted(data, scored, evidence, [*poor, *good])


# Refits


def test_a_law_is_refitted_from_where_the_base_began_as_well():
    """A base that was fitted without it has bent: a Stribeck curve ten times as wide and four times as high."""
    data, scored, _ = at_the_start("drag")
    bent = scored.fitted.physical.copy()
    for name, factor in (("static_nm", 4.0), ("stribeck_velocity_rps", 10.0), ("attraction_nm_per_rev", 0.02)):
        bent[select.NAMES.index(name)] *= factor
    data = data._replace(start=scored.fitted.physical)
    far, _ = select.evaluate(data, bent, ())
    own = effect("quadratic_drag", {"drag_nm_per_rps2": 1e-6})
    one = Proposal("quadratic_drag", "quadratic_drag", 3, own, np.zeros((1, 1)), Score(1.0, np.zeros(1), 1, 0.0))
    both, single = (refitted(data, far, one, 0.99, two_starts) for two_starts in (True, False))
    assert both.loss < 0.9 * single.loss
    kept = refitted(data, far, one, 0.0, True)  # it keeps what its columns promised: one start will do
    assert kept.loss == single.loss


def test_strengths_that_are_far_out_do_not_spoil_a_fit():
    """With the base projected out they may be any size along what the base can do by itself."""
    data, scored, _ = at_the_start("constant")
    own = effect("torque_offset", {"torque_nm": 50.0})
    one = Proposal("torque_offset", "torque_offset", 0, own, np.zeros((1, 1)), Score(1.0, np.zeros(1), 1, 0.0))
    assert refitted(data, scored.fitted, one, 0.5, False).loss < scored.fitted.loss

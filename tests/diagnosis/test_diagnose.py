"""The whole diagnosis on an axis whose truth is known: found by name, proven on runs apart, in one report."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from diagnosis.planted import DELAY_S, FACTS, INERTIA, based, effect, nothing, only, planted, runs
from shared_data import shared_files

from fffo_drive.diagnosis.base import NAMES
from fffo_drive.diagnosis.channels import channels
from fffo_drive.diagnosis.diagnose import (
    MECHANISMS,
    DiagnosisSettings,
    cautions,
    diagnose,
    judged,
    physical_of,
    verdict_of,
)
from fffo_drive.diagnosis.fitting import Fitted, fit, jacobian
from fffo_drive.diagnosis.results import Number, Rest, report
from fffo_drive.identification.dataset import DataError, Record
from fffo_drive.model.parameters import read_model, write_model
from fffo_drive.units import inertia_nm_s2_per_rev

OFFSET_NM = 0.006
WAVE_NM = 0.005
QUICK = DiagnosisSettings(
    without=only("torque_offset", "asymmetric_coulomb", "cogging", "quadratic_drag"), ablate=frozenset({"curves"})
)
REST = Rest(2e-3, 1e-3, None, ("velocity",), "half of it goes with velocity")


def planted_load(motion):
    return OFFSET_NM + WAVE_NM * np.cos(2.0 * np.pi * 5.0 * motion.position_rev)


def turned(motion):
    """An offset of the other sign: what was learnt does not carry over to it."""
    return -planted_load(motion)


@cache
def found(load=planted_load, unseen=planted_load, held_out_seed=31):
    """The diagnosis of two runs, proven on a third."""
    return diagnose(
        runs(load, load, duration_s=9.0), runs(unseen, seed=held_out_seed, duration_s=9.0), FACTS, settings=QUICK
    )


def named(diagnosis):
    return [finding.name for finding in diagnosis.findings if finding.accepted]


def test_what_was_planted_is_named_with_its_numbers_and_proven_on_a_run_apart():
    page = found()
    assert page.verdict == "effects_found"
    assert sorted(named(page)) == ["cogging", "torque_offset"]
    assert all(name in page.headline for name in named(page))
    numbers = {n.name: n for finding in page.findings for n in finding.parameters}
    assert numbers["torque_nm"].value == pytest.approx(OFFSET_NM, rel=0.05)
    assert numbers["torque_nm"].sd < 0.05 * OFFSET_NM
    assert numbers["order"].value == pytest.approx(5.0, abs=0.01)
    assert page.after.torque_rms_nm.value < 0.3 * page.before.torque_rms_nm.value
    assert page.after.velocity_rms_rps.value < page.before.velocity_rms_rps.value
    for finding in page.findings:
        assert finding.false_alarm_probability <= 0.01
        assert finding.gain[0] > 2.0 * finding.gain[1]
        assert finding.held_out_gain[0] > 0.0
        assert finding.picture.curves
        assert "nats" in finding.reason
    assert page.unexplained_rest is None


def test_held_out_runs_never_influence_the_choice():
    """Other held-out runs, even those of another machine, give the same effects and numbers on the same fit runs."""
    one, other, opposite = found(), found(held_out_seed=47), found(unseen=turned)
    for page in (other, opposite):
        assert [f.name for f in page.findings] == [f.name for f in one.findings]
        assert [n.value for f in page.findings for n in f.parameters] == [
            n.value for f in one.findings for n in f.parameters
        ]
        assert page.fit_after == one.fit_after
    assert other.after != one.after


def test_what_does_not_carry_over_is_the_headline_and_no_model_is_offered():
    page = found(unseen=turned)
    assert page.verdict == "nothing_carries_over"
    assert page.headline.startswith("No finding carries over")
    assert named(page) == []
    assert page.model_after is None
    assert all(finding.reason.startswith("does not carry over") for finding in page.findings)


def geared(motion):
    """An offset, and a wave that is no order of the motor: it stands above the ladder."""
    return OFFSET_NM + WAVE_NM * np.cos(2.0 * np.pi * 4.7 * motion.position_rev)


def out_of_step(motion):
    """The same offset with the wave half a period further: only the offset carries over."""
    return 2.0 * OFFSET_NM - geared(motion)


def test_where_only_the_first_rungs_carry_over_they_stand_alone():
    learnt, page = found(geared, geared), found(geared, out_of_step)
    assert sorted(named(learnt)) == ["cogging", "torque_offset"]
    assert page.verdict == "effects_found"
    assert named(page) == ["torque_offset"]
    refused = next(finding for finding in page.findings if finding.name == "cogging")
    assert refused.reason.startswith("does not carry over: ")
    assert "cogging" not in page.headline
    assert [effect.name for effect in page.model_after.effects] == ["torque_offset"]
    assert page.after.torque_rms_nm.value < page.before.torque_rms_nm.value
    assert page.unexplained_rest is not None  # the wave


def test_where_nothing_is_nothing_is_found():
    page = found(nothing, nothing)
    assert page.verdict == "no_effect_found"
    assert page.findings == ()
    assert page.after == page.before
    assert page.model_after.effects == []


def test_without_held_out_runs_that_is_said():
    page = diagnose(runs(nothing, duration_s=9.0), [], FACTS, settings=QUICK)
    assert page.before is None
    assert any("no held-out run" in text for text in page.cautions)


def test_the_report_is_json_with_all_its_keys():
    for page in (found(), found(unseen=turned), found(nothing, nothing)):
        content = json.loads(json.dumps(report(page)))
        assert set(content) == {
            "format", "tool", "verdict", "headline", "effects", "friction_form", "before", "after", "unexplained_rest",
            "runs_look", "first_p", "ceiling", "units", "false_alarm_rate", "runs", "channels", "tried", "cautions",
            "settings", "seconds", "prior",
        }  # fmt: skip
        assert content["runs"] == {"fit": ["run-1", "run-2"], "held_out": ["run-31"]}
    content = report(found())
    assert set(content["effects"][0]) == {
        "name", "alternatives", "axis", "parameters", "explained_fraction", "false_alarm_probability", "accepted",
        "reason", "regime", "experiment", "compensable", "strength_percent", "sd", "units", "gain", "held_out_gain",
        "rivals", "before", "after", "symbols", "torque_rms_nm", "plain_name", "cause", "remedy", "place", "confidence",
        "doubt", "strength_variation",
    }  # fmt: skip
    assert set(content["before"]["held_out"]) == {
        "torque_rms_nm", "torque_relative_percent", "velocity_rms_rps", "interval_95", "seconds",
    }  # fmt: skip
    assert content["tried"]


def test_the_model_is_read_again_as_it_was_written(tmp_path):
    page = found()
    write_model(tmp_path / "model.yaml", page.model_after)
    again = read_model(tmp_path / "model.yaml")
    assert sorted(e.name for e in again.effects) == ["cogging", "torque_offset"]
    assert inertia_nm_s2_per_rev(again.inertia_kg_m2.value) == pytest.approx(INERTIA, rel=0.02)
    physical = physical_of(again)
    assert physical[NAMES.index("delay_s")] == pytest.approx(DELAY_S, abs=2e-4)
    assert physical[:9] == pytest.approx(physical_of(page.model_after)[:9])
    further = diagnose(runs(planted_load, seed=5, duration_s=9.0), [], FACTS, again, QUICK)  # it may begin from it
    assert inertia_nm_s2_per_rev(further.model_after.inertia_kg_m2.value) == pytest.approx(INERTIA, rel=0.02)


def test_progress_is_reported_and_goes_up_to_one():
    shares = []
    diagnose(
        runs(nothing, duration_s=9.0), [], FACTS, settings=QUICK, progress=lambda share, text: shares.append(share)
    )
    assert shares == sorted(shares)
    assert shares[0] == 0.0
    assert shares[-1] == 1.0


def accepted(*names, held_out_gain=(5.0, 1.0)):
    """Findings that stand, by name."""
    template = next(f for f in found().findings if f.name == "torque_offset")
    return [template.__class__(**{**vars(template), "name": n, "held_out_gain": held_out_gain}) for n in names]


OF_INERTIA = "The runs contradict each other: the inertia is not the same in all of them."


@pytest.mark.parametrize(
    ("names", "worse", "rest", "remarks", "verdict", "words"),
    [
        ((), "", None, (), "no_effect_found", "No effect found"),
        ((), "", REST, (), "unexplained", REST.sentence),
        (("cogging",), "", None, (), "effects_found", "The model lacks: cogging."),
        (("cogging", "torque_offset"), "", None, (), "effects_found", "cogging, torque_offset"),
        (
            ("second_surface",),
            "",
            None,
            (),
            "no_effect_found",
            "No effect found. The friction is not that of a single",
        ),
        (("second_surface",), "", REST, (), "unexplained", "a single surface: second_surface."),
        (
            ("cogging", "second_surface"),
            "",
            None,
            (),
            "effects_found",
            "lacks: cogging. The friction is not that of",
        ),
        (("cogging",), "", REST, (), "effects_found", f"Not explained: {REST.sentence}"),
        (("cogging",), "", None, (OF_INERTIA,), "unexplained", OF_INERTIA),
        ((), "", REST, (OF_INERTIA,), "unexplained", REST.sentence),
        ((), "it is no smaller", None, (), "nothing_carries_over", "on the held-out runs it is no smaller"),
        ((), "it is no smaller", REST, (OF_INERTIA,), "nothing_carries_over", REST.sentence),
    ],
)
def test_the_verdict_by_what_was_found(names, worse, rest, remarks, verdict, words):
    word, headline = verdict_of(accepted(*names), worse, rest, remarks)
    assert word == verdict
    assert words in headline


def test_what_does_not_lower_the_held_out_error_is_no_headline():
    page = [*accepted("cogging"), *accepted("quadratic_drag", held_out_gain=(-3.0, 1.0))]
    assert verdict_of(page, "", None, ())[1] == "The model lacks: cogging."
    with_alternative = accepted("cogging")[0]
    object.__setattr__(with_alternative, "alternatives", ("unbalance", "torque_ripple"))
    assert "cogging (or unbalance or torque_ripple)" in verdict_of([with_alternative], "", None, ())[1]


def test_what_is_in_doubt_is_no_cause():
    """It stays in the model and is named apart; without another finding the drive is not explained."""
    sure, doubtful = accepted("cogging")[0], replace(accepted("quadratic_drag")[0], doubt="it does not stand out")
    beside = "In the model, but uncertain as a cause: quadratic_drag."
    assert verdict_of([sure, doubtful], "", None, ()) == ("effects_found", f"The model lacks: cogging. {beside}")
    for rest in (REST, None):
        word, headline = verdict_of([doubtful], "", rest, ())
        assert word == "unexplained"
        assert headline.endswith(beside)
        assert (REST.sentence in headline) == (rest is not None)
    assert sure.confidence != "cannot tell"
    assert doubtful.confidence == "cannot tell"


def warming(motion):
    """A constant torque that comes in the second half of a run."""
    return np.where(motion.time_s > 0.5 * (motion.time_s[0] + motion.time_s[-1]), 2.0 * OFFSET_NM, 0.0)


def test_a_law_that_fits_half_of_the_time_leaves_a_residual_that_depends_on_time():
    page = found(warming, warming)
    assert named(page) == ["torque_offset"]
    assert "time" in page.unexplained_rest.axes
    assert page.unexplained_rest.sentence in page.headline
    (offset,) = report(page)["effects"]
    assert offset["confidence"] == "cannot tell"
    assert 0.8 < offset["strength_variation"] < 1.1  # none in one half, twice its mean in the other
    assert not any(f.doubt for f in found().findings)


def doubts(*findings, rest=None):
    """What is in doubt of findings of one model, each given by name and what differs from a plain one.

    A plain one is confirmed by held-out runs, but not so clearly that it stands whatever remains.
    """
    made = [replace(accepted(f["name"], held_out_gain=(3.0, 1.0))[0], **f) for f in findings]
    return [one.doubt for one in judged(made, rest)]


HALF = REST._replace(rms_nm=1.0, floor_nm=0.5**0.5)  # half of what is left


def test_what_does_not_stand_out_from_what_no_law_explains_is_in_doubt():
    """A share of 1/2 removes as much as the model leaves; a cause removes more than nothing named accounts for."""
    little, enough = ({"name": "torque_offset", "explained_fraction": share} for share in (0.33, 0.34))
    wave = {"name": "cogging", "explained_fraction": 0.9}
    assert "does not stand out" in doubts(little, wave, rest=HALF)[0]
    assert doubts(enough, wave, rest=HALF) == ["", ""]
    assert doubts(little, wave) == ["", ""]
    # a curve has no cause: beside one that removes as much as the model leaves, a law must remove more than that
    curve = {"name": "unknown:time", "explained_fraction": 0.5, "held_out_gain": (9.0, 1.0)}
    low, high = ({"name": "torque_offset", "explained_fraction": share} for share in (0.49, 0.51))
    assert "does not stand out" in doubts(low, curve)[0]
    assert doubts(high, curve) == ["", ""]
    assert "does not stand out" in doubts(enough, curve, rest=HALF)[0]


def wave(name, order, torque_rms_nm):
    """A steady wave that held-out runs show clearly."""
    order = Number("order", order, 1e-3, "1/rev")
    return replace(
        accepted(name, held_out_gain=(30.0, 1.0))[0],
        parameters=(order,),
        torque_rms_nm=torque_rms_nm,
        strength_variation=0.05,
    )


@pytest.mark.parametrize(
    ("order", "torque_rms_nm", "doubted"), [(3.003, 5e-4, True), (6.0, 5e-4, False), (3.003, 3e-3, False)]
)
def test_a_wave_is_in_doubt_beside_a_much_larger_one_of_another_kind_at_its_order(order, torque_rms_nm, doubted):
    ripple, small = wave("friction_ripple", 3.0, 6e-3), wave("cogging", order, torque_rms_nm)
    for findings in ([ripple, small], [small, ripple]):
        found = {one.name: one.doubt for one in judged(findings, None)}
        assert found["friction_ripple"] == ""
        assert ("may be part of that" in found["cogging"]) == doubted


@pytest.mark.parametrize(("torque_rms_nm", "doubted"), [(5e-4, True), (3e-3, False)])
def test_a_curve_over_the_angle_is_in_doubt_beside_a_much_larger_wave(torque_rms_nm, doubted):
    curve = wave("unknown:motor_angle", 3.0, torque_rms_nm)
    curve = replace(curve, parameters=(), axis="motor_angle", explained_fraction=0.6)
    ripple = replace(wave("friction_ripple", 3.0, 6e-3), axis="motor_angle")
    assert ["may be part of that" in one.doubt for one in judged([ripple, curve], None)] == [False, doubted]
    elsewhere = replace(curve, name="unknown:velocity", axis="velocity")
    assert [one.doubt for one in judged([ripple, elsewhere], None)] == ["", ""]


def test_harmonics_of_one_kind_stand_beside_each_other():
    """LAAS: cogging of order 72, and of 18 and 144 with a twentieth of it."""
    found = judged([wave("cogging", order, size) for order, size in ((72.0, 4e-3), (18.0, 2e-4), (144.0, 2e-4))], None)
    assert [one.doubt for one in found] == ["", "", ""]


def test_nothing_is_certain_where_the_position_itself_is_at_fault():
    sure = accepted("cogging", held_out_gain=(30.0, 1.0))
    assert [one.doubt for one in judged(sure, None)] == [""]
    fault = "the position of run-1 is at fault"
    found = judged(sure, None, fault)
    assert [one.doubt for one in found] == [fault]
    assert verdict_of(found, "", None, [fault]) == ("unexplained", f"{fault}.")


def test_a_doubt_does_not_feed_itself():
    """A law that is clear of the rest stays so beside a doubtful law that removes nearly as much."""
    first = {"name": "friction_ripple", "explained_fraction": 0.4}  # removes 0.67; more than 0.5 is needed
    second = {"name": "cogging", "explained_fraction": 0.3}  # removes 0.43
    assert [bool(why) for why in doubts(first, second, rest=HALF)] == [False, True]


def test_a_steady_law_that_held_out_runs_show_clearly_is_a_cause_whatever_remains():
    """EMPS' constant force varies by 4 % and gains 9.5 standard deviations; beside it more has no name than it has."""
    curve = {"name": "unknown:velocity", "explained_fraction": 0.9, "held_out_gain": (9.0, 1.0)}
    law = {"name": "torque_offset", "explained_fraction": 0.1, "held_out_gain": (4.1, 1.0), "strength_variation": 0.15}
    assert doubts(law, curve, rest=HALF) == ["", ""]
    for less in ({"strength_variation": 0.16}, {"held_out_gain": (3.9, 1.0)}, {"held_out_gain": None}):
        assert "does not stand out" in doubts(law | less, curve, rest=HALF)[0]
    assert "does not stand out" in doubts(law | {"name": "unknown:time"}, curve, rest=HALF)[0]


def test_a_curve_that_held_out_runs_show_less_clearly_does_not_count_against_a_law():
    """EMPS' pulses: the viscous friction gains 753 nats on the other file, a curve over the position 186."""
    law = {"name": "asymmetric_viscous", "explained_fraction": 0.49, "strength_variation": 0.18}
    curve = {"name": "unknown:output_angle", "explained_fraction": 0.5, "held_out_gain": (186.0, 22.0)}
    assert doubts(law | {"held_out_gain": (753.0, 106.0)}, curve) == ["", ""]
    assert "does not stand out" in doubts(law | {"held_out_gain": (185.0, 20.0)}, curve)[0]
    assert "does not stand out" in doubts(law | {"held_out_gain": None}, curve)[0]


def test_what_varies_from_place_to_place_is_in_doubt_by_law_or_curve():
    for name in ("quadratic_drag", "torque_offset", "unknown:velocity"):
        finding = {"name": name, "explained_fraction": 0.9, "held_out_gain": (9.0, 1.0)}
        assert doubts({**finding, "strength_variation": 0.34}) == [""]
        (why,) = doubts({**finding, "strength_variation": 0.36})
        assert "its strength varies by 36 %" in why


def test_what_the_held_out_runs_excite_and_do_not_confirm_is_in_doubt():
    error = found().before
    other = replace(error, torque_rms_nm=error.torque_rms_nm._replace(high=0.99 * error.torque_rms_nm.low))
    unconfirmed = {"explained_fraction": 0.9, "held_out_gain": (1.0, 1.0)}
    excited = {"regime_before": error, "regime_after": error}
    for name in ("unknown:velocity", "quadratic_drag"):
        finding = {"name": name, **unconfirmed, "regime_before": None, "regime_after": None}
        assert doubts(finding | excited) == ["the held-out runs do not confirm it"]
        # hardly excited: a curve that held-out runs do not confirm names nothing
        assert doubts(finding) == ["the held-out runs do not confirm it" if name.startswith("unknown") else ""]
        assert doubts(finding | {"held_out_gain": None}) == [""]  # nothing held out
        assert doubts(finding | excited | {"held_out_gain": (2.0, 1.0)}) == [""]
        assert doubts(finding | excited | {"regime_after": other}) == [""]  # the error is smaller where it acts


def test_runs_of_another_inertia_are_reported_in_headline_and_cautions():
    records = [planted(seed=1, name="a"), planted(seed=2, name="b", begin_s=14.0, inertia=1.34 * INERTIA)]
    page = diagnose(records, [], FACTS, settings=QUICK)
    assert page.verdict == "unexplained"
    assert named(page) == []
    assert "contradict each other" in page.headline
    assert any("inertia" in text for text in page.cautions)


def test_runs_that_contradict_each_other_by_themselves_are_the_headline():
    """A measured servo; two of three runs have a feed-forward torque that their logs lack. None differs in inertia
    alone: 20 % of the torque remains, which is smooth and which nothing predicts.
    """
    fit = [measured(f"Lorenz_{name}_1") for name in ("Jm", "Bm", "Fc")]
    page = diagnose(fit, [measured("Lorenz_Bm_5")], FACTS.model_copy(update={"torque_constant_nm_per_a": 1.0}))
    assert page.verdict == "unexplained"
    assert "contradict each other" in page.headline
    assert "% of the torque is smooth and unexplained" in page.headline
    assert sum("contradict each other: inertia" in text for text in page.cautions) == 1


def measured(name):
    """A run of the servo: position in rad, torque in Nm."""
    (path,) = shared_files(f"measured/lorenz/{name}.txt")
    rows = np.loadtxt(path)
    return Record(
        name=name,
        path=path,
        period_s=0.001,
        torque_constant_nm_per_a=1.0,
        current_a=rows[:, 4],
        measured_current_a=None,
        position_rev=rows[:, 0] / (2.0 * np.pi),
        velocity_rps=None,
        reference_rps=None,
        lsb_rev=1e-4,
        breaks=(),
        digest="",
        begin_s=0.0,
    )


def test_a_delay_is_a_note_and_never_a_finding():
    _, base = based(runs(nothing, duration_s=9.0))
    late = FACTS.model_copy(update={"nominal_delay_s": 0.0})
    for facts, count in ((late, 1), (FACTS.model_copy(update={"nominal_delay_s": 0.002}), 0), (FACTS, 0)):
        texts = cautions(facts, None, [], [object()], base)
        assert sum("delay" in text for text in texts) == count
    relative = FACTS.model_copy(update={"absolute_angle": False})
    wave = effect("cogging", {"cos_nm": 1e-3, "sin_nm": 0.0}, order=3.0)
    object.__setattr__(wave, "per_run", frozenset({"cos_nm", "sin_nm"}))
    own = Fitted(base.physical, (wave,), 1.0, base.residual_nm, base.white)
    assert any("homed angle" in text for text in cautions(relative, None, [], [object()], own))
    assert not any("homed angle" in text for text in cautions(FACTS, None, [], [object()], own))


def test_no_runs_are_refused_in_a_sentence():
    with pytest.raises(DataError, match="no runs"):
        diagnose([], [], FACTS)


def test_runs_that_are_too_short_are_refused_in_a_sentence():
    with pytest.raises(DataError, match="long enough"):
        diagnose([planted(duration_s=0.5)], [], FACTS)


def test_what_is_switched_off_and_left_out_is_in_the_report():
    page = found()
    assert page.settings["ablate"] == ["curves"]
    assert "cogging" not in page.settings["without"]
    assert "elasticity" in page.settings["without"]
    assert "curves" in MECHANISMS


def test_a_residual_over_one_axis_is_seen_there_and_gone_with_its_effect():
    data, base = based(runs(lambda motion: np.full(motion.time_s.size, OFFSET_NM), duration_s=9.0))
    fitted = fit(data, base.physical, [effect("torque_offset", {"torque_nm": OFFSET_NM})])
    lives = {
        c.name: c for c in channels(data, (base, jacobian(data, base)), (fitted, jacobian(data, fitted)), rate=0.01)
    }
    assert lives["velocity"].explained_before > 0.5
    assert lives["velocity"].explained_after < 0.2
    assert {"time", "motor_angle", "travel_since_reversal"} <= set(lives)
    assert any(" x " in name for name in lives)

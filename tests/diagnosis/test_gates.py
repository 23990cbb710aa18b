"""What a machine cannot be is refused with the reason, and the truth is not: each false model is planted by hand."""

from functools import cache

import numpy as np
import pytest
from diagnosis.planted import INERTIA, KT, based, effect, runs

from fffo_drive.diagnosis.base import NAMES, moved
from fffo_drive.diagnosis.fitting import evaluate, fit, jacobian
from fffo_drive.diagnosis.gates import (
    DETERMINED_SD,
    SHOWN_SHARE,
    ReferenceAxis,
    needed_rms_nm,
    objection,
    shown_share,
    shrinking,
)
from fffo_drive.diagnosis.scenes import Effect
from fffo_drive.model.effects.registry import LAWS

OFFSET_NM = 0.006
NONE = frozenset[str]()
LAG_S = 0.012  # slower than any current loop's plausible lag


def constant(motion):
    return np.full(motion.time_s.size, OFFSET_NM)


@cache
def axis(lag_s=0.0):
    """(data, base with its constant torque, reference) of an axis; with a lag the current is measured."""
    data, base = based(runs(constant, constant, duration_s=8.0, lag_s=lag_s))
    fitted = fit(data, base.physical, [effect("torque_offset", {"torque_nm": 0.0})])
    return data, fitted, ReferenceAxis.of(data, fitted, jacobian(data, fitted))


def judged(one, physical=None, lag_s=0.0, ablate=NONE):
    """The objection to a model with one more effect, evaluated and not fitted."""
    data, fitted, reference = axis(lag_s)
    model, _ = evaluate(data, fitted.physical if physical is None else physical, [*fitted.effects, one])
    return objection(data, model, reference, ablate)


def test_nothing_is_objected_to_the_truth():
    data, fitted, reference = axis()
    assert objection(data, fitted, reference, NONE) == ""
    assert objection(data, fitted, None, NONE) == ""
    assert judged(effect("cogging", {"cos_nm": 0.003, "sin_nm": 0.0}, order=3.0)) == ""
    assert judged(effect("elasticity", {"share": 0.3}, frequency_hz=40.0, damping=0.05)) == ""


@pytest.mark.parametrize(
    ("one", "words"),
    [
        (effect("elasticity", {"share": 0.3}, frequency_hz=142.0, damping=2.0), "damping 2"),
        (effect("elasticity", {"share": 0.3}, frequency_hz=40.0, damping=0.1999), "damping"),
        (effect("current_lag", {"share": 0.9}, tau_s=0.48), "tau_s 0.48 s"),
        (effect("current_lag", {"share": 0.9}, tau_s=0.00499), "tau_s"),
        (effect("current_lag", {"share": 1.7}, tau_s=0.002), "share 1.7"),
    ],
)
def test_a_shape_that_no_machine_has_is_refused(one, words):
    assert "implausible for a machine" in judged(one)
    assert words in judged(one)
    assert "implausible for a machine" not in judged(one, ablate=frozenset({"shapes"}))


def test_a_strength_may_be_a_little_beyond_for_its_noise():
    assert judged(effect("current_lag", {"share": 1.05}, tau_s=0.002)) == ""
    assert judged(effect("current_lag", {"share": 1.2}, tau_s=0.002)) != ""


@pytest.mark.parametrize("size_rev", [0.0499, 0.1])
def test_a_strength_on_its_bound_is_refused_in_whatever_run(size_rev):
    strengths = {"cos1_rev": np.array([1e-3, size_rev]), "sin1_rev": np.array([1e-3, 1e-3])}
    two = Effect("resolver_error", {}, strengths, frozenset(strengths))
    assert f"cos1_rev {size_rev:.3g} rev" in judged(two)
    strengths["cos1_rev"] = np.array([1e-3, 2e-3])
    assert judged(Effect("resolver_error", {}, strengths, frozenset(strengths))) == ""


@pytest.mark.parametrize("name", [name for name, law in LAWS.items() if not law.in_base])
def test_what_a_law_begins_with_is_no_bound(name):
    law = LAWS[name]
    strengths = {p.name: np.array([p.typical]) for p in law.strengths}
    assert "implausible" not in judged(Effect(name, {p.name: p.typical for p in law.shapes}, strengths))


def test_what_the_measured_current_shows_to_be_missing_is_still_needed():
    """A dead zone of a third of the command is no axis that shrinks, where the current shows it."""
    data, fitted, _ = axis(LAG_S)
    unmeasured = data._replace(stretches=[stretch._replace(measured_a=None) for stretch in data.stretches])
    zone = fitted._replace(effects=(*fitted.effects, effect("dead_zone", {"lost_nm": 0.02}, width_a=0.02 / KT)))
    assert needed_rms_nm(unmeasured, zone) == pytest.approx(needed_rms_nm(data, fitted))
    assert needed_rms_nm(data, zone) > 1.2 * needed_rms_nm(data, fitted)


def test_a_lag_within_what_a_current_loop_can_be_is_not_refused_where_no_current_was_measured():
    assert judged(effect("current_lag", {"share": 1.0}, tau_s=0.002)) == ""


def test_the_measured_current_tells_whether_a_lag_is_real():
    """There a time constant may be any, and what the current does not show is refused however plausible it is."""
    true = effect("current_lag", {"share": 1.0}, tau_s=LAG_S)
    data, fitted, _ = axis(LAG_S)
    assert shown_share(data, fitted, true) > 0.9
    assert judged(true, lag_s=LAG_S) == ""
    for false in (
        effect("current_lag", {"share": -1.0}, tau_s=LAG_S),
        effect("current_lag", {"share": 1.0}, tau_s=0.3),
        effect("voltage_limit", {"share": 0.9}, stall_nm=0.1, no_load_rps=30.0),
    ):
        assert shown_share(data, fitted, false) < SHOWN_SHARE
        assert "the measured current does not confirm it" in judged(false, lag_s=LAG_S, ablate=frozenset({"shapes"}))
        assert "current" not in judged(false, lag_s=LAG_S, ablate=frozenset({"shapes", "current", "shrink"}))
    assert judged(effect("cogging", {"cos_nm": 0.003}, order=3.0), lag_s=LAG_S) == ""  # it acts on the axis


def test_without_a_measured_current_nothing_is_said_of_what_it_shows():
    data, fitted, _ = axis()
    assert shown_share(data, fitted, fitted.effects[0]) is None


def test_a_limit_of_the_voltage_needs_the_measured_current():
    limit = effect("voltage_limit", {"share": 0.5}, stall_nm=0.2, no_load_rps=40.0)
    assert "a log with the measured current would decide" in judged(limit)
    assert "measured current" not in judged(limit, ablate=frozenset({"current"}))


@pytest.mark.parametrize("factor", [0.1, 0.6, 1.6])
def test_an_effect_that_buys_its_error_with_another_inertia_is_refused(factor):
    _, fitted, _ = axis()
    wave = effect("quadratic_drag", {"drag_nm_per_rps2": 1e-7})
    other = moved(fitted.physical, "inertia_nm_s2_per_rev", float(np.log(factor)))
    assert "changing the axis" in judged(wave, other)
    assert "times" in judged(wave, other)
    assert judged(wave, other, ablate=frozenset({"shrink"})) == ""
    near = moved(fitted.physical, "inertia_nm_s2_per_rev", float(np.log(1.0 + 0.5 * (factor - 1.0))))
    assert factor < 0.5 or "changing the axis" not in judged(wave, near)


def test_a_rigid_axis_may_have_seen_the_inertia_of_the_motor_alone():
    """Behind a joint with half of the inertia the first rungs see between J / 2 and J."""
    _, fitted, _ = axis()
    spring = effect("elasticity", {"share": 0.5}, frequency_hz=40.0, damping=0.05)
    for factor, words in ((0.6, "changing the axis"), (1.6, ""), (2.9, ""), (3.1, "changing the axis")):
        refusal = judged(spring, moved(fitted.physical, "inertia_nm_s2_per_rev", float(np.log(factor))))
        assert (words in refusal) if words else refusal == ""


def test_an_inertia_that_the_data_do_not_determine_is_no_reference():
    data, fitted, reference = axis()
    assert reference.inertia_sd < DETERMINED_SD
    assert reference.inertia_nm_s2_per_rev == pytest.approx(INERTIA, rel=0.02)
    light, _ = evaluate(data, moved(fitted.physical, "inertia_nm_s2_per_rev", -0.5), fitted.effects)
    assert shrinking(data, light, reference) != ""
    assert shrinking(data, light, reference._replace(inertia_sd=2.0 * DETERMINED_SD)) == ""
    assert objection(data, light, reference, NONE) == ""  # a constant torque swallows no command


def test_a_share_of_an_inertia_that_the_data_do_not_determine_is_not_believed():
    data, fitted, reference = axis()
    spring = effect("elasticity", {"share": 0.3}, frequency_hz=40.0, damping=0.05)
    model, _ = evaluate(data, fitted.physical, [*fitted.effects, spring])
    assert objection(data, model, reference, NONE) == ""
    unsure = reference._replace(inertia_sd=2.0 * DETERMINED_SD)
    assert "an inertia that the data do not determine" in objection(data, model, unsure, NONE)


def test_where_a_force_balance_gives_another_inertia_the_data_do_not_determine_it():
    _, _, reference = axis()
    assert reference.beside(reference.inertia_nm_s2_per_rev) == reference
    light = reference.beside(0.2 * reference.inertia_nm_s2_per_rev)
    assert light.inertia_sd == pytest.approx(np.log(5.0))
    assert not light.inertia_is_determined


@pytest.mark.parametrize(
    ("name", "strengths", "shape"),
    [
        ("cogging", ("cos_nm", "sin_nm"), "order"),
        ("position_dependent_friction", ("cos_share", "sin_share"), "period_rev"),
    ],
)
def test_a_wave_of_which_the_data_show_less_than_a_period_is_none(name, strengths, shape):
    data, _, _ = axis()
    for periods, words in ((0.9, "less than one"), (1.1, "")):
        period_rev = data.rows.turns / periods
        value = 1.0 / period_rev if shape == "order" else period_rev
        refusal = judged(effect(name, {key: 0.01 for key in strengths}, **{shape: value}))
        assert (words in refusal) if words else refusal == ""


def test_an_axis_that_needs_less_torque_is_refused_also_where_its_inertia_is_not_determined():
    data, fitted, reference = axis()
    physical = fitted.physical.copy()
    for name in ("inertia_nm_s2_per_rev", "coulomb_nm", "static_nm", "viscous_nm_per_rps"):
        physical[NAMES.index(name)] *= 0.3
    small, _ = evaluate(data, physical, fitted.effects)
    refusal = shrinking(data, small, reference._replace(inertia_sd=1.0))
    assert "shrinking the axis" in refusal
    assert "%" in refusal


def test_the_torque_that_is_needed_is_that_of_the_axis_and_of_what_acts_on_it():
    data, fitted, reference = axis()
    rows = data.rows
    command = np.concatenate([rows.filter.rows(s.current_a * KT) for s in data.stretches])[data.used]
    assert reference.needed_nm == pytest.approx(np.sqrt(np.mean(command**2)), rel=0.02)
    bare = needed_rms_nm(data, fitted._replace(effects=()))
    lagging = (*fitted.effects, effect("current_lag", {"share": 1.0}, tau_s=0.3))
    assert needed_rms_nm(data, fitted._replace(effects=lagging)) == pytest.approx(reference.needed_nm)
    assert bare != pytest.approx(reference.needed_nm, rel=1e-4)

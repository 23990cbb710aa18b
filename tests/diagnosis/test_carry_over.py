"""What carries over from run to run, what balances friction at rest, and where a rare residual lives."""

from dataclasses import replace

import numpy as np
import pytest
from fffo_drive.diagnosis.candidates import Effect
from fffo_drive.diagnosis.free_curves import free_trials
from fffo_drive.diagnosis.removal import backward
from fffo_drive.diagnosis.selection import Contest, Selection, beside, evidence_of
from fffo_drive.diagnosis.tables import with_table
from fffo_drive.diagnosis.transfer import Transfer, of_one_size, transfer
from fffo_drive.diagnosis.where import where
from identification.rig import random_plant, record
from identification.synthetic import PERIOD_S

from fffo_drive.diagnosis.diagnose import prepared
from fffo_drive.diagnosis.fitting import at_rest, evaluate, huber_terms, refit
from fffo_drive.diagnosis.startup import fit_base
from fffo_drive.drive.simulated.parameters import EffectConfig
from fffo_drive.identification.excitation import identification_sequence, separating_recipe
from fffo_drive.identification.facts import DriveFacts

FACTS = DriveFacts(torque_constant_nm_per_a=0.148, rated_current_a=8.3, gear_ratio=160.0, resolver_bits=15)
OFFSET_NM = 0.004  # drives the plant; a law is what is taken away: it finds the negative


@pytest.fixture(scope="module")
def offset_axis():
    """Two runs of an axis with an offset, and the base fitted without one: (data, base, sensitivities)."""
    plant = replace(
        random_plant(5), roughness_nm=2e-4, effects=(EffectConfig("torque_offset", {"torque_nm": OFFSET_NM}),)
    )
    runs = [
        record(plant, identification_sequence(16.0, PERIOD_S, 0.5, 1.1, 0.1, 10.0), "identify"),
        record(plant, separating_recipe(PERIOD_S, 12.0, 80.0, 1), "recipe"),
    ]
    stretches, rows, start = prepared(runs, FACTS, None)
    return fit_base(stretches, rows, start, len(runs))


def effect(name, strengths, **shapes):
    return Effect(name, shapes, {key: np.array([value]) for key, value in strengths.items()})


@pytest.mark.slow
def test_a_torque_at_rest_is_taken_from_what_friction_balances(offset_axis):
    data, base, _ = offset_axis
    plain = at_rest(data, base.physical, ())
    loaded = at_rest(data, base.physical, [effect("torque_offset", {"torque_nm": -OFFSET_NM})])
    for before, after in zip(plain.stretches, loaded.stretches, strict=True):
        assert np.allclose(before.balance_nm - after.balance_nm, -OFFSET_NM)


@pytest.mark.slow
def test_what_is_real_carries_over_to_a_run_that_did_not_teach_it(offset_axis):
    data, base, matrix = offset_axis
    fitted = refit(data, matrix, base.physical, [effect("torque_offset", {"torque_nm": -0.001})])
    assert fitted.effects[0].strengths["torque_nm"][0] == pytest.approx(-OFFSET_NM, rel=0.1)
    found = transfer(data, matrix, fitted, base)
    assert found.folds >= 1
    assert found.holds
    assert found.left_out > 0.7 * found.fitted > 0.0


@pytest.mark.slow
def test_what_only_fills_the_gaps_of_its_own_runs_does_not(offset_axis):
    """Twelve free windows along the travel take the noise of these runs with them."""
    data, base, matrix = offset_axis
    low, high = np.quantile(data.rows.position_rev, (0.02, 0.98))
    windows = [
        effect("position_dependent_friction", {"window_share": 0.0}, centre_rev=float(c), width_rev=(high - low) / 12.0)
        for c in np.linspace(low, high, 12)
    ]
    offset = effect("torque_offset", {"torque_nm": -OFFSET_NM})
    without = refit(data, matrix, base.physical, [offset])
    fitted = refit(data, matrix, without.physical, [*without.effects, *windows], shapes=False)
    assert fitted.loss < without.loss
    assert not transfer(data, matrix, fitted, without).holds


@pytest.mark.slow
def test_a_weak_companion_goes_and_what_carries_over_stays(offset_axis):
    data, base, matrix = offset_axis
    middle = float(np.median(data.rows.position_rev))
    window = effect("position_dependent_friction", {"window_share": 0.01}, centre_rev=middle, width_rev=0.5)
    fitted = refit(data, matrix, base.physical, [window, effect("torque_offset", {"torque_nm": -OFFSET_NM})])
    left, numbers = backward(data, matrix, fitted, [0.0, 0.0], 0.01)
    assert [e.name for e in left.effects] == ["torque_offset"]
    assert numbers == [1]
    none, numbers = backward(data, matrix, left, [0.5], 0.01)  # what noise might have made goes, too
    assert (none.effects, numbers) == ((), [])


@pytest.mark.slow
def test_a_curve_that_stands_against_the_base_does_not_spoil_the_fit(offset_axis):
    """Strengths with the base projected out may be any size along what the base can do by itself."""
    data, base, matrix = offset_axis
    evidence, scenes = evidence_of(data, matrix, base)
    curve = next(t for t in free_trials(evidence, scenes) if t.name == "unknown:velocity")
    viscous = {name: curve.shapes["x" + name[1:]] for name in curve.effect.strengths}
    far = replace(curve.effect, strengths={name: v + 0.1 * viscous[name] for name, v in curve.effect.strengths.items()})
    assert evaluate(data, base.physical, [far])[0].loss > 10.0 * base.loss
    assert beside(data, matrix, base, curve._replace(effect=far)).loss < base.loss


def test_a_wave_keeps_its_phases_and_takes_one_size():
    phases, sizes = np.array([0.0, 1.0, 2.0]), np.array([3.0, 0.5, 2.0])
    strengths = {"cos_nm": sizes * np.cos(phases), "sin_nm": sizes * np.sin(phases)}
    wave = Effect("cogging", {"order": 4.0}, strengths, frozenset(strengths))
    assert wave.sizes() == pytest.approx([2.0])
    equal = wave.of_sizes(wave.sizes())
    assert equal.strengths["cos_nm"] == pytest.approx(2.0 * np.cos(phases))
    assert equal.strengths["sin_nm"] == pytest.approx(2.0 * np.sin(phases))
    assert effect("torque_offset", {"torque_nm": 1.0}).waves == []


@pytest.mark.slow
def test_three_waves_of_three_sizes_are_not_one_effect(offset_axis):
    data, base, matrix = offset_axis
    sizes = np.array([0.004, 0.0])
    wave = Effect(
        "unbalance", {"ratio": 1.0}, {"cos_nm": sizes, "sin_nm": np.zeros(2)}, frozenset({"cos_nm", "sin_nm"})
    )
    fitted = evaluate(data, base.physical, [wave])[0]
    assert of_one_size(data, fitted, 0).effects[0].strengths["cos_nm"] == pytest.approx([0.002, 0.002])
    offset = evaluate(data, base.physical, [effect("torque_offset", {"torque_nm": -OFFSET_NM})])[0]
    assert of_one_size(data, offset, 0) is offset


def test_nothing_is_held_against_an_effect_that_no_run_can_be_left_out_for():
    assert Transfer(0.0, 0.0, 0).holds
    assert not Transfer(1.0, 10.0, 2).holds


def test_the_loss_of_a_row_is_square_within_the_limit_and_straight_beyond():
    terms = huber_terms(np.array([0.0, -2.0, 10.0]))
    assert np.allclose(terms, [0.0, 4.0, 4.0 * (20.0 - 4.0)])


@pytest.mark.slow
def test_a_residual_over_two_axes_and_one_after_rests_are_seen_where_they_are(offset_axis):
    data, base, matrix = offset_axis
    fitted = refit(data, matrix, base.physical, [effect("torque_offset", {"torque_nm": -OFFSET_NM})])
    clean, scenes = evidence_of(data, matrix, fitted)
    rows = data.rows
    corner = np.sign(rows.velocity_rps) * np.sign(rows.position_rev - np.median(rows.position_rev))
    both = fitted._replace(residual_nm=fitted.residual_nm + 0.002 * corner)
    lives = where((evidence_of(data, matrix, both)[0], clean), scenes, 0.01)
    found = {c.name: c for c in lives.beyond}
    pair = found["output_angle x velocity"]
    assert pair.significant_before
    assert pair.explained_before > 0.3
    assert pair.explained_before == max(c.explained_before for c in found.values())
    assert not pair.significant_after
    assert {"break_away", "reversal", "jerk"} <= set(found)


@pytest.mark.slow
def test_a_residual_over_one_axis_is_seen_there_and_gone_with_it(offset_axis):
    """As a share of the residual that it is of, before and after alike."""
    data, base, matrix = offset_axis
    fitted = refit(data, matrix, base.physical, [effect("torque_offset", {"torque_nm": -OFFSET_NM})])
    clean, scenes = evidence_of(data, matrix, fitted)
    bumps = 0.002 * np.cos(2.0 * np.pi * data.rows.position_rev / (0.5 * np.ptp(data.rows.position_rev)))
    bumpy = evidence_of(data, matrix, fitted._replace(residual_nm=fitted.residual_nm + bumps))[0]
    found = {c.name: c for c in where((bumpy, clean), scenes, 0.01).axes}
    angle = found["output_angle"]
    assert angle.explained_before > 0.6
    assert angle.explained_before == max(c.explained_before for c in found.values())
    assert angle.significant_before
    assert not angle.significant_after
    assert angle.explained_after < 0.05


@pytest.mark.slow
def test_one_axis_alone_makes_no_table(offset_axis):
    data, base, matrix = offset_axis
    fitted = refit(data, matrix, base.physical, [effect("torque_offset", {"torque_nm": -OFFSET_NM})])
    contest = Contest("torque_offset", {"torque_offset": 1.0}, {})
    given = Selection(data, base, fitted, matrix, (contest,), (1e-9,), (), (), None)
    assert with_table(given, 0.01, lambda share: None) is given


@pytest.mark.slow
def test_the_model_at_hand_is_evaluated_as_it_was_fitted(offset_axis):
    data, base, matrix = offset_axis
    fitted = refit(data, matrix, base.physical, [effect("torque_offset", {"torque_nm": -OFFSET_NM})])
    again, _ = evaluate(data, fitted.physical, fitted.effects)
    assert np.array_equal(again.residual_nm, fitted.residual_nm)
    assert again.loss == fitted.loss

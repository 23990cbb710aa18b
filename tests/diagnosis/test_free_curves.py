"""What is in no list, on plants that share no line with the search: which curve it is, and what the curve says."""

import numpy as np
import pytest
from diagnosis.test_tables import FACTS, axis_with
from fffo_drive.diagnosis.candidates import Effect, effect_rows
from fffo_drive.diagnosis.free_curves import free_trials
from fffo_drive.diagnosis.selection import beside, evidence_of
from fffo_drive.diagnosis.transfer import transfer
from fffo_drive.diagnosis.visited import taught

from fffo_drive.diagnosis.base import NAMES
from fffo_drive.diagnosis.fitting import consistent_scenes, loaded_sensitivities, refit
from fffo_drive.drive.simulated.parameters import EffectConfig
from fffo_drive.model.effects.laws.lookup import BRAKE, WOUND

AMPLITUDE_NM = 0.012
CABLE = {"torque_nm": 0.01, "reach_rev": 1.5}


def found_in(*effects):
    """(data, base, sensitivities, evidence, free curves) of an axis."""
    data, base, matrix = axis_with(*effects)
    evidence, scenes = evidence_of(data, matrix, base)
    return data, base, matrix, evidence, free_trials(evidence, scenes)


@pytest.fixture(scope="module")
def dragged():
    """Friction that helps in one half of the output turn and hinders in the other."""
    return found_in(EffectConfig("odd_direction_angle", {"amplitude_nm": AMPLITUDE_NM, "phase_rev": 0.1}))


def curve(effect):
    """(places, values) of a curve."""
    count = int(effect.shapes["count"])
    return tuple(
        np.array([values(f"{axis}{k:02d}") for k in range(count)])
        for axis, values in (("x", effect.shapes.get), ("y", lambda name: float(effect.strengths[name][0])))
    )


@pytest.mark.slow
def test_a_drag_over_the_output_angle_is_found_as_one(dragged):
    data, base, matrix, evidence, trials = dragged
    assert trials[0].name == "unknown:output_angle"
    assert trials[0].shapes["kind"] == BRAKE
    assert trials[0].explained > 0.8 * evidence.energy
    found = refit(data, matrix, base.physical, [trials[0].effect])
    places_rev, values_nm = curve(found.effects[0])
    inside = (places_rev > np.quantile(data.rows.position_rev, 0.1)) & (
        places_rev < np.quantile(data.rows.position_rev, 0.9)
    )
    wanted_nm = AMPLITUDE_NM * np.cos(2.0 * np.pi * (places_rev / FACTS.gear_ratio + 0.1))
    level = np.mean((values_nm - wanted_nm)[inside])  # the Coulomb level of the base takes up a constant
    assert values_nm[inside] - level == pytest.approx(wanted_nm[inside], abs=0.15 * AMPLITUDE_NM)


@pytest.mark.slow
def test_a_cable_that_winds_up_and_slips_is_found_as_a_memory_of_the_travel():
    _, _, _, evidence, trials = found_in(EffectConfig("odd_cable", CABLE))
    assert trials[0].name == "unknown:memory"
    assert trials[0].shapes["kind"] == WOUND
    assert trials[0].explained > 0.6 * evidence.energy
    reaches_rev, pulls_nm = curve(trials[0].effect)
    near = (reaches_rev > CABLE["reach_rev"] / 3.0) & (reaches_rev < 3.0 * CABLE["reach_rev"])
    assert pulls_nm[near].sum() == pytest.approx(CABLE["torque_nm"], rel=0.25)


@pytest.mark.slow
def test_a_curve_carries_over_to_a_run_and_is_not_asked_where_no_other_run_was(dragged):
    data, base, matrix, _, trials = dragged
    fitted = refit(data, matrix, base.physical, [trials[0].effect])
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    step, position_rev = data.rows.laws.step, data.rows.position_rev
    low, high = np.quantile(position_rev[data.rows.kept], (0.2, 0.5))
    teaching = data.rows.kept & (position_rev > low) & (position_rev < high)
    known = taught(fitted.effects, scenes, step, teaching)
    places_rev, _ = curve(fitted.effects[0])
    reach_rev = float(np.diff(places_rev).max())
    assert known[teaching].mean() > 0.95
    assert not known[(position_rev < low - reach_rev) | (position_rev > high + reach_rev)].any()
    assert taught(fitted.effects, scenes, step, data.rows.kept)[data.rows.kept].mean() > 0.99
    offset = Effect("torque_offset", {}, {"torque_nm": np.array([1e-3])})
    assert taught([offset], scenes, step, teaching).all()
    over_time = next(t.effect for t in trials if t.name == "unknown:time")  # it does not come back: asked everywhere
    assert taught([over_time], scenes, step, teaching).all()
    assert transfer(data, matrix, fitted, base).carries(0.7)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["unknown:memory", "unknown:output_angle", "unknown:frequency"])
def test_the_columns_of_a_curve_are_its_law(dragged, name):
    data, base, _, _, trials = dragged
    trial = next(t for t in trials if t.name == name)
    strengths = np.array([trial.effect.strengths[key][0] for key in trial.columns.names])
    along = effect_rows(consistent_scenes(data, base.physical, ()), trial.effect, data.rows.laws)
    assert along == pytest.approx(trial.columns.values @ strengths, abs=1e-9)


@pytest.mark.slow
def test_where_the_base_has_bent_beyond_return_a_rival_is_fitted_from_its_start(dragged):
    """A Stribeck curve a tenth as wide and eight times as high: from there no step leads back."""
    data, base, matrix, _, trials = dragged
    straight = refit(data, matrix, base.physical, [trials[0].effect])
    bent = base.physical.copy()
    for name, factor in (("static_nm", 8.0), ("stribeck_velocity_rps", 0.1), ("attraction_nm_per_rev", 0.02)):
        bent[NAMES.index(name)] *= factor
    matrix = loaded_sensitivities(data, bent, ())
    stuck = refit(data, matrix, bent, [trials[0].effect])
    far = refit(data, matrix, bent, (), iterations=8)
    promising = trials[0]._replace(explained=0.9 * float(far.white @ far.white))
    found = beside(data, matrix, far, promising)
    assert stuck.loss > 2.0 * straight.loss
    assert found.loss < 1.1 * straight.loss

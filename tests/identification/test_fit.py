"""The whole fit on a simulated axis whose truth is known: its own friction, current loop, resolver and noise."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from identification.rig import PERIOD_S, random_plant, record, truth
from identification.synthetic import TRUTH, chirp_record, record_of

from fffo_drive.drive.simulated.parameters import delay_budget
from fffo_drive.identification.coordinates import MODEL_PARAMETERS, PARAMETERS
from fffo_drive.identification.dataset import DataError
from fffo_drive.identification.excitation import identification_sequence, separating_recipe
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.identification.fit import FitSettings, _warnings, fit_records, sensor_delay
from fffo_drive.identification.results import model_file, report
from fffo_drive.model.parameters import read_model, write_model

FACTS = DriveFacts(torque_constant_nm_per_a=0.148, rated_current_a=8.3, gear_ratio=160.0)
LIMITS = dict.fromkeys(MODEL_PARAMETERS, 0.03) | {"stiffness_per_rev": 0.1, "stribeck_exponent": 0.1}


def excited(plant):
    chirp = identification_sequence(40.0, PERIOD_S, 0.4, 1.1, 0.05, 10.0)
    return [
        record(plant, chirp, "identify"),
        record(plant, separating_recipe(PERIOD_S, 14.0, 150.0, 1), "recipe"),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 8])
def test_the_truth_is_found(seed):
    plant = random_plant(seed)
    expected = truth(plant)
    fit = fit_records(excited(plant), FitSettings(compare_literal=False), facts=FACTS)
    assert fit.solution.converged
    assert fit.effects == ()
    assert fit.warnings == ()
    assert fit.uncertainty.doubts == ()
    for k, name in enumerate(MODEL_PARAMETERS):
        assert fit.physical[k] == pytest.approx(expected[name], rel=LIMITS[name]), name
        assert abs(fit.physical[k] - expected[name]) < 5.0 * fit.uncertainty.sd[k], name
        assert fit.uncertainty.sd[k] < 0.05 * abs(expected[name]), name
    # end to end, with the hold and the lag of the drive's velocity: what the plant was told
    budget = delay_budget(plant)
    assert fit.sensor_delay_s == pytest.approx(budget.tracking_loop_s, rel=0.05)
    whole_s = fit.value("delay_s") + budget.hold_s + fit.sensor_delay_s
    assert whole_s == pytest.approx(plant.delay_s, rel=0.03)


@pytest.mark.slow
def test_the_models_own_motion_is_fitted_exactly_and_its_file_can_be_read(tmp_path):
    recorded = chirp_record(40.0, lsb_rev=2.0**-15, noise_rev=1e-5)
    fit = fit_records([recorded])
    assert np.allclose(fit.physical[:9], TRUTH[:9], rtol=0.02)
    assert fit.literal_loss is not None
    assert fit.literal_loss > 1.5  # the falling curve is the true one
    model = model_file(fit, [recorded], "fitted")
    write_model(tmp_path / "model.yaml", model)
    again = read_model(tmp_path / "model.yaml")
    assert again.friction_config() == pytest.approx(model.friction_config())
    assert again.friction.coulomb_nm.sd is not None
    facts = DriveFacts(torque_constant_nm_per_a=0.148)
    page = report(fit, [recorded], facts)
    rows = {row["name"]: row for row in page["parameters"]}
    assert set(rows) == set(PARAMETERS)
    low, high = rows["coulomb_nm"]["interval_95"]
    assert low < rows["coulomb_nm"]["value"] < high
    assert page["frequency_response"]["synthetic"]["first_order"]["gain_rps_per_a"] > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("bits", [28, 40])
def test_the_models_own_motion_is_found_however_fine_the_sensor_is(bits):
    fit = fit_records([chirp_record(lsb_rev=2.0**-bits)], FitSettings(effects=(), compare_literal=False))
    np.testing.assert_allclose(fit.physical[:9], TRUTH[:9], rtol=0.01)


def test_what_fast_sliding_cannot_tell_is_named():
    time = np.arange(40_000) * PERIOD_S
    current = 1.0 + 0.4 * np.sin(2 * np.pi * 1.0 * time) + 0.3 * np.sin(2 * np.pi * 7.0 * time)
    fit = fit_records([record_of(current, lsb_rev=2.0**-15, noise_rev=1e-5)], FitSettings(compare_literal=False))
    named = {doubt.name for doubt in fit.uncertainty.doubts}
    assert {"stiffness_per_rev", "stribeck_velocity_rps"} <= named
    assert "inertia_nm_s2_per_rev" not in named
    assert all(doubt.excitation for doubt in fit.uncertainty.doubts)
    # without slow speeds the fit puts Fs below Fc, which no contact has
    assert fit.value("static_nm") == fit.value("coulomb_nm")
    assert any("Fs is set to Fc" in text for text in fit.warnings)
    assert fit.value("inertia_nm_s2_per_rev") == pytest.approx(TRUTH[0], rel=0.02)


@pytest.mark.slow
def test_an_offset_is_found_and_fitted():
    base = chirp_record(40.0)
    offset_nm = 2e-3
    moved = record_of(base.current_a - offset_nm / 0.148, lsb_rev=2.0**-15, noise_rev=1e-5)
    seen = type(moved)(**{**vars(moved), "current_a": base.current_a})
    fit = fit_records([seen], FitSettings(compare_literal=False))
    assert fit.value("offset_nm") == pytest.approx(offset_nm, rel=0.03)


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 400.0, 2000.0, 20000.0])
def test_the_lag_of_the_velocity_is_found_at_any_rate(rate_hz):
    """Two sines, and the velocity 4 ms late."""
    time_s = np.arange(round(10.0 * rate_hz)) / rate_hz
    turns = 2.0 * np.pi * np.array([[1.3], [2.1]])
    position = (np.sin(turns * time_s) / turns).sum(axis=0)
    velocity = np.cos(turns * (time_s - 0.004)).sum(axis=0)
    log = record_of(velocity, period_s=1.0 / rate_hz, position_rev=position, velocity_rps=velocity)
    lag_s, sd_s = sensor_delay([log])
    assert lag_s == pytest.approx(0.004, rel=0.05)
    assert sd_s is not None


def test_logs_of_different_rates_are_not_mixed():
    first = chirp_record(4.0, lsb_rev=2.0**-15)
    second = type(first)(**{**vars(first), "period_s": 0.001})
    with pytest.raises(DataError, match="one rate"):
        fit_records([first, second])
    with pytest.raises(DataError, match="no logs"):
        fit_records([])


def test_what_stands_at_a_bound_is_named_by_its_symbol_and_a_number_of_an_effect_by_its_name():
    space = SimpleNamespace(names=("coulomb_nm", "asymmetric_coulomb.share"), low=np.zeros(2), high=np.ones(2))
    solution = SimpleNamespace(converged=True, values=np.array([0.0, 1.0]))
    said = _warnings(solution, space, None)
    assert [text.split(" stands at a bound")[0] for text in said] == ["Fc", "asymmetric_coulomb.share"]

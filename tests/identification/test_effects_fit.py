"""The refit of everything with effects: known parameters come back, from the model's own motion and from the plant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identification.refit import fit_effects, with_effects
from identification.rig import record
from identification.synthetic import AXIS, PERIOD_S, TRUTH, chirp_record
from model.loaded_axis import simulate_with_effects

from fffo_drive.drive.simulated.parameters import EffectConfig, paper_plant
from fffo_drive.identification.coordinates import MODEL_PARAMETERS, coordinates, to_coordinates
from fffo_drive.identification.excitation import identification_sequence
from fffo_drive.identification.layout import EffectStart, default_free
from fffo_drive.identification.prediction import make_problem, residual
from fffo_drive.identification.residuals import torque_residual, velocity_errors
from fffo_drive.identification.solver import solve
from fffo_drive.model.axis import AxisState
from fffo_drive.model.effects.registry import LAWS
from fffo_drive.model.effects.table import Term
from fffo_drive.model.friction import REST

LSB_REV = 2.0**-15


def loaded_record(terms, duration_s=8.0, seed=1):
    """The model's own motion with effects, in whole counts with noise."""
    current = identification_sequence(duration_s, PERIOD_S, 0.5, 1.1, 0.1, 10.0).values
    states, _ = simulate_with_effects(AXIS, terms, AxisState(0.0, 0.0, REST), current, PERIOD_S, 1)
    noise = 1e-5 * np.random.default_rng(seed).standard_normal(current.size)
    position = np.floor((states[:, 1] + states[:, 4] + noise) / LSB_REV) * LSB_REV
    return replace(chirp_record(duration_s), position_rev=position, current_a=current, lsb_rev=LSB_REV)


def test_without_effects_the_refit_is_the_fit_bit_for_bit():
    problem = make_problem([chirp_record(8.0, lsb_rev=LSB_REV)], 40.0)
    start = TRUTH * 1.02
    free = (*MODEL_PARAMETERS, "sensor_lag_s2")
    space = coordinates(start, PERIOD_S, free)
    expected = solve(problem, space, to_coordinates(start, space.scale), 3)
    found = fit_effects(problem, start, [], iterations=3)
    assert np.array_equal(found.solution.values, expected.values)
    assert found.solution.cost == expected.cost
    assert found.problem.layout is None


CASES = {
    "cogging": ({"cos_nm": 0.005, "sin_nm": 0.003, "order": 6.0}, {"order": 6.0}),
    "resolver_error": ({"cos1_rev": 1e-3, "sin2_rev": 5e-4}, {}),
    "elasticity": ({"share": 0.3, "frequency_hz": 30.0, "damping": 0.03}, {"frequency_hz": 33.0, "damping": 0.05}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_known_parameters_come_back(name):
    truth, start = CASES[name]
    problem = make_problem([loaded_record([Term(name, truth)])], 40.0)
    base = fit_effects(problem, TRUTH, [], iterations=5, with_jacobian=False)
    first = LAWS[name].strengths[0].name
    small = {first: 0.3 * truth[first]} if name == "elasticity" else {}
    found = fit_effects(problem, base.base, [EffectStart(name, start | small)], iterations=25)
    assert found.solution.cost < 0.7 * base.solution.cost
    for key, value in truth.items():
        assert found.effects[0].values[key] == pytest.approx(value, rel=0.05), key
    assert np.allclose(found.base[:4], TRUTH[:4], rtol=0.02)
    assert found.jacobian.shape == (problem.rows, found.free.size)


@pytest.mark.slow
def test_an_effect_of_the_plant_is_found_with_its_interval():
    """The plant's own physics, current loop and resolver between it and the model."""
    plant = replace(
        paper_plant(), effects=(EffectConfig("cogging", {"amplitude_nm": 0.0075, "order": 6.0, "phase_rev": 0.1}),)
    )
    runs = [record(plant, identification_sequence(8.0, PERIOD_S, 0.4, 1.1, 0.1, 10.0))]
    problem, check = (make_problem(runs, hz) for hz in (40.0, 20.0))
    starts = [EffectStart("cogging", {"order": 6.0})]
    found = fit_effects(problem, TRUTH, starts, iterations=8, check=check)
    effect = found.effects[0]
    # the plant drives with sin(2 pi (6 angle + 0.1)); the model has what is taken away
    assert effect.values["cos_nm"] == pytest.approx(-0.0075 * np.sin(0.2 * np.pi), abs=3e-4)
    assert effect.values["sin_nm"] == pytest.approx(-0.0075 * np.cos(0.2 * np.pi), abs=3e-4)
    assert 0.0 < effect.sd["sin_nm"] < 5e-4
    assert "order" not in effect.sd
    model = effect.model(["torque_ripple"], "a test")
    assert model.datum == "absolute"
    assert model.parameters["sin_nm"].sd == effect.sd["sin_nm"]
    before, after = (torque_residual(runs[0], found.base, terms=terms) for terms in ([], found.terms()))
    rms = [float(np.sqrt(np.mean(r.residual_nm[r.kept] ** 2))) for r in (before, after)]
    assert rms[1] < 0.4 * rms[0]
    windows = [velocity_errors(runs[0], found.base, terms=terms)[0] for terms in ([], found.terms())]
    assert np.median(np.abs(windows[1])) < 0.5 * np.median(np.abs(windows[0]))


@pytest.mark.slow
def test_a_phase_for_each_run():
    """The same cogging, its zero elsewhere in each run: amplitudes agree, phases do not."""
    first = loaded_record([Term("cogging", {"cos_nm": 0.005, "order": 6.0})])
    second = loaded_record([Term("cogging", {"sin_nm": 0.005, "order": 6.0})], seed=2)
    problem = make_problem([first, second], 40.0)
    start = EffectStart("cogging", {"order": 6.0}, {"cos_nm": (0.001, 0.001), "sin_nm": (0.0, 0.0)})
    found = fit_effects(problem, TRUTH, [start], iterations=8, with_jacobian=False)
    assert "cogging.cos_nm@1" in found.space.names
    assert found.effects[0].per_run["cos_nm"] == pytest.approx((0.005, 0.0), abs=2e-4)
    assert found.effects[0].per_run["sin_nm"] == pytest.approx((0.0, 0.005), abs=2e-4)
    assert found.effects[0].model().datum == "run"
    assert found.effects[0].term(1).values["sin_nm"] == pytest.approx(0.005, abs=2e-4)


def test_held_out_errors_at_given_parameters():
    values = {"cos_nm": 0.005, "sin_nm": 0.003, "order": 6.0}
    problem = make_problem([loaded_record([Term("cogging", values)], 6.0)], 40.0)
    joint, vector = with_effects(problem, TRUTH, [EffectStart("cogging", values)])
    assert np.std(residual(joint, vector)) < 0.2 * np.std(residual(problem, TRUTH))


def test_what_is_switched_off_by_its_shape_stays_held():
    law = LAWS["position_dependent_friction"]
    wave = default_free(law, {"period_rev": 3.0})
    window = default_free(law, {"centre_rev": 1.0, "width_rev": 0.5})
    assert set(wave) == {"cos_share", "sin_share"}
    assert set(window) == {"window_share", "centre_rev", "width_rev"}
    assert default_free(LAWS["lookup"], {"count": 3.0}) == ("y00", "y01", "y02")
    assert default_free(LAWS["cogging"], {"order": 6.0}) == ("cos_nm", "sin_nm")

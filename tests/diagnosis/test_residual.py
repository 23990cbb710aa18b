"""The residual in torque and what it is worth: filter, path, noise, projection."""

import numpy as np
import pytest
from fffo_drive.diagnosis.candidates import scenes_of, strength_columns
from fffo_drive.diagnosis.evidence import estimate_whitening, make_evidence, score, whiten
from fffo_drive.diagnosis.paths import make_filter, rows_of, stretches_of
from fffo_drive.diagnosis.screening import comparable, false_alarm_probability
from identification.synthetic import PERIOD_S, TRUTH, chirp_record

from fffo_drive.diagnosis.base import BASE, NAMES, balanced, delayed, models_along, moved, residual_rows, sensitivities
from fffo_drive.diagnosis.spectra import order_peaks

RNG = np.random.default_rng(3)


@pytest.fixture(scope="module")
def scene():
    records = [chirp_record(lsb_rev=2.0**-15, noise_rev=1.5e-5)]
    stretches = balanced(stretches_of(records), TRUTH)
    rows = rows_of(stretches, make_filter(PERIOD_S))
    return stretches, rows


def test_the_filter_has_no_phase_and_leaves_a_constant_alone():
    filter_ = make_filter(PERIOD_S)
    assert filter_.taps.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(filter_.taps, filter_.taps[::-1])
    n = 4000
    slow = np.sin(2 * np.pi * 3.0 * PERIOD_S * np.arange(n))
    rows = filter_.rows(slow)
    np.testing.assert_allclose(rows[20:-20], slow[:: filter_.step][20:-20], atol=2e-3)
    assert np.abs(filter_.rows(np.sin(2 * np.pi * 180.0 * PERIOD_S * np.arange(n)))[20:-20]).max() < 0.01


def test_the_filter_at_the_laws_rate_is_the_same_filter():
    filter_ = make_filter(PERIOD_S)
    laws = filter_.thinned()
    hz = np.array([1.0, 20.0, 45.0, 60.0])
    np.testing.assert_allclose(filter_.gain(hz), laws.gain(hz), atol=0.01)
    assert laws.row_period_s == pytest.approx(filter_.row_period_s)


@pytest.mark.parametrize("delay", [0.0, 0.3, 0.5, 3.7, 6.0])
def test_a_delayed_command_is_the_mean_of_what_was_held(delay):
    values = RNG.normal(size=100)
    charge = np.concatenate([[0.0], np.cumsum(values)])
    at = np.arange(100) - delay
    places = np.arange(101)
    mean = np.interp(at + 0.5, places, charge) - np.interp(at - 0.5, places, charge)
    np.testing.assert_allclose(delayed(values, delay)[8:-2], mean[8:-2], atol=1e-12)


def test_the_residual_of_the_truth_is_noise(scene):
    stretches, rows = scene
    residual = residual_rows(stretches, TRUTH, rows)[rows.kept]
    friction = rows.laws.rows(models_along(stretches, TRUTH)[0].friction_nm)[rows.kept]
    assert np.sqrt(np.mean(residual**2)) < 0.02 * np.sqrt(np.mean(friction**2))


@pytest.mark.parametrize("name", ["inertia_nm_s2_per_rev", "delay_s", "viscous_nm_per_rps", "static_nm"])
def test_sensitivities_foretell_what_a_wrong_parameter_leaves(scene, name):
    stretches, rows = scene
    matrix = sensitivities(stretches, TRUTH, rows)
    step = 1e-4 if name == "delay_s" else 0.02
    change = residual_rows(stretches, moved(TRUTH, name, step), rows) - residual_rows(stretches, TRUTH, rows)
    foretold = -step * matrix[:, BASE.index(name)]
    kept = rows.kept
    assert np.corrcoef(change[kept], foretold[kept])[0, 1] > 0.99


def test_whitening_makes_coloured_noise_white(scene):
    _, rows = scene
    noise = RNG.normal(size=rows.time_s.size)
    for k in range(1, noise.size):
        noise[k] += 0.6 * noise[k - 1]
    whitening = estimate_whitening(rows, 1e-3 * noise, np.zeros(noise.size, np.int64))
    white = whiten(rows, whitening, 1e-3 * noise)
    assert white.std() == pytest.approx(1.0, abs=0.1)
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.1


def test_what_a_refit_of_the_base_explains_is_no_evidence_for_an_effect(scene):
    """Frisch and Waugh: an error of the viscous coefficient is in the span of the base, and nothing is left of it."""
    stretches, rows = scene
    matrix = sensitivities(stretches, TRUTH, rows)
    noise = 1e-4 * RNG.normal(size=rows.time_s.size)
    whitening = estimate_whitening(rows, noise, np.zeros(noise.size, np.int64))
    evidence = make_evidence(rows, whitening, noise + 0.3 * matrix[:, BASE.index("viscous_nm_per_rps")], matrix)
    assert evidence.energy < 1.3 * evidence.residual.size
    viscous = score(evidence, matrix[:, [BASE.index("viscous_nm_per_rps")]])
    assert viscous.explained < 10.0


def test_a_law_finds_its_own_strength(scene):
    stretches, rows = scene
    models = models_along(stretches, TRUTH)
    scenes = scenes_of(stretches, TRUTH, models)
    columns = strength_columns(scenes, "quadratic_drag", {}, rows, False)
    matrix = sensitivities(stretches, TRUTH, rows)
    noise = 1e-4 * RNG.normal(size=rows.time_s.size)
    whitening = estimate_whitening(rows, noise, np.zeros(noise.size, np.int64))
    evidence = make_evidence(rows, whitening, noise + 2e-4 * columns.values[:, 0], matrix)
    assert score(evidence, columns.values).strengths[0] == pytest.approx(2e-4, rel=0.1)


def test_statistics_of_different_rank_are_on_one_scale():
    draws = np.random.default_rng(1)
    one, six = draws.chisquare(1, 20000), draws.chisquare(6, 20000)
    assert np.quantile(comparable(one, 1), 0.99) == pytest.approx(np.quantile(comparable(six, 6), 0.99), rel=0.15)


def test_a_statistic_beyond_all_surrogates_has_a_small_probability_and_never_zero():
    maxima = np.sort(np.random.default_rng(2).gumbel(10.0, 2.0, 400))
    assert 0.3 < false_alarm_probability(10.7, maxima) < 0.7
    far = false_alarm_probability(60.0, maxima)
    assert 0.0 < far < 1e-4


def test_an_order_of_the_angle_stands_out_through_reversals(scene):
    _, rows = scene
    wave = 1e-3 * np.cos(2 * np.pi * 3.5 * rows.position_rev) * rows.filter.gain(3.5 * rows.velocity_rps)
    peaks = order_peaks(rows, wave + 3e-4 * RNG.normal(size=wave.size), 3)
    assert peaks
    assert peaks[0].place == pytest.approx(3.5, abs=0.05)


def test_parameters_are_in_the_order_of_the_fit():
    assert NAMES[:9] == BASE[:9]

"""The residual in torque and what it is worth: filter, path, noise, projection."""

import numpy as np
import pytest
from identification.synthetic import PERIOD_S, TRUTH, chirp_record

from fffo_drive.diagnosis.base import BASE, NAMES, balanced, delayed, models_along, moved, residual_rows, sensitivities
from fffo_drive.diagnosis.rows import make_filter, rows_of, stretches_of
from fffo_drive.diagnosis.spectra import frequency_peaks, order_peaks, slow_orders

RNG = np.random.default_rng(3)


@pytest.fixture(scope="module")
def scene():
    records = [chirp_record(lsb_rev=2.0**-15, noise_rev=1.5e-5)]
    filter_ = make_filter(PERIOD_S)
    stretches = balanced(stretches_of(records, filter_), TRUTH)
    return stretches, rows_of(stretches, filter_)


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
    predicted = -step * matrix[:, BASE.index(name)]
    kept = rows.kept
    assert np.corrcoef(change[kept], predicted[kept])[0, 1] > 0.99


def test_an_order_of_the_angle_stands_out_through_reversals(scene):
    _, rows = scene
    wave = 1e-3 * np.cos(2 * np.pi * 3.5 * rows.position_rev) * rows.filter.gain(3.5 * rows.velocity_rps)
    peaks = order_peaks(rows, wave + 3e-4 * RNG.normal(size=wave.size), 3)
    assert peaks
    assert peaks[0].place == pytest.approx(3.5, abs=0.05)


def test_a_long_wave_is_the_largest_of_its_band(scene):
    """No line stands out below an order of 1.5: the largest of each band is tried, whatever else is there."""
    _, rows = scene
    order = 8.0 / rows.turns
    wave = 1e-3 * np.cos(2 * np.pi * order * rows.position_rev) + 2e-4 * RNG.normal(size=rows.time_s.size)
    assert min(abs(found - order) for found in slow_orders(rows, wave)) < 1.0 / rows.turns


def test_a_line_over_time_stands_out(scene):
    _, rows = scene
    wave = 1e-3 * np.cos(2 * np.pi * 7.3 * rows.time_s) + 5e-4 * RNG.normal(size=rows.time_s.size)
    assert frequency_peaks(rows, wave, 3)[0].place == pytest.approx(7.3, abs=0.1)


def test_parameters_are_in_the_order_of_the_fit():
    assert NAMES[:9] == BASE[:9]

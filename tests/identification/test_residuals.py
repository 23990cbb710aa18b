"""Residual statistics against closed forms, and against effects that are put in."""

from __future__ import annotations

import json

import numpy as np
import pytest
from identification.synthetic import AXIS, KT, PERIOD_S, TRUTH, chirp_record, record_of

from fffo_drive.identification.excitation import frequency_response_chirp
from fffo_drive.identification.frequency_response import (
    FrequencyResponse,
    damping_over_amplitude,
    fit_first_order,
    frequency_response,
)
from fffo_drive.identification.residuals import (
    dependences,
    effective_samples,
    residual_summary,
    run_residuals,
    torque_residual,
    whiteness,
)


def test_effective_samples_of_an_autoregression():
    """N (1 - a) / (1 + a) for x_k = a x_k-1 + noise."""
    noise = np.random.default_rng(3).standard_normal(200_000)
    x = np.zeros(noise.size)
    for k in range(1, noise.size):
        x[k] = 0.8 * x[k - 1] + noise[k]
    count, correlation = effective_samples(x)
    assert count / x.size == pytest.approx(0.2 / 1.8, rel=0.1)
    assert correlation[:3] == pytest.approx([1.0, 0.8, 0.64], abs=0.02)
    assert whiteness(x)["p_value"] < 1e-6
    assert whiteness(noise)["p_value"] > 1e-3


def test_a_residual_that_does_not_vary_says_nothing_about_its_correlation():
    assert whiteness(np.full(5000, 1e-3)) == {}
    record = chirp_record(10.0, lsb_rev=2.0**-15)
    (run,) = run_residuals([record], TRUTH)
    constant = run._replace(torque=run.torque._replace(residual_nm=np.full(run.torque.residual_nm.size, 1e-3)))
    summary = residual_summary([constant])["synthetic"]
    assert summary["whiteness"] == {}
    assert (summary["skewness"], summary["excess_kurtosis"]) == (0.0, 0.0)
    json.dumps(summary, allow_nan=False)


def test_at_the_truth_the_torque_residual_is_small_and_depends_on_nothing():
    found = torque_residual(chirp_record(20.0, lsb_rev=2.0**-15, noise_rev=1e-5), TRUTH)
    assert np.sqrt(np.mean(found.residual_nm[found.kept] ** 2)) < 3e-4
    assert all(d.p_value > 1e-4 for d in dependences(found, 10))


def test_an_asymmetry_is_seen_as_one():
    record = chirp_record(20.0, lsb_rev=2.0**-15)
    found = torque_residual(record, TRUTH)
    drag = found._replace(residual_nm=found.residual_nm + 2e-3 * np.abs(found.velocity_rps) / 10.0)
    strongest = max(dependences(drag, 10), key=lambda d: abs(d.correlation) if d.function != "1" else 0.0)
    assert strongest.function == "|v|"
    assert strongest.p_value < 1e-6


def test_the_summary_is_plain_numbers():
    summary = residual_summary(run_residuals([chirp_record(10.0, lsb_rev=2.0**-15)], TRUTH))
    assert json.loads(json.dumps(summary)).keys() == {"synthetic"}
    run = summary["synthetic"]
    assert sum(run["histogram"]["counts"]) > 1000
    assert run["by_regime"]["sliding"] > 0.0
    assert run["torque_relative_percent"] < 1.0


def test_a_first_order_gain_is_fitted_whatever_its_phase():
    frequency = np.geomspace(0.05, 40.0, 30)
    gain = 26.17 / np.hypot(1.0, 2 * np.pi * frequency * 0.166)
    response = FrequencyResponse(frequency, gain, np.full(30, -123.0), np.ones(30))
    found = fit_first_order(response)
    assert found.gain_rps_per_a == pytest.approx(26.17, rel=1e-4)
    assert found.time_constant_s == pytest.approx(0.166, rel=1e-4)


@pytest.mark.slow
def test_the_response_to_a_chirp_is_that_of_a_linear_axis():
    linear = AXIS._replace(friction=AXIS.friction._replace(coulomb_nm=1e-7, static_nm=1e-7, viscous_nm_per_rps=0.006))
    record = record_of(frequency_response_chirp(100.0, PERIOD_S, 1.0, 0.02, 50.0).values, linear)
    response = frequency_response(record)
    good = response.coherence > 0.9
    expected = KT / np.hypot(0.006, 2 * np.pi * response.frequency_hz * AXIS.inertia_nm_s2_per_rev)
    inside = good & (response.frequency_hz < 30.0)
    assert inside.sum() > 20
    assert np.abs(response.gain_rps_per_a[inside] / expected[inside] - 1.0).max() < 0.08
    found = fit_first_order(response)
    assert found.gain_rps_per_a == pytest.approx(KT / 0.006, rel=0.05)
    assert found.time_constant_s == pytest.approx(AXIS.inertia_nm_s2_per_rev / 0.006, rel=0.05)


def test_damping_falls_with_amplitude_towards_the_viscous_one():
    points = damping_over_amplitude([chirp_record(40.0)], AXIS.inertia_nm_s2_per_rev, AXIS.delay_s)
    amplitude = np.array([p.amplitude_rps for p in points])
    damping = np.array([p.damping_nm_per_rps for p in points])
    assert damping[0] > 10.0 * damping[-1] > 10.0 * 0.003
    fast = amplitude > 5.0
    # harmonic balance of Coulomb friction: D = sigma + 4 Fc / (pi A)
    assert damping[fast] == pytest.approx(0.003 + 4.0 * 0.025 / (np.pi * amplitude[fast]), rel=0.15)

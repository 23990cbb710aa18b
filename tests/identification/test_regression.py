"""The start of the fit, the rigid model, and what they recover."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identification.synthetic import AXIS, KT, PERIOD_S, chirp_record, record_of
from rigid_regression import RigidSettings, fit_rigid, rigid_error_percent

from fffo_drive.identification.dataset import DataError
from fffo_drive.identification.kinematics import acting_torque_nm, low_pass, motion_of, travel_since_reversal_rev
from fffo_drive.identification.regression import regression_start


def test_the_filter_has_no_phase_and_unit_gain_at_rest():
    time = np.arange(20_000) * PERIOD_S
    wave = np.sin(2 * np.pi * 2.0 * time)
    assert np.abs(low_pass(wave, 40.0, PERIOD_S) - wave)[500:-500].max() < 1e-4
    assert low_pass(np.ones(1000), 40.0, PERIOD_S) == pytest.approx(1.0)


def test_the_acting_torque_is_the_held_command_delayed():
    current = np.zeros(4000)
    current[2000:] = 1.0
    record = record_of(current)
    for delay in (0.0, 0.0021):
        torque = acting_torque_nm(record, slice(0, 4000), delay, 40.0)
        crossing = np.interp(0.5 * KT, torque[1900:2100], np.arange(1900, 2100))
        assert crossing == pytest.approx(2000.0 + delay / PERIOD_S, abs=0.05)


def test_travel_is_counted_from_the_reversal():
    current = 0.8 * np.sign(np.sin(2 * np.pi * 0.5 * np.arange(8000) * PERIOD_S))
    record = record_of(current)
    motion = motion_of(record, slice(0, 8000))
    travel = travel_since_reversal_rev(motion)
    turned = np.flatnonzero(np.diff(travel) < 0.0)
    assert turned.size == 3
    end = int(turned[1])
    begin = int(turned[0]) + 1
    assert travel[end] == pytest.approx(np.abs(np.diff(motion.position_rev[begin : end + 1])).sum())


def test_the_start_is_near_the_truth():
    start = regression_start([chirp_record(40.0, lsb_rev=2.0**-15)])
    assert start.inertia_nm_s2_per_rev == pytest.approx(AXIS.inertia_nm_s2_per_rev, rel=0.05)
    assert start.viscous_nm_per_rps == pytest.approx(0.003, rel=0.1)
    assert start.coulomb_nm == pytest.approx(0.025, rel=0.25)
    assert 0.0 <= start.delay_s <= 0.008
    assert start.static_nm > start.coulomb_nm


def test_too_little_sliding_is_refused():
    time = np.arange(400) * PERIOD_S
    with pytest.raises(DataError, match="sliding"):
        regression_start([record_of(0.1 * np.sin(2 * np.pi * 3.0 * time), lsb_rev=2.0**-15)])


def test_the_rigid_model_is_recovered_by_direction():
    time = np.arange(40_000) * PERIOD_S
    position = 2.0 * np.sin(2 * np.pi * 0.5 * time) + 0.4 * np.sin(2 * np.pi * 1.7 * time)
    velocity = np.gradient(position, PERIOD_S)
    acceleration = np.gradient(velocity, PERIOD_S)
    force = 2e-3 * acceleration + np.where(velocity > 0, 0.01 * velocity + 0.03, 0.02 * velocity - 0.05)
    record = replace(record_of(np.zeros(40_000)), current_a=force / KT, position_rev=position)
    settings = RigidSettings(directional=True, cutoff_hz=400.0)
    fit = fit_rigid(record, settings)
    expected = {
        "inertia": 2e-3, "viscous_forward": 0.01, "viscous_backward": 0.02, "coulomb_forward": 0.03,
        "coulomb_backward": 0.05,
    }  # fmt: skip
    assert fit.parameters == pytest.approx(expected, rel=0.02)
    assert fit.error_percent < 3.0
    assert rigid_error_percent(record, fit.parameters, settings) == pytest.approx(fit.error_percent)
    assert fit_rigid(record, RigidSettings(cutoff_hz=400.0)).error_percent > 2.0 * fit.error_percent

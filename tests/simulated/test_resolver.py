"""Resolver, converter and tracking loop: counts, lag, transfer function, resolution and noise of the velocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated.plant_rig import NO_FRICTION, exchange, quiet, record

from fffo_drive.drive.simulated import state as at
from fffo_drive.drive.simulated.pack import new_state, plant_parameters
from fffo_drive.drive.simulated.parameters import PlantConfig, ResolverConfig
from fffo_drive.drive.simulated.resolver import plant_latch, resolver_step
from fffo_drive.drive.simulated.state import STEP_S
from fffo_drive.units import TWO_PI

IDEAL = ResolverConfig(bits=24, noise_rev=0.0, velocity_noise_rps=0.0, velocity_lsb_rps=0.0)


def follow(config: ResolverConfig, angle_rev: np.ndarray, seed: int = 1) -> np.ndarray:
    """Feed angles, one a sub-step; tracked angle and velocity: shape (n, 2)."""
    plant = PlantConfig(resolver=config, seed=seed, initial_angle_rev=float(angle_rev[0]))
    parameters, state = plant_parameters(plant), new_state(plant)
    rows = np.zeros((angle_rev.size, 2))
    for k, angle in enumerate(angle_rev):
        resolver_step(parameters.numbers, state.values, state.words, float(angle))
        rows[k] = state.values[at.TRACKED_REV], state.values[at.TRACKED_RPS]
    return rows


def test_at_rest_the_position_is_the_count_below_the_angle():
    for angle in (0.0, 0.1234, -0.4321, 57.3, -3.00001):
        config = PlantConfig(resolver=replace(IDEAL, bits=15), initial_angle_rev=angle, current_noise_a=0.0)
        parameters, state = plant_parameters(config), new_state(config)
        for _ in range(2000):
            resolver_step(parameters.numbers, state.values, state.words, angle)
        assert plant_latch(parameters, state).position_counts == int(np.floor(angle * 32768))


def test_the_position_counts_on_over_many_turns_without_a_jump():
    rows = exchange(replace(quiet(friction=NO_FRICTION), resolver=replace(IDEAL, bits=15)), np.full(4000, 0.8))
    counts = rows[:, 1]
    assert counts[-1] / 32768 > 25
    assert np.abs(np.diff(counts, 2)).max() < 40
    assert counts[-1] / 32768 == pytest.approx(np.sum(rows[:, 3]) * 0.0005, rel=1e-3)


def test_angle_has_no_lag_at_constant_speed_and_velocity_the_right_mean():
    angle = 7.0 * np.arange(8000) * STEP_S
    rows = follow(IDEAL, angle)
    assert rows[4000:, 0] - angle[4000:] == pytest.approx(np.zeros(4000), abs=1e-6)
    assert rows[4000:, 1] == pytest.approx(np.full(4000, 7.0), abs=1e-3)


def test_velocity_lags_by_two_zeta_over_the_natural_frequency():
    """On a ramp of speed the estimate is behind by acceleration times lag."""
    config = replace(IDEAL, tracking_hz=300.0, tracking_damping=0.8)
    t = np.arange(6000) * STEP_S
    rows = follow(config, 0.5 * 100.0 * t * t)
    lag_s = np.mean(100.0 * t[4000:] - rows[4000:, 1]) / 100.0
    assert lag_s == pytest.approx(2 * 0.8 / (TWO_PI * 300) - 0.5 * STEP_S, rel=1e-3)


@pytest.mark.parametrize("frequency_hz", [30.0, 200.0, 400.0])
def test_the_velocity_estimate_has_the_transfer_function_of_the_loop(frequency_hz):
    natural, zeta = TWO_PI * 400.0, 0.9
    s = 1j * TWO_PI * frequency_hz
    t = np.arange(round(0.5 / STEP_S)) * STEP_S
    amplitude_rev = 0.001
    velocity = follow(IDEAL, amplitude_rev * np.sin(TWO_PI * frequency_hz * t))[:, 1]
    half = t.size // 2
    basis = np.column_stack([np.cos(TWO_PI * frequency_hz * t), np.sin(TWO_PI * frequency_hz * t)])[half:]
    cosine, sine = np.linalg.lstsq(basis, velocity[half:], rcond=None)[0]
    measured = (cosine - 1j * sine) / (amplitude_rev * TWO_PI * frequency_hz)
    expected = natural**2 / (s * s + 2 * zeta * natural * s + natural**2)
    assert measured == pytest.approx(expected, abs=0.12)
    assert abs(measured) == pytest.approx(abs(expected), rel=0.12)


def test_reported_velocities_are_multiples_of_the_resolution():
    velocity = exchange(PlantConfig(), np.full(2000, 0.6))[:, 0]
    assert velocity / 0.001 == pytest.approx(np.round(velocity / 0.001), abs=1e-6)
    assert np.unique(velocity).size > 100


def test_a_coarser_resolver_makes_a_noisier_velocity():
    """Counts of 1/32768 rev, seen through the tracking loop: about 0.01 rps, and much less with 20 bits."""
    deviations = []
    for bits in (12, 15, 20):
        config = replace(quiet(friction=NO_FRICTION), resolver=replace(IDEAL, bits=bits))
        rows = exchange(config, np.concatenate([np.full(200, 0.1), np.zeros(3800)]))
        error = rows[1000:, 0] - rows[1000:, 3]
        deviations.append(error.std())
    assert deviations[0] > 4 * deviations[1] > 16 * deviations[2]
    assert 0.001 < deviations[1] < 0.05


def test_noise_has_the_configured_size():
    resolver = replace(IDEAL, velocity_noise_rps=0.02)
    config = replace(quiet(), resolver=resolver, current_noise_a=0.05)
    rows = exchange(config, np.zeros(20_000))
    assert rows[:, 0].std() == pytest.approx(0.02, rel=0.03)
    assert rows[:, 2].std() == pytest.approx(0.05, rel=0.03)
    assert abs(rows[:, 0].mean()) < 5e-4
    assert abs(np.corrcoef(rows[1:, 0], rows[:-1, 0])[0, 1]) < 0.03


def test_the_truth_is_not_touched_by_the_sensor():
    commands = np.full(1000, 0.5)
    a = record(quiet(), commands)
    b = record(replace(quiet(), resolver=ResolverConfig(bits=8, noise_rev=0.01)), commands)
    # the tracking loop is the same, so is the delay: the motion is bit for bit the same
    assert np.array_equal(a.velocity_rps, b.velocity_rps)

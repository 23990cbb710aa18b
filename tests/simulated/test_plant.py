"""The plant against closed forms: coast-down, force balance, voltage limit, delay, determinism, warming."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated.plant_rig import (
    NO_FRICTION,
    SUBSTEPS_PER_TICK,
    TICK_S,
    copy_state,
    exchange,
    lively_current,
    quiet,
    record,
)

from fffo_drive.drive.simulated import state as at
from fffo_drive.drive.simulated.pack import new_state, plant_parameters
from fffo_drive.drive.simulated.parameters import PlantConfig, ThermalConfig, delay_budget, paper_plant
from fffo_drive.drive.simulated.plant import plant_advance, substeps_due
from fffo_drive.drive.simulated.state import STEP_S
from fffo_drive.drive.simulated.surfaces import PlantFriction, Surface
from fffo_drive.units import TWO_PI, inertia_nm_s2_per_rev

INERTIA = inertia_nm_s2_per_rev(1.5e-4)
KT = 0.148
VISCOUS = PlantFriction(surfaces=(Surface("oil", 1e-6, 1e-6, 0.003, 1.0, 10.0, 0.01),))


def same(a, b) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def test_free_coast_down_is_exponential_under_viscous_friction():
    config = quiet(friction=VISCOUS)
    state = new_state(config)
    state.values[at.VELOCITY_RPS] = 10.0
    run = record(config, np.zeros(1200), state)
    coulomb_rps = 1e-6 / 0.003  # the least level that a surface may have
    expected = (10.0 + coulomb_rps) * np.exp(-0.003 / INERTIA * run.time_s) - coulomb_rps
    assert run.velocity_rps == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("config", [PlantConfig(), paper_plant()], ids=["five", "single"])
@pytest.mark.parametrize("current_a", [0.6, -0.4])
def test_steady_speed_balances_torque_and_friction(config, current_a):
    config = quiet(friction=config.friction)
    run = record(config, np.full(12_000, current_a))
    speed = abs(run.velocity_rps[-1])
    friction = 0.025 + 0.042 * np.exp(-((speed / 0.733) ** 1.07)) + 0.003 * speed
    assert abs(run.friction_nm[-1]) == pytest.approx(KT * abs(current_a), rel=1e-3)
    assert friction == pytest.approx(KT * abs(current_a), rel=0.09)
    assert np.sign(run.velocity_rps[-1]) == np.sign(current_a)


def test_below_break_away_the_shaft_creeps_a_few_degrees_and_stays():
    run = record(quiet(), np.full(4000, 0.25))
    assert abs(run.velocity_rps[-1]) < 1e-3
    assert 0.0 < run.angle_rev[-1] < 10.0 / 360.0


def test_the_dc_link_limits_the_speed_near_the_back_emf():
    """48 V over 2 pi 0.148 V/rps: 3097 rpm without friction, a little less with it."""
    ideal_rps = 48.0 / (TWO_PI * KT)
    assert ideal_rps * 60 == pytest.approx(3100, rel=2e-3)
    free = record(quiet(friction=NO_FRICTION), np.full(8000, 8.0))
    assert free.velocity_rps[-1] == pytest.approx(ideal_rps, rel=1e-3)
    loaded = record(quiet(), np.full(8000, 8.0))
    friction_a = loaded.friction_nm[-1] / KT
    assert loaded.velocity_rps[-1] == pytest.approx((48.0 - 0.35 * friction_a) / (TWO_PI * KT), rel=2e-3)


def test_the_limits_of_current_and_voltage_are_noted_until_the_next_latch():
    config = quiet()
    parameters, state = plant_parameters(config), new_state(config)
    plant_advance(parameters, state, 1.0, 500)
    assert state.words[at.LIMITED] == 0
    plant_advance(parameters, state, 40.0, 500)
    assert state.words[at.LIMITED] == 1
    assert state.values[at.CURRENT_A] <= 16.6 * (1 + 1e-9)


def test_the_current_loop_answers_a_step_with_its_bandwidth_and_lag():
    config = quiet(friction=NO_FRICTION, current_bandwidth_hz=500.0)
    run = record(config, np.full(40, 2.0))
    missing = 2.0 - run.current_a
    budget = delay_budget(config)
    lag_s = missing.sum() * STEP_S / 2.0
    assert lag_s == pytest.approx(budget.transport_s + budget.current_loop_s, abs=0.6 * STEP_S)
    once_a_period = missing[80:120:2]
    assert once_a_period[1:] / once_a_period[:-1] == pytest.approx(np.exp(-TWO_PI * 500 * 2 * STEP_S), rel=1e-6)


@pytest.mark.parametrize(("delay_s", "bandwidth_hz"), [(0.003, 1000.0), (0.005, 300.0), (0.0021, 2000.0)])
def test_the_end_to_end_delay_is_what_is_configured(delay_s, bandwidth_hz):
    """Phase from the sampled command to the sampled velocity of a free rotor: -90 degrees - 360 f Td."""
    config = quiet(friction=NO_FRICTION, delay_s=delay_s, current_bandwidth_hz=bandwidth_hz)
    frequency_hz = 10.0
    t = np.arange(16_000) * TICK_S
    angle = TWO_PI * frequency_hz * t
    velocity = exchange(config, 0.5 * np.sin(angle))[:, 0]
    basis = np.column_stack([np.sin(angle), np.cos(angle), np.ones_like(t)])[4000:]
    sine, cosine, _ = np.linalg.lstsq(basis, velocity[4000:], rcond=None)[0]
    measured_s = (-np.arctan2(cosine, sine) - np.pi / 2) / (TWO_PI * frequency_hz)
    assert measured_s == pytest.approx(delay_s, abs=5e-6)
    gain = np.hypot(sine, cosine) / 0.5
    assert gain == pytest.approx(KT / INERTIA / (TWO_PI * frequency_hz), rel=0.01)


def test_the_parts_of_the_delay_add_up_to_it():
    budget = delay_budget(PlantConfig())
    assert sum(budget.__dict__.values()) == pytest.approx(0.003, abs=1e-15)
    assert budget.transport_s > 0.0


def test_advancing_in_one_go_or_step_by_step_is_the_same():
    config = PlantConfig(seed=5)
    parameters = plant_parameters(config)
    a, b = new_state(config), new_state(config)
    plant_advance(parameters, a, 0.7, 1100)
    for _ in range(1100):
        plant_advance(parameters, b, 0.7, 1)
    assert same(a, b)


def test_the_same_seed_gives_the_same_run_and_another_seed_another():
    commands = lively_current(0.5)
    a, b, c = (exchange(PlantConfig(), commands, seed) for seed in (7, 7, 8))
    assert np.array_equal(a, b)
    assert not np.array_equal(a[:, 0], c[:, 0])
    assert a[:, 3] == pytest.approx(c[:, 3], abs=1.0)


def test_a_snapshot_goes_on_like_the_original():
    config = PlantConfig()
    parameters, state = plant_parameters(config), new_state(config)
    plant_advance(parameters, state, 0.8, 3000)
    kept = copy_state(state)
    plant_advance(parameters, state, 0.5, 3000)
    end = copy_state(state)
    for field, value in zip(state, kept, strict=True):
        field[...] = value
    plant_advance(parameters, state, 0.5, 3000)
    assert same(state, end)


def test_sub_steps_due_never_lose_time():
    state = new_state(PlantConfig())
    total = 0
    for k in range(1, 2001):
        n = substeps_due(state, k * 500_000)
        assert n == SUBSTEPS_PER_TICK
        state.words[at.SUBSTEP] += n
        total += n
    assert total == 22_000
    assert substeps_due(state, 999_999_999) == 0
    assert substeps_due(state, 1_000_000_000 + 45_455) == 1


def test_warming_follows_the_losses_and_thins_the_lubricant():
    thermal = ThermalConfig(k_per_w=5.0, time_constant_s=2.0, viscous_per_k=-0.01)
    config = quiet(thermal=thermal, friction=VISCOUS)
    parameters, state = plant_parameters(config), new_state(config)
    plant_advance(parameters, state, 0.2, 40 * 22_000)
    speed = state.values[at.VELOCITY_RPS]
    power_w = 0.35 * 0.2**2 + TWO_PI * state.values[at.FRICTION_NM] * speed
    rise_k = 5.0 * power_w
    assert state.values[at.TEMPERATURE_K] == pytest.approx(rise_k, rel=1e-3)
    assert state.values[at.FRICTION_NM] == pytest.approx(KT * 0.2, rel=1e-3)
    assert state.values[at.FRICTION_NM] / speed == pytest.approx(0.003 * (1 - 0.01 * rise_k), rel=2e-3)


def test_rough_surfaces_leave_a_coloured_torque_of_the_configured_size():
    rough = replace(quiet(), roughness_nm=0.002, roughness_hz=15.0)
    smooth = quiet()
    commands = np.full(20_000, 0.5)
    extra = record(rough, commands).friction_nm - record(smooth, commands).friction_nm
    extra = extra[40_000:] - extra[40_000:].mean()
    assert extra.std() == pytest.approx(0.002, rel=0.25)
    lag = round(1.0 / (TWO_PI * 15.0) / STEP_S)
    assert np.mean(extra[lag:] * extra[:-lag]) / extra.var() == pytest.approx(np.exp(-1), abs=0.15)

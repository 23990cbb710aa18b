"""2SEP friction against its physics: levels, hysteresis, rate dependence, lag, boundedness, and an ODE solver."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from interpreted import hex_results
from model.friction_cases import TABLE1, edge_values
from scipy.integrate import solve_ivp

from fffo_drive.model.axis import AxisConfig, AxisState, axis_step
from fffo_drive.model.friction import (
    OMEGA_CLIPPED,
    OMEGA_LITERAL,
    OMEGA_SIGNED,
    REST,
    FrictionConfig,
    FrictionState,
    friction_step,
    settled_friction,
    steady_friction_along,
    steady_friction_nm,
)

PERIOD_S = 5e-4


def run(config: FrictionConfig, velocity_rps: np.ndarray, period_s: float = PERIOD_S, state: FrictionState = REST):
    """Friction torque after each sample of a velocity record."""
    torque_nm = np.empty(velocity_rps.size)
    for k, w in enumerate(velocity_rps):
        state = friction_step(config, state, float(w), 0.0, period_s)
        torque_nm[k] = state.torque_nm
    return torque_nm, state


def test_presliding_alone_is_an_exponential_that_saturates_at_coulomb():
    config = TABLE1._replace(attraction_nm_per_rev=1e-12)
    torque_nm, _ = run(config, np.full(400, 0.02))
    travel_rev = 0.02 * PERIOD_S * np.arange(1, 401)
    np.testing.assert_allclose(torque_nm, 0.025 * (1.0 - np.exp(-778.0 * travel_rev)), rtol=1e-9)
    far, _ = run(config, np.full(2000, 1.0))
    assert far[-1] == pytest.approx(0.025, rel=1e-9)


@pytest.mark.parametrize("velocity_rps", [0.05, -0.05, 0.733, -3.0, 15.0])
def test_friction_tends_to_the_steady_curve(velocity_rps):
    travel_rev = 3.0  # many times S / B
    steps = math.ceil(travel_rev / (abs(velocity_rps) * PERIOD_S))
    torque_nm, _ = run(TABLE1, np.full(min(steps, 200_000), velocity_rps))
    assert torque_nm[-1] == pytest.approx(
        math.copysign(steady_friction_nm(TABLE1, velocity_rps), velocity_rps), rel=1e-6
    )


def test_both_readings_of_the_stribeck_curve():
    literal = TABLE1._replace(stribeck_exponent=-1.07)
    assert steady_friction_nm(TABLE1, 0.0) == pytest.approx(0.067)
    assert steady_friction_nm(literal, 0.0) == pytest.approx(0.025)
    at_vs = 0.025 + 0.042 * math.exp(-1.0) + 0.003 * 0.733
    assert steady_friction_nm(TABLE1, 0.733) == pytest.approx(at_vs)
    assert steady_friction_nm(literal, 0.733) == pytest.approx(at_vs)
    assert steady_friction_nm(TABLE1, 15.0) == pytest.approx(0.070, abs=1e-4)
    assert steady_friction_nm(literal, 15.0) == pytest.approx(0.067 + 0.045, abs=3e-3)


def test_a_full_reversal_moves_presliding_to_the_other_coulomb_level():
    config = TABLE1._replace(attraction_nm_per_rev=1e-12)
    start = settled_friction(config, 1.0)._replace(torque_nm=0.025)
    torque_nm, state = run(config, np.full(2000, -1.0), state=start)
    assert state.omega_nm == pytest.approx(-0.05)
    assert torque_nm[-1] == pytest.approx(-0.025, rel=1e-9)


def test_a_periodic_cycle_settles_to_a_closed_loop_that_dissipates():
    time_s = np.arange(4000) * PERIOD_S
    velocity_rps = 0.05 * np.sin(2 * np.pi * time_s / 2.0)  # one period; +-0.016 rev, presliding and beyond
    cycles = []
    state = REST
    for _ in range(6):
        torque_nm, state = run(TABLE1, velocity_rps, state=state)
        cycles.append(torque_nm)
    assert np.abs(cycles[-1] - cycles[-2]).max() < 1e-9
    energy_nm_rev = np.sum(cycles[-1] * velocity_rps) * PERIOD_S
    assert energy_nm_rev > 0.5 * 4 * 0.016 * 0.025


def breakaway_peak_nm(rate_nm_per_s: float) -> float:
    axis = AxisConfig(9.4e-4, 0.148, 0.0, TABLE1)
    state = AxisState(0.0, 0.0, REST)
    peak = 0.0
    for k in range(200_000):
        state = axis_step(axis, state, rate_nm_per_s * k * 1e-4, 1e-4)
        peak = max(peak, state.friction.torque_nm)
        if state.velocity_rps > 3.0:
            break
    return peak


def test_breakaway_depends_on_the_torque_rate():
    peaks = [breakaway_peak_nm(rate) for rate in (0.02, 0.2, 2.0)]
    assert peaks[0] > peaks[1] > peaks[2]
    assert peaks[0] < 0.067 + 1e-3
    assert peaks[0] - peaks[2] > 0.002


def lag_loop_area(frequency_hz: float) -> float:
    """Area of F over w per cycle in unidirectional motion: zero for a static curve."""
    n = round(1.0 / frequency_hz / 1e-4)
    velocity_rps = 0.6 + 0.4 * np.sin(2 * np.pi * np.arange(n) / n)
    state = settled_friction(TABLE1, 0.6)
    for _ in range(3):
        torque_nm, state = run(TABLE1, velocity_rps, 1e-4, state)
    return abs(float(np.sum(torque_nm[:-1] * np.diff(velocity_rps))))


def test_frictional_lag_grows_with_acceleration():
    areas = [lag_loop_area(frequency_hz) for frequency_hz in (0.2, 0.5, 1.25)]
    # a short lag makes an area in proportion to the rate of change of velocity
    assert areas[1] / areas[0] == pytest.approx(2.5, rel=0.15)
    assert areas[2] / areas[1] == pytest.approx(2.5, rel=0.4)


def dither(omega_form: int) -> np.ndarray:
    """Slow motion under a micro-reversal every few ticks, from a settled 0.3 rps where F is well above Fc."""
    config = TABLE1._replace(omega_form=omega_form)
    state = settled_friction(config, 0.3)
    velocity_rps = np.tile([0.3, 0.3, 0.3, 0.3, 0.3, 0.3, -0.005], 3000)
    torque_nm, _ = run(config, velocity_rps, state=state)
    return torque_nm


def test_dithering_reversals_keep_the_level_with_the_clipped_omega_alone():
    level_nm = steady_friction_nm(TABLE1, 0.3)
    clipped = dither(OMEGA_CLIPPED)
    signed = dither(OMEGA_SIGNED)
    literal = dither(OMEGA_LITERAL)
    assert abs(clipped[6:]).max() <= 0.067 + 1e-9
    # what is lost is the presliding travel of the micro-reversal itself, not the way from Fs to Fc
    assert clipped[-7:].max() > 0.9 * level_nm
    assert abs(signed).max() <= 0.067 + 1e-9
    assert signed[-7:].min() < clipped[-7:].min()
    assert not (abs(literal) < 1.0).all()  # the printed form ratchets to any value


@settings(max_examples=60)
@given(
    st.lists(st.floats(-50, 50, allow_nan=False), min_size=1, max_size=60),
    st.floats(1e-6, 5e-3),
    st.sampled_from([1.07, -1.07, 0.5, 2.5]),
)
def test_friction_is_bounded_by_the_steady_curve_whatever_the_velocity(velocities, period_s, exponent):
    config = TABLE1._replace(stribeck_exponent=exponent)
    torque_nm, _ = run(config, np.array(velocities), period_s)
    top_nm = 0.067 + 0.003 * max(map(abs, velocities)) + 0.025
    assert np.isfinite(torque_nm).all()
    assert abs(torque_nm).max() <= top_nm


def test_agreement_with_an_ode_solver_through_reversals():
    amplitude_rps, frequency_hz = 1.3, 1.7

    def velocity(t: float) -> float:
        return amplitude_rps * math.sin(2 * math.pi * frequency_hz * t)

    step_s = 1e-5
    steps = round(1.0 / frequency_hz / step_s)
    midpoints = np.array([velocity((k + 0.5) * step_s) for k in range(steps)])
    ours, _ = run(TABLE1, midpoints, step_s)

    def slope(t: float, y: np.ndarray, omega: float, sign: float) -> list[float]:
        w = velocity(t)
        speed = abs(w)
        dz1 = omega * 778.0 * speed * math.exp(-778.0 * y[1])
        steady = steady_friction_nm(TABLE1, w)
        return [dz1 + 2.33 * speed * sign - 2.33 * speed / steady * y[0], speed]

    half_s = 0.5 / frequency_hz
    torque, reference_nm = 0.0, []
    for half, sign in enumerate((1.0, -1.0)):
        omega = sign * max(0.0, 0.025 - sign * torque)
        span = (half * half_s, (half + 1) * half_s)
        at = np.linspace(*span, 200)
        solution = solve_ivp(slope, span, [torque, 0.0], t_eval=at, args=(omega, sign), rtol=1e-10, atol=1e-13)
        torque = float(solution.y[0, -1])
        reference_nm.append(solution.y[0][1:])
    indices = np.concatenate([np.linspace(h * half_s, (h + 1) * half_s, 200)[1:] for h in (0, 1)])
    sampled = np.interp(indices, (np.arange(steps) + 1) * step_s, ours)
    assert np.abs(sampled - np.concatenate(reference_nm)).max() < 2e-5


@settings(max_examples=80)
@given(
    st.floats(-40, 40).filter(lambda w: abs(w) > 1e-6),
    st.floats(-0.1, 0.1),
    st.floats(-30, 30),
    st.integers(2, 40),
)
def test_one_step_equals_many_small_ones_at_constant_velocity(velocity_rps, torque_nm, observation, pieces):
    start = FrictionState(torque_nm, 0.002, 0.013, math.copysign(1.0, velocity_rps))
    whole = friction_step(TABLE1, start, velocity_rps, observation, 2e-3)
    state = start
    for _ in range(pieces):
        state = friction_step(TABLE1, state, velocity_rps, observation, 2e-3 / pieces)
    np.testing.assert_allclose(np.array(state), np.array(whole), rtol=1e-9, atol=1e-14)


def test_the_limit_of_equal_lag_and_stiffness_is_continuous():
    steady = steady_friction_nm(TABLE1, 0.5)
    start = FrictionState(0.01, 0.0, 0.02, 1.0)
    torques = []
    for relative in (-1e-7, 0.0, 1e-7):
        config = TABLE1._replace(stiffness_per_rev=2.33 / steady * (1.0 + relative))
        torques.append(friction_step(config, start, 0.5, 0.0, 1e-2).torque_nm)
    assert torques[1] == pytest.approx(0.5 * (torques[0] + torques[2]), rel=1e-10)


def test_standstill_holds_friction_and_integrates_only_the_observation():
    start = FrictionState(0.031, 0.004, 0.02, -1.0)
    assert friction_step(TABLE1, start, 0.0, 0.0, PERIOD_S) == start
    observed = friction_step(TABLE1, start, 0.0, 4.0, PERIOD_S)
    assert observed.torque_nm == pytest.approx(0.031 + 4.0 * PERIOD_S, rel=1e-12)


def test_symmetry_under_change_of_sign():
    velocity_rps = np.sin(np.arange(3000) * 0.01) * 2.0
    forward, _ = run(TABLE1, velocity_rps)
    backward, _ = run(TABLE1, -velocity_rps)
    np.testing.assert_array_equal(forward, -backward)


@pytest.mark.slow
def test_compiled_and_interpreted_code_agree_bit_for_bit():
    assert edge_values() == hex_results("model.friction_cases", "edge_values")


@pytest.mark.parametrize("exponent", [-3.0, -1.07, 0.5, 2.0])
def test_friction_along_many_velocities_is_that_of_each(exponent):
    config = TABLE1._replace(stribeck_exponent=exponent)
    speeds_rps = np.concatenate(([0.0, -0.0], np.geomspace(1e-12, 100.0, 40), -np.geomspace(1e-3, 10.0, 20)))
    one_by_one = [steady_friction_nm(config, float(speed_rps)) for speed_rps in speeds_rps]
    np.testing.assert_allclose(steady_friction_along(config, speeds_rps), one_by_one, rtol=1e-9)

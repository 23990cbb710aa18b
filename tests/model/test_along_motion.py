"""Laws along a motion that is known, as a diagnosis uses them: what a law did in a simulation comes out again."""

from __future__ import annotations

import math

import numpy as np
import pytest
from model.loaded_axis import simulate_with_effects
from model.test_effects import AXIS, COARSE_S, FRICTION, SHAKEN, TURN

from fffo_drive.model.axis import AxisState
from fffo_drive.model.effects import slots as s
from fffo_drive.model.effects.table import Term, effects_along
from fffo_drive.model.friction import REST, FrictionState, friction_step, torque_after

PERIOD_S = 2.5e-4
N = 24_000
JOINTS = {
    "elasticity": {"share": 0.4, "frequency_hz": 25.0, "damping": 0.07},
    "backlash": {"share": 0.4, "gap_rev": 0.01, "friction_share": 0.5, "contact_hz": 60.0},
}


def simulated(name, values):
    """Motion of an axis with one effect at full rate, and the effect's torque along it."""
    time_s = np.arange(N) * PERIOD_S
    current = 1.5 * np.sin(TURN * (0.5 + 1.0 * time_s) * time_s)
    axis = AXIS._replace(delay_s=0.0)
    output, _ = simulate_with_effects(axis, [Term(name, values)], AxisState(0.0, 0.0, REST), current, PERIOD_S, 8)
    rows = np.zeros((N, s.N_MOTION))
    rows[:, s.TIME_S], rows[:, s.VELOCITY_RPS] = time_s, output[:, 0]
    rows[:, s.MOTOR_ANGLE_REV] = rows[:, s.SENSOR_ANGLE_REV] = output[:, 1]
    rows[:, s.FRICTION_NM] = output[:, 2]
    rows[:, s.ACCELERATION_RPS2] = np.gradient(output[:, 0], PERIOD_S)
    load_nm = np.append(0.5 * (output[:-1, 3] + output[1:, 3]), 0.0)  # of the steps before and after an instant
    return axis, rows, load_nm


@pytest.mark.parametrize("name", JOINTS)
def test_a_joint_takes_from_a_known_motion_what_it_took_in_the_simulation(name):
    """With the torque that the motion needs without the joint: with the motor's own, the joint is in it already."""
    axis, rows, expected = simulated(name, JOINTS[name])
    driving = axis.inertia_nm_s2_per_rev * rows[:, s.ACCELERATION_RPS2] + rows[:, s.FRICTION_NM]
    rows[:, s.CURRENT_A] = driving / axis.torque_constant_nm_per_a
    load, _ = effects_along([Term(name, JOINTS[name])], rows, axis, PERIOD_S, feedforward=True)
    smooth = np.ones(41) / 41.0  # impacts last less than a sample
    load, expected = np.convolve(load, smooth, "same"), np.convolve(expected, smooth, "same")
    size = float(np.sqrt(np.mean(expected**2)))
    assert size > 0.003
    assert float(np.sqrt(np.mean((load - expected) ** 2))) < 0.1 * size
    assert float(load @ expected) / float(expected @ expected) == pytest.approx(1.0, abs=0.05)


VISCOUS = {
    "asymmetric_viscous": ({"excess_nm_per_rps": 2e-3}, lambda row: 2e-3 * math.copysign(1.0, row[s.VELOCITY_RPS])),
    "viscous_drift": (
        {"change_nm_per_rps": -2e-3, "tau_s": 3.0}, lambda row: 2e-3 * math.expm1(-row[s.TIME_S] / 3.0)),
}  # fmt: skip


@pytest.mark.parametrize("name", VISCOUS)
def test_a_viscous_coefficient_is_felt_as_the_friction_follows(name):
    """The viscous part stands in S(w), which friction follows over a travel: no torque of its own at once."""
    values, rise = VISCOUS[name]
    load, _ = effects_along([Term(name, values)], SHAKEN, AXIS, COARSE_S)
    state, expected = REST, np.zeros(len(SHAKEN))
    for k, row in enumerate(SHAKEN):
        velocity = float(row[s.VELOCITY_RPS])
        config = FRICTION._replace(viscous_nm_per_rps=0.003 + rise(row))
        state = friction_step(config, state, velocity, 0.0, COARSE_S)
        expected[k] = state.torque_nm - row[s.FRICTION_NM]
    assert np.abs(expected).max() > 0.004
    assert np.abs(load - expected).max() < 1e-12


def test_what_acts_on_the_base_is_in_the_raised_surface_as_well():
    """A level of no change takes nothing, whatever friction the signals tell."""
    rows = SHAKEN.copy()
    rows[:, s.FRICTION_NM] += 0.01 * np.sin(np.arange(len(rows)))
    load, _ = effects_along([Term("asymmetric_coulomb", {"share": 0.0})], rows, AXIS, COARSE_S)
    assert not load.any()


def test_a_wave_is_taken_where_the_step_was_and_not_where_it_ends():
    """At a constant speed a level of a wave lags by the travel S/B alone: half a step more would be 0.3 of a radian."""
    speed_rps, order, share = 8.0, 6.0, 0.2
    rows = np.zeros((4000, s.N_MOTION))
    friction = FrictionState(0.0, 0.0, 0.0, 0.0)
    for k in range(len(rows)):
        friction = friction_step(FRICTION, friction, speed_rps, 0.0, COARSE_S)
        rows[k, s.FRICTION_NM], rows[k, s.TRAVEL_REV] = friction.torque_nm, friction.travel_rev
    rows[:, s.DIRECTION], rows[:, s.VELOCITY_RPS] = 1.0, speed_rps
    angle = speed_rps * COARSE_S * np.arange(1, len(rows) + 1)
    rows[:, s.MOTOR_ANGLE_REV] = rows[:, s.SENSOR_ANGLE_REV] = angle
    load, _ = effects_along([Term("friction_ripple", {"cos_share": share, "order": order})], rows, AXIS, COARSE_S)
    phasor = 2.0 * np.mean((load * np.exp(-1j * TURN * order * angle))[2000:])
    fine = 200
    state, value = rows[-1, s.FRICTION_NM], np.empty(2000 * fine)
    base = np.empty(value.size)
    at = state
    places = np.arange(1, value.size + 1) * speed_rps * COARSE_S / fine
    contact = state - FRICTION.viscous_nm_per_rps * speed_rps
    for k, place in enumerate(places):
        level = state + share * math.cos(TURN * order * place) * contact
        at = torque_after(
            at, level, FRICTION.attraction_nm_per_rev / level, 0.0, 778.0, 1e3, speed_rps * COARSE_S / fine
        )
        value[k], base[k] = at, state
    half = value.size // 2
    exact = 2.0 * np.mean(((value - base) * np.exp(-1j * TURN * order * places))[half:])
    assert np.angle(phasor / exact) == pytest.approx(0.0, abs=0.06)
    assert abs(phasor) == pytest.approx(abs(exact), rel=0.03)


def test_a_lag_follows_a_ramp_between_the_instants():
    tau_s, slope = 0.005, 0.3
    rows = np.zeros((60, s.N_MOTION))
    time_s = np.arange(60) * COARSE_S
    rows[:, s.CURRENT_A] = slope * time_s
    load, _ = effects_along([Term("current_lag", {"share": 1.0, "tau_s": tau_s})], rows, AXIS, COARSE_S)
    expected = AXIS.torque_constant_nm_per_a * slope * tau_s * -np.expm1(-time_s / tau_s)
    assert np.allclose(load, expected, atol=1e-15)

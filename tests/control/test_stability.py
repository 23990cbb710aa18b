"""Margins against closed forms and against the figures of the paper's loop."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fffo_drive.control.stability import (
    ElasticLoad,
    LinearAxis,
    MeasuredResponse,
    _unwrapped,
    condition_14_nm_per_rev,
    impedance_nm_per_rps,
    loop_delay_s,
    loop_margins,
    over_loads,
    stick_slip_rps,
    stuck_axes,
)
from fffo_drive.model.parameters import Quantity, read_model

TABLE_1 = Path(__file__).resolve().parents[2] / "configs" / "models" / "table1.yaml"
KT = 0.148
DAMPING = KT / 26.17
PAPER = LinearAxis(0.166 * DAMPING, DAMPING, 0.003, KT)


def with_friction(**values):
    paper = read_model(TABLE_1)
    changed = {name: Quantity(value=value) for name, value in values.items()}
    return paper.model_copy(update={"friction": paper.friction.model_copy(update=changed)})


def test_margins_of_an_integrator_with_delay():
    # Kp Kt / (J s) exp(-Td s): crossover Kp Kt / J, phase margin 90 deg - wc Td, gain margin pi / (2 wc Td)
    axis = LinearAxis(1e-3, 0.0, 0.002, 0.1)
    margins = loop_margins(axis, 1.0, 0.0, 0.0)
    crossover = 1.0 * 0.1 / 1e-3
    assert margins.crossover_hz == pytest.approx(crossover / (2 * math.pi), rel=1e-3)
    assert margins.phase_deg == pytest.approx(90.0 - math.degrees(crossover * 0.002), abs=0.1)
    assert margins.gain == pytest.approx(math.pi / 2 / (crossover * 0.002), rel=1e-3)


def test_a_loop_of_two_integrators_and_a_lag_begins_below_180_degrees():
    """A position hold on a sliding axis: the phase margin at the crossover is that of its open loop there."""
    axis, kp, ki, hold = LinearAxis(1e-3, 0.003, 0.002, 0.1), 1.0, 10.0, 50.0
    margins = loop_margins(axis, kp, ki, 0.0, hold)
    s = 2j * math.pi * margins.crossover_hz
    open_loop = 0.1 * (kp + ki / s + hold / s**2) / (1e-3 * s + 0.003) * np.exp(-0.002 * s)
    assert margins.phase_deg == pytest.approx(180.0 + math.degrees(np.angle(open_loop)), abs=0.1)
    assert 60.0 < margins.phase_deg < 90.0


@pytest.mark.parametrize(
    ("gain_nm_per_rev", "phase_deg", "gain_margin"), [(0.0, 62, 3.4), (3.3, 53, 3.3), (10.0, 38, 3.0)]
)
def test_the_paper_loop_with_its_delay(gain_nm_per_rev, phase_deg, gain_margin):
    margins = loop_margins(PAPER, 0.975, 9.75, gain_nm_per_rev)
    assert margins.phase_deg == pytest.approx(phase_deg, abs=0.6)
    assert margins.gain == pytest.approx(gain_margin, abs=0.06)
    assert margins.crossover_hz == pytest.approx(24.0, rel=0.15)


def test_a_stuck_contact_is_a_spring_and_its_margin_is_known():
    # G = (Kp Kt + Ki Kt / s) / (J s + k / s) exp(-Td s): 90 deg - w Td - atan(Ki / (Kp w)) at the upper crossing
    inertia, contact, delay_s, kt, kp, ki = 1e-3, 22.0, 0.0025, 0.1, 1.4, 14.0
    axis = LinearAxis(inertia, 0.0, delay_s, kt, contact)
    margins = loop_margins(axis, kp, ki, 0.0)
    omega = 2.0 * math.pi * margins.crossover_hz
    assert abs(inertia * omega - contact / omega) == pytest.approx(kt * math.hypot(kp, ki / omega), rel=1e-3)
    assert omega > math.sqrt(contact / inertia)
    expected_deg = 90.0 - math.degrees(omega * delay_s) - math.degrees(math.atan(ki / (kp * omega)))
    assert margins.phase_deg == pytest.approx(expected_deg, abs=0.1)


@pytest.mark.parametrize(("stiffness_per_rev", "stiffer_than_seen"), [(500.0, False), (1e5, True)])
def test_a_contact_at_rest_is_between_its_levels_and_a_held_one_no_stiffer_than_its_position_shows(
    stiffness_per_rev, stiffer_than_seen
):
    coulomb_nm = with_friction().friction_config().coulomb_nm
    model = with_friction(stiffness_per_rev=stiffness_per_rev, static_nm=3.0 * coulomb_nm)
    friction = model.friction_config()
    at_coulomb, at_static = (
        level_nm * stiffness_per_rev + friction.attraction_nm_per_rev
        for level_nm in (friction.coulomb_nm, friction.static_nm)
    )
    softest = friction.static_nm / (32.0 * 2.0**-15) if stiffer_than_seen else at_coulomb
    found = [axis.contact_nm_per_rev for axis in stuck_axes(PAPER, model, 2.0**-15)]
    assert found == pytest.approx([softest, at_static], rel=1e-12)


def test_stick_slip_begins_where_the_stribeck_curve_falls_faster_than_kp_holds():
    # without delay, Ki and L, and with friction that follows at once: S'(w) + sigma + Kp Kt = 0
    model = with_friction(stribeck_exponent=2.0, stribeck_velocity_rps=0.5, attraction_nm_per_rev=1e6)
    friction = model.friction_config()
    axis = PAPER._replace(damping_nm_per_rps=friction.viscous_nm_per_rps, delay_s=0.0)
    drop_nm, steepest_rps = friction.static_nm - friction.coulomb_nm, 0.5 / math.sqrt(2.0)
    steepest = 2.0 * drop_nm * steepest_rps / 0.25 * math.exp(-0.5)
    enough = (steepest - friction.viscous_nm_per_rps) / KT
    assert stick_slip_rps(axis, friction, (1.01 * enough, 0.0, 0.0)) is None
    low_rps, high_rps = stick_slip_rps(axis, friction, (0.9 * enough, 0.0, 0.0))
    assert low_rps < steepest_rps < high_rps
    for speed_rps in (0.8 * low_rps, 1.25 * high_rps):
        slope = -2.0 * drop_nm * speed_rps / 0.25 * math.exp(-((speed_rps / 0.5) ** 2))
        assert slope + friction.viscous_nm_per_rps + 0.9 * enough * KT > 0.0
    # friction with memory does not follow: the paper's axis does not stick and slip under its own gains
    assert stick_slip_rps(PAPER, read_model(TABLE_1).friction_config(), (0.975, 9.75, 3.3)) is None


def test_an_elastic_load_is_the_whole_inertia_below_and_the_motors_above_its_resonance():
    axis = LinearAxis(1e-3, 0.0, 0.0, 0.1, elastic=ElasticLoad(0.4, 50.0, 0.0))
    slow, fast = np.array([1j]) * 2 * math.pi * 0.5, np.array([1j]) * 2 * math.pi * 5000.0
    assert abs(impedance_nm_per_rps(axis, slow)[0] / (1e-3 * slow[0])) == pytest.approx(1.0, rel=1e-3)
    assert abs(impedance_nm_per_rps(axis, fast)[0] / (0.6e-3 * fast[0])) == pytest.approx(1.0, rel=1e-3)
    # motor against load: the motor moves without torque; the load alone on its spring: the motor cannot be moved
    resonance, antiresonance = (np.array([2j * math.pi * f]) for f in (50.0, 50.0 * math.sqrt(0.6)))
    assert abs(impedance_nm_per_rps(axis, resonance)[0]) < 1e-9
    assert abs(impedance_nm_per_rps(axis, antiresonance * (1 + 1e-9))[0]) > 1e3


def test_a_loop_has_no_less_delay_than_its_period_and_half_of_one():
    model = read_model(TABLE_1)
    assert loop_delay_s(model, 0.0005) == pytest.approx(0.00275 + 0.00025)
    fitted = model.model_copy(update={"delay_s": Quantity(value=0.0008)})  # 0.0007 of it the sensor's
    assert loop_delay_s(fitted, 0.0005) == pytest.approx(0.0005 + 0.0007 + 0.00025)
    assert loop_delay_s(fitted, 0.0005, estimated=True) == pytest.approx(0.0005 + 0.00025)


def test_condition_14_fails_for_pi_alone_and_holds_from_l_of_3_2():
    assert condition_14_nm_per_rev(9.75, KT, 0.0, 2.33) == pytest.approx(1.443 - 4.66)
    assert condition_14_nm_per_rev(9.75, KT, 3.2, 2.33) < 0 < condition_14_nm_per_rev(9.75, KT, 3.22, 2.33)


def test_another_load_leaves_the_motor_and_the_spring_as_they_are():
    """Impedance of Jm beside Jl on the spring k and damper d, whatever Jl is; without a load only Jm."""
    share, frequency_hz, zeta = 0.3, 110.0, 0.05
    axis = LinearAxis(1e-3, 0.002, 0.003, KT, elastic=ElasticLoad(share, frequency_hz, zeta))
    motor, load = (1.0 - share) * 1e-3, share * 1e-3
    omega, reduced = 2.0 * math.pi * frequency_hz, motor * load / 1e-3
    spring, damper = omega**2 * reduced, 2.0 * zeta * omega * reduced
    s = 2j * math.pi * np.geomspace(1.0, 1000.0, 50)
    for factor in (0.25, 1.0, 4.0):
        joint = spring / s + damper
        expected = motor * s + 0.002 + joint * factor * load * s / (joint + factor * load * s)
        other = axis.with_inertia(motor + factor * load)
        np.testing.assert_allclose(impedance_nm_per_rps(other, s), expected, rtol=1e-9)
    for inertia in (motor, 0.9 * motor):
        bare = impedance_nm_per_rps(axis.with_inertia(inertia), s)
        np.testing.assert_allclose(bare, inertia * s + 0.002, rtol=1e-9)


def test_the_margins_over_a_range_are_those_of_its_ends():
    """An integrator with delay has its gain margin, pi / (2 wc Td) with wc = Kp Kt / J, from the least inertia; with an
    integral the largest has the smallest phase margin: 90 deg - wc Td - atan(Ki / (Kp wc)).
    """
    axis = LinearAxis(1e-3, 0.0, 0.002, 0.1, inertia_range_nm_s2_per_rev=(0.4e-3, 5e-3))
    margins = loop_margins(axis, 1.0, 0.0, 0.0)
    assert margins.gain == pytest.approx(math.pi / 2 * 0.4e-3 / (0.1 * 0.002), rel=1e-3)
    assert margins.phase_deg == pytest.approx(90.0 - math.degrees(0.1 / 0.4e-3 * 0.002), abs=0.1)
    slow = loop_margins(axis, 1.0, 30.0, 0.0)
    crossover = 2.0 * math.pi * slow.crossover_hz
    assert 20.0 <= crossover <= 45.0  # of the largest: Kp Kt / J, raised by the integral
    assert slow.phase_deg == pytest.approx(
        90.0 - math.degrees(0.002 * crossover + math.atan(30.0 / crossover)), abs=0.1
    )
    assert slow.gain == pytest.approx(loop_margins(axis.with_inertia(0.4e-3), 1.0, 30.0, 0.0).gain)


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.1, 1.0),
    st.floats(1.0, 10.0),
    st.floats(0.02, 0.6),
    st.floats(3.0, 30.0),
    st.floats(0.0, 5.0),
    st.sampled_from((0.0, 5.0, 60.0)),
)
def test_no_rigid_load_inside_a_range_has_smaller_margins_than_the_worst_of_its_ends(
    low, high, proportional, per_s, observer, contact
):
    axis = LinearAxis(1e-3, 0.003, 0.003, KT, contact, inertia_range_nm_s2_per_rev=(low * 1e-3, high * 1e-3))
    gains = proportional, per_s * proportional, observer
    worst = loop_margins(axis, *gains)
    if worst.phase_deg < 0.0 or worst.gain < 1.0:
        return  # not a stable loop: its margins say nothing
    for inertia in np.geomspace(low * 1e-3, high * 1e-3, 7):
        inside = loop_margins(axis.with_inertia(float(inertia)), *gains)
        assert min(inside.phase_deg, 45.0) >= min(worst.phase_deg, 45.0) - 0.3  # beyond it on a spring: a round peak
        assert inside.gain > worst.gain - 0.02


def test_a_range_includes_the_model_and_counts_for_stick_slip():
    axis = LinearAxis(2e-4, 0.003, 0.003, KT, inertia_range_nm_s2_per_rev=(1e-3, 5e-3))
    assert [one.inertia_nm_s2_per_rev for one in over_loads(axis)] == pytest.approx([2e-4, 5e-3])
    friction = read_model(TABLE_1).friction_config()
    gains = 0.2, 0.8, 0.0
    own, largest = (stick_slip_rps(axis.with_inertia(inertia), friction, gains) for inertia in (2e-4, 5e-3))
    assert own is None
    assert stick_slip_rps(axis, friction, gains) == largest is not None


@given(st.lists(st.floats(-2.0 * math.pi, 2.0 * math.pi) | st.sampled_from([0.0, math.pi, -math.pi]), min_size=2))
def test_the_phase_without_jumps_is_that_of_numpy_to_the_bit(steps):
    values = np.exp(1j * np.cumsum(steps))
    np.testing.assert_array_equal(_unwrapped(values), np.unwrap(np.angle(values)))
    real = np.where(np.array(steps) > 0.0, 1.0 + 0.0j, -1.0 + 0.0j)  # steps of half a turn, either way
    np.testing.assert_array_equal(_unwrapped(real), np.unwrap(np.angle(real)))


def test_a_degree_of_error_in_a_measured_response_is_a_degree_at_rest():
    stuck = PAPER._replace(contact_nm_per_rev=21.8)
    gains = 0.5, 5.0, 0.0
    found = loop_margins(stuck, *gains)
    frequencies_hz = tuple(np.geomspace(5.0, 400.0, 50).tolist())
    for degrees in (-1.0, 1.0):
        ratio = (complex(np.exp(1j * np.radians(degrees))),) * len(frequencies_hz)
        off = loop_margins(stuck._replace(measured=MeasuredResponse(frequencies_hz, ratio)), *gains)
        assert off.phase_deg == pytest.approx(found.phase_deg - degrees, abs=0.1)

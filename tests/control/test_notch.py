"""Notches on the error: closed forms of the filter, what drives the law behind them, and switches without a bump."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fffo_drive.control.controller import (
    ControllerConfig,
    controller_at_rest,
    controller_step,
    with_new_gains,
)
from fffo_drive.control.feedforward import NO_FEEDFORWARD, FeedforwardConfig, Reference, steady_reference
from fffo_drive.control.friction_observer import TOGGLE_FEEDFORWARD, TOGGLE_OFF, ObserverConfig
from fffo_drive.control.notch import (
    MOST_NOTCHES,
    NO_NOTCHES,
    Notch,
    NotchState,
    SectionState,
    notch_config,
    notch_step,
    notches_at_rest,
)
from fffo_drive.control.pi import PiConfig
from fffo_drive.control.stability import LinearAxis, loop_margins, notch_response
from fffo_drive.model.friction import FrictionConfig

PERIOD_S = 5e-4
TABLE1 = FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, 0)
NOTCH = Notch(110.0, 0.8, 0.1)
NOTCHES = st.builds(Notch, st.floats(5.0, 700.0), st.floats(0.05, 4.0), st.floats(0.0, 0.95))
LAW = ControllerConfig(
    PiConfig(0.975, 9.75), ObserverConfig(TABLE1, 5.0, 0.134, 0.1), NO_FEEDFORWARD, 0.148, 1e6, PERIOD_S, 0.9
)


def response(notches, *frequencies_hz, period_s=PERIOD_S):
    return notch_response(notches, 2j * math.pi * np.array(frequencies_hz), period_s)


def law(*notches, **changes):
    return LAW._replace(notches=notch_config(notches, PERIOD_S), **changes)


def step(config, state, reference_rps, velocity_rps, toggle=TOGGLE_OFF):
    return controller_step(config, state, toggle, steady_reference(reference_rps), velocity_rps, 0.0, velocity_rps, 0.0)


@given(NOTCHES)
def test_a_notch_has_its_depth_and_no_phase_at_its_frequency_and_passes_what_is_constant(notch):
    slowest, at = response((notch,), 1e-9, notch.frequency_hz)
    assert slowest == pytest.approx(1.0, abs=1e-9)
    assert at == pytest.approx(notch.depth, abs=1e-9)


def test_far_below_its_frequency_a_notch_takes_the_phase_that_its_width_costs():
    # (s^2 + d v w s + w^2) / (s^2 + v w s + w^2) for s << w: -(1 - d) v s / w
    lag_deg = -np.degrees(np.angle(response((NOTCH,), 2.0)[0]))
    expected_deg = math.degrees((1.0 - NOTCH.depth) * NOTCH.width * 2.0 / NOTCH.frequency_hz)
    assert lag_deg == pytest.approx(expected_deg, rel=0.02)


def test_a_notch_is_half_as_strong_in_power_at_the_edges_of_its_width():
    # of a notch that passes nothing: |w^2 - v^2| = width w v, whose solutions lie width w apart
    notch = Notch(30.0, 0.2, 0.0)  # far below the rate, where it is the continuous one
    edges_hz = [30.0 * (math.hypot(0.1, 1.0) + sign * 0.1) for sign in (-1.0, 1.0)]
    assert edges_hz[1] - edges_hz[0] == pytest.approx(0.2 * 30.0)
    assert np.abs(response((notch,), *edges_hz)) == pytest.approx([math.sqrt(0.5)] * 2, rel=0.01)


def matrix_of_a_period(config):
    """The kernel's step is linear: its matrix, from memory and value to the memory after it and what passes."""
    columns = []
    for one, two, three, four, value in np.eye(2 * MOST_NOTCHES + 1).tolist():
        memory = NotchState(SectionState(one, two), SectionState(three, four))
        passed, after = notch_step(config, memory, value)
        columns.append([*after.first, *after.second, passed])
    return np.array(columns).T


@settings(deadline=None)  # the first call compiles
@given(
    st.lists(NOTCHES, min_size=1, max_size=2),
    st.floats(2.0, 900.0),
    st.lists(st.floats(-9.0, 9.0), min_size=5, max_size=5),
)
def test_the_kernel_has_the_response_that_the_margins_count(notches, frequency_hz, numbers):
    config = notch_config(notches, PERIOD_S)
    period = matrix_of_a_period(config)
    one, two, three, four, value = numbers
    passed, after = notch_step(config, NotchState(SectionState(one, two), SectionState(three, four)), value)
    assert [*after.first, *after.second, passed] == pytest.approx(list(period @ numbers), abs=1e-12)
    # x' = A x + B u, y = C x + D u: a sine that has settled passes C (z - A)^-1 B + D
    turned = np.exp(2j * math.pi * frequency_hz * PERIOD_S) * np.eye(4) - period[:4, :4]
    found = period[4, :4] @ np.linalg.solve(turned, period[:4, 4]) + period[4, 4]
    assert found == pytest.approx(response(notches, frequency_hz)[0], abs=1e-6)
    assert np.abs(np.linalg.eigvals(period[:4, :4])).max() < 1.0  # whatever it began with decays


def test_a_law_without_notches_is_that_of_before_bit_for_bit():
    """A section that passes everything would already lose the sign of a zero."""
    state = controller_at_rest()
    for k in range(200):
        before_rps = state.filtered_error_rps
        terms, state = step(LAW, state, 1.0, math.sin(k), TOGGLE_FEEDFORWARD)
        assert terms.filtered_error_rps == before_rps + 0.9 * ((1.0 - math.sin(k)) - before_rps)
    assert state.notches == notches_at_rest()
    assert LAW.notches == notch_config((), PERIOD_S) == NO_NOTCHES


def test_a_resonance_in_the_velocity_does_not_reach_the_command_and_the_row_says_what_drove_the_law():
    config = law(Notch(110.0, 0.5, 0.0), error_share=1.0)
    state, commands_a, errors = controller_at_rest(), [], []
    for k in range(2000):
        terms, state = step(config, state, 1.0, 1.0 + math.sin(2.0 * math.pi * 110.0 * k * PERIOD_S))
        commands_a.append(terms.proportional_a)
        errors.append(terms.error_rps)
        assert terms.proportional_a == 0.975 * terms.filtered_error_rps
    assert max(errors[-200:]) > 0.99
    assert max(map(abs, commands_a[-200:])) < 1e-6


def test_feed_forward_does_not_pass_the_notches():
    """An axis that follows exactly gets the same command with and without them."""
    configs = [
        one._replace(feedforward=FeedforwardConfig(1e-3, 0.0, 0.0)) for one in (LAW, law(NOTCH, Notch(45.0, 1.0, 0.1)))
    ]
    states = [controller_at_rest()] * 2
    for k in range(400):
        velocity_rps = math.sin(2.0 * math.pi * 40.0 * k * PERIOD_S)
        reference = Reference(velocity_rps, 0.0, velocity_rps, 250.0 * velocity_rps, velocity_rps)
        found = [
            controller_step(one, state, TOGGLE_FEEDFORWARD, reference, velocity_rps, 0.0, velocity_rps, 0.0)
            for one, state in zip(configs, states, strict=True)
        ]
        states = [state for _, state in found]
        assert found[0][0] == found[1][0]


@settings(deadline=None)
@given(st.lists(NOTCHES, max_size=2), st.lists(NOTCHES, max_size=2), st.floats(-5.0, 5.0))
def test_notches_that_are_added_changed_or_removed_leave_the_command_where_it_is(before, after, error_rps):
    one, other = (law(*notches)._replace(pi=PiConfig(0.975, 0.0)) for notches in (before, after))
    state = controller_at_rest()._replace(filtered_error_rps=error_rps, toggle=TOGGLE_OFF)
    state = with_new_gains(LAW, one, state)  # after a constant error
    terms, state = step(one, state, error_rps, 0.0)
    for _ in range(3):
        then, state = step(other, with_new_gains(one, other, state), error_rps, 0.0)
        assert then.requested_a == pytest.approx(terms.requested_a, rel=1e-9, abs=1e-12)
        one = other


def test_margins_count_the_notches():
    # an integrator with delay: with a notch the phase at the crossover is less by that of the notch
    axis = LinearAxis(1e-3, 0.0, 0.002, 0.1, period_s=PERIOD_S)
    plain, notched = loop_margins(axis, 1.0, 0.0, 0.0), loop_margins(axis._replace(notches=(NOTCH,)), 1.0, 0.0, 0.0)
    at = response((NOTCH,), notched.crossover_hz)[0]
    crossover = 100.0 * abs(at)  # |N| Kp Kt / (J w) = 1
    assert 2.0 * math.pi * notched.crossover_hz == pytest.approx(crossover, rel=2e-3)
    expected_deg = 90.0 - math.degrees(crossover * 0.002) + math.degrees(np.angle(at))
    assert notched.phase_deg == pytest.approx(expected_deg, abs=0.2)
    assert notched.phase_deg < plain.phase_deg - 5.0

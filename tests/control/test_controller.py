"""PI and observer: closed forms, hand-over of the toggle, wind-up, freezing, clamping."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from fffo_drive.control.controller import (
    ControllerConfig,
    RestConfig,
    controller_at_rest,
    controller_step,
    pack_controller,
    unpack_controller,
    with_limited,
    with_torque_lost,
)
from fffo_drive.control.feedforward import NO_FEEDFORWARD, Reference, steady_reference
from fffo_drive.control.friction_observer import (
    TOGGLE_FEEDBACK,
    TOGGLE_FEEDFORWARD,
    TOGGLE_OFF,
    ObserverConfig,
)
from fffo_drive.control.pi import PiConfig, pi_step
from fffo_drive.model.friction import REST, FrictionConfig, friction_step, steady_friction_nm

PERIOD_S = 5e-4
KT = 0.148
CREEP_RPS = 1e-12  # moves, but so slowly that the estimate has no decay
TABLE1 = FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, 0)
CONFIG = ControllerConfig(
    PiConfig(0.975, 9.75), ObserverConfig(TABLE1, 5.0, 0.134, 0.1), NO_FEEDFORWARD, KT, 20.0, PERIOD_S
)


def step(config, state, toggle, reference, velocity_rps, effects_nm):
    """The law with an error of the drive's own velocity."""
    return controller_step(config, state, toggle, reference, velocity_rps, effects_nm, velocity_rps, 0.0)


def run(config, toggles, references, velocities, state=None):
    """Commands and states over sequences."""
    state = state or controller_at_rest()
    terms_list = []
    for toggle, reference, velocity in zip(toggles, references, velocities, strict=True):
        terms, state = step(config, state, int(toggle), steady_reference(float(reference)), float(velocity), 0.0)
        terms_list.append(terms)
    return terms_list, state


def test_pi_is_its_closed_form_for_a_constant_error():
    n = 400
    terms, _ = run(CONFIG, [TOGGLE_OFF] * n, [1.0] * n, [0.4] * n)
    time_s = PERIOD_S * np.arange(1, n + 1)
    np.testing.assert_allclose([t.command_a for t in terms], 0.6 * (0.975 + 9.75 * time_s), rtol=1e-12)


def test_the_integral_stands_still_in_saturation_and_leaves_it_at_once():
    integral_a = 0.0
    for _ in range(2000):
        _, integral_a = pi_step(CONFIG.pi, integral_a, 30.0, 0.0, 20.0, False, PERIOD_S)
    assert integral_a == 0.0  # the proportional term alone is beyond the limit
    _, lowered = pi_step(CONFIG.pi, 15.0, -1.0, 20.0, 20.0, False, PERIOD_S)
    assert lowered < 15.0  # an error that leads back is integrated
    _, held = pi_step(CONFIG.pi, 1.0, 0.5, 0.0, 20.0, True, PERIOD_S)
    assert held == 1.0  # limited by the envelope, which the law cannot see


def test_no_overshoot_of_the_command_after_a_long_saturation():
    inertia, velocity = 9.4e-4, 0.0
    state = controller_at_rest()
    peak = 0.0
    config = CONFIG._replace(current_limit_a=1.0)
    for _ in range(4000):
        terms, state = step(config, state, TOGGLE_OFF, steady_reference(10.0), velocity, 0.0)
        velocity += PERIOD_S / inertia * KT * terms.command_a
        peak = max(peak, velocity)
    assert peak < 10.0 * 1.35  # the zero's overshoot; with wind-up it is beyond 2


def test_observer_in_feedforward_follows_the_model_and_is_injected_through_kt():
    n = 4000
    ramp = np.minimum(np.arange(n) * 1e-3, 2.0)  # switched on at rest, where there is nothing to hand over
    terms, _ = run(CONFIG, [TOGGLE_FEEDFORWARD] * n, ramp, ramp)
    last = terms[-1]
    assert last.friction_nm == pytest.approx(steady_friction_nm(TABLE1, 2.0), rel=1e-6)
    assert last.requested_a == pytest.approx(last.friction_nm / KT)
    assert last.observation_nm_per_s == 0.0


def test_a_persistent_error_is_learned_as_friction_up_to_the_clamp():
    n = 4000
    config = CONFIG._replace(pi=PiConfig(0.0, 0.0), current_limit_a=1e3)
    terms, _ = run(config, [TOGGLE_FEEDFORWARD] * n, [CREEP_RPS] * n, [-0.1] * n)
    friction = np.array([t.friction_nm for t in terms])
    np.testing.assert_allclose(np.diff(friction[:100]), 5.0 * 0.1 * PERIOD_S, rtol=1e-9)
    assert friction.max() == pytest.approx(0.134)


def test_observation_is_frozen_while_the_command_is_limited():
    creep = steady_reference(CREEP_RPS)
    terms, state = step(CONFIG, controller_at_rest(), TOGGLE_FEEDFORWARD, creep, -0.5, 0.0)
    assert terms.observation_nm_per_s == pytest.approx(2.5)
    terms, _ = step(CONFIG, with_limited(state, True), TOGGLE_FEEDFORWARD, creep, -0.5, 0.0)
    assert terms.observation_nm_per_s == 0.0
    saturated = CONFIG._replace(current_limit_a=0.1)
    first, state = step(saturated, controller_at_rest(), TOGGLE_FEEDFORWARD, steady_reference(5.0), 0.0, 0.0)
    assert first.limited
    second, _ = step(saturated, state, TOGGLE_FEEDFORWARD, steady_reference(5.0), 0.0, 0.0)
    assert second.observation_nm_per_s == 0.0


@pytest.mark.parametrize("toggle", [TOGGLE_FEEDFORWARD, TOGGLE_FEEDBACK])
def test_at_rest_the_estimate_holds_and_the_integral_alone_acts(toggle):
    """Two integrators on one stuck axis would hunt."""
    _, state = run(CONFIG, [toggle] * 2000, [1.0] * 2000, [1.0] * 2000)
    terms, after = run(CONFIG, [toggle] * 400, [0.0] * 400, [0.0] * 200 + [-0.05] * 200, state)
    assert all(t.observation_nm_per_s == 0.0 for t in terms)
    assert after.friction.torque_nm == state.friction.torque_nm
    assert after.integral_a == pytest.approx(state.integral_a + 9.75 * 0.05 * 200 * PERIOD_S)


@pytest.mark.parametrize(
    ("before", "after"), list(itertools.permutations([TOGGLE_OFF, TOGGLE_FEEDFORWARD, TOGGLE_FEEDBACK], 2))
)
@pytest.mark.parametrize("reference_rps", [0.05, 1.0, -12.0])
def test_switching_while_running_makes_no_bump(before, after, reference_rps):
    """Across the switch the command moves no more than it does from tick to tick without one."""
    n = 3000
    velocities = np.full(n, reference_rps * 0.98)
    references = np.full(n, reference_rps)
    _, state = run(CONFIG, [before] * n, references, velocities)
    unswitched, _ = step(CONFIG, state, before, steady_reference(reference_rps), reference_rps * 0.98, 0.0)
    switched, after_state = step(CONFIG, state, after, steady_reference(reference_rps), reference_rps * 0.98, 0.0)
    assert abs(switched.command_a - unswitched.command_a) < 0.02
    second, _ = step(CONFIG, after_state, after, steady_reference(reference_rps), reference_rps * 0.98, 0.0)
    assert abs(second.command_a - switched.command_a) < 0.02


def test_a_start_hands_nothing_over_though_the_reference_ahead_moves_already():
    """The first step of a profile that is read ahead: the estimate is that of an unloaded contact, (7) from F = 0."""
    starting = Reference(0.0, 0.0, 0.01, 0.0, 0.0)
    terms, state = step(CONFIG, controller_at_rest(), TOGGLE_FEEDFORWARD, starting, 0.0, 0.0)
    expected_nm = friction_step(TABLE1, REST, 0.01, 0.0, PERIOD_S).torque_nm
    assert (terms.friction_nm, terms.integral_a, state.integral_a) == (expected_nm, 0.0, 0.0)
    assert terms.command_a == pytest.approx(expected_nm / KT, rel=1e-12)


def test_off_hands_the_estimate_to_the_integrator():
    _, state = run(CONFIG, [TOGGLE_FEEDFORWARD] * 2000, [1.0] * 2000, [1.0] * 2000)
    terms, after = step(CONFIG, state, TOGGLE_OFF, steady_reference(1.0), 1.0, 0.0)
    assert terms.friction_nm == 0.0
    assert after.integral_a == pytest.approx(state.integral_a + state.friction.torque_nm / KT)


def test_feedback_reverses_only_beyond_the_band():
    n = 2000
    _, state = run(CONFIG, [TOGGLE_FEEDBACK] * n, [1.0] * n, [1.0] * n)
    _, inside = step(CONFIG, state, TOGGLE_FEEDBACK, steady_reference(1.0), -0.09, 0.0)
    _, outside = step(CONFIG, state, TOGGLE_FEEDBACK, steady_reference(1.0), -0.11, 0.0)
    assert inside.friction.direction == 1.0
    assert outside.friction.direction == -1.0


def test_the_parameter_block_is_the_record():
    assert unpack_controller(pack_controller(CONFIG)) == CONFIG


def test_a_feed_forward_that_goes_at_once_is_handed_to_the_integrator():
    steady = steady_reference(2.0)
    _, state = run(CONFIG, [TOGGLE_FEEDFORWARD] * 200, [2.0] * 200, [1.9] * 200)
    before, _ = step(CONFIG, state, TOGGLE_FEEDFORWARD, steady, 1.9, 0.02)
    after, _ = step(CONFIG, with_torque_lost(CONFIG, state, 0.02), TOGGLE_FEEDFORWARD, steady, 1.9, 0.0)
    assert abs(after.command_a - before.command_a) < 1e-12
    assert before.requested_a - after.proportional_a - before.integral_a == pytest.approx(
        (before.friction_nm + 0.02) / CONFIG.torque_constant_nm_per_a
    )


def test_what_is_learned_in_the_integral_is_a_pi_with_l_over_kt_more_and_the_friction_is_the_model():
    n = 300
    beside = CONFIG._replace(observer=CONFIG.observer._replace(learns_in_integral=True))
    stronger = CONFIG._replace(
        pi=CONFIG.pi._replace(integral_a_per_rev=9.75 + 5.0 / KT),
        observer=CONFIG.observer._replace(gain_nm_per_rev=0.0),
    )
    velocities = 2.0 + 0.1 * np.sin(0.05 * np.arange(n))
    one, other = (run(c, [TOGGLE_FEEDFORWARD] * n, [2.0] * n, velocities)[0] for c in (beside, stronger))
    np.testing.assert_allclose([t.command_a for t in one], [t.command_a for t in other], rtol=1e-12)
    assert [t.friction_nm for t in one] == [t.friction_nm for t in other]
    assert max(abs(t.observation_nm_per_s) for t in one) > 0.0  # the row still says what was learned


def test_at_rest_the_estimate_is_released_with_its_time_constant_and_the_next_start_is_of_an_unloaded_contact():
    share = 1.0 - np.exp(-PERIOD_S / 0.1)
    config = CONFIG._replace(rest=RestConfig(1.0, share, share))
    _, moving = run(config, [TOGGLE_FEEDFORWARD] * 400, [1.0] * 400, [1.0] * 400)
    terms, rested = run(config, [TOGGLE_FEEDFORWARD] * 200, [0.0] * 200, [0.0] * 200, moving)
    assert terms[-1].friction_nm == pytest.approx(moving.friction.torque_nm * np.exp(-1.0), rel=1e-9)
    assert rested.friction[1:] == (0.0, 0.0, 0.0)
    long = rested._replace(friction=rested.friction._replace(torque_nm=0.0), integral_a=0.0)
    starts = [run(config, [TOGGLE_FEEDFORWARD] * 40, [w] * 40, [w] * 40, long)[0] for w in (0.5, -0.5)]
    np.testing.assert_array_equal([t.friction_nm for t in starts[0]], [-t.friction_nm for t in starts[1]])


def test_gains_fade_at_rest_and_are_whole_in_the_first_tick_of_motion():
    share = 1.0 - np.exp(-PERIOD_S / 0.1)
    config = CONFIG._replace(rest=RestConfig(0.4, share, 0.0))
    n = 200
    terms, state = run(config, [TOGGLE_OFF] * n, [0.0] * n, [0.01] * n)
    faded = 1.0 - 0.6 * (1.0 - np.exp(-PERIOD_S * np.arange(1, n + 1) / 0.1))
    np.testing.assert_allclose([t.proportional_a for t in terms], -0.01 * 0.975 * faded, rtol=1e-9)
    np.testing.assert_allclose(np.diff([t.integral_a for t in terms]), -0.01 * 9.75 * PERIOD_S * faded[1:], rtol=1e-9)
    moving, state = run(config, [TOGGLE_OFF], [0.5], [0.01], state)
    assert moving[0].proportional_a == 0.975 * 0.49
    assert state.rest == 0.0


def test_a_single_tick_at_zero_is_no_rest():
    """A reference that crosses zero may hit it: the estimate goes on where it was."""
    share = 1.0 - np.exp(-PERIOD_S / 0.1)
    config = CONFIG._replace(rest=RestConfig(0.4, share, share))
    references = np.full(401, 1.0)
    whole, _ = run(config, [TOGGLE_FEEDFORWARD] * 401, references, references)
    references[200] = 0.0
    with_zero, _ = run(config, [TOGGLE_FEEDFORWARD] * 401, references, references)
    lost = abs(with_zero[-1].friction_nm - whole[-1].friction_nm)
    assert lost < share * abs(whole[200].friction_nm)

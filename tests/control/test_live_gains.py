"""New gains on a running law: the command goes on where it was, whatever is done to the gains."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fffo_drive.control.controller import (
    ControllerConfig,
    RestConfig,
    controller_at_rest,
    controller_step,
    with_new_gains,
)
from fffo_drive.control.feedforward import NO_FEEDFORWARD, steady_reference
from fffo_drive.control.friction_observer import TOGGLE_FEEDBACK, TOGGLE_FEEDFORWARD, TOGGLE_OFF, ObserverConfig
from fffo_drive.control.pi import PiConfig
from fffo_drive.model.friction import FrictionConfig

PERIOD_S = 5e-4
TABLE1 = FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, 0)
GAINS = st.floats(0.05, 5.0)


def step(config, state, toggle, reference, velocity_rps, effects_nm):
    """The law with an error of the drive's own velocity."""
    return controller_step(config, state, toggle, reference, velocity_rps, effects_nm, velocity_rps, 0.0)


def law(proportional: float, integral: float, observer: float) -> ControllerConfig:
    return ControllerConfig(
        PiConfig(proportional, integral),
        ObserverConfig(TABLE1, observer, 0.134, 0.1),
        NO_FEEDFORWARD,
        0.148,
        1e6,
        PERIOD_S,
    )


@settings(deadline=None)  # the first call compiles
@given(
    st.sampled_from([TOGGLE_OFF, TOGGLE_FEEDFORWARD, TOGGLE_FEEDBACK]),
    GAINS, GAINS, GAINS, GAINS, st.floats(0.0, 10.0), st.floats(0.0, 10.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0),
)  # fmt: skip
def test_a_change_of_gains_moves_the_command_no_more_than_a_period_of_the_law_does(
    toggle, kp, ki, new_kp, new_ki, observer, new_observer, reference_rps, velocity_rps
):
    before, after = law(kp, ki, observer), law(new_kp, new_ki, new_observer)
    state = controller_at_rest()
    for _ in range(50):
        terms, state = step(before, state, toggle, steady_reference(reference_rps), velocity_rps, 0.0)
    then, _ = step(
        after, with_new_gains(before, after, state), toggle, steady_reference(reference_rps), velocity_rps, 0.0
    )
    error_rps = abs(reference_rps - velocity_rps)
    one_period_a = (new_ki + new_observer / 0.148) * error_rps * PERIOD_S
    settling_a = abs(then.friction_nm - terms.friction_nm) / 0.148  # what the friction model does in a period anyhow
    assert abs(then.requested_a - terms.requested_a) <= 1.01 * (one_period_a + settling_a) + 1e-9


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_lower_bound_of_the_estimate_leaves_the_command_where_it_is(sign):
    """The observer carries a load beyond the new bound; the integrator takes over what the bound cuts off."""
    before = law(0.5, 0.0, 5.0)
    after = before._replace(observer=before.observer._replace(clamp_nm=0.067))
    state = controller_at_rest()
    for _ in range(200):
        terms, state = step(before, state, TOGGLE_FEEDFORWARD, steady_reference(0.01 * sign), -0.5 * sign, 0.0)
    assert abs(terms.friction_nm) > 0.1
    then, _ = step(
        after, with_new_gains(before, after, state), TOGGLE_FEEDFORWARD, steady_reference(0.01 * sign), -0.5 * sign, 0.0
    )
    assert abs(then.friction_nm) == 0.067
    assert math.isclose(then.requested_a, terms.requested_a, rel_tol=1e-9)


def test_the_same_gains_change_nothing():
    config = law(0.975, 9.75, 5.0)
    _, state = step(config, controller_at_rest(), TOGGLE_FEEDFORWARD, steady_reference(1.0), 0.3, 0.0)
    assert with_new_gains(config, config, state) == state


@given(GAINS, GAINS, st.floats(0.02, 1.0), st.floats(0.02, 1.0), st.floats(-1.0, 1.0))
def test_a_change_of_gains_at_rest_counts_with_the_share_that_is_in_force_there(kp, new_kp, share, new_share, rps):
    before = law(kp, 0.0, 0.0)._replace(rest=RestConfig(share, 1.0, 0.0))
    after = law(new_kp, 0.0, 0.0)._replace(rest=RestConfig(new_share, 1.0, 0.0))
    terms, state = step(before, controller_at_rest(), TOGGLE_OFF, steady_reference(0.0), rps, 0.0)
    assert math.isclose(terms.requested_a, -share * kp * rps, rel_tol=1e-9, abs_tol=1e-12)
    then, _ = step(after, with_new_gains(before, after, state), TOGGLE_OFF, steady_reference(0.0), rps, 0.0)
    assert math.isclose(then.requested_a, terms.requested_a, rel_tol=1e-9, abs_tol=1e-9)

"""Adaptation of offset, Coulomb and viscous friction: known truth is learned, at its rate, and only where it may be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fffo_drive.config.axis import model_of, read_axis
from fffo_drive.config.profile_sections import PaperProfile
from fffo_drive.config.sections import AdaptationSection, FeedforwardSection, RestSection
from fffo_drive.control.adaptation import (
    COULOMB_AT_BOUND,
    OFFSET_AT_BOUND,
    AdaptationConfig,
    Adapted,
    adaptation_at_start,
    adaptation_step,
    adapted_torque,
    bounds_reached,
)
from fffo_drive.control.controller import (
    ControllerConfig,
    adapts_another_model,
    controller_at_rest,
    controller_step,
    with_limited,
)
from fffo_drive.control.feedforward import NO_FEEDFORWARD, steady_reference
from fffo_drive.control.friction_observer import (
    TOGGLE_FEEDBACK,
    TOGGLE_FEEDFORWARD,
    TOGGLE_OFF,
    ObserverConfig,
)
from fffo_drive.control.pi import PiConfig
from fffo_drive.control.reference import MODE_VELOCITY
from fffo_drive.control.velocity_estimator import VelocityEstimatorTerms
from fffo_drive.jit import njit
from fffo_drive.model.friction import FrictionConfig, settled_friction
from fffo_drive.runtime.adaptation_watch import BoundWatch
from fffo_drive.runtime.tick import LawOutput, give_adapted, learn, terms_of_current
from fffo_drive.workflows.plan import checked_plan
from fffo_drive.workflows.simulate import simulate

AXIS = Path(__file__).resolve().parents[2] / "configs" / "axis_simulated.yaml"
TABLE1 = FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, 0)
PERIOD_S = 5e-4
TIME_S = 5.0
CONFIG = AdaptationConfig(True, PERIOD_S / TIME_S, 0.02, 0.002)
LAW = ControllerConfig(
    PiConfig(0.975, 9.75),
    ObserverConfig(TABLE1, 5.0, 0.134, 0.1, True),
    NO_FEEDFORWARD,
    0.148,
    20.0,
    PERIOD_S,
    adaptation=CONFIG,
)
TRUTH = np.array([0.004, -0.006, 0.0005])  # offset, Coulomb (Nm), viscous (Nm/rps)


@njit
def _learn(config, state, contact, velocity_rps, truth, of_friction, found, learns):
    for k in range(contact.shape[0]):
        c, w = contact[k], velocity_rps[k]
        friction_nm = (truth[k, 1] - state.coulomb_nm) * c + (truth[k, 2] - state.viscous_nm_per_rps) * w
        missing_nm = truth[k, 0] - state.offset_nm + of_friction * friction_nm
        learns[k], state = adaptation_step(config, state, c, w, missing_nm)
        found[k, 0], found[k, 1], found[k, 2] = state.offset_nm, state.coulomb_nm, state.viscous_nm_per_rps


def learned_over(contact, velocity_rps, truth=TRUTH, config=CONFIG, of_friction=1.0):
    """Parameters (n, 3) and whether they were learned (n,), where P and I give all that is missing in every tick.

    `truth`: (3,), or (n, 3) where it changes. `of_friction`: the share of the missing friction that they give.
    """
    found, learns = np.empty((contact.size, 3)), np.empty(contact.size, bool)
    every = np.ascontiguousarray(np.broadcast_to(truth, found.shape))
    _learn(config, adaptation_at_start(), contact, velocity_rps, every, of_friction, found, learns)
    return found, learns


def to_and_fro(duration_s, hz=1.3):
    time_s = np.arange(round(duration_s / PERIOD_S)) * PERIOD_S
    velocity_rps = 5.0 * np.sin(2.0 * np.pi * hz * time_s + 0.3)
    return np.sign(velocity_rps), velocity_rps


def test_known_change_is_learned_whatever_its_signs_are():
    found, learns = learned_over(*to_and_fro(12 * TIME_S))
    np.testing.assert_allclose(found[-1], TRUTH, rtol=0.02)
    assert learns.mean() > 0.99


def test_the_step_response_is_that_of_two_lags_of_t_and_two_t():
    """2 T^2 p'' + 2 T p' + p = truth, damped by 0.7, once the means have forgotten how they began."""
    settled, _ = learned_over(*to_and_fro(10 * TIME_S), truth=np.zeros(3))
    assert np.abs(settled).max() == 0.0
    contact, velocity_rps = to_and_fro(20 * TIME_S)
    n = contact.size // 2
    truth = np.zeros((2 * n, 3))
    truth[n:, 0] = 0.004
    found, _ = learned_over(contact, velocity_rps, truth, of_friction=0.0)
    time = np.arange(n) * PERIOD_S / TIME_S
    expected = 1.0 - np.exp(-0.5 * time) * (np.cos(0.5 * time) + np.sin(0.5 * time))
    np.testing.assert_allclose(found[n:, 0] / 0.004, expected, atol=0.02)


def test_an_axis_that_turns_one_way_is_not_adapted():
    velocity_rps = 3.0 + np.sin(np.arange(20_000) * 2e-3)
    found, learns = learned_over(np.ones(20_000), velocity_rps)
    assert not learns.any()
    assert np.abs(found).max() == 0.0


def test_at_one_speed_viscous_friction_is_not_adapted_and_coulomb_friction_takes_it():
    contact = np.sign(to_and_fro(12 * TIME_S)[0] + 0.1)
    found, learns = learned_over(contact, 4.0 * contact)
    assert learns.mean() > 0.99
    assert np.abs(found[:, 2]).max() == 0.0
    np.testing.assert_allclose(found[-1, :2], [0.004, -0.006 + 4.0 * 0.0005], rtol=0.02)


def test_bounds_hold_for_the_value_and_for_its_rate():
    found, _ = learned_over(*to_and_fro(6 * TIME_S), truth=np.array([1.0, -1.0, 0.0]))
    assert np.abs(found[:, :2]).max() == CONFIG.torque_bound_nm
    assert np.abs(np.diff(found, axis=0)).max() <= CONFIG.step_share * CONFIG.torque_bound_nm * (1.0 + 1e-9)
    state = adaptation_at_start()._replace(offset_nm=found[-1, 0], coulomb_nm=found[-1, 1])
    assert bounds_reached(CONFIG, state) == OFFSET_AT_BOUND | COULOMB_AT_BOUND
    assert bounds_reached(CONFIG._replace(used=False), state) == 0


def test_a_bound_is_reported_when_it_is_reached_and_again_after_it_was_left():
    watch = BoundWatch()
    assert watch.news(0) is None
    assert "adaptation of Coulomb friction has reached its bound" in watch.news(COULOMB_AT_BOUND)
    assert watch.news(COULOMB_AT_BOUND) is None
    assert watch.news(COULOMB_AT_BOUND | OFFSET_AT_BOUND).startswith("adaptation of offset has")
    assert watch.news(0) is None
    assert watch.news(COULOMB_AT_BOUND) is not None


def test_the_contact_is_one_in_steady_sliding_beyond_the_stribeck_flank():
    state = adaptation_at_start()._replace(coulomb_nm=0.01)
    for speed_rps in (-20.0, 20.0):
        settled = settled_friction(TABLE1, speed_rps)
        given = adapted_torque(TABLE1, state, settled.torque_nm, speed_rps)
        assert given.contact == pytest.approx(np.sign(speed_rps), rel=1e-3)
        assert given.torque_nm == pytest.approx(0.01 * given.contact)


STATE = adaptation_at_start()._replace(offset_nm=0.003, coulomb_nm=0.005, viscous_nm_per_rps=0.0004)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (TOGGLE_OFF, TOGGLE_FEEDFORWARD),
        (TOGGLE_FEEDFORWARD, TOGGLE_OFF),
        (TOGGLE_FEEDFORWARD, TOGGLE_FEEDBACK),
        (TOGGLE_FEEDBACK, TOGGLE_FEEDFORWARD),
    ],
)
def test_the_command_does_not_jump_where_the_toggle_changes(before, after):
    reference = steady_reference(5.0)

    def run(controller, toggles):
        commands, given_nm = [], []
        last_nm = 0.0
        for toggle in toggles:
            given, controller = give_adapted(LAW, STATE, controller, MODE_VELOCITY, reference, toggle, True, last_nm)
            last_nm = given.torque_nm
            terms, controller = controller_step(LAW, controller, toggle, reference, 5.0, last_nm, 5.0, 0.0)
            commands.append(terms.command_a)
            given_nm.append(last_nm)
        return np.array(commands), np.array(given_nm)

    commands, given_nm = run(controller_at_rest(), [before] * 4000 + [after] * 10)
    assert abs(given_nm[4000] - given_nm[3999]) > 0.005  # something was handed over
    assert np.abs(np.diff(commands[3990:])).max() < 1e-4


@pytest.mark.parametrize("toggle", [TOGGLE_OFF, TOGGLE_FEEDFORWARD, TOGGLE_FEEDBACK])
def test_what_was_learned_acts_from_the_first_step_after_a_restart_of_the_law(toggle):
    rest = steady_reference(0.0)
    given, controller = give_adapted(LAW, STATE, controller_at_rest(), MODE_VELOCITY, rest, toggle, True, 0.0)
    terms, _ = controller_step(LAW, controller, toggle, rest, 0.0, given.torque_nm, 0.0, 0.0)
    learned_nm = STATE.offset_nm if toggle == TOGGLE_FEEDFORWARD else 0.0
    assert terms.command_a == pytest.approx(learned_nm / LAW.torque_constant_nm_per_a)


NO_ESTIMATE = VelocityEstimatorTerms(0.0, 0.0, 0.0, False)


def test_nothing_is_learned_at_rest_where_limited_with_another_toggle_or_from_what_is_no_number():
    controller = controller_at_rest()._replace(toggle=TOGGLE_FEEDFORWARD)
    terms = terms_of_current(0.0)._replace(integral_a=0.1)
    given = Adapted(1.0, 0.0)

    def learns(law_terms=terms, value=5.0, config=LAW, memory=controller):
        law = LawOutput(MODE_VELOCITY, steady_reference(value), law_terms, 0.0, NO_ESTIMATE)
        return learn(config, STATE, given, law, memory)[1] != STATE

    assert learns()
    assert not learns(value=0.0)
    assert not learns(memory=with_limited(controller, True))
    assert not learns(memory=controller._replace(toggle=TOGGLE_FEEDBACK))
    assert not learns(config=LAW._replace(adaptation=CONFIG._replace(used=False)))
    assert not learns(terms._replace(proportional_a=float("nan")))


def test_new_gains_keep_what_was_learned_and_another_model_does_not():
    assert not adapts_another_model(LAW, LAW._replace(pi=PiConfig(0.5, 5.0)))
    other = LAW.observer._replace(friction=TABLE1._replace(coulomb_nm=0.02))
    assert adapts_another_model(LAW, LAW._replace(observer=other))
    assert adapts_another_model(LAW, LAW._replace(adaptation=CONFIG._replace(torque_bound_nm=0.01)))


def axis_with(enabled):
    axis = read_axis(AXIS)
    changed = {
        "observer": axis.controller.observer.model_copy(update={"learns_in": "integral"}),
        "at_rest": RestSection(gain_share=0.5, release_friction=True),
        "feedforward": FeedforwardSection(inertia=True, preview=True, delay_aware=True),
        "adaptation": AdaptationSection(enabled=enabled, time_s=20.0),
    }
    controller = axis.controller.model_copy(update=changed)
    return axis.model_copy(update={"controller": controller, "profile": PaperProfile(kind="paper", slope=0.0)})


def test_on_the_plant_a_wrong_level_is_learned_and_the_error_falls():
    """Five surfaces, which share no equation with the model: its level 25 % too low is found within two minutes."""
    model = model_of(AXIS, read_axis(AXIS))
    friction = model.friction
    low = {
        name: getattr(friction, name).model_copy(update={"value": 0.75 * getattr(friction, name).value})
        for name in ("coulomb_nm", "static_nm")
    }
    wrong = model.model_copy(update={"friction": friction.model_copy(update=low), "content_hash": None})
    plan = checked_plan(AXIS, axis_with(False), wrong)
    profile = plan.profile._replace(
        values=np.tile(plan.profile.values, 3), derivatives=np.tile(plan.profile.derivatives, 3)
    )
    errors = {}
    for enabled in (False, True):
        done = simulate(plan._replace(axis=axis_with(enabled), profile=profile), TOGGLE_FEEDFORWARD)
        assert done.fault is None
        rows = done.rows
        late = rows[(rows["mode"] == MODE_VELOCITY) & (rows["profile_sample"] >= 2 * profile.values.size // 3)]
        errors[enabled] = np.mean(
            (late["reference_rps"] - late["true_velocity_rps"])[10_000:80_000] ** 2
        )  # behind the jump
    learned_nm = late["adapted_coulomb_nm"].mean()
    assert learned_nm == pytest.approx(0.25 * friction.coulomb_nm.value, rel=0.35)
    assert errors[True] < 0.7 * errors[False]

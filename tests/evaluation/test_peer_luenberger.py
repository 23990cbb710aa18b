"""The friction observer on the position: eigenvalues, its step on an axis in closed form, friction found, margins."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import pytest
from scipy.linalg import expm

from fffo_drive.control.feedforward import FeedforwardConfig, steady_reference
from fffo_drive.control.pi import PiConfig
from fffo_drive.control.stability import LinearAxis
from fffo_drive.evaluation.peers.constants import MEMORY_SLOTS, PeerConfig, command_for
from fffo_drive.evaluation.peers.design import ObserverForm, observer_gains
from fffo_drive.evaluation.peers.fit import TABLE_1
from fffo_drive.evaluation.peers.luenberger import (
    FRICTION_NM,
    HISTORY,
    LuenbergerLoop,
    eigenvalues,
    estimate_after,
    further_pole_rad_per_s,
    luenberger_step,
    observe,
    stiffest_nm_per_rev,
    tangent_stiffness,
)
from fffo_drive.identification.tuning import Wish
from fffo_drive.model.friction import REST, friction_step, steady_friction_nm
from fffo_drive.packing import pack

PERIOD_S = 0.0005
INERTIA, VISCOUS, KT = 9.425e-4, 0.003, 0.148
SLOW = 180.0
FAST = SLOW + further_pole_rad_per_s(TABLE_1, INERTIA)
STIFFEST = stiffest_nm_per_rev(TABLE_1)
# neither coulomb nor static friction: nothing of the model is left
NO_FRICTION = TABLE_1._replace(
    coulomb_nm=1e-12, static_nm=1e-12, viscous_nm_per_rps=0.0, stiffness_per_rev=1.0, attraction_nm_per_rev=0.0
)
PI = PiConfig(0.5, 5.0)
PEER = PeerConfig(PI, FeedforwardConfig(0.0, 0.0, 0.0), KT, 16.6, PERIOD_S, 1.0)
TICKS = 6  # of transport; a command is held for a period and is half of one later on average


def law(model=TABLE_1, pi=PI, slow=SLOW, fast=FAST, ticks=TICKS):
    return LuenbergerLoop(PEER._replace(pi=pi), model, INERTIA, slow, fast, ticks + 0.5)


class Axis:
    """Inertia with friction in the direction of the motion: position and velocity exact for a held command."""

    def __init__(self, ticks=TICKS, viscous=0.0, friction_nm=0.0):
        self.late = deque([0.0] * ticks, maxlen=ticks)
        self.viscous, self.friction_nm = viscous, friction_nm
        self.position_rev, self.velocity_rps = 0.0, 0.0

    def follow(self, command_a):
        torque_nm = KT * self.late[0] - self.friction_nm - self.viscous * self.velocity_rps
        self.late.append(command_a)
        gained_rps = torque_nm / INERTIA * PERIOD_S
        self.position_rev += (self.velocity_rps + 0.5 * gained_rps) * PERIOD_S
        self.velocity_rps += gained_rps


def test_the_eigenvalues_are_real_and_negative_up_to_the_largest_stiffness_and_the_assigned_pole_is_the_slowest():
    for stiffness in np.linspace(0.0, STIFFEST, 50):
        of_error = [[-(SLOW + FAST), -1.0 / INERTIA], [stiffness + INERTIA * SLOW * FAST, 0.0]]
        slowest, fastest = eigenvalues(SLOW, FAST, INERTIA, stiffness)
        assert fastest <= slowest < 0.0
        assert slowest <= -SLOW * (1.0 - 1e-12)
        assert slowest + fastest == pytest.approx(np.trace(of_error), rel=1e-12)
        assert slowest * fastest == pytest.approx(np.linalg.det(of_error), rel=1e-9)
    assert eigenvalues(SLOW, FAST, INERTIA, 0.0) == pytest.approx((-SLOW, -FAST))
    twice = -0.5 * (SLOW + FAST)
    assert eigenvalues(SLOW, FAST, INERTIA, STIFFEST) == pytest.approx((twice, twice), rel=1e-6)


@pytest.mark.parametrize("stiffness", [0.0, 20.0, STIFFEST])
def test_at_constant_stiffness_an_error_of_the_estimate_decays_with_the_assigned_eigenvalues(stiffness):
    """An axis on a spring under a torque that changes each period: the error obeys its characteristic equation."""
    rates = [[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, -1.0 / INERTIA, 1.0 / INERTIA], [0.0, stiffness, 0.0, 0.0], [0.0] * 4]
    over_period = expm(PERIOD_S * np.array(rates))
    state, estimate = np.array([0.2, 1.3, -0.04, 0.0]), (0.0, 0.0)
    errors = []
    for torque_nm in np.random.default_rng(5).uniform(-0.3, 0.3, 120):
        errors.append(state[1:3] - estimate)
        state[3] = torque_nm
        after = over_period @ state
        estimate = estimate_after(*estimate, after[0] - state[0], torque_nm, stiffness, INERTIA, SLOW, FAST, PERIOD_S)
        state = after
    found = np.array(errors)
    first, second = np.exp(np.array(eigenvalues(SLOW, FAST, INERTIA, stiffness)) * PERIOD_S)
    expected = (first + second) * found[1:-1] - first * second * found[:-2]
    assert found[2:] == pytest.approx(expected, abs=1e-11)
    assert np.all(np.abs(found[-1]) < 1e-3 * np.abs(found[0]))


@pytest.mark.parametrize("stiffness", [0.0, 20.0, STIFFEST])
def test_with_short_periods_the_gains_are_those_of_the_differential_equation(stiffness):
    moved_rev = 1e-3
    gained = estimate_after(0.0, 0.0, moved_rev, 0.0, stiffness, INERTIA, SLOW, FAST, 1e-6)
    assert gained[0] == pytest.approx((SLOW + FAST) * moved_rev, rel=2e-3)
    assert gained[1] == pytest.approx(-INERTIA * SLOW * FAST * moved_rev, rel=2e-3)


def test_after_a_reversal_the_tangent_stiffness_is_that_of_the_hysteresis_branch():
    """dF/dx = |Omega| K exp(-K x) + B (1 - F / S), of the equations of the 2SEP model, over ways that are short."""
    state = REST
    for _ in range(4000):
        state = friction_step(TABLE_1, state, -0.4, 0.0, PERIOD_S)
    found, moved_rev = [], 0.4 * 1e-6
    for _ in range(3000):
        after = friction_step(TABLE_1, state, 0.4, 0.0, 1e-6)
        stiff_per_rev = TABLE_1.stiffness_per_rev
        missing_share = 1.0 - after.torque_nm / steady_friction_nm(TABLE_1, 0.4)
        expected = after.omega_nm * stiff_per_rev * math.exp(-stiff_per_rev * after.travel_rev)
        expected += TABLE_1.attraction_nm_per_rev * missing_share
        found.append(tangent_stiffness(TABLE_1, state, after, moved_rev))
        assert found[-1] == pytest.approx(expected, rel=5e-3)
        state = after
    assert 0.7 * STIFFEST < max(found) < STIFFEST
    assert all(np.diff(found) < 0.0)


def test_the_tangent_stiffness_is_neither_negative_nor_above_the_largest():
    state = REST._replace(torque_nm=0.05)
    falling, steep = state._replace(torque_nm=0.04), state._replace(torque_nm=0.06)
    assert tangent_stiffness(TABLE_1, state, falling, 1e-4) == 0.0
    assert tangent_stiffness(TABLE_1, state, steep, 1e-4) == STIFFEST
    assert tangent_stiffness(TABLE_1, state, steep, -1e-3) == 0.0
    assert tangent_stiffness(TABLE_1, state, steep, 0.0) == 0.0


def test_in_steady_sliding_the_tangent_stiffness_is_zero():
    state = after = REST
    for _ in range(20_000):
        state, after = after, friction_step(TABLE_1, after, 3.0, 0.0, PERIOD_S)
    assert tangent_stiffness(TABLE_1, state, after, 3.0 * PERIOD_S) < 1e-6


@pytest.mark.parametrize("friction_nm", [0.03, 0.09])
def test_at_a_constant_sliding_velocity_the_estimate_is_the_friction_torque(friction_nm):
    """Also where it is not the model's, 0.036 Nm at this velocity."""
    parameters, memory = pack(law()), np.zeros(MEMORY_SLOTS)
    axis = Axis(friction_nm=friction_nm)
    for _ in range(8000):
        axis.follow(luenberger_step(parameters, memory, steady_reference(3.0), axis.velocity_rps, axis.position_rev))
    assert axis.velocity_rps == pytest.approx(3.0, abs=1e-5)
    assert memory[FRICTION_NM] == pytest.approx(friction_nm, rel=1e-5)


def test_without_friction_the_law_is_pi():
    """Neither inertia nor delay is taken for friction, whatever the motion, from any position."""
    parameters, memory, of_pi = pack(law(NO_FRICTION)), np.zeros(MEMORY_SLOTS), np.zeros(MEMORY_SLOTS)
    axis = Axis()
    axis.position_rev = 7.25
    for tick in range(4000):
        reference = steady_reference(3.0 * math.sin(0.02 * tick))
        velocity_rps = axis.velocity_rps
        expected_a = command_for(PEER, of_pi, reference, reference.expected - velocity_rps, 0.0)
        command_a = luenberger_step(parameters, memory, reference, velocity_rps, axis.position_rev)
        assert command_a == pytest.approx(expected_a, abs=1e-9)
        axis.follow(command_a)


def test_after_reversals_the_estimate_follows_friction_that_an_observer_of_a_disturbance_is_late_for():
    """A shaft with the friction of the model swings at 2 Hz: error of the estimate with and without its stiffness."""
    left = []
    for model in (TABLE_1, TABLE_1._replace(stiffness_per_rev=0.0, attraction_nm_per_rev=0.0)):
        config, memory = law(model, ticks=0), np.zeros(MEMORY_SLOTS)
        state, position_rev = REST, 0.0
        errors = []
        for tick in range(4000):
            time_s = (tick + 0.5) * PERIOD_S
            velocity_rps = math.sin(2.0 * math.pi * 2.0 * time_s)
            inertia_nm = INERTIA * 4.0 * math.pi * math.cos(2.0 * math.pi * 2.0 * time_s)
            state = friction_step(TABLE_1, state, velocity_rps, 0.0, PERIOD_S)
            memory[HISTORY] = (inertia_nm + state.torque_nm) / KT
            position_rev += velocity_rps * PERIOD_S
            errors.append(observe(config, memory, position_rev) - state.torque_nm)
        left.append(float(np.std(errors[1000:])))
    assert left[0] < 0.4 * left[1]
    assert left[0] < 0.05 * TABLE_1.static_nm


@pytest.mark.parametrize(("share", "grows"), [(0.95, False), (1.05, True)])
def test_the_gain_margin_of_the_design_is_the_gain_at_which_the_law_becomes_unstable(share, grows):
    """In sliding, with a velocity that is a period later than the position: the motor gives more than is known."""
    form = ObserverForm((0.0, FAST - SLOW), PI.integral_a_per_rev / PI.proportional_a_per_rps, PERIOD_S)
    known = LinearAxis(INERTIA, VISCOUS, (TICKS + 1.5) * PERIOD_S, KT)
    gains = observer_gains(known, form, Wish(phase_margin_deg=45.0, gain_margin=2.8))
    pi = PiConfig(gains.proportional_a_per_rps, gains.proportional_a_per_rps * form.integral_per_s)
    sliding = NO_FRICTION._replace(coulomb_nm=1e-9, static_nm=1e-9)
    slow = gains.bandwidth_rad_per_s
    parameters = pack(law(sliding, pi, slow, slow + FAST - SLOW))
    memory = np.zeros(MEMORY_SLOTS)
    axis = Axis(viscous=VISCOUS)
    axis.velocity_rps, before_rps = 1e-6, 0.0
    swings = []
    for _ in range(6000):
        command_a = luenberger_step(parameters, memory, steady_reference(0.0), before_rps, axis.position_rev)
        before_rps = axis.velocity_rps
        axis.follow(share * gains.margins.gain * command_a)
        swings.append(abs(axis.velocity_rps))
    assert (max(swings[-500:]) > 2.0 * max(swings[1500:2000])) is grows
    assert (max(swings[-500:]) < 0.5 * max(swings[1500:2000])) is not grows

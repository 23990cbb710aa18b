"""The velocity from position and torque: its gains, bias, lag and noise in closed form, and when it is not followed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from interpreted import hex_results

from fffo_drive.control.stability import LinearAxis, feedback_lag_s, loop_delay_s, loop_margins
from fffo_drive.control.velocity_estimator import (
    BRIDGED_TICKS,
    COMMANDS,
    DRIVE_VELOCITY,
    Measured,
    estimator_at_rest,
    estimator_config,
    estimator_response,
    keep_command,
    steady_state_gains,
    velocity_estimator_step,
    velocity_noise_rps,
)

PERIOD_S = 5e-4
PERIOD_NS = 500_000
INERTIA, KT = 2.0 * math.pi * 1.494e-4, 0.148
TORQUE_DELAY_S = 0.00205  # 4.1 periods
CONFIG = estimator_config(200.0, INERTIA, KT, TORQUE_DELAY_S, PERIOD_S, 25.0, 8.0)
COUNTS = 1 << 15


class Axis:
    """An inertia with a constant load under a command that acts later, exact at every instant; its drive lags."""

    def __init__(self, config=CONFIG, velocity_rps=0.0, position_rev=0.0, load_nm=0.0, lag_s=0.0007):
        self.config, self.load_nm, self.lag_s = config, load_nm, lag_s
        self.velocity_rps, self.position_rev = velocity_rps, position_rev
        self.drive_rps = velocity_rps
        self.commands = np.zeros(COMMANDS)
        self.sent = []
        self.state = estimator_at_rest()
        self.tick, self.lived, self.woke_ns = 0, 0, 0

    def step(self, current_a=0.0, fresh=True, position_rev=None, periods=1, lateness_ns=0):
        """One tick: what the filter found, then the command is sent and the axis lives on to the next SYNC."""
        woke_ns = self.tick * PERIOD_NS + lateness_ns
        self._live(1e-9 * (woke_ns - self.woke_ns))
        self.lived, self.woke_ns = self.tick, woke_ns
        shown_rev = self.position_rev if position_rev is None else position_rev
        seen = Measured(self.tick, woke_ns, fresh, shown_rev, self.drive_rps)
        terms, self.state = velocity_estimator_step(self.config, self.state, self.commands, seen)
        keep_command(self.commands, self.tick, current_a)
        # SYNC k applies the command of k - 1: through skipped periods it acts on, and the new one behind them
        self.sent += [self._sent(self.tick - 1)] * (periods - 1) + [current_a]
        self.tick += periods
        return terms

    def _live(self, time_s):
        delay, share = self.config.delay_periods, self.config.delay_share
        for k in range(self.lived, self.tick):
            step_s = time_s / (self.tick - self.lived)
            current_a = (1.0 - share) * self._sent(k - delay) + share * self._sent(k - delay - 1)
            acceleration = (KT * current_a - self.load_nm) / INERTIA
            self.position_rev += step_s * (self.velocity_rps + 0.5 * acceleration * step_s)
            self.velocity_rps += acceleration * step_s
            self.drive_rps += (self.velocity_rps - self.drive_rps) * step_s / (step_s + self.lag_s)

    def _sent(self, tick):
        return self.sent[tick] if tick >= 0 else 0.0


def settled(**start):
    axis = Axis(**start)
    for _ in range(600):
        terms = axis.step(axis.load_nm / KT)
    assert terms.estimated
    return axis


@pytest.mark.parametrize("bandwidth_hz", [2.0, 5.0])
def test_slow_filters_have_the_gains_of_the_continuous_one(bandwidth_hz):
    omega = 2.0 * math.pi * bandwidth_hz
    gains = steady_state_gains(bandwidth_hz, INERTIA, PERIOD_S)
    w = omega * PERIOD_S
    assert gains.position == pytest.approx(2.0 * w, rel=1.5 * w)
    assert gains.velocity_per_s == pytest.approx(2.0 * w * omega, rel=2.5 * w)
    assert gains.disturbance_nm == pytest.approx(INERTIA * omega**3 * PERIOD_S, rel=3.5 * w)


def test_poles_are_those_of_a_butterworth_filter():
    bandwidth_hz = 20.0
    gains = steady_state_gains(bandwidth_hz, INERTIA, PERIOD_S)
    transition = np.array(
        [[1.0, PERIOD_S, -0.5 * PERIOD_S**2 / INERTIA], [0.0, 1.0, -PERIOD_S / INERTIA], [0.0, 0.0, 1.0]]
    )
    kept = np.eye(3) - np.outer([gains.position, gains.velocity_per_s, -gains.disturbance_nm], [1.0, 0.0, 0.0])
    poles = np.sort_complex(np.log(np.linalg.eigvals(kept @ transition)) / PERIOD_S)
    expected = 2.0 * math.pi * bandwidth_hz * np.exp(1j * np.array([math.pi, -2.0 * math.pi / 3, 2.0 * math.pi / 3]))
    np.testing.assert_allclose(poles, np.sort_complex(expected), rtol=2e-3)


def test_no_bias_at_constant_velocity_and_constant_load():
    axis = settled(velocity_rps=5.0, load_nm=0.06)
    # the load was not known at the beginning: until the first command acted it braked the axis
    terms = axis.step(axis.load_nm / KT)
    assert terms.estimated_rps == pytest.approx(axis.velocity_rps, abs=1e-9)
    assert terms.disturbance_nm == pytest.approx(0.06, abs=1e-8)


def test_a_ramp_is_followed_without_the_lag_of_the_drive():
    axis = settled()
    for _ in range(300):
        terms = axis.step(0.5)
    acceleration = KT * 0.5 / INERTIA
    assert (axis.velocity_rps - axis.drive_rps) / acceleration == pytest.approx(0.0007, rel=1e-6)
    assert abs(axis.velocity_rps - terms.estimated_rps) / acceleration < 1e-9
    assert terms.followed_rps == terms.estimated_rps


def test_a_load_that_rises_leaves_an_error_of_twice_the_square_of_the_time_constant():
    # velocity error over d/dt load: (s + 2 w) / (s^3 + 2 w s^2 + 2 w^2 s + w^3) / J, 2 / (J w^2) at s = 0
    bandwidth_hz, slope_nm_per_s = 20.0, 0.5
    axis = settled(config=estimator_config(bandwidth_hz, INERTIA, KT, TORQUE_DELAY_S, PERIOD_S, 25.0, 8.0))
    for _ in range(400):
        axis.load_nm += slope_nm_per_s * PERIOD_S
        terms = axis.step(axis.load_nm / KT)
    omega = 2.0 * math.pi * bandwidth_hz
    expected_rps = slope_nm_per_s / INERTIA * 2.0 / omega**2
    assert terms.estimated_rps - axis.velocity_rps == pytest.approx(expected_rps, rel=0.05)


def test_noise_of_the_position_comes_out_as_theory_has_it():
    bandwidth_hz, noise_rev = 30.0, 1e-5
    config = estimator_config(bandwidth_hz, INERTIA, KT, TORQUE_DELAY_S, PERIOD_S, 25.0, 8.0)
    axis = Axis(config=config)
    noise = np.random.default_rng(3).normal(0.0, noise_rev, 60_000)
    found = np.array([axis.step(position_rev=float(one)).estimated_rps for one in noise])
    expected = velocity_noise_rps(bandwidth_hz, noise_rev, PERIOD_S)
    assert np.std(found[1000:]) == pytest.approx(expected, rel=0.05)
    # and by the response of the sampled filter, whatever its bandwidth
    omega = np.linspace(1e-3, math.pi / PERIOD_S, 200_001)
    exact = math.sqrt(np.mean(np.abs(estimator_response(config, omega).of_position_per_s) ** 2)) * noise_rev
    assert np.std(found[1000:]) == pytest.approx(exact, rel=0.04)


def test_a_sync_that_comes_late_is_no_velocity():
    lateness_ns = np.random.default_rng(5).integers(0, 60_000, 400)
    axis = settled(velocity_rps=10.0)
    for late_ns in lateness_ns:
        terms = axis.step(lateness_ns=int(late_ns))
        assert terms.estimated_rps == pytest.approx(10.0, abs=1e-6)  # 60 us are 20 counts of 15 bits


def test_positions_beyond_any_wrap_of_the_counter_are_as_good_as_near_zero():
    # the port unwraps the drive's 32 bit counter: the position goes on, and the filter with it
    wrap_rev = float(1 << 31) / COUNTS
    near, far = settled(velocity_rps=5.0), settled(velocity_rps=5.0, position_rev=wrap_rev - 0.01)
    for _ in range(20):
        one, other = near.step(), far.step()
    assert far.position_rev > wrap_rev
    assert other.estimated
    assert other.estimated_rps == pytest.approx(one.estimated_rps, abs=1e-6)


def test_skipped_ticks_are_predicted_with_the_command_that_the_drive_held():
    axis = settled()
    for current_a in (1.0, -2.0, 3.0):
        axis.step(current_a)
    axis.step(1.5, periods=3)
    for _ in range(10):
        terms = axis.step(0.0)
        assert terms.estimated
        assert terms.estimated_rps == pytest.approx(axis.velocity_rps, abs=1e-9)


def test_missing_feedback_is_bridged_by_the_prediction_and_then_the_drives_velocity_is_followed():
    axis = settled(velocity_rps=3.0)
    axis.step(1.0)
    for _ in range(BRIDGED_TICKS):
        terms = axis.step(1.0, fresh=False, position_rev=0.0)
        assert terms.estimated
        assert terms.followed_rps == pytest.approx(axis.velocity_rps, abs=1e-9)
    terms = axis.step(1.0, fresh=False, position_rev=0.0)
    assert not terms.estimated
    assert terms.followed_rps == axis.drive_rps
    assert not axis.step(1.0).estimated  # it begins, and has to settle
    for _ in range(CONFIG.settling_ticks):
        terms = axis.step(1.0)
    assert terms.estimated
    assert terms.estimated_rps == pytest.approx(axis.velocity_rps, abs=0.02 * 3.0)


@pytest.mark.parametrize("off_rev", [0.2, -0.2, math.nan, math.inf])
def test_a_jump_of_the_position_is_no_motion(off_rev):
    axis = settled(velocity_rps=3.0)
    terms = axis.step(position_rev=axis.position_rev + off_rev)
    assert not terms.estimated
    assert terms.followed_rps == axis.drive_rps
    assert math.isfinite(terms.estimated_rps)


def test_a_position_that_stands_still_while_the_axis_turns_is_not_followed():
    axis = settled(velocity_rps=12.0)
    stuck_rev = axis.position_rev
    followed = [axis.step(position_rev=stuck_rev) for _ in range(100)]
    lost = next(k for k, terms in enumerate(followed) if not terms.estimated)
    assert lost < 30
    assert all(abs(terms.followed_rps - 12.0) <= CONFIG.disagreement_rps for terms in followed)


def test_nothing_is_estimated_unless_it_is_asked_for():
    axis = Axis(config=DRIVE_VELOCITY._replace(period_s=PERIOD_S), velocity_rps=2.0)
    terms = axis.step()
    assert terms == (0.0, 0.0, 2.0, False)
    assert axis.state == estimator_at_rest()


# ---- margins


def margins_with(axis, estimator):
    return loop_margins(axis._replace(estimator=estimator), 0.975, 9.75, 5.0)


def test_cut_at_the_velocity_the_loop_is_that_with_the_shorter_delay():
    # H p + U i of the exact axis is its velocity: Kt / (J s), late by the delay to the position and half a period
    omega = 2.0 * math.pi * np.geomspace(0.1, 100.0, 50)
    s = 1j * omega
    delay_s = TORQUE_DELAY_S + 0.5 * PERIOD_S
    found = estimator_response(CONFIG, omega)
    axis = KT / (INERTIA * s) * np.exp(-s * delay_s)
    whole = found.of_position_per_s * axis / s + found.of_command_rps_per_a
    np.testing.assert_allclose(np.degrees(np.angle(whole / axis)), 0.0, atol=0.5)
    np.testing.assert_allclose(np.abs(whole / axis), 1.0, rtol=0.02)


def test_margins_with_a_fast_estimate_are_those_of_the_shorter_delay_and_with_a_slow_one_smaller():
    delay_s = TORQUE_DELAY_S + 0.5 * PERIOD_S
    axis = LinearAxis(INERTIA, 0.003, delay_s, KT)
    prompt = loop_margins(axis, 0.975, 9.75, 5.0)
    fast, slow = (
        margins_with(axis, estimator_config(hz, INERTIA, KT, TORQUE_DELAY_S, PERIOD_S, 25.0, 8.0))
        for hz in (390.0, 50.0)
    )
    assert fast.phase_deg == pytest.approx(prompt.phase_deg, abs=1.0)
    assert slow.phase_deg < prompt.phase_deg - 10.0
    assert slow.gain < 0.5 * prompt.gain < fast.gain


def test_the_gain_margin_is_where_the_simulated_loop_begins_to_swing():
    # a P loop on the estimate, the axis' inertia smaller than the filter believes: stable below the margin, not above
    delay_s = TORQUE_DELAY_S + 0.5 * PERIOD_S
    margin = loop_margins(LinearAxis(INERTIA, 0.0, delay_s, KT, estimator=CONFIG), 0.975, 0.0, 0.0).gain
    assert swing(0.93 * margin) < 1e-3
    assert swing(1.07 * margin) > 1e-1


def swing(torque_factor):
    """How a P loop on the estimate ends after a start at 0.1 rps, with a torque that is so many times the believed."""
    axis = Axis(velocity_rps=0.1)
    for _ in range(CONFIG.settling_ticks + 2):
        axis.step()
    speeds = []
    for _ in range(1500):
        terms = axis.step()
        current_a = -0.975 * terms.estimated_rps
        speeds.append(axis.velocity_rps)
        keep_command(axis.commands, axis.tick - 1, current_a)  # what the filter knows
        axis.sent[-1] = torque_factor * current_a  # what the axis gets
        if abs(axis.velocity_rps) > 5.0:
            break
    return max(abs(speed) for speed in speeds[-100:])


class Delays:
    """A model's delays."""

    def __init__(self, delay_s, sensor_delay_s):
        self.delay_s, self.sensor_delay_s = Value(delay_s), Value(sensor_delay_s)


class Value:
    def __init__(self, value):
        self.value = value


def test_the_delay_is_shorter_by_the_lag_of_the_drives_velocity_and_by_nothing_else():
    model = Delays(0.00275, 0.0007)
    assert loop_delay_s(model, PERIOD_S) == pytest.approx(0.003)
    assert loop_delay_s(model, PERIOD_S, estimated=True) == pytest.approx(0.0023)
    assert feedback_lag_s(model, True) == 0.0
    assert feedback_lag_s(model, False) == 0.0007


# ---- compiled and interpreted


def days() -> list[str]:
    """A motion with gaps, skipped ticks, jumps, jitter and numbers that are none: every branch, as bits."""
    rng = np.random.default_rng(11)
    axis = Axis(velocity_rps=1.0, load_nm=0.02)
    found = []
    for k in range(1500):
        position_rev = None
        if k % 400 == 300:
            position_rev = (math.nan, axis.position_rev + 0.3, math.inf)[k // 400 % 3]
        terms = axis.step(
            float(rng.normal(0.1, 0.5)),
            fresh=not (700 <= k < 707 or k % 97 == 0),
            position_rev=position_rev,
            periods=1 if k % 53 else 3,
            lateness_ns=int(rng.integers(0, 40_000)),
        )
        found += [float(one).hex() for one in (*terms, *axis.state)]
    return found


def test_compiled_and_interpreted_agree_bit_for_bit():
    assert days() == hex_results("control.test_velocity_estimator", "days")

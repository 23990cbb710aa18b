"""The generator of live set points against closed forms, its bounds, and a library that solves the same problem."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fffo_drive.control.feedforward import NO_FEEDFORWARD, FeedforwardConfig, read_reference
from fffo_drive.control.set_point import (
    ARRIVED_SHARE,
    HISTORY,
    SET_POINT_SIZE,
    GeneratorState,
    SetPoint,
    advance_motion,
    begin_motion,
    has_ended,
    preview_ticks,
    ramp_s,
    set_point_step,
    shortest_ramp,
    stopping_rev,
    unpack_set_point,
    with_set_point,
)

REST = GeneratorState(0.0, 0.0)
A, J, PERIOD_S = 20.0, 400.0, 5e-4
ROUNDING = 1e-9

speeds = st.floats(-50.0, 50.0)
bounds = st.tuples(st.floats(0.1, 1000.0), st.floats(1.0, 1e5))
states = st.builds(GeneratorState, speeds, st.floats(-1000.0, 1000.0))


def duration_s(state, target, acceleration=A, jerk=J):
    return ramp_s(shortest_ramp(state, target, acceleration, jerk))


def walk(state, targets, acceleration=A, jerk=J, period_s=PERIOD_S):
    """States after each period; a target for each."""
    found = []
    for target in targets:
        state = set_point_step(state, target, acceleration, jerk, period_s)
        found.append(state)
    return np.array(found)


@pytest.mark.parametrize("target", [0.5, 1.0, -1.0, 3.0, -12.0])
def test_from_rest_to_a_speed_takes_what_the_closed_form_says(target):
    """dv <= A^2/J: two jerks of sqrt(dv/J); beyond it dv/A + A/J."""
    dv = abs(target)
    expected_s = 2 * math.sqrt(dv / J) if dv <= A * A / J else dv / A + A / J
    assert duration_s(REST, target) == pytest.approx(expected_s, rel=1e-12)
    ticks = math.ceil(expected_s / PERIOD_S - 1e-9)
    path = walk(REST, [target] * (ticks + 1))
    assert (path[ticks - 1 :] == [target, 0.0]).all()  # there, exactly, and it stays
    assert (path[: ticks - 1, 0] != target).all()
    assert np.abs(path[:, 1]).max() == pytest.approx(min(A, math.sqrt(dv * J)), rel=0.02)


def test_the_path_from_rest_is_the_parabola_the_line_and_the_parabola():
    path = walk(REST, [3.0] * 400)
    time_s = PERIOD_S * np.arange(1, 401)
    t1, total = A / J, 3.0 / A + A / J
    end = 3.0 - 0.5 * J * np.maximum(0, total - time_s) ** 2
    middle = np.where(time_s < total - t1, 0.5 * A * t1 + A * (time_s - t1), end)
    expected = np.where(time_s < t1, 0.5 * J * time_s**2, middle)
    np.testing.assert_allclose(path[:, 0], expected, atol=1e-12)


def test_a_reversal_goes_through_zero_without_a_stop_there():
    """From v to -v it is one ramp of 2 v: nothing is lost at standstill."""
    assert duration_s(GeneratorState(4.0, 0.0), -4.0) == pytest.approx(8.0 / A + A / J, rel=1e-12)
    path = walk(GeneratorState(4.0, 0.0), [-4.0] * 900)
    at_zero = int(np.argmin(np.abs(path[:, 0])))
    assert path[at_zero, 1] == pytest.approx(-A, rel=1e-12)


def test_a_target_that_is_taken_back_in_the_middle_of_a_ramp():
    """At full acceleration the way on until it has gone is A^2/2J, and that way is gone back."""
    path = walk(REST, [10.0] * 400)
    v, a = path[-1]
    assert a == pytest.approx(A)
    top = v + A * A / (2 * J)
    down = walk(GeneratorState(v, a), [0.0] * 3000)
    assert down[:, 0].max() == pytest.approx(top, abs=A * PERIOD_S**2 * J)
    # A / J to no acceleration at the top, from there the way from rest
    assert duration_s(GeneratorState(v, a), 0.0) == pytest.approx(A / J + top / A + A / J, rel=1e-9)
    assert (down[-1] == 0.0).all()


@settings(max_examples=300, deadline=None)
@given(states, speeds, bounds, st.floats(1e-5, 0.5))
def test_steps_of_any_length_are_one_way(state, target, limits, share):
    """Two steps are one: planned again on the way, the plan stays what it was."""
    whole_s = duration_s(state, target, *limits)
    one = set_point_step(state, target, *limits, 0.7 * whole_s)
    middle = set_point_step(state, target, *limits, 0.7 * share * whole_s)
    two = set_point_step(middle, target, *limits, 0.7 * (1.0 - share) * whole_s)
    scale = 1.0 + abs(state.velocity_rps) + abs(target) + state.acceleration_rps2**2 / limits[1]
    assert two.velocity_rps == pytest.approx(one.velocity_rps, abs=1e-6 * scale)
    left_s = duration_s(middle, target, *limits)
    assert 0.7 * share * whole_s + left_s == pytest.approx(whole_s, rel=1e-5, abs=1e-6)
    assert set_point_step(state, target, *limits, whole_s * (1 + 1e-12) + 1e-12) == (target, 0.0)


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(speeds, st.integers(1, 120)), min_size=1, max_size=12), bounds,
    st.sampled_from([2.5e-4, 5e-4, 1e-3]),
)  # fmt: skip
def test_whatever_is_asked_for_and_whenever_no_bound_is_exceeded(asked, limits, period_s):
    acceleration, jerk = limits
    targets = [target for target, ticks in asked for _ in range(ticks)]
    path = walk(REST, targets, acceleration, jerk, period_s)
    v, a = np.insert(path, 0, 0.0, axis=0).T
    rounding = ROUNDING * (1.0 + np.abs(targets).max())
    assert np.abs(a).max() <= acceleration * (1 + ROUNDING)
    assert np.abs(np.diff(a)).max() <= jerk * period_s * (1 + 2 * ARRIVED_SHARE) + ROUNDING * acceleration
    # never beyond the largest that was asked for, in either direction
    assert v.max() <= max(0.0, *targets) + rounding
    assert v.min() >= min(0.0, *targets) - rounding
    # a velocity that is the integral of its acceleration
    between = 0.5 * (a[1:] + a[:-1]) * period_s
    assert np.abs(np.diff(v) - between).max() <= 0.5 * jerk * period_s**2 + rounding
    # and in the end it arrives
    last = GeneratorState(*path[-1])
    rest_s = duration_s(last, targets[-1], acceleration, jerk)
    end = walk(last, [targets[-1]] * 3, acceleration, jerk, rest_s / 2 + 1e-9)
    assert (end[-1] == [targets[-1], 0.0]).all()


@settings(max_examples=300, deadline=None)
@given(states, speeds, bounds)
def test_a_way_to_a_target_overshoots_it_only_where_its_acceleration_forces_it_to(state, target, limits):
    acceleration, jerk = limits
    forced = state.velocity_rps + state.acceleration_rps2 * abs(state.acceleration_rps2) / (2 * jerk)
    whole_s = duration_s(state, target, *limits)
    path = walk(state, [target] * 200, *limits, max(whole_s, 1e-6) / 199)
    scale = 1e-7 * (1.0 + abs(forced) + abs(state.velocity_rps) + abs(target))
    assert path[:, 0].max() <= max(state.velocity_rps, forced, target) + scale
    assert path[:, 0].min() >= min(state.velocity_rps, forced, target) - scale
    assert np.abs(path[:, 1]).max() <= max(acceleration, abs(state.acceleration_rps2)) * (1 + ROUNDING)


@settings(max_examples=300, deadline=None)
@given(states, speeds, bounds)
def test_it_is_as_fast_as_ruckig(state, target, limits):
    """Ruckig's velocity interface solves the same problem: the same duration, and the same way."""
    ruckig = pytest.importorskip("ruckig")
    acceleration, jerk = limits
    given = ruckig.InputParameter(1)
    given.control_interface = ruckig.ControlInterface.Velocity
    given.current_velocity, given.current_acceleration = [state.velocity_rps], [state.acceleration_rps2]
    given.target_velocity, given.target_acceleration = [target], [0.0]
    given.max_acceleration, given.max_jerk = [acceleration], [jerk]
    theirs = ruckig.Trajectory(1)
    assert ruckig.Ruckig(1).calculate(given, theirs) in (ruckig.Result.Working, ruckig.Result.Finished)
    whole_s = duration_s(state, target, *limits)
    assert whole_s == pytest.approx(theirs.duration, rel=1e-6, abs=1e-6)
    scale = 1.0 + abs(state.velocity_rps) + abs(target) + state.acceleration_rps2**2 / jerk
    for share in (0.1, 0.37, 0.5, 0.82, 0.99):
        ours = set_point_step(state, target, *limits, share * theirs.duration)
        _, velocity, _ = theirs.at_time(share * theirs.duration)
        assert ours.velocity_rps == pytest.approx(velocity[0], abs=1e-6 * scale)


# ---- as a reference


class Motion:
    """A motion by set points, tick by tick."""

    def __init__(self, config, first=100):
        self.config, self.tick = config, first
        self.trajectory = np.full((2, HISTORY), np.nan)
        self.motion = None
        self.number = 0
        self.set_point = None
        self.window, self.lag_s = (-math.inf, math.inf), 0.0
        self.position_rev = self.velocity_rps = 0.0

    def ask(self, target, hold_ticks=0, after=0.0, acceleration=A):
        self.number += 1
        self.set_point = SetPoint(target, acceleration, J, hold_ticks, after, acceleration, *self.window, self.lag_s)
        if self.motion is None:
            self.motion = begin_motion(self.trajectory, self.number, self.tick)
        else:
            self.motion = with_set_point(self.motion, self.number, self.tick)

    def go(self, ticks, skip=0):
        found = []
        for _ in range(ticks):
            self.motion, target, reference = advance_motion(
                self.config,
                self.set_point,
                self.motion,
                self.trajectory,
                self.tick,
                self.position_rev,
                self.velocity_rps,
                PERIOD_S,
            )
            self.tick += 1 + skip
            found.append((target, *reference))
        return np.array(found)


PREVIEWS = [
    NO_FEEDFORWARD,
    FeedforwardConfig(0.0, 5.0, 1.0),
    FeedforwardConfig(0.0, 5.5, 1.25),
    FeedforwardConfig(0.0, 0.0, 6.5),
]


@pytest.mark.parametrize("config", PREVIEWS)
def test_live_it_is_the_reference_of_the_same_trajectory_as_a_profile(config):
    """Known ahead by the preview: bit for bit what a profile gives that was sampled before anything moved."""
    motion = Motion(config)
    motion.ask(3.0)
    rows = [motion.go(150)]
    motion.ask(-1.0)
    rows.append(motion.go(250))
    motion.ask(0.0)
    rows.append(motion.go(400))
    rows = np.concatenate(rows)
    ahead = preview_ticks(config)
    known = [(0.0, 0.0)] * ahead + walk(REST, [3.0] * 150 + [-1.0] * 250 + [0.0] * 400).tolist()
    values, derivatives = np.array(known).T.copy()
    for k in range(rows.shape[0] - ahead - 1):
        assert tuple(rows[k, 1:]) == read_reference(config, values, derivatives, values.size, k), k
    # what it costs: so many periods until the first set point shows
    first = int(np.flatnonzero(rows[:, 1])[0])
    assert first == ahead
    assert has_ended(config, motion.motion, 10)


def test_a_skipped_tick_is_a_sample_all_the_same():
    config = PREVIEWS[2]
    every, third = Motion(config), Motion(config)
    every.ask(3.0)
    third.ask(3.0)
    np.testing.assert_array_equal(every.go(301)[::3], third.go(101, skip=2))


def test_after_a_gap_longer_than_the_history_it_is_where_it_would_be():
    config = PREVIEWS[2]
    every, gap = Motion(config), Motion(config)
    for motion in (every, gap):
        motion.ask(30.0)
        motion.go(10)
    gap.tick += 4 * HISTORY
    np.testing.assert_allclose(gap.go(5), every.go(4 * HISTORY + 5)[-5:], rtol=1e-12)
    assert gap.go(1)[0, 1] == 30.0


def test_one_that_nobody_renews_holds_for_its_time_and_goes_to_standstill():
    motion = Motion(NO_FEEDFORWARD)
    motion.ask(2.0, hold_ticks=400)
    rows = motion.go(300)
    motion.ask(2.0, hold_ticks=400)  # renewed in time
    rows = np.concatenate((rows, motion.go(399)))
    assert (rows[:, 0] == 2.0).all()
    assert rows[-1, 1] == 2.0
    rows = motion.go(800)
    assert (rows[1:, 0] == 0.0).all()
    assert np.abs(np.diff(rows[:, 2])).max() <= J * PERIOD_S * (1 + 1e-9)
    stood = int(np.argmax(rows[:, 1] == 0.0))
    assert stood == round((2.0 / A + A / J) / PERIOD_S)
    assert has_ended(NO_FEEDFORWARD, motion.motion, 100)


def test_a_step_for_a_time_goes_back_to_what_was_before():
    motion = Motion(NO_FEEDFORWARD)
    motion.ask(2.0)
    motion.go(400)
    motion.ask(2.5, hold_ticks=200, after=2.0)
    rows = motion.go(600)
    assert rows[:, 1].max() == 2.5
    assert tuple(rows[-1, :2]) == (2.0, 2.0)
    assert not has_ended(NO_FEEDFORWARD, motion.motion, 0)


def test_it_is_not_done_before_the_last_reader_sees_standstill():
    config = FeedforwardConfig(0.0, 5.5, 1.25)
    motion = Motion(config)
    motion.ask(1.0)
    motion.go(300)
    motion.ask(0.0)
    for _ in range(1000):
        rows = motion.go(1)
        if has_ended(config, motion.motion, 0):
            break
    assert not rows[0, 1:].any()
    motion.ask(2.0)  # in the very tick in which it would end: it goes on
    assert not has_ended(config, motion.motion, 0)
    assert motion.go(400)[-1, 1] == 2.0


@settings(max_examples=200, deadline=None)
@given(states, bounds)
def test_the_way_to_standstill_is_the_integral_of_the_velocity(state, limits):
    whole_s = duration_s(state, 0.0, *limits)
    v = np.insert(walk(state, [0.0] * 2000, *limits, whole_s / 2000 + 1e-12)[:, 0], 0, state.velocity_rps)
    integral_rev = (v[0] / 2 + v[1:-1].sum() + v[-1] / 2) * whole_s / 2000
    scale = whole_s * (1.0 + np.abs(v).max())
    assert stopping_rev(state, *limits) == pytest.approx(integral_rev, abs=1e-3 * scale)


def test_from_a_steady_speed_it_stops_after_v_over_2_times_the_time():
    """The deceleration is symmetric: half the speed on average, over v/A + A/J."""
    assert stopping_rev(GeneratorState(4.0, 0.0), A, J) == pytest.approx(2.0 * (4.0 / A + A / J), rel=1e-12)
    assert stopping_rev(GeneratorState(-4.0, 0.0), A, J) == pytest.approx(-2.0 * (4.0 / A + A / J), rel=1e-12)
    assert stopping_rev(REST, A, J) == 0.0


LAG_TICKS = 6


class Window(Motion):
    """A motion of an axis that follows the newest sample of the trajectory some periods later, exactly."""

    def __init__(self, low_rev=-1.0, high_rev=1.0, config=PREVIEWS[2]):
        super().__init__(config)
        self.window, self.lag_s = (low_rev, high_rev), LAG_TICKS * PERIOD_S
        self.positions = [0.0] * (LAG_TICKS + 2)
        self.excess = 1.0

    def go(self, ticks, skip=0):
        found = []
        for _ in range(ticks):
            self.position_rev = self.positions[-1 - LAG_TICKS]
            self.velocity_rps = self.excess * (self.position_rev - self.positions[-2 - LAG_TICKS]) / PERIOD_S
            before = self.motion.generator
            found.append(super().go(1)[0])
            step_rev = 0.5 * (before.velocity_rps + self.motion.generator.velocity_rps) * PERIOD_S
            self.positions.append(self.positions[-1] + step_rev)
        return np.array(found)


@pytest.mark.parametrize("side", [1, -1])
def test_a_way_out_of_the_window_ends_at_standstill_before_its_edge(side):
    motion = Window()
    motion.ask(side * 3.0)
    rows = motion.go(3000)
    positions = side * np.array(motion.positions)
    assert motion.motion.blocked == side
    assert positions.max() <= 1.0 + 1e-5
    assert positions[-1] > 1.0 - 3.0 * PERIOD_S  # not earlier than it must
    assert positions[-1] == positions.max()
    assert tuple(rows[-1]) == (0.0,) * 6
    assert np.abs(np.diff(rows[:, 2])).max() <= J * PERIOD_S * (1 + 1e-4)
    assert np.abs(rows[:, 2]).max() <= A * (1 + 1e-9)
    assert has_ended(motion.config, motion.motion, 100)
    # more of the same changes nothing, also renewed; the other way is free
    for _ in range(20):
        motion.ask(side * 3.0, 100)
        assert not motion.go(30)[:, 1:].any()
    motion.ask(side * -3.0)
    motion.go(400)
    assert motion.motion.blocked == 0
    assert side * motion.positions[-1] < 0.9


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(-8.0, 8.0), st.integers(1, 400)), min_size=1, max_size=12))
def test_whatever_is_asked_for_the_window_holds(asked):
    motion = Window(-0.4, 0.7)
    changes = []
    for target, ticks in asked:
        motion.ask(target)
        changes.append(motion.go(ticks)[:, 2])
    motion.go(2000)
    assert min(motion.positions) >= -0.4 - 1e-4
    assert max(motion.positions) <= 0.7 + 1e-4
    assert np.abs(np.diff(np.concatenate(changes))).max(initial=0.0) <= J * PERIOD_S * (1 + 1e-4)


def test_an_axis_that_runs_ahead_of_its_reference_is_braked_earlier():
    """By the way that the excess takes: (w^2 - v^2) / 2A, and the jerk's share."""
    stands = []
    for excess in (1.0, 1.2):
        motion = Window(-10.0, 10.0)
        motion.excess = excess
        motion.ask(4.0)
        motion.go(8000)
        stands.append(motion.positions[-1])
    assert stands[0] - stands[1] == pytest.approx(
        (4.8**2 - 4.0**2) / (2 * A) + 0.8 * A / (2 * J) + 0.8 * LAG_TICKS * PERIOD_S, abs=0.01
    )


def test_an_axis_outside_its_window_may_go_back_in():
    motion = Window(0.5, 1.0)
    motion.ask(-2.0)
    assert not motion.go(100)[:, 1:].any()
    motion.ask(2.0)
    motion.go(1500)
    assert 0.9 < motion.positions[-1] < 1.0 + 1e-5


def test_the_block_holds_the_record():
    set_point = SetPoint(1.5, 2.5, 3.5, 7, -4.5, 5.5, -6.5, 7.5, 8.5)
    block = np.array(set_point)
    assert block.shape == (SET_POINT_SIZE,)
    assert unpack_set_point(block) == set_point

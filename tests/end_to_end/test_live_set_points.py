"""Live set points through loop, law and simulated drive: the same commands as of a profile, gates, stops and gaps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from evaluation.asked import AXIS, PERIOD_S, models
from evaluation.gated import GatedDrive, GatedRun

from fffo_drive.config.session import session_config
from fffo_drive.control.friction_observer import TOGGLE_FEEDFORWARD
from fffo_drive.control.reference import MODE_VELOCITY, Profile
from fffo_drive.control.set_point import GeneratorState, SetPoint, set_point_step
from fffo_drive.drive.cia402 import GOAL_DISABLED, GOAL_ENABLED
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.runtime import blocks as b

A, J = 60.0, 2e3
LAG_S = 3e-3
LATER = {"tick", "row_number", "request_number", "set_point_rps", "set_point_number", "set_point_sample",
         "profile_number", "profile_sample", "busy_ns"}  # fmt: skip
FEEDFORWARD = {"inertia": True, "preview": True, "delay_aware": True}


def to(target_rps, hold_ticks=0, after_rps=0.0, window=(-math.inf, math.inf)):
    return SetPoint(target_rps, A, J, hold_ticks, after_rps, A, *window, LAG_S)


class Live:
    """A loop that stands between ticks, enabled, the law acting."""

    def __init__(self, **feedforward):
        section = AXIS.controller.feedforward.model_copy(update=feedforward or FEEDFORWARD)
        axis = AXIS.model_copy(update={"controller": AXIS.controller.model_copy(update={"feedforward": section})})
        self.config = session_config(axis, models()[1], 4000, 1 << 13)
        self.run = GatedRun(self.config, GatedDrive())
        self.session = self.run.session
        self.ahead = self.config.controller.feedforward.preview_ticks
        self.window = (-math.inf, math.inf)
        self.run.begin(20_000)
        self.session.request(b.TOGGLE, TOGGLE_FEEDFORWARD)
        self.enable()

    def enable(self):
        self.session.request(b.GOAL, GOAL_ENABLED)
        self.run.ticks(40)

    def ask(self, *set_point):
        return self.session.set_point(to(*set_point, window=self.window))

    def rows(self):
        """All of the run."""
        self.session.request(b.STOP, 1)
        self.run.end()
        return RingReader(self.session.ring).read().rows


@pytest.fixture
def live():
    return Live()


STORY = ((3.0, 220), (-1.5, 70), (6.0, 40), (6.2, 300), (0.0, 400))


def sampled(ahead):
    """What the generator makes of the story, and before it what was known already: standstill."""
    state, states = GeneratorState(0.0, 0.0), []
    for target_rps, ticks in STORY:
        for _ in range(ticks):
            state = set_point_step(state, target_rps, A, J, PERIOD_S)
            states.append(state)
    values, derivatives = np.array([(0.0, 0.0)] * ahead + states).T.copy()
    return Profile("sampled", MODE_VELOCITY, PERIOD_S, values, derivatives)


@pytest.mark.parametrize("preview", [True, False])
def test_live_steps_give_the_commands_of_the_same_trajectory_as_a_profile(preview):
    feedforward = {**FEEDFORWARD, "preview": preview}
    asked, known = Live(**feedforward), Live(**feedforward)
    assert (asked.ahead > 0) == preview
    for target_rps, ticks in STORY:
        asked.ask(target_rps)
        asked.run.ticks(ticks)
    known.session.start_profile(sampled(asked.ahead))
    known.run.ticks(sum(ticks for _, ticks in STORY))
    one, other = asked.rows(), known.rows()
    assert np.abs(one["requested_a"]).max() > 0.5
    assert (one["set_point_sample"] >= 0).sum() > 1000
    for name in set(one.dtype.names) - LATER:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_what_the_preview_costs_is_what_is_reported(live):
    live.ask(2.0)
    live.run.ticks(60)
    rows = live.rows()
    rows = rows[rows["set_point_sample"] >= 0]
    assert int(np.flatnonzero(rows["reference_rps"])[0]) == live.ahead
    assert rows["reference_ahead_rps"][0] != 0.0  # torque begins at once
    assert (rows["set_point_rps"] == 2.0).all()


def test_a_set_point_waits_for_torque_and_ends_with_it(live):
    live.session.request(b.GOAL, GOAL_DISABLED)
    live.run.ticks(60)
    number = live.ask(4.0)
    live.run.ticks(50)
    assert live.session.status(b.SET_POINT_DONE) == 0
    live.enable()
    live.run.ticks(200)
    live.session.request(b.GOAL, GOAL_DISABLED)
    live.run.ticks(50)
    assert live.session.status(b.SET_POINT_DONE) == number
    live.enable()
    live.run.ticks(100)
    rows = live.rows()
    runs = np.flatnonzero(rows["set_point_sample"] >= 0)
    assert (np.diff(runs) == 1).all()  # one motion, and it does not come back by itself
    assert (rows["mode"][runs] == MODE_VELOCITY).all()
    assert not rows["reference_rps"][runs[-1] + 1 :].any()


def test_one_that_was_aborted_before_it_could_begin_never_does(live):
    live.session.request(b.GOAL, GOAL_DISABLED)
    live.run.ticks(60)
    live.session.request(b.SET_POINT_ABORT, live.ask(4.0))
    live.enable()
    live.run.ticks(100)
    assert not live.rows()["reference_rps"].any()


def test_profile_and_set_points_wait_for_each_other(live):
    profile = sampled(0)._replace(values=np.full(100, 0.5), derivatives=np.zeros(100))
    live.session.start_profile(profile)
    live.run.ticks(10)
    live.ask(1.0, 150)
    live.run.ticks(20)
    live.session.start_profile(profile)  # instead of the one that runs: first come, first served
    live.run.ticks(2500)
    rows = live.rows()
    both = (rows["set_point_sample"] >= 0) & (rows["profile_sample"] >= 0)
    assert not both.any()
    assert rows["set_point_sample"].max() > 500
    assert rows["reference_rps"].max() == 1.0
    assert live.session.status(b.PROFILE_DONE) == 2
    assert live.session.status(b.SET_POINT_DONE) == live.session.status(b.SET_POINT_LAPSED) == 1


def test_a_jog_that_is_not_renewed_stands_still_after_its_time(live):
    live.ask(2.0, 100)
    live.run.ticks(99)
    live.ask(2.0, 100)  # renewed in the last tick of its time
    live.run.ticks(100)
    assert live.session.status(b.SET_POINT_LAPSED) == 0
    live.run.ticks(1200)
    assert live.session.status(b.SET_POINT_LAPSED) == live.session.status(b.SET_POINT_DONE) == 2
    rows = live.rows()
    lives = rows[rows["set_point_sample"] >= 0]
    assert (lives["set_point_rps"][:199] == 2.0).all()
    assert (lives["set_point_rps"][199:] == 0.0).all()
    assert np.abs(np.diff(lives["reference_rps2"])).max() <= J * PERIOD_S * (1 + 1e-4)
    assert np.abs(lives["reference_rps2"]).max() <= A * (1 + 1e-9)
    # at standstill for the tail, then no motion
    stands = int(np.flatnonzero(lives["reference_rps"])[-1])
    tail = lives.size - 1 - stands
    feedforward = live.config.controller.feedforward
    assert tail == live.config.loop.tail_ticks + int(np.ceil(feedforward.behind_ticks)) + 1


@pytest.mark.parametrize("offset", [-1, 0, 1])
def test_a_set_point_in_the_tick_in_which_the_motion_ends_is_followed(offset):
    live = Live()
    live.ask(0.0)
    feedforward = live.config.controller.feedforward
    stands = live.config.loop.tail_ticks + live.ahead + int(np.ceil(feedforward.behind_ticks)) + 1
    live.run.ticks(stands + offset)
    number = live.ask(1.0)
    live.run.ticks(200)
    assert live.session.status(b.SET_POINT_DONE) == (1 if offset > 0 else 0)
    rows = live.rows()
    assert rows["set_point_number"][-1] == number
    assert rows["reference_rps"].max() == 1.0


def test_a_trip_ends_the_motion_and_a_reset_does_not_bring_it_back(live):
    number = live.ask(4.0)
    live.run.ticks(150)
    live.run.drive.raise_fault(0x3210)
    live.run.ticks(30)
    assert live.session.status(b.TRIP) != 0
    assert live.session.status(b.SET_POINT_DONE) == number
    live.run.drive.clear_fault()
    live.session.request(b.RESET_NUMBER, 1)
    live.run.ticks(150)
    live.enable()
    rows = live.rows()
    after = rows[int(np.flatnonzero(rows["trip"])[0]) :]
    assert not after["reference_rps"].any()


def test_the_axis_stays_in_its_window_whoever_jogs(live):
    live.window = (-0.3, 0.4)
    live.ask(5.0)
    live.run.ticks(1200)
    assert live.session.status(b.SET_POINT_BLOCKED) == live.session.status(b.SET_POINT_DONE) == 1
    live.ask(-5.0)
    live.run.ticks(1200)
    live.ask(-5.0)  # at the edge already
    live.run.ticks(800)
    rows = live.rows()
    assert rows["position_rev"].max() == pytest.approx(0.4, abs=0.01)
    assert rows["position_rev"].min() == pytest.approx(-0.3, abs=0.01)
    assert np.abs(rows["reference_rps"]).max() > 2.0
    assert (rows["trip"] == 0).all()
    assert not rows["set_point_rps"][-700:].any()  # braked again, and not renewed for ever

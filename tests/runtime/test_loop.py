"""The loop on a fake clock and a scripted drive: timing rules, requests, trips and what it sends."""

from __future__ import annotations

import numpy as np
import pytest
from runtime.scripted_port import (
    ANSWERS,
    BOOTS,
    BUS_OFF,
    CONTROLWORD,
    CURRENT_A,
    EMERGENCIES,
    FAULT,
    FOREIGN_FRAMES,
    NMT_EXITS,
    NMT_STATE,
    STATUSWORD,
    SWITCH_ON_DISABLED,
    SYNC_NS,
    WAKE_DELAY_NS,
    ScriptedPort,
    scripted,
)

from fffo_drive.control import envelope as env
from fffo_drive.control.controller import CONTROLLER_BLOCK_SIZE, ControllerConfig
from fffo_drive.control.feedforward import NO_FEEDFORWARD, FeedforwardConfig
from fffo_drive.control.friction_observer import TOGGLE_FEEDFORWARD, TOGGLE_OFF, ObserverConfig
from fffo_drive.control.pi import PiConfig
from fffo_drive.control.reference import MODE_CURRENT, MODE_IDLE, MODE_VELOCITY, Profile
from fffo_drive.drive.cia402 import GOAL_DISABLED, GOAL_ENABLED
from fffo_drive.jit import INTERPRETED
from fffo_drive.model.friction import FrictionConfig
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime.loop import run_loop
from fffo_drive.runtime.ring import new_ring
from fffo_drive.runtime.tick import LoopConfig

PERIOD_NS = 500_000
TABLE1 = FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, 0)
CONTROLLER = ControllerConfig(
    PiConfig(0.975, 9.75), ObserverConfig(TABLE1, 5.0, 0.134, 0.1), NO_FEEDFORWARD, 0.148, 20.0, 5e-4
)
LOOP = LoopConfig(PERIOD_NS, 300_000, 100_000, 400_000, 100, 4, 0)


def envelope(**changes):
    base = env.EnvelopeConfig(
        10.0, 1e6, 30.0, 5.0, 1.0, True, -1e9, 1e9, 100.0, 1.0, 5, 50, 0, 5e-4, env.default_reactions()
    )
    return base._replace(**changes)


class Rig:
    """A loop on a scripted port, run for all of its script."""

    def __init__(self, port: ScriptedPort, goal: int = GOAL_ENABLED, toggle: int = TOGGLE_OFF) -> None:
        self.port = port
        self.blocks = b.new_blocks(CONTROLLER, 1000)
        self.blocks.control[b.GOAL] = goal
        self.blocks.control[b.TOGGLE] = toggle
        self.ring = new_ring(4096)
        self.reader = RingReader(self.ring)

    def run(self, ticks: int = 0, loop=None, **changes) -> np.ndarray:
        config = LOOP._replace(max_ticks=ticks or self.port.script.shape[0], **(loop or {}))
        scratch = np.zeros((2, CONTROLLER_BLOCK_SIZE))
        if not INTERPRETED:
            run_loop.disable_compile(False)  # a session of another test has forbidden it
        run_loop(self.port, config, envelope(**changes), self.blocks, scratch, self.ring, PERIOD_NS)
        return self.reader.read().rows

    def status(self, word: int) -> int:
        return int(self.blocks.status[word])


def constant_profile(mode: int, level: float, n: int) -> Profile:
    return Profile("constant", mode, 5e-4, np.full(n, level), np.zeros(n))


def test_deadlines_are_absolute_and_every_tick_leaves_one_row():
    rig = Rig(scripted(50))
    rig.port.script[:, WAKE_DELAY_NS] = np.random.default_rng(1).integers(0, 90_000, 50)
    rows = rig.run()
    np.testing.assert_array_equal(rows["tick"], np.arange(50))
    np.testing.assert_array_equal(np.diff(rows["deadline_ns"]), PERIOD_NS)
    np.testing.assert_array_equal(rows["lateness_ns"], rig.port.script[:, WAKE_DELAY_NS])
    np.testing.assert_array_equal(rows["turnaround_ns"], 50_000)
    assert rig.status(b.LATE_TICKS) == rig.status(b.SKIPPED_TICKS) == 0


def test_a_late_tick_is_counted_and_missed_deadlines_are_skipped():
    rig = Rig(scripted(60))
    rig.port.script[10, WAKE_DELAY_NS] = 150_000  # late, nothing missed
    rig.port.script[20, WAKE_DELAY_NS] = 3 * PERIOD_NS + 20_000  # three deadlines missed
    rows = rig.run(40)
    assert rig.status(b.SKIPPED_TICKS) == 3
    assert rig.status(b.LATE_TICKS) == 1
    assert rows["late"].sum() == 1
    assert rows["lateness_ns"][11] == 50_000  # kept its distance from the late SYNC instead of being lost
    assert 20 not in rows["tick"]
    assert 23 in rows["tick"]
    np.testing.assert_array_equal(rows["deadline_ns"], PERIOD_NS * (rows["tick"].astype(np.int64) + 1))


def test_no_two_syncs_are_closer_than_the_minimum_gap():
    rng = np.random.default_rng(7)
    rig = Rig(scripted(400))
    rig.port.script[:, WAKE_DELAY_NS] = rng.choice([0, 80_000, 300_000, 480_000, 700_000], 400)
    rig.run(200)
    syncs = rig.port.log[:, SYNC_NS]
    assert np.diff(syncs[np.isfinite(syncs)]).min() >= LOOP.minimum_gap_ns


def test_no_torque_unless_the_drive_is_in_operation_enabled():
    rig = Rig(scripted(80, velocity_rps=-1.0))
    rig.port.script[:30, STATUSWORD] = SWITCH_ON_DISABLED
    rows = rig.run()
    assert (rows["current_command_a"][:30] == 0.0).all()
    assert (rows["mode"][:30] == MODE_IDLE).all()
    assert (rows["current_command_a"][30:] > 0.5).all()


def test_no_torque_is_asked_for_when_the_goal_is_disabled():
    rig = Rig(scripted(30, velocity_rps=-1.0), goal=GOAL_DISABLED)
    rows = rig.run()
    assert (rows["current_command_a"] == 0.0).all()
    assert (rows["controlword"] == 0).all()


def test_a_profile_starts_when_enabled_and_reports_that_it_is_done():
    rig = Rig(scripted(100))
    rig.port.script[:10, STATUSWORD] = SWITCH_ON_DISABLED
    profile = Profile("ramp", MODE_VELOCITY, 5e-4, np.linspace(0.0, 1.0, 40), np.full(40, 50.0))
    number = b.publish_profile(rig.blocks, profile)
    rows = rig.run()
    np.testing.assert_allclose(rows["reference_rps"][10:50], profile.values)
    np.testing.assert_array_equal(rows["profile_sample"][10:54], np.arange(44))
    assert (rows["reference_rps"][50:] == 0.0).all()
    assert rig.status(b.PROFILE_DONE) == number


@pytest.mark.parametrize("older", [1, 5000])  # more than is kept
def test_a_profile_that_begins_in_motion_knows_the_reference_before_it(older):
    rig = Rig(scripted(60))
    b.publish_controller(rig.blocks, CONTROLLER._replace(feedforward=FeedforwardConfig(0.0, 0.0, 2.5)))
    profile = Profile("ramp", MODE_VELOCITY, 5e-4, np.linspace(1.0, 0.0, 40), np.full(40, -51.0))
    b.publish_profile(rig.blocks, profile, np.array([9.0] * older + [1.0, 1.2, 1.1]))
    rows = rig.run()
    np.testing.assert_array_equal(rows["profile_sample"][:44], np.arange(44))
    np.testing.assert_array_equal(rows["reference_rps"][:40], profile.values)
    np.testing.assert_allclose(rows["expected_rps"][:3], [1.1, 1.15, 1.05])
    np.testing.assert_allclose(rows["expected_rps"][3:40], (profile.values[:37] + profile.values[1:38]) / 2)


def test_skipped_ticks_do_not_shift_the_profile():
    rig = Rig(scripted(100))
    rig.port.script[20, WAKE_DELAY_NS] = 2 * PERIOD_NS + 1000
    b.publish_profile(rig.blocks, constant_profile(MODE_VELOCITY, 1.0, 60))
    rows = rig.run(70)
    np.testing.assert_array_equal(rows["profile_sample"][:50], rows["tick"][:50])


def test_autostop_disables_the_drive_and_leaves():
    rig = Rig(scripted(300))
    rig.port.script[70:, STATUSWORD] = SWITCH_ON_DISABLED
    rig.blocks.control[b.AUTOSTOP] = 1
    b.publish_profile(rig.blocks, constant_profile(MODE_VELOCITY, 0.5, 50))
    rows = rig.run()
    assert rig.status(b.FINISHED) == 1
    assert rows["tick"][-1] == 70
    assert rows["controlword"][-1] == 0


def test_a_current_profile_passes_through_and_the_law_rests():
    rig = Rig(scripted(60, velocity_rps=2.0))
    b.publish_profile(rig.blocks, constant_profile(MODE_CURRENT, 1.25, 30))
    rows = rig.run()
    assert (rows["mode"][:30] == MODE_CURRENT).all()
    assert (rows["current_command_a"][:30] == 1.25).all()
    assert (rows["integral_a"][:30] == 0.0).all()


def test_missing_feedback_holds_the_last_value_then_trips():
    rig = Rig(scripted(60, velocity_rps=0.3))
    rig.port.velocity_rps[:] = np.linspace(0.0, 1.0, 60)
    rig.port.script[20:23, ANSWERS] = 0
    rig.port.script[40:, ANSWERS] = 0
    rows = rig.run()
    np.testing.assert_array_equal(rows["velocity_age"][19:24], [0, 1, 2, 3, 0])
    assert (rows["velocity_rps"][20:23] == rows["velocity_rps"][19]).all()
    assert (rows["turnaround_ns"][20:23] == -1).all()
    assert (rows["trip"][:44] == env.TRIP_NONE).all()
    assert (rows["trip"][44:] == env.TRIP_FEEDBACK_MISSING).all()
    assert (rows["current_command_a"][44:] == 0.0).all()
    assert rig.status(b.TRIP_TICK) == 44
    assert rig.status(b.MISSING_FEEDBACK) == 23


@pytest.mark.parametrize(
    ("column", "value", "trip", "controlword"),
    [
        (EMERGENCIES, 1, env.TRIP_EMERGENCY, 0x0002),
        (BUS_OFF, 1, env.TRIP_BUS_OFF, 0x0002),
        (FOREIGN_FRAMES, 1, env.TRIP_FOREIGN_COMMAND, 0x0002),
        (BOOTS, 1, env.TRIP_REBOOT, 0x0000),
        (NMT_STATE, 0x7F, env.TRIP_NOT_OPERATIONAL, 0x0002),
        (NMT_STATE, 0x04, env.TRIP_NOT_OPERATIONAL, 0x0002),
        (NMT_EXITS, 1, env.TRIP_NOT_OPERATIONAL, 0x0002),
        (STATUSWORD, FAULT, env.TRIP_DRIVE_FAULT, 0x0000),
        (STATUSWORD, SWITCH_ON_DISABLED, env.TRIP_DRIVE_LEFT, 0x0002),
    ],
)
def test_bad_news_of_the_drive_stops_within_the_tick(column, value, trip, controlword):
    rig = Rig(scripted(60, velocity_rps=-1.0))
    rig.port.script[30:, column] = value
    rows = rig.run()
    assert rows["trip"][29] == env.TRIP_NONE
    assert rows["current_command_a"][29] > 0.5
    assert (rows["trip"][30:] == trip).all()
    assert (rows["current_command_a"][30:] == 0.0).all()
    assert (rig.port.log[30:, CURRENT_A] == 0.0).all()
    assert (rig.port.log[30:, CONTROLWORD] == controlword).all()


@pytest.mark.parametrize("state", [0x7F, 0x04])
def test_a_drive_that_left_operational_is_noticed_without_torque_too(state):
    rig = Rig(scripted(60), goal=GOAL_DISABLED)
    rig.port.script[30:, NMT_STATE] = state
    rows = rig.run()
    assert (rows["trip"][:30] == env.TRIP_NONE).all()
    assert (rows["trip"][30:] == env.TRIP_NOT_OPERATIONAL).all()


def test_a_drive_that_was_away_from_operational_between_two_ticks_is_noticed():
    """Pre-operational and operational again: nothing of it is left but the count. A reset makes it old news."""
    rig = Rig(scripted(300))
    rig.port.script[30:, NMT_EXITS] = 1
    assert (rig.run(60)["trip"][30:] == env.TRIP_NOT_OPERATIONAL).all()
    rig.port.clock_ns[0] = 0
    rig.port.script[:, NMT_EXITS] = 1
    assert (rig.run(60)["trip"] == env.TRIP_NOT_OPERATIONAL).sum() == 0


def test_a_drive_that_has_sent_no_heartbeat_yet_is_not_judged_by_it():
    rig = Rig(scripted(60))
    rig.port.script[:, NMT_STATE] = -1
    assert (rig.run()["trip"] == env.TRIP_NONE).all()


def test_a_trip_stays_until_it_is_reset_and_the_cause_is_gone():
    port = scripted(300, velocity_rps=0.0)
    port.script[20:40, EMERGENCIES] = 1
    port.script[40:, EMERGENCIES] = 1
    rig = Rig(port)
    rows = rig.run(100)
    assert (rows["trip"][20:100] == env.TRIP_EMERGENCY).all()
    rig.blocks.control[b.RESET_NUMBER] = 1  # before a new loop: the baseline is taken when it begins
    port.clock_ns[0] = 0
    rows = rig.run(100)
    assert (rows["trip"][-50:] == env.TRIP_NONE).all()


def test_new_parameters_are_taken_whole_at_a_tick_boundary():
    rig = Rig(scripted(20, velocity_rps=-1.0))
    rig.run(10)
    doubled = CONTROLLER._replace(pi=PiConfig(1.95, 0.0))
    number = b.publish_controller(rig.blocks, doubled)
    rig.port.log[:] = np.nan
    rig.port.clock_ns[0] = 0
    rows = rig.run(10)
    assert rows["proportional_a"][-1] == pytest.approx(1.95)
    assert rig.status(b.PARAMETERS_IN_USE) == number


def test_terms_add_up_and_the_observer_is_in_the_row():
    rig = Rig(scripted(60, velocity_rps=0.4), toggle=TOGGLE_FEEDFORWARD)
    b.publish_profile(rig.blocks, constant_profile(MODE_VELOCITY, 0.5, 50))
    rows = rig.run()
    total = rows["proportional_a"] + rows["integral_a"] + rows["friction_nm"] / 0.148
    np.testing.assert_allclose(rows["requested_a"], total, rtol=0, atol=1e-15)
    assert (rows["friction_nm"][5:50] > 0.02).all()
    moving = rows["reference_rps"] != 0.0
    assert 0 < moving.sum() < rows.size
    np.testing.assert_allclose(rows["observation_nm_per_s"], np.where(moving, 5.0 * rows["error_rps"], 0.0))


def test_the_slew_limit_is_marked_in_the_row():
    rig = Rig(scripted(30, velocity_rps=-5.0))
    rows = rig.run(slew_a_per_s=1000.0)
    np.testing.assert_allclose(rows["current_command_a"][:5], 0.5 * np.arange(1, 6))
    assert (rows["limits"][:5] & env.LIMIT_SLEW).all()


def test_a_silent_supervisor_ends_in_a_quick_stop_and_then_in_no_loop_at_all():
    rig = Rig(scripted(400))
    rig.port.script[350:, STATUSWORD] = SWITCH_ON_DISABLED  # the drive has stopped by then
    loop = LOOP._replace(max_ticks=390, supervisor_ticks=200)
    if not INTERPRETED:
        run_loop.disable_compile(False)
    scratch = np.zeros((2, CONTROLLER_BLOCK_SIZE))
    ticks = run_loop(rig.port, loop, envelope(), rig.blocks, scratch, rig.ring, PERIOD_NS)
    rows = rig.reader.read().rows
    assert rig.status(b.ABANDONED) == rig.status(b.FINISHED) == 1
    assert 201 < ticks < 390
    assert (rows["controlword"][:201] == 0x0F).all()
    assert (rows["controlword"][201:] == 0x02).all()
    assert (rows["current_command_a"][202:] == 0.0).all()
    assert (rows["trip"] == 0).all()

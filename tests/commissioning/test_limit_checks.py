"""Verdicts on what stops the axis, on motions written down by hand."""

from __future__ import annotations

import numpy as np
import pytest

from fffo_drive.commissioning.estimate import coasting_s, current_slope, fall_rate_rps2, update_interval_s
from fffo_drive.commissioning.limit_checks import current_limit, quick_stop, stop_after_trip
from fffo_drive.commissioning.motion import PulseMotion, integral, pulse_windows, responses
from fffo_drive.control.envelope import LIMIT_CURRENT, TRIP_HEARTBEAT, TRIP_OVERSPEED

PERIOD_S = 0.0005


def motion(velocity, command=0.0, trip_row=None, trip=TRIP_OVERSPEED, leave_row=None, limits=0):
    """A motion with this velocity; from `trip_row` on tripped, from `leave_row` on not enabled."""
    velocity = np.asarray(velocity, np.float64)
    n = velocity.size
    rows = np.arange(n)
    time_s = rows * PERIOD_S
    command = np.broadcast_to(np.asarray(command, np.float64), n).copy()
    if trip_row is not None:
        command[trip_row:] = 0.0
        leave_row = trip_row + 1 if leave_row is None else leave_row
    enabled = rows < (n if leave_row is None else leave_row)
    tripped = np.where(rows >= (n if trip_row is None else trip_row), trip, 0)
    return PulseMotion(
        time_s, command, velocity, integral(time_s, velocity), command.copy(), np.ones(n, bool), enabled,
        ~enabled, np.full(n, limits), tripped, np.full(n, -1),
    )  # fmt: skip


def rise_and_fall(peak_rps, fall_rps2, n=1000):
    """Up with 100 rps2, down with `fall_rps2`, then rest. Also the row of the peak."""
    time_s = np.arange(n) * PERIOD_S
    top_s = peak_rps / 100.0
    fall = np.maximum(0.0, peak_rps - fall_rps2 * (time_s - top_s))
    return np.where(time_s < top_s, 100.0 * time_s, fall), round(top_s / PERIOD_S)


def test_a_clamp_that_holds_is_ok_and_one_that_does_not_has_failed():
    still = np.zeros(200)
    command = np.where(np.arange(200) < 100, 0.5, 0.0)
    assert current_limit(motion(still, command, limits=LIMIT_CURRENT), 0.5, 1.0, 0.01).verdict == "ok"
    assert current_limit(motion(still, 1.2 * command, limits=LIMIT_CURRENT), 0.5, 1.0, 0.01).verdict == "failed"
    assert current_limit(motion(still, command), 0.5, 1.0, 0.01).verdict == "failed"  # nothing said that it was limited
    moving = np.full(200, 1.0)
    assert current_limit(motion(moving, command, limits=LIMIT_CURRENT), 0.5, 1.0, 0.01).verdict == "warning"


def test_a_stop_after_a_trip_is_judged_by_what_the_axis_does():
    velocity, top = rise_and_fall(2.0, 100.0)
    judge = lambda m, reached=2.0: stop_after_trip("speed_limit", m, TRIP_OVERSPEED, reached, 1.9, "rps")  # noqa: E731
    good = judge(motion(velocity, 0.5, top))
    assert good.verdict == "ok"
    assert good.numbers["stopped_after_s"] == pytest.approx(0.02, abs=2e-3)
    assert good.numbers["stopping_travel_rev"] == pytest.approx(0.02, rel=0.05)
    assert judge(motion(velocity, 0.5)).verdict == "failed"  # beyond the limit, and no trip
    assert judge(motion(velocity, 0.5), reached=1.5).verdict == "not_done"  # the limit was not met
    other = judge(motion(velocity, 0.5, top, trip=TRIP_HEARTBEAT))
    assert other.verdict == "failed"
    assert "heartbeat" in other.text
    held = judge(motion(velocity, 0.5, top, leave_row=top + 600))
    assert "let go" in held.text
    assert held.verdict == "failed"
    coasting = judge(motion(np.full(1000, 2.0), 0.5, top))
    assert coasting.verdict == "failed"
    assert "0x605A" in coasting.remedy
    late = motion(velocity, 0.5, top)
    late.command_a[top + 3] = 0.1
    assert "current was commanded" in judge(late).text


def test_a_noisy_velocity_is_no_motion():
    velocity, top = rise_and_fall(2.0, 100.0)
    noise = np.random.default_rng(1).normal(0.0, 0.15, velocity.size)
    noisy = motion(velocity, 0.5, top)._replace(velocity_rps=velocity + noise)
    check = stop_after_trip("speed_limit", noisy, TRIP_OVERSPEED, 2.0, 1.9, "rps")
    assert check.verdict == "ok"
    assert check.numbers["stopped_after_s"] == pytest.approx(0.015, abs=5e-3)


def test_braking_is_compared_with_coasting_through_the_same_speeds():
    free, top = rise_and_fall(2.0, 40.0)
    coast = motion(free, np.where(np.arange(free.size) < top, 0.5, 0.0))
    for rate, verdict in ((120.0, "ok"), (48.0, "warning"), (40.0, "failed")):
        braked, row = rise_and_fall(1.6, rate)
        check = quick_stop([motion(braked, 0.5, row)], [coast])
        assert check.verdict == verdict, check
        assert check.numbers["coasting_rps2"] == pytest.approx(40.0, rel=0.05)
        assert check.measured == pytest.approx(rate / 40.0, rel=0.1)
    never, row = rise_and_fall(1.6, 0.0)
    assert quick_stop([motion(never, 0.5, row)], [coast]).verdict == "failed"


def test_an_axis_that_friction_stops_at_once_does_not_show_its_brake():
    free, top = rise_and_fall(1.0, 400.0)
    coast = motion(free, np.where(np.arange(free.size) < top, 0.5, 0.0))
    braked, row = rise_and_fall(0.9, 300.0)
    check = quick_stop([motion(braked, 0.5, row)], [coast])
    assert check.verdict == "warning"
    assert "--speed" in check.remedy


def test_small_estimators():
    velocity, top = rise_and_fall(2.0, 50.0)
    pulse = np.where(np.arange(velocity.size) < top, -0.5, 0.0)
    one = motion(-velocity, pulse)
    assert fall_rate_rps2(one, 1.7, 0.7) == pytest.approx(50.0, rel=0.03)
    assert coasting_s(one) == pytest.approx(0.04, rel=0.05)
    assert [(w.start, w.stop) for w in pulse_windows(one)] == [(0, velocity.size)]
    (move,) = responses(one)
    assert move.speed_rps == pytest.approx(2.0)
    assert move.net_rev == pytest.approx(0.02 + 0.04, rel=0.02)
    slope, samples = current_slope(one._replace(current_a=0.9 * pulse))
    assert slope == pytest.approx(0.9)
    assert samples == top - 21  # after 10 ms of the same command
    held = np.repeat(velocity[::4], 4)
    assert update_interval_s(motion(held, -pulse), PERIOD_S) == pytest.approx(4 * PERIOD_S)


def test_a_motion_without_pulses_says_nothing():
    still = motion(np.zeros(50))
    assert pulse_windows(still) == []
    assert responses(still) == []
    assert coasting_s(still) == 0.0
    assert np.isnan(fall_rate_rps2(still, 1.0, 0.5))
    assert np.isnan(current_slope(still)[0])

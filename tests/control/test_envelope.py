"""The envelope: each limit at its edge, what has precedence, and that it stands alone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fffo_drive.control import envelope as env

PERIOD_S = 5e-4
CONFIG = env.EnvelopeConfig(
    10.0, 4000.0, 20.0, 5.0, 2.0, True, -3.0, 3.0, 2.0, 0.01, 10, 100, 500_000_000, PERIOD_S, env.default_reactions()
)
HEALTHY = env.EnvelopeInputs(
    1.0, 0.0, 0.0, 0.0, 0, 0, 0x0637, 0, 0, False, False, 0, 0, 0, True, True, True, False, False, 0, False
)


def step(config=CONFIG, state=None, **changes):
    return env.envelope_step(config, state or env.envelope_at_rest(), HEALTHY._replace(**changes))


def test_an_ordinary_command_passes_unchanged():
    assert step()[:3] == (1.0, 0, env.TRIP_NONE)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("requested", [9.999, 10.0, 10.001, 1e6, math.inf])
def test_current_is_clamped_at_its_limit(sign, requested):
    state = env.envelope_at_rest()._replace(last_command_a=sign * 9.0)
    command_a, limits, trip, _ = step(CONFIG, state, requested_a=sign * requested)
    if math.isinf(requested):
        assert (command_a, trip) == (0.0, env.TRIP_NOT_A_NUMBER)
        return
    assert command_a == pytest.approx(sign * min(requested, 10.0))
    assert bool(limits & env.LIMIT_CURRENT) == (requested > 10.0)


def test_slew_limits_the_step_both_ways():
    largest = 4000.0 * PERIOD_S
    for direction in (1.0, -1.0):
        command_a, limits, _, _ = step(requested_a=direction * (largest + 1e-9))
        assert command_a == pytest.approx(direction * largest, abs=1e-12)
        assert limits & env.LIMIT_SLEW
        command_a, limits, _, _ = step(requested_a=direction * largest)
        assert command_a == pytest.approx(direction * largest)
        assert not limits & env.LIMIT_SLEW


@pytest.mark.parametrize(
    ("changes", "trip"),
    [
        ({"velocity_rps": 20.001}, env.TRIP_OVERSPEED),
        ({"velocity_rps": -20.001}, env.TRIP_OVERSPEED),
        ({"position_rev": 3.001}, env.TRIP_POSITION_WINDOW),
        ({"position_rev": -3.001}, env.TRIP_POSITION_WINDOW),
        ({"feedback_age": 10}, env.TRIP_FEEDBACK_MISSING),
        ({"status_age": 100}, env.TRIP_STATUS_MISSING),
        ({"velocity_rps": math.nan}, env.TRIP_NOT_A_NUMBER),
        ({"requested_a": math.nan}, env.TRIP_NOT_A_NUMBER),
        ({"position_rev": math.inf}, env.TRIP_NOT_A_NUMBER),
        ({"error_rps": math.nan}, env.TRIP_NOT_A_NUMBER),
        ({"statusword": 0x0218}, env.TRIP_DRIVE_FAULT),
        ({"emergencies": 1}, env.TRIP_EMERGENCY),
        ({"reboots": 1}, env.TRIP_REBOOT),
        ({"not_operational": True}, env.TRIP_NOT_OPERATIONAL),
        ({"bus_off": True}, env.TRIP_BUS_OFF),
        ({"foreign_frames": 1}, env.TRIP_FOREIGN_COMMAND),
        ({"heartbeat_age_ns": 500_000_001}, env.TRIP_HEARTBEAT),
        ({"settings_changes": 1}, env.TRIP_SETTINGS_CHANGED),
    ],
)
def test_each_trip_gives_no_torque(changes, trip):
    command_a, _, found, _ = step(**changes)
    assert (command_a, found) == (0.0, trip)
    assert trip in env.TRIP_TEXTS


@pytest.mark.parametrize(
    "changes",
    [
        {"velocity_rps": 20.0},
        {"position_rev": 3.0},
        {"position_rev": -3.0},
        {"feedback_age": 9},
        {"status_age": 99},
        {"heartbeat_age_ns": 500_000_000},
        {"heartbeat_age_ns": -1},
    ],
)
def test_the_edges_themselves_are_allowed(changes):
    assert step(**changes)[2] == env.TRIP_NONE


def test_a_following_error_trips_only_when_it_lasts():
    state = env.envelope_at_rest()
    trips = []
    for _ in range(40):
        _, _, trip, state = step(CONFIG, state, error_rps=2.001)
        trips.append(trip)
    first = trips.index(env.TRIP_FOLLOWING_ERROR)
    assert first * PERIOD_S == pytest.approx(0.01, abs=2 * PERIOD_S)
    for _ in range(round(env.PAUSE_S / PERIOD_S)):
        _, _, trip, state = step(CONFIG, state, error_rps=1.9)
        assert trip == env.TRIP_NONE  # a pause is no reason
    assert state.following_s == 0.0
    assert step(CONFIG, env.envelope_at_rest()._replace(following_s=1.0), error_rps=9.0, closed_loop=False)[2] == 0


@pytest.mark.parametrize("hz", [10.5, 40.0, 85.0, 300.0])
@pytest.mark.parametrize("amplitude_rps", [2.2, 20.0])
def test_an_alternating_error_trips_after_its_time(hz, amplitude_rps):
    """It is below the limit twice a period, at the smaller amplitude for 73 % of the time."""
    state, config = env.envelope_at_rest(), CONFIG._replace(following_error_s=0.2)
    for tick in range(1000):
        error_rps = amplitude_rps * math.sin(2 * math.pi * hz * (tick + 0.5) * PERIOD_S)
        _, _, trip, state = step(config, state, error_rps=error_rps)
        if trip:
            break
    first_s = math.asin(2.0 / amplitude_rps) / (2 * math.pi * hz)
    assert trip == env.TRIP_FOLLOWING_ERROR
    assert first_s + 0.2 - 2 * PERIOD_S <= tick * PERIOD_S <= first_s + 0.2 + 0.5 / hz + 2 * PERIOD_S


def test_errors_that_come_seldom_are_forgotten():
    """For a tenth of a second each time, every 0.15 s: no oscillation, and none lasts for its time."""
    state, config = env.envelope_at_rest(), CONFIG._replace(following_error_s=0.12)
    for tick in range(6000):
        _, _, trip, state = step(config, state, error_rps=3.0 if tick % 300 < 199 else 0.0)
        assert trip == env.TRIP_NONE


def reversing(hz, config=CONFIG, seconds=1.0, **changes):
    """Seconds until the trip of a command that is asked for now in one direction, now in the other."""
    state = env.envelope_at_rest()
    for tick in range(round(seconds / PERIOD_S)):
        sign = 1.0 if (tick * PERIOD_S * hz) % 1.0 < 0.5 else -1.0
        given = {"requested_a": 20.0, **changes}
        given["requested_a"] *= sign
        _, _, trip, state = step(config, state, **given)
        if trip:
            return trip, tick * PERIOD_S
    return 0, math.inf


@pytest.mark.parametrize("hz", [10.5, 85.0, 300.0])
@pytest.mark.parametrize(
    "changes", [{}, {"requested_a": 3.0, "limited": True}, {"requested_a": 3.0, "statusword": 0x0E37}]
)
def test_a_command_that_reverses_at_its_limit_trips(hz, changes):
    """At the envelope's limit, the controller's, or the drive's (statusword bit 11)."""
    config = CONFIG._replace(following_error_s=0.2)
    trip, after_s = reversing(hz, config, **changes)
    assert trip == env.TRIP_OSCILLATION
    assert 0.2 <= after_s <= 0.2 + 1.0 / hz + 2 * PERIOD_S


@pytest.mark.parametrize(
    ("hz", "changes"),
    [(85.0, {"requested_a": 9.9}), (9.0, {}), (85.0, {"closed_loop": False}), (0.0, {"requested_a": 20.0})],
)
def test_no_oscillation(hz, changes):
    """Below the limit, slower than 10 Hz, an open loop, or always in one direction."""
    config = CONFIG._replace(following_error_s=0.2, continuous_current_a=10.0)
    assert reversing(hz, config, 3.0, **changes)[0] == env.TRIP_NONE


@pytest.mark.parametrize(
    ("says", "trip"), [("local_control", env.TRIP_LOCAL_CONTROL), ("ignores_target", env.TRIP_NOT_FOLLOWING)]
)
def test_a_drive_that_does_not_heed_us_trips_when_that_lasts(says, trip):
    state, trips = env.envelope_at_rest(), []
    for _ in range(300):
        _, _, found, state = step(CONFIG, state, **{says: True})
        trips.append(found)
    assert trips.index(trip) * PERIOD_S == pytest.approx(env.UNHEEDED_S, abs=2 * PERIOD_S)
    assert set(trips) == {env.TRIP_NONE, trip}
    assert step(CONFIG, state)[3].unheeded_s == 0.0
    assert step(CONFIG, state, **{says: True, "wanted": False})[2] == env.TRIP_NONE


def i2t_ticks(current_a: float, config=CONFIG, start=None) -> int:
    state = (start or env.envelope_at_rest())._replace(last_command_a=current_a)
    for tick in range(40_000):
        command_a, limits, trip, state = step(config, state, requested_a=current_a)
        if trip == env.TRIP_I2T or limits & env.LIMIT_I2T:
            return tick
    return -1


def test_i2t_lets_the_limit_flow_for_its_time_and_the_continuous_current_for_ever():
    assert i2t_ticks(10.0) * PERIOD_S == pytest.approx(2.0, rel=0.01)
    # at 7.5 A: (100 - 25) * 2 / (56.25 - 25) seconds
    assert i2t_ticks(7.5) * PERIOD_S == pytest.approx(4.8, rel=0.01)
    assert i2t_ticks(5.0) == -1


def test_a_reset_does_not_cool_the_motor():
    state = env.envelope_at_rest()._replace(
        last_command_a=10.0, i2t_a2s=149.0, following_s=0.005, was_enabled=True, unheeded_s=0.1
    )
    assert env.envelope_after_reset(state) == env.envelope_at_rest()._replace(i2t_a2s=149.0)
    # peak current cannot be had again by resetting: the time that it takes is that which it takes to cool
    ticks = [i2t_ticks(10.0, start=env.envelope_after_reset(state)), i2t_ticks(10.0)]
    assert ticks[0] < 0.02 * ticks[1]


def test_i2t_can_limit_instead_of_trip():
    config = CONFIG._replace(i2t_trips=False, slew_a_per_s=1e9)
    state = env.envelope_at_rest()
    commands = []
    for _ in range(30_000):
        command_a, _, trip, state = step(config, state, requested_a=10.0)
        assert trip == env.TRIP_NONE
        commands.append(command_a)
    assert commands[0] == 10.0
    # heat stays at the capacity, so that the mean square is the continuous current's
    assert np.mean(np.square(commands[8000:])) == pytest.approx(25.0, rel=0.01)


def test_leaving_operation_enabled_unasked_is_a_trip_but_not_while_enabling():
    _, _, trip, state = step(enabled=False)
    assert trip == env.TRIP_NONE
    _, _, trip, state = step(CONFIG, state, enabled=True)
    assert trip == env.TRIP_NONE
    assert step(CONFIG, state, enabled=False)[2] == env.TRIP_DRIVE_LEFT
    assert step(CONFIG, state, enabled=False, wanted=False)[2] == env.TRIP_NONE


def test_without_torque_wanted_nothing_but_the_drive_and_the_bus_can_trip():
    quiet = {"wanted": False, "velocity_rps": 99.0, "position_rev": 99.0, "feedback_age": 999, "status_age": 999}
    command_a, _, trip, _ = step(**quiet)
    assert (command_a, trip) == (0.0, env.TRIP_NONE)
    assert step(**quiet, bus_off=True)[2] == env.TRIP_BUS_OFF


def test_every_trip_has_a_sentence_and_a_reaction():
    assert set(env.TRIP_TEXTS) == set(range(env.TRIP_COUNT))
    assert set(env.DEFAULT_REACTIONS) == set(range(1, env.TRIP_COUNT))
    assert all(len(why) > 20 for _, why in env.DEFAULT_REACTIONS.values())
    assert env.default_reactions().shape == (env.TRIP_COUNT,)

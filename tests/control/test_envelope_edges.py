"""The envelope against its specification: dense at every edge of every limit, all pairs of causes, many mixtures."""

from __future__ import annotations

import itertools
import math
import random

import numpy as np
import pytest
from control.envelope_spec import (
    CAPACITY_A2S,
    CAUSES,
    CONFIG,
    HEALTHY,
    PERIOD_S,
    REST,
    STEP_A,
    WITHOUT_TORQUE,
    around,
    capacity_a2s,
    expected,
    sweep,
)
from interpreted import hex_results

from fffo_drive.control import envelope as env

LIMITING = CONFIG._replace(i2t_trips=False)


def same(one, other) -> bool:
    """Equal in every bit but the sign of zero; nan equals nan."""
    return all(a == b or (a != a and b != b) for a, b in zip([*one[:3], *one[3]], [*other[:3], *other[3]], strict=True))


def check(config=CONFIG, state=REST, seen=HEALTHY):
    """One step is as specified. Returns it."""
    found = env.envelope_step(config, state, seen)
    assert same(found, expected(config, state, seen)), (config, state, seen, found)
    return found


def edge_of(outcomes: list[bool], values: list[float], edge: float) -> None:
    """All finite values up to the edge are allowed, and from the next number on none is."""
    for value, fine in zip(values, outcomes, strict=True):
        if math.isfinite(value):
            assert fine == (value <= edge), value


def test_numbers_in_recordings_never_change():
    names = (
        "NONE", "NOT_A_NUMBER", "OVERSPEED", "POSITION_WINDOW", "FOLLOWING_ERROR", "I2T", "FEEDBACK_MISSING",
        "STATUS_MISSING", "DRIVE_FAULT", "EMERGENCY", "BUS_OFF", "HEARTBEAT", "REBOOT", "DRIVE_LEFT",
        "NOT_OPERATIONAL", "FOREIGN_COMMAND", "LOCAL_CONTROL", "NOT_FOLLOWING", "SETTINGS_CHANGED",
        "OSCILLATION", "COUNT",
    )  # fmt: skip
    assert [getattr(env, f"TRIP_{name}") for name in names] == list(range(21))
    limits = ("CONTROLLER", "CURRENT", "SLEW", "I2T", "DRIVE")
    assert [getattr(env, f"LIMIT_{name}") for name in limits] == [1, 2, 4, 8, 16]
    assert (env.REACTION_COAST, env.REACTION_QUICK_STOP) == (0, 1)
    assert (env.STATUS_FAULT, env.STATUS_INTERNAL_LIMIT) == (0x0008, 0x0800)  # CiA 402, 0x6041


def test_default_reactions():
    coast = {12}  # a drive that has restarted has no torque to brake with
    found = env.default_reactions()
    assert found.dtype == np.int64
    assert found.tolist() == [0 if trip in coast else 1 for trip in range(20)]


def test_memory_at_rest_and_after_a_reset():
    assert env.envelope_at_rest() == REST
    warm = env.EnvelopeState(3.0, 120.0, 0.5, True, 0.1, 0.01, -1.0, 0.2, 0.02)
    assert env.envelope_after_reset(warm) == REST._replace(i2t_a2s=120.0)


def with_cause(seen, state, cause):
    return seen._replace(**cause[1]), state._replace(**cause[2])


def test_each_cause_alone_trips_and_has_its_number():
    for cause in CAUSES:
        seen, state = with_cause(HEALTHY, REST, cause)
        assert check(CONFIG, state, seen)[2] == cause[0]


def mixtures(count: int, seed: int):
    """States and inputs near the edges, several at once."""
    pick = random.Random(seed)
    values = {
        "requested_a": sweep((-10.0, -5.0, 5.0, 10.0), 21), "velocity_rps": [0.0, *around(20.0, 1), *around(-20.0, 1)],
        "position_rev": [0.0, *around(-3.0, 1), *around(5.0, 1)], "error_rps": [0.0, *around(2.0, 1), *around(-2.0, 1)],
        "feedback_age": [0, 1, 9, 10, 11], "status_age": [0, 1, 99, 100, 101], "statusword": [0x0637, 0x0E37, 0x0218],
        "emergencies": [0, 0, 0, 1], "reboots": [0, 0, 0, 1], "bus_off": [False, False, False, True],
        "foreign_frames": [0, 0, 0, 1], "settings_changes": [0, 0, 0, 1],
        "not_operational": [False, False, False, True],
        "heartbeat_age_ns": [-1, 0, 499_999_999, 500_000_000, 500_000_001], "wanted": [True, True, False],
        "enabled": [True, True, False], "closed_loop": [True, False],
        "local_control": [False, False, True], "ignores_target": [False, False, True], "skipped_ticks": [0, 0, 1, 5],
        "limited": [False, True],
    }  # fmt: skip
    lasting = [0.0, *(time_s for time_s in around(2.0**-7 - PERIOD_S, 1) if time_s > 0.0)]
    pauses = [0.0, 0.0, 0.01, *(time_s for time_s in around(0.05 - PERIOD_S, 1) if time_s > 0.0)]
    for _ in range(count):
        names = pick.sample(sorted(values), 4)
        seen = HEALTHY._replace(**{name: pick.choice(values[name]) for name in names})
        state = env.EnvelopeState(
            pick.choice([0.0, 1.0, -9.5, 10.0, 14.0]),
            pick.choice([0.0, 1e-3, *around(CAPACITY_A2S, 1)]),
            pick.choice(lasting),
            pick.choice([False, True]),
            pick.choice([0.0, *around(0.125 - PERIOD_S, 1)]),
            pick.choice(pauses),
            pick.choice([-1.0, 0.0, 1.0]),
            pick.choice(lasting),
            pick.choice(pauses),
        )
        changes = {"i2t_trips": pick.choice([True, False]), "heartbeat_timeout_ns": pick.choice([0, 500_000_000])}
        yield CONFIG._replace(**changes), state, seen


def test_mixtures_are_as_specified():
    for config, state, seen in mixtures(3000, 1):
        check(config, state, seen)


@pytest.mark.parametrize("field", ["velocity_rps", "position_rev", "error_rps", "requested_a"])
def test_each_number_of_the_feedback_at_every_edge(field):
    edges = {
        "velocity_rps": (-20.0, 20.0), "position_rev": (-3.0, 5.0), "error_rps": (-2.0, 2.0),
        "requested_a": (-10.0, -5.0, -STEP_A, STEP_A, 5.0, 10.0),
    }[field]  # fmt: skip
    for value in sweep(edges):
        for config in (CONFIG, LIMITING):
            for last_a, heat, following_s in itertools.product((0.0, 9.0, -9.0), (0.0, 151.0), (0.0, 2.0**-7)):
                state = REST._replace(last_command_a=last_a, i2t_a2s=heat, following_s=following_s)
                check(config, state, HEALTHY._replace(**{field: value}))


def test_the_edges_stand_where_the_configuration_has_them():
    def fine(value, name, sign):
        return env.envelope_step(CONFIG, REST, HEALTHY._replace(**{name: sign * value}))[2] == 0

    for sign in (1, -1):
        values = sweep((20.0,))
        edge_of(
            [fine(value, "velocity_rps", sign) for value in values if value >= 0], [v for v in values if v >= 0], 20.0
        )
    for sign, edge in ((1, 5.0), (-1, 3.0)):
        values = [value for value in sweep((edge,)) if value >= 0]
        edge_of([fine(value, "position_rev", sign) for value in values], values, edge)


@pytest.mark.parametrize(
    ("field", "values", "first_bad"),
    [
        ("feedback_age", range(0, 40), 10),
        ("status_age", range(0, 400), 100),
        ("emergencies", range(0, 5), 1),
        ("reboots", range(0, 5), 1),
        ("foreign_frames", range(0, 5), 1),
        ("settings_changes", range(0, 5), 1),
        ("heartbeat_age_ns", [-1, 0, 1, *range(499_999_990, 500_000_010), 10**15], 500_000_001),
        ("bus_off", [False, True], True),
        ("not_operational", [False, True], True),
    ],
)
def test_each_count_at_its_edge(field, values, first_bad):
    for value in values:
        for wanted in (True, False):
            found = check(seen=HEALTHY._replace(**{field: value, "wanted": wanted}))
            tripped = value >= first_bad and (wanted or field not in ("feedback_age", "status_age"))
            assert (found[2] != 0) == tripped


@pytest.mark.parametrize("timeout_ns", [0, 1, 2])
def test_a_heartbeat_is_watched_only_with_a_timeout_and_only_after_the_first(timeout_ns):
    config = CONFIG._replace(heartbeat_timeout_ns=timeout_ns)
    for age_ns in (-1, 0, 1, 2, 3, 10**12):
        found = check(config, seen=HEALTHY._replace(heartbeat_age_ns=age_ns))
        assert (found[2] == 11) == (timeout_ns > 0 and age_ns > timeout_ns)


def test_every_statusword():
    for statusword in range(1 << 16):
        found = env.envelope_step(CONFIG, REST, HEALTHY._replace(statusword=statusword))
        fault, limited = statusword & 8 != 0, statusword & 2048 != 0
        assert (found[2], found[1]) == ((8, 0) if fault else (0, 16 if limited else 0))


def test_a_current_is_never_beyond_its_limit_whatever_was_before():
    for requested, last_a in itertools.product(
        sweep((-10.0, 10.0), 31), [*around(10.0), -10.0, 40.0, -40.0, 12.0, -12.0]
    ):
        for config in (CONFIG, LIMITING, CONFIG._replace(slew_a_per_s=1.0)):
            state = REST._replace(last_command_a=last_a)
            command_a = check(config, state, HEALTHY._replace(requested_a=requested))[0]
            assert -10.0 <= command_a <= 10.0


def test_the_slew_at_its_edges_from_anywhere():
    for last_a in (-10.0, -9.0, -1.0, 0.0, 0.5, 3.0, 8.0, 10.0):
        for side in (-STEP_A, STEP_A, 0.0):
            for requested in around(last_a + side):
                found = check(state=REST._replace(last_command_a=last_a), seen=HEALTHY._replace(requested_a=requested))
                assert abs(found[0] - last_a) <= STEP_A


def test_heat_at_the_edge_of_its_capacity():
    assert capacity_a2s(CONFIG) == env.i2t_capacity_a2s(CONFIG) == CAPACITY_A2S
    for heat in around(CAPACITY_A2S):
        for requested, last_a in itertools.product((0.0, 4.9, *around(5.0), 5.1, -5.1, 10.0), (0.0, 4.0, 9.0)):
            state = REST._replace(i2t_a2s=heat, last_command_a=last_a)
            seen = HEALTHY._replace(requested_a=requested)
            tripped = check(CONFIG, state, seen)[2] == 5
            assert tripped == (heat > CAPACITY_A2S)
            found = check(LIMITING, state, seen)
            assert bool(found[1] & 8) == (heat > CAPACITY_A2S and abs(requested) > 5.0)


@pytest.mark.parametrize("continuous_a", [0.5, 5.0, 9.5, 10.0])
def test_heat_follows_the_square_of_the_current(continuous_a):
    config = LIMITING._replace(continuous_current_a=continuous_a, slew_a_per_s=1e9)
    state = REST
    for tick in range(600):
        seen = HEALTHY._replace(requested_a=12.0 * math.sin(tick / 40.0), skipped_ticks=tick % 3, wanted=tick % 90 != 0)
        state = check(config, state, seen)[3]
        assert state.i2t_a2s >= 0.0


@pytest.mark.parametrize(("skipped", "allowed"), [(0, 16), (1, 8), (3, 4), (15, 1)])
def test_a_following_error_trips_after_its_time_and_not_before(skipped, allowed):
    state, trips = REST, []
    for _ in range(allowed + 1):
        _, _, trip, state = check(CONFIG, state, HEALTHY._replace(error_rps=-2.25, skipped_ticks=skipped))
        trips.append(trip)
    assert trips == [0] * allowed + [4]


@pytest.mark.parametrize(("skipped", "allowed"), [(0, 256), (1, 128), (15, 16)])
@pytest.mark.parametrize(("says", "trip"), [("local_control", 16), ("ignores_target", 17)])
def test_a_drive_that_does_not_heed_us_trips_after_its_time_and_not_before(says, trip, skipped, allowed):
    state, trips = REST, []
    for _ in range(allowed + 1):
        _, _, found, state = check(CONFIG, state, HEALTHY._replace(**{says: True}, skipped_ticks=skipped))
        trips.append(found)
    assert trips == [0] * allowed + [trip]


def test_deadlines_that_were_missed_count_with_the_current_that_flowed():
    state = REST._replace(last_command_a=10.0, i2t_a2s=100.0)
    found = check(state=state, seen=HEALTHY._replace(requested_a=10.0, skipped_ticks=7))
    assert found[3].i2t_a2s == 100.0 + 8 * 75.0 * PERIOD_S
    state = REST._replace(last_command_a=10.0, i2t_a2s=CAPACITY_A2S)
    assert check(state=state, seen=HEALTHY._replace(requested_a=10.0))[2] == 0
    assert check(state=state, seen=HEALTHY._replace(requested_a=10.0, skipped_ticks=1))[2] == 5


@pytest.mark.parametrize("wanted", [True, False])
def test_of_two_causes_the_more_certain_one_is_named(wanted):
    for first, second in itertools.combinations(CAUSES, 2):
        seen, state = with_cause(*with_cause(HEALTHY._replace(wanted=wanted), REST, second), first)
        for config in (CONFIG, LIMITING):
            check(config, state, seen)
        found = env.envelope_step(CONFIG, state, seen)
        possible = [trip for trip in (first[0], second[0]) if wanted or trip in WITHOUT_TORQUE]
        assert found[2] == (possible[0] if possible else 0)
        assert (found[0] == 0.0) == (not wanted or bool(possible))


def hex_of_mixtures() -> list[str]:
    """Every number of every step, for a comparison of every bit."""
    found = []
    for config, state, seen in mixtures(500, 2):
        command_a, limits, trip, after = env.envelope_step(config, state, seen)
        found += [float(number).hex() for number in (command_a, limits, trip, *after)]
    return found


@pytest.mark.slow
def test_compiled_and_interpreted_agree_in_every_bit():
    assert hex_of_mixtures() == hex_results("control.test_envelope_edges", "hex_of_mixtures")

"""The envelope as a specification: one table of what is allowed, and the three limits. Shares no line with the code.

All numbers of CONFIG are sums of powers of two, so that every edge is hit exactly and no rounding stands between the
code and this file.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import numpy as np

from fffo_drive.control import envelope as env

PERIOD_S = 2.0**-11
STEP_A = 2.0  # slew in a period
CAPACITY_A2S = 150.0  # (10^2 - 5^2) 2 s
PAUSE_S = 0.05  # half a period of 10 Hz
UNHEEDED_S = 0.125  # a drive may set statusword bits 9 and 12 so much later than the state
REACTIONS = np.zeros(20, dtype=np.int64)
CONFIG = env.EnvelopeConfig(
    current_limit_a=10.0, slew_a_per_s=4096.0, speed_limit_rps=20.0, continuous_current_a=5.0, i2t_time_s=2.0,
    i2t_trips=True, position_low_rev=-3.0, position_high_rev=5.0, following_error_rps=2.0, following_error_s=2.0**-7,
    feedback_missing_ticks=10, status_missing_ticks=100, heartbeat_timeout_ns=500_000_000, period_s=PERIOD_S,
    reactions=REACTIONS,
)  # fmt: skip
REST = env.EnvelopeState(
    last_command_a=0.0,
    i2t_a2s=0.0,
    following_s=0.0,
    was_enabled=False,
    unheeded_s=0.0,
    followed_s=0.0,
    limited_side=0.0,
    reversing_s=0.0,
    steady_s=0.0,
)
HEALTHY = env.EnvelopeInputs(
    requested_a=1.0, velocity_rps=0.5, position_rev=0.5, error_rps=0.25, feedback_age=0, status_age=0,
    statusword=0x0637, emergencies=0, reboots=0, not_operational=False, bus_off=False, foreign_frames=0,
    heartbeat_age_ns=0, settings_changes=0, wanted=True, enabled=True, closed_loop=True, local_control=False,
    ignores_target=False, skipped_ticks=0, limited=False,
)  # fmt: skip

# one cause of each trip, most certain first; numbers as in recordings, so that they never change
CAUSES: tuple[tuple[int, dict[str, object], dict[str, object]], ...] = (
    # trip, what is seen, what is remembered
    (10, {"bus_off": True}, {}),
    (15, {"foreign_frames": 1}, {}),
    (12, {"reboots": 1}, {}),
    (9, {"emergencies": 1}, {}),
    (8, {"statusword": 0x0218}, {}),
    (14, {"not_operational": True}, {}),
    (11, {"heartbeat_age_ns": 500_000_001}, {}),
    (18, {"settings_changes": 1}, {}),
    (13, {"enabled": False}, {"was_enabled": True}),
    (1, {"requested_a": math.nan}, {}),
    (6, {"feedback_age": 10}, {}),
    (7, {"status_age": 100}, {}),
    (16, {"local_control": True}, {"unheeded_s": 0.125}),
    (17, {"ignores_target": True}, {"unheeded_s": 0.125}),
    (2, {"velocity_rps": 20.5}, {}),
    (3, {"position_rev": 5.5}, {}),
    (19, {"requested_a": -10.0}, {"limited_side": 1.0, "reversing_s": 2.0**-7}),
    (4, {"error_rps": 2.5}, {"following_s": 2.0**-7}),
    (5, {}, {"i2t_a2s": 151.0}),
)
WITHOUT_TORQUE = (10, 15, 12, 9, 8, 14, 11, 18)  # also where no torque is wanted


def expected_trip(
    config: env.EnvelopeConfig, heat_a2s: float, errs_s: float, reverses_s: float, was_enabled: bool,
    unheeded_s: float, seen,
) -> int:  # fmt: skip
    """The most certain reason to stop, by the table of what is allowed."""
    numbers = (seen.requested_a, seen.error_rps, seen.velocity_rps, seen.position_rev)
    heard = config.heartbeat_timeout_ns == 0 or seen.heartbeat_age_ns in range(-1, config.heartbeat_timeout_ns + 1)
    allowed = {
        10: not seen.bus_off,
        15: seen.foreign_frames == 0,
        12: seen.reboots == 0,
        9: seen.emergencies == 0,
        8: (seen.statusword // 8) % 2 == 0,
        14: not seen.not_operational,
        11: heard,
        18: seen.settings_changes == 0,
        13: seen.enabled or not was_enabled,
        1: all(-math.inf < number < math.inf for number in numbers),
        6: seen.feedback_age in range(config.feedback_missing_ticks),
        7: seen.status_age in range(config.status_missing_ticks),
        16: not (unheeded_s > UNHEEDED_S and seen.local_control),
        17: not (unheeded_s > UNHEEDED_S and not seen.local_control),
        2: -config.speed_limit_rps <= seen.velocity_rps <= config.speed_limit_rps,
        3: config.position_low_rev <= seen.position_rev and not seen.position_rev > config.position_high_rev,
        19: not reverses_s > config.following_error_s,
        4: not errs_s > config.following_error_s,
        5: not (config.i2t_trips and heat_a2s > capacity_a2s(config)),
    }
    for trip, fine in allowed.items():
        if not fine and (seen.wanted or trip in WITHOUT_TORQUE):
            return trip
    return 0


def capacity_a2s(config: env.EnvelopeConfig) -> float:
    """Heat that may gather: the current limit for i2t_time_s."""
    return (config.current_limit_a**2 - config.continuous_current_a**2) * config.i2t_time_s


def warmed(config: env.EnvelopeConfig, heat_a2s: float, current_a: float, time_s: float) -> float:
    """Heat after a current, never below the cold motor's."""
    squares = [amperes * amperes for amperes in (current_a, config.continuous_current_a)]
    after = heat_a2s + (squares[0] - squares[1]) * time_s
    return after if after > 0.0 else 0.0


def inside(value: float, bound: float) -> bool:
    return -bound <= value <= bound


def episode(before: tuple[float, float], seen: bool, step_s: float) -> tuple[float, float]:
    """(how long, how long the present pause is) of what ends when it pauses for half a period of 10 Hz."""
    lasts, pause = before[0] + step_s, 0.0 if seen else before[1] + step_s
    goes_on = seen or (before[0] > 0.0 and pause < PAUSE_S)
    return (lasts, pause) if goes_on else (0.0, 0.0)


def side_of(config: env.EnvelopeConfig, seen: env.EnvelopeInputs) -> float:
    """Which limit the command is at, whoever has it: -1, 1, or 0 for none."""
    free = -config.current_limit_a < seen.requested_a < config.current_limit_a
    if free and not seen.limited and (seen.statusword // 2048) % 2 == 0:
        return 0.0
    return math.copysign(1.0, seen.requested_a)


def clipped(value: float, low: float, high: float) -> float:
    return sorted((low, value, high))[1]


def expected(config: env.EnvelopeConfig, state: env.EnvelopeState, seen: env.EnvelopeInputs):
    """(command_a, limits, trip, state) of one step."""
    held_s = config.period_s * seen.skipped_ticks
    heat = warmed(config, state.i2t_a2s, state.last_command_a, held_s)
    step_s = held_s + config.period_s
    acts = seen.wanted and seen.closed_loop
    beyond = math.isfinite(seen.error_rps) and not inside(seen.error_rps, config.following_error_rps)
    beyond = beyond or math.isinf(seen.error_rps)
    errs = episode((state.following_s, state.followed_s), beyond, step_s) if acts else (0.0, 0.0)
    side = side_of(config, seen) if acts else 0.0
    reverses = {side, state.limited_side} == {-1.0, 1.0}
    turns = episode((state.reversing_s, state.steady_s), reverses, step_s) if acts else (0.0, 0.0)
    side = (side or state.limited_side) if acts else 0.0
    silent = seen.wanted and (seen.local_control or seen.ignores_target)
    unheeded = state.unheeded_s + held_s + config.period_s if silent else 0.0
    now = [lasts if pause == 0.0 else 0.0 for lasts, pause in (errs, turns)]  # nothing trips in a pause
    trip = expected_trip(config, heat, *now, state.was_enabled, unheeded, seen)
    command, limits = 0.0, 0
    if seen.wanted and trip == 0:
        hot = not config.i2t_trips and heat > capacity_a2s(config)
        bound = config.continuous_current_a if hot else config.current_limit_a
        wished = clipped(seen.requested_a, -bound, bound)
        step = config.slew_a_per_s * config.period_s
        slewed = clipped(wished, state.last_command_a - step, state.last_command_a + step)
        command = clipped(slewed, -config.current_limit_a, config.current_limit_a)
        limits = (
            2 * (wished != seen.requested_a)
            + 4 * (slewed != wished)
            + 8 * (hot and wished != seen.requested_a)
            + 16 * ((seen.statusword // 2048) % 2)
        )
    heat = warmed(config, heat, command, config.period_s)
    after = env.EnvelopeState(command, heat, errs[0], seen.wanted and seen.enabled, unheeded, errs[1], side, *turns)
    return command, limits, trip, after


def around(edge: float, ulps: int = 3) -> list[float]:
    """An edge, its nearest neighbours among the numbers on both sides, and others close to it."""
    found = {edge}
    for direction in (-math.inf, math.inf):
        near = edge
        for _ in range(ulps):
            near = math.nextafter(near, direction)
            found.add(near)
    for exponent in range(-12, 0):
        found |= {edge - 10.0**exponent, edge + 10.0**exponent}
    return sorted(found)


def sweep(edges: Iterable[float], count: int = 61) -> list[float]:
    """Dense at every edge, even between and beyond them, with what is no number."""
    edges = sorted(edges)
    span = max(edges[-1] - edges[0], 1.0)
    even = np.linspace(edges[0] - 0.5 * span, edges[-1] + 0.5 * span, count).tolist()
    values = set(itertools.chain(even, *(around(edge) for edge in edges)))
    return [*sorted(values), math.inf, -math.inf, math.nan, 0.0, -0.0, 1e300, -1e300, 5e-324]

"""Live set points: a velocity not known in advance, turned into a reference that is nevertheless known ahead.

A generator with bounds on acceleration and jerk runs ahead of the tick by as much as feed-forward reads ahead
(control/feedforward). So the reference, its previewed value and the value in the error come from one trajectory, as
with a profile. A new set point changes the trajectory from its newest sample on: it acts as many periods later as the
generator is ahead.

The generator goes from any velocity and acceleration to a constant velocity in the shortest time (Biagiotti and
Melchiorri, Trajectory Planning, 3.4, in velocity): jerk at its bound towards a peak acceleration, that acceleration for
a while if it is the bound, jerk at its bound back to zero. The ramp is replanned in each period from the present state,
so a set point can change at any time.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ..arrays import Floats
from ..jit import njit
from ..packing import flat_names, reader
from .feedforward import FeedforwardConfig, Reference

HISTORY = 1024  # samples of a trajectory that are kept, a power of two: more than twice the longest delay of a model
_KEPT = HISTORY - 1
ARRIVED_SHARE = 1e-5  # of a step: a ramp that would end this little later has arrived, or rounding would cost a period


class SetPoint(NamedTuple):
    """A set point, with the bounds of the motion towards it."""

    target_rps: float
    acceleration_rps2: float
    jerk_rps3: float
    hold_ticks: int  # duration, from the tick that takes it; 0: until the next set point
    after_rps: float  # the target after that
    after_acceleration_rps2: float
    low_rev: float  # the motion ends at standstill before these positions; infinite: no limit
    high_rev: float
    lag_s: float  # from the position that the feedback shows to the newest sample of the trajectory


SET_POINT_NAMES = flat_names(SetPoint)
SET_POINT_SIZE = len(SET_POINT_NAMES)
unpack_set_point = njit(reader(SetPoint, "unpack_set_point"))


class GeneratorState(NamedTuple):
    """State of the generator."""

    velocity_rps: float
    acceleration_rps2: float


class Ramp(NamedTuple):
    """The shortest ramp to a target: three phases of constant jerk, zero in the middle one."""

    direction: float  # of the acceleration in the middle: 1 or -1
    begin_s: float
    begin_jerk_rps3: float
    middle_s: float
    end_s: float


class LiveMotion(NamedTuple):
    """Memory of a motion by set points. Samples count from the tick in which it began."""

    number: int  # of the set point that was taken last
    start_tick: int  # -1: none runs
    taken_tick: int  # of the last set point
    head: int  # newest sample of the trajectory
    resting: int  # number of the newest samples that are zero for good
    blocked: int  # 1 or -1: the set point leads out of its window above or below, and is not followed
    generator: GeneratorState


@njit
def no_motion(number: int) -> LiveMotion:
    """No motion; the last one was by set point `number`."""
    return LiveMotion(number, -1, -1, -1, 0, 0, GeneratorState(0.0, 0.0))


@njit
def shortest_ramp(state: GeneratorState, target_rps: float, acceleration_rps2: float, jerk_rps3: float) -> Ramp:
    """The ramp from here to `target_rps` at zero acceleration. Bounds > 0; a state beyond them returns inside first.

    Velocity v, acceleration a, bounds A and J, in the direction in which v has to go once a is zero:
    dv = (p^2 - a^2) / 2J + p^2 / 2J with the peak p of the acceleration, or A for longer.
    """
    v, a, A, J = state.velocity_rps, state.acceleration_rps2, acceleration_rps2, jerk_rps3
    direction = 1.0 if target_rps >= v + a * abs(a) / (2.0 * J) else -1.0
    dv, a = direction * (target_rps - v), direction * a
    if a > A:
        middle_s = max(0.0, (dv - a * a / (2.0 * J)) / A)
        return Ramp(direction, (a - A) / J, -direction * J, middle_s, A / J)
    peak = math.sqrt(max(0.0, J * dv + 0.5 * a * a))
    middle_s = 0.0
    if peak > A:
        middle_s = max(0.0, (dv - (A * A - 0.5 * a * a) / J) / A)
        peak = A
    return Ramp(direction, max(0.0, peak - a) / J, direction * J, middle_s, peak / J)


@njit
def ramp_s(ramp: Ramp) -> float:
    """Duration of a ramp, s."""
    return ramp.begin_s + ramp.middle_s + ramp.end_s


@njit
def _moved(state: GeneratorState, jerk_rps3: float, time_s: float) -> GeneratorState:
    velocity_rps = state.velocity_rps + time_s * (state.acceleration_rps2 + 0.5 * jerk_rps3 * time_s)
    return GeneratorState(velocity_rps, state.acceleration_rps2 + jerk_rps3 * time_s)


@njit
def set_point_step(
    state: GeneratorState, target_rps: float, acceleration_rps2: float, jerk_rps3: float, time_s: float
) -> GeneratorState:
    """State of the generator after `time_s`. It arrives exactly, and stays."""
    ramp = shortest_ramp(state, target_rps, acceleration_rps2, jerk_rps3)
    left_s = time_s
    if left_s * (1.0 + ARRIVED_SHARE) >= ramp_s(ramp):
        return GeneratorState(target_rps, 0.0)
    state = _moved(state, ramp.begin_jerk_rps3, min(left_s, ramp.begin_s))
    left_s -= ramp.begin_s
    if left_s > 0.0:
        if ramp.middle_s > 0.0:  # no rounding of the peak
            state = GeneratorState(state.velocity_rps, ramp.direction * acceleration_rps2)
        state = _moved(state, 0.0, min(left_s, ramp.middle_s))
        left_s -= ramp.middle_s
    if left_s > 0.0:
        state = _moved(state, -ramp.direction * jerk_rps3, left_s)
    return state


@njit
def _way_rev(velocity_rps: float, acceleration_rps2: float, jerk_rps3: float, time_s: float) -> float:
    return time_s * (velocity_rps + time_s * (0.5 * acceleration_rps2 + jerk_rps3 * time_s / 6.0))


@njit
def stopping_rev(state: GeneratorState, acceleration_rps2: float, jerk_rps3: float) -> float:
    """Travel of the shortest ramp to standstill, rev."""
    ramp = shortest_ramp(state, 0.0, acceleration_rps2, jerk_rps3)
    way_rev = _way_rev(state.velocity_rps, state.acceleration_rps2, ramp.begin_jerk_rps3, ramp.begin_s)
    state = _moved(state, ramp.begin_jerk_rps3, ramp.begin_s)
    way_rev += _way_rev(state.velocity_rps, state.acceleration_rps2, 0.0, ramp.middle_s)
    state = _moved(state, 0.0, ramp.middle_s)
    end_jerk_rps3 = -ramp.direction * jerk_rps3
    return way_rev + _way_rev(state.velocity_rps, state.acceleration_rps2, end_jerk_rps3, ramp.end_s)


@njit
def leads_out(
    set_point: SetPoint, state: GeneratorState, following: GeneratorState, position_rev: float, velocity_rps: float,
    time_s: float,
) -> int:  # fmt: skip
    """1 or -1, by side, if the axis could not stop inside the window after a step to the state `following`; else 0.

    An axis that is faster than its reference (`velocity_rps` is the feedback) needs more travel.
    """
    outwards = 1 if following.velocity_rps > 0.0 else -1
    edge_rev = set_point.high_rev if outwards == 1 else set_point.low_rev
    if math.isinf(edge_rev):
        return 0
    excess_rps = max(0.0, outwards * (velocity_rps - state.velocity_rps)) * outwards
    faster = GeneratorState(following.velocity_rps + excess_rps, following.acceleration_rps2)
    way_rev = _way_rev(state.velocity_rps + excess_rps, -state.acceleration_rps2, 0.0, set_point.lag_s)
    way_rev += 0.5 * (state.velocity_rps + following.velocity_rps) * time_s
    way_rev += stopping_rev(faster, set_point.after_acceleration_rps2, set_point.jerk_rps3)
    return outwards if outwards * way_rev > 0.0 and outwards * (position_rev + way_rev - edge_rev) > 0.0 else 0


@njit
def read_trajectory(samples: Any, position: float) -> float:
    """Samples of a trajectory at a fractional position, as `feedforward.read_samples` for a profile."""
    below = math.floor(position)
    share = position - below
    first = samples[below & _KEPT] if below >= 0 else 0.0
    if share == 0.0:
        return float(first)
    second = samples[(below + 1) & _KEPT] if below >= -1 else 0.0
    return float(first + share * (second - first))


@njit
def preview_ticks(config: FeedforwardConfig) -> int:
    """Periods by which the generator is ahead of the tick, which is how much later a set point acts."""
    return max(0, math.ceil(config.ahead_ticks))


@njit
def has_lapsed(set_point: SetPoint, motion: LiveMotion, tick: int) -> bool:
    """Whether its duration has ended without a renewal."""
    return set_point.hold_ticks > 0 and tick - motion.taken_tick >= set_point.hold_ticks


@njit
def begin_motion(trajectory: Floats, number: int, tick: int) -> LiveMotion:
    """Start of a motion from standstill: the earlier trajectory is cleared."""
    trajectory[:] = 0.0
    return LiveMotion(number, tick, tick, -1, 0, 0, GeneratorState(0.0, 0.0))


@njit
def with_set_point(motion: LiveMotion, number: int, tick: int) -> LiveMotion:
    """Another set point in the same motion, even after a standstill."""
    return LiveMotion(number, motion.start_tick, tick, motion.head, 0, motion.blocked, motion.generator)


@njit
def advance_motion(
    config: FeedforwardConfig, set_point: SetPoint, motion: LiveMotion, trajectory: Floats, tick: int,
    position_rev: float, velocity_rps: float, period_s: float,
) -> tuple[LiveMotion, float, Reference]:  # fmt: skip
    """The motion at a tick: (memory, target in force, reference). `trajectory` (2, HISTORY): velocity, acceleration.

    Skipped periods count as samples, as they do for a profile. A way that would leave the window is
    braked to standstill before its edge; it stays there until a set point leads back.
    """
    target_rps, acceleration_rps2 = set_point.target_rps, set_point.acceleration_rps2
    if has_lapsed(set_point, motion, tick):
        target_rps, acceleration_rps2 = set_point.after_rps, set_point.after_acceleration_rps2
    sample = tick - motion.start_tick
    last = sample + preview_ticks(config)
    head, resting, state = motion.head, motion.resting, motion.generator
    blocked = motion.blocked if target_rps * motion.blocked > 0.0 else 0
    if blocked != 0:
        target_rps, acceleration_rps2 = 0.0, set_point.after_acceleration_rps2
    if head < 0:  # the samples until it can act are already determined: standstill
        head = last - 1
    while head < last:
        samples = max(1, last - head - HISTORY)  # samples that can no longer be read are skipped in one step
        time_s = samples * period_s
        following = set_point_step(state, target_rps, acceleration_rps2, set_point.jerk_rps3, time_s)
        side = leads_out(set_point, state, following, position_rev, velocity_rps, time_s)
        if side != 0:
            following = set_point_step(
                state, 0.0, set_point.after_acceleration_rps2, set_point.jerk_rps3, time_s
            )  # fmt: skip
            if target_rps * side > 0.0:
                blocked, target_rps, acceleration_rps2 = side, 0.0, set_point.after_acceleration_rps2
        state = following
        head += samples
        trajectory[0, head & _KEPT] = state.velocity_rps
        trajectory[1, head & _KEPT] = state.acceleration_rps2
        rests = target_rps == 0.0 and state.velocity_rps == 0.0 and state.acceleration_rps2 == 0.0
        resting = resting + samples if rests else 0
    reference = Reference(
        read_trajectory(trajectory[0], float(sample)),
        read_trajectory(trajectory[1], float(sample)),
        read_trajectory(trajectory[0], sample + config.ahead_ticks),
        read_trajectory(trajectory[1], sample + config.ahead_ticks),
        read_trajectory(trajectory[0], sample - config.behind_ticks),
    )
    moved = LiveMotion(motion.number, motion.start_tick, motion.taken_tick, head, resting, blocked, state)
    return moved, target_rps, reference


@njit
def has_ended(config: FeedforwardConfig, motion: LiveMotion, tail_ticks: int) -> bool:
    """Whether all readable samples are zero, and have been for `tail_ticks`."""
    return motion.resting > preview_ticks(config) + math.ceil(config.behind_ticks) + tail_ticks

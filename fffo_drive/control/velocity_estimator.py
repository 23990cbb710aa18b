"""Velocity from position and torque: a steady-state Kalman filter on position, velocity and disturbance torque.

    d/dt position = velocity,    J d/dt velocity = Kt i - disturbance,    d/dt disturbance = white noise

The drive's own velocity comes from a tracking loop and lags behind its position; the estimate does not, because the
commanded torque is known. What is not known (friction, load, an error of J) is the disturbance. The commands are those
on the bus, delayed by the delay from command to torque, so that each acts on the position in which it shows.

With a single noise ratio the poles are those of a Butterworth filter (R. E. Kalman and R. S. Bucy, 1961; closed form in
`steady_state_gains`): one bandwidth sets everything. The filter is computed when a file is read, never in the tick.

Until the filter has settled, and when it is not trusted, the error uses the drive's own velocity; the row says which.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats
from ..jit import njit
from ..units import NS_PER_S

COMMANDS = 1024  # last commands that are kept, a power of two: more than twice the longest delay of a model
_KEPT = COMMANDS - 1
BRIDGED_TICKS = 4  # prediction without feedback for this long; 2 ms at 2 kHz, the age of a drive's own velocity
SETTLING_TIMES = 8.0  # of 1 / (2 pi bandwidth): the slowest pair, at half of it, has decayed to exp(-4), 2 %
JUMP_PERIODS = 4.0  # at the speed limit: a larger deviation of the position was not motion


class VelocityEstimatorConfig(NamedTuple):
    """Constants of the filter."""

    used: bool  # False: the error uses the drive's own velocity, and nothing is estimated
    position_gain: float  # rev per rev of innovation, in a period
    velocity_gain_per_s: float
    disturbance_gain_nm_per_rev: float
    inertia_nm_s2_per_rev: float
    torque_constant_nm_per_a: float
    period_s: float
    delay_periods: int  # from a command to the torque that the position shows, whole periods
    delay_share: float  # ... and the rest, in periods
    jump_rev: float  # of the position against the prediction
    disagreement_rps: float  # of estimate and drive
    settling_ticks: int


DRIVE_VELOCITY = VelocityEstimatorConfig(False, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0, 0.0, 0.0, 0.0, 0)


class VelocityEstimatorState(NamedTuple):
    """Memory of the filter, in addition to the last commands."""

    position_rev: float
    velocity_rps: float
    disturbance_nm: float  # torque lost between motor torque and acceleration
    tick: int  # of the last step; -1: not started
    first_tick: int  # of the first one
    fresh_tick: int  # of the last feedback
    woke_ns: int  # of the last step


class VelocityEstimatorTerms(NamedTuple):
    """Results of one step, for the row."""

    estimated_rps: float  # 0 without an estimate
    disturbance_nm: float
    followed_rps: float  # velocity in the error
    estimated: bool  # whether that is the estimate


class Measured(NamedTuple):
    """Inputs of the filter in one tick."""

    tick: int
    woke_ns: int  # SYNC follows at once: the drive latched the position then
    fresh: bool  # the feedback answers this tick's SYNC
    position_rev: float  # multi-turn
    velocity_rps: float  # the drive's own


@njit
def estimator_at_rest() -> VelocityEstimatorState:
    """Memory before the first step, and whenever the velocity loop is open."""
    return VelocityEstimatorState(0.0, 0.0, 0.0, -1, -1, -1, 0)


@njit
def keep_command(commands_a: Any, tick: int, current_a: float) -> None:
    """Store the command of a tick as sent. `commands_a` (COMMANDS,)."""
    commands_a[tick & _KEPT] = current_a


@njit
def _command_of(commands_a: Any, state: VelocityEstimatorState, tick: int) -> float:
    """The command of a tick; 0 before the filter began."""
    return float(commands_a[tick & _KEPT]) if tick >= state.first_tick else 0.0


@njit
def _hold_skipped(commands_a: Any, state: VelocityEstimatorState, tick: int) -> None:
    """Fill in skipped periods: without SYNC the drive held its command, and took the last one after them."""
    last_a, held_a = _command_of(commands_a, state, state.tick), _command_of(commands_a, state, state.tick - 1)
    for k in range(state.tick, tick - 1):
        commands_a[k & _KEPT] = held_a
    commands_a[(tick - 1) & _KEPT] = last_a


@njit
def _predicted(
    config: VelocityEstimatorConfig, state: VelocityEstimatorState, commands_a: Any, measured: Measured
) -> VelocityEstimatorState:
    """The state predicted at this SYNC from the torque since the last one."""
    periods = measured.tick - state.tick
    # elapsed time, not the period: at 10 rps, 10 us of lateness are 3 counts of 15 bits
    step_s = (measured.woke_ns - state.woke_ns) / NS_PER_S / periods
    position_rev, velocity_rps = state.position_rev, state.velocity_rps
    for k in range(state.tick, measured.tick):
        newest = k - config.delay_periods
        current_a = (1.0 - config.delay_share) * _command_of(commands_a, state, newest)
        current_a += config.delay_share * _command_of(commands_a, state, newest - 1)
        torque_nm = config.torque_constant_nm_per_a * current_a - state.disturbance_nm
        gained_rps = step_s * torque_nm / config.inertia_nm_s2_per_rev
        position_rev += step_s * (velocity_rps + 0.5 * gained_rps)
        velocity_rps += gained_rps
    return VelocityEstimatorState(
        position_rev, velocity_rps, state.disturbance_nm, measured.tick, state.first_tick, state.fresh_tick,
        measured.woke_ns,
    )  # fmt: skip


@njit
def _corrected(
    config: VelocityEstimatorConfig, state: VelocityEstimatorState, innovation_rev: float
) -> VelocityEstimatorState:
    return VelocityEstimatorState(
        state.position_rev + config.position_gain * innovation_rev,
        state.velocity_rps + config.velocity_gain_per_s * innovation_rev,
        state.disturbance_nm - config.disturbance_gain_nm_per_rev * innovation_rev,
        state.tick,
        state.first_tick,
        state.tick,
        state.woke_ns,
    )


@njit
def _begun(measured: Measured) -> VelocityEstimatorState:
    """A filter that starts at the drive's position and velocity; not started without feedback."""
    if not (measured.fresh and math.isfinite(measured.position_rev) and math.isfinite(measured.velocity_rps)):
        return estimator_at_rest()
    tick = measured.tick
    return VelocityEstimatorState(measured.position_rev, measured.velocity_rps, 0.0, tick, tick, tick, measured.woke_ns)


@njit
def _trusted(config: VelocityEstimatorConfig, state: VelocityEstimatorState, drive_rps: float) -> bool:
    """Whether the estimate is finite and close to the drive's velocity: a frozen position is not trusted."""
    if not (math.isfinite(state.position_rev) and math.isfinite(state.disturbance_nm)):
        return False
    return abs(state.velocity_rps - drive_rps) <= config.disagreement_rps  # not so for NaN


@njit
def velocity_estimator_step(
    config: VelocityEstimatorConfig, state: VelocityEstimatorState, commands_a: Any, measured: Measured
) -> tuple[VelocityEstimatorTerms, VelocityEstimatorState]:
    """One tick: predict with the torque, correct with the position. `commands_a` (COMMANDS,): `keep_command`.

    The filter restarts after a jump of the position, more than BRIDGED_TICKS without feedback, a number that is
    not finite, or an estimate that the drive's velocity contradicts; until it has settled the drive's is followed.
    """
    if not config.used:
        return VelocityEstimatorTerms(0.0, 0.0, measured.velocity_rps, False), estimator_at_rest()
    without = measured.tick - state.fresh_tick - (1 if measured.fresh else 0)  # ticks without feedback
    if state.tick < 0 or without > BRIDGED_TICKS:
        state = _begun(measured)
    else:
        if measured.tick - state.tick > 1:
            _hold_skipped(commands_a, state, measured.tick)
        state = _predicted(config, state, commands_a, measured)
        if measured.fresh:
            innovation_rev = measured.position_rev - state.position_rev
            jumped = not abs(innovation_rev) <= config.jump_rev  # also where it is not a number
            state = _begun(measured) if jumped else _corrected(config, state, innovation_rev)
        if state.tick >= 0 and not _trusted(config, state, measured.velocity_rps):
            state = _begun(measured)
    if state.tick < 0:
        return VelocityEstimatorTerms(0.0, 0.0, measured.velocity_rps, False), state
    settled = state.tick - state.first_tick >= config.settling_ticks
    followed_rps = state.velocity_rps if settled else measured.velocity_rps
    return VelocityEstimatorTerms(state.velocity_rps, state.disturbance_nm, followed_rps, settled), state


# ---- design, when a file is read


class EstimatorGains(NamedTuple):
    """Steady-state gains of the filter, per rev of innovation."""

    position: float
    velocity_per_s: float
    disturbance_nm: float


def steady_state_gains(bandwidth_hz: float, inertia_nm_s2_per_rev: float, period_s: float) -> EstimatorGains:
    """Kalman gains of the sampled filter, from the discrete Riccati equation.

    w = 2 pi bandwidth is (q / (J^2 r T))^(1/6), with the disturbance's density q in Nm^2/s and the position's variance
    r in rev^2 per sample. For w T -> 0 the poles are Butterworth, s^3 + 2 w s^2 + 2 w^2 s + w^3, and the gains are
    2 w T, 2 w^2 T and J w^3 T. The Riccati equation is solved in periods, where it is well conditioned.
    """
    from scipy.linalg import solve_discrete_are  # loads slowly

    ratio = (2.0 * math.pi * bandwidth_hz * period_s) ** 6
    transition = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    noise = ratio * np.array([[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]])
    seen = np.array([[1.0], [0.0], [0.0]])
    covariance = solve_discrete_are(transition.T, seen, noise, np.eye(1))
    position, velocity, acceleration = covariance[:, 0] / (covariance[0, 0] + 1.0)
    return EstimatorGains(
        float(position), float(velocity) / period_s, float(acceleration) * inertia_nm_s2_per_rev / period_s**2
    )


def estimator_config(
    bandwidth_hz: float, inertia_nm_s2_per_rev: float, torque_constant_nm_per_a: float, torque_delay_s: float,
    period_s: float, speed_limit_rps: float, disagreement_rps: float,
) -> VelocityEstimatorConfig:  # fmt: skip
    """The filter's constants. `torque_delay_s`: from a command to the torque that the position shows, without hold."""
    gains = steady_state_gains(bandwidth_hz, inertia_nm_s2_per_rev, period_s)
    delay_periods = math.floor(torque_delay_s / period_s)
    return VelocityEstimatorConfig(
        True,
        *gains,
        inertia_nm_s2_per_rev,
        torque_constant_nm_per_a,
        period_s,
        delay_periods,
        torque_delay_s / period_s - delay_periods,
        JUMP_PERIODS * speed_limit_rps * period_s,
        disagreement_rps,
        math.ceil(SETTLING_TIMES / (2.0 * math.pi * bandwidth_hz * period_s)),
    )


def velocity_noise_rps(bandwidth_hz: float, position_noise_rev: float, period_s: float) -> float:
    """Standard deviation of the estimate from white noise of the position: sqrt(3/2 w^3 T) times that (w T small)."""
    omega = 2.0 * math.pi * bandwidth_hz
    return math.sqrt(1.5 * omega**3 * period_s) * position_noise_rev


class EstimatorResponse(NamedTuple):
    """The estimate as a linear function of the inputs of the filter; both (n,)."""

    of_position_per_s: npt.NDArray[np.complexfloating[Any, Any]]  # rps per rev
    of_command_rps_per_a: npt.NDArray[np.complexfloating[Any, Any]]


def estimator_response(config: VelocityEstimatorConfig, omega: Floats) -> EstimatorResponse:
    """Frequency response of the filter at omega (n,) rad/s, up to half the rate."""
    period_s, inertia = config.period_s, config.inertia_nm_s2_per_rev
    backward = np.exp(-1j * omega * period_s)
    gains = np.array([config.position_gain, config.velocity_gain_per_s, -config.disturbance_gain_nm_per_rev])
    halved = 0.5 * period_s * period_s / inertia
    transition = np.array([[1.0, period_s, -halved], [0.0, 1.0, -period_s / inertia], [0.0, 0.0, 1.0]])
    kept = np.eye(3) - np.outer(gains, [1.0, 0.0, 0.0])
    torque = kept @ np.array([halved, period_s / inertia, 0.0])
    # x(k) = kept (transition x(k-1) + torque(k-1)) + gains position(k)
    system = np.eye(3) - backward[:, None, None] * (kept @ transition)
    solved = np.linalg.solve(system, np.stack((gains, torque), axis=1)[None].astype(complex))[:, 1, :]
    late = backward**config.delay_periods * (1.0 - config.delay_share + config.delay_share * backward)
    return EstimatorResponse(solved[:, 0], solved[:, 1] * backward * late * config.torque_constant_nm_per_a)

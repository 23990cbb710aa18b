"""PI with a reduced-order friction observer modelled on Ruderman's (arXiv 2504.21316, Control Engineering Practice; its
predecessor arXiv 2305.15870, IFAC World Congress 2023).

In the publication: the displacement x is the only measurement. A reduced-order Luenberger observer estimates velocity w
and friction torque F, on a system matrix that varies with the tangent stiffness k of the friction, k = 0 in steady
sliding. Its eigenvalues are real and negative throughout. The slowest one is assigned. F is added to a standard
feedback controller:

    J dw/dt = Kt i(t - Td) - F + J l1 (dx/dt - w),    dF/dt = k w + l2 (dx/dt - w)

Its equation of k and its rule for the gains were not available; both are this project's. k is the
present slope of the hysteresis of the 2SEP model, fitted as for the other laws, driven by the estimated velocity. k is
at most kmax = (Fc + Fs) K + 2 B, after a reversal from breakaway, and never negative: where friction falls after
breakaway, k = 0.

With l1 = p + q and l2 = -J p q the eigenvalues are the roots of s^2 + (p + q) s + p q + k / J: -p and -q in sliding,
and real up to kmax with q = p + 2 sqrt(kmax / J). -p is then the slowest of all. p is chosen for the margins
of PI+FFFO+, as the bandwidth of the disturbance observers is (design.py).

One step is exact for a k and a torque that are constant over a period: the axis moves as inertia on a spring, and the
gains are such that an error of the estimate changes by exp(eigenvalue h).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ...arrays import Floats
from ...control.feedforward import Reference, read_samples
from ...jit import njit
from ...model.friction import FrictionConfig, FrictionState, friction_step
from ...packing import reader
from .constants import OWN, PeerConfig, command_for, filtered_error, remember

STARTED = OWN  # 1 once a position is known
POSITION_REV = OWN + 1  # of the last period
VELOCITY_RPS = OWN + 2  # estimate
FRICTION_NM = OWN + 3  # estimate
MODEL = OWN + 4  # FrictionState of the friction model, in its order
HISTORY = MODEL + len(FrictionState._fields)  # commands, the last one first


class LuenbergerLoop(NamedTuple):
    """The law."""

    peer: PeerConfig
    model: FrictionConfig
    inertia_nm_s2_per_rev: float  # of the observer
    slow_rad_per_s: float  # p
    fast_rad_per_s: float  # q
    delay_ticks: float  # from command to position, hold included


@njit
def stiffest_nm_per_rev(model: FrictionConfig) -> float:
    """kmax: just after a reversal from breakaway."""
    return (model.coulomb_nm + model.static_nm) * model.stiffness_per_rev + 2.0 * model.attraction_nm_per_rev


def further_pole_rad_per_s(model: FrictionConfig, inertia_nm_s2_per_rev: float) -> float:
    """q - p, the smallest with which the eigenvalues are real up to kmax."""
    return 2.0 * math.sqrt(stiffest_nm_per_rev(model) / inertia_nm_s2_per_rev)


@njit
def tangent_stiffness(model: FrictionConfig, before: FrictionState, after: FrictionState, moved_rev: float) -> float:
    """k in Nm/rev, from 0 to kmax: mean slope of the model's friction over a distance `moved_rev`."""
    if moved_rev == 0.0:
        return 0.0
    return min(max(0.0, (after.torque_nm - before.torque_nm) / moved_rev), stiffest_nm_per_rev(model))


@njit
def eigenvalues(
    slow_rad_per_s: float, fast_rad_per_s: float, inertia_nm_s2_per_rev: float, stiffness: float
) -> tuple[float, float]:
    """Both eigenvalues (1/s) of the estimation error at a tangent stiffness (Nm/rev) up to kmax."""
    middle = 0.5 * (slow_rad_per_s + fast_rad_per_s)
    half = 0.5 * (fast_rad_per_s - slow_rad_per_s)
    apart = math.sqrt(max(0.0, half * half - stiffness / inertia_nm_s2_per_rev))
    return apart - middle, -apart - middle


@njit
def _sine_over(angle: float) -> float:
    return math.sin(angle) / angle if angle > 0.0 else 1.0


@njit
def estimate_after(
    velocity_rps: float, friction_nm: float, moved_rev: float, torque_nm: float, stiffness: float,
    inertia_nm_s2_per_rev: float, slow_rad_per_s: float, fast_rad_per_s: float, period_s: float,
) -> tuple[float, float]:  # fmt: skip
    """Velocity (rps) and friction torque (Nm) after a period in which the position moved by `moved_rev`.

    `torque_nm`: of the motor, constant over the period, as is the tangent stiffness (Nm/rev).
    """
    first, second = eigenvalues(slow_rad_per_s, fast_rad_per_s, inertia_nm_s2_per_rev, stiffness)
    first, second = math.exp(first * period_s), math.exp(second * period_s)
    # without an error: inertia on a spring, oscillating about the point where friction equals the torque
    turn = math.sqrt(stiffness / inertia_nm_s2_per_rev) * period_s
    cosine = math.cos(turn)
    per_velocity_s = period_s * _sine_over(turn)
    per_torque = 0.5 * (period_s * _sine_over(0.5 * turn)) ** 2 / inertia_nm_s2_per_rev  # rev/Nm
    excess_nm = friction_nm - torque_nm
    unexpected_rev = moved_rev - per_velocity_s * velocity_rps + per_torque * excess_nm
    after_rps = cosine * velocity_rps - per_velocity_s / inertia_nm_s2_per_rev * excess_nm
    after_nm = torque_nm + cosine * excess_nm + stiffness * per_velocity_s * velocity_rps
    # gains for which the error's transition matrix over a period has the eigenvalues `first` and `second`
    product, total = first * second, first + second
    gain_per_s = (1.0 + 2.0 * cosine - product - total) / (2.0 * per_velocity_s)
    gain_nm_per_rev = (1.0 - 2.0 * cosine + total - product) / (2.0 * per_torque)
    return after_rps + gain_per_s * unexpected_rev, after_nm + gain_nm_per_rev * unexpected_rev


unpack_luenberger = njit(reader(LuenbergerLoop, "unpack_luenberger"))


@njit
def observe(config: LuenbergerLoop, memory: Floats, position_rev: float) -> float:
    """The friction torque (Nm) estimated with the position of this period."""
    peer, model = config.peer, config.model
    if memory[STARTED] == 0.0:
        memory[STARTED], memory[POSITION_REV] = 1.0, position_rev
    history = memory[HISTORY:]
    # the last period's mean torque: half a period older than its end, as in the disturbance observer
    torque_nm = peer.torque_constant_nm_per_a * read_samples(history, history.size, config.delay_ticks - 0.5)
    velocity_rps = memory[VELOCITY_RPS]
    before = FrictionState(memory[MODEL], memory[MODEL + 1], memory[MODEL + 2], memory[MODEL + 3])
    after = friction_step(model, before, velocity_rps, 0.0, peer.period_s)
    memory[MODEL], memory[MODEL + 1], memory[MODEL + 2], memory[MODEL + 3] = after
    memory[VELOCITY_RPS], memory[FRICTION_NM] = estimate_after(
        velocity_rps, memory[FRICTION_NM], position_rev - memory[POSITION_REV], torque_nm,
        tangent_stiffness(model, before, after, velocity_rps * peer.period_s), config.inertia_nm_s2_per_rev,
        config.slow_rad_per_s, config.fast_rad_per_s, peer.period_s,
    )  # fmt: skip
    memory[POSITION_REV] = position_rev
    return float(memory[FRICTION_NM])


@njit
def luenberger_step(
    parameters: Floats, memory: Floats, reference: Reference, velocity_rps: float, position_rev: float
) -> float:
    """The command (A) of one period."""
    config = unpack_luenberger(parameters)
    error_rps = filtered_error(config.peer, memory, reference, velocity_rps)
    friction_nm = observe(config, memory, position_rev)
    command_a = command_for(config.peer, memory, reference, error_rps, friction_nm)
    remember(memory, HISTORY, command_a)
    return command_a

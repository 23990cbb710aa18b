"""The axis as one step: J dw/dt = u(t - Td) - F(w) (15), with F the 2SEP friction; and its simulation over a record.

The step is the leapfrog (half a kick, friction over the drift, half a kick): second order, and without the energy gain
that an explicit step has on the presliding spring. Inertia in Nm s^2/rev (units.inertia_nm_s2_per_rev), torque in Nm.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..jit import njit
from .friction import FrictionConfig, FrictionState, friction_step


class AxisConfig(NamedTuple):
    """Constants of the axis."""

    inertia_nm_s2_per_rev: float
    torque_constant_nm_per_a: float
    delay_s: float  # Td: command to torque, on top of the hold of a sampled command
    friction: FrictionConfig


class AxisState(NamedTuple):
    """Memory of the axis."""

    velocity_rps: float
    position_rev: float
    friction: FrictionState


@njit
def axis_step(config: AxisConfig, state: AxisState, torque_nm: float, period_s: float) -> AxisState:
    """The axis after `period_s` under a constant motor torque."""
    half_kick = 0.5 * period_s / config.inertia_nm_s2_per_rev
    drift_rps = state.velocity_rps + half_kick * (torque_nm - state.friction.torque_nm)
    friction = friction_step(config.friction, state.friction, drift_rps, 0.0, period_s)
    velocity_rps = drift_rps + half_kick * (torque_nm - friction.torque_nm)
    return AxisState(velocity_rps, state.position_rev + drift_rps * period_s, friction)


@njit
def held_command(command: Floats, time_in_samples: float) -> float:
    """A sampled command, held until the next sample, at a time counted in samples. Before the first sample: 0."""
    index = math.floor(time_in_samples)
    if index < 0:
        return 0.0
    return float(command[min(int(index), command.size - 1)])


@njit
def mean_held_command(command: Floats, begin: float, end: float) -> float:
    """Mean of the held command between two times in samples, at most one sample apart: exact for any delay."""
    edge = math.floor(begin) + 1.0
    first = held_command(command, begin)
    if edge >= end:
        return first
    second = held_command(command, edge)
    return (first * (edge - begin) + second * (end - edge)) / (end - begin)


@njit
def simulate_into(
    config: AxisConfig, state: AxisState, current_a: Floats, period_s: float, substeps: int, output: Any
) -> AxisState:
    """Run the axis over a sampled current command (held), writing columns velocity, position, friction torque.

    `current_a` (n,), `output` (n, 3): row k is the state at the instant of sample k, before command k acts.
    Returns the state at the end of the record.
    """
    step_s = period_s / substeps
    delay_samples = config.delay_s / period_s
    for k in range(current_a.size):
        output[k, 0] = state.velocity_rps
        output[k, 1] = state.position_rev
        output[k, 2] = state.friction.torque_nm
        for j in range(substeps):
            begin = k + j / substeps - delay_samples
            current = mean_held_command(current_a, begin, begin + 1.0 / substeps)
            state = axis_step(config, state, config.torque_constant_nm_per_a * current, step_s)
    return state


def simulate(
    config: AxisConfig, state: AxisState, current_a: Floats, period_s: float, substeps: int = 4
) -> tuple[Floats, AxisState]:
    """`simulate_into` with its own output: (n, 3) columns velocity_rps, position_rev, friction_nm; final state."""
    output = np.empty((current_a.size, 3))
    end = simulate_into(config, state, np.ascontiguousarray(current_a, dtype=np.float64), period_s, substeps, output)
    return output, end

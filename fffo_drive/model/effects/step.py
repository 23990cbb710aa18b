"""The axis with effects as one step: J dw/dt = u(t - Td) - F(w) - E, and its simulation over a record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...jit import njit
from ..axis import AxisConfig, AxisState, mean_held_command
from ..friction import friction_step
from . import slots as s
from .slots import AxisFacts, Floats
from .table import EffectTable, Term, effect_table, effects_step


@njit
def loaded_step(
    config: AxisConfig, table: EffectTable, state: AxisState, current_a: float, offset_nm: float
) -> AxisState:
    """The axis after one step of the table under a constant current. `offset_nm` opposes the motor's torque.

    The leapfrog of `axis_step`; effects act at the middle of the step with the speed of the drift, and are in the
    table's signals afterwards. The first half-kick uses the effects of the previous step and is corrected at the end.
    """
    signals = table.signals
    step_s = signals[s.STEP_S]
    half_kick = 0.5 * step_s / config.inertia_nm_s2_per_rev
    torque_nm = config.torque_constant_nm_per_a * current_a - offset_nm
    before_nm = state.friction.torque_nm
    load_nm = signals[s.LOAD_NM]
    drift_rps = state.velocity_rps + half_kick * (torque_nm - before_nm - load_nm)
    friction = friction_step(config.friction, state.friction, drift_rps, 0.0, step_s)
    signals[s.VELOCITY_RPS] = drift_rps
    signals[s.ACCELERATION_RPS2] = (torque_nm - friction.torque_nm - load_nm) / config.inertia_nm_s2_per_rev
    signals[s.MOTOR_ANGLE_REV] = state.position_rev + 0.5 * drift_rps * step_s
    position_rev = state.position_rev + drift_rps * step_s
    signals[s.SENSOR_ANGLE_REV] = position_rev
    signals[s.CURRENT_A] = current_a
    signals[s.FRICTION_NM] = friction.torque_nm
    signals[s.TRAVEL_REV] = friction.travel_rev
    signals[s.DIRECTION] = friction.direction
    effects_step(table)
    signals[s.TIME_S] += step_s
    whole_nm = 2.0 * torque_nm - before_nm - friction.torque_nm - 2.0 * signals[s.LOAD_NM]
    return AxisState(state.velocity_rps + half_kick * whole_nm, position_rev, friction)


@njit
def loaded_simulate_into(
    config: AxisConfig, table: EffectTable, state: AxisState, current_a: Floats, period_s: float, substeps: int,
    output: Any,
) -> AxisState:  # fmt: skip
    """Run over a sampled current command (held). `output` (n, 5): velocity, position, friction, load, sensor's error.

    Row k is the state at the instant of sample k; load and error are of the step before. The table's step is
    `period_s / substeps`.
    """
    delay_samples = config.delay_s / period_s
    signals = table.signals
    for k in range(current_a.size):
        output[k, 0] = state.velocity_rps
        output[k, 1] = state.position_rev
        output[k, 2] = state.friction.torque_nm
        output[k, 3] = signals[s.LOAD_NM]
        output[k, 4] = signals[s.SENSOR_REV]
        for j in range(substeps):
            begin = k + j / substeps - delay_samples
            held_a = mean_held_command(current_a, begin, begin + 1.0 / substeps)
            state = loaded_step(config, table, state, held_a, 0.0)
    return state


def simulate_with_effects(
    config: AxisConfig, terms: Sequence[Term], state: AxisState, current_a: Floats, period_s: float, substeps: int = 4,
    facts: AxisFacts | None = None,
) -> tuple[Floats, AxisState]:  # fmt: skip
    """`loaded_simulate_into` with its own table and output: (n, 5), and the final state."""
    table = effect_table(terms, config, period_s / substeps, facts)
    output = np.empty((current_a.size, 5))
    command = np.ascontiguousarray(current_a, dtype=np.float64)
    end = loaded_simulate_into(config, table, state, command, period_s, substeps, output)
    return output, end

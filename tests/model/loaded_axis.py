"""The axis with effects over a whole record, as the model sees it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fffo_drive.arrays import Floats
from fffo_drive.jit import njit
from fffo_drive.model.axis import AxisConfig, AxisState, mean_held_command
from fffo_drive.model.effects import slots as s
from fffo_drive.model.effects.slots import AxisFacts
from fffo_drive.model.effects.step import loaded_step
from fffo_drive.model.effects.table import EffectTable, Term, effect_table


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

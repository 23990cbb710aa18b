"""The machine as the drive's firmware sees it, simulated: follows the node's clock in sub-steps of 1/22 kHz.

Of a pause of the process longer than `LONGEST_CATCH_UP_NS` the rest is not simulated: the plant stands still.
"""

from __future__ import annotations

import math

from ....jit import njit
from .. import state as at
from ..pack import new_state, plant_parameters
from ..parameters import PlantConfig
from ..plant import plant_advance, substeps_due
from ..resolver import plant_latch
from ..state import Floats, Integers, PlantParameters, PlantState

LONGEST_CATCH_UP_NS = 1_000_000_000
DISCHARGE_S = 0.02  # time constant of the DC link without its supply


# Called from Python 2000 times a second: single arrays as arguments and a plain tuple as result take a third of the
# time of records.
@njit
def _catch_up(
    numbers: Floats, integers: Integers, surfaces: Floats, effects: Integers, effect_parameters: Floats,
    values: Floats, words: Integers, friction: Floats, delay_line: Floats, signals: Floats, effect_memory: Floats,
    command_a: float, elapsed_ns: int,
) -> tuple[float, int, float, bool]:  # fmt: skip
    """Advance to `elapsed_ns` since power-on with this command, and measure: rps, counts, A, limited."""
    parameters = PlantParameters(numbers, integers, surfaces, effects, effect_parameters)
    state = PlantState(values, words, friction, delay_line, signals, effect_memory)
    plant_advance(parameters, state, command_a, substeps_due(state, elapsed_ns))
    report = plant_latch(parameters, state)
    return report.velocity_rps, report.position_counts, report.current_a, report.limited


class SimulatedPlant:
    """Motor, current loop and resolver. The power stage is off where `current_a` is 0. Compiled on construction."""

    def __init__(self, config: PlantConfig) -> None:
        self.config = config
        self._parameters = plant_parameters(config)
        self._state = new_state(config)
        self._memory = (*self._parameters, *self._state)
        self._supply_v = float(self._parameters.numbers[at.DC_LINK_V])
        self._counts_per_rev = float(self._parameters.numbers[at.COUNTS_PER_REV])
        self._speed_per_torque = float(self._parameters.numbers[at.SPEED_PER_TORQUE])
        self._supplied = True
        self._sensed = True
        self._offset_counts = 0
        self._time_ns = 0
        self._skipped_ns = 0
        self.dc_link_v = self._supply_v
        self.counts, self.velocity_rps, self.current_a = 0, 0.0, 0.0  # as measured
        self.limited = False  # current or voltage met a limit during the last `advance`
        self.advance(0, 0.0)

    @property
    def temperature_k(self) -> float:
        """Of the motor, above the surroundings."""
        return float(self._state.values[at.TEMPERATURE_K])

    @property
    def true_velocity_rps(self) -> float:
        """Of the shaft, for tests and the summary."""
        return float(self._state.values[at.VELOCITY_RPS])

    def advance(self, until_ns: int, current_a: float) -> None:
        """Advance to `until_ns` (since the start) with this command, then measure."""
        pause_ns = until_ns - self._time_ns - LONGEST_CATCH_UP_NS
        if pause_ns > 0:
            self._skipped_ns += pause_ns
        if not self._supplied:
            self._discharge(until_ns - self._time_ns, current_a)
        self._time_ns = until_ns
        velocity_rps, counts, self.current_a, self.limited = _catch_up(
            *self._memory, current_a, until_ns - self._skipped_ns
        )
        if self._sensed:
            self.counts = counts + self._offset_counts
            self.velocity_rps = velocity_rps

    def lose_resolver(self, lost: bool, jump_rev: float) -> None:
        """Without a signal the angle is the last one plus the jump; the jump stays when the signal comes back."""
        self._sensed = not lost
        if lost:
            jump = math.floor(jump_rev * self._counts_per_rev)
            self._offset_counts += jump
            self.counts += jump
            self.velocity_rps = 0.0

    def hold(self, held: bool) -> None:
        """Close (at once, even on a turning shaft) or open the holding brake: nothing moves a held shaft."""
        numbers = self._parameters.numbers
        if held:
            self._state.values[at.VELOCITY_RPS] = 0.0
        numbers[at.SPEED_PER_TORQUE] = 0.0 if held else self._speed_per_torque

    def lose_dc_link(self, lost: bool) -> None:
        """The DC link discharges through its load; the supply comes back at once."""
        self._supplied = not lost
        if self._supplied:
            self._set_voltage(self._supply_v, self._supply_v)

    def _discharge(self, duration_ns: int, current_a: float) -> None:
        remaining = math.exp(-duration_ns / (DISCHARGE_S * 1e9))
        # with the power stage off no current flows: the model's controller needs voltage to hold it at zero
        self._set_voltage(self.dc_link_v * remaining, self._supply_v if current_a == 0.0 else None)

    def _set_voltage(self, link_v: float, available_v: float | None) -> None:
        self.dc_link_v = link_v
        self._parameters.numbers[at.DC_LINK_V] = link_v if available_v is None else available_v

"""The simulated plant under a controller of its own, run by run: what is logged, and what is true.

The loop is a PI controller at 2 kHz; its command is quantised to a thousandth of the rated current and acts from the
next sample on. No line of the package's own controller or model is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fffo_drive.drive.simulated.pack import new_state, plant_parameters
from fffo_drive.drive.simulated.parameters import PlantConfig
from fffo_drive.drive.simulated.plant import plant_advance
from fffo_drive.drive.simulated.resolver import plant_latch
from fffo_drive.drive.simulated.state import (
    ANGLE_REV,
    SUBSTEP,
    SUBSTEPS_PER_S,
    VELOCITY_RPS,
    PlantParameters,
    PlantState,
)
from fffo_drive.jit import njit

from .profiles import CLOSED_LOOP, PERIOD_S, RATE_HZ, Profile

Floats = np.ndarray[Any, np.dtype[np.float64]]

SUBSTEPS = SUBSTEPS_PER_S // RATE_HZ
COLUMNS = ("current_command_a", "current_a", "velocity_rps", "position_rev")
TRUE_RPS, TRUE_REV = 4, 5


class Gains(NamedTuple):
    """The controller of the closed-loop runs."""

    proportional_a_per_rps: float
    integral_a_per_rev: float
    limit_a: float
    step_a: float  # resolution of the command


@dataclass(frozen=True)
class Run:
    """One run as it is logged, (n,) each, and the true motion behind it."""

    profile: Profile
    columns: dict[str, Floats]  # COLUMNS, and reference_rps in closed loop
    true_rps: Floats
    true_rev: Floats

    @property
    def time_s(self) -> Floats:
        """Stamps since power-on."""
        return self.profile.begin_s + np.arange(self.profile.values.size) * PERIOD_S


@njit
def _loop(
    parameters: PlantParameters,
    state: PlantState,
    closed: bool,
    asked: Floats,
    gains: Gains,
    counts_per_rev: float,
    rows: Floats,
) -> None:
    waiting_a = 0.0
    applied_a = 0.0
    integral_a = 0.0
    for k in range(asked.shape[0]):
        if k > 0:
            plant_advance(parameters, state, applied_a, SUBSTEPS)
        report = plant_latch(parameters, state)
        applied_a = waiting_a
        command_a = asked[k]
        if closed:
            error_rps = asked[k] - report.velocity_rps
            command_a = integral_a + gains.proportional_a_per_rps * error_rps
            if abs(command_a) < gains.limit_a:
                integral_a += gains.integral_a_per_rev * error_rps * PERIOD_S
        command_a = min(gains.limit_a, max(-gains.limit_a, command_a))
        waiting_a = math.floor(command_a / gains.step_a + 0.5) * gains.step_a
        rows[k, 0] = waiting_a
        rows[k, 1] = report.current_a
        rows[k, 2] = report.velocity_rps
        rows[k, 3] = report.position_counts / counts_per_rev
        rows[k, TRUE_RPS] = state.values[VELOCITY_RPS]
        rows[k, TRUE_REV] = state.values[ANGLE_REV]


def simulate(plant: PlantConfig, gains: Gains, profile: Profile, seed: int) -> Run:
    """One run from rest, at its place on the clock since power-on. `seed`: noise of this run."""
    parameters = plant_parameters(plant)
    state = new_state(plant, seed)
    state.words[SUBSTEP] = round(profile.begin_s * SUBSTEPS_PER_S)
    rows = np.zeros((profile.values.size, 6))
    closed = profile.mode == CLOSED_LOOP
    _loop(parameters, state, closed, profile.values, gains, float(1 << plant.resolver.bits), rows)
    columns = {name: np.ascontiguousarray(rows[:, k]) for k, name in enumerate(COLUMNS)}
    if closed:
        columns["reference_rps"] = profile.values
    return Run(profile, columns, rows[:, TRUE_RPS].copy(), rows[:, TRUE_REV].copy())

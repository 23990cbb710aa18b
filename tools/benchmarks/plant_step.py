"""The kernel of the plant's benchmark: many ticks of the plant under given commands."""

from __future__ import annotations

from typing import Any

import numpy as np

from fffo_drive.drive.simulated.plant import plant_advance
from fffo_drive.drive.simulated.resolver import plant_latch
from fffo_drive.drive.simulated.state import PlantParameters, PlantState
from fffo_drive.jit import njit

Floats = np.ndarray[Any, np.dtype[np.float64]]


@njit
def drive_plant(
    parameters: PlantParameters, state: PlantState, commands_a: Floats, velocities_rps: Floats, substeps: int
) -> None:
    """Advance by a tick for each command (A) and latch the measured velocity; all arrays (ticks,)."""
    for tick in range(commands_a.size):
        plant_advance(parameters, state, commands_a[tick], substeps)
        velocities_rps[tick] = plant_latch(parameters, state).velocity_rps

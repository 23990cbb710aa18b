"""Whether a simulated axis comes to rest by itself, and under a PI controller without any delay.

Friction dissipates energy. An effect that supplies energy (a torque that depends on the sign of the velocity and on the
angle) keeps an axis turning for ever, or oscillating under a controller that holds it: no controller can bring such an
axis to rest, so it is useless for judging controllers.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fffo_drive.arrays import Floats
from fffo_drive.drive.simulated.pack import new_state, plant_parameters
from fffo_drive.drive.simulated.parameters import PlantConfig, noiseless
from fffo_drive.drive.simulated.plant import plant_advance
from fffo_drive.drive.simulated.state import (
    ANGLE_REV,
    SPEED_PER_TORQUE,
    SUBSTEPS_PER_S,
    VELOCITY_RPS,
    PlantParameters,
    PlantState,
)
from fffo_drive.jit import njit
from fffo_drive.units import inertia_nm_s2_per_rev

KICKS_RPS = (0.5, -2.0, 8.0)  # initial speed of the free axis
IDEAL_BANDWIDTH_HZ = 20.0  # of the controller without delay; its integral time is ten times 1 / (2 pi 20 Hz)
PLACES_REV = (0.0, 40.25, 80.5, 120.75)  # where it holds: quarters of a turn of the motor, and behind a 160:1 gear
COASTS_S = 9  # long compared with the coasting of any axis with friction; then it is observed for a second
FASTEST_CREEP_RPS = 0.02  # of a contact under the spring of the controller's integral
LOOKS_PER_S = 100
FORGOTTEN_RPS = 2e-3  # remaining difference from the axis that was never moved


class Hold(NamedTuple):
    """An ideal PI velocity controller: a damper and a spring to the initial position of the axis."""

    damper_nm_per_rps: float
    spring_nm_per_rev: float
    place_rev: float


def comes_to_rest(plant: PlantConfig) -> bool:
    """Whether the axis forgets a kick after some time, both free and held without delay.

    An external disturbance (such as a periodic torque) moves it with and without a kick.
    """
    quiet = noiseless(plant)
    omega = 2.0 * math.pi * IDEAL_BANDWIDTH_HZ
    damper_nm_per_rps = omega * inertia_nm_s2_per_rev(plant.inertia_kg_m2)
    holds = [Hold(0.0, 0.0, 0.0), *(Hold(damper_nm_per_rps, 0.1 * omega * damper_nm_per_rps, at) for at in PLACES_REV)]
    for hold in holds:
        placed = replace(quiet, initial_angle_rev=hold.place_rev)
        undisturbed_rps = _later_rps(placed, 0.0, hold)
        for kick_rps in KICKS_RPS:
            difference_rps = _later_rps(placed, kick_rps, hold) - undisturbed_rps
            if _swing_rps(difference_rps) > FORGOTTEN_RPS:
                return False
    return True


def _swing_rps(difference_rps: Floats) -> float:
    """Rms about the mean, plus the mean if it is faster than any creep, as for an axis that keeps turning."""
    mean_rps = abs(float(np.mean(difference_rps)))
    return max(float(np.std(difference_rps)), mean_rps if mean_rps > FASTEST_CREEP_RPS else 0.0)


def _later_rps(plant: PlantConfig, kick_rps: float, hold: Hold) -> Floats:
    """Velocity in the second after `COASTS_S`, shape (LOOKS_PER_S,)."""
    parameters, state = plant_parameters(plant), new_state(plant)
    state.values[VELOCITY_RPS] = kick_rps
    _advance(parameters, state, hold, COASTS_S * SUBSTEPS_PER_S)
    found = np.empty(LOOKS_PER_S)
    for look in range(LOOKS_PER_S):
        _advance(parameters, state, hold, SUBSTEPS_PER_S // LOOKS_PER_S)
        found[look] = state.values[VELOCITY_RPS]
    return found


@njit
def _advance(parameters: PlantParameters, state: PlantState, hold: Hold, substeps: int) -> None:
    """The plant without current, held at its shaft by the controller."""
    x = state.values
    for _ in range(substeps):
        torque_nm = hold.damper_nm_per_rps * x[VELOCITY_RPS] + hold.spring_nm_per_rev * (x[ANGLE_REV] - hold.place_rev)
        x[VELOCITY_RPS] -= parameters.numbers[SPEED_PER_TORQUE] * torque_nm
        plant_advance(parameters, state, 0.0, 1)

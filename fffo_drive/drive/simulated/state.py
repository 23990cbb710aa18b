"""Constants and state of the plant's kernels as arrays, with the name of every slot.

Arrays rather than fields: passing an array to a kernel costs as much as passing one number, and there are many
numbers. `PlantState` is the complete state of the plant.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

Floats = np.ndarray[Any, np.dtype[np.float64]]
Integers = np.ndarray[Any, np.dtype[np.int64]]

SUBSTEPS_PER_S = 22_000  # the current controller's 11 kHz twice, 11 in a tick of 2 kHz
STEP_S = 1.0 / SUBSTEPS_PER_S

# PlantParameters.numbers
SPEED_PER_TORQUE = 0  # step/J: change of speed (rev/s) by 1 Nm over a sub-step
TORQUE_CONSTANT = 1  # Nm/A
PEAK_CURRENT_A = 2
DC_LINK_V = 3
RESISTANCE_OHM = 4
BACK_EMF = 5  # V per rev/s
CURRENT_KEPT = 6  # exp(-step R/L)
CURRENT_APPROACH = 7  # share of the error that the current controller removes in one of its periods
TRANSPORT_FRACTION = 8  # of a sub-step, beyond the whole ones
COUNTS_PER_REV = 9
TRACKING_POSITION = 10  # correction of the angle by the angle error, per sub-step
TRACKING_VELOCITY = 11  # correction of the speed (1/s) by the angle error, per sub-step
RESOLVER_NOISE_REV = 12
VELOCITY_NOISE_RPS = 13
VELOCITY_LSB_RPS = 14
CURRENT_NOISE_A = 15
ROUGHNESS_KEPT = 16  # of the coloured torque, per sub-step
ROUGHNESS_NM = 17  # new share of it, per sub-step
WARMING_K_PER_W = 18  # over a sub-step
COOLING = 19  # share of the temperature rise lost in a sub-step
VISCOUS_PER_K = 20
COULOMB_PER_K = 21
OFFSET_NM_PER_K = 22
CURRENT_PER_V = 23  # A by which 1 V across the winding raises the current over a sub-step, (1 - CURRENT_KEPT)/R
V_PER_CURRENT = 24  # V held over two sub-steps for a change of 1 A, R/(1 - CURRENT_KEPT^2)
REV_PER_COUNT = 25
N_NUMBERS = 26

# PlantParameters.integers
FRICTION_KIND = 0
TRANSPORT_STEPS = 1  # whole sub-steps of the transport delay
FIRST_OF_STAGE = 2  # N_STAGES + 1 entries: effects[first[stage]:first[stage + 1]] belong to the stage

# PlantState.values
ANGLE_REV = 0
VELOCITY_RPS = 1
CURRENT_A = 2
WINDING_V = 3  # voltage across the winding that the current controller holds, less back-EMF
FRICTION_NM = 4  # all friction of the last sub-step, that of effects and the roughness included
ROUGH_NM = 5
TEMPERATURE_K = 6  # rise above the surroundings
TRACKED_REV = 7
TRACKED_RPS = 8
TORQUE_NM = 9  # motor torque of the last sub-step
N_VALUES = 10

# PlantState.words: random generator first (noise.RANDOM_WORDS), then
SUBSTEP = 4  # sub-steps since power-on
HEAD = 5  # where the next demand goes in the delay line
LIMITED = 6  # 1 when current or voltage were at their limit since the last latch
N_WORDS = 7


class PlantParameters(NamedTuple):
    """Constants of a plant. Made by `pack.plant_parameters`."""

    numbers: Floats  # (N_NUMBERS,)
    integers: Integers
    friction: Floats  # (surfaces, friction.TABLE_COLUMNS)
    effects: Integers  # (effects,) addresses in the order of their stages
    effect_parameters: Floats  # (effects, slots.MAX_PARAMETERS)


class PlantState(NamedTuple):
    """State of a plant, changed in place by the kernels. Made by `pack.new_state`."""

    values: Floats  # (N_VALUES,)
    words: Integers  # (N_WORDS,)
    friction: Floats  # (surfaces, friction.STATE_COLUMNS)
    delay_line: Floats  # demands in A, a ring
    signals: Floats  # (slots.N_SLOTS,) what effects see
    effect_memory: Floats  # (effects, slots.MEMORY_SLOTS)


class PlantReport(NamedTuple):
    """What the drive measures at a SYNC, and the true values."""

    velocity_rps: float  # the drive's estimate, in multiples of its resolution
    position_counts: int  # multi-turn, of the resolver's resolution
    current_a: float
    true_velocity_rps: float
    true_friction_nm: float
    limited: bool  # current or voltage were at their limit since the last report

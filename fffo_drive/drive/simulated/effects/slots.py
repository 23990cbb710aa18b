"""What an effect sees and changes: slots of the plant's `signals` array, and the stages at which effects are
called.

An effect is a kernel `effect(signals, parameters, memory)` on three float64 vectors. It reads the plant's
present state from `signals` and changes the slots of its stage in place; `memory` (zero at power-on) is its
own. Angles are of the motor shaft in rev, and everything else is at the motor shaft too.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Vector = np.ndarray[Any, np.dtype[np.float64]]

# stages, in the order in which a sub-step of the plant runs them
PREPARED = -1  # no kernel: the effect changes the configuration before the plant is made
COMMAND = 0  # changes COMMAND_A, the demand that reaches the current loop
TORQUE = 1  # changes TORQUE_NM, the motor torque that the current makes
LEVEL = 2  # changes the scales of the base friction
LOAD = 3  # adds torque or friction on the shaft
SENSOR = 4  # changes SENSED_REV, the angle that the resolver sees
N_STAGES = 5

STAGE_NAMES = {
    PREPARED: "configuration",
    COMMAND: "current demand",
    TORQUE: "motor torque",
    LEVEL: "friction level",
    LOAD: "shaft torque",
    SENSOR: "resolver",
}

# constants of the plant
STEP_S = 0
GEAR_RATIO = 1
RATED_CURRENT_A = 2
TORQUE_CONSTANT_NM_PER_A = 3
INERTIA_NM_S2_PER_REV = 4  # as configured, before an effect takes a share of it to another body
COULOMB_NM = 5  # sum over the surfaces, as configured
# read only
TIME_S = 6  # since power-on
VELOCITY_RPS = 7
ANGLE_REV = 8
CURRENT_A = 9  # mean current of the sub-step (from stage TORQUE on)
FRICTION_NM = 10  # torque of the base friction (from stage LOAD on; before it, that of the last sub-step)
# changed by effects, at their stage
COMMAND_A = 11
TORQUE_NM = 12
LEVEL_SCALE = 13  # multiplies Coulomb and stiction level
STICTION_SCALE = 14  # multiplies the rise from Coulomb to stiction level
VISCOUS_SCALE = 15
ADDED_TORQUE_NM = 16  # positive drives in positive direction
ADDED_FRICTION_NM = 17  # positive brakes positive speed; part of the friction that the plant reports
SENSED_REV = 18
N_SLOTS = 20

MAX_PARAMETERS = 8
MEMORY_SLOTS = 6

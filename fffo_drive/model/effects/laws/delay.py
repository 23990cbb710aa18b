"""Torque comes later than the model says. A refit of Td absorbs it; this law is for a model whose Td is kept."""

from __future__ import annotations

import math

from ....arrays import Floats
from ....jit import njit
from .. import slots as s
from ..law import STRENGTH, Law, Parameter, no_shape


@njit
def delay(signals: Floats, parameters: Floats, memory: Floats) -> None:
    """E = torque(t) - torque(t - delay), straight lines in between. memory: next place, torque of past steps."""
    size = memory.size - 1
    place = int(memory[0])
    memory[1 + place] = signals[s.MOTOR_TORQUE_NM]
    back = min(max(parameters[0] / signals[s.STEP_S], 0.0), size - 2.0)
    whole = math.floor(back)
    share = back - whole
    newer = memory[1 + (place - whole) % size]
    older = memory[1 + (place - whole - 1) % size]
    memory[0] = (place + 1) % size
    signals[s.LOAD_NM] += signals[s.MOTOR_TORQUE_NM] - (newer + share * (older - newer))


LAW = Law(
    name="delay",
    axis="memory",
    kernel=delay,
    parameters=(Parameter("delay_s", "s", STRENGTH, 0.0, 0.03, 5e-4, "delay on top of the model's"),),
    search=no_shape,
    meaning="torque comes later than the model says",
    plain_name="delay",
    cause="sampling, transmission and filters between command and measured velocity",
    remedy="shorten filters and cycle times in the drive",
    compensable=False,
    regime="fast changes of torque",
    lookalikes=("current_lag", "frictional_lag", "elasticity"),
    experiment=(
        "a chirp of current to 50 Hz and more: the phase of a delay grows with frequency and the amplitude stays"
    ),
    motions=("chirp",),
    picture="frequency",
    figure="reversal",
    acts_on="command",
    in_base=True,
)

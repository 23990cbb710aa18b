"""What the loop remembers between two ticks, and its packed form: the beginning of a recording that starts in a motion.

The packed memory is one flat array: the numbers of `LoopMemory`, then the arrays that the law keeps beside it.
"""

from __future__ import annotations

from typing import NamedTuple

from ..arrays import Floats
from ..control.adaptation import AdaptationState, Adapted
from ..control.compensation import MEMORY_SIZE
from ..control.controller import ControllerState
from ..control.envelope import EnvelopeState
from ..control.set_point import HISTORY, LiveMotion
from ..control.velocity_estimator import COMMANDS, VelocityEstimatorState
from ..jit import njit
from ..packing import flat_names, reader, writer


class LawMemory(NamedTuple):
    """What the law remembers between two ticks."""

    controller: ControllerState
    estimator: VelocityEstimatorState
    learned: AdaptationState
    adapted: Adapted  # what was given in the last tick


class LoopMemory(NamedTuple):
    """What law, envelope and generator of set points remember between two ticks."""

    law: LawMemory
    envelope: EnvelopeState
    motion: LiveMotion


LOOP_MEMORY_NAMES = flat_names(LoopMemory)
read_loop_memory = reader(LoopMemory, "read_loop_memory")
write_loop_memory = njit(writer(LoopMemory, "write_loop_memory"))

# places in the packed memory
EFFECTS_MEMORY = len(LOOP_MEMORY_NAMES)
COMMANDS_A = EFFECTS_MEMORY + MEMORY_SIZE  # the last commands
TRAJECTORY = COMMANDS_A + COMMANDS  # the generated reference: velocities, then accelerations
PACKED_SIZE = TRAJECTORY + 2 * HISTORY


class PackedMemory(NamedTuple):
    """The memory behind a row."""

    memory: LoopMemory
    effects: Floats  # (compensation.MEMORY_SIZE,)
    commands_a: Floats  # (velocity_estimator.COMMANDS,)
    trajectory: Floats  # (2, set_point.HISTORY)


def unpack_memory(packed: Floats) -> PackedMemory:
    """The parts of a packed memory (PACKED_SIZE,), copied."""
    return PackedMemory(
        read_loop_memory(packed),
        packed[EFFECTS_MEMORY:COMMANDS_A].copy(),
        packed[COMMANDS_A:TRAJECTORY].copy(),
        packed[TRAJECTORY:PACKED_SIZE].reshape(2, HISTORY).copy(),
    )

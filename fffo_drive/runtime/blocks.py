"""Memory that the loop shares with ordinary threads, without waiting on either side.

Words are int64 with one writer each. Parameters and profiles have two slots: the writer fills the one that is not in
use and then publishes its number; the loop makes one try to copy and otherwise keeps the last good copy.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..control.compensation import ALL_EFFECTS, TABLE_SIZE, new_memory
from ..control.controller import CONTROLLER_BLOCK_SIZE, ControllerConfig, pack_controller
from ..control.own_law import no_own_law
from ..control.reference import Profile
from ..control.set_point import HISTORY, SET_POINT_SIZE, SetPoint
from ..control.velocity_estimator import COMMANDS
from ..jit import njit
from ..jit.atomic import load_acquire, store_release
from .memory import COMMANDS_A, EFFECTS_MEMORY, PACKED_SIZE, TRAJECTORY, LoopMemory, write_loop_memory

Words = np.ndarray[Any, np.dtype[np.int64]]

# control words: written by the supervisor
STOP = 0  # 1: leave the loop after this tick
GOAL = 1  # drive.cia402.GOAL_*
TOGGLE = 2  # friction_observer.TOGGLE_*
PROFILE_NUMBER = 3  # a new number starts the profile in slot number & 1 once the drive is enabled
PROFILE_ABORT = 4  # the number of a profile to end at once
PARAMETER_NUMBER = 5  # a new number publishes the parameters in slot number & 1
RESET_NUMBER = 6  # a new number clears the latched trip and the drive's fault
AUTOSTOP = 7  # 1: disable the drive and leave the loop when the profile has ended
SUPERVISOR_BEAT = 8  # changes as long as the supervisor is alive (LoopConfig.supervisor_ticks)
EFFECTS = 9  # bits: the effects of the model in service
EFFECTS_NUMBER = 10  # a new number publishes the effects in slot number & 1
REQUEST_NUMBER = 11  # raised after each request, with the sequence of its record: rows name the last one seen
SET_POINT_NUMBER = 12  # a new number publishes the live set point in slot number & 1
SET_POINT_ABORT = 13  # the number of a set point whose motion has to end at once
MEMORY_NUMBER = 14  # a new number asks for a copy of the loop's memory
CONTROL_WORDS = 15

# status words: written by the loop
TICK = 0
DEADLINE_NS = 1
MODE = 2
TRIP = 3
TRIP_TICK = 4
STATUSWORD = 5
PROFILE_SAMPLE = 6  # -1: no profile is running
PROFILE_DONE = 7  # number of the last profile that ended
LATE_TICKS = 8
SKIPPED_TICKS = 9
MISSING_FEEDBACK = 10
STALE_BLOCKS = 11  # parameter copies that were torn and not used
PARAMETERS_IN_USE = 12
FINISHED = 13  # 1 when the loop has returned
ABANDONED = 14  # 1 when the loop stopped because the supervisor was silent
EFFECTS_IN_USE = 15  # number of the effects that are compensated
TRIP_STATUSWORD = 16  # of the tick of the trip: later ones show the reaction
SET_POINT_DONE = 17  # number of the set point whose motion ended last, at standstill or aborted
SET_POINT_LAPSED = 18  # number of the last set point whose duration ended without a renewal
SET_POINT_BLOCKED = 19  # number of the last set point that would leave its window, and was braked
ADAPTED_TO_BOUND = 20  # bits of adapted parameters at their bounds: control.adaptation.*_AT_BOUND
MEMORY_GIVEN = 21  # the last MEMORY_NUMBER that was answered
MEMORY_ROW = 22  # rows ever written when it was: the copy is the memory before this row
STATUS_WORDS = 23

PROFILE_ROWS = 2  # value and derivative
NO_PAST: Floats = np.zeros(0)  # the past of a profile that begins at standstill


class Blocks(NamedTuple):
    """All shared memory, as an argument of the loop."""

    control: Words  # (CONTROL_WORDS,)
    status: Words  # (STATUS_WORDS,)
    parameters: Floats  # (2, CONTROLLER_BLOCK_SIZE)
    profile_words: Words  # (2, 3): length, mode and samples of the past of each slot
    profiles: Floats  # (2, PROFILE_ROWS, HISTORY + capacity): the past, then the samples
    effects: Floats  # (2, compensation.TABLE_SIZE)
    effects_loop: Floats  # the same size, private to the loop: copy in progress, and effects in use
    effects_memory: Floats  # (compensation.MEMORY_SIZE,), private to the loop
    set_points: Floats  # (2, SET_POINT_SIZE)
    set_point_loop: Floats  # the same size, private to the loop: copy in progress, and set point in use
    trajectory: Floats  # (2, set_point.HISTORY), private to the loop: the generated reference
    commands: Floats  # (velocity_estimator.COMMANDS,), private to the loop: the last commands in A
    memory: Floats  # (memory.PACKED_SIZE,), written by the loop when it is asked for
    own_law: Floats  # (own_law.BLOCK_SIZE,), a user's law in place of the loop's, and its memory; private to the loop


def new_blocks(controller: ControllerConfig, profile_capacity: int) -> Blocks:
    """Memory at rest, with these parameters in use. `profile_capacity`: samples of the longest profile."""
    blocks = Blocks(
        np.zeros(CONTROL_WORDS, np.int64),
        np.zeros(STATUS_WORDS, np.int64),
        np.zeros((2, CONTROLLER_BLOCK_SIZE)),
        np.zeros((2, 3), np.int64),
        np.zeros((2, PROFILE_ROWS, HISTORY + profile_capacity)),
        np.zeros((2, TABLE_SIZE)),
        np.zeros((2, TABLE_SIZE)),
        new_memory(),
        np.zeros((2, SET_POINT_SIZE)),
        np.zeros((2, SET_POINT_SIZE)),
        np.zeros((2, HISTORY)),
        np.zeros(COMMANDS),
        np.zeros(PACKED_SIZE),
        no_own_law(),
    )
    blocks.control[EFFECTS] = ALL_EFFECTS
    blocks.parameters[:] = pack_controller(controller)
    blocks.status[PROFILE_SAMPLE] = -1
    return blocks


def publish_controller(blocks: Blocks, controller: ControllerConfig) -> int:
    """Hand new parameters to the loop, which takes them at a tick boundary. Return their number."""
    number = int(blocks.control[PARAMETER_NUMBER]) + 1
    blocks.parameters[number & 1] = pack_controller(controller)
    store_release(blocks.control, PARAMETER_NUMBER, number)
    return number


def publish_effects(blocks: Blocks, table: Floats) -> int:
    """Hand new effects (compensation.pack_compensation) to the loop. Returns their number."""
    number = int(blocks.control[EFFECTS_NUMBER]) + 1
    blocks.effects[number & 1] = table
    store_release(blocks.control, EFFECTS_NUMBER, number)
    return number


def ask_for_memory(blocks: Blocks) -> int:
    """Ask the loop for its memory behind the next tick. Returns the number of the request."""
    number = int(blocks.control[MEMORY_NUMBER]) + 1
    store_release(blocks.control, MEMORY_NUMBER, number)
    return number


def require_room(blocks: Blocks, profile: Profile) -> None:
    """Raise ValueError for a profile that is longer than the memory for it."""
    capacity = blocks.profiles.shape[2] - HISTORY
    if profile.values.size > capacity:
        raise ValueError(
            f"profile '{profile.name}' has {profile.values.size} samples, the loop holds {capacity}: "
            "shorten it or raise loop.longest_profile_s"
        )


def publish_profile(blocks: Blocks, profile: Profile, past: Floats = NO_PAST) -> int:
    """Hand a profile to the loop, which starts it once the drive is enabled. Returns its number.

    `past`: the reference before the first sample, oldest first, where the axis already moves: the error is that of an
    older reference (FeedforwardConfig.behind_ticks). Raises ValueError when it is longer than the memory for it.
    """
    require_room(blocks, profile)
    number = int(blocks.control[PROFILE_NUMBER]) + 1
    slot = number & 1
    past = past[-HISTORY:]
    end = past.size + profile.values.size
    blocks.profiles[slot, :, : past.size] = past, np.zeros(past.size)  # derivatives are read ahead only
    blocks.profiles[slot, :, past.size : end] = profile.values, profile.derivatives
    blocks.profile_words[slot] = profile.values.size, profile.mode, past.size
    store_release(blocks.control, PROFILE_NUMBER, number)
    return number


def publish_set_point(blocks: Blocks, set_point: SetPoint) -> int:
    """Hand a live set point to the loop. Returns its number."""
    number = int(blocks.control[SET_POINT_NUMBER]) + 1
    blocks.set_points[number & 1] = set_point
    store_release(blocks.control, SET_POINT_NUMBER, number)
    return number


@njit
def take_parameters(blocks: Blocks, number_in_use: int, scratch: Floats, in_use: Floats) -> int:
    """Copy newly published parameters to `in_use`. Returns the number in use: the old one if the copy was torn."""
    return _take(blocks, PARAMETER_NUMBER, blocks.parameters, number_in_use, scratch, in_use)


@njit
def take_effects(blocks: Blocks, number_in_use: int) -> int:
    """Newly published effects to `blocks.effects_loop[1]`. Returns the number in use."""
    loop = blocks.effects_loop
    return _take(blocks, EFFECTS_NUMBER, blocks.effects, number_in_use, loop[0], loop[1])


@njit
def take_set_point(blocks: Blocks, number_in_use: int) -> int:
    """A newly published set point to `blocks.set_point_loop[1]`. Returns the number in use."""
    loop = blocks.set_point_loop
    return _take(blocks, SET_POINT_NUMBER, blocks.set_points, number_in_use, loop[0], loop[1])


@njit
def _take(blocks: Blocks, word: int, slots: Floats, number_in_use: int, scratch: Floats, in_use: Floats) -> int:
    """Copy the slot whose number is in a control word, if that number is new. Return the number in use.

    One try: while the copy is made the writer may publish once more (the other slot) but not twice; then the copy is
    dropped, counted, and tried again at the next tick.
    """
    number = load_acquire(blocks.control, word)
    if number == number_in_use:
        return number_in_use
    _copy(slots[number & 1], scratch)
    if load_acquire(blocks.control, word) != number:
        blocks.status[STALE_BLOCKS] += 1
        return number_in_use
    _copy(scratch, in_use)
    return int(number)


@njit
def _copy(source: Floats, target: Floats) -> None:
    for i in range(target.size):
        target[i] = source[i]


@njit(inline="always")
def memory_is_asked_for(blocks: Blocks) -> bool:
    """Whether a copy of the memory was asked for that was not given yet."""
    return bool(load_acquire(blocks.control, MEMORY_NUMBER) != blocks.status[MEMORY_GIVEN])


@njit
def give_memory(blocks: Blocks, head: int, memory: LoopMemory) -> None:
    """Copy the memory behind row `head` - 1. Who asked reads it once it is given, and asks no more until then."""
    number = load_acquire(blocks.control, MEMORY_NUMBER)
    packed = blocks.memory
    write_loop_memory(memory, packed)
    _copy(blocks.effects_memory, packed[EFFECTS_MEMORY:COMMANDS_A])
    _copy(blocks.commands, packed[COMMANDS_A:TRAJECTORY])
    _copy(blocks.trajectory[0], packed[TRAJECTORY : TRAJECTORY + HISTORY])
    _copy(blocks.trajectory[1], packed[TRAJECTORY + HISTORY : PACKED_SIZE])
    blocks.status[MEMORY_ROW] = head
    store_release(blocks.status, MEMORY_GIVEN, number)

"""What ordinary threads ask of the loop, tick by tick: other parameters or effects, a reset, a goal, and its end."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..control.adaptation import NOTHING_ADAPTED, adaptation_at_start
from ..control.compensation import SUM_NM, compensation_rest, effects_in_service
from ..control.controller import (
    ControllerConfig,
    adapts_another_model,
    controller_at_rest,
    unpack_controller,
    with_new_gains,
    with_torque_lost,
)
from ..control.envelope import TRIP_NONE, envelope_after_reset
from ..control.velocity_estimator import estimator_at_rest
from ..drive.cia402 import GOAL_DISABLED, GOAL_ENABLED, GOAL_QUICK_STOP, has_torque, is_operation_enabled
from ..jit import njit
from ..jit.atomic import load_acquire
from . import blocks as b
from .blocks import Blocks, take_effects, take_parameters
from .memory import LawMemory
from .tick import Guard, LoopConfig, baseline_of

FAULT_RESET_TICKS = 40  # how long a reset is asked for: the drive must see bit 7 rise (CiA 402 transition 15)


class LawInUse(NamedTuple):
    """The parameters and effects of this tick, by the numbers under which they were published."""

    parameters_number: int
    effects_number: int
    config: ControllerConfig


class Requests(NamedTuple):
    """What is asked for in this tick, and what may be given."""

    number: int  # of the last request seen
    toggle: int
    goal: int
    effects: int  # bits: those in service
    enabled: bool  # the drive is in Operation Enabled
    wanted: bool  # torque is asked for, and nothing stands against it
    active: bool  # ... and the law acts: the drive has been enabled for long enough


class Supervision(NamedTuple):
    """Whether somebody is in charge of the loop, and whether it is about to end."""

    beat: int  # of the supervisor, as last seen
    beat_tick: int
    abandoned: bool
    stopping_ticks: int  # since the end began; 0: the loop goes on
    enabled_ticks: int  # since the drive is in Operation Enabled


@njit(inline="always")
def law_at_start(blocks: Blocks, scratch: Any) -> tuple[LawInUse, LawMemory]:
    """The parameters and effects that are published before the first tick, and memory at rest."""
    parameters_number = take_parameters(blocks, -1, scratch[0], scratch[1])
    blocks.status[b.PARAMETERS_IN_USE] = parameters_number
    effects_number = take_effects(blocks, -1)
    blocks.status[b.EFFECTS_IN_USE] = effects_number
    compensation_rest(blocks.effects_memory)
    memory = LawMemory(controller_at_rest(), estimator_at_rest(), adaptation_at_start(), NOTHING_ADAPTED)
    return LawInUse(parameters_number, effects_number, unpack_controller(scratch[1])), memory


@njit(inline="always")
def take_blocks(blocks: Blocks, scratch: Any, law: LawInUse, memory: LawMemory) -> tuple[LawInUse, LawMemory]:
    """Newly published parameters and effects. What the torque loses by them the integrator gains."""
    parameters_number, config = law.parameters_number, law.config
    controller, learned, adapted = memory.controller, memory.learned, memory.adapted
    number = take_parameters(blocks, parameters_number, scratch[0], scratch[1])
    if number != parameters_number:
        parameters_number = number
        blocks.status[b.PARAMETERS_IN_USE] = number
        config = unpack_controller(scratch[1])
        controller = with_new_gains(law.config, config, controller)
        if adapts_another_model(law.config, config):
            controller = with_torque_lost(config, controller, adapted.torque_nm)
            learned, adapted = adaptation_at_start(), NOTHING_ADAPTED
    effects_number = take_effects(blocks, law.effects_number)
    if effects_number != law.effects_number:
        blocks.status[b.EFFECTS_IN_USE] = effects_number
        controller = with_torque_lost(config, controller, blocks.effects_memory[SUM_NM])
        compensation_rest(blocks.effects_memory)
    return (
        LawInUse(parameters_number, effects_number, config),
        LawMemory(controller, memory.estimator, learned, adapted),
    )


@njit(inline="always")
def take_reset(blocks: Blocks, feedback: Any, guard: Guard) -> Guard:
    """A reset clears the latched trip, and what the drive reports counts from here on."""
    number = load_acquire(blocks.control, b.RESET_NUMBER)
    if number == guard.reset_number:
        return guard
    return Guard(envelope_after_reset(guard.envelope), baseline_of(feedback), TRIP_NONE, number, FAULT_RESET_TICKS)


@njit
def supervision_at_start(blocks: Blocks) -> Supervision:
    """Before the first tick."""
    return Supervision(load_acquire(blocks.control, b.SUPERVISOR_BEAT), 0, False, 0, 0)


@njit(inline="always")
def supervise(
    blocks: Blocks, config: LoopConfig, before: Supervision, statusword: int, tick: int, elapsed_ticks: int
) -> Supervision:
    """A supervisor that is silent for too long has left the axis alone: the end begins."""
    beat = load_acquire(blocks.control, b.SUPERVISOR_BEAT)
    beat_tick = tick if beat != before.beat else before.beat_tick
    abandoned, stopping_ticks = before.abandoned, before.stopping_ticks
    if config.supervisor_ticks > 0 and tick - beat_tick > config.supervisor_ticks and not abandoned:
        abandoned = True
        stopping_ticks = 1
        blocks.status[b.ABANDONED] = 1
    enabled_ticks = before.enabled_ticks + elapsed_ticks if is_operation_enabled(statusword) else 0
    return Supervision(beat, beat_tick, abandoned, stopping_ticks, enabled_ticks)


@njit(inline="always")
def read_requests(
    blocks: Blocks, config: LoopConfig, supervision: Supervision, guard: Guard, statusword: int, number: int
) -> Requests:
    """The control words. `number`: of the last request, read before everything that it counts."""
    toggle = load_acquire(blocks.control, b.TOGGLE)
    goal = load_acquire(blocks.control, b.GOAL)
    effects = effects_in_service(blocks.effects_loop[1], load_acquire(blocks.control, b.EFFECTS))
    if supervision.stopping_ticks > 0:
        goal = GOAL_DISABLED
    if supervision.abandoned:
        goal = GOAL_QUICK_STOP
    wanted = goal == GOAL_ENABLED and guard.trip == TRIP_NONE and guard.reset_ticks == 0
    active = wanted and supervision.enabled_ticks > config.enable_delay_ticks
    return Requests(number, toggle, goal, effects, is_operation_enabled(statusword), wanted, active)


@njit(inline="always")
def without_torque(asked: Requests) -> Requests:
    """The same, in a loop that has begun to end."""
    return Requests(asked.number, asked.toggle, GOAL_DISABLED, asked.effects, asked.enabled, False, False)


@njit(inline="always")
def begin_stopping(before: Supervision) -> Supervision:
    """The end begins: the drive is disabled first."""
    return Supervision(before.beat, before.beat_tick, before.abandoned, 1, before.enabled_ticks)


@njit(inline="always")
def stops_here(
    blocks: Blocks, config: LoopConfig, before: Supervision, statusword: int, ticks_run: int
) -> tuple[bool, Supervision]:
    """Whether this was the last tick: the drive let go (or had time enough), STOP, or `max_ticks`."""
    if before.stopping_ticks > 0:
        stopping_ticks = before.stopping_ticks + 1
        before = Supervision(before.beat, before.beat_tick, before.abandoned, stopping_ticks, before.enabled_ticks)
        if not has_torque(statusword) or stopping_ticks > config.stop_ticks:
            return True, before
    if load_acquire(blocks.control, b.STOP) != 0:
        return True, before
    return config.max_ticks > 0 and ticks_run >= config.max_ticks, before

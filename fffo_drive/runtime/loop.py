"""The tick: one compiled function that holds no GIL, for a drive on a bus and a simulated one alike.

At the deadline: empty the receive queue, SYNC -> feedback until the cut-off -> reference -> controller -> envelope ->
command -> row -> housekeeping (heartbeat, one service frame). A command of sample k acts at SYNC k+1. Nothing in here
allocates, logs, raises, or waits for another thread.
"""

from __future__ import annotations

from typing import Any

from ..control.controller import controller_at_rest, unpack_controller, with_limited
from ..control.envelope import (
    LIMIT_CONTROLLER,
    REACTION_QUICK_STOP,
    TRIP_NONE,
    EnvelopeConfig,
    envelope_at_rest,
    envelope_step,
)
from ..control.reference import MODE_IDLE
from ..drive.cia402 import (
    GOAL_DISABLED,
    GOAL_ENABLED,
    GOAL_QUICK_STOP,
    controlword_towards,
    has_torque,
    is_operation_enabled,
)
from ..drive.port import port_command, port_housekeeping, port_now_ns
from ..jit import njit
from ..jit.atomic import load_acquire, store_release
from . import blocks as b
from .blocks import Blocks, take_parameters
from .ring import HEAD, Ring
from .tick import (
    LoopConfig,
    ProfileCursor,
    apply_law,
    baseline_of,
    exchange,
    follow_profile,
    look,
    publish_tick,
    wake,
    write_row,
)

FAULT_RESET_TICKS = 40  # how long a reset is asked for: the drive must see bit 7 rise (CiA 402 transition 15)


@njit
def goal_after_trip(config: EnvelopeConfig, trip: int, goal: int) -> int:
    """A latched trip replaces what was asked for by its reaction."""
    if trip == TRIP_NONE:
        return goal
    if config.reactions[trip] == REACTION_QUICK_STOP:
        return GOAL_QUICK_STOP
    return GOAL_DISABLED


@njit
def run_loop(
    port: Any, config: LoopConfig, envelope_config: EnvelopeConfig, blocks: Blocks, scratch: Any, ring: Ring,
    first_deadline_ns: int,
) -> int:  # fmt: skip
    """Run until STOP, the end of the profile (AUTOSTOP) or `max_ticks`. Returns the number of ticks that ran.

    `scratch` (2, CONTROLLER_BLOCK_SIZE) float64: copy under way, and parameters in use. The last thing sent is a zero
    command with the voltage disabled.
    """
    control = blocks.control
    status = blocks.status
    feedback = port.feedback[0]
    parameter_number = take_parameters(blocks, -1, scratch[0], scratch[1])
    status[b.PARAMETERS_IN_USE] = parameter_number
    controller_config = unpack_controller(scratch[1])
    controller = controller_at_rest()
    envelope = envelope_at_rest()
    cursor = ProfileCursor(status[b.PROFILE_DONE], -1, 0, MODE_IDLE)
    baseline = baseline_of(feedback)
    reset_number = load_acquire(control, b.RESET_NUMBER)
    reset_ticks = 0
    trip = TRIP_NONE
    controlword = 0
    stopping_ticks = 0
    head = load_acquire(ring.words, HEAD)
    last_sync_ns = first_deadline_ns - config.period_ns
    tick = 0
    deadline_ns = first_deadline_ns
    ticks_run = 0

    while True:
        timing = wake(port, config, status, tick, deadline_ns, last_sync_ns)
        last_sync_ns = timing.woke_ns
        timing = exchange(port, config, status, timing)

        # what ordinary threads ask for
        number = take_parameters(blocks, parameter_number, scratch[0], scratch[1])
        if number != parameter_number:
            parameter_number = number
            status[b.PARAMETERS_IN_USE] = number
            controller_config = unpack_controller(scratch[1])
        number = load_acquire(control, b.RESET_NUMBER)
        if number != reset_number:
            reset_number = number
            reset_ticks = FAULT_RESET_TICKS
            trip = TRIP_NONE
            envelope = envelope_at_rest()
            baseline = baseline_of(feedback)
        toggle = load_acquire(control, b.TOGGLE)
        goal = load_acquire(control, b.GOAL)
        if stopping_ticks > 0:
            goal = GOAL_DISABLED

        # the law
        enabled = is_operation_enabled(feedback["statusword"])
        wanted = goal == GOAL_ENABLED and trip == TRIP_NONE and reset_ticks == 0
        was_running = cursor.start_tick >= 0
        cursor, sample, reference = follow_profile(
            blocks, cursor, controller_config.feedforward, timing.tick, wanted and enabled, config.tail_ticks
        )
        if was_running and cursor.start_tick < 0 and load_acquire(control, b.AUTOSTOP) != 0:
            stopping_ticks = 1
            goal = GOAL_DISABLED
            wanted = False
        law, controller = apply_law(
            controller_config, controller, cursor.mode, reference, feedback["velocity_rps"], toggle, wanted and enabled
        )

        # the envelope
        seen = look(feedback, timing, baseline, law, wanted, enabled)
        command_a, limits, found, envelope = envelope_step(envelope_config, envelope, seen)
        if limits != 0:
            controller = with_limited(controller, True)
        if law.terms.limited:
            limits |= LIMIT_CONTROLLER
        if found != TRIP_NONE and trip == TRIP_NONE and reset_ticks == 0:
            trip = found
            status[b.TRIP_TICK] = timing.tick
        goal = goal_after_trip(envelope_config, trip, goal)
        if trip != TRIP_NONE:
            command_a = 0.0

        row = write_row(ring, head, timing, config, law, seen, feedback)
        controlword = controlword_towards(seen.statusword, goal, reset_ticks > 0, controlword)
        row["limited_a"] = command_a
        row["current_command_a"] = port_command(port, timing.tick, controlword, command_a)
        row["busy_ns"] = port_now_ns(port) - timing.woke_ns
        row["controlword"] = controlword
        row["limits"] = limits
        row["trip"] = trip
        row["profile_sample"] = sample
        row["toggle"] = toggle
        head += 1
        publish_tick(ring, head, status, timing, row)
        port_housekeeping(port, timing.tick)

        # whether there is a next one
        if reset_ticks > 0:
            reset_ticks -= 1
        ticks_run += 1
        if stopping_ticks > 0:
            stopping_ticks += 1
            if not has_torque(seen.statusword) or stopping_ticks > config.stop_ticks:
                break
        if load_acquire(control, b.STOP) != 0:
            break
        if config.max_ticks > 0 and ticks_run >= config.max_ticks:
            break
        tick = timing.tick + 1
        deadline_ns = timing.deadline_ns + config.period_ns

    port_command(port, tick, 0, 0.0)
    store_release(status, b.FINISHED, 1)
    return ticks_run

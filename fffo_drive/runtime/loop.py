"""The tick: one compiled function that holds no GIL, for a drive on a bus and a simulated one alike.

At the deadline: empty the receive queue, SYNC -> feedback until the cut-off -> reference -> controller -> envelope ->
command -> row -> housekeeping (heartbeat, one service frame). A command of sample k acts at SYNC k+1. Nothing in here
allocates, logs, raises, or waits for another thread.
"""

from __future__ import annotations

from typing import Any

from ..control.adaptation import NOTHING_ADAPTED, adaptation_at_start, bounds_reached
from ..control.compensation import SUM_NM, compensation_rest, effects_in_service
from ..control.controller import (
    adapts_another_model,
    controller_at_rest,
    unpack_controller,
    with_limited,
    with_new_gains,
    with_torque_lost,
)
from ..control.envelope import (
    LIMIT_CONTROLLER,
    REACTION_QUICK_STOP,
    TRIP_NONE,
    EnvelopeConfig,
    EnvelopeInputs,
    envelope_after_reset,
    envelope_at_rest,
    envelope_step,
)
from ..control.reference import MODE_IDLE
from ..control.set_point import no_motion
from ..control.velocity_estimator import estimator_at_rest, keep_command
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
from .blocks import Blocks, take_effects, take_parameters
from .ring import HEAD, Ring
from .tick import (
    LoopConfig,
    ProfileCursor,
    apply_law,
    baseline_of,
    compensate,
    estimate_velocity,
    exchange,
    flags_of,
    follow_profile,
    follow_set_points,
    give_adapted,
    learn,
    look,
    publish_tick,
    wake,
    write_row,
)

FAULT_RESET_TICKS = 40  # how long a reset is asked for: the drive must see bit 7 rise (CiA 402 transition 15)


@njit
def goal_in_force(config: EnvelopeConfig, trip: int, goal: int, seen: EnvelopeInputs) -> int:
    """A latched trip replaces what was asked for by its reaction; a drive in local control is not enabled."""
    if trip == TRIP_NONE:
        refused = goal == GOAL_ENABLED and seen.local_control and not seen.enabled
        return GOAL_DISABLED if refused else goal
    if config.reactions[trip] == REACTION_QUICK_STOP:
        return GOAL_QUICK_STOP
    return GOAL_DISABLED


@njit
def run_loop(
    port: Any, config: LoopConfig, envelope_config: EnvelopeConfig, blocks: Blocks, scratch: Any, ring: Ring,
    first_deadline_ns: int,
) -> int:  # fmt: skip
    """Run until STOP, the end of the profile (AUTOSTOP) or `max_ticks`. Returns the number of ticks that ran.

    A supervisor that is silent for `supervisor_ticks` has left the axis alone: quick stop, then the end, and with it of
    our heartbeat.

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
    estimator = estimator_at_rest()
    learned = adaptation_at_start()
    adapted = NOTHING_ADAPTED
    effects_number = take_effects(blocks, -1)
    status[b.EFFECTS_IN_USE] = effects_number
    compensation_rest(blocks.effects_memory)
    envelope = envelope_at_rest()
    cursor = ProfileCursor(status[b.PROFILE_DONE], -1, 0, MODE_IDLE)
    live = no_motion(status[b.SET_POINT_DONE])
    baseline = baseline_of(feedback)
    reset_number = load_acquire(control, b.RESET_NUMBER)
    reset_ticks = 0
    beat = load_acquire(control, b.SUPERVISOR_BEAT)
    beat_tick = 0
    abandoned = False
    trip = TRIP_NONE
    controlword = 0
    enabled_ticks = 0
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

        # what ordinary threads ask for; the number first: what it counts is seen below
        request_number = load_acquire(control, b.REQUEST_NUMBER)
        number = take_parameters(blocks, parameter_number, scratch[0], scratch[1])
        if number != parameter_number:
            parameter_number = number
            status[b.PARAMETERS_IN_USE] = number
            gains_before = controller_config
            controller_config = unpack_controller(scratch[1])
            controller = with_new_gains(gains_before, controller_config, controller)
            if adapts_another_model(gains_before, controller_config):
                controller = with_torque_lost(controller_config, controller, adapted.torque_nm)
                learned, adapted = adaptation_at_start(), NOTHING_ADAPTED
        number = take_effects(blocks, effects_number)
        if number != effects_number:
            effects_number = number
            status[b.EFFECTS_IN_USE] = number
            controller = with_torque_lost(controller_config, controller, blocks.effects_memory[SUM_NM])
            compensation_rest(blocks.effects_memory)
        number = load_acquire(control, b.RESET_NUMBER)
        if number != reset_number:
            reset_number = number
            reset_ticks = FAULT_RESET_TICKS
            trip = TRIP_NONE
            envelope = envelope_after_reset(envelope)
            baseline = baseline_of(feedback)
        toggle = load_acquire(control, b.TOGGLE)
        goal = load_acquire(control, b.GOAL)
        in_service = effects_in_service(blocks.effects_loop[1], load_acquire(control, b.EFFECTS))
        if stopping_ticks > 0:
            goal = GOAL_DISABLED
        number = load_acquire(control, b.SUPERVISOR_BEAT)
        if number != beat:
            beat = number
            beat_tick = timing.tick
        if config.supervisor_ticks > 0 and timing.tick - beat_tick > config.supervisor_ticks and not abandoned:
            abandoned = True
            stopping_ticks = 1
            status[b.ABANDONED] = 1
        if abandoned:
            goal = GOAL_QUICK_STOP

        # the law
        enabled = is_operation_enabled(feedback["statusword"])
        enabled_ticks = enabled_ticks + timing.tick - tick + 1 if enabled else 0
        wanted = goal == GOAL_ENABLED and trip == TRIP_NONE and reset_ticks == 0
        active = wanted and enabled_ticks > config.enable_delay_ticks
        was_running = cursor.start_tick >= 0
        cursor, sample, reference = follow_profile(
            blocks, cursor, controller_config.feedforward, timing.tick, active and live.start_tick < 0,
            config.tail_ticks,
        )  # fmt: skip
        if was_running and cursor.start_tick < 0 and load_acquire(control, b.AUTOSTOP) != 0:
            stopping_ticks = 1
            goal = GOAL_DISABLED
            wanted = active = False
        live, live_sample, set_point_rps, live_reference = follow_set_points(
            blocks, live, controller_config.feedforward, config, timing.tick, feedback, active,
            cursor.start_tick < 0,
        )  # fmt: skip
        if live_sample >= 0:
            reference = live_reference
        effects_nm = compensate(blocks, cursor.mode, reference, feedback["position_rev"], active, in_service)
        estimate, estimator = estimate_velocity(
            controller_config, estimator, blocks, cursor.mode, timing, feedback, active
        )
        adapted, controller = give_adapted(
            controller_config, learned, controller, cursor.mode, reference, toggle, active, adapted.torque_nm
        )
        law, controller = apply_law(
            controller_config, controller, cursor.mode, reference, feedback["velocity_rps"], toggle, active,
            effects_nm + adapted.torque_nm, estimate.followed_rps,
        )  # fmt: skip

        # the envelope
        seen = look(feedback, config, timing, baseline, law, wanted, enabled, timing.tick - tick)
        command_a, limits, found, envelope = envelope_step(envelope_config, envelope, seen)
        if limits != 0:
            controller = with_limited(controller, True)
        if law.terms.limited:
            limits |= LIMIT_CONTROLLER
        if found != TRIP_NONE and trip == TRIP_NONE and reset_ticks == 0:
            trip = found
            status[b.TRIP_TICK] = timing.tick
            status[b.TRIP_STATUSWORD] = seen.statusword
        if trip != TRIP_NONE:
            command_a = 0.0

        row = write_row(ring, head, timing, config, law, effects_nm, adapted, learned, estimate, seen, feedback)
        adapts, learned = learn(controller_config, learned, adapted, law, controller)
        status[b.ADAPTED_TO_BOUND] = bounds_reached(controller_config.adaptation, learned)
        goal_now = goal_in_force(envelope_config, trip, goal, seen)
        controlword = controlword_towards(seen.statusword, goal_now, reset_ticks > 0, controlword)
        row["limited_a"] = command_a
        row["current_command_a"] = port_command(port, timing.tick, controlword, command_a)
        keep_command(blocks.commands, timing.tick, row["current_command_a"])
        row["busy_ns"] = port_now_ns(port) - timing.woke_ns
        row["controlword"] = controlword
        row["limits"] = limits
        row["trip"] = trip
        row["profile_sample"] = sample
        row["toggle"] = toggle
        row["effects"] = in_service
        row["i2t_a2s"] = envelope.i2t_a2s
        row["request_number"] = request_number
        row["parameters_number"] = parameter_number
        row["effects_number"] = effects_number
        row["profile_number"] = cursor.number
        row["set_point_number"] = live.number
        row["set_point_sample"] = live_sample
        row["set_point_rps"] = set_point_rps
        row["flags"] = flags_of(seen, ticks_run == 0, estimate.estimated, adapts)
        row["goal"] = goal
        row["resetting"] = reset_ticks
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

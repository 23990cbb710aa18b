"""The tick: one compiled function that holds no GIL, for a drive on a bus and a simulated one alike.

At the deadline: empty the receive queue, SYNC -> feedback until the cut-off -> reference -> controller -> envelope ->
command -> row -> housekeeping (heartbeat, one service frame). A command of sample k acts at SYNC k+1. Nothing in here
allocates, logs, raises, or waits for another thread.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ..control.controller import (
    ControllerTerms,
    controller_at_rest,
    controller_step,
    unpack_controller,
    with_limited,
)
from ..control.envelope import (
    LIMIT_CONTROLLER,
    REACTION_QUICK_STOP,
    TRIP_NONE,
    EnvelopeConfig,
    EnvelopeInputs,
    envelope_at_rest,
    envelope_step,
)
from ..control.reference import MODE_CURRENT, MODE_IDLE, MODE_VELOCITY
from ..drive.cia402 import (
    GOAL_DISABLED,
    GOAL_ENABLED,
    GOAL_QUICK_STOP,
    controlword_towards,
    has_torque,
    is_operation_enabled,
)
from ..drive.port import (
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sleep_until,
    port_sync,
)
from ..jit import njit
from ..jit.atomic import load_acquire, store_release
from . import blocks as b
from .blocks import Blocks, take_parameters
from .ring import HEAD, Ring

FAULT_RESET_TICKS = 20  # how long a reset is asked for: the drive needs to see bit 7 rise (CiA 402 transition 15)


class LoopConfig(NamedTuple):
    """Times of the loop, in nanoseconds and ticks."""

    period_ns: int
    cutoff_ns: int  # after SYNC: feedback that comes later is late
    late_ns: int  # lateness from which a tick counts as late
    minimum_gap_ns: int  # no two SYNCs are closer than this
    stop_ticks: int  # a drive that has not let go of its torque by then is left all the same
    tail_ticks: int  # standstill under control after a profile, before it counts as done
    max_ticks: int  # 0: no bound


@njit
def idle_terms() -> ControllerTerms:
    """The terms of a tick without torque."""
    return ControllerTerms(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False)


@njit
def open_loop_terms(current_a: float) -> ControllerTerms:
    """The terms of a tick that passes a current profile on."""
    return ControllerTerms(0.0, 0.0, 0.0, 0.0, 0.0, current_a, current_a, False)


@njit
def run_loop(
    port: Any, config: LoopConfig, envelope_config: EnvelopeConfig, blocks: Blocks, scratch: Any, ring: Ring,
    first_deadline_ns: int,
) -> int:  # fmt: skip
    """Run until STOP, the end of the profile (AUTOSTOP) or `max_ticks`. Returns the number of ticks that ran.

    `scratch` (2, CONTROLLER_BLOCK_SIZE) float64: copy under way, and parameters in use. At the return the drive has
    been sent a zero command; disabling it is asked for by GOAL before.
    """
    control = blocks.control
    status = blocks.status
    feedback = port.feedback[0]
    capacity_mask = ring.rows.size - 1
    in_use = scratch[1]

    for i in range(in_use.size):
        in_use[i] = blocks.parameters[load_acquire(control, b.PARAMETER_NUMBER) & 1, i]
    parameter_number = load_acquire(control, b.PARAMETER_NUMBER)
    controller_config = unpack_controller(in_use)
    controller = controller_at_rest()
    envelope = envelope_at_rest()
    reset_number = load_acquire(control, b.RESET_NUMBER)
    reset_ticks = 0
    profile_number = status[b.PROFILE_DONE]
    profile_start = -1
    profile_length = 0
    profile_mode = MODE_IDLE
    emergencies_before = feedback["emergency_count"]
    boots_before = feedback["boot_count"]
    trip = TRIP_NONE
    controlword = 0
    head = load_acquire(ring.words, HEAD)
    deadline_ns = first_deadline_ns
    last_sync_ns = first_deadline_ns - config.period_ns
    tick = 0
    ticks_run = 0
    stopping = False
    stopping_ticks = 0

    while True:
        port_sleep_until(port, deadline_ns)
        woke_ns = port_now_ns(port)
        # missed deadlines are skipped, never caught up; and SYNCs keep their distance
        missed = (woke_ns - deadline_ns) // config.period_ns
        if missed > 0:
            tick += missed
            deadline_ns += missed * config.period_ns
            status[b.SKIPPED_TICKS] += missed
        if woke_ns - last_sync_ns < config.minimum_gap_ns:
            tick += 1
            deadline_ns += config.period_ns
            status[b.SKIPPED_TICKS] += 1
            continue
        lateness_ns = woke_ns - deadline_ns

        port_sync(port, tick)
        sync_ns = port_now_ns(port)
        last_sync_ns = woke_ns
        fresh = port_receive(port, tick, sync_ns + config.cutoff_ns)
        turnaround_ns = -1
        if fresh:
            turnaround_ns = feedback["received_ns"] - sync_ns
        else:
            status[b.MISSING_FEEDBACK] += 1

        # what ordinary threads ask for
        number = take_parameters(blocks, parameter_number, scratch[0], in_use)
        if number != parameter_number:
            parameter_number = number
            controller_config = unpack_controller(in_use)
        toggle = load_acquire(control, b.TOGGLE)
        goal = load_acquire(control, b.GOAL)
        if stopping:
            goal = GOAL_DISABLED
        number = load_acquire(control, b.RESET_NUMBER)
        if number != reset_number:
            reset_number = number
            reset_ticks = FAULT_RESET_TICKS
            trip = TRIP_NONE
            envelope = envelope_at_rest()
            emergencies_before = feedback["emergency_count"]
            boots_before = feedback["boot_count"]
        statusword = feedback["statusword"]
        enabled = is_operation_enabled(statusword)
        wanted = trip == TRIP_NONE and goal == GOAL_ENABLED and reset_ticks == 0

        # reference at the deadline
        number = load_acquire(control, b.PROFILE_NUMBER)
        if number != profile_number and wanted and enabled and profile_start < 0:
            profile_number = number
            profile_start = tick
            profile_length = blocks.profile_words[number & 1, 0]
            profile_mode = blocks.profile_words[number & 1, 1]
        sample = -1
        if profile_start >= 0:
            sample = tick - profile_start
            aborted = load_acquire(control, b.PROFILE_ABORT) == profile_number
            if sample >= profile_length + config.tail_ticks or aborted or not wanted:
                sample = -1
                profile_start = -1
                profile_mode = MODE_IDLE
                status[b.PROFILE_DONE] = profile_number
                if load_acquire(control, b.AUTOSTOP) != 0:
                    stopping = True
                    goal = GOAL_DISABLED
                    wanted = False
        reference = 0.0
        derivative = 0.0
        if 0 <= sample < profile_length:
            reference = blocks.profiles[profile_number & 1, 0, sample]
            derivative = blocks.profiles[profile_number & 1, 1, sample]

        # the law
        velocity_rps = feedback["velocity_rps"]
        mode = MODE_IDLE
        terms = idle_terms()
        reference_rps = 0.0
        reference_rps2 = 0.0
        if wanted and enabled:
            if profile_mode == MODE_CURRENT:
                mode = MODE_CURRENT
                terms = open_loop_terms(reference)
                controller = controller_at_rest()
            else:
                mode = MODE_VELOCITY
                reference_rps = reference
                reference_rps2 = derivative
                terms, controller = controller_step(
                    controller_config, controller, toggle, reference_rps, velocity_rps
                )
        else:
            controller = controller_at_rest()

        # the envelope
        heartbeat_age_ns = -1
        if feedback["heartbeat_ns"] >= 0:
            heartbeat_age_ns = woke_ns - feedback["heartbeat_ns"]
        velocity_age = tick - feedback["velocity_tick"]
        status_age = tick - feedback["status_tick"]
        seen = EnvelopeInputs(
            terms.command_a,
            velocity_rps,
            feedback["position_rev"],
            terms.error_rps,
            velocity_age,
            status_age,
            statusword,
            feedback["emergency_count"] - emergencies_before,
            feedback["boot_count"] - boots_before,
            feedback["bus_off"] != 0,
            heartbeat_age_ns,
            wanted,
            enabled,
            mode == MODE_VELOCITY,
        )
        command_a, limits, found, envelope = envelope_step(envelope_config, envelope, seen)
        if limits != 0:
            controller = with_limited(controller, True)
        if terms.limited:
            limits |= LIMIT_CONTROLLER
        if found != TRIP_NONE and trip == TRIP_NONE and reset_ticks == 0:
            trip = found
            status[b.TRIP_TICK] = tick
        if trip != TRIP_NONE:
            command_a = 0.0
            goal = GOAL_DISABLED
            if envelope_config.reactions[trip] == REACTION_QUICK_STOP:
                goal = GOAL_QUICK_STOP

        controlword = controlword_towards(statusword, goal, reset_ticks > 0, controlword)
        sent_a = port_command(port, tick, controlword, command_a)
        done_ns = port_now_ns(port)

        late = lateness_ns > config.late_ns
        if late:
            status[b.LATE_TICKS] += 1
        row = ring.rows[head & capacity_mask]
        row["tick"] = tick
        row["deadline_ns"] = deadline_ns
        row["lateness_ns"] = lateness_ns
        row["turnaround_ns"] = turnaround_ns
        row["busy_ns"] = done_ns - woke_ns
        row["reference_rps"] = reference_rps
        row["reference_rps2"] = reference_rps2
        row["velocity_rps"] = velocity_rps
        row["position_rev"] = feedback["position_rev"]
        row["current_a"] = feedback["current_a"]
        row["error_rps"] = terms.error_rps
        row["proportional_a"] = terms.proportional_a
        row["integral_a"] = terms.integral_a
        row["friction_nm"] = terms.friction_nm
        row["observation_nm_per_s"] = terms.observation_nm_per_s
        row["requested_a"] = terms.requested_a
        row["current_command_a"] = sent_a
        row["true_velocity_rps"] = feedback["true_velocity_rps"]
        row["true_friction_nm"] = feedback["true_friction_nm"]
        row["velocity_age"] = velocity_age
        row["status_age"] = status_age
        row["statusword"] = statusword
        row["controlword"] = controlword
        row["limits"] = limits
        row["trip"] = trip
        row["profile_sample"] = sample
        row["toggle"] = toggle
        row["mode"] = mode
        row["late"] = late
        row["reserved"] = 0
        head += 1
        store_release(ring.words, HEAD, head)

        status[b.TICK] = tick
        status[b.DEADLINE_NS] = deadline_ns
        status[b.MODE] = mode
        status[b.TRIP] = trip
        status[b.STATUSWORD] = statusword
        status[b.PROFILE_SAMPLE] = sample
        status[b.PARAMETERS_IN_USE] = parameter_number
        port_housekeeping(port, tick)

        if reset_ticks > 0:
            reset_ticks -= 1
        ticks_run += 1
        if load_acquire(control, b.STOP) != 0:
            break
        if stopping:
            stopping_ticks += 1
            if not has_torque(statusword) or stopping_ticks >= config.stop_ticks:
                break
        if config.max_ticks > 0 and ticks_run >= config.max_ticks:
            break
        tick += 1
        deadline_ns += config.period_ns

    port_command(port, tick, 0, 0.0)
    store_release(status, b.FINISHED, 1)
    return ticks_run

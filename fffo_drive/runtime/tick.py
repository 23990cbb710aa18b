"""The pieces of one tick, each a kernel: wake, exchange, follow the target, the law, the envelope, the command."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ..control.adaptation import NOTHING_ADAPTED, AdaptationState, Adapted, adaptation_step, adapted_torque
from ..control.compensation import compensation_rest, compensation_step
from ..control.controller import (
    ControllerConfig,
    ControllerState,
    ControllerTerms,
    controller_at_rest,
    controller_step,
    with_limited,
    with_torque_lost,
)
from ..control.envelope import (
    LIMIT_CONTROLLER,
    REACTION_QUICK_STOP,
    TRIP_NONE,
    EnvelopeConfig,
    EnvelopeInputs,
    EnvelopeState,
    envelope_at_rest,
    envelope_step,
)
from ..control.feedforward import FeedforwardConfig, Reference, read_reference, stands_still, steady_reference
from ..control.friction_observer import TOGGLE_FEEDFORWARD, TOGGLE_NONE, TOGGLE_OFF, observer_start
from ..control.own_law import USED, own_law_rest, own_law_step
from ..control.reference import MODE_CURRENT, MODE_IDLE, MODE_VELOCITY
from ..control.set_point import (
    LiveMotion,
    advance_motion,
    begin_motion,
    has_ended,
    has_lapsed,
    no_motion,
    unpack_set_point,
    with_set_point,
)
from ..control.velocity_estimator import (
    Measured,
    VelocityEstimatorState,
    VelocityEstimatorTerms,
    estimator_at_rest,
    velocity_estimator_step,
)
from ..drive.cia402 import (
    GOAL_DISABLED,
    GOAL_ENABLED,
    GOAL_QUICK_STOP,
    NOT_READY_MASK,
    STATUS_FAULT,
    STATUS_FOLLOWS_COMMAND,
    STATUS_INTERNAL_LIMIT,
    STATUS_REMOTE,
    controlword_towards,
)
from ..drive.port import NMT_OPERATIONAL, port_command, port_now_ns, port_receive, port_sleep_until, port_sync
from ..jit import njit
from ..jit.atomic import load_acquire, store_release
from ..units import NS_PER_S
from . import blocks as b
from .blocks import Blocks, Words, take_set_point
from .memory import LawMemory

# bits of the row's flags: further inputs of the envelope, and the start of memory
FLAG_LOOP_BEGAN = 1  # the first tick of a loop: all memory at rest
FLAG_EMERGENCY = 2  # the drive sent an EMCY since the loop began or a fault was reset
FLAG_REBOOT = 4  # ... a boot-up message
FLAG_NOT_OPERATIONAL = 8  # ... a heartbeat that says that it is not in NMT state OPERATIONAL
FLAG_BUS_OFF = 16  # ... the CAN controller was off the bus, or the interface gone
FLAG_FOREIGN_COMMAND = 32  # ... a frame that only we may send came from somebody else
FLAG_LOCAL_CONTROL = 64  # statusword bit 9 is 0 where the drive serves it: it ignores the controlword
FLAG_IGNORES_TARGET = 128  # statusword bit 12 is 0 where the drive serves it, though the axis is commanded
FLAG_ESTIMATED_VELOCITY = 256  # the error used the estimated velocity, not the drive's
FLAG_ADAPTS = 512  # offset and Coulomb friction are learned in this tick
FLAG_SETTINGS_CHANGED = 1024  # ... an object of the drive no longer had the value that it was given


class LoopConfig(NamedTuple):
    """Times of the loop, in nanoseconds and ticks."""

    period_ns: int
    cutoff_ns: int  # after SYNC: feedback that arrives later is late
    late_ns: int  # lateness from which a tick counts as late
    minimum_gap_ns: int  # no two SYNCs are closer than this
    stop_ticks: int  # a drive that still has torque by then is released all the same
    tail_ticks: int  # standstill under control after a profile, before it counts as done
    max_ticks: int  # 0: no bound
    supervisor_ticks: int = 0  # with the supervisor silent this long, the loop stops the drive and ends; 0: never
    enable_delay_ticks: int = 0  # from Operation Enabled to the start of the law, for a holding brake to open
    served_status_bits: int = 0  # those of cia402.STATUS_REMOTE and STATUS_FOLLOWS_COMMAND that the drive sets

    @property
    def enable_delay_s(self) -> float:
        """Time from Operation Enabled to the start of the law."""
        return self.enable_delay_ticks * self.period_ns / NS_PER_S


class Timing(NamedTuple):
    """When a tick ran."""

    tick: int
    deadline_ns: int
    woke_ns: int
    turnaround_ns: int  # SYNC to feedback; -1: none arrived


class ProfileCursor(NamedTuple):
    """Position of the loop in a profile."""

    number: int  # of the last profile taken
    start_tick: int  # -1: none is running
    length: int
    mode: int  # reference.MODE_*; MODE_IDLE holds zero velocity


class LawOutput(NamedTuple):
    """Output of the law in this tick."""

    mode: int
    reference: Reference  # all zero without a velocity law
    terms: ControllerTerms
    effects_nm: float
    estimate: VelocityEstimatorTerms


class Baseline(NamedTuple):
    """Counters of the drive when the loop began or a fault was reset; only later changes count."""

    emergencies: int
    boots: int
    bus_losses: int
    nmt_exits: int
    foreign_frames: int
    settings_changes: int


@njit
def baseline_of(feedback: Any) -> Baseline:
    """The counters now."""
    return Baseline(
        feedback["emergency_count"],
        feedback["boot_count"],
        feedback["bus_losses"],
        feedback["nmt_exits"],
        feedback["foreign_frames"],
        feedback["settings_changed"],
    )


class Guard(NamedTuple):
    """What stands between law and drive, and what it remembers."""

    envelope: EnvelopeState
    baseline: Baseline
    trip: int  # latched until a reset
    reset_number: int  # of the last reset that was taken
    reset_ticks: int  # for which the drive is still asked to reset its fault


class Sent(NamedTuple):
    """What went to the drive."""

    controlword: int
    current_a: float  # what the wire's resolution made of the command
    busy_ns: int  # from waking to here


@njit(inline="always")
def guard_at_start(blocks: Blocks, feedback: Any) -> Guard:
    """Before the first tick."""
    reset_number = load_acquire(blocks.control, b.RESET_NUMBER)
    return Guard(envelope_at_rest(), baseline_of(feedback), TRIP_NONE, reset_number, 0)


@njit(inline="always")
def timing_before(config: LoopConfig, first_deadline_ns: int) -> Timing:
    """Of the tick before the first, as if it had been on time."""
    deadline_ns = first_deadline_ns - config.period_ns
    return Timing(-1, deadline_ns, deadline_ns, -1)


@njit(inline="always")
def wake(port: Any, config: LoopConfig, status: Words, last: Timing) -> Timing:
    """Sleep until the next deadline. Missed deadlines are skipped, never caught up.

    After a late SYNC the next one is delayed to keep the minimum distance: later than its deadline, but not lost.
    """
    deadline_ns = last.deadline_ns + config.period_ns
    port_sleep_until(port, max(deadline_ns, last.woke_ns + config.minimum_gap_ns))
    woke_ns = port_now_ns(port)
    missed = max(0, (woke_ns - deadline_ns) // config.period_ns)
    status[b.SKIPPED_TICKS] += missed
    return Timing(last.tick + 1 + missed, deadline_ns + missed * config.period_ns, woke_ns, -1)


@njit(inline="always")
def exchange(port: Any, config: LoopConfig, status: Words, timing: Timing) -> Timing:
    """SYNC, and its answer until the cut-off."""
    port_sync(port, timing.tick)
    sync_ns = port_now_ns(port)
    turnaround_ns = -1
    if port_receive(port, timing.tick, sync_ns + config.cutoff_ns) != 0:
        turnaround_ns = port.feedback[0]["received_ns"] - sync_ns
    else:
        status[b.MISSING_FEEDBACK] += 1
    if timing.woke_ns - timing.deadline_ns > config.late_ns:
        status[b.LATE_TICKS] += 1
    return Timing(timing.tick, timing.deadline_ns, timing.woke_ns, turnaround_ns)


@njit
def follow_profile(
    blocks: Blocks, cursor: ProfileCursor, feedforward: FeedforwardConfig, tick: int, active: bool, tail_ticks: int
) -> tuple[ProfileCursor, int, Reference]:
    """Return (cursor, sample, reference). Start a new profile, report an ended one as done."""
    number = load_acquire(blocks.control, b.PROFILE_NUMBER)
    if number != cursor.number and active:
        words = blocks.profile_words[number & 1]
        cursor = ProfileCursor(number, tick, words[0], words[1])
    if cursor.start_tick < 0:
        return cursor, -1, steady_reference(0.0)
    sample = tick - cursor.start_tick
    aborted = load_acquire(blocks.control, b.PROFILE_ABORT) == cursor.number
    if sample >= cursor.length + tail_ticks or aborted or not active:
        blocks.status[b.PROFILE_DONE] = cursor.number
        return ProfileCursor(cursor.number, -1, 0, MODE_IDLE), -1, steady_reference(0.0)
    slot = cursor.number & 1
    profile, past = blocks.profiles[slot], blocks.profile_words[slot, 2]
    return cursor, sample, read_reference(feedforward, profile[0], profile[1], past + cursor.length, past + sample)


@njit(inline="always")
def follow_set_points(
    blocks: Blocks, motion: LiveMotion, feedforward: FeedforwardConfig, config: LoopConfig, tick: int,
    feedback: Any, active: bool, may_begin: bool,
) -> tuple[LiveMotion, int, float, Reference]:  # fmt: skip
    """Return (memory, sample, target in force, reference); sample is -1 without a motion by set points.

    The first set point begins a motion, later ones change it; it ends at standstill with a target of zero.
    """
    if active and (may_begin or motion.start_tick >= 0):
        number = take_set_point(blocks, motion.number)
        if number != motion.number:
            if motion.start_tick < 0:
                motion = begin_motion(blocks.trajectory, number, tick)
            else:
                motion = with_set_point(motion, number, tick)
    if motion.start_tick < 0:
        return motion, -1, 0.0, steady_reference(0.0)
    set_point = unpack_set_point(blocks.set_point_loop[1])
    aborted = load_acquire(blocks.control, b.SET_POINT_ABORT) == motion.number
    if aborted or not active or has_ended(feedforward, motion, config.tail_ticks):
        store_release(blocks.status, b.SET_POINT_DONE, motion.number)
        return no_motion(motion.number), -1, 0.0, steady_reference(0.0)
    if has_lapsed(set_point, motion, tick):
        blocks.status[b.SET_POINT_LAPSED] = motion.number
    period_s = config.period_ns / NS_PER_S
    motion, target_rps, reference = advance_motion(
        feedforward, set_point, motion, blocks.trajectory, tick, feedback["position_rev"], feedback["velocity_rps"],
        period_s,
    )  # fmt: skip
    if motion.blocked != 0:
        blocks.status[b.SET_POINT_BLOCKED] = motion.number
    return motion, tick - motion.start_tick, target_rps, reference


@njit
def compensate(
    blocks: Blocks, mode: int, reference: Reference, position_rev: float, active: bool, in_service: int
) -> float:
    """Compensation (Nm) of the model's effects; their memory is reset while the velocity loop is open."""
    memory = blocks.effects_memory
    if not active or mode == MODE_CURRENT:
        compensation_rest(memory)
        return 0.0
    return compensation_step(blocks.effects_loop[1], memory, in_service, reference, position_rev)


@njit
def estimate_velocity(
    config: ControllerConfig, state: VelocityEstimatorState, blocks: Blocks, mode: int, timing: Timing, feedback: Any,
    active: bool,
) -> tuple[VelocityEstimatorTerms, VelocityEstimatorState]:  # fmt: skip
    """The velocity for the error; the filter is reset while the velocity loop is open."""
    if not active or mode == MODE_CURRENT:
        return VelocityEstimatorTerms(0.0, 0.0, feedback["velocity_rps"], False), estimator_at_rest()
    measured = Measured(
        timing.tick,
        timing.woke_ns,
        feedback["velocity_tick"] == timing.tick,
        feedback["position_rev"],
        feedback["velocity_rps"],
    )
    return velocity_estimator_step(config.velocity, state, blocks.commands, measured)


@njit
def give_adapted(
    config: ControllerConfig, state: AdaptationState, controller: ControllerState, mode: int, reference: Reference,
    toggle: int, active: bool, before_nm: float,
) -> tuple[Adapted, ControllerState]:  # fmt: skip
    """Adapted torque on this tick's reference, bumpless when friction switches to the reference or away from it.

    `before_nm`: the adapted torque of the last tick. In the first step of the law there was none.
    """
    if not (config.adaptation.used and active) or mode == MODE_CURRENT:
        return NOTHING_ADAPTED, controller
    adapted = NOTHING_ADAPTED
    if toggle == TOGGLE_FEEDFORWARD:
        friction_nm = controller.friction.torque_nm
        if controller.toggle == TOGGLE_OFF:
            friction_nm = observer_start(config.observer, reference.ahead).torque_nm
        adapted = adapted_torque(config.observer.friction, state, friction_nm, reference.ahead)
    if toggle != controller.toggle and controller.toggle != TOGGLE_NONE:
        controller = with_torque_lost(config, controller, before_nm - adapted.torque_nm)
    return adapted, controller


@njit
def learn(
    config: ControllerConfig, state: AdaptationState, adapted: Adapted, law: LawOutput, controller: ControllerState
) -> tuple[bool, AdaptationState]:
    """Learn from the torque of P and I: in motion, on the reference, and only if the command was not limited."""
    if not config.adaptation.used or law.mode != MODE_VELOCITY or controller.toggle != TOGGLE_FEEDFORWARD:
        return False, state
    lacking_nm = config.torque_constant_nm_per_a * (law.terms.proportional_a + law.terms.integral_a)
    if stands_still(law.reference) or controller.limited or not math.isfinite(lacking_nm):
        return False, state
    return adaptation_step(config.adaptation, state, adapted.contact, law.reference.ahead, lacking_nm)


@njit(inline="always")
def law_step(
    blocks: Blocks, config: ControllerConfig, memory: LawMemory, mode: int, timing: Timing, feedback: Any,
    toggle: int, effects: int, active: bool, reference: Reference,
) -> tuple[LawOutput, LawMemory]:  # fmt: skip
    """The velocity law, an open-loop current, or nothing; the memory rests while the law does not act."""
    effects_nm = compensate(blocks, mode, reference, feedback["position_rev"], active, effects)
    estimate, estimator = estimate_velocity(config, memory.estimator, blocks, mode, timing, feedback, active)
    adapted, controller = give_adapted(
        config, memory.learned, memory.controller, mode, reference, toggle, active, memory.adapted.torque_nm
    )
    if not active:
        mode, reference = MODE_IDLE, steady_reference(0.0)
        terms, controller = terms_of_current(0.0), controller_at_rest()
        own_law_rest(blocks.own_law)
    elif mode == MODE_CURRENT:
        terms, controller = terms_of_current(reference.value), controller_at_rest()
        reference = steady_reference(0.0)
        own_law_rest(blocks.own_law)
    elif blocks.own_law[USED] != 0.0:
        mode = MODE_VELOCITY
        terms, controller = own_law_step(
            blocks.own_law,
            config,
            controller,
            reference,
            effects_nm + adapted.torque_nm,
            estimate.followed_rps,
            feedback["position_rev"],
        )
    else:
        mode = MODE_VELOCITY
        terms, controller = controller_step(
            config, controller, toggle, reference, feedback["velocity_rps"], effects_nm + adapted.torque_nm,
            estimate.followed_rps, feedback["position_rev"],
        )  # fmt: skip
    output = LawOutput(mode, reference, terms, effects_nm, estimate)
    return output, LawMemory(controller, estimator, memory.learned, adapted)


@njit
def terms_of_current(current_a: float) -> ControllerTerms:
    """An open-loop current has no other terms."""
    return ControllerTerms(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, current_a, current_a, False)


@njit
def in_local_control(served_bits: int, statusword: int) -> bool:
    """Whether the drive reports that it ignores controlwords; not evaluated while it starts or is in fault."""
    if served_bits & ~statusword & STATUS_REMOTE == 0:
        return False
    return statusword & STATUS_FAULT == 0 and statusword & NOT_READY_MASK != 0


@njit
def ignores_target(served_bits: int, statusword: int) -> bool:
    """Whether the drive reports that it does not follow the target, other than by limiting it (bit 11, in the row)."""
    if served_bits & STATUS_FOLLOWS_COMMAND == 0:
        return False
    return statusword & (STATUS_FOLLOWS_COMMAND | STATUS_INTERNAL_LIMIT) == 0


@njit
def look(
    feedback: Any, config: LoopConfig, timing: Timing, baseline: Baseline, law: LawOutput, wanted: bool, enabled: bool,
    skipped_ticks: int,
) -> EnvelopeInputs:  # fmt: skip
    """Inputs of the envelope: the request, the feedback and the ages of both, and status changes of the drive."""
    # the following error uses the drive's own velocity: the envelope does not depend on an estimate
    error_rps = law.reference.expected - feedback["velocity_rps"] if law.mode == MODE_VELOCITY else 0.0
    heartbeat_age_ns = -1
    if feedback["heartbeat_ns"] >= 0:
        heartbeat_age_ns = timing.woke_ns - feedback["heartbeat_ns"]
    return EnvelopeInputs(
        law.terms.command_a,
        feedback["velocity_rps"],
        feedback["position_rev"],
        error_rps,
        timing.tick - feedback["velocity_tick"],
        timing.tick - feedback["status_tick"],
        feedback["statusword"],
        feedback["emergency_count"] - baseline.emergencies,
        feedback["boot_count"] - baseline.boots,
        (feedback["nmt_state"] >= 0 and feedback["nmt_state"] != NMT_OPERATIONAL)
        or feedback["nmt_exits"] != baseline.nmt_exits,
        # even a short loss counts: any frame after its report clears it before it is checked
        feedback["bus_off"] != 0 or feedback["bus_losses"] != baseline.bus_losses,
        feedback["foreign_frames"] - baseline.foreign_frames,
        heartbeat_age_ns,
        feedback["settings_changed"] - baseline.settings_changes,
        wanted,
        enabled,
        law.mode == MODE_VELOCITY,
        in_local_control(config.served_status_bits, feedback["statusword"]),
        law.mode != MODE_IDLE and ignores_target(config.served_status_bits, feedback["statusword"]),
        skipped_ticks,
        law.terms.limited,
    )


@njit
def flags_of(seen: EnvelopeInputs, loop_began: bool, estimated: bool, adapts: bool) -> int:
    """Bits for the row."""
    flags = FLAG_LOOP_BEGAN if loop_began else 0
    flags |= FLAG_ESTIMATED_VELOCITY if estimated else 0
    flags |= FLAG_ADAPTS if adapts else 0
    flags |= FLAG_EMERGENCY if seen.emergencies > 0 else 0
    flags |= FLAG_REBOOT if seen.reboots > 0 else 0
    flags |= FLAG_NOT_OPERATIONAL if seen.not_operational else 0
    flags |= FLAG_BUS_OFF if seen.bus_off else 0
    flags |= FLAG_LOCAL_CONTROL if seen.local_control else 0
    flags |= FLAG_IGNORES_TARGET if seen.ignores_target else 0
    flags |= FLAG_SETTINGS_CHANGED if seen.settings_changes > 0 else 0
    return flags | (FLAG_FOREIGN_COMMAND if seen.foreign_frames > 0 else 0)


@njit(inline="always")
def guard_step(
    config: EnvelopeConfig, status: Words, tick: int, guard: Guard, memory: LawMemory, law: LawOutput,
    seen: EnvelopeInputs,
) -> tuple[float, int, Guard, LawMemory]:  # fmt: skip
    """The envelope. Returns (command in A, limits that were met, guard, memory that knows of them)."""
    command_a, limits, found, envelope = envelope_step(config, guard.envelope, seen)
    if limits != 0:
        controller = with_limited(memory.controller, True)
        memory = LawMemory(controller, memory.estimator, memory.learned, memory.adapted)
    if law.terms.limited:
        limits |= LIMIT_CONTROLLER
    trip = guard.trip
    if found != TRIP_NONE and trip == TRIP_NONE and guard.reset_ticks == 0:
        trip = found
        status[b.TRIP_TICK] = tick
        status[b.TRIP_STATUSWORD] = seen.statusword
    if trip != TRIP_NONE:
        command_a = 0.0
    return command_a, limits, Guard(envelope, guard.baseline, trip, guard.reset_number, guard.reset_ticks), memory


@njit(inline="always")
def count_reset(guard: Guard) -> Guard:
    """One tick less for which the drive is asked to reset its fault."""
    return Guard(guard.envelope, guard.baseline, guard.trip, guard.reset_number, max(0, guard.reset_ticks - 1))


@njit
def goal_in_force(config: EnvelopeConfig, trip: int, goal: int, seen: EnvelopeInputs) -> int:
    """A latched trip replaces what was asked for by its reaction; a drive in local control is not enabled."""
    if trip == TRIP_NONE:
        refused = goal == GOAL_ENABLED and seen.local_control and not seen.enabled
        return GOAL_DISABLED if refused else goal
    if config.reactions[trip] == REACTION_QUICK_STOP:
        return GOAL_QUICK_STOP
    return GOAL_DISABLED


@njit(inline="always")
def send(
    port: Any, config: EnvelopeConfig, timing: Timing, guard: Guard, goal: int, seen: EnvelopeInputs,
    last_controlword: int, command_a: float,
) -> Sent:  # fmt: skip
    """The controlword towards the goal, and the current."""
    goal_now = goal_in_force(config, guard.trip, goal, seen)
    controlword = controlword_towards(seen.statusword, goal_now, guard.reset_ticks > 0, last_controlword)
    current_a = port_command(port, timing.tick, controlword, command_a)
    return Sent(controlword, current_a, port_now_ns(port) - timing.woke_ns)


@njit(inline="always")
def with_learned(memory: LawMemory, learned: AdaptationState) -> LawMemory:
    """The same memory after a tick that learned."""
    return LawMemory(memory.controller, memory.estimator, learned, memory.adapted)

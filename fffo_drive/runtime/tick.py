"""The pieces of one tick, each a kernel: wake, exchange, follow the profile, apply the law, look, write the row."""

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
    with_torque_lost,
)
from ..control.envelope import EnvelopeInputs
from ..control.feedforward import FeedforwardConfig, Reference, read_reference, stands_still, steady_reference
from ..control.friction_observer import TOGGLE_FEEDFORWARD, TOGGLE_OFF, observer_start
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
    NOT_READY_MASK,
    STATUS_FAULT,
    STATUS_FOLLOWS_COMMAND,
    STATUS_INTERNAL_LIMIT,
    STATUS_REMOTE,
)
from ..drive.port import NMT_OPERATIONAL, port_now_ns, port_receive, port_sleep_until, port_sync
from ..jit import njit
from ..jit.atomic import load_acquire, store_release
from ..units import NS_PER_S
from . import blocks as b
from .blocks import Blocks, Words, take_set_point
from .ring import HEAD, Ring

# bits of the row's flags: further inputs of the envelope, and the start of memory
FLAG_LOOP_BEGAN = 1  # the first tick of a loop: all memory at rest
FLAG_EMERGENCY = 2  # the drive sent an EMCY since the loop began or a fault was reset
FLAG_REBOOT = 4  # ... a boot-up message
FLAG_NOT_OPERATIONAL = 8  # ... a heartbeat that says that it is not in NMT state OPERATIONAL
FLAG_BUS_OFF = 16  # ... the CAN controller was off the bus, or the interface gone
FLAG_FOREIGN_SYNC = 32  # ... a SYNC of another producer
FLAG_LOCAL_CONTROL = 64  # statusword bit 9 is 0 where the drive serves it: it ignores the controlword
FLAG_IGNORES_TARGET = 128  # statusword bit 12 is 0 where the drive serves it, though the axis is commanded
FLAG_ESTIMATED_VELOCITY = 256  # the error used the estimated velocity, not the drive's
FLAG_ADAPTS = 512  # offset and Coulomb friction are learned in this tick


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


class Baseline(NamedTuple):
    """Counters of the drive when the loop began or a fault was reset; only later changes count."""

    emergencies: int
    boots: int
    bus_losses: int
    nmt_exits: int
    foreign_syncs: int


@njit
def baseline_of(feedback: Any) -> Baseline:
    """The counters now."""
    return Baseline(
        feedback["emergency_count"],
        feedback["boot_count"],
        feedback["bus_losses"],
        feedback["nmt_exits"],
        feedback["foreign_syncs"],
    )


@njit
def wake(port: Any, config: LoopConfig, status: Words, tick: int, deadline_ns: int, last_sync_ns: int) -> Timing:
    """Sleep until the deadline. Missed deadlines are skipped, never caught up.

    After a late SYNC the next one is delayed to keep the minimum distance: later than its deadline, but not lost.
    """
    port_sleep_until(port, max(deadline_ns, last_sync_ns + config.minimum_gap_ns))
    woke_ns = port_now_ns(port)
    missed = max(0, (woke_ns - deadline_ns) // config.period_ns)
    status[b.SKIPPED_TICKS] += missed
    return Timing(tick + missed, deadline_ns + missed * config.period_ns, woke_ns, -1)


@njit
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
    profile = blocks.profiles[cursor.number & 1]
    return cursor, sample, read_reference(feedforward, profile[0], profile[1], cursor.length, sample)


@njit
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

    `before_nm`: the adapted torque of the last tick.
    """
    if not (config.adaptation.used and active) or mode == MODE_CURRENT:
        return NOTHING_ADAPTED, controller
    adapted = NOTHING_ADAPTED
    if toggle == TOGGLE_FEEDFORWARD:
        friction_nm = controller.friction.torque_nm
        if controller.toggle == TOGGLE_OFF:
            friction_nm = observer_start(config.observer, reference.ahead).torque_nm
        adapted = adapted_torque(config.observer.friction, state, friction_nm, reference.ahead)
    if toggle != controller.toggle:
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


@njit
def apply_law(
    config: ControllerConfig, state: ControllerState, mode: int, reference: Reference, velocity_rps: float,
    toggle: int, active: bool, added_nm: float, followed_rps: float,
) -> tuple[LawOutput, ControllerState]:  # fmt: skip
    """The velocity law, an open-loop current, or nothing; the memory rests while the law does not act."""
    if not active:
        return LawOutput(MODE_IDLE, steady_reference(0.0), terms_of_current(0.0)), controller_at_rest()
    if mode == MODE_CURRENT:
        return LawOutput(MODE_CURRENT, steady_reference(0.0), terms_of_current(reference.value)), controller_at_rest()
    terms, state = controller_step(config, state, toggle, reference, velocity_rps, added_nm, followed_rps)
    return LawOutput(MODE_VELOCITY, reference, terms), state


@njit
def terms_of_current(current_a: float) -> ControllerTerms:
    """An open-loop current has no other terms."""
    return ControllerTerms(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, current_a, current_a, False)


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
        feedback["foreign_syncs"] - baseline.foreign_syncs,
        heartbeat_age_ns,
        wanted,
        enabled,
        law.mode == MODE_VELOCITY,
        in_local_control(config.served_status_bits, feedback["statusword"]),
        law.mode != MODE_IDLE and ignores_target(config.served_status_bits, feedback["statusword"]),
        skipped_ticks,
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
    return flags | (FLAG_FOREIGN_SYNC if seen.foreign_syncs > 0 else 0)


@njit
def write_row(
    ring: Ring, head: int, timing: Timing, config: LoopConfig, law: LawOutput, effects_nm: float, adapted: Adapted,
    learned: AdaptationState, estimate: VelocityEstimatorTerms, seen: EnvelopeInputs, feedback: Any,
) -> Any:  # fmt: skip
    """Fill a row with what is known before the command is sent; the loop adds the rest and publishes it."""
    row = ring.rows[head & (ring.rows.size - 1)]
    lateness_ns = timing.woke_ns - timing.deadline_ns
    row["tick"] = timing.tick
    row["row_number"] = head & 0xFFFFFFFF
    row["deadline_ns"] = timing.deadline_ns
    row["lateness_ns"] = lateness_ns
    row["turnaround_ns"] = timing.turnaround_ns
    row["late"] = 1 if lateness_ns > config.late_ns else 0
    row["reference_rps"] = law.reference.value
    row["reference_rps2"] = law.reference.derivative
    row["reference_ahead_rps"] = law.reference.ahead
    row["reference_ahead_rps2"] = law.reference.ahead_derivative
    row["expected_rps"] = law.reference.expected
    row["mode"] = law.mode
    row["error_rps"] = law.terms.error_rps
    row["filtered_error_rps"] = law.terms.filtered_error_rps
    row["proportional_a"] = law.terms.proportional_a
    row["integral_a"] = law.terms.integral_a
    row["friction_nm"] = law.terms.friction_nm
    row["inertia_nm"] = law.terms.inertia_nm
    row["effects_nm"] = effects_nm
    row["adapted_nm"] = adapted.torque_nm
    row["adapted_offset_nm"] = learned.offset_nm
    row["adapted_coulomb_nm"] = learned.coulomb_nm
    row["adapted_viscous_nm_per_rps"] = learned.viscous_nm_per_rps
    row["observation_nm_per_s"] = law.terms.observation_nm_per_s
    row["requested_a"] = law.terms.requested_a
    row["velocity_rps"] = seen.velocity_rps
    row["position_rev"] = seen.position_rev
    row["velocity_age"] = seen.feedback_age
    row["status_age"] = seen.status_age
    row["heartbeat_age_ns"] = seen.heartbeat_age_ns
    row["statusword"] = seen.statusword
    row["current_a"] = feedback["current_a"]
    row["true_velocity_rps"] = feedback["true_velocity_rps"]
    row["estimated_rps"] = estimate.estimated_rps
    row["disturbance_nm"] = estimate.disturbance_nm
    row["true_friction_nm"] = feedback["true_friction_nm"]
    return row


@njit
def publish_tick(ring: Ring, head: int, status: Words, timing: Timing, row: Any) -> None:
    """The row and the status words become visible to other threads."""
    store_release(ring.words, HEAD, head)
    status[b.DEADLINE_NS] = timing.deadline_ns
    status[b.MODE] = row["mode"]
    status[b.TRIP] = row["trip"]
    status[b.STATUSWORD] = row["statusword"]
    status[b.PROFILE_SAMPLE] = row["profile_sample"]
    store_release(status, b.TICK, timing.tick)

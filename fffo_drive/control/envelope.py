"""The envelope, last stage before the bus: clamp the command, or latch a trip. Independent of the controller.

Limits act on the data on the bus only: command, feedback, ages, status of the drive. A trip stays until it is reset;
each has a reaction (coast or quick stop) in the configuration.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..jit import njit

LIMIT_CONTROLLER = 1  # set by the loop: the controller's own current limit
LIMIT_CURRENT = 2
LIMIT_SLEW = 4
LIMIT_I2T = 8
LIMIT_DRIVE = 16  # statusword bit 11: the drive limits internally

TRIP_NONE = 0
TRIP_NOT_A_NUMBER = 1
TRIP_OVERSPEED = 2
TRIP_POSITION_WINDOW = 3
TRIP_FOLLOWING_ERROR = 4
TRIP_I2T = 5
TRIP_FEEDBACK_MISSING = 6
TRIP_STATUS_MISSING = 7
TRIP_DRIVE_FAULT = 8
TRIP_EMERGENCY = 9
TRIP_BUS_OFF = 10
TRIP_HEARTBEAT = 11
TRIP_REBOOT = 12
TRIP_DRIVE_LEFT = 13
TRIP_NOT_OPERATIONAL = 14
TRIP_FOREIGN_COMMAND = 15
TRIP_LOCAL_CONTROL = 16
TRIP_NOT_FOLLOWING = 17
TRIP_SETTINGS_CHANGED = 18
TRIP_OSCILLATION = 19
TRIP_COUNT = 20

TRIP_NAMES = {  # as axis files, messages and the manual have them
    value: name.removeprefix("TRIP_").lower()
    for name, value in list(globals().items())
    if name.startswith("TRIP_") and value not in (TRIP_NONE, TRIP_COUNT)
}
TRIP_TEXTS = {
    TRIP_NONE: "no fault",
    TRIP_NOT_A_NUMBER: "command or feedback is not a finite number",
    TRIP_OVERSPEED: "velocity beyond envelope.speed_limit_rps",
    TRIP_POSITION_WINDOW: "position outside envelope.position_window_rev",
    TRIP_FOLLOWING_ERROR: "velocity error beyond envelope.following_error_rps for longer than following_error_s",
    TRIP_OSCILLATION: (
        "the command reverses at its limit for longer than envelope.following_error_s: a resonance, a lost load or a "
        "wrong model; diagnose the recording, and tune again"
    ),
    TRIP_I2T: "I2t: continuous current exceeded for too long",
    TRIP_FEEDBACK_MISSING: "velocity feedback missing for envelope.feedback_missing_ticks periods",
    TRIP_STATUS_MISSING: "statusword missing for envelope.status_missing_ticks periods",
    TRIP_DRIVE_FAULT: "the drive reports a fault (statusword)",
    TRIP_EMERGENCY: "the drive sent an emergency message (EMCY)",
    TRIP_BUS_OFF: "the CAN controller is off the bus, or the interface is gone",
    TRIP_HEARTBEAT: "the drive's heartbeat is missing",
    TRIP_REBOOT: "the drive rebooted while in use",
    TRIP_DRIVE_LEFT: "the drive left Operation Enabled by itself",
    TRIP_NOT_OPERATIONAL: "the drive left NMT state operational, as its heartbeat says",
    TRIP_FOREIGN_COMMAND: "somebody else sends what only this program may send",
    TRIP_LOCAL_CONTROL: (
        "the drive is in local control and ignores the controlword (statusword bit 9 is 0): give control to the bus; "
        "for a drive that never sets this bit: drive.unserved_status_bits: [9]"
    ),
    TRIP_NOT_FOLLOWING: (
        "the drive does not follow the target torque 0x6071 (statusword bit 12 is 0 in Operation Enabled): see its "
        "mode, limit switches and interlock; for a drive that never sets this bit: drive.unserved_status_bits: [12]"
    ),
    TRIP_SETTINGS_CHANGED: "a setting of the drive is no longer what it was given when it was brought up",
}

REACTION_COAST = 0
REACTION_QUICK_STOP = 1

_BRAKES = "the drive still obeys, and brakes on its own: nothing that this program computes or measures is needed"
_IN_CASE = "if the drive receives and obeys it, the drive brakes; if not, nothing is lost"
# reaction to each trip unless envelope.reactions overrides it, and the reason
DEFAULT_REACTIONS = {
    TRIP_NOT_A_NUMBER: (REACTION_QUICK_STOP, _BRAKES),
    TRIP_OVERSPEED: (REACTION_QUICK_STOP, _BRAKES),
    TRIP_POSITION_WINDOW: (REACTION_QUICK_STOP, _BRAKES),
    TRIP_FOLLOWING_ERROR: (REACTION_QUICK_STOP, _BRAKES),
    TRIP_OSCILLATION: (REACTION_QUICK_STOP, _BRAKES),
    TRIP_I2T: (REACTION_QUICK_STOP, "braking takes little time compared with the thermal time constant"),
    TRIP_FEEDBACK_MISSING: (REACTION_QUICK_STOP, _IN_CASE),
    TRIP_STATUS_MISSING: (REACTION_QUICK_STOP, _IN_CASE),
    TRIP_DRIVE_FAULT: (
        REACTION_QUICK_STOP, "its fault reaction (0x605E) is already running; a controlword of 0 (coast) could cut it "
        "short",
    ),
    TRIP_EMERGENCY: (
        REACTION_QUICK_STOP, "a drive that stays in Operation Enabled trusts its own feedback and brakes; one that "
        "does not goes through its fault reaction (0x605E), which a quick stop does not disturb",
    ),
    TRIP_BUS_OFF: (
        REACTION_QUICK_STOP, "nothing can be sent now: the drive stops by 0x6007; the quick stop is sent when the bus "
        "is back",
    ),
    TRIP_HEARTBEAT: (REACTION_QUICK_STOP, _IN_CASE),
    TRIP_REBOOT: (
        REACTION_COAST, "no torque is left to brake with, and its quick-stop settings are no longer those of this "
        "program",
    ),
    TRIP_DRIVE_LEFT: (REACTION_QUICK_STOP, _IN_CASE),
    TRIP_NOT_OPERATIONAL: (
        REACTION_QUICK_STOP, "the drive stops by 0x6007; the quick stop takes effect when it is operational again",
    ),
    TRIP_FOREIGN_COMMAND: (REACTION_QUICK_STOP, _BRAKES),
    TRIP_LOCAL_CONTROL: (REACTION_QUICK_STOP, _IN_CASE),
    TRIP_NOT_FOLLOWING: (REACTION_QUICK_STOP, "the drive ignores the target torque, but not the controlword"),
    TRIP_SETTINGS_CHANGED: (REACTION_QUICK_STOP, _BRAKES),
}  # fmt: skip

UNHEEDED_S = 0.125  # a drive may set bits 9 and 12 this much later than the state to which they belong
# half a period of 10 Hz, the slowest oscillation that counts as one: a shorter pause between two excesses of the error,
# or between two reversals at the limit, ends neither
PAUSE_S = 0.05

STATUS_INTERNAL_LIMIT = 1 << 11  # CiA 402, 0x6041
STATUS_FAULT = 1 << 3


class EnvelopeConfig(NamedTuple):
    """Limits. `reactions` (TRIP_COUNT,) int64 holds REACTION_* for each trip."""

    current_limit_a: float
    slew_a_per_s: float
    speed_limit_rps: float
    continuous_current_a: float  # I2t: largest permanent current
    i2t_time_s: float  # how long current_limit_a is allowed from cold
    i2t_trips: bool  # False: cut to the continuous current instead
    position_low_rev: float
    position_high_rev: float
    following_error_rps: float
    following_error_s: float
    feedback_missing_ticks: int
    status_missing_ticks: int
    heartbeat_timeout_ns: int  # 0: the drive's heartbeat is not monitored
    period_s: float
    reactions: Any


class EnvelopeState(NamedTuple):
    """Memory of the envelope."""

    last_command_a: float
    i2t_a2s: float  # heat above the continuous current, A^2 s; a reset does not cool the motor
    following_s: float  # how long the velocity error has been too large, short pauses included
    was_enabled: bool
    unheeded_s: float  # how long the drive has reported that it ignores controlword or target
    followed_s: float  # the pause: how long the error has been small again
    limited_side: float  # sign of the command when it was last at its limit; 0.0: not yet
    reversing_s: float  # how long the command has reversed at its limit, short pauses included
    steady_s: float  # the pause: since the last reversal


class EnvelopeInputs(NamedTuple):
    """Inputs of the envelope in one tick."""

    requested_a: float
    velocity_rps: float
    position_rev: float
    error_rps: float
    feedback_age: int  # ticks
    status_age: int
    statusword: int
    emergencies: int  # EMCY frames since the loop began
    reboots: int  # boot-up messages since the loop began
    not_operational: bool  # a heartbeat says that the drive is not in NMT state OPERATIONAL, or was not for a while
    bus_off: bool
    foreign_frames: int  # frames that only we may send, from somebody else, since the loop began
    heartbeat_age_ns: int  # -1: none received yet
    settings_changes: int  # objects of the drive that were changed since the loop began
    wanted: bool  # torque is wanted in this tick
    enabled: bool  # the drive is in Operation Enabled
    closed_loop: bool  # the velocity loop is closed, so the error is meaningful
    local_control: bool  # the drive reports that it ignores the controlword
    ignores_target: bool  # it reports that it ignores 0x6071 while it is commanded
    skipped_ticks: int  # since the last step: deadlines missed, with the last command held
    limited: bool  # whoever requests the command has cut it to a limit of its own


@njit
def envelope_with_heat(i2t_a2s: float) -> EnvelopeState:
    """Memory at rest of a motor with this heat above its continuous current."""
    return EnvelopeState(0.0, i2t_a2s, 0.0, False, 0.0, 0.0, 0.0, 0.0, 0.0)


@njit
def envelope_at_rest() -> EnvelopeState:
    """Memory before the first tick."""
    return envelope_with_heat(0.0)


@njit
def envelope_after_reset(state: EnvelopeState) -> EnvelopeState:
    """Memory after a reset: at rest, but with the I2t heat kept, or each reset would allow peak current again."""
    return envelope_with_heat(state.i2t_a2s)


@njit
def find_trip(config: EnvelopeConfig, state: EnvelopeState, seen: EnvelopeInputs) -> int:
    """The first reason to trip, the most certain first; TRIP_NONE if there is none."""
    if seen.bus_off:
        return TRIP_BUS_OFF
    if seen.foreign_frames > 0:  # before the effects of another master on the drive: the cause is reported
        return TRIP_FOREIGN_COMMAND
    if seen.reboots > 0:
        return TRIP_REBOOT
    if seen.emergencies > 0:
        return TRIP_EMERGENCY
    if seen.statusword & STATUS_FAULT:
        return TRIP_DRIVE_FAULT
    if seen.not_operational:
        return TRIP_NOT_OPERATIONAL
    if config.heartbeat_timeout_ns > 0 and seen.heartbeat_age_ns > config.heartbeat_timeout_ns:
        return TRIP_HEARTBEAT
    if seen.settings_changes > 0:
        return TRIP_SETTINGS_CHANGED
    if not seen.wanted:
        return TRIP_NONE
    # from here on: reasons that apply only with torque
    if state.was_enabled and not seen.enabled:
        return TRIP_DRIVE_LEFT
    if not (math.isfinite(seen.requested_a) and math.isfinite(seen.error_rps)):
        return TRIP_NOT_A_NUMBER
    if not (math.isfinite(seen.velocity_rps) and math.isfinite(seen.position_rev)):
        return TRIP_NOT_A_NUMBER
    if seen.feedback_age >= config.feedback_missing_ticks:
        return TRIP_FEEDBACK_MISSING
    if seen.status_age >= config.status_missing_ticks:
        return TRIP_STATUS_MISSING
    if state.unheeded_s > UNHEEDED_S:
        return TRIP_LOCAL_CONTROL if seen.local_control else TRIP_NOT_FOLLOWING
    if abs(seen.velocity_rps) > config.speed_limit_rps:
        return TRIP_OVERSPEED
    if not config.position_low_rev <= seen.position_rev <= config.position_high_rev:
        return TRIP_POSITION_WINDOW
    if state.reversing_s > config.following_error_s and state.steady_s == 0.0:
        return TRIP_OSCILLATION
    if state.following_s > config.following_error_s and state.followed_s == 0.0:
        return TRIP_FOLLOWING_ERROR
    if config.i2t_trips and state.i2t_a2s > i2t_capacity_a2s(config):
        return TRIP_I2T
    return TRIP_NONE


@njit
def i2t_capacity_a2s(config: EnvelopeConfig) -> float:
    """I2t budget above the continuous current, A^2 s: the current limit for `i2t_time_s` from cold."""
    continuous_a2 = config.continuous_current_a * config.continuous_current_a
    return (config.current_limit_a * config.current_limit_a - continuous_a2) * config.i2t_time_s


@njit
def clamp_command(config: EnvelopeConfig, state: EnvelopeState, requested_a: float) -> tuple[float, int]:
    """Current, I2t and slew limits. Returns (command_a, LIMIT_* bits).

    The current limit is applied last: a limit lowered while running acts at once, however slow the slew.
    """
    limits = 0
    limit_a = config.current_limit_a
    if not config.i2t_trips and state.i2t_a2s > i2t_capacity_a2s(config):
        limit_a = config.continuous_current_a
        if abs(requested_a) > limit_a:
            limits |= LIMIT_I2T
    command_a = min(max(requested_a, -limit_a), limit_a)
    if command_a != requested_a:
        limits |= LIMIT_CURRENT
    step_a = config.slew_a_per_s * config.period_s
    slewed_a = min(max(command_a, state.last_command_a - step_a), state.last_command_a + step_a)
    if slewed_a != command_a:
        limits |= LIMIT_SLEW
    return min(max(slewed_a, -config.current_limit_a), config.current_limit_a), limits


@njit
def heat_after(config: EnvelopeConfig, heat_a2s: float, current_a: float, time_s: float) -> float:
    """Heat above the continuous current after a current has flowed for a time, A^2 s; below it the motor cools."""
    excess_a2 = current_a * current_a - config.continuous_current_a * config.continuous_current_a
    return max(0.0, heat_a2s + excess_a2 * time_s)


@njit
def lasting(lasts_s: float, pause_s: float, seen: bool, step_s: float) -> tuple[float, float]:
    """How long something has lasted, pauses shorter than PAUSE_S included, and how long the present pause is.

    An alternating error is below its limit twice a period, for a third of the time and more: that is a pause, no end.
    """
    if seen:
        return lasts_s + step_s, 0.0
    pause_s += step_s
    if lasts_s == 0.0 or pause_s >= PAUSE_S:
        return 0.0, 0.0
    return lasts_s + step_s, pause_s


@njit
def side_at_limit(config: EnvelopeConfig, seen: EnvelopeInputs) -> float:
    """Sign of a command that is at a limit: the controller's, the envelope's or the drive's own; 0.0 below them."""
    limited = seen.limited or seen.statusword & STATUS_INTERNAL_LIMIT != 0
    if not limited and abs(seen.requested_a) < config.current_limit_a:
        return 0.0
    return math.copysign(1.0, seen.requested_a)


@njit
def watch_loop(config: EnvelopeConfig, state: EnvelopeState, seen: EnvelopeInputs, heat_a2s: float) -> EnvelopeState:
    """Memory with this tick added: how long error, reversals at the limit and a drive that ignores us have lasted."""
    step_s = (seen.skipped_ticks + 1) * config.period_s
    following_s, followed_s, side, reversing_s, steady_s = 0.0, 0.0, 0.0, 0.0, 0.0
    if seen.wanted and seen.closed_loop:
        beyond = abs(seen.error_rps) > config.following_error_rps
        following_s, followed_s = lasting(state.following_s, state.followed_s, beyond, step_s)
        side = side_at_limit(config, seen)
        reverses = side * state.limited_side < 0.0
        side = state.limited_side if side == 0.0 else side
        reversing_s, steady_s = lasting(state.reversing_s, state.steady_s, reverses, step_s)
    unheeded_s = 0.0
    if seen.wanted and (seen.local_control or seen.ignores_target):
        unheeded_s = state.unheeded_s + step_s
    return EnvelopeState(
        state.last_command_a,
        heat_a2s,
        following_s,
        state.was_enabled,
        unheeded_s,
        followed_s,
        side,
        reversing_s,
        steady_s,
    )


@njit
def envelope_step(
    config: EnvelopeConfig, state: EnvelopeState, seen: EnvelopeInputs
) -> tuple[float, int, int, EnvelopeState]:
    """Return (command_a, limits, trip, state). With a trip, or if no torque is requested, the command is 0."""
    held_s = seen.skipped_ticks * config.period_s
    state = watch_loop(config, state, seen, heat_after(config, state.i2t_a2s, state.last_command_a, held_s))

    trip = find_trip(config, state, seen)
    command_a = 0.0
    limits = 0
    if trip == TRIP_NONE and seen.wanted:
        command_a, limits = clamp_command(config, state, seen.requested_a)
        if seen.statusword & STATUS_INTERNAL_LIMIT:
            limits |= LIMIT_DRIVE

    after = EnvelopeState(
        command_a,
        heat_after(config, state.i2t_a2s, command_a, config.period_s),
        state.following_s,
        seen.wanted and seen.enabled,
        state.unheeded_s,
        state.followed_s,
        state.limited_side,
        state.reversing_s,
        state.steady_s,
    )
    return command_a, limits, trip, after


def default_reactions() -> np.ndarray[Any, np.dtype[np.int64]]:
    """DEFAULT_REACTIONS by number: quick stop where the drive may still brake."""
    reactions = np.full(TRIP_COUNT, REACTION_QUICK_STOP, dtype=np.int64)
    for trip, (reaction, _) in DEFAULT_REACTIONS.items():
        reactions[trip] = reaction
    return reactions

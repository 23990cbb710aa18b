"""PI with friction observer as one step: terms out, memory in and out, a toggle that switches without a bump.

i = Kp e + Ki int(e) + H + (F + E) / Kt,    e: the error behind notches (control/notch) and a low-pass
                                            H: at rest, the position hold (control/position_hold)
                                            F from the observer: off, on the reference (FF) or on the measured
                                            velocity (FB)
                                            E from the effects of the model (control/compensation), and what was
                                            learned in service (control/adaptation)
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..jit import njit
from ..model.friction import FrictionState
from ..packing import flat_names, pack, reader
from .adaptation import NO_ADAPTATION, AdaptationConfig
from .feedforward import FeedforwardConfig, Reference, stands_still
from .friction_observer import (
    TOGGLE_NONE,
    TOGGLE_OFF,
    ObserverConfig,
    observer_release,
    observer_start,
    observer_step,
    observer_velocity_rps,
)
from .notch import NO_NOTCHES, NotchConfig, NotchState, notch_step, notches_at_rest, notches_settled
from .pi import PiConfig, pi_step
from .position_hold import NO_HOLD, HoldConfig, HoldState, hold_step, nothing_held, within_bound
from .velocity_estimator import DRIVE_VELOCITY, VelocityEstimatorConfig


class RestConfig(NamedTuple):
    """Changes while the reference is zero; they end with the first tick of motion."""

    gain_share: float  # of Kp and Ki at rest, where the contact is a spring on the inertia; 1: as in motion
    fade_share: float  # part of the remaining change made in a tick
    release_share: float  # of the friction estimate that is let go in a tick; 0: it is held
    hold: HoldConfig = NO_HOLD  # of the position


AS_IN_MOTION = RestConfig(1.0, 1.0, 0.0)


class ControllerConfig(NamedTuple):
    """Constants of the control law; a live change replaces the whole record at a tick boundary."""

    pi: PiConfig
    observer: ObserverConfig
    feedforward: FeedforwardConfig
    torque_constant_nm_per_a: float
    current_limit_a: float  # of the sum; the envelope has its own
    period_s: float
    error_share: float = 1.0  # of a new error that is taken in a period; 1: the error is not filtered
    rest: RestConfig = AS_IN_MOTION
    velocity: VelocityEstimatorConfig = DRIVE_VELOCITY
    adaptation: AdaptationConfig = NO_ADAPTATION
    notches: NotchConfig = NO_NOTCHES


class ControllerState(NamedTuple):
    """Memory of the control law."""

    integral_a: float
    filtered_error_rps: float
    friction: FrictionState
    toggle: int  # of the last step; a change hands the estimate over
    limited: bool  # the envelope or the limit cut the last command
    rest: float  # 0 in motion, towards 1 at rest: how far the gains have gone to those at rest
    hold: HoldState  # of the position, at rest
    notches: NotchState  # on the error


class ControllerTerms(NamedTuple):
    """What one step computed, for the row."""

    error_rps: float
    filtered_error_rps: float  # what drives the law
    proportional_a: float
    integral_a: float
    hold_a: float
    friction_nm: float
    inertia_nm: float
    observation_nm_per_s: float
    requested_a: float  # sum of the terms, not limited
    command_a: float  # limited
    limited: bool


@njit
def controller_at_rest() -> ControllerState:
    """Memory before the first step, and whenever the drive has no torque."""
    return ControllerState(
        0.0, 0.0, FrictionState(0.0, 0.0, 0.0, 0.0), TOGGLE_NONE, False, 0.0, nothing_held(), notches_at_rest()
    )


@njit
def _with_memory(state: ControllerState, integral_a: float, notches: NotchState) -> ControllerState:
    """The same with another integral and other memory of the notches."""
    return ControllerState(
        integral_a,
        state.filtered_error_rps,
        state.friction,
        state.toggle,
        state.limited,
        state.rest,
        state.hold,
        notches,
    )


@njit
def _hand_over(
    config: ControllerConfig, state: ControllerState, toggle: int, reference: Reference, velocity_rps: float
) -> ControllerState:
    """Bumpless switch of the observer: the integrator takes over what the estimate loses.

    In the first step there is nothing to hand over: the estimate begins as that of an unloaded contact.
    """
    integral_a, friction = state.integral_a, state.friction
    if toggle == TOGGLE_OFF:
        integral_a = integral_a + friction.torque_nm / config.torque_constant_nm_per_a
        friction = FrictionState(0.0, 0.0, 0.0, 0.0)
    elif state.toggle == TOGGLE_OFF:
        driven_rps = observer_velocity_rps(config.observer, friction, toggle, reference.ahead, velocity_rps)
        friction = observer_start(config.observer, driven_rps)
        integral_a = integral_a - friction.torque_nm / config.torque_constant_nm_per_a
    return ControllerState(
        integral_a, state.filtered_error_rps, friction, toggle, state.limited, state.rest, state.hold, state.notches
    )


@njit
def filtered_error_rps(config: ControllerConfig, before_rps: float, error_rps: float) -> float:
    """The error through a first-order low-pass.

    It filters noise and quantisation of the feedback but not the reference: feed-forward is unaffected, and if the axis
    follows exactly there is nothing to delay.
    """
    if config.error_share >= 1.0:
        return error_rps
    return before_rps + config.error_share * (error_rps - before_rps)


@njit
def _gain_share(config: RestConfig, rest: float) -> float:
    """Share of Kp and Ki that is in force; `rest`: how far the gains have gone to those at rest."""
    return 1.0 - rest * (1.0 - config.gain_share)


@njit
def controller_step(
    config: ControllerConfig, state: ControllerState, toggle: int, reference: Reference, velocity_rps: float,
    added_nm: float, followed_rps: float, position_rev: float,
) -> tuple[ControllerTerms, ControllerState]:  # fmt: skip
    """One period of the law; `added_nm` is fed forward in addition to friction and inertia: effects and adaptation.

    `velocity_rps` is the drive's own velocity, the input of a friction model on feedback; the error uses
    `followed_rps`, which is the same or an estimate (control.velocity_estimator).

    The observation is frozen (lambda = 0) while the last command was limited, and at rest.

    While the reference is zero, lambda would be a second integrator, several times as strong as that of the PI, and an
    axis with stiction would hunt. At rest the PI's integral acts, with the gains at rest, and the position hold;
    in the first tick of motion the integral takes over the hold's current.
    """
    if toggle != state.toggle:
        state = _hand_over(config, state, toggle, reference, velocity_rps)
    error_rps = reference.expected - followed_rps
    passed_rps, notches = error_rps, state.notches
    if config.notches.used:
        passed_rps, notches = notch_step(config.notches, notches, error_rps)
    driving_rps = filtered_error_rps(config, state.filtered_error_rps, passed_rps)

    at_rest = stands_still(reference)
    rest = state.rest + config.rest.fade_share * (1.0 - state.rest) if at_rest else 0.0
    gain_share = _gain_share(config.rest, rest)

    integral_a, hold = state.integral_a, state.hold
    if at_rest and config.rest.hold.bound_a > 0.0:
        hold = hold_step(config.rest.hold, hold, rest, position_rev, state.limited, config.period_s)
        hold, integral_a = within_bound(config.rest.hold, hold, integral_a)
    else:
        integral_a += hold.current_a
        hold = nothing_held()

    friction = state.friction
    observation_nm_per_s = 0.0
    learned_a_per_rev = 0.0
    if toggle != TOGGLE_OFF:
        if not (state.limited or at_rest):
            observation_nm_per_s = config.observer.gain_nm_per_rev * driving_rps
        into_estimate_nm_per_s = observation_nm_per_s
        if config.observer.learns_in_integral:
            into_estimate_nm_per_s = 0.0
            if not at_rest:
                learned_a_per_rev = config.observer.gain_nm_per_rev / config.torque_constant_nm_per_a
        if at_rest and config.rest.release_share > 0.0:
            friction = observer_release(friction, config.rest.release_share)
        else:
            driven_rps = observer_velocity_rps(config.observer, friction, toggle, reference.ahead, velocity_rps)
            friction = observer_step(config.observer, friction, driven_rps, into_estimate_nm_per_s, config.period_s)

    inertia_nm = config.feedforward.inertia_nm_s2_per_rev * reference.ahead_derivative
    feedforward_a = (friction.torque_nm + inertia_nm + added_nm) / config.torque_constant_nm_per_a
    limit_a = config.current_limit_a
    gains = PiConfig(
        gain_share * config.pi.proportional_a_per_rps, gain_share * config.pi.integral_a_per_rev + learned_a_per_rev
    )
    proportional_a, integral_a = pi_step(
        gains, integral_a, driving_rps, hold.current_a + feedforward_a, limit_a, state.limited, config.period_s
    )
    requested_a = proportional_a + integral_a + hold.current_a + feedforward_a
    command_a = min(max(requested_a, -limit_a), limit_a)
    limited = command_a != requested_a
    terms = ControllerTerms(
        error_rps,
        driving_rps,
        proportional_a,
        integral_a,
        hold.current_a,
        friction.torque_nm,
        inertia_nm,
        observation_nm_per_s,
        requested_a,
        command_a,
        limited,
    )
    return terms, ControllerState(integral_a, driving_rps, friction, toggle, limited, rest, hold, notches)


@njit
def with_limited(state: ControllerState, limited: bool) -> ControllerState:
    """The same memory, noting whether the envelope limited the command as well."""
    either = state.limited or limited
    return ControllerState(
        state.integral_a,
        state.filtered_error_rps,
        state.friction,
        state.toggle,
        either,
        state.rest,
        state.hold,
        state.notches,
    )


@njit
def with_new_gains(before: ControllerConfig, after: ControllerConfig, state: ControllerState) -> ControllerState:
    """Bumpless change of gains: the integrator takes over what the proportional term and the bounded estimate lose.

    Other notches begin as after a constant error: they pass what drove the law in the last tick.
    """
    before_a_per_rps = _gain_share(before.rest, state.rest) * before.pi.proportional_a_per_rps
    after_a_per_rps = _gain_share(after.rest, state.rest) * after.pi.proportional_a_per_rps
    change_a = (before_a_per_rps - after_a_per_rps) * state.filtered_error_rps
    bound_nm = after.observer.clamp_nm
    cut_off_nm = state.friction.torque_nm - min(max(state.friction.torque_nm, -bound_nm), bound_nm)
    notches = state.notches
    if after.notches != before.notches:
        notches = notches_settled(after.notches, state.filtered_error_rps)
    integral_a = state.integral_a + change_a + cut_off_nm / after.torque_constant_nm_per_a
    return _with_memory(state, integral_a, notches)


@njit
def adapts_another_model(before: ControllerConfig, after: ControllerConfig) -> bool:
    """Whether the adaptation has to restart: what was learned with one model or bound is invalid with another."""
    return before.adaptation != after.adaptation or before.observer.friction != after.observer.friction


@njit
def with_torque_lost(config: ControllerConfig, state: ControllerState, torque_nm: float) -> ControllerState:
    """Bumpless end of a feed-forward torque: the integrator takes it over."""
    return _with_memory(state, state.integral_a + torque_nm / config.torque_constant_nm_per_a, state.notches)


CONTROLLER_NAMES = flat_names(ControllerConfig)
CONTROLLER_BLOCK_SIZE = len(CONTROLLER_NAMES)
unpack_controller = njit(reader(ControllerConfig, "unpack_controller"))


def pack_controller(config: ControllerConfig) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The record as a flat array, for the block that the loop reads; `unpack_controller` is its inverse."""
    return pack(config)

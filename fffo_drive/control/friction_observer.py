"""Friction observer: the 2SEP model driven by a velocity and by the control error (6), lambda(e) = L e.

Feed-forward (FFFO) computes it on the reference, feedback (FBFO) on the measured velocity; the error corrects both.
"""

from __future__ import annotations

from typing import NamedTuple

from ..jit import njit
from ..model.friction import FrictionConfig, FrictionState, friction_step, settled_friction

TOGGLE_NONE = -1  # before the first step: there is nothing to hand over
TOGGLE_OFF = 0
TOGGLE_FEEDFORWARD = 1  # the paper's switch at "0": reference velocity
TOGGLE_FEEDBACK = 2  # the paper's switch at "1": measured velocity
TOGGLE_NAMES = {TOGGLE_OFF: "off", TOGGLE_FEEDFORWARD: "ff", TOGGLE_FEEDBACK: "fb"}


class ObserverConfig(NamedTuple):
    """Constants of the observer."""

    friction: FrictionConfig
    gain_nm_per_rev: float  # L
    clamp_nm: float  # bound of the estimate's magnitude; a multiple of Fs
    feedback_band_rps: float  # a smaller measured velocity does not reverse the model: a few counts of the sensor
    learns_in_integral: bool = False  # lambda(e) goes to the controller's integral, where it does not decay


@njit
def observer_velocity_rps(
    config: ObserverConfig, state: FrictionState, toggle: int, reference_rps: float, velocity_rps: float
) -> float:
    """The velocity on which the friction is computed."""
    if toggle == TOGGLE_FEEDFORWARD:
        return reference_rps
    if abs(velocity_rps) <= config.feedback_band_rps and velocity_rps * state.direction <= 0.0:
        return 0.0
    return velocity_rps


@njit
def observer_step(
    config: ObserverConfig, state: FrictionState, velocity_rps: float, observation_nm_per_s: float, period_s: float
) -> FrictionState:
    """Estimate after one period, clamped: at w = 0 the observer is a pure integrator of lambda(e)."""
    stepped = friction_step(config.friction, state, velocity_rps, observation_nm_per_s, period_s)
    torque_nm = min(max(stepped.torque_nm, -config.clamp_nm), config.clamp_nm)
    return FrictionState(torque_nm, stepped.travel_rev, stepped.omega_nm, stepped.direction)


@njit
def observer_release(state: FrictionState, share: float) -> FrictionState:
    """Estimate at rest after a tick in which `share` of its torque is released.

    A contact at rest carries the torque that the motor applies. When the torque goes, its spring unloads, and the next
    motion begins with an unloaded contact, in either direction: that is the model at a reversal, with F as it is by
    then.
    """
    return FrictionState((1.0 - share) * state.torque_nm, 0.0, 0.0, 0.0)


@njit
def observer_start(config: ObserverConfig, velocity_rps: float) -> FrictionState:
    """Initial estimate when switched on in motion: the steady friction at this velocity, clamped."""
    settled = settled_friction(config.friction, velocity_rps)
    torque_nm = min(max(settled.torque_nm, -config.clamp_nm), config.clamp_nm)
    return FrictionState(torque_nm, settled.travel_rev, settled.omega_nm, settled.direction)

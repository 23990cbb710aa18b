"""The drive's own velocity loop: PI at 8 kHz in the drive, alone or beside the torque that the PC adds (CSV, 0x60B2).

Its delay is shorter than that over the bus, so the same margins allow higher gains. The PC sends the set point ahead by
what the bus takes, and the drive interpolates it linearly. The torque is friction and inertia along the reference,
ahead by what the drive's command takes; each value is held for a period of the PC. Beside it the set point is as old as
the velocity that the drive compares it with.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...arrays import Floats
from ...control.reference import Profile
from ...control.stability import LinearAxis
from ...drive.simulated.parameters import PlantConfig, delay_budget
from ...identification.tuning import Gains, Wish, gains_in_motion
from ...model.friction import FrictionConfig

PER_TICK = 4  # of its periods in one of the loop over the bus at 2 kHz
DELAYS_S = (0.002, 0.001)  # from the shaft's velocity to torque and back to the velocity, hold included
TORQUE_RATES_HZ = (1000.0, 250.0)  # of the PC
FASTEST_TRACKING_HZ = 2000.0
ROUNDING_S = 1e-9  # of a sum of delays


class TorqueOffset(NamedTuple):
    """What the PC knows of the axis, and how often it sends a torque."""

    friction: FrictionConfig
    inertia_nm_s2_per_rev: float
    rate_hz: float


class DriveLoop(NamedTuple):
    """A velocity loop in the drive."""

    delay_s: float
    torque: TorqueOffset | None = None


def as_the_drive_has_it(plant: PlantConfig, delay_s: float, period_s: float) -> PlantConfig:
    """The plant behind the loop in its drive: the same axis and converter, with a shorter delay.

    A drive whose tracking loop alone takes longer than that has a faster one. Raises PlantConfigError if none is fast
    enough.
    """
    own = replace(plant, delay_s=delay_s, sync_period_s=period_s)
    budget = delay_budget(own)
    if budget.transport_s < 0.0:
        resolver = own.resolver
        lag_s = budget.tracking_loop_s + budget.transport_s - ROUNDING_S
        half_step_s = resolver.tracking_damping / (math.pi * resolver.tracking_hz) - budget.tracking_loop_s
        if lag_s + half_step_s > 0.0:
            tracking_hz = min(resolver.tracking_damping / (math.pi * (lag_s + half_step_s)), FASTEST_TRACKING_HZ)
            own = replace(own, resolver=replace(resolver, tracking_hz=tracking_hz))
    return own.validate()


def finer(profile: Profile, ticks: int) -> Profile:
    """The profile as a drive interpolates it, with so many samples for each; the first of each is the PC's own."""
    samples = np.arange(profile.values.size * ticks) / ticks
    known = np.arange(profile.values.size)
    values, derivatives = (np.interp(samples, known, column) for column in (profile.values, profile.derivatives))
    return profile._replace(period_s=profile.period_s / ticks, values=values, derivatives=derivatives)


def offsets_nm(torque: TorqueOffset, profile: Profile, ahead_s: float) -> Floats:
    """The torque at each sample of a profile (n,): that of `ahead_s` later, at the middle of its period of the PC."""
    from .fit import friction_along  # compiles the models

    wanted_nm = friction_along(torque.friction, profile.values, profile.period_s)
    wanted_nm += torque.inertia_nm_s2_per_rev * profile.derivatives
    held = round(1.0 / (torque.rate_hz * profile.period_s))
    samples = np.arange(profile.values.size)
    middle = samples // held * held + 0.5 * (held - 1)
    return np.asarray(np.interp(middle + ahead_s / profile.period_s, samples, wanted_nm))


@functools.lru_cache(maxsize=8)
def _of_one(wish: Wish, scale_s: float) -> Gains:
    """For an inertia and torque constant of 1 without viscous friction."""
    return Gains(*gains_in_motion(LinearAxis(1.0, 0.0, scale_s, 1.0), wish))


def drive_gains(
    inertia_nm_s2_per_rev: float, torque_constant_nm_per_a: float, delay_s: float, wish: Wish
) -> tuple[float, float]:
    """Kp in A/rps and Ki in A/rev with the most integral action within the margins.

    Without viscous friction, which helps, the loop is the same for every axis with time in units of the delay.
    """
    found = _of_one(wish, DELAYS_S[0])
    faster = DELAYS_S[0] / delay_s
    current = inertia_nm_s2_per_rev / torque_constant_nm_per_a
    proportional, integral = found.proportional_a_per_rps, found.integral_action_nm_per_rev(1.0)
    return proportional * current * faster, integral * current * faster**2

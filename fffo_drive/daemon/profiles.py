"""Profiles for `start`, by name or from the request, checked against the limits; and the ramp of a stop."""

from __future__ import annotations

import difflib
import math

import numpy as np

from ..config.axis import build_profile
from ..config.checks import motion_problems, profile_problems
from ..config.profile_sections import ProfileSection
from ..config.sections import length_problems
from ..control.reference import MODE_VELOCITY, Profile
from ..documents import DocumentError
from ..workflows.plan import Plan
from .parameters import DEFAULT_PROFILE

STOP = "stop"  # name of the ramp


def profile_names(plan: Plan) -> tuple[str, ...]:
    """Names accepted by `start`."""
    return (DEFAULT_PROFILE, *plan.axis.daemon.profiles)


def chosen_profile(plan: Plan, wanted: str | ProfileSection) -> Profile:
    """The profile of that name or section. Raises DocumentError if there is none, or it exceeds the limits."""
    if isinstance(wanted, str):
        if wanted == DEFAULT_PROFILE:
            return plan.profile
        section = plan.axis.daemon.profiles.get(wanted)
        if section is None:
            close = difflib.get_close_matches(wanted, profile_names(plan), 1)
            hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(profile_names(plan))}"
            raise DocumentError(f"no profile '{wanted}' in {plan.path} (daemon.profiles); {hint}")
        name = wanted
    else:
        section, name = wanted, wanted.kind
    too_long = length_problems(section, plan.axis.loop)
    if too_long:
        raise DocumentError("\n".join(too_long))
    profile = build_profile(section, plan.axis.loop.period_s)._replace(name=name)
    problems = profile_problems(plan.axis, profile) + motion_problems(plan.axis, profile, plan.model)
    if problems:
        raise DocumentError("\n".join(problems))
    return profile


def braking_ramp(velocity_rps: float, deceleration_rps2: float, period_s: float) -> Profile:
    """Ramp from a velocity to standstill; begins one period later, when the loop takes it."""
    start = velocity_rps if math.isfinite(velocity_rps) else 0.0
    ticks = max(1, math.ceil(abs(start) / (deceleration_rps2 * period_s)))
    slope = -start / (ticks * period_s)
    values = start + slope * period_s * np.arange(1, ticks + 1, dtype=np.float64)
    derivatives = np.full(ticks, slope, dtype=np.float64)
    values[-1] = derivatives[-1] = 0.0
    return Profile(STOP, MODE_VELOCITY, period_s, values.astype(np.float64), derivatives)

"""What it costs that a file switches a part of the law off, or that the load changes: by the model, on its motion.

With every part on, and a right model, the shaft follows the reference. A part that is off leaves the loop a torque to
make by itself, and the velocity error by which it makes it is that torque over impedance and controller,

    error = torque / (Z + C exp(-s Td)),    Z = J s + D,  C = (Kp Kt + (Ki Kt + L) / s) N / (1 + s Tf)

with the notches N. It is evaluated over the spectrum of the torque along the reference, with friction as its
steady-state curve. Each part is taken alone, with all others on. With another load the torque is what feed-forward
makes too much or too little. No kernel of the law runs: a check of a file takes no time for it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats
from ..control.feedforward import FeedforwardConfig
from ..control.reference import MODE_VELOCITY, Profile, piecewise_linear
from ..control.stability import LinearAxis, error_response, impedance_nm_per_rps, over_loads
from ..model.friction import FrictionConfig, least_sliding_nm, steady_friction_along
from ..model.parameters import ModelFile
from .axis import AxisFile, feedforward_config, loop_axis
from .sections import FeedforwardSection

Complexes = npt.NDArray[np.complexfloating[Any, Any]]

LONGEST_S = 60.0  # of the reference: the rest of a longer one is like it
BEHIND_S = 1.0  # behind the reference, back to standstill, so that its end does not act on its beginning
DOUBT_SHARE = 0.1  # of the friction that the model has: what the observer is there for


class PartCost(NamedTuple):
    """What a part that is off costs. The errors are those of the shaft; nan at rest, where the loop is another one."""

    key: str  # in the file
    torque_nm: float  # that the loop has to make by itself, or that it makes for nothing: the largest
    largest_rps: float
    rms_rps: float
    why: str

    def __str__(self) -> str:
        expected = (
            "expect the axis to creep"
            if math.isnan(self.largest_rps)
            else f"expect velocity errors of up to {self.largest_rps:.2g} rps ({self.rms_rps:.2g} rps rms)"
        )
        return f"{self.key} {self.why}; {expected}"


def law_costs(axis: AxisFile, model: ModelFile, profile: Profile, observer_on: bool) -> list[PartCost]:
    """Each part of the best law that this file has off, with its cost, and the load that costs most; else none."""
    controller = axis.controller
    feedforward, at_rest = controller.feedforward, controller.at_rest
    costs = [
        (observer_on, _friction),
        (feedforward.inertia, _inertia),
        (feedforward.preview, _preview),
        (feedforward.delay_aware, _delay_aware),
        (not observer_on or controller.observer.learns_in == "integral", _learning),
    ]
    off = [cost for on, cost in costs if not on]
    if feedforward.inertia and controller.inertia_range_kg_m2 is not None:
        off.append(_load)
    motion = _Motion.of(axis, model, profile, observer_on) if off else None
    found = [cost(motion) for cost in off if motion is not None]
    friction = model.friction_config()
    if observer_on and not at_rest.release_friction:
        found.append(_release(friction))
    if at_rest.hold_a_per_rev_s == 0.0:
        found.append(_hold(at_rest.hold_bound_share * least_sliding_nm(friction, axis.envelope.speed_limit_rps)))
    return found


class _Motion(NamedTuple):
    """The reference, arrays (n,), and what the loop is to the axis."""

    samples: int  # of the reference; what follows is the way back to standstill
    period_s: float
    velocity_rps: Floats
    acceleration_rps2: Floats
    friction_nm: Floats
    axis: LinearAxis
    shifts: FeedforwardConfig  # with every part on
    s: Complexes
    proportional_nm_per_rps: float
    integral_nm_per_rev: float
    observer_nm_per_rev: float

    @classmethod
    def of(cls, axis: AxisFile, model: ModelFile, profile: Profile, observer_on: bool) -> _Motion:
        """Of a file; a live set point takes the place of a profile without a velocity."""
        section, period_s, kt = axis.controller, axis.loop.period_s, model.torque_constant_nm_per_a
        if profile.mode != MODE_VELOCITY:
            profile = _set_point(axis)
        samples = min(profile.values.size, round(LONGEST_S / period_s))
        behind = np.linspace(1.0, 0.0, round(BEHIND_S / period_s) + samples % 2)  # an even number, for the transform
        velocity_rps = np.concatenate((profile.values[:samples], profile.values[samples - 1] * behind))
        return cls(
            samples,
            period_s,
            velocity_rps,
            np.concatenate((profile.derivatives[:samples], 0.0 * behind)),
            np.sign(velocity_rps) * steady_friction_along(model.friction_config(), velocity_rps),
            loop_axis(axis, model),
            feedforward_config(FeedforwardSection(), model, period_s, section.velocity),
            2j * math.pi * np.fft.rfftfreq(velocity_rps.size, period_s)[1:],
            section.proportional_a_per_rps * kt,
            section.integral_a_per_rev * kt,
            section.observer.gain_nm_per_rev if observer_on else 0.0,
        )

    def late(self, values: Floats, ticks: float) -> Floats:
        """Values so many periods later."""
        places = np.arange(values.size)
        return np.asarray(np.interp(places - ticks, places, values, left=0.0))

    def controller(self, learned_share: float = 1.0) -> Complexes:
        """C, Nm/rps, with a share of the observer's L."""
        integral = self.integral_nm_per_rev + learned_share * self.observer_nm_per_rev
        return np.asarray((self.proportional_nm_per_rps + integral / self.s) * error_response(self.axis, self.s))

    def response(self, transfer: Complexes, values: Floats) -> Floats:
        """What a linear system makes of values; nothing of their mean, which the integral takes."""
        found = np.fft.rfft(values)
        found[1:] *= transfer
        found[0] = 0.0
        return np.asarray(np.fft.irfft(found, values.size))

    def error_rps(self, torque_nm: Floats, learned_share: float = 1.0) -> Floats:
        """Velocity error of the shaft where the loop has to make this torque."""
        late = np.exp(-self.s * self.axis.delay_s)
        loop = impedance_nm_per_rps(self.axis, self.s) + self.controller(learned_share) * late
        return self.response(1.0 / loop, torque_nm)

    def largest(self, values: Floats) -> float:
        """Along the reference."""
        return float(np.max(np.abs(values[: self.samples])))

    def cost(self, key: str, torque_nm: Floats, error_rps: Floats, why: str) -> PartCost:
        """The numbers along the reference; `{torque}` in `why` is the torque."""
        torque, error = self.largest(torque_nm), error_rps[: self.samples]
        rms_rps = float(np.sqrt(np.mean(error * error)))
        return PartCost(
            f"controller.{key}", torque, self.largest(error_rps), rms_rps, why.format(torque=f"{torque:.2g} Nm")
        )


def _set_point(axis: AxisFile) -> Profile:
    """To the largest set point and back, with the bound of the acceleration."""
    asked = axis.daemon.set_points
    highest_rps = asked.largest_rps or axis.envelope.speed_limit_rps
    ramp_s = highest_rps / asked.acceleration_rps2
    times_s = np.cumsum([0.0, 0.1, ramp_s, 0.5, ramp_s, 0.1])
    speeds_rps = highest_rps * np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
    return piecewise_linear("set point", MODE_VELOCITY, axis.loop.period_s, times_s, speeds_rps)


def _friction(motion: _Motion) -> PartCost:
    torque_nm = motion.friction_nm
    why = "is off: the loop has to make up to {torque} of friction by itself"
    return motion.cost("observer.toggle", torque_nm, motion.error_rps(torque_nm), why)


def _inertia(motion: _Motion) -> PartCost:
    torque_nm = motion.axis.inertia_nm_s2_per_rev * motion.acceleration_rps2
    why = f"is off: at {motion.largest(motion.acceleration_rps2):.3g} rps2 the loop has to make {{torque}} by itself"
    return motion.cost("feedforward.inertia", torque_nm, motion.error_rps(torque_nm), why)


def _load(motion: _Motion) -> PartCost:
    """The end of the range of inertia with the larger error."""
    own = motion.axis.inertia_nm_s2_per_rev

    def cost(axis: LinearAxis) -> PartCost:
        torque_nm = (axis.inertia_nm_s2_per_rev - own) * motion.acceleration_rps2
        why = (
            f"is a range: with {axis.inertia_nm_s2_per_rev / own:.3g} times the model's inertia the loop has to "
            "make up to {torque} that feed-forward does not know"
        )
        return motion.cost("inertia_range_kg_m2", torque_nm, motion._replace(axis=axis).error_rps(torque_nm), why)

    return max((cost(axis) for axis in over_loads(motion.axis)), key=lambda one: one.largest_rps)


def _preview(motion: _Motion) -> PartCost:
    """Torque and the reference of the error are both late by the way from command to torque."""
    ahead = motion.shifts.ahead_ticks
    needed_nm = motion.axis.inertia_nm_s2_per_rev * motion.acceleration_rps2 + motion.friction_nm
    error_rps = motion.velocity_rps - motion.late(motion.velocity_rps, ahead)
    why = f"is off: torque comes {1e3 * ahead * motion.period_s:.2g} ms late, and up to {{torque}} of it are missing"
    return motion.cost("feedforward.preview", needed_nm - motion.late(needed_nm, ahead), error_rps, why)


def _delay_aware(motion: _Motion) -> PartCost:
    """The loop takes the age of the feedback for an error, and drives the shaft ahead of the reference."""
    ahead, behind = motion.shifts.ahead_ticks, motion.shifts.behind_ticks
    seen_rps = motion.late(motion.velocity_rps, ahead) - motion.late(motion.velocity_rps, ahead + behind)
    error_rps = motion.error_rps(motion.response(motion.controller(), seen_rps))
    torque_nm = motion.response(impedance_nm_per_rps(motion.axis, motion.s), error_rps)
    age_ms = 1e3 * behind * motion.period_s
    why = f"is off: the loop takes {age_ms:.2g} ms of age for an error and makes up to {{torque}} against it"
    return motion.cost("feedforward.delay_aware", torque_nm, error_rps, why)


def _learning(motion: _Motion) -> PartCost:
    """At speed L e decays in the estimate: what the model lacks is left to Kp and Ki."""
    torque_nm = DOUBT_SHARE * motion.friction_nm
    why = (
        "is friction: what the observer learns decays at speed; where the model's friction is "
        f"{100.0 * DOUBT_SHARE:.0f} % wrong, Kp and Ki have to make up to {{torque}} without it"
    )
    return motion.cost("observer.learns_in", torque_nm, motion.error_rps(torque_nm, learned_share=0.0), why)


def _release(friction: FrictionConfig) -> PartCost:
    held_nm = friction.coulomb_nm
    why = f"is off: the friction of the motion before, {held_nm:.2g} Nm, goes on pushing at rest"
    return PartCost("controller.at_rest.release_friction", held_nm, math.nan, math.nan, why)


def _hold(held_nm: float) -> PartCost:
    why = f"is 0: nothing holds the position at rest, where up to {held_nm:.2g} Nm could"
    return PartCost("controller.at_rest.hold_a_per_rev_s", held_nm, math.nan, math.nan, why)

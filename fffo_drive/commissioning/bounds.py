"""Bounds of commissioning, and the envelopes derived from them.

The envelope of the axis file is only ever tightened. It trips before a bound, so that the braking distance stays
inside.
"""

from __future__ import annotations

from typing import NamedTuple

from ..control.adaptation import NO_ADAPTATION
from ..control.controller import AS_IN_MOTION, ControllerConfig
from ..control.envelope import (
    REACTION_QUICK_STOP,
    TRIP_OVERSPEED,
    TRIP_POSITION_WINDOW,
    EnvelopeConfig,
)
from ..control.feedforward import NO_FEEDFORWARD, FeedforwardConfig
from ..control.notch import NO_NOTCHES
from ..control.pi import PiConfig
from ..control.velocity_estimator import DRIVE_VELOCITY

CURRENT_SHARE = 0.5  # of the continuous current
SPEED_SHARE = 0.5  # of the speed limit
SPEED_RPS = 5.0
TRAVEL_REV = 2.0
TIME_S = 120.0
TRIP_SHARE = 0.8  # of a bound, at which the envelope trips
NEVER = float("inf")


class BoundsError(Exception):
    """The limits leave no room to commission the axis."""


class Bounds(NamedTuple):
    """Largest magnitudes. Travel is counted from the initial position."""

    current_a: float
    speed_rps: float
    travel_rev: float
    time_s: float  # of all motion together


def make_bounds(
    envelope: EnvelopeConfig,
    current_a: float | None = None,
    speed_rps: float | None = None,
    travel_rev: float | None = None,
) -> Bounds:
    """Bounds as requested (None: default), inside the envelope. Raises BoundsError for a request beyond it."""
    highest_a = min(envelope.continuous_current_a, envelope.current_limit_a)
    bounds = Bounds(
        CURRENT_SHARE * highest_a if current_a is None else current_a,
        min(SPEED_RPS, SPEED_SHARE * envelope.speed_limit_rps) if speed_rps is None else speed_rps,
        TRAVEL_REV if travel_rev is None else travel_rev,
        TIME_S,
    )
    for name, value, limit, unit in (
        ("current", bounds.current_a, highest_a, "A"),
        ("speed", bounds.speed_rps, envelope.speed_limit_rps, "rps"),
    ):
        if not 0.0 < value <= limit:
            raise BoundsError(f"--{name} {value:g} {unit}: above 0 and at most {limit:g}, the limit of the axis file")
    if not bounds.travel_rev > 0.0:
        raise BoundsError(f"--travel {bounds.travel_rev:g} rev: must be above 0")
    return bounds


def bounded_envelope(envelope: EnvelopeConfig, bounds: Bounds, start_rev: float) -> EnvelopeConfig:
    """The axis' envelope with the bounds of commissioning, around the present position.

    Over-speed and the position window always brake: a coasting axis would leave the bounds. Raises BoundsError when
    the position window of the axis file leaves no room.
    """
    low_rev, high_rev = start_rev - bounds.travel_rev, start_rev + bounds.travel_rev
    if low_rev < envelope.position_low_rev or high_rev > envelope.position_high_rev:
        window = f"[{envelope.position_low_rev:g}, {envelope.position_high_rev:g}]"
        raise BoundsError(
            f"the axis is at {start_rev:.3f} rev and may be moved {bounds.travel_rev:g} rev both ways, but "
            f"envelope.position_window_rev is {window}: move the axis towards its middle, or give a smaller --travel"
        )
    reactions = envelope.reactions.copy()
    reactions[[TRIP_OVERSPEED, TRIP_POSITION_WINDOW]] = REACTION_QUICK_STOP
    return envelope._replace(
        current_limit_a=bounds.current_a,
        continuous_current_a=min(envelope.continuous_current_a, bounds.current_a),
        speed_limit_rps=TRIP_SHARE * bounds.speed_rps,
        position_low_rev=start_rev - TRIP_SHARE * bounds.travel_rev,
        position_high_rev=start_rev + TRIP_SHARE * bounds.travel_rev,
        following_error_rps=NEVER,  # no loop is closed, or a slow one: there is nothing to follow
        reactions=reactions,
    )


class SlowLoop(NamedTuple):
    """A velocity loop that is far slower than any resonance that is looked for, beside a current that is planned."""

    proportional_a_per_rps: float
    integral_a_per_rev: float
    error_share: float  # of a new error that is taken in a period: above, a resonance is not fed back
    behind_ticks: float  # from a command to the velocity that shows it


def slow_loop(controller: ControllerConfig, loop: SlowLoop, current_limit_a: float) -> ControllerConfig:
    """The law of the axis file reduced to this loop. What a profile has as derivative is its planned current, in A."""
    return controller._replace(
        pi=PiConfig(loop.proportional_a_per_rps, loop.integral_a_per_rev),
        feedforward=FeedforwardConfig(controller.torque_constant_nm_per_a, 0.0, loop.behind_ticks),
        current_limit_a=current_limit_a,
        error_share=loop.error_share,
        rest=AS_IN_MOTION,
        velocity=DRIVE_VELOCITY,
        adaptation=NO_ADAPTATION,
        notches=NO_NOTCHES,
    )


def open_loop(controller: ControllerConfig) -> ControllerConfig:
    """A law without gains and with zero current limit: in any mode of the loop, feedback causes no current."""
    return controller._replace(pi=PiConfig(0.0, 0.0), feedforward=NO_FEEDFORWARD, current_limit_a=0.0)

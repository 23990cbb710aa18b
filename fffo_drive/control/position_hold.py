"""Hold of the position at rest: a contact that creeps by some counts a second is nothing that a velocity loop sees.

When the axis has come to rest its position is latched. From then on an integral of the distance beyond a dead band adds
a current that brings the axis back. It need be no faster than the contact gives way.

Its bound is a share of the least friction in sliding. It cannot move the axis over its contact; where a hand or a stop
holds the axis it stays at its bound; and in sliding, friction takes more power than it can give, whatever its phase.
The linear margins therefore count on the contact that sticks (control/stability). An axis that is moved farther than
its contact's travel has slid: it is held where it is then, the travel behind, and not brought back all the way.

What the model lacked while the axis moved is in the velocity loop's integral when it stops. Where that is more than
the bound, as with a model of too little Coulomb friction, it pushes the axis on. What the hold asks for beyond its
bound is therefore taken off that integral, down to nothing and never beyond. The gain is the same on both sides of the
bound, and so is the margin. What is taken off is not given back: it is spent once and feeds no oscillation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..jit import njit

HELD_DEAD_BANDS = 32.0  # the least travel after which a held axis counts as moved: a fitted 1/K may be far too short
SETTLED = 0.99  # of the way to the gains at rest: the friction torque has gone by then, and the contact is unloaded


class HoldConfig(NamedTuple):
    """Constants of the hold."""

    integral_a_per_rev_s: float
    dead_band_rev: float  # a distance that is not corrected: the resolution of the position
    travel_rev: float  # farther than this the axis has slid
    bound_a: float  # of the current; 0: no hold


def held_travel_rev(stiffness_per_rev: float, dead_band_rev: float) -> float:
    """The travel of a contact, 1/K, at least so far that it can be seen."""
    return max(1.0 / stiffness_per_rev, HELD_DEAD_BANDS * dead_band_rev)


NO_HOLD = HoldConfig(0.0, 0.0, 0.0, 0.0)


class HoldState(NamedTuple):
    """Memory of the hold."""

    latched: bool
    position_rev: float  # where the axis is held
    current_a: float


@njit
def nothing_held() -> HoldState:
    """In motion, and before the axis has come to rest."""
    return HoldState(False, 0.0, 0.0)


@njit
def hold_step(
    config: HoldConfig, state: HoldState, rest: float, position_rev: float, limited: bool, period_s: float
) -> HoldState:
    """A period at rest; the current is not bounded yet (`within_bound`).

    `rest`: how far the gains have gone to those at rest; `limited`: the last command was cut.
    """
    if not math.isfinite(position_rev):
        return state
    if not state.latched:
        return HoldState(rest >= SETTLED, position_rev, 0.0)
    away_rev = position_rev - state.position_rev
    held_rev = state.position_rev
    if abs(away_rev) > config.travel_rev:
        away_rev = math.copysign(config.travel_rev, away_rev)
        held_rev = position_rev - away_rev
    beyond_rev = max(abs(away_rev) - config.dead_band_rev, 0.0)
    current_a = state.current_a
    if not limited:
        current_a -= config.integral_a_per_rev_s * period_s * math.copysign(beyond_rev, away_rev)
    return HoldState(True, held_rev, current_a)


@njit
def within_bound(config: HoldConfig, state: HoldState, integral_a: float) -> tuple[HoldState, float]:
    """The hold within its bound, and the velocity loop's integral, less what the hold asked for against it beyond."""
    current_a = min(max(state.current_a, -config.bound_a), config.bound_a)
    beyond_a = state.current_a - current_a
    if beyond_a * integral_a < 0.0:
        integral_a += math.copysign(min(abs(beyond_a), abs(integral_a)), beyond_a)
    return HoldState(state.latched, state.position_rev, current_a), integral_a

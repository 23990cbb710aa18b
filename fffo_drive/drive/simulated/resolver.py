"""Resolver, converter and the drive's tracking loop: where the measured position and velocity come from.

The converter gives the angle in whole counts, with a little noise. A type-II tracking loop (its angle has no lag at
constant speed) follows it each sub-step. Its integrator is the velocity estimate:

    velocity/true velocity = wn^2/(s^2 + 2 zeta wn s + wn^2)

so at low frequency the velocity lags by 2 zeta/wn. The drive reports it in multiples of its velocity resolution.
"""

from __future__ import annotations

import math

from ...jit import njit
from . import state as at
from .noise import random_normal
from .state import STEP_S, Floats, Integers, PlantParameters, PlantReport, PlantState


@njit
def resolver_step(c: Floats, x: Floats, words: Integers, sensed_rev: float) -> None:
    """One sub-step: convert the angle (rev, multi-turn) and let the tracking loop follow.

    `c`, `x`, `words`: `numbers` of the parameters, `values` and `words` of the state.
    """
    noise_rev = c[at.RESOLVER_NOISE_REV]
    if noise_rev > 0.0:
        sensed_rev += noise_rev * random_normal(words)
    converted_rev = (math.floor(sensed_rev * c[at.COUNTS_PER_REV]) + 0.5) * c[at.REV_PER_COUNT]
    predicted_rev = x[at.TRACKED_REV] + x[at.TRACKED_RPS] * STEP_S
    error_rev = converted_rev - predicted_rev
    x[at.TRACKED_REV] = predicted_rev + c[at.TRACKING_POSITION] * error_rev
    x[at.TRACKED_RPS] += c[at.TRACKING_VELOCITY] * error_rev


@njit
def plant_latch(parameters: PlantParameters, state: PlantState) -> PlantReport:
    """What the drive measures now, with fresh noise. Clears words[LIMITED]."""
    c = parameters.numbers
    x = state.values
    velocity_rps = x[at.TRACKED_RPS] + c[at.VELOCITY_NOISE_RPS] * random_normal(state.words)
    lsb_rps = c[at.VELOCITY_LSB_RPS]
    if lsb_rps > 0.0:
        velocity_rps = math.floor(velocity_rps / lsb_rps + 0.5) * lsb_rps
    limited = state.words[at.LIMITED] != 0
    state.words[at.LIMITED] = 0
    return PlantReport(
        float(velocity_rps),
        math.floor(x[at.TRACKED_REV] * c[at.COUNTS_PER_REV]),
        float(x[at.CURRENT_A] + c[at.CURRENT_NOISE_A] * random_normal(state.words)),
        float(x[at.VELOCITY_RPS]),
        float(x[at.FRICTION_NM]),
        bool(limited),
    )

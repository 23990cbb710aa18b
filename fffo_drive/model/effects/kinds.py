"""Pieces that several laws are made of: waves, hysteresis, lags. Kernels without memory of their own."""

from __future__ import annotations

import math

from ...jit import njit
from . import slots as s
from .slots import Floats

TURN = 2.0 * math.pi


@njit
def wave(cosine: float, sine: float, turns: float) -> float:
    """cosine cos(2 pi turns) + sine sin(2 pi turns)."""
    angle = TURN * turns
    return cosine * math.cos(angle) + sine * math.sin(angle)


@njit
def sign_of(value: float) -> float:
    """1, -1, or 0."""
    if value > 0.0:
        return 1.0
    return -1.0 if value < 0.0 else 0.0


@njit
def approach(value: float, goal: float, distance: float, length: float) -> float:
    """A first-order approach to `goal`, exact over `distance` (travel or time) with its `length`."""
    return goal + (value - goal) * math.exp(-distance / length)


@njit
def settled(elapsed: float, length: float) -> float:
    """1 - exp(-elapsed/length)."""
    return -math.expm1(-elapsed / length)


@njit
def steady_contact_nm(signals: Floats, speed_rps: float) -> float:
    """Level of the Stribeck curve at a speed, without its viscous part."""
    ratio = speed_rps / signals[s.STRIBECK_VELOCITY_RPS]
    exponent = signals[s.STRIBECK_EXPONENT]
    falling = 1.0 if exponent > 0.0 else 0.0
    if ratio > 1e-9:
        falling = math.exp(-math.pow(ratio, exponent))
    return float(signals[s.COULOMB_NM] + (signals[s.STATIC_NM] - signals[s.COULOMB_NM]) * falling)

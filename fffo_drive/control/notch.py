"""Notch filters on the error: what the feedback would feed of a resonance is taken out before any gain acts on it.

    N(s) = (s^2 + depth width w s + w^2) / (s^2 + width w s + w^2),    w = 2 pi frequency

1 far from the frequency, `depth` at it. Notches stand before Kp, Ki and L, and nowhere else:

    - feed-forward does not pass them: an axis that follows exactly has no error for a notch to delay;
    - limits and anti-windup stand behind them, so no memory of a notch winds up;
    - a change of gains, of the toggle or to the gains at rest is none of a notch's input, and needs no hand-over.

The position hold at rest does not pass them either: it is an integral, far slower than any resonance.

Sampled by the bilinear transform, prewarped so that the notch is where it was asked for; the margins count the sampled
filter itself. Its two numerators of order one are equal, so that the gain at rest is exactly 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from ..jit import njit

MOST_NOTCHES = 2
HIGHEST_NOTCH_SHARE = 0.4  # of the loop's rate: nearer to half of it a sampled notch has no width


class Notch(NamedTuple):
    """What a notch is to do; keys of the axis file."""

    frequency_hz: float
    width: float  # of the band in which it acts, over its frequency: twice the damping ratio of its poles
    depth: float  # gain at the frequency; 0: nothing passes


class SectionConfig(NamedTuple):
    """Coefficients of a sampled notch: (direct + middle z + last z^2) / (1 + middle z + back z^2), z one period ago."""

    direct: float
    middle: float
    last: float
    back: float


class NotchConfig(NamedTuple):
    """Two notches in a row; one that is not used passes everything."""

    used: bool
    first: SectionConfig
    second: SectionConfig


PASSES = SectionConfig(1.0, 0.0, 0.0, 0.0)
NO_NOTCHES = NotchConfig(False, PASSES, PASSES)


class SectionState(NamedTuple):
    """Memory of one notch (direct form II transposed)."""

    first: float
    second: float


class NotchState(NamedTuple):
    """Memory of both."""

    first: SectionState
    second: SectionState


def section_config(notch: Notch, period_s: float) -> SectionConfig:
    """A notch at the period of the loop. Its frequency must be below half the rate."""
    tangent = math.tan(math.pi * notch.frequency_hz * period_s)
    square, width = tangent * tangent, notch.width * tangent
    scale = 1.0 + width + square
    return SectionConfig(
        (1.0 + notch.depth * width + square) / scale,
        2.0 * (square - 1.0) / scale,
        (1.0 - notch.depth * width + square) / scale,
        (1.0 - width + square) / scale,
    )


def notch_config(notches: Sequence[Notch], period_s: float) -> NotchConfig:
    """The notches of a law, at most MOST_NOTCHES, at the period of the loop."""
    sections = [section_config(notch, period_s) for notch in notches]
    first, second = sections + [PASSES] * (MOST_NOTCHES - len(sections))
    return NotchConfig(bool(sections), first, second)


@njit
def notches_at_rest() -> NotchState:
    """Memory after an error of zero."""
    return NotchState(SectionState(0.0, 0.0), SectionState(0.0, 0.0))


@njit
def _section_step(config: SectionConfig, state: SectionState, value: float) -> tuple[float, SectionState]:
    passed = config.direct * value + state.first
    return passed, SectionState(
        config.middle * (value - passed) + state.second, config.last * value - config.back * passed
    )


@njit
def notch_step(config: NotchConfig, state: NotchState, value: float) -> tuple[float, NotchState]:
    """A period of both notches: what passes, and the memory behind it."""
    passed, first = _section_step(config.first, state.first, value)
    passed, second = _section_step(config.second, state.second, passed)
    return passed, NotchState(first, second)


@njit
def _section_settled(config: SectionConfig, value: float) -> SectionState:
    second = (config.last - config.back) * value
    return SectionState(second, second)


@njit
def notches_settled(config: NotchConfig, value: float) -> NotchState:
    """Memory after a constant value, which passes unchanged."""
    return NotchState(_section_settled(config.first, value), _section_settled(config.second, value))

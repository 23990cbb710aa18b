"""Feed-forward on a reference known ahead: torque that arrives on time, and an error that accounts for the delay.

A command computed at t produces its torque later, and its velocity is measured later still. With the end-to-end delay
Td (hold included) and the sensor's share of it Ts:

    friction and inertia torque at t are those of w_r(t + Td - Ts), so that the shaft follows w_r on time
    the error at t is w_r(t - Ts) - w(t): the reference as old as the feedback, so that no delay is learned as friction

Both only shift the reference, which remains a bounded input: (11) and its condition (14) remain valid.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ..jit import njit


class FeedforwardConfig(NamedTuple):
    """Shifts of the reference, and the inertia whose torque is fed forward. All zero: the paper's FFFO."""

    inertia_nm_s2_per_rev: float  # 0: no inertia torque
    ahead_ticks: float  # how far ahead the reference is read for torque
    behind_ticks: float  # age of the reference from which the error is computed

    @property
    def preview_ticks(self) -> int:
        """Periods for which the reference must be known ahead (control.set_point.preview_ticks is the kernel)."""
        return max(0, math.ceil(self.ahead_ticks))


class Reference(NamedTuple):
    """The reference at one tick, for each part of the law."""

    value: float  # at the deadline: rps, or A for a current profile
    derivative: float  # per second
    ahead: float  # the value that torque of this tick will meet
    ahead_derivative: float
    expected: float  # the value that the feedback of this tick has if the axis follows exactly


NO_FEEDFORWARD = FeedforwardConfig(0.0, 0.0, 0.0)


@njit
def steady_reference(value: float) -> Reference:
    """A constant reference: the same at any time."""
    return Reference(value, 0.0, value, 0.0, value)


@njit
def stands_still(reference: Reference) -> bool:
    """Whether the reference is zero, now and at the time for which torque is computed."""
    return reference.value == 0.0 and reference.ahead == 0.0


@njit
def read_samples(samples: Any, length: int, position: float) -> float:
    """Samples (n,) at a fractional position, by linear interpolation; 0 before the first and after the last."""
    below = math.floor(position)
    share = position - below
    first = samples[below] if 0 <= below < length else 0.0
    if share == 0.0:
        return float(first)
    second = samples[below + 1] if -1 <= below < length - 1 else 0.0
    return float(first + share * (second - first))


@njit
def read_reference(config: FeedforwardConfig, values: Any, derivatives: Any, length: int, sample: int) -> Reference:
    """The reference of a profile (arrays of at least `length`) at a sample."""
    ahead = sample + config.ahead_ticks
    return Reference(
        read_samples(values, length, float(sample)),
        read_samples(derivatives, length, float(sample)),
        read_samples(values, length, ahead),
        read_samples(derivatives, length, ahead),
        read_samples(values, length, sample - config.behind_ticks),
    )

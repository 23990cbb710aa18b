"""PI velocity controller (9): u = Kp e + Ki int(e), with conditional integration as anti-windup."""

from __future__ import annotations

from typing import NamedTuple

from ..jit import njit


class PiConfig(NamedTuple):
    """Gains of the velocity loop, command in A."""

    proportional_a_per_rps: float  # Kp
    integral_a_per_rev: float  # Ki = Kp / Ti


@njit
def pi_step(
    config: PiConfig, integral_a: float, error_rps: float, feedforward_a: float, limit_a: float, limited: bool,
    period_s: float,
) -> tuple[float, float]:  # fmt: skip
    """Return (proportional_a, new integral_a).

    Conditional integration: the integral is held while the sum with `feedforward_a` exceeds +-`limit_a` (or the
    envelope `limited` the last command) and the error would increase the excess.
    """
    proportional_a = config.proportional_a_per_rps * error_rps
    candidate_a = integral_a + config.integral_a_per_rev * error_rps * period_s
    sum_a = proportional_a + candidate_a + feedforward_a
    if (abs(sum_a) > limit_a or limited) and error_rps * sum_a > 0.0:
        return proportional_a, integral_a
    return proportional_a, candidate_a

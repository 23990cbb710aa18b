"""How the drive stops by itself: the brake behind quick stop and fault reaction (option codes 0x605A and
0x605E).

In torque mode the drive closes its own speed loop for this: a proportional controller on a speed ramp, or at the
current limit.
"""

from __future__ import annotations

from typing import NamedTuple

from ...jit import njit
from .cia402_device import QUICK_STOP_STAYS

# kinds of brake; the values are the option codes without the "stay in quick stop" offset of 4
COAST = 0
SLOW_RAMP = 1
CURRENT_LIMIT = 3  # 2: the quick stop ramp

_STAY_OFFSET = 4


class BrakeSettings(NamedTuple):
    """Constants of the brake."""

    slow_rps2: float  # deceleration of the slow down ramp (0x6084)
    quick_rps2: float  # deceleration of the quick stop ramp (0x6085)
    gain_a_per_rps: float  # of the drive's own speed loop
    limit_a: float  # current while braking
    standstill_rps: float  # measured speed below which the shaft counts as stopped


@njit
def brake_kind(option: int) -> int:
    """Kind of brake of an option code 0x605A (0 to 3, 5 to 7) or 0x605E (0 to 3)."""
    return option - _STAY_OFFSET if option >= QUICK_STOP_STAYS else option


@njit
def brake_step(
    settings: BrakeSettings, kind: int, ramp_rps: float, velocity_rps: float, step_s: float
) -> tuple[float, float, bool]:
    """One step of braking: next speed on the ramp, current (A), and whether it is done.

    `ramp_rps`: the measured speed when braking begins, then the value that the previous step returned.
    """
    if kind == COAST:
        return 0.0, 0.0, True
    ramp_rps = _toward_zero(ramp_rps, settings, kind, step_s)
    current_a = settings.gain_a_per_rps * (ramp_rps - velocity_rps)
    current_a = min(settings.limit_a, max(-settings.limit_a, current_a))
    done = ramp_rps == 0.0 and abs(velocity_rps) < settings.standstill_rps
    return ramp_rps, current_a, done


@njit
def _toward_zero(ramp_rps: float, settings: BrakeSettings, kind: int, step_s: float) -> float:
    if kind == CURRENT_LIMIT:
        return 0.0
    change_rps = (settings.slow_rps2 if kind == SLOW_RAMP else settings.quick_rps2) * step_s
    if ramp_rps > change_rps:
        return ramp_rps - change_rps
    return ramp_rps + change_rps if ramp_rps < -change_rps else 0.0

"""The numbers on the machine's name plate."""

from __future__ import annotations

from typing import NamedTuple

from ....units import PERMILLE


class Ratings(NamedTuple):
    """The name plate: declared in the object dictionary, and the scales between it and SI."""

    rated_torque_nm: float
    torque_constant_nm_per_a: float
    peak_permille: int  # of the rated torque
    counts_per_rev: int
    velocity_counts_per_rps: int  # 0x606C
    max_speed_rps: float
    undervoltage_v: float
    overvoltage_v: float
    highest_temperature_k: float  # above the surroundings
    slow_rps2: float  # ramps of the drive, where it has no object for them
    quick_rps2: float
    brake_a_per_rps: float  # the drive's own velocity loop, which it closes to brake
    standstill_rps: float

    @property
    def rated_current_a(self) -> float:
        """The current that makes the rated torque (0x6075)."""
        return self.rated_torque_nm / self.torque_constant_nm_per_a

    @property
    def a_per_permille(self) -> float:
        """Current per thousandth of the rated torque."""
        return self.rated_current_a / PERMILLE

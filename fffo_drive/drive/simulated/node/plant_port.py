"""The machine as the drive's firmware sees it, and the numbers on its name plate."""

from __future__ import annotations

from typing import NamedTuple, Protocol

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


class PlantPort(Protocol):
    """Motor, current loop and resolver. The power stage is off where `current_a` is 0."""

    @property
    def counts(self) -> int:
        """Angle of the resolver, multi-turn."""
        ...

    @property
    def velocity_rps(self) -> float:
        """Of the resolver's tracking loop."""
        ...

    @property
    def current_a(self) -> float:
        """Torque-forming current, measured."""
        ...

    @property
    def limited(self) -> bool:
        """Current or voltage met a limit during the last `advance`."""
        ...

    @property
    def dc_link_v(self) -> float:
        """Supply of the power stage."""
        ...

    @property
    def temperature_k(self) -> float:
        """Of the motor, above the surroundings."""
        ...

    def advance(self, until_ns: int, current_a: float) -> None:
        """Advance to `until_ns` (since the start) with this command, and update the feedback."""
        ...

    def lose_resolver(self, lost: bool, jump_rev: float) -> None:
        """Take the resolver's signal away, or give it back; its angle jumps by `jump_rev`."""
        ...

    def hold(self, held: bool) -> None:
        """Close (at once, even on a turning shaft) or open the holding brake."""
        ...

    def lose_dc_link(self, lost: bool) -> None:
        """Take the supply away, or give it back."""
        ...

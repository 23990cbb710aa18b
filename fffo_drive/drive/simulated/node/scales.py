"""The drive's units, from its factor group (CiA 402-2), its ratings, and its polarity.

0x6064 has the unit given by 0x60A8, 0x6091 and 0x6092, 0x606C that of 0x60A9 or 0x6090; torque objects are in
thousandths of 0x6076, current objects in thousandths of 0x6075. Writing these objects changes how the drive scales its
values, never the machine. Values without an object are as configured.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

from ....canopen_node.abort import Abort, SdoAbortError
from ....canopen_node.dictionary import ObjectDictionary
from ....units import PERMILLE
from .personality import Personality
from .ratings import Ratings

RATED_CURRENT, RATED_TORQUE, POLARITY = 0x6075, 0x6076, 0x607E
ENCODER, VELOCITY_ENCODER, GEAR, FEED = 0x608F, 0x6090, 0x6091, 0x6092
POSITION_UNIT, VELOCITY_UNIT = 0x60A8, 0x60A9
FACTORS = (RATED_CURRENT, RATED_TORQUE, POLARITY, ENCODER, VELOCITY_ENCODER, GEAR, FEED, POSITION_UNIT, VELOCITY_UNIT)

REVERSED_POSITION, REVERSED_VELOCITY = 0x80, 0x40  # of 0x607E

# CiA 303-2: byte 3 power of ten, byte 2 unit, byte 1 what it is divided by
INCREMENT = 0xB5
_PER_REV = {
    0xB4: Fraction(1),  # revolutions
    0x41: Fraction(360),  # degrees
    0x42: Fraction(360 * 60),
    0x43: Fraction(360 * 3600),
    0x10: Fraction(2.0 * math.pi).limit_denominator(10**9),  # radians
}
_SECONDS = {0x03: 1, 0x47: 60, 0x48: 3600}
_LARGEST_POWER = 12


class NodeUnit:
    """A decoded notation of CiA 303-2. ValueError for one that names no angle or angular velocity."""

    def __init__(self, notation: int, velocity: bool) -> None:
        power = (notation >> 24 ^ 0x80) - 0x80
        numerator, denominator = notation >> 16 & 0xFF, notation >> 8 & 0xFF
        seconds = _SECONDS.get(denominator) if velocity else (1 if denominator == 0 else None)
        known = numerator == INCREMENT or numerator in _PER_REV
        if not known or seconds is None or abs(power) > _LARGEST_POWER or notation & 0xFF:
            raise ValueError(f"0x{notation:08X}")
        self.counts_increments = numerator == INCREMENT
        self.per_rev = _PER_REV.get(numerator, Fraction(1)) * seconds * Fraction(10) ** -power
        """Units in a revolution (of a velocity: in one a second); of increments: in an increment."""


class NodeScales:
    """Factors between the plant and the objects, prepared for the cyclic path.

    `powered()` says whether the motor may turn under power: the factors do not change then (08000022 by SDO).
    """

    def __init__(
        self, od: ObjectDictionary, ratings: Ratings, personality: Personality, powered: Callable[[], bool]
    ) -> None:
        self.od, self.ratings, self.personality = od, ratings, personality
        self._powered = powered
        self.on_change: list[Callable[[], None]] = []
        declared = _ratio(od, ENCODER)
        self._encoder = Fraction(personality.encoder_counts_per_rev) or declared or Fraction(ratings.counts_per_rev)
        for index in FACTORS:
            od.guard(index, self._check)
            od.on_write(index, self._written)
        od.guard(POSITION_UNIT, lambda sub, value: self._check_unit(value, velocity=False))
        od.guard(VELOCITY_UNIT, lambda sub, value: self._check_unit(value, velocity=True))
        self.renew()

    def renew(self) -> None:
        """Read the objects again."""
        polarity = self.od.number(POLARITY)
        gear = _ratio(self.od, GEAR) or Fraction(1)
        believed = _ratio(self.od, ENCODER) or self._encoder
        increments = self._encoder / self.ratings.counts_per_rev
        position = self._per_increment(believed) / gear * (-1 if polarity & REVERSED_POSITION else 1)
        self.converts_position = increments != 1 or position != 1
        self._factors = (*increments.as_integer_ratio(), *position.as_integer_ratio())
        per_rps = float(self._per_rps(believed) / gear)
        self.units_per_rps = per_rps
        self.velocity_per_rps = -per_rps if polarity & REVERSED_VELOCITY else per_rps
        self._rate()
        for listener in self.on_change:
            listener()

    def position(self, counts: int) -> int:
        """0x6064 before it is cut to 32 bits, from the resolver's counts."""
        to_increments, per_count, to_units, per_increment = self._factors
        return counts * to_increments // per_count * to_units // per_increment

    @property
    def peak_permille(self) -> float:
        """The highest current of the drive, in thousandths as 0x6071 has them."""
        return self.ratings.peak_permille * self.ratings.a_per_permille / self.a_per_permille

    def _rate(self) -> None:
        """Torque and current of a thousandth; factory ratings where the motor was not configured."""
        ratings, personality, number = self.ratings, self.personality, self.od.number
        by_torque = number(RATED_TORQUE) * personality.rated_torque_unit_nm / ratings.torque_constant_nm_per_a
        by_current = number(RATED_CURRENT) * personality.rated_current_unit_a
        if number(RATED_TORQUE) == round(ratings.rated_torque_nm / personality.rated_torque_unit_nm):
            by_torque = ratings.rated_current_a  # without the rounding of the object
        if number(RATED_CURRENT) == round(ratings.rated_current_a / personality.rated_current_unit_a):
            by_current = ratings.rated_current_a
        self.as_made = by_torque == by_current == ratings.rated_current_a  # both ratings are those of the motor
        self.a_per_permille = (by_torque or by_current or ratings.rated_current_a) / PERMILLE
        self.current_a_per_permille = (by_current or by_torque or ratings.rated_current_a) / PERMILLE

    def _per_increment(self, believed: Fraction) -> Fraction:
        """Position units in an increment of the encoder, without the gear."""
        unit = _unit_of(self.od.number(POSITION_UNIT), velocity=False)
        if unit is not None and not unit.counts_increments:
            return unit.per_rev / believed
        feed = _ratio(self.od, FEED)
        scale = unit.per_rev if unit is not None else Fraction(1)
        return scale * (feed / believed if feed else 1)

    def _per_rps(self, believed: Fraction) -> Fraction:
        """Velocity units in one revolution per second, without the gear."""
        unit = _unit_of(self.od.number(VELOCITY_UNIT), velocity=True)
        declared = _ratio(self.od, VELOCITY_ENCODER)
        if unit is None:
            return declared or Fraction(self.ratings.velocity_counts_per_rps)
        return unit.per_rev * (declared or self._encoder if unit.counts_increments else self._encoder / believed)

    def _check(self, sub: int, value: int) -> None:
        if self._powered():
            raise SdoAbortError(Abort.DEVICE_STATE)

    def _check_unit(self, value: int, velocity: bool) -> None:
        self._check(0, value)
        if value and _unit_of(value, velocity) is None:
            raise SdoAbortError(Abort.INVALID_VALUE)

    def _written(self, sub: int, value: int) -> None:
        if not self._powered():  # by RPDO: taken with the next that is written
            self.renew()


def _unit_of(notation: int, velocity: bool) -> NodeUnit | None:
    """The unit of 0x60A8 or 0x60A9; None where it is unset, or not a unit of this machine."""
    try:
        return NodeUnit(notation, velocity) if notation else None
    except ValueError:
        return None


def _ratio(od: ObjectDictionary, index: int) -> Fraction | None:
    """Sub 1 over sub 2; None where they are absent, 0, or 1/1, which stands for "not set"."""
    over, under = od.number_or(index, 1, 0), od.number_or(index, 2, 1) or 1
    ratio = abs(Fraction(over, under))
    return ratio if ratio not in (0, 1) else None

"""Units that a drive, or its file, reports: counts per revolution, velocity, ratings, shortest period.

SI unit notation of 0x60A8 and 0x60A9: CiA 303-2 (prefix, numerator, denominator); factor group: CiA 402-2 (0x608F,
0x6090 to 0x6092). A ratio of 1 to 1 counts as not set: no encoder has one count.
"""

from __future__ import annotations

import math
from typing import Any

from .silence import DriveObjects

REVOLUTIONS, INCREMENTS, DEGREES, RADIANS = 0xB4, 0xB5, 0x41, 0x10  # notation indices
PER_SECOND, PER_MINUTE = 0x03, 0x47
MILLI = 1e-3


def reported_units(
    objects: DriveObjects, torque_unit_nm: float = MILLI, current_unit_a: float = MILLI
) -> dict[str, Any]:
    """Keys of an axis file's drive section that the drive reports; others are absent.

    `torque_unit_nm`, `current_unit_a`: of 0x6076 and 0x6075, mNm and mA in CiA 402.
    """
    found: dict[str, Any] = {}
    if torque := objects.value(0x6076):
        found["rated_torque_nm"] = torque * torque_unit_nm
    if current := objects.value(0x6075):
        found["rated_current_a"] = current * current_unit_a
    increments = _ratio(objects, 0x608F)
    unit = objects.value(0x60A8)
    counts = units_per_turn(unit, increments) if unit else increments
    counts = counts / _gear(objects, unit) if counts is not None else None
    if counts is not None and counts >= 2 and counts == round(counts):
        found["counts_per_rev"] = round(counts)
    unit = objects.value(0x60A9)
    velocity = velocity_units_per_rps(unit, increments) if unit else _ratio(objects, 0x6090)
    if velocity is not None:
        found["velocity_units_per_rps"] = velocity / _gear(objects, unit)
    return found


def counts_increments(unit: int | None) -> bool:
    """Whether a position with this unit (0x60A8; 0 and None: no unit reported) is in encoder increments."""
    return not unit or unit >> 16 & 0xFF == INCREMENTS


def unit_remarks(objects: DriveObjects) -> list[str]:
    """Remarks on the units that must be read before an axis is commissioned."""
    found = []
    motor, shaft = objects.value(0x6091, 1), objects.value(0x6091, 2)
    if motor and shaft and motor != shaft:
        found.append(f"0x6091 declares a gear of {motor} to {shaft}: counts and velocity are of the motor's shaft")
    polarity = objects.value(0x607E) or 0
    turned = [name for bit, name in ((7, "position"), (6, "velocity")) if polarity >> bit & 1]
    if turned:
        found.append(
            f"0x607E turns the sign of {' and '.join(turned)}; torque does not follow in every drive: "
            "`fffo-drive commission` shows whether the signs agree"
        )
    if objects.has(0x6076) and objects.value(0x6076) == 0:
        found.append("0x6076 is 0 until the drive knows its motor: set it with the vendor's tool, or by drive.sdo")
    return found


def highest_rate_hz(lowest_exponent: int | None) -> int | None:
    """The rate that 0x60C2 allows when its exponent cannot go lower; None where nothing is reported."""
    if lowest_exponent is None or not -6 < lowest_exponent < 0:
        return None
    return int(10**-lowest_exponent)


def units_per_turn(unit: int, increments: float | None) -> float | None:
    """Position units per revolution, from the SI unit; None for another unit, or increments of unknown size."""
    exponent, numerator = _prefix(unit), unit >> 16 & 0xFF
    turn = {REVOLUTIONS: 1.0, INCREMENTS: increments, DEGREES: 360.0, RADIANS: 2.0 * math.pi}.get(numerator)
    return None if turn is None else turn / 10.0**exponent


def velocity_units_per_rps(unit: int, increments: float | None) -> float | None:
    """0x606C for 1 rev/s, from the SI unit: an angle or increments, per second or minute; None for others."""
    turn = units_per_turn(unit, increments)
    seconds = {PER_SECOND: 1.0, PER_MINUTE: 60.0}.get(unit >> 8 & 0xFF)
    return None if turn is None or seconds is None else turn * seconds


def _prefix(unit: int) -> int:
    exponent = unit >> 24 & 0xFF
    return exponent - 256 if exponent > 127 else exponent


def _ratio(objects: DriveObjects, index: int) -> float | None:
    """Increments per revolution (0x608F), or per second (0x6090); None where not set."""
    above, below = objects.value(index, 1), objects.value(index, 2)
    return above / below if above and below and above > below else None


def _gear(objects: DriveObjects, unit: int | None) -> float:
    """Motor revolutions per revolution of the counted position (0x6091); increments always count the motor's own."""
    if not unit or unit >> 16 & 0xFF == INCREMENTS:
        return 1.0
    motor, shaft = objects.value(0x6091, 1), objects.value(0x6091, 2)
    return motor / shaft if motor and shaft else 1.0

"""The drive's own current limit, from its objects: the least of what limits torque and current.

0x6072, 0x60E0 and 0x60E1 count thousandths of the rated torque (0x6076), 0x6073 of the rated current (0x6075); CiA
402-2, 402-4. With a limit of its own above the drive's the law would wind its integral up while the drive limits,
unless the drive says that by bit 11 of the statusword, which is optional.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from ...units import PERMILLE, permille_per_a
from ..port import NO_LIMIT, CurrentLimit
from .config import CanopenDriveConfig
from .service import Service

MAX_TORQUE, MAX_CURRENT, POSITIVE, NEGATIVE = 0x6072, 0x6073, 0x60E0, 0x60E1
LIMITS = {
    MAX_TORQUE: "max torque",
    MAX_CURRENT: "max current",
    POSITIVE: "positive torque limit",
    NEGATIVE: "negative torque limit",
}
RATED_CURRENT = 0x6075
LARGEST = 0x7FFF  # more is none, or a number with a sign


def least_limit(
    value: Callable[[int], int | None],
    torque_constant_nm_per_a: float,
    rated_torque_nm: float,
    rated_current_a: float | None,
) -> CurrentLimit:
    """Of the values of these objects; None is one that the drive does not have. 0 tells nothing about a limit."""
    found = NO_LIMIT
    for index, name in LIMITS.items():
        number = value(index)
        if number is None or not 0 < number <= LARGEST:
            continue
        if index == MAX_CURRENT:
            limit_a = math.inf if rated_current_a is None else number / PERMILLE * rated_current_a
        else:
            limit_a = number / permille_per_a(torque_constant_nm_per_a, rated_torque_nm)
        if limit_a < found.current_a:
            found = CurrentLimit(limit_a, f"0x{index:04X}, {name}, is {number}")
    return found


def read_current_limit(service: Service, config: CanopenDriveConfig) -> CurrentLimit:
    """As the configuration has it, else by the drive's objects; NO_LIMIT where it has none.

    Raises BusUnavailableError, DriveRefusedError.
    """
    if config.current_limit_a is not None:
        return CurrentLimit(config.current_limit_a, "drive.current_limit_a")
    rated_a = config.rated_current_a
    if rated_a is None and (reported := service.read_optional_int(RATED_CURRENT, 0)):
        rated_a = reported * config.rated_current_unit_a
    return least_limit(
        lambda index: service.read_optional_int(index, 0),
        config.torque_constant_nm_per_a,
        config.rated_torque_nm,
        rated_a,
    )

"""The drive's own scaling: name plate and encoder objects, if it has them."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

from ..drive.canopen.reported_units import counts_increments, reported_units
from ..drive.port import DriveRefusedError


@runtime_checkable
class ObjectSource(Protocol):
    """A drive whose objects can be read, also while the loop runs."""

    def read_object(self, index: int, sub: int) -> bytes:
        """Raises DriveRefusedError if the drive does not have the object."""
        ...


class NamePlate(NamedTuple):
    """Scaling objects; None if the drive does not have them."""

    counts_per_rev: float | None = None  # 0x608F: increments over revolutions; 0x60A8 where the position has a unit
    velocity_units_per_rps: float | None = None  # 0x6090: increments a second over revolutions a second; else 0x60A9
    torque_constant_nm_per_a: float | None = None  # 0x6076 over 0x6075
    rated_current_a: float | None = None  # 0x6075
    counts_object: str = "0x608F"  # that tells the counts
    velocity_object: str = "0x6090"


def read_number(source: ObjectSource, index: int, sub: int, *, signed: bool = False) -> int | None:
    """An object as a number; None if the drive does not have it. Raises BusUnavailableError."""
    try:
        return int.from_bytes(source.read_object(index, sub), "little", signed=signed)
    except DriveRefusedError:
        return None


class _Objects:
    """A connected drive as `DriveObjects` has it. Raises BusUnavailableError."""

    def __init__(self, source: ObjectSource) -> None:
        self._source = source

    def has(self, index: int, sub: int = 0) -> bool:
        """Whether the object exists and can be read."""
        return self.value(index, sub) is not None

    def value(self, index: int, sub: int = 0) -> int | None:
        """Its number."""
        return read_number(self._source, index, sub)


def read_name_plate(source: object, current_unit_a: float = 1e-3, torque_unit_nm: float = 1e-3) -> NamePlate:
    """Of a drive on a bus; a drive in process has none. `current_unit_a`: of 0x6075, `torque_unit_nm`: of 0x6076."""
    if not isinstance(source, ObjectSource):
        return NamePlate()
    objects = _Objects(source)
    reported = reported_units(objects)
    torque, current = objects.value(0x6076), objects.value(0x6075)
    return NamePlate(
        reported.get("counts_per_rev"),
        reported.get("velocity_units_per_rps"),
        torque * torque_unit_nm / (current * current_unit_a) if torque and current else None,
        current * current_unit_a if current else None,
        "0x608F" if counts_increments(objects.value(0x60A8)) else "0x60A8",
        "0x60A9" if objects.value(0x60A9) else "0x6090",
    )

"""What the drive says about its own scaling: name plate and encoder objects, where it has them."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

from ..drive.port import DriveRefusedError

PERMILLE = 1000.0
MILLI = 1000.0


@runtime_checkable
class ObjectSource(Protocol):
    """A drive whose objects can be read, also while the loop runs."""

    def read_object(self, index: int, sub: int) -> bytes:
        """Raises DriveRefusedError when the drive does not have it."""
        ...


class NamePlate(NamedTuple):
    """None where the drive does not say."""

    counts_per_rev: float | None = None  # 0x608F: increments over revolutions
    velocity_units_per_rps: float | None = None  # 0x6090: increments a second over revolutions a second
    torque_constant_nm_per_a: float | None = None  # 0x6076 over 0x6075
    rated_current_a: float | None = None  # 0x6075


def read_number(source: ObjectSource, index: int, sub: int, *, signed: bool = False) -> int | None:
    """An object as a number; None where the drive does not have it. Raises BusUnavailableError."""
    try:
        return int.from_bytes(source.read_object(index, sub), "little", signed=signed)
    except DriveRefusedError:
        return None


def read_name_plate(source: object) -> NamePlate:
    """Of a drive on a bus; a drive in process has none."""
    if not isinstance(source, ObjectSource):
        return NamePlate()

    def ratio(index: int) -> float | None:
        above, below = read_number(source, index, 1), read_number(source, index, 2)
        return above / below if above and below else None

    torque, current = read_number(source, 0x6076, 0), read_number(source, 0x6075, 0)
    return NamePlate(
        ratio(0x608F),
        ratio(0x6090),
        torque / current if torque and current else None,
        current / MILLI if current else None,
    )

"""Write an object and read it back: a drive that refuses, or keeps a different value, is not enabled."""

from __future__ import annotations

from ..port import DriveRefusedError
from .service import READ_ONLY, SdoRefusedError, Service, object_name


def write_checked(
    service: Service, index: int, sub: int, value: int, size: int, purpose: str, *, mask: int | None = None
) -> None:
    """Write `value` in `size` bytes and compare what the drive then has (under `mask`, if given).

    An object that is read only may have the value already.
    `purpose` completes "needed for ...". Raises DriveRefusedError naming object, value and the drive's
    reason, and BusUnavailableError when nobody answers.
    """
    name = object_name(index, sub)
    shown = _shown(value, size)
    compared = mask if mask is not None else (1 << 8 * size) - 1
    try:
        service.write(index, sub, (value & ((1 << 8 * size) - 1)).to_bytes(size, "little"))
        kept = service.read_int(index, sub)
    except SdoRefusedError as refusal:
        if refusal.code == READ_ONLY and (service.read_int(index, sub) ^ value) & compared == 0:
            return
        raise DriveRefusedError(
            f"node {service.node_id} refuses {name} = {shown}, needed for {purpose}: {refusal}"
        ) from refusal
    if kept & compared != value & compared:
        raise DriveRefusedError(
            f"node {service.node_id} took {name} = {shown} but reads back {_shown(kept, size)}; "
            f"needed for {purpose}; choose a value that the drive supports"
        )


def write_if_present(service: Service, index: int, sub: int, value: int, size: int, purpose: str) -> bool:
    """As `write_checked`, but False when the drive does not have the object."""
    if service.read_optional_int(index, sub) is None:
        return False
    write_checked(service, index, sub, value, size, purpose)
    return True


def _shown(value: int, size: int) -> str:
    return f"{value} (0x{value & ((1 << 8 * size) - 1):0{2 * size}X})"

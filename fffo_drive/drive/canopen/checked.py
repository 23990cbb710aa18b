"""Write an object and read it back: a drive that refuses, or keeps a different value, is not enabled."""

from __future__ import annotations

from ..port import DriveRefusedError
from .object_map import object_name
from .service import READ_ONLY, Kept, SdoRefusedError, Service, shown_value


def write_checked(
    service: Service, index: int, sub: int, value: int, size: int, purpose: str, *, mask: int | None = None
) -> None:
    """Write `value` in `size` bytes and compare what the drive then has (under `mask`, if given). It is kept in mind:
    `settings_watch` reads it again while the loop runs.

    An object that is read only may have the value already.
    `purpose` completes "needed for ...". Raises DriveRefusedError naming object, value and the drive's
    reason, and BusUnavailableError when nobody answers.
    """
    name = object_name(index, sub)
    shown = shown_value(value, size)
    compared = mask if mask is not None else (1 << 8 * size) - 1
    told = Kept(value, size, compared, purpose)
    try:
        service.write(index, sub, (value & ((1 << 8 * size) - 1)).to_bytes(size, "little"))
        kept = service.read_int(index, sub)
    except SdoRefusedError as refusal:
        if refusal.code == READ_ONLY and told.is_still(service.read_int(index, sub)):
            service.kept[index, sub] = told
            return
        raise DriveRefusedError(
            f"node {service.node_id} refuses {name} = {shown}, needed for {purpose}: {refusal}"
        ) from refusal
    if not told.is_still(kept):
        raise DriveRefusedError(
            f"node {service.node_id} took {name} = {shown} but reads back {shown_value(kept, size)}; "
            f"needed for {purpose}; choose a value that the drive supports"
        )
    service.kept[index, sub] = told


def write_if_present(service: Service, index: int, sub: int, value: int, size: int, purpose: str) -> bool:
    """As `write_checked`, but False when the drive does not have the object."""
    if service.read_optional_int(index, sub) is None:
        return False
    write_checked(service, index, sub, value, size, purpose)
    return True

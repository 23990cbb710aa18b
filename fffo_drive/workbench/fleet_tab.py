"""What the Fleet tab shows of a store: how far its records are, its drives, what failed, and the axis' own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..commissioning.record import read_record
from ..config.axis import beside, read_axis
from ..documents import DocumentError
from ..extras import needs_extra

LISTED = 100  # drives and failures on the page; `fffo-drive fleet status --json` has all


def store_of(axis: Path | None, given: str | None) -> str | None:
    """The store that was given, else the one that the axis' daemon writes records to; None: neither."""
    store = given
    if store is None and axis is not None:
        try:
            store = read_axis(axis).daemon.fleet
        except (DocumentError, OSError):
            return None  # the page shows what is wrong with it
    return store if store is None or "://" in store else str(Path(store).resolve())


def fleet_state(store: str, axis: Path | None) -> dict[str, Any]:
    """A store for the page. Raises DocumentError where it cannot be read, OSError."""
    try:
        from ..fleet.store import FleetStore, status_object
    except ImportError as error:
        raise DocumentError(f"{error}: {needs_extra('fleet', 'fleet')}") from None
    status = status_object(FleetStore(store))
    names = [row["drive"] for row in status["by_drive"]]
    own = next((name for name in _own_names(axis) if name in names), "")
    shown = sorted(status["by_drive"], key=lambda row: row["drive"] != own)[:LISTED]
    return status | {"own": own, "by_drive": shown, "failures": status["failures"][:LISTED]}


def _own_names(axis: Path | None) -> list[str]:
    """What runs of this axis are filed under: the drive's serial number, else the axis' name."""
    if axis is None:
        return []
    try:
        content = read_axis(axis)
        serials = []
        if content.commissioning:
            serials = [f"0x{read_record(beside(axis, content.commissioning)).drive.serial_number:08X}"]
        return [*serials, content.name]
    except (DocumentError, OSError):
        return []

"""Locations of sockets and recordings, with and without a service manager."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from ..directories import own_directory, require_own, shared_place

CONTROL, WATCH = "control.sock", "watch.sock"
TEMPORARY = "fffo-drive"
SYSTEM_RECORDS = Path("/run/fffo-drive-records")
SYSTEM_DIRECTORY = Path("/run/fffo-drive")  # RuntimeDirectory=fffo-drive/%i of the unit


def socket_directory(name: str, environment: Mapping[str, str] = os.environ) -> Path:
    """Directory of the sockets of an axis: that of the service manager, else the user's runtime directory.

    Without one it is a private temporary directory, which is created. Raises ForeignDirectoryError.
    """
    given = environment.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    if not environment.get("XDG_RUNTIME_DIR"):
        own_directory(shared_place(TEMPORARY))
    return user_directory(environment) / name


def user_directory(environment: Mapping[str, str] = os.environ) -> Path:
    """Directory for the sockets of daemons that no service manager started. Raises ForeignDirectoryError."""
    base = Path(environment.get("XDG_RUNTIME_DIR") or shared_place(TEMPORARY))
    if not environment.get("XDG_RUNTIME_DIR") and os.path.lexists(base):
        require_own(base)
    return base / "fffo-drive"


def records_socket(environment: Mapping[str, str] = os.environ) -> Path | None:
    """Where the unit that makes records of the fleet is asked (fffo-drive-records@.socket); None without one."""
    given = environment.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    path = SYSTEM_RECORDS / f"{Path(given).name}.sock"
    return path if given and path.is_socket() else None


def recordings_directory(environment: Mapping[str, str] = os.environ) -> Path | None:
    """Base of relative recording directories: the state directory of the service; None: the working directory."""
    given = environment.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(given) if given else None

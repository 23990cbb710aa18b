"""Where things are: sockets and recordings, under a service manager and without one."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

CONTROL, WATCH = "control.sock", "watch.sock"
SYSTEM_DIRECTORY = Path("/run/fffo-drive")  # RuntimeDirectory=fffo-drive/%i of the unit


def socket_directory(name: str, environment: Mapping[str, str] = os.environ) -> Path:
    """Where the sockets of an axis are: what the service manager made, else the user's runtime directory."""
    given = environment.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    return user_directory(environment) / name


def user_directory(environment: Mapping[str, str] = os.environ) -> Path:
    """Directory for the sockets of daemons that no service manager started."""
    base = environment.get("XDG_RUNTIME_DIR") or str(Path(tempfile.gettempdir()) / f"fffo-drive-{os.getuid()}")
    return Path(base) / "fffo-drive"


def recordings_directory(environment: Mapping[str, str] = os.environ) -> Path | None:
    """Where relative recording directories begin: the state directory of the service; None: where it was started."""
    given = environment.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(given) if given else None

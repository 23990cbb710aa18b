"""Whether a daemon serves an axis, and what it says."""

from __future__ import annotations

from pathlib import Path

from .client import CallError, ClientError, DaemonClient
from .places import SYSTEM_DIRECTORY, WATCH, user_directory

TORQUE_STATES = ("enabled", "preparing", "running", "following", "stopping")
ANSWER_S = 2.0


def torque_on(name: str, sockets: Path | None = None) -> bool | None:
    """Whether the axis' daemon has torque on; None where no daemon answers."""
    for directory in [sockets] if sockets else [home / name for home in (SYSTEM_DIRECTORY, user_directory())]:
        path = directory / WATCH
        if not path.exists():
            continue
        try:
            with DaemonClient(path, ANSWER_S) as client:
                return str(client.call("status")["state"]) in TORQUE_STATES
        except (ClientError, CallError):
            continue
    return None

"""Which daemon serves an axis, where its sockets are, and whether it has torque on."""

from __future__ import annotations

from pathlib import Path

from .client import CallError, ClientError, DaemonClient, commanding
from .places import CONTROL, SYSTEM_DIRECTORY, WATCH, user_directory
from .states import TORQUE_STATES

ANSWER_S = 2.0


def find_socket(axis: str | None, sockets: str | Path | None, watching: bool) -> Path:
    """The socket of the one daemon that is meant: by name, or in a directory. Raises ClientError."""
    name = WATCH if watching else CONTROL
    if sockets:
        return Path(sockets) / name
    homes = (SYSTEM_DIRECTORY, user_directory())
    found = [path for home in homes for path in sorted(home.glob(f"*/{name}"))]
    if axis:
        found = [path for path in found if path.parent.name == axis]
    if len(found) == 1:
        return found[0]
    if not found:
        which = f" of '{axis}'" if axis else ""
        places = ", ".join(str(home) for home in homes)
        text = f"no daemon{which} in {places}: start one with fffo-drive serve AXIS, or give --sockets"
        raise ClientError(f"{text}{commanding()}")
    raise ClientError(
        f"more than one daemon runs, choose one with --axis: {', '.join(path.parent.name for path in found)}"
    )


def serving(name: str, sockets: Path | None = None) -> tuple[Path, str] | None:
    """(directory of the sockets, state) of the daemon that serves an axis; None where no daemon answers."""
    for directory in [sockets] if sockets else [home / name for home in (SYSTEM_DIRECTORY, user_directory())]:
        path = directory / WATCH
        if not path.exists():
            continue
        try:
            with DaemonClient(path, ANSWER_S) as client:
                return directory, str(client.call("status")["state"])
        except (ClientError, CallError):
            continue
    return None


def torque_on(name: str, sockets: Path | None = None) -> bool | None:
    """Whether the axis' daemon has torque on; None where no daemon answers."""
    found = serving(name, sockets)
    return None if found is None else found[1] in TORQUE_STATES

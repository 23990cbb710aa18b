"""One master per bus on this machine: before a process commands on a bus it takes the lease of the bus, a lock.

The lease is an abstract Unix socket with the bus in its name. The kernel gives a name to one process and takes it back
when that process ends, however it ends; the name is in the same network namespace as the CAN interface and the loopback
bus. The lease does not cover masters on other machines or in other containers, or programs that take no lease: these
are detected by listening (drive/canopen/listening).
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import socket
from pathlib import Path

from .link import LinkError

_NAMES = Path("/proc/self/net/unix")  # abstract names begin with @ there


class BusHeldError(LinkError):
    """Another process on this machine has the lease of the bus. The text names it."""


class BusLease:
    """The lease of a bus, until `close`."""

    def __init__(self, bus: str) -> None:
        """Take it. Raises BusHeldError."""
        self._sockets: list[socket.socket] = []
        try:
            self._bind(_name(bus))
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise LinkError(f"bus {bus!r}: cannot take its lease: {error.strerror}") from error
            raise BusHeldError(
                f"{bus}: {bus_holder(bus) or 'another process'} on this machine commands there"
            ) from error
        with contextlib.suppress(OSError):  # for texts alone
            self._bind(f"{_name(bus)} process {os.getpid()}")

    def _bind(self, name: str) -> None:
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)  # nobody listens on it
        try:
            sock.bind(f"\0{name}")
        except OSError:
            sock.close()
            raise
        self._sockets.append(sock)

    def close(self) -> None:
        """Give it back; a second call does nothing."""
        for sock in self._sockets:
            sock.close()


def bus_holder(bus: str) -> str | None:
    """`process 1234` that has the lease of the bus, if this can be determined; else None."""
    try:
        names = _NAMES.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    found = re.search(f"@{re.escape(_name(bus))} (process [0-9]+)$", names, re.MULTILINE)
    return found[1] if found else None


def _name(bus: str) -> str:
    return f"fffo_drive/bus/{bus}"

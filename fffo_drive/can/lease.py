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

LONGEST_COMMAND = 100  # characters of a command line that are shown
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
    """`process 1234 (fffo-drive serve axis.yaml)` that has the lease of the bus, if this can be determined."""
    return bus_holders().get(bus)


def bus_holders() -> dict[str, str]:
    """Who has the lease of each bus on this machine that somebody commands on, as far as this can be determined."""
    try:
        names = _NAMES.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return {}
    found = re.findall(rf"@{re.escape(_name(''))}(\S+) process ([0-9]+)$", names, re.MULTILINE)
    return {bus: f"process {pid}{_command_of(pid)}" for bus, pid in found}


def _command_of(pid: str) -> str:
    """The command line of a process in brackets, with a blank in front; nothing where it is not ours to see."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8", errors="replace").rstrip("\0").split("\0")
    except OSError:
        return ""
    if len(words) > 1 and Path(words[0]).name.startswith("python"):
        words = words[1:]
    words[0] = Path(words[0]).name
    text = "".join(sign if sign.isprintable() else "?" for sign in " ".join(" ".join(words).split()))
    return f" ({text if len(text) <= LONGEST_COMMAND else f'{text[:LONGEST_COMMAND]}...'})" if text else ""


def _name(bus: str) -> str:
    return f"fffo_drive/bus/{bus}"

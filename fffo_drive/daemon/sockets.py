"""Unix sockets on the file system: mode, group, and stale sockets of dead processes."""

from __future__ import annotations

import contextlib
import errno
import grp
import os
import socket
from pathlib import Path

from ..documents import DocumentError

CONTROL_MODE, WATCH_MODE = 0o660, 0o666


class SocketTakenError(OSError):
    """Another process serves on this socket."""


class ListeningSocket:
    """A socket at a place of the file system, and whether it is still there."""

    def __init__(self, path: Path, mode: int, group: str | None = None) -> None:
        """`group` gets it. Raises as `bound` and `give_to`."""
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self.mode, self.group = path, mode, group
        self.socket = bound(path, mode)
        self._identity = identity_of(path)
        try:
            if group is not None:
                give_to(path, group)
        except DocumentError:
            self.socket.close()
            self.unlink()
            raise

    def is_there(self) -> bool:
        """Whether clients find it at its place."""
        return identity_of(self.path) == self._identity

    def unlink(self) -> None:
        """Take it from its place, unless another one is there."""
        with contextlib.suppress(OSError):
            if self.is_there():
                self.path.unlink()

    def anew(self) -> ListeningSocket:
        """Another one at its place. Raises as the constructor."""
        return ListeningSocket(self.path, self.mode, self.group)


def identity_of(path: Path) -> tuple[int, int] | None:
    """Device and inode of a file; None where there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


def bound(path: Path, mode: int) -> socket.socket:
    """A listening socket of this mode; a stale one is replaced.

    Raises SocketTakenError, OSError.
    """
    if path.exists() and not path.is_socket():
        raise OSError(errno.EEXIST, "is not a socket, and the daemon needs its place; move it away", str(path))
    if path.is_socket():
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(1.0)
            try:
                probe.connect(str(path))
            except (ConnectionRefusedError, FileNotFoundError):
                path.unlink(missing_ok=True)
            except OSError as error:
                raise SocketTakenError(error.errno, f"cannot be used: {error.strerror or error}", str(path)) from error
            else:
                raise SocketTakenError(errno.EADDRINUSE, "another daemon serves this axis; stop it first", str(path))
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
    before = os.umask(0o777 & ~mode)
    try:
        sock.bind(str(path))
    except OSError as error:
        sock.close()
        raise OSError(error.errno, f"control socket: {error.strerror or error}", str(path)) from error
    finally:
        os.umask(before)
    sock.listen(64)
    return sock


def give_to(path: Path, group: str) -> None:
    """Make a group the socket's own. Raises DocumentError for one that does not exist or is not ours."""
    try:
        number = grp.getgrnam(group).gr_gid
    except KeyError:
        raise DocumentError(f"daemon.control_group: no group '{group}' on this machine") from None
    try:
        os.chown(path, -1, number)
    except OSError as error:
        text = f"daemon.control_group: cannot give {path} to '{group}' ({error.strerror}): be a member of it"
        raise DocumentError(text) from None

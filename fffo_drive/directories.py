"""Directories of our own in places that everybody may write to: used only when nobody else can have a hand in them.

Their names can be known in advance: whoever makes one first could exchange compiled code or a socket in it.
"""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from pathlib import Path


class ForeignDirectoryError(OSError):
    """A directory that somebody else made, or may write to."""


def shared_place(name: str) -> Path:
    """Where our own directory of this name is among everybody's: one for each user."""
    return Path(tempfile.gettempdir()) / f"{name}-{os.getuid()}"


def own_directory(path: Path) -> Path:
    """The directory, made for us alone where it is not there. Raises ForeignDirectoryError, OSError."""
    try:
        path.mkdir(mode=0o700)
    except FileExistsError:
        require_own(path)
    return path


def require_own(path: Path) -> None:
    """Raise ForeignDirectoryError unless it is a directory, no link to one, ours, and nobody else may write to it."""
    found = path.lstat()
    if not stat.S_ISDIR(found.st_mode):
        problem = "a link" if stat.S_ISLNK(found.st_mode) else "no directory"
    elif found.st_uid != os.getuid():
        problem = f"not ours: it belongs to uid {found.st_uid}"
    elif found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        problem = f"open to others: its mode is {stat.S_IMODE(found.st_mode):04o}"
    else:
        return
    text = f"{problem}, and it is in a place where everybody may write; remove it and start again"
    raise ForeignDirectoryError(errno.EPERM, text, str(path))


def as_typed(path: str) -> str:
    """A path as it is typed in the current directory: relative where it lies below, else as it is."""
    here = Path.cwd()
    return str(Path(path).relative_to(here)) if Path(path).is_relative_to(here) else path

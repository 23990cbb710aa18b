"""A machine as files: /proc and /sys of this one, or of another one under a directory that `write_record` made."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence
from pathlib import Path

COMMANDS = "commands"  # directory of a record that holds what commands printed
COMMAND_TIMEOUT_S = 10.0


class Host:
    """Reads the machine whose root directory is `root`; remembers what it has read.

    Paths are absolute, as on that machine. What is not there, or may not be read, is None.
    """

    def __init__(self, root: str | Path = "/") -> None:
        self.root = Path(root)
        self._contents: dict[str, bytes] = {}
        self._links: dict[str, str] = {}

    @property
    def live(self) -> bool:
        """This machine, not a record of one."""
        return self.root == Path("/")

    def content(self, path: str) -> bytes | None:
        """The bytes of a file."""
        try:
            found = self._at(path).read_bytes()
        except (OSError, ValueError):  # ValueError: a path made from what another file says may be none
            return None
        self._contents[path.lstrip("/")] = found
        return found

    def text(self, path: str) -> str | None:
        """The text of a file, without white space at its ends."""
        found = self.content(path)
        return None if found is None else found.decode("utf-8", "replace").strip()

    def number(self, path: str) -> int | None:
        """The integer in a file."""
        try:
            return int(self.text(path) or "")
        except ValueError:
            return None

    def link(self, path: str) -> str | None:
        """Last part of what a symbolic link leads to (the driver of a device, for example)."""
        try:
            target = os.readlink(self._at(path))
        except OSError:
            return None
        self._links[path.lstrip("/")] = target
        return os.path.basename(target)

    def names(self, path: str) -> list[str]:
        """Names in a directory, sorted; empty without the directory."""
        try:
            return sorted(os.listdir(self._at(path)))
        except OSError:
            return []

    def output(self, command: Sequence[str]) -> str | None:
        """What a command prints; None when there is no such command, or it fails."""
        place = f"{COMMANDS}/{' '.join(command)}"
        if not self.live:
            return self.text(place)
        try:
            done = subprocess.run(command, capture_output=True, timeout=COMMAND_TIMEOUT_S, check=True)
        except (OSError, subprocess.SubprocessError):
            return None
        self._contents[place] = done.stdout
        return done.stdout.decode("utf-8", "replace").strip()

    def write_record(self, directory: Path) -> None:
        """Everything that was read so far, as files under `directory`: a `root` for another Host."""
        for name, found in self._contents.items():
            place = directory / name
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(found)
        for name, target in self._links.items():
            place = directory / name
            place.parent.mkdir(parents=True, exist_ok=True)
            place.unlink(missing_ok=True)
            place.symlink_to(target)

    def _at(self, path: str) -> Path:
        return self.root / path.lstrip("/")


def cpu_list(text: str | None) -> set[int]:
    """CPUs of a list as the kernel prints it: `0-2,5`; empty for none."""
    found: set[int] = set()
    for part in (text or "").split(","):
        low, _, high = part.strip().partition("-")
        if low.isdigit():
            found.update(range(int(low), int(high or low) + 1))
    return found

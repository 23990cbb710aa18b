"""Programs of the system that belong to an installation: the group, and telling systemd and udev of new files."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from .service_files import GROUP

TIMEOUT_S = 60.0
RUNNING_SYSTEMD = Path("/run/systemd/system")  # sd_booted(3)
RUNNING_UDEV = Path("/run/udev/control")
SYSTEM_PATHS = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


class SystemCommand(NamedTuple):
    """One program to run. `purpose` is what is missing without it."""

    words: tuple[str, ...]
    purpose: str


class Result(NamedTuple):
    """What came of it: an empty `problem` when it worked."""

    command: SystemCommand
    problem: str


def after_install(root: Path) -> list[SystemCommand]:
    """The group; on this machine itself also news for systemd and udev."""
    made = SystemCommand(("systemd-sysusers", f"--root={root}", "fffo-drive.conf"), f"group {GROUP}")
    if not is_live(root):
        return [made]
    return [made._replace(words=("systemd-sysusers", "fffo-drive.conf")), *_news()]


def after_removal(root: Path) -> list[SystemCommand]:
    """The same backwards."""
    purpose = f"group {GROUP} away"
    if not is_live(root):
        return [SystemCommand(("groupdel", "--prefix", str(root), GROUP), purpose)]
    return [SystemCommand(("groupdel", GROUP), purpose), *_news()]


def _news() -> list[SystemCommand]:
    """What running programs are told; nothing in a chroot or a container without them."""
    news = [
        (RUNNING_SYSTEMD, SystemCommand(("systemctl", "daemon-reload"), "systemd knows of the unit")),
        (RUNNING_UDEV, SystemCommand(("udevadm", "control", "--reload"), "udev knows of the rules")),
    ]
    return [command for sign, command in news if sign.exists()]


def is_live(root: Path) -> bool:
    """This machine, not a root directory of another one."""
    return root.resolve() == Path("/")


def has_group(root: Path) -> bool:
    """Whether the group is in the machine's own file."""
    try:
        lines = (root / "etc/group").read_text(encoding="utf-8").splitlines()
    except OSError:
        return False
    return any(line.startswith(f"{GROUP}:") for line in lines)


def run_commands(commands: Sequence[SystemCommand]) -> list[Result]:
    """Run all; one that fails or is not installed does not keep the next from running."""
    return [Result(command, _problem(command.words)) for command in commands]


def active_instances() -> list[str]:
    """Units of the service that run on this machine; empty without systemd."""
    program = shutil.which("systemctl", path=SYSTEM_PATHS)
    if program is None:
        return []
    words = (program, "list-units", "--plain", "--no-legend", "--state=active,activating,reloading", "fffo-drive@*")
    done = subprocess.run(words, capture_output=True, text=True, timeout=TIMEOUT_S)
    return [line.split()[0] for line in done.stdout.splitlines() if line.strip()]


def _problem(words: tuple[str, ...]) -> str:
    program = shutil.which(words[0], path=SYSTEM_PATHS)
    if program is None:
        return f"{words[0]} is not installed"
    try:
        done = subprocess.run((program, *words[1:]), capture_output=True, text=True, timeout=TIMEOUT_S)
    except (OSError, subprocess.SubprocessError) as error:
        return str(error)
    said = " ".join((done.stderr or done.stdout).split())
    return "" if done.returncode == 0 else said or f"exit code {done.returncode}"

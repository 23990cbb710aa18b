"""The files of the service: where they lie in the package, where they go on a machine, and how they are filled in."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

PACKAGE = Path(__file__).resolve().parent.parent
GROUP = "fffo-drive"
UNIT = "fffo-drive@.service"
RECORDS_UNIT, RECORDS_SOCKET = "fffo-drive-records@.service", "fffo-drive-records@.socket"
PROGRAM = "/opt/fffo-drive/bin/fffo-drive"  # as it stands in the unit
BUS_LINE = re.compile(r"^  bus: \S+.*$", re.MULTILINE)
EXAMPLE_SUFFIX = ".example"

UNITS = "etc/systemd/system"
NETWORK = "etc/systemd/network"
CONFIG = "etc/fffo-drive"
MANIFEST = "etc/fffo-drive/.installed.json"


class ServiceFile(NamedTuple):
    """One file to put in place. `path` is relative to the root directory of the machine."""

    path: str
    content: bytes

    @property
    def digest(self) -> str:
        """SHA-256 of the content."""
        return digest_of(self.content)


def digest_of(content: bytes) -> str:
    """SHA-256, hex."""
    return hashlib.sha256(content).hexdigest()


def sources() -> tuple[Path, Path]:
    """Directories `systemd` and `configs`: inside an installed package, else beside it in a source tree.

    Raises FileNotFoundError.
    """
    for parent in (PACKAGE / "files", PACKAGE.parent):
        if (parent / "systemd" / UNIT).is_file() and (parent / "configs").is_dir():
            return parent / "systemd", parent / "configs"
    text = "the package lacks its service files or its examples; install it again with pip"
    raise FileNotFoundError(2, text, str(PACKAGE / "files"))


def example_files() -> dict[str, bytes]:
    """Everything below `configs`, by its path there, in order. Raises FileNotFoundError."""
    _, configs = sources()
    files = sorted(path for path in configs.rglob("*") if path.is_file())
    return {path.relative_to(configs).as_posix(): path.read_bytes() for path in files}


def service_files(program: Path, networks: Iterable[str] = ()) -> list[ServiceFile]:
    """All files, filled in: `program` is what the unit starts.

    Network files are examples (named .example, which networkd passes over), but for the interfaces in `networks`.
    """
    systemd, configs = sources()
    units = {name: (systemd / name).read_text(encoding="utf-8") for name in (UNIT, RECORDS_UNIT, RECORDS_SOCKET)}
    found = [
        *(ServiceFile(f"{UNITS}/{name}", text.replace(PROGRAM, str(program)).encode()) for name, text in units.items()),
        ServiceFile("etc/udev/rules.d/90-fffo-drive.rules", (systemd / "90-fffo-drive.rules").read_bytes()),
        ServiceFile("etc/sysusers.d/fffo-drive.conf", (systemd / "sysusers.conf").read_bytes()),
    ]
    chosen = set(networks)
    for path in sorted((systemd / "network").iterdir()):
        suffix = "" if interface_of(path.name) in chosen else EXAMPLE_SUFFIX
        found.append(ServiceFile(f"{NETWORK}/{path.name}{suffix}", path.read_bytes()))
    axis = (configs / "axis_canopen.yaml").read_text(encoding="utf-8")
    found += [ServiceFile(f"{CONFIG}/{name}.yaml", axis_on(axis, name).encode()) for name in ("can0", "vcan0")]
    beside = ("models/table1.yaml", "simulated_drive.yaml")
    found += [ServiceFile(f"{CONFIG}/{name}", (configs / name).read_bytes()) for name in beside]
    return found


def example_interfaces() -> list[str]:
    """Interfaces for which there are network files."""
    systemd, _ = sources()
    return sorted({interface_of(path.name) for path in (systemd / "network").iterdir()})


def interface_of(name: str) -> str:
    """can0 of 80-fffo-can0.network."""
    return Path(name).stem.rpartition("-")[2]


def axis_on(text: str, interface: str) -> str:
    """The commented axis file, for the service of an interface."""
    filled, count = BUS_LINE.subn(f"  bus: socketcan:{interface}", text)
    assert count == 1, "configs/axis_canopen.yaml: one line `bus:`"
    head = (
        f"# Axis of the service fffo-drive@{interface}; `systemctl reload fffo-drive@{interface}` reads it again.\n#\n"
    )
    return head + filled.replace("name: canopen", f"name: {interface}")

"""Tests that need something of the machine: what it is, whether it is here, and a word about what was left out.

A test with one of the markers in `NEEDS` is left out where the need is not met; the last lines of a run say so, and
why. FFFO_REQUIRE=NAME,NAME (or `all`) makes it an error instead.
"""

from __future__ import annotations

import functools
import importlib.util
import os
import shutil
import socket
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
VCAN = "vcan0"
LEFT_OUT = "left_out"  # key of the counts that a worker of pytest-xdist hands over
SEARCHED = os.environ.get("PATH", "") + ":/usr/local/sbin:/usr/sbin:/sbin"


def vcan_missing() -> str | None:
    """AF_CAN, an interface that is up, and the right to take it down."""
    in_uml = "tools/uml/test runs them, in a user-mode kernel where need be"
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as probe:
            probe.bind((VCAN,))
    except OSError as error:
        what = (
            f"no interface {VCAN}" if isinstance(error, OSError) and error.errno == 19 else "no AF_CAN in this kernel"
        )
        return f"{what} ({error.strerror}); {in_uml}"
    return None if os.geteuid() == 0 else f"not root, so {VCAN} cannot be taken down; {in_uml}"


def program_missing(name: str, package: str) -> str | None:
    """A program of a Debian package."""
    return None if shutil.which(name, path=SEARCHED) else f"no {name}; on Debian: apt install {package}"


def uml_missing() -> str | None:
    """The kernel, and a processor on which it runs (tools/uml/run)."""
    if "amx_tile" in Path("/proc/cpuinfo").read_text().split():
        return "this processor has AMX, whose registers the user-mode kernel cannot restore"
    return program_missing("linux.uml", "user-mode-linux")


def node_canopen_missing() -> str | None:
    """The npm package `canopen`."""
    if shutil.which("node") is None:
        return "no node; on Debian: apt install nodejs npm"
    if not (ROOT / ".venv" / "counterparts" / "node_modules" / "canopen").is_dir():
        return "npm's canopen is not installed; tools/counterparts installs it where that is possible"
    return None


def browser_missing() -> str | None:
    """A Chromium (tools/headless.py), and what drives it."""
    if importlib.util.find_spec("playwright") is None:
        return "no playwright; tools/environment test installs it"
    names = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome")
    return None if any(map(shutil.which, names)) else "no Chromium; on Debian: apt install chromium"


NEEDS: dict[str, Callable[[], str | None]] = {
    "vcan": vcan_missing,
    "uml": uml_missing,
    "systemd": lambda: None if Path("/lib/systemd/systemd-udevd").exists() else "on Debian: apt install systemd udev",
    "tshark": lambda: program_missing("tshark", "tshark"),
    "can_utils": lambda: program_missing("candump", "can-utils"),
    "node_canopen": node_canopen_missing,
    "browser": browser_missing,
}
missing = functools.cache(lambda name: NEEDS[name]())


def pytest_configure(config: pytest.Config) -> None:
    """What is required by name must be here, whatever is collected: reported once, and not by workers that end."""
    required = set(filter(None, os.environ.get("FFFO_REQUIRE", "").split(",")))
    if unknown := sorted(required - {*NEEDS, "all"}):
        raise pytest.UsageError(f"FFFO_REQUIRE: {unknown[0]} is none of {', '.join(NEEDS)}, all")
    if not hasattr(config, "workerinput"):
        _refuse(name for name in sorted(required - {"all"}) if missing(name) is not None)


def _refuse(names: Iterable[str]) -> None:
    if text := "; ".join(f"{name} is required (FFFO_REQUIRE): {missing(name)}" for name in names):
        raise pytest.UsageError(text)


def _unmet(item: pytest.Item) -> list[str]:
    return [name for name in NEEDS if item.get_closest_marker(name) is not None and missing(name) is not None]


@pytest.hookimpl(trylast=True)  # after -k and -m
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what cannot run here."""
    unmet = {item: _unmet(item) for item in items}
    counts = Counter(names[0] for names in unmet.values() if names)
    required = os.environ.get("FFFO_REQUIRE", "").split(",")
    if "all" in required:
        _refuse(sorted({name for names in unmet.values() for name in names}))
    left_out = [item for item in items if unmet[item]]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not unmet[item]]
    items.sort(key=lambda item: item.get_closest_marker("systemd") is None)  # minutes long: no worker ends on it alone
    config.stash[COUNTS] = dict(counts)
    if hasattr(config, "workeroutput"):
        config.workeroutput[LEFT_OUT] = dict(counts)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object) -> None:
    """A worker of pytest-xdist has ended: every one of them has collected the same."""
    node.config.stash[COUNTS] = getattr(node, "workeroutput", {}).get(LEFT_OUT, {})


def pytest_terminal_summary(terminalreporter: Any, exitstatus: int, config: pytest.Config) -> None:
    """What was left out, and why."""
    for name, count in sorted(config.stash.get(COUNTS, {}).items()):
        terminalreporter.write_line(f"left out: {count} tests marked {name}: {missing(name)}")


COUNTS = pytest.StashKey[dict[str, int]]()

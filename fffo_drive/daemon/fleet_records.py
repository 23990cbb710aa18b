"""Records of what the service records, for a fleet's store: by a process of its own, when nothing else wants the CPU.

Under systemd that is a unit of its own, with its own limit of memory; else a child, which is the first to be killed.

A file is on the disk before its record is begun, so that a process that fails or is ended costs nothing: `fffo-drive
fleet add STORE --from DIRECTORY` takes up what has no record.
"""

from __future__ import annotations

import asyncio
import json
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from ..recording.events import Level
from .event_log import EventLog
from .places import records_socket
from .worker import Worker

LONGEST_S = 3600.0  # of one process: a processor that is never idle
FIRST_TO_GO = 'echo 1000 2>/dev/null >/proc/self/oom_score_adj; exec "$@"'  # proc(5)
LONGEST_TEXT = 300  # characters of its output that are reported


class FleetRecords:
    """One process at a time; the files of a recording go to it together."""

    def __init__(self, log: EventLog) -> None:
        self._log = log
        self._worker = Worker("fffo-fleet")
        self._tasks: set[asyncio.Task[None]] = set()

    def take(self, store: str, files: Sequence[str]) -> None:
        """Have the records of finished files made; returns at once."""
        task = asyncio.get_running_loop().create_task(self._take(store, files))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _take(self, store: str, files: Sequence[str]) -> None:
        problem = await self._worker.run(_make, store, list(files))
        if problem:
            text = f"no record for the fleet's store {store}: {problem}"
            self._log.add("recording", text, Level.WARNING, {"files": list(files)})


def command(store: str, files: Sequence[str]) -> list[str]:
    """What makes the records: this program, one process, scheduled when nothing else is and the first to be killed.

    The shell says that before the program begins to take memory: of a service's child the score would be the service's.
    """
    made = ["fleet", "add", store, *files, "--work", "--workers", "1", "--idle", "--json"]
    return ["/bin/sh", "-c", FIRST_TO_GO, "sh", sys.executable, "-m", "fffo_drive", *made]


def _make(store: str, files: list[str]) -> str:
    """Have it made; what it complains of, empty where it did its work."""
    unit = records_socket()
    if unit is not None:
        return _ask(unit, store, files)
    try:
        done = subprocess.run(
            command(store, files), stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=LONGEST_S
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    said = done.stderr.strip()
    return said[-LONGEST_TEXT:] or f"exit code {done.returncode}" if done.returncode else ""


def _ask(unit: Path, store: str, files: list[str]) -> str:
    """The same by a unit of the service manager: one line to `fffo-drive fleet answer`, one line back."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC) as sock:
            sock.settimeout(LONGEST_S)
            sock.connect(str(unit))
            sock.sendall(json.dumps({"store": store, "files": files}).encode() + b"\n")
            with sock.makefile("rb") as answer:
                line = answer.readline()
        if not line:
            return f"fffo-drive-records@{unit.stem} ended without an answer; systemctl status says why (out of memory?)"
        return str(json.loads(line)["problem"])[-LONGEST_TEXT:]
    except (OSError, ValueError, KeyError) as error:
        return f"{unit}: {error}"

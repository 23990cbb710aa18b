"""Records of what the service records, for a fleet's store: by a process of its own, when nothing else wants the CPU.

A file is on the disk before its record is begun, so that a process that fails or is ended costs nothing: `fffo-drive
fleet add STORE --from DIRECTORY` takes up what has no record.
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Sequence

from ..recording.events import Level
from .event_log import EventLog
from .worker import Worker

LONGEST_S = 3600.0  # of one process: a processor that is never idle
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
        problem = await self._worker.run(_make, command(store, files))
        if problem:
            text = f"no record for the fleet's store {store}: {problem}"
            self._log.add("recording", text, Level.WARNING, {"files": list(files)})


def command(store: str, files: Sequence[str]) -> list[str]:
    """What makes the records: this program, one process, scheduled when nothing else is."""
    made = ["fleet", "add", store, *files, "--work", "--workers", "1", "--idle", "--json"]
    return [sys.executable, "-m", "fffo_drive", *made]


def _make(words: list[str]) -> str:
    """Run it; what it complains of, empty where it did its work."""
    try:
        done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=LONGEST_S)
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    said = done.stderr.strip()
    return said[-LONGEST_TEXT:] or f"exit code {done.returncode}" if done.returncode else ""

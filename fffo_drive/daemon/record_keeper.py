"""Recording while the daemon runs: on and off, a new file for each connection, and error supervision."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Coroutine, Mapping
from pathlib import Path
from typing import Any, TypeVar

from ..config.axis import beside, recorder_settings
from ..recording.events import Level
from ..recording.recorder import Recorder
from ..recording.settings import RecorderHooks, RunHeader
from ..recording.writer import wall_clock_offset_ns
from ..runtime.runs import run_metadata, timestamp_name
from ..workflows.plan import YAML_TYPE, Plan
from .connection import Connection
from .event_log import EventLog
from .fleet_records import FleetRecords
from .worker import Worker

DISK_TIMEOUT_S = 30.0
LULL_S = 2.0  # without a loss: what was lost before belongs to a failure that is over
T = TypeVar("T")
LEVELS = {level.name.lower(): level for level in Level}


class Sources:
    """The files attached to a recording, as they were when they were read."""

    def __init__(self, plan: Plan) -> None:
        """The files of a plan, read now. Raises OSError."""
        model = beside(plan.path, plan.axis.model)
        self.axis = (plan.path.name, YAML_TYPE, plan.path.read_bytes())
        self.model = (model.name, YAML_TYPE, model.read_bytes())
        record = plan.axis.commissioning
        self.extra: tuple[tuple[str, str, bytes], ...] = ()
        if record is not None:
            with contextlib.suppress(OSError):
                self.extra = ((Path(record).name, YAML_TYPE, beside(plan.path, record).read_bytes()),)


class RecordKeeper:
    """At most one recorder. Operations that wait for the disk run on another thread, each to its end, even if who
    asked for it no longer waits.
    """

    def __init__(self, log: EventLog, directory: Path | None, clock: Callable[[], float] = time.monotonic) -> None:
        """`directory`: for recordings whose configured directory is relative; None: the working directory."""
        self._log, self._clock = log, clock
        self._base = directory
        self.hooks = RecorderHooks()  # of recorders started from now on
        self.wanted = False
        self._recorder: Recorder | None = None
        self._changing = asyncio.Lock()
        self._changes: set[asyncio.Task[Any]] = set()
        self._disk = Worker("fffo-disk")
        self._no_file = ""  # why there is none
        self._losses = (0, 0)  # of the recorder, as last seen
        self._lost_s = -math.inf
        self.last_files: tuple[Path, ...] = ()
        self._fleet = FleetRecords(log)
        self._store: str | None = None  # of the fleet, for the file that is being written

    async def begin(self, plan: Plan, connection: Connection | None, sources: Sources, toggle: int, note: str) -> str:
        """Begin a file now, or (without a connection, "") with the next connection. Raises OSError."""
        self.wanted = True
        if connection is not None:
            self._no_file = "no file is open yet"
        return await self._to_its_end(self._begin(plan, connection, sources, toggle, note))

    async def end(self) -> list[str]:
        """End the file. Returns the files of this recording."""
        return await self._to_its_end(self._end())

    async def _to_its_end(self, change: Coroutine[Any, Any, T]) -> T:
        task = asyncio.ensure_future(change)
        self._changes.add(task)
        task.add_done_callback(self._changes.discard)
        return await asyncio.shield(task)

    async def _begin(self, plan: Plan, connection: Connection | None, sources: Sources, toggle: int, note: str) -> str:
        path = ""
        async with self._changing:
            if connection is not None and not self.running:
                try:
                    path = str(await self._disk.run(self._start, plan, connection, sources, toggle, note))
                except OSError as error:
                    self._no_file = f"no file: {error}"
                    raise
            self._no_file = ""
        if path:
            self._log.add("recording", f"recording to {path}", data={"file": path})
        return path

    async def _end(self) -> list[str]:
        async with self._changing:
            if not self.running:
                return []
            files = [str(file) for file in await self._disk.run(self._stop)]
        self._log.add("recording", f"recorded {', '.join(files) or 'nothing'}", data={"files": files})
        if self._store is not None and files:
            self._fleet.take(self._store, files)
        return files

    def _start(self, plan: Plan, connection: Connection, sources: Sources, toggle: int, note: str) -> Path:
        directory = (self._base or Path()) / plan.axis.recording.directory
        directory.mkdir(parents=True, exist_ok=True)
        path = directory / f"{timestamp_name(plan.axis.name, time.time_ns())}.mcap"
        number = 1
        while path.exists() or path.with_name(path.name + ".part").exists():
            number += 1
            path = directory / f"{timestamp_name(plan.axis.name, time.time_ns())}_{number}.mcap"
        facts = {"commissioning": note, "source": "daemon", "connection": str(connection.number)}
        # profiles come and go while it records: each has a record of its own
        metadata = run_metadata(plan.axis.name, connection.identity, toggle, plan.profile.period_s, facts)
        header = RunHeader(metadata, (sources.axis, sources.model, *sources.extra), wall_clock_offset_ns())
        recorder = Recorder(
            connection.session.ring, path, header, recorder_settings(plan.axis), self.hooks, from_now=True,
            records=connection.session.records,
        )  # fmt: skip
        recorder.start()
        self._losses, self._lost_s, self._recorder = (0, 0), -math.inf, recorder  # in this order: turns look at them
        store = plan.axis.daemon.fleet
        self._store = store if store is None or "://" in store else str((self._base or Path()) / store)
        return path

    def _stop(self) -> tuple[Path, ...]:
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            return ()
        if recorder.alive:
            recorder.stop(None, DISK_TIMEOUT_S)
        else:  # rows not yet written are drained here
            recorder.close()
        self.last_files = recorder.statistics.files
        return self.last_files

    @property
    def busy(self) -> bool:
        """Whether a file is being opened or closed."""
        return bool(self._changes) or self._disk.busy

    @property
    def running(self) -> bool:
        """Whether a file is being written, or should be."""
        return self._recorder is not None

    def tell(self, event: Mapping[str, Any]) -> None:
        """An event of the daemon's, into the file."""
        if self._recorder is not None:
            self._recorder.event(LEVELS[event["level"]], "supervisor", event["text"], {"kind": event["kind"]})

    def trouble(self) -> str:
        """Why the recording is incomplete; empty if it is complete."""
        recorder = self._recorder
        if recorder is None:
            return self._no_file if self.wanted else ""
        if not recorder.alive:
            return "the recorder's thread has ended"
        statistics = recorder.statistics
        missing = statistics.rows_dropped + statistics.rows_lost
        if missing or statistics.write_errors:
            return f"{missing} rows are missing: {statistics.last_error or 'the disk was too slow for the ring'}"
        return ""

    def failure(self) -> str:
        """Why the recording that is wanted fails now; empty if it does not, or none is wanted."""
        recorder = self._recorder
        if recorder is None or not recorder.alive:
            return self.trouble()
        statistics = recorder.statistics
        losses = statistics.rows_dropped + statistics.rows_lost, statistics.write_errors
        if losses != self._losses:
            self._losses, self._lost_s = losses, self._clock()
        return self.trouble() if self._clock() - self._lost_s < LULL_S else ""

    def status(self) -> dict[str, Any]:
        """For the API."""
        recorder = self._recorder
        if recorder is None:
            files = [str(file) for file in self.last_files]
            return {"on": False, "wanted": self.wanted, "file": None, "finished": files, "trouble": self.trouble()}
        s = recorder.statistics
        return {
            "on": True,
            "wanted": self.wanted,
            "file": str(recorder.current_path) if recorder.current_path else None,
            "finished": [str(file) for file in s.files],
            "rows_written": s.rows_written,
            "rows_lost": s.rows_lost,
            "rows_dropped": s.rows_dropped,
            "write_errors": s.write_errors,
            "trouble": self.trouble(),
        }

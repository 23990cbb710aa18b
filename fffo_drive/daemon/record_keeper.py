"""Recording while the daemon runs: on and off, a new file for each connection, and error supervision."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from ..config.axis import beside, recorder_settings
from ..recording.disk import life_text
from ..recording.events import Event, Level
from ..recording.recorder import Recorder
from ..recording.rotation import SERVICE
from ..recording.settings import RecorderHooks, RunHeader
from ..recording.writer import wall_clock_offset_ns
from ..runtime.runs import run_metadata, timestamp_name
from ..workflows.plan import YAML_TYPE, Plan
from . import worker
from .connection import Connection
from .event_log import EventLog
from .fleet_records import FleetRecords
from .worker import Stillness, Worker, silence

LONGEST_LOOK_S = 0.5
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
        self._disk = Worker("fffo-disk", log.tell_disk)
        self._stillness = Stillness(LONGEST_LOOK_S)  # of the recorder's thread
        self._stuck = ""  # by which the disk keeps it
        self._no_file = ""  # why there is none
        self._losses = (0, 0)  # of the recorder, as last seen
        self._lost_s = -math.inf
        self.last_files: tuple[Path, ...] = ()
        self._fleet = FleetRecords(log)
        self._store: str | None = None  # of the fleet, for the file that is being written
        self._loop: asyncio.AbstractEventLoop | None = None  # of the service, for what the recorder's thread tells
        self._hearing = False  # an event of the recorder's, which has it in its file

    async def begin(self, plan: Plan, connection: Connection | None, sources: Sources, toggle: int, note: str) -> str:
        """Begin a file now, or (without a connection, "") with the next connection. Raises OSError."""
        self.wanted = True
        self._loop = asyncio.get_running_loop()
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
                    recorder, file = await self._disk.run(
                        self._start,
                        plan,
                        connection,
                        sources,
                        toggle,
                        note,
                        doing="opening a recording in",
                        at=self._directory(plan),
                        late=self._end_late,
                    )
                except OSError as error:
                    self._no_file = f"no file: {error}"
                    raise
                path = str(file)
                self._losses, self._lost_s, self._recorder = (0, 0), -math.inf, recorder
                store = plan.axis.daemon.fleet
                self._store = store if store is None or "://" in store else str((self._base or Path()) / store)
            self._no_file = ""
        if path:
            self._log.add("recording", f"recording to {path}", data={"file": path})
        return path

    async def _end(self) -> list[str]:
        loop = asyncio.get_running_loop()
        async with self._changing:
            recorder, self._recorder, self._stuck = self._recorder, None, ""
            if recorder is None:
                return []
            found = await self._disk.run(
                self._stop,
                recorder,
                doing="closing",
                at=recorder.current_path,
                late=lambda files: loop.call_soon_threadsafe(self._recorded, files, self._store),
            )
            return self._recorded(found, self._store)

    def _recorded(self, found: Sequence[Path], store: str | None) -> list[str]:
        """Files are finished."""
        self.last_files = tuple(found)
        files = [str(file) for file in found]
        self._log.add("recording", f"recorded {', '.join(files) or 'nothing'}", data={"files": files})
        if store is not None and files:
            self._fleet.take(store, files)
        return files

    def _directory(self, plan: Plan) -> Path:
        return (self._base or Path()) / plan.axis.recording.directory

    def _start(
        self, plan: Plan, connection: Connection, sources: Sources, toggle: int, note: str
    ) -> tuple[Recorder, Path]:
        directory = self._directory(plan)
        directory.mkdir(parents=True, exist_ok=True)
        path = directory / f"{timestamp_name(plan.axis.name, time.time_ns())}.mcap"
        number = 1
        while path.exists() or path.with_name(path.name + ".part").exists():
            number += 1
            path = directory / f"{timestamp_name(plan.axis.name, time.time_ns())}_{number}.mcap"
        facts = {"commissioning": note, "source": SERVICE, "connection": str(connection.number)}
        # profiles come and go while it records: each has a record of its own
        metadata = run_metadata(plan.axis.name, connection.identity, toggle, plan.profile.period_s, facts)
        header = RunHeader(metadata, (sources.axis, sources.model, *sources.extra), wall_clock_offset_ns())
        recorder = Recorder(
            connection.session.ring,
            path,
            header,
            recorder_settings(plan.axis, of_service=True),
            self._telling_hooks(),
            from_now=True,
            records=connection.session.records,
            memory=connection.session,
        )
        recorder.start()
        return recorder, path

    def _telling_hooks(self) -> RecorderHooks:
        """The hooks, and events of the recorder that the daemon does not find out itself: what the quota deleted."""
        if self.hooks.on_event is not None or self._loop is None:
            return self.hooks
        loop = self._loop

        def tell(event: Event) -> None:  # on the recorder's thread
            if "quota_bytes" in event.data:
                loop.call_soon_threadsafe(self._hear, event)

        return replace(self.hooks, on_event=tell)

    def _hear(self, event: Event) -> None:
        self._hearing = True
        try:
            self._log.add("recording", event.text, Level(event.level), event.data)
        finally:
            self._hearing = False

    def _stop(self, recorder: Recorder) -> tuple[Path, ...]:
        if recorder.alive:
            recorder.stop()
        else:  # rows not yet written are drained here
            recorder.close()
        return recorder.statistics.files

    def _end_late(self, opened: tuple[Recorder, Path]) -> None:
        """A file that was opened after nobody waited for it any more."""
        recorder, path = opened
        recorder.stop()
        self._log.add("recording", f"{path} was opened too late, and is closed again", Level.WARNING)

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
        if self._recorder is not None and not self._hearing:
            self._recorder.event(LEVELS[event["level"]], "supervisor", event["text"], {"kind": event["kind"]})

    def trouble(self) -> str:
        """Why the recording is incomplete; empty if it is complete."""
        recorder = self._recorder
        if recorder is None:
            return self._no_file if self.wanted else ""
        if not recorder.alive:
            return "the recorder's thread has ended"
        if self._stuck:
            return self._stuck
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
        if self._stillness.look((id(recorder), recorder.turns), self._clock()) < worker.DISK_PATIENCE_S:
            self._stuck = ""
        elif not self._stuck:
            self._stuck = silence(f"writing {recorder.current_path}")
        if self._stuck:
            return self._stuck
        statistics = recorder.statistics
        losses = statistics.rows_dropped + statistics.rows_lost, statistics.write_errors
        if losses != self._losses:
            self._losses, self._lost_s = losses, self._clock()
        return self.trouble() if self._clock() - self._lost_s < LULL_S else ""

    @property
    def silent(self) -> str:
        """To what the disk does not answer; empty where it does."""
        return self._stuck or self._disk.silent

    @property
    def hangs(self) -> bool:
        """Whether a file that nobody waits for any more is still being opened or closed."""
        return self._disk.hangs

    def status(self) -> dict[str, Any]:
        """For the API."""
        recorder = self._recorder
        if recorder is None:
            files = [str(file) for file in self.last_files]
            return {"on": False, "wanted": self.wanted, "file": None, "finished": files, "trouble": self.trouble()}
        s, life = recorder.statistics, recorder.disk_life
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
            "disk_life": None if life is None else {**life._asdict(), "text": life_text(life)},
        }

"""The recorder: drains the ring on a thread of ordinary priority and writes files, whatever the state of the disk.

The loop never waits for it. If the disk is full, gone or slow, rows are lost, counted and reported; the thread
continues to drain and opens a new file as soon as possible.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..units import NS_PER_S
from .disk import DiskLife, disk_life
from .events import Event, Level
from .ring_reader import ReadableRing, RingReader
from .run_files import RunFiles
from .run_records import FileStart, MemorySource, RecordBook, RunRecord
from .settings import RecorderHooks, RecorderSettings, RecorderStatistics, RunHeader

SOURCE = "recorder"
WRITE_ROWS = 4096  # between checks of the file size: a run in simulated time arrives in one piece
MEASURED_S = 10.0  # of recording, before its rate is known
EVENT_QUEUE = 4096  # events kept while no file is open; older ones are counted as lost
MEMORY_TIMEOUT_S, MEMORY_POLL_S = 0.5, 0.001  # for the loop's answer, which comes with its next tick


class Recorder:
    """Records a ring into `path` (NAME.mcap, and NAME_002.mcap ... after rotation or an error).

    It begins with the oldest row of the ring or, `from_now`, with the newest. The first file is opened here, so
    that a path that cannot be written raises OSError before anything moves. Then either `start` and `stop`
    the thread, or call `drain_once` and `close`, never both at a time. `records`: of the session that writes the ring.
    `memory`: its loop; every file that begins in the midst of its rows then begins with what it remembers.
    """

    def __init__(
        self,
        ring: ReadableRing,
        path: Path | str,
        header: RunHeader | None = None,
        settings: RecorderSettings | None = None,
        hooks: RecorderHooks | None = None,
        *,
        from_now: bool = False,
        records: RecordBook | None = None,
        memory: MemorySource | None = None,
    ) -> None:
        self._records: deque[RunRecord] = deque()
        self._book = records
        # subscribed before the first row is read: records named by that row are in force, or follow
        in_force = records.listen(self._records.append) if records is not None else []
        start = memory_now(memory) if from_now and memory is not None else None
        if start is not None:
            self._reader = RingReader(ring, first=start.row)
        else:
            # the newest row shows the state before anything that is asked for from now on: a replay of that needs it
            self._reader = RingReader(ring, newest=1 if from_now else None)
        self._settings = settings or RecorderSettings()
        self._hooks = hooks or RecorderHooks()
        self._offset_ns = (header or RunHeader()).time_offset_ns
        self._events: deque[Event] = deque()
        self._events_lost = 0
        self._hook_errors = 0
        self._hook_error = ""
        self._overrunning = False
        self._closed = False
        self._began_ns = self._hooks.clock_ns()
        self.turns = 0  # of the thread, ended: it goes on while no disk keeps it
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._summary: Mapping[str, str] = {}
        try:
            self._files = RunFiles(
                Path(path), header or RunHeader(), self._settings, self._hooks, self._report, in_force, start, memory
            )
        except BaseException:
            self._leave()
            raise

    def event(
        self,
        level: int,
        source: str,
        text: str,
        data: Mapping[str, Any] | None = None,
        time_ns: int | None = None,
    ) -> None:
        """Queue an event; from any thread, never waits for the disk. `time_ns`: wall clock, None is now."""
        bounded = min(max(int(level), 0), 255)
        stamp = self._wall_ns() if time_ns is None else max(int(time_ns), 0)
        self._queue(Event(stamp, bounded, str(source), str(text), dict(data or {})))

    @property
    def statistics(self) -> RecorderStatistics:
        """A snapshot, from any thread; exact when the recorder is at rest."""
        files = self._files
        return RecorderStatistics(
            rows_written=files.rows_written,
            rows_pending=files.rows_pending,
            rows_dropped=files.rows_dropped,
            rows_lost=self._reader.rows_lost,
            events_written=files.events_written,
            events_lost=self._events_lost + files.events_lost,
            write_errors=files.write_errors,
            hook_errors=self._hook_errors,
            last_error=files.last_error or self._hook_error,
            files=tuple(files.finished),
            bytes_written=files.bytes_written,
        )

    @property
    def disk_life(self) -> DiskLife | None:
        """How long the disk lasts at the rate of this recording; None before that is known."""
        since_s = (self._hooks.clock_ns() - self._began_ns) / NS_PER_S
        use, written = self._files.disk, self._files.bytes_written
        if use is None or not written or since_s < MEASURED_S:
            return None
        return disk_life(written / since_s, use, self._settings.rotation.quota_bytes)

    @property
    def current_path(self) -> Path | None:
        """The file being written (.part); None while there is none."""
        return self._files.current_path

    @property
    def thread_id(self) -> int | None:
        """The kernel's id of the recorder's thread; None before `start`."""
        return self._thread.native_id if self._thread else None

    @property
    def alive(self) -> bool:
        """The thread runs; False before `start` and after the end."""
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Start the thread; returns when it runs, with ordinary priority."""
        running = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(running,), name="fffo-recorder", daemon=True)
        self._thread.start()
        running.wait()

    def stop(self, summary: Mapping[str, str] | None = None, timeout_s: float | None = None) -> bool:
        """Drain the rest, close the file, end the thread. False when the disk keeps it beyond `timeout_s`."""
        if self._thread is None:
            self.close(summary)
            return True
        if not self._stop.is_set():
            self._summary = dict(summary or {})
            self._stop.set()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def drain_once(self) -> int:
        """One turn: rows and events to the file, then flush, rotation and quota as they are due.

        Returns the number of rows drained. Raises nothing for what the disk does.
        """
        batch = self._reader.read()
        now_ns = self._hooks.clock_ns()
        if batch.lost and not self._overrunning:
            self._report(Level.ERROR, f"the ring ran over: {batch.lost} rows lost", {"rows_lost": batch.lost})
        self._overrunning = batch.lost > 0
        first = self._reader.tail - len(batch.rows)
        for begin in range(0, max(len(batch.rows), 1), WRITE_ROWS):
            part = batch.rows[begin : begin + WRITE_ROWS]
            self._files.write(part, first + begin, self._events, self._records, now_ns)
            self._files.keep_house(now_ns)
        if self._hooks.on_rows is not None and len(batch.rows):
            self._call(self._hooks.on_rows, batch.rows)
        return len(batch.rows)

    def close(self, summary: Mapping[str, str] | None = None) -> RecorderStatistics:
        """Drain the rest and finish the file. Raises nothing for what the disk does: see the statistics."""
        if not self._closed:
            self._closed = True
            self.drain_once()
            self._leave()
            counts = {"rows_lost": str(self._reader.rows_lost)}
            self._files.close({**counts, **(summary or {})}, self._hooks.clock_ns())
        return self.statistics

    def _leave(self) -> None:
        if self._book is not None:
            self._book.leave(self._records.append)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def _run(self, running: threading.Event) -> None:
        try:
            leave_realtime(self._settings.cpus)
        except OSError as error:
            self._report(Level.WARNING, f"the recorder runs where it was started: {error}", {})
        finally:
            running.set()
        while not self._stop.wait(self._settings.drain_interval_s):
            self._guarded(self.drain_once)
            self.turns += 1
        self._guarded(lambda: self.close(self._summary))

    def _guarded(self, turn: Callable[[], object]) -> None:
        try:
            turn()
        except Exception as error:  # memory may be short for a while; a dead thread would lose the rest of the run
            self._files.note_failure(error, self._hooks.clock_ns())

    def _report(self, level: Level, text: str, data: Mapping[str, Any]) -> None:
        event = Event(self._wall_ns(), level, SOURCE, text, dict(data))
        self._queue(event)
        if self._hooks.on_event is not None:
            self._call(self._hooks.on_event, event)

    def _queue(self, event: Event) -> None:
        if len(self._events) >= EVENT_QUEUE:
            with contextlib.suppress(IndexError):  # the recorder may have emptied it meanwhile
                self._events.popleft()
                self._events_lost += 1
        self._events.append(event)

    def _call(self, hook: Callable[[Any], None], argument: Any) -> None:
        try:
            hook(argument)
        except Exception as error:  # a broken viewer must not end the recording
            self._hook_errors += 1
            self._hook_error = f"hook: {type(error).__name__}: {error}"

    def _wall_ns(self) -> int:
        return max(self._hooks.clock_ns() + self._offset_ns, 0)


def memory_now(source: MemorySource) -> FileStart | None:
    """The loop's memory behind its next tick; None where no loop runs."""
    number = source.ask_for_memory()
    deadline_s = time.monotonic() + MEMORY_TIMEOUT_S
    while number is not None:
        given = source.memory_given(number)
        if given is not None or time.monotonic() > deadline_s:
            return given
        time.sleep(MEMORY_POLL_S)
    return None


def leave_realtime(cpus: frozenset[int] | None = None) -> None:
    """Give the calling thread ordinary scheduling, in case it inherited the loop's, and these CPUs."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if cpus is not None:
        os.sched_setaffinity(0, cpus)

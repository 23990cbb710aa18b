"""The files of one run: opened, rotated, abandoned when the disk fails, and retried at a limited rate."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from ..units import NS_PER_S
from .disk import DiskUse, bytes_text
from .events import Event, Level
from .rotation import CONTINUES, OfOneWriter, disk_use, enforce_quota, is_taken, segment_path
from .run_records import FileStart, MemorySource, RunRecord, still_in_force
from .settings import RecorderHooks, RecorderSettings, Rows, RunHeader
from .writer import RunWriter

QUOTA_NAMES = 3  # of deleted files that an event says; its data has all
Report = Callable[[Level, str, Mapping[str, Any]], None]


class RunFiles:
    """Writes rows, events and records to NAME.mcap, NAME_002.mcap, ... Only the constructor raises OSError.

    Every file begins with the records that were in force when it was opened. One that begins in the midst of the rows
    of a running loop begins with what it remembers before its first row: it is asked for, and the file waits for it.

    Rows and events that do not reach a file are counted; a failure is reported once, and once more when it is
    over.
    """

    def __init__(
        self, path: Path, header: RunHeader, settings: RecorderSettings, hooks: RecorderHooks, report: Report,
        in_force: Iterable[RunRecord] = (), start: FileStart | None = None, memory: MemorySource | None = None,
    ) -> None:  # fmt: skip
        self._path = path
        self._header = header
        self._in_force = list(in_force)
        self._settings = settings
        self._hooks = hooks
        self._report = report
        self._memory = memory
        self._asked: int | None = None  # for the memory with which the next file is to begin
        self._writer: RunWriter | None = None
        self._segment = 0
        self._handed = self._events_handed = 0  # rows and events given to the open file
        self._rows_closed = self._bytes_closed = self._events_closed = 0  # in closed files
        self._opened_ns = self._flushed_ns = self._retry_ns = self._quota_ns = 0
        self._failing = False
        self._over_quota = False
        self._of_this_writer = OfOneWriter(header.metadata)
        self.disk: DiskUse | None = None  # as last seen
        self._dropped_before = 0  # rows dropped when the present failure began
        self.rows_dropped = 0
        self.events_lost = 0
        self.write_errors = 0
        self.last_error = ""
        self.finished: list[Path] = []
        self._open(hooks.clock_ns(), start)

    # ---- counts

    @property
    def rows_written(self) -> int:
        """Rows that files hold."""
        return self._rows_closed + (self._writer.rows_written if self._writer else 0)

    @property
    def rows_pending(self) -> int:
        """Rows in the chunk that is being filled."""
        return self._writer.rows_pending if self._writer else 0

    @property
    def events_written(self) -> int:
        """Events that files hold."""
        return self._events_closed + (self._writer.events_written if self._writer else 0)

    @property
    def bytes_written(self) -> int:
        """Size of all files."""
        return self._bytes_closed + (self._writer.size_bytes if self._writer else 0)

    @property
    def current_path(self) -> Path | None:
        """The file being written (.part); None while there is none."""
        return self._writer.part_path if self._writer else None

    # ---- writing

    def write(self, rows: Rows, first: int, events: deque[Event], records: deque[RunRecord], now_ns: int) -> None:
        """Take rows, queued events and records; without an open file, rows are dropped and events stay queued.

        `first`: the place of the first row among all that the ring ever got.
        """
        if self._writer is None and self._asked is None and now_ns >= self._retry_ns:
            self._begin_next(now_ns)
        news = [records.popleft() for _ in range(len(records))]
        self._in_force += news
        start = self._start_in(first)
        before = len(rows) if start is None else start.row - first
        if before > len(rows):  # it comes with the next rows
            start, before = None, len(rows)
        self._take(rows[:before], events, news, now_ns)
        if start is not None:
            self._asked = None
            self._open_next(now_ns, start)
            self._take(rows[before:], events, (), now_ns)

    def _take(self, rows: Rows, events: deque[Event], news: Iterable[RunRecord], now_ns: int) -> None:
        self._write(rows, events, news, now_ns)
        if len(rows) and len(self._in_force) > 1:
            self._in_force = still_in_force(self._in_force, rows[-1])

    def _start_in(self, first: int) -> FileStart | None:
        """Where the next file begins, once the loop has said it; rows before `first` have gone by."""
        if self._asked is None or self._memory is None:
            return None
        start = self._memory.memory_given(self._asked)
        if start is not None and start.row >= first:
            return start
        if start is not None:  # the ring ran over
            self._asked = self._memory.ask_for_memory()
        return None

    def _write(self, rows: Rows, events: deque[Event], records: Iterable[RunRecord], now_ns: int) -> None:
        writer = self._writer
        if writer is None:
            self.rows_dropped += len(rows)
            return
        self._handed += len(rows)
        try:
            for record in records:
                writer.write_record(record, self._wall_ns(now_ns))
            writer.write_rows(rows)
            while events:
                event = events.popleft()
                self._events_handed += 1
                writer.write_event(event)
        except Exception as error:  # any error: the loop continues, and so does draining
            self._fail(writer, error, now_ns)

    def keep_house(self, now_ns: int) -> None:
        """Flush, begin a new file, enforce the quota, each when it is due."""
        writer = self._writer
        if writer is not None and now_ns - self._flushed_ns >= self._settings.flush_interval_s * NS_PER_S:
            self._flush(writer, now_ns)
        writer = self._writer
        if writer is not None and self._asked is None and self._rotation_is_due(writer, now_ns):
            self._begin_next(now_ns)
        if now_ns - self._quota_ns >= self._settings.quota_interval_s * NS_PER_S:
            self._check_quota(now_ns)

    def close(self, summary: Mapping[str, str], now_ns: int) -> None:
        """Finish the open file."""
        if self._writer is not None:
            self._finish(self._writer, summary, now_ns)

    def _flush(self, writer: RunWriter, now_ns: int) -> None:
        self._flushed_ns = now_ns
        try:
            writer.flush()
        except Exception as error:
            self._fail(writer, error, now_ns)
            return
        # an empty file can be made on a full disk, too: only rows in a file end a failure
        if self._failing and writer.rows_written:
            self._failing = False
            missing = self.rows_dropped - self._dropped_before
            name = writer.path.name
            text = f"recording goes on in {name}; {missing} rows are missing"
            self._report(Level.WARNING, text, {"rows_missing": missing, "file": name})

    # ---- opening

    def _begin_next(self, now_ns: int) -> None:
        """The next file, with the loop's memory when it has given it, or at once where no loop runs."""
        self._asked = None if self._memory is None else self._memory.ask_for_memory()
        if self._asked is None:
            self._open_next(now_ns, None)

    def _open_next(self, now_ns: int, start: FileStart | None) -> None:
        """Finish the open file, if there is one, and open the next; a failure is reported and tried again."""
        if self._writer is not None and not self._finish(self._writer, {"ended_by": "rotation"}, now_ns):
            return
        try:
            self._open(now_ns, start)
        except Exception as error:
            self.note_failure(error, now_ns)

    def _open(self, now_ns: int, start: FileStart | None) -> None:
        """Open the next file of the run; raises OSError."""
        first = self._segment == 0
        number = self._segment + 1
        while not first and is_taken(segment_path(self._path, number)):
            number += 1
        path = segment_path(self._path, number)
        path.parent.mkdir(exist_ok=True, parents=first)
        metadata = dict(self._header.metadata)
        if not first:
            metadata |= {"segment": str(number), CONTINUES: self._path.name}
        writer = RunWriter(
            path,
            metadata,
            self._header.attachments,
            self._header.time_offset_ns,
            chunk_size=self._settings.chunk_size,
            compression=self._settings.compression,
            fsync_interval_s=self._settings.fsync_interval_s,
            clock_ns=self._hooks.clock_ns,
            opener=self._hooks.opener,
        )
        try:
            for record in self._in_force:
                writer.write_record(record, self._wall_ns(now_ns))
            if start is not None:
                wall_ns = self._wall_ns(now_ns)
                writer.write_record(start.memory._replace(time_ns=wall_ns), wall_ns)
        except BaseException:
            writer.abandon()
            raise
        self._writer = writer
        self._segment = number
        self._opened_ns = self._flushed_ns = now_ns
        self._check_quota(now_ns)

    def _wall_ns(self, now_ns: int) -> int:
        return max(now_ns + self._header.time_offset_ns, 0)

    # ---- closing

    def _rotation_is_due(self, writer: RunWriter, now_ns: int) -> bool:
        policy = self._settings.rotation
        age_ns = now_ns - self._opened_ns
        return (policy.max_bytes is not None and writer.size_bytes >= policy.max_bytes) or (
            policy.max_duration_s is not None and age_ns >= policy.max_duration_s * NS_PER_S
        )

    def _finish(self, writer: RunWriter, summary: Mapping[str, str], now_ns: int) -> bool:
        try:
            self.finished.append(writer.close({**self._counts(), **summary}))
        except Exception as error:
            self._fail(writer, error, now_ns)
            return False
        self._retire(writer, kept=writer.rows_written)
        return True

    def _fail(self, writer: RunWriter, error: Exception, now_ns: int) -> None:
        """Abandon the open file: its content stays, the rest is counted as lost, and a new file is tried later."""
        self.note_failure(error, now_ns)
        gone = writer.deleted
        if writer.rows_written and not gone:
            with contextlib.suppress(Exception):
                # on a full disk, truncating the torn chunk may free just enough space for the index
                self.finished.append(writer.close({**self._counts(), "ended_by": self.last_error}))
                self._retire(writer, kept=writer.rows_written)
                return
        writer.abandon()
        if writer.part_path.exists():
            self.finished.append(writer.part_path)
        self._retire(writer, kept=0 if gone else writer.rows_written)

    def _retire(self, writer: RunWriter, kept: int) -> None:
        self._rows_closed += kept
        self.rows_dropped += self._handed - kept
        self._events_closed += writer.events_written
        self.events_lost += self._events_handed - writer.events_written
        self._bytes_closed += writer.size_bytes
        self._handed = self._events_handed = 0
        self._writer = None

    def note_failure(self, error: Exception, now_ns: int) -> None:
        """Count an error; report it unless the last one is not over yet."""
        self.write_errors += 1
        self.last_error = f"{type(error).__name__}: {error}"
        self._asked = None  # again when the next file is tried
        self._retry_ns = now_ns + int(self._settings.retry_interval_s * NS_PER_S)
        if not self._failing:
            self._failing = True
            self._dropped_before = self.rows_dropped
            name = self._writer.path.name if self._writer else self._path.name
            self._report(Level.ERROR, f"recording of {name} failed: {self.last_error}", {"file": name})

    def _counts(self) -> dict[str, str]:
        return {
            "rows_dropped": str(self.rows_dropped),
            "events_lost": str(self.events_lost),
            "write_errors": str(self.write_errors),
        }

    # ---- quota

    def _check_quota(self, now_ns: int) -> None:
        self._quota_ns = now_ns
        quota = self._settings.rotation.quota_bytes
        directory, kept = self._path.parent, [self._writer.path] if self._writer else []
        try:
            report = enforce_quota(directory, math.inf if quota is None else quota, self._of_this_writer, kept)
            self.disk = disk_use(directory, report.total_bytes)
        except OSError:
            return  # a directory that is gone shows when the file is flushed
        if quota is None:
            return
        data = {"quota_bytes": quota, "total_bytes": report.total_bytes}
        if report.deleted:
            names = [path.name for path in report.deleted]
            some = ", ".join(names[:QUOTA_NAMES]) + (" ..." if len(names) > QUOTA_NAMES else "")
            text = f"deleted to stay below recording.quota_bytes, {bytes_text(quota)}: {some}"
            self._report(Level.INFO, text, {**data, "files": names})
        if not report.within and not self._over_quota:
            text = (
                f"recordings take {report.total_bytes} bytes, recording.quota_bytes allows {quota}, and none may be "
                "deleted"
            )
            self._report(Level.WARNING, text, data)
        self._over_quota = not report.within

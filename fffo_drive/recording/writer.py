"""One run, one file: metadata first, rows in batches, events; NAME.mcap.part until it is complete."""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

from .. import __version__
from ..signals import ROW
from ..units import NS_PER_S
from .container import ChunkBuilder, McapFile, record_bytes
from .errors import RecordingError
from .events import EVENT_SCHEMA, Event, encode_event, utc_text
from .run_records import RECORD_SCHEMA, RECORD_TOPIC, RECORD_TYPE, RunRecord, encode_record
from .schema import (
    CDR_HEADER,
    EVENT_TOPIC,
    EVENT_TYPE,
    MESSAGE_ENCODING,
    METADATA_NAME,
    PROFILE,
    ROW_TOPIC,
    ROW_TYPE,
    SCHEMA_ENCODING,
    SUMMARY_NAME,
    message_dtype,
    schema_text,
)
from .settings import CHUNK_SIZE, Attachments, Compression, Opener, open_new

LIBRARY = f"fffo-drive/{__version__}"
PART_SUFFIX = ".part"
ROW_CHANNEL = 1
EVENT_CHANNEL = 2
RECORD_CHANNEL = 3

Rows = np.ndarray[Any, np.dtype[np.void]]

_ROW_BYTES = np.dtype(f"V{ROW.itemsize}")
_ROW_MESSAGE = message_dtype(len(CDR_HEADER) + ROW.itemsize)
_ROW_PART = np.dtype(  # the same bytes with the row apart from the CDR header
    {
        "names": ["cdr", "row"],
        "formats": [f"V{len(CDR_HEADER)}", _ROW_BYTES],
        "offsets": [
            _ROW_MESSAGE.itemsize - ROW.itemsize - len(CDR_HEADER),
            _ROW_MESSAGE.itemsize - ROW.itemsize,
        ],
        "itemsize": _ROW_MESSAGE.itemsize,
    }
)


def wall_clock_offset_ns(samples: int = 9) -> int:
    """CLOCK_REALTIME minus CLOCK_MONOTONIC now, from the tightest of a few pairs of readings.

    Taken once per run: later steps of the wall clock do not affect the recording.
    """
    best_width, best_offset = 0, 0
    for sample in range(samples):
        before = time.monotonic_ns()
        wall = time.time_ns()
        width = time.monotonic_ns() - before
        if sample == 0 or width < best_width:
            best_width, best_offset = width, wall - before - width // 2
    return best_offset


class RunWriter:
    """Writes rows and events of one run to `path` (NAME.mcap).

    Until `close` the file is NAME.mcap.part. Log and publish time of a row are `deadline_ns +
    time_offset_ns`. A chunk is written when it is full and on `flush`. Pending rows are lost with the process, flushed
    rows are not, and rows flushed `fsync_interval_s` before a power failure are not either. After an OSError the writer
    cannot be used any more: `abandon` it (the file stays readable). `clock_ns` paces fsync, `wall_ns` gives the start
    and end time of the file.
    """

    def __init__(
        self,
        path: Path | str,
        metadata: Mapping[str, str],
        attachments: Attachments = (),
        time_offset_ns: int = 0,
        *,
        chunk_size: int = CHUNK_SIZE,
        compression: Compression = "zstd",
        fsync_interval_s: float | None = None,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        wall_ns: Callable[[], int] = time.time_ns,
        opener: Opener = open_new,
    ) -> None:
        self.path = Path(path)
        self.part_path = self.path.with_name(self.path.name + PART_SUFFIX)
        for taken in (self.path, self.part_path):
            if taken.exists():
                raise FileExistsError(
                    errno.EEXIST,
                    "a recording of this name exists and is not overwritten: give another name",
                    str(taken),
                )
        self.rows_written = 0  # in chunks that the file holds
        self.rows_pending = 0  # in the chunk being filled
        self.events_written = 0
        self.records_written = 0
        self._events_pending = 0
        self._records_pending = 0
        self._offset_ns = int(time_offset_ns)
        self._chunk_size = chunk_size
        self._fsync_interval_ns = None if fsync_interval_s is None else int(fsync_interval_s * NS_PER_S)
        self._clock_ns = clock_ns
        self._wall_ns = wall_ns
        self._synced_ns = clock_ns()
        self._ticks: tuple[int, int] | None = None
        self._finished = False
        self._file = opener(self.part_path)
        try:
            self._begin(metadata, attachments, compression)
        except BaseException:
            self._discard_empty()
            raise

    def _begin(self, metadata: Mapping[str, str], attachments: Attachments, compression: Compression) -> None:
        self._mcap = McapFile(self._file, PROFILE, LIBRARY, compression)
        begun_ns = self._wall_ns()
        facts = {
            "tool": LIBRARY,
            "begun": utc_text(begun_ns),
            "time_offset_ns": str(self._offset_ns),
            **{str(key): str(value) for key, value in metadata.items()},
        }
        self._mcap.add_metadata(METADATA_NAME, facts)
        for name, media_type, content in attachments:
            self._mcap.add_attachment(name, media_type, content, begun_ns)
        self._chunk = ChunkBuilder()
        for record in _schemas_and_channels():
            self._mcap.register(record)
            self._chunk.add_record(record_bytes(record))
        if self._fsync_interval_ns is not None:
            self._sync()

    @property
    def size_bytes(self) -> int:
        """Bytes in the file."""
        return self._mcap.size

    def write_rows(self, rows: Rows) -> None:
        """Add rows (n,), dtype `signals.ROW`, in the order of their ticks."""
        if rows.dtype != ROW or rows.ndim != 1:
            raise RecordingError(f"rows of dtype {rows.dtype} and shape {rows.shape}: signals.ROW and (n,) are needed")
        if len(rows) == 0:
            return
        records, log_times = self._encode(rows)
        begin = 0
        while begin < len(rows):
            # like mcap.writer.Writer: a chunk is closed by the message that makes it larger than chunk_size
            room = max(self._chunk_size - self._chunk.size, 0) // _ROW_MESSAGE.itemsize + 1
            end = min(begin + room, len(rows))
            self._chunk.add_messages(ROW_CHANNEL, records[begin:end].tobytes(), log_times[begin:end])
            self.rows_pending += end - begin
            begin = end
            if self._chunk.size > self._chunk_size:
                self._close_chunk()
        first = int(rows["tick"][0]) if self._ticks is None else self._ticks[0]
        self._ticks = (first, int(rows["tick"][-1]))

    def _encode(self, rows: Rows) -> tuple[Rows, np.ndarray[Any, np.dtype[np.uint64]]]:
        log_times = rows["deadline_ns"] + np.int64(self._offset_ns)
        if int(log_times.min()) < 0:
            raise RecordingError("a row lies before the Unix epoch: deadline_ns + time_offset_ns is negative")
        stamps = log_times.astype(np.uint64)
        records = np.empty(len(rows), _ROW_MESSAGE)
        records["opcode"] = Opcode.MESSAGE
        records["length"] = _ROW_MESSAGE.itemsize - 9
        records["channel"] = ROW_CHANNEL
        records["sequence"] = rows["tick"] & np.uint64(0xFFFFFFFF)  # a reader sees skipped ticks as gaps
        records["log_time"] = stamps
        records["publish_time"] = stamps
        parts = records.view(_ROW_PART)
        parts["cdr"] = np.void(CDR_HEADER)
        # as plain bytes: NumPy would copy structured rows field by field, forty times slower
        parts["row"] = np.ascontiguousarray(rows).view(_ROW_BYTES)
        return records, stamps

    def write_event(self, event: Event) -> None:
        """Add an event; it reaches the file with the chunk that is being filled."""
        sequence = self.events_written + self._events_pending
        self._events_pending += 1
        self._write_message(EVENT_CHANNEL, sequence, event.time_ns, encode_event(event))

    def write_record(self, record: RunRecord, time_ns: int) -> None:
        """Add a record, as an event is added. `time_ns`: wall clock of now; one in force may be hours older."""
        self._records_pending += 1
        self._write_message(RECORD_CHANNEL, record.sequence, time_ns, encode_record(record))

    def _write_message(self, channel: int, sequence: int, time_ns: int, data: bytes) -> None:
        message = Message(
            channel_id=channel, sequence=sequence & 0xFFFFFFFF, log_time=time_ns, publish_time=time_ns, data=data
        )
        self._chunk.add_messages(channel, record_bytes(message), np.array([time_ns], np.uint64))
        if self._chunk.size > self._chunk_size:
            self._close_chunk()

    def _close_chunk(self) -> None:
        chunk, self._chunk = self._chunk, ChunkBuilder()
        rows, self.rows_pending = self.rows_pending, 0
        events, self._events_pending = self._events_pending, 0
        records, self._records_pending = self._records_pending, 0
        self._mcap.add_chunk(chunk)
        self.rows_written += rows
        self.events_written += events
        self.records_written += records

    def flush(self) -> None:
        """Hand everything to the operating system, and to the disk when the fsync interval is over.

        Raises OSError also if the file was deleted or moved meanwhile, which would otherwise go unnoticed.
        """
        if self._chunk.counts:
            self._close_chunk()
        self.check_in_place()
        if self._fsync_interval_ns is not None and self._clock_ns() - self._synced_ns >= self._fsync_interval_ns:
            self._sync()

    def check_in_place(self) -> None:
        """Raise FileNotFoundError if the name no longer refers to the file being written."""
        try:
            same = os.path.samestat(os.stat(self.part_path), os.fstat(self._file.fileno()))
        except FileNotFoundError:
            same = False
        if not same:
            raise FileNotFoundError(errno.ENOENT, "deleted or moved while it was being written", str(self.part_path))

    @property
    def deleted(self) -> bool:
        """Whether the file has no name any more and will disappear when closed."""
        try:
            return os.fstat(self._file.fileno()).st_nlink == 0
        except (OSError, ValueError):
            return not self.part_path.exists()  # closed already

    def _sync(self) -> None:
        os.fsync(self._file.fileno())
        _sync_directory(self.path.parent)
        self._synced_ns = self._clock_ns()

    def close(self, summary: Mapping[str, str] | None = None) -> Path:
        """Flush, write closing metadata (`summary` and counts) and the index, rename. Returns the final path.

        Raises OSError when that fails; the file then keeps its .part name.
        """
        if not self._finished:
            self._finish(summary or {})
        self.check_in_place()
        if self._fsync_interval_ns is not None:
            self._sync()
        self._file.close()
        if self.path.exists():
            raise FileExistsError(errno.EEXIST, "a recording of this name appeared meanwhile", str(self.path))
        os.rename(self.part_path, self.path)
        if self._fsync_interval_ns is not None:
            _sync_directory(self.path.parent)
        return self.path

    def _finish(self, summary: Mapping[str, str]) -> None:
        if self._chunk.counts:
            self._close_chunk()
        first, last = self._ticks if self._ticks is not None else (-1, -1)
        counts = {
            "ended": utc_text(self._wall_ns()),
            "rows": str(self.rows_written),
            "events": str(self.events_written),
            "records": str(self.records_written),
            "first_tick": str(first),
            "last_tick": str(last),
        }
        self._mcap.add_metadata(SUMMARY_NAME, {**counts, **{str(key): str(value) for key, value in summary.items()}})
        self._mcap.finish()
        self._finished = True

    def abandon(self) -> None:
        """Close the file as it is, as .part; a file without a row or event is removed. Never raises."""
        if self._mcap.chunk_count == 0:
            self._discard_empty()
            return
        with contextlib.suppress(OSError):
            self._file.close()

    def _discard_empty(self) -> None:
        with contextlib.suppress(OSError):
            self.check_in_place()
            self.part_path.unlink()
        with contextlib.suppress(OSError):
            self._file.close()


def _schemas_and_channels() -> list[Schema | Channel]:
    schemas = [
        Schema(id=1, name=ROW_TYPE, encoding=SCHEMA_ENCODING, data=schema_text().encode()),
        Schema(id=2, name=EVENT_TYPE, encoding=SCHEMA_ENCODING, data=EVENT_SCHEMA.encode()),
        Schema(id=3, name=RECORD_TYPE, encoding=SCHEMA_ENCODING, data=RECORD_SCHEMA.encode()),
    ]
    topics = ((ROW_CHANNEL, ROW_TOPIC), (EVENT_CHANNEL, EVENT_TOPIC), (RECORD_CHANNEL, RECORD_TOPIC))
    channels = [
        Channel(id=channel, topic=topic, message_encoding=MESSAGE_ENCODING, metadata={}, schema_id=channel)
        for channel, topic in topics
    ]
    return [*schemas, *channels]


def _sync_directory(directory: Path) -> None:
    """Make a new or renamed file name survive a power failure."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

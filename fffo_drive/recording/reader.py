"""Reads a recording into NumPy columns, whole or torn, without decoding message by message."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Channel, ChunkIndex, Metadata, Schema, Statistics
from mcap.summary import Summary

from ..documents import did_you_mean
from ..signals import ROW, SIGNALS, UNITS
from ..units import NS_PER_S
from .errors import ForeignRecordingError, RecordingError
from .events import Event, decode_event
from .files import regular
from .index import read_index, record_at
from .run_records import RECORD_TOPIC, RECORD_TYPE, RecordKind, RunRecord, decode_record
from .scan import (
    HEAD_SIZE,
    DamagedRecordError,
    McapRecord,
    Scanner,
    Segment,
    parse,
    record_data,
    segments,
)
from .schema import (
    CDR_HEADER,
    EVENT_TOPIC,
    EVENT_TYPE,
    MESSAGE_ENCODING,
    METADATA_NAME,
    ROW_TOPIC,
    SCHEMA_ENCODING,
    SUMMARY_NAME,
    RowLayout,
    layout_from_schema,
    message_dtype,
)

Array = np.ndarray[Any, np.dtype[Any]]
T = TypeVar("T")
_MESSAGE_PREFIX = message_dtype(0).itemsize
_LOG_TIME = 1 + 8 + 2 + 4  # bytes of opcode, length, channel and sequence in front of it
GROUP_ROWS = 1 << 15  # 10 MB, 16 s at 2 kHz: what costs the same for any number of rows is then little
_CURRENT_LAYOUT = RowLayout(ROW, UNITS, {signal.name: signal.meaning for signal in SIGNALS})


class Attachment(NamedTuple):
    """A file inside the recording."""

    name: str
    media_type: str
    data: bytes


class _Columns(Mapping[str, Array]):
    """Columns of a run, each copied out of the rows when it is first asked for: few of them are needed at once."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._copied: dict[str, Array | None] = dict.fromkeys([*(run.rows.dtype.names or ()), "time_s"])

    def __getitem__(self, name: str) -> Array:
        found = self._copied[name]
        if found is None:
            rows = self._run.rows
            found = np.ascontiguousarray(rows[name]) if name in (rows.dtype.names or ()) else self._run.time_s
            self._copied[name] = found
        return found

    def __contains__(self, name: object) -> bool:
        return name in self._copied

    def __iter__(self) -> Iterator[str]:
        return iter(self._copied)

    def __len__(self) -> int:
        return len(self._copied)


@dataclass(frozen=True)
class Run:
    """A recording in memory; of a torn one (`complete` False, `reason` says why) the whole chunks."""

    path: Path
    rows: Array  # (n,) structured, fields as in the file's schema
    log_time_ns: Array  # (n,) int64, wall clock of each row's deadline
    units: Mapping[str, str]
    meanings: Mapping[str, str]
    metadata: Mapping[str, str]
    summary: Mapping[str, str]  # empty in a torn file
    attachments: Mapping[str, Attachment]
    events: tuple[Event, ...]
    records: tuple[RunRecord, ...]  # in force at the file's begin, and made since; none in files of older versions
    complete: bool
    reason: str

    @cached_property
    def columns(self) -> Mapping[str, Array]:
        """Every field of the row as a contiguous array, and `time_s`, seconds since the first row."""
        return _Columns(self)

    @property
    def time_s(self) -> Array:
        """Seconds since the first row, by deadline."""
        names = self.rows.dtype.names or ()
        stamps = self.rows["deadline_ns"] if "deadline_ns" in names else self.log_time_ns
        return (stamps - stamps[0]) / NS_PER_S if len(stamps) else np.zeros(0)

    def column(self, name: str) -> Array:
        """One column; RecordingError with the nearest names when there is none of this name."""
        if name not in self.columns:
            raise RecordingError(f"{self.path}: no column {name!r}: {did_you_mean(name, self.columns)}")
        return self.columns[name]

    def lacks(self, text: str) -> str:
        """The message that something is missing in it, with the tear that may be the cause."""
        return f"{self.path}: {text}" + (f" ({self.reason})" if self.reason else "")

    @property
    def profile_sizes(self) -> Mapping[int, int]:
        """Samples of the profiles in it by their number; empty where its rows name none."""
        if not {"profile_number", "profile_sample"} <= set(self.rows.dtype.names or ()):
            return {}
        return {one.number: int(one.by_name["samples"]) for one in self.records if one.kind == RecordKind.PROFILE}

    @property
    def profile_samples(self) -> int | None:
        """Samples of the profile that ran; None if there were several (recording of a service), or if it is not
        recorded.
        """
        sizes = self.profile_sizes
        if sizes:
            ran = np.unique(self.rows["profile_number"][self.rows["profile_sample"] >= 0])
            return sizes.get(int(ran[0])) if ran.size == 1 else None
        samples = self.metadata.get("profile_samples")
        return None if samples is None else int(samples)


def read_run(
    path: Path | str,
    topic: str = ROW_TOPIC,
    columns: Collection[str] | None = None,
    ranges: Sequence[tuple[int, int]] | None = None,
) -> Run:
    """Read a recording, finished or torn (NAME.mcap.part, a copy cut short: its whole chunks).

    Of a long one less is read with `columns`, those fields of the rows alone as far as they are there, and `ranges`,
    rows from here on and before there, rising.

    Raises RecordingError if it is not an MCAP file, or a complete one without rows on `topic`; OSError if it cannot be
    opened.
    """
    blocks = RowBlocks(path, topic)
    parts = blocks if ranges is None else _within(blocks, ranges)
    found = [block if columns is None else block.only(columns) for block in parts]
    return replace(blocks.rest, **_joined(found)._asdict()) if found else blocks.rest


class RowBlock(NamedTuple):
    """Rows that follow each other in a recording."""

    rows: Array  # (n,) structured, fields as in the file's schema
    log_time_ns: Array  # (n,) int64

    def only(self, columns: Collection[str]) -> RowBlock:
        """Without the other fields."""
        kept = [name for name in self.rows.dtype.names or () if name in columns]
        rows = np.empty(len(self.rows), [(name, self.rows.dtype[name]) for name in kept])
        for name in kept:
            rows[name] = self.rows[name]
        return RowBlock(rows, self.log_time_ns)

    @property
    def stamps_ns(self) -> Array:
        """(n,) Deadlines; log times where the rows have none."""
        return self.rows["deadline_ns"] if "deadline_ns" in (self.rows.dtype.names or ()) else self.log_time_ns


def _within(blocks: Iterable[RowBlock], ranges: Sequence[tuple[int, int]]) -> Iterator[RowBlock]:
    number = 0
    for block in blocks:
        for first, end in ranges:
            part = slice(max(0, first - number), max(0, end - number))
            if part.start < min(part.stop, len(block.rows)):
                yield RowBlock(block.rows[part].copy(), block.log_time_ns[part].copy())
        number += len(block.rows)


def _joined(blocks: Sequence[RowBlock]) -> RowBlock:
    dtype = blocks[0].rows.dtype
    # as bytes: field by field it would take forty times as long
    rows = np.concatenate([block.rows.view(f"V{dtype.itemsize}") for block in blocks])
    return RowBlock(rows.view(dtype), np.concatenate([block.log_time_ns for block in blocks]))


def groups(blocks: Iterable[RowBlock], least_rows: int = GROUP_ROWS) -> Iterator[RowBlock]:
    """The same rows in larger blocks; only the last one may have fewer rows."""
    waiting: list[RowBlock] = []
    for block in blocks:
        waiting.append(block)
        if sum(len(one.rows) for one in waiting) >= least_rows:
            yield _joined(waiting)
            waiting.clear()
    if waiting:
        yield _joined(waiting)


class TimeWindow(NamedTuple):
    """A part of a recording: rows from here on and before there, in seconds since its first row."""

    from_s: float = 0.0
    to_s: float = math.inf


Choice = Callable[[Sequence[ChunkIndex]], Sequence[ChunkIndex]]  # of the chunks that hold rows


class RowBlocks:
    """The rows of a recording, finished or torn, in blocks of one chunk each (some hundred kB): in constant memory.

    Of a finished one the chunks outside `window` are not read. May be iterated again; each time the file is read anew.
    `rest` is what the last iteration found beside the rows, and `count` the rows of the whole file. Iterating raises
    the errors of `read_run`.
    """

    def __init__(self, path: Path | str, topic: str = ROW_TOPIC, window: TimeWindow | None = None) -> None:
        self._path, self._topic, self._window = Path(path), topic, window
        self._rest: Run | None = None
        self.count = 0

    def __iter__(self) -> Iterator[RowBlock]:
        if self._window is None:
            yield from self._read(None)
            return
        first = next(self._read(lambda chunks: chunks[:1]), None)
        first_ns = 0 if first is None else int(first.log_time_ns[0])
        from_s, to_s = self._window

        def inside(chunks: Sequence[ChunkIndex]) -> Sequence[ChunkIndex]:
            spans = [(one, one.message_start_time - first_ns, one.message_end_time - first_ns) for one in chunks]
            return [
                one for one, begin_ns, end_ns in spans if end_ns / NS_PER_S >= from_s and begin_ns / NS_PER_S < to_s
            ]

        for rows, log_time_ns in self._read(inside):
            time_s = (log_time_ns - first_ns) / NS_PER_S
            kept = (time_s >= from_s) & (time_s < to_s)
            if kept.any():
                yield RowBlock(rows[kept], log_time_ns[kept])

    def ends(self) -> Iterator[RowBlock]:
        """The first and the last block, and those that hold more than rows; all blocks where there is no index."""
        return self._read(lambda chunks: [*chunks[:1], *chunks[-1:]])

    def _read(self, choice: Choice | None) -> Iterator[RowBlock]:
        """All blocks, or those of a choice where an index says where they are."""
        collector = _Collector(self._path, self._topic)
        with regular(self._path).open("rb") as file:
            summary = None if choice is None else read_index(file)
            file.seek(0)
            scanner = Scanner(file, str(self._path))
            chosen = _chosen(file, summary, collector, choice) if choice is not None and summary is not None else None
            for record in scanner if chosen is None else chosen:
                try:
                    collector.take(record, scanner)
                except DamagedRecordError as damage:
                    scanner.damage(record, str(damage))
                    break
                for rows, times in collector.taken():
                    yield RowBlock(rows, times)
            if chosen is not None and scanner.tear is None:
                collector.count = collector.stated_rows
        self._rest, self.count = collector.run(scanner.tear), collector.count

    @property
    def rest(self) -> Run:
        """The recording without its rows."""
        assert self._rest is not None, "iterate over all blocks first"
        return self._rest


def _chosen(file: BinaryIO, summary: Summary, collector: _Collector, choice: Choice) -> Iterator[McapRecord]:
    """What a file holds beside rows, and the chosen chunks of rows, in their order."""
    collector.know(summary)
    for attachment in summary.attachment_indexes:
        yield record_at(file, Opcode.ATTACHMENT, attachment.offset, attachment.length)
    for metadata in summary.metadata_indexes:
        yield record_at(file, Opcode.METADATA, metadata.offset, metadata.length)
    channels = [set(chunk.message_index_offsets) for chunk in summary.chunk_indexes]
    rows = collector.layouts.keys()
    with_rows = [chunk for chunk, own in zip(summary.chunk_indexes, channels, strict=True) if own & rows]
    wanted = {chunk.chunk_start_offset for chunk in choice(with_rows)}
    for chunk, own in zip(summary.chunk_indexes, channels, strict=True):
        if chunk.chunk_start_offset in wanted or not own <= rows:
            yield record_at(file, Opcode.CHUNK, chunk.chunk_start_offset, chunk.chunk_length)


def describe(path: Path | str, check: bool = False) -> dict[str, Any]:
    """A recording in one JSON object, from its index where it has one; `check`: every chunk is read and checked.

    `period_s` is the median of its first and its last block. Raises the errors of `read_run`.
    """
    blocks = RowBlocks(path)
    ends: list[RowBlock] = []
    for block in blocks if check else blocks.ends():
        ends = [*ends[:1], block]
    run = blocks.rest
    stamps = [block.stamps_ns for block in ends]
    periods = np.concatenate([np.diff(part) for part in stamps]) if stamps else np.zeros(0)
    return {
        "file": str(run.path),
        "complete": run.complete,
        "reason": run.reason,
        "rows": blocks.count,
        "duration_s": float(stamps[-1][-1] - stamps[0][0]) / NS_PER_S if stamps else 0.0,
        "period_s": float(np.median(periods)) / NS_PER_S if len(periods) else None,
        "columns": {name: run.units[name] for name in run.rows.dtype.names or ()},
        "events": [event.as_dict() for event in run.events],
        "records": [record.as_dict() for record in run.records],
        "attachments": {a.name: {"media_type": a.media_type, "bytes": len(a.data)} for a in run.attachments.values()},
        "metadata": dict(run.metadata),
        "summary": dict(run.summary),
    }


def read_without_rows(path: Path | str) -> Run:
    """A recording without its rows: of a finished one from its index. Raises the errors of `read_run`."""
    blocks = RowBlocks(path)
    for _ in blocks.ends():
        pass
    return blocks.rest


class RunHead(NamedTuple):
    """What stands in front of a recording's rows."""

    metadata: Mapping[str, str]  # empty where it says nothing of itself
    attachments: Mapping[str, Attachment]
    start_ns: int | None  # log time of its first message; None where there is none


def read_head(path: Path | str) -> RunHead:
    """Metadata, attachments and start at the beginning of a recording, without reading its rows.

    Raises RecordingError when it is no MCAP file, OSError when it cannot be opened.
    """
    header: dict[str, str] = {}
    attachments: dict[str, Attachment] = {}
    with regular(Path(path)).open("rb") as file, contextlib.suppress(DamagedRecordError):
        for record in Scanner(file, str(path)):
            if record.opcode == Opcode.METADATA:
                metadata = parse(Metadata.read, record.body)
                header |= metadata.metadata if metadata.name == METADATA_NAME else {}
            elif record.opcode == Opcode.ATTACHMENT:
                _keep(attachments, parse(AttachmentRecord.read, record.body))
            elif record.opcode == Opcode.CHUNK:
                return RunHead(header, attachments, int.from_bytes(record.body[:8], "little"))
    return RunHead(header, attachments, None)


def _keep(attachments: dict[str, Attachment], record: AttachmentRecord) -> None:
    """Add an attachment in its order. A name that is taken (axis and model of one name) gets a number in front."""
    name = record.name if record.name not in attachments else f"{len(attachments) + 1}_{record.name}"
    attachments[name] = Attachment(name, record.media_type, record.data)


def read_metadata(path: Path | str) -> dict[str, str]:
    """The metadata of `read_head`, with its errors."""
    return dict(read_head(path).metadata)


@dataclass
class _Collector:
    path: Path
    topic: str
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    layouts: dict[int, RowLayout] = field(default_factory=dict)  # by channel
    event_channels: set[int] = field(default_factory=set)
    record_channels: set[int] = field(default_factory=set)
    blocks: list[tuple[Array, Array]] = field(default_factory=list)  # rows and log times, by segment, not yet taken
    count: int = 0  # rows
    stated: dict[int, int] = field(default_factory=dict)  # messages by channel, from the file's statistics
    events: list[Event] = field(default_factory=list)
    records: list[RunRecord] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, Attachment] = field(default_factory=dict)

    def take(self, record: McapRecord, scanner: Scanner) -> None:
        """One top-level record; a damaged one changes nothing."""
        if record.opcode == Opcode.CHUNK:
            data = scanner.contents(record)
            self._take_segments(data, segments(data))
        elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            data = record_data(record)
            self._take_segments(data, segments(data))
        elif record.opcode == Opcode.METADATA:
            metadata = parse(Metadata.read, record.body)
            self.metadata.setdefault(metadata.name, {}).update(metadata.metadata)
        elif record.opcode == Opcode.ATTACHMENT:
            _keep(self.attachments, parse(AttachmentRecord.read, record.body))
        elif record.opcode == Opcode.STATISTICS:
            self.stated = parse(Statistics.read, record.body).channel_message_counts

    def _take_segments(self, data: bytes, parts: list[Segment]) -> None:
        blocks: list[tuple[Array, Array]] = []
        events: list[Event] = []
        records: list[RunRecord] = []
        for part in parts:
            body = memoryview(data)[part.offset + HEAD_SIZE : part.offset + part.size]
            if part.opcode == Opcode.SCHEMA:
                schema = parse(Schema.read, body)
                self.schemas[schema.id] = schema
            elif part.opcode == Opcode.CHANNEL:
                self._take_channel(parse(Channel.read, body))
            elif part.channel in self.layouts:
                blocks.append(_rows(data, part, self.layouts[part.channel], f"{self.path}: {self.topic}"))
            elif part.channel in self.event_channels:
                events += _decoded(data, part, decode_event)
            elif part.channel in self.record_channels:
                records += _decoded(data, part, decode_record)
        self.blocks += blocks  # only now: all of a chunk, or nothing
        self.count += sum(len(rows) for rows, _ in blocks)
        self.events += events
        self.records += records

    def _take_channel(self, channel: Channel) -> None:
        if channel.id in self.channels:
            return  # repeated, as it may be
        self.channels[channel.id] = channel
        schema = self.schemas.get(channel.schema_id)
        if channel.topic == self.topic:
            self.layouts[channel.id] = self._layout(channel, schema)
        elif channel.topic == EVENT_TOPIC and schema is not None and schema.name == EVENT_TYPE:
            self.event_channels.add(channel.id)
        elif channel.topic == RECORD_TOPIC and schema is not None and schema.name == RECORD_TYPE:
            self.record_channels.add(channel.id)

    def _layout(self, channel: Channel, schema: Schema | None) -> RowLayout:
        place = f"{self.path}: channel {channel.topic}"
        if schema is None or schema.encoding != SCHEMA_ENCODING or channel.message_encoding != MESSAGE_ENCODING:
            kind = f"{channel.message_encoding or 'no'} encoding, {schema.encoding if schema else 'no'} schema"
            needed = f"{MESSAGE_ENCODING} with {SCHEMA_ENCODING}"
            raise RecordingError(f"{place} has {kind}; only {needed} can be read")
        try:
            layout = layout_from_schema(schema.data.decode("utf-8", "replace"))
        except RecordingError as error:
            raise RecordingError(f"{place}: {error}") from error
        if any(known.dtype != layout.dtype for known in self.layouts.values()):
            raise RecordingError(f"{place} changes its fields within the file: rows of two kinds make no columns")
        return layout

    @property
    def stated_rows(self) -> int:
        """Rows by the file's statistics."""
        return sum(count for channel, count in self.stated.items() if channel in self.layouts)

    def know(self, summary: Summary) -> None:
        """Schemas, channels and statistics of an index."""
        self.schemas.update(summary.schemas)
        for channel in summary.channels.values():
            self._take_channel(channel)
        if summary.statistics is not None:
            self.stated = summary.statistics.channel_message_counts

    def taken(self) -> list[tuple[Array, Array]]:
        """Rows since the last call."""
        blocks, self.blocks = self.blocks, []
        return blocks

    def run(self, tear: str | None) -> Run:
        """What was collected, without the rows; `tear` as the scanner left it."""
        if self.channels and not self.layouts and tear is None:
            topics = [channel.topic for channel in self.channels.values()]
            hint = did_you_mean(self.topic, topics)
            line = f"fffo-drive import {self.path} --out DIR"
            raise ForeignRecordingError(
                f"{self.path}: no rows on {self.topic!r}: {hint}\n  import a log of another program with: {line}"
            )
        layout = next(iter(self.layouts.values()), _CURRENT_LAYOUT)
        if tear is None and self.stated and self.stated_rows != self.count:
            tear = f"states {self.stated_rows} rows in its statistics"
        reason = "" if tear is None else _torn(self.path, tear, self.count)
        return Run(
            path=self.path,
            rows=np.zeros(0, layout.dtype),
            log_time_ns=np.zeros(0, np.int64),
            units=layout.units,
            meanings=layout.meanings,
            metadata=self.metadata.get(METADATA_NAME, {}),
            summary=self.metadata.get(SUMMARY_NAME, {}),
            attachments=self.attachments,
            events=tuple(self.events),
            records=tuple(self.records),
            complete=tear is None,
            reason=reason,
        )


def _torn(path: Path, tear: str, rows: int) -> str:
    """The message of every reader of a recording that is not whole."""
    remedy = f"; `fffo-drive log recover {path} NEW.mcap` makes a whole file of them" if rows else ""
    return f"{path} {tear}; {rows} rows, up to the last whole chunk, were read{remedy}"


def _rows(data: bytes, part: Segment, layout: RowLayout, place: str) -> tuple[Array, Array]:
    """Rows of a segment in native order, and their log times.

    A payload may be longer than the row (other writers pad), never shorter.
    """
    size = layout.dtype.itemsize
    begin = _MESSAGE_PREFIX + len(CDR_HEADER)
    if part.size < begin + size:
        raise DamagedRecordError(f"a row of {part.size - begin} bytes where its schema needs {size}")
    fields = {
        "names": ["log_time", "encoding", "row"],
        "formats": ["<u8", ">u2", f"V{size}"],
        "offsets": [_LOG_TIME, _MESSAGE_PREFIX, begin],
        "itemsize": part.size,
    }
    records: Array = np.frombuffer(data, np.dtype(fields), part.repeats, part.offset)  # type: ignore[call-overload]
    encoding = int(records["encoding"][0])
    if encoding > 1 or (records["encoding"] != encoding).any():
        raise RecordingError(f"{place}: rows in CDR representation {encoding:#06x}; only plain CDR can be read")
    raw = np.ascontiguousarray(records["row"])  # a copy, so that the decompressed chunk can go
    if encoding == 0:
        raw = raw.view(layout.dtype.newbyteorder(">")).astype(layout.dtype).view(raw.dtype)
    return raw.view(layout.dtype), records["log_time"].astype(np.int64)


def _decoded(data: bytes, part: Segment, decode: Callable[[bytes], T]) -> list[T]:
    found = []
    for number in range(part.repeats):
        begin = part.offset + number * part.size
        try:
            found.append(decode(data[begin + _MESSAGE_PREFIX : begin + part.size]))
        except ValueError as error:
            raise DamagedRecordError(str(error)) from error
    return found

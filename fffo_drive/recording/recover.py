"""Makes a complete, indexed file from a torn one: records of complete chunks unchanged, with a new index."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from .container import ChunkBuilder, McapFile
from .errors import RecordingError
from .files import regular
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
from .schema import METADATA_NAME, ROW_TOPIC, SUMMARY_NAME, message_dtype
from .settings import CHUNK_SIZE, open_new
from .writer import LIBRARY

RESCUE_SUFFIX = ".recovering"  # not .part: that is often the name of the input
_MESSAGE_PREFIX = message_dtype(0).itemsize


class RecoverReport(NamedTuple):
    """Result of a recovery."""

    path_in: Path
    path_out: Path
    was_complete: bool
    reason: str  # why the file was not complete, or ""
    rows: int
    messages: int  # rows, events and whatever other channels hold
    bytes_in: int
    bytes_discarded: int  # behind the last whole record


def recover(path_in: Path | str, path_out: Path | str) -> RecoverReport:
    """Write what is whole in `path_in` to the new file `path_out`, marked `recovered: true` in its metadata.

    Raises RecordingError when `path_in` is no MCAP file or has not even a header, FileExistsError when
    `path_out` is there.
    """
    source, target = Path(path_in), Path(path_out)
    part = target.with_name(target.name + RESCUE_SUFFIX)
    for taken in (target, part):
        if taken.exists():
            raise FileExistsError(
                errno.EEXIST, "a file of this name exists and is not overwritten: give another name", str(taken)
            )
    with regular(source).open("rb") as file:
        scanner = Scanner(file, str(source))
        rescue = _Rescue(source, part)
        try:
            for record in scanner:
                try:
                    rescue.take(record, scanner)
                except DamagedRecordError as damage:
                    scanner.damage(record, str(damage))
                    break
            report = rescue.finish(scanner, target)
        except BaseException:
            rescue.discard()
            raise
    os.rename(part, target)
    return report


class _Rescue:
    """The new file, as far as it has come."""

    def __init__(self, source: Path, part: Path) -> None:
        self._source = source
        self._part = part
        self._file = open_new(part)
        self._out: McapFile | None = None
        self._chunk = ChunkBuilder()
        self._schemas: set[int] = set()
        self._channels: dict[int, str] = {}  # topic by channel
        self._counts: dict[int, int] = {}

    def take(self, record: McapRecord, scanner: Scanner) -> None:
        """One top-level record of the torn file; a damaged one is dropped."""
        if record.opcode == Opcode.HEADER:
            header = parse(Header.read, record.body)
            self._out = McapFile(self._file, header.profile, f"{LIBRARY} recovered from {header.library}")
        elif record.opcode == Opcode.CHUNK:
            self._take_contents(scanner.contents(record))
        elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            self._take_contents(record_data(record))
        elif record.opcode == Opcode.METADATA:
            metadata = parse(Metadata.read, record.body)
            facts = dict(metadata.metadata)
            if metadata.name == METADATA_NAME:
                facts |= {"recovered": "true", "recovered_from": self._source.name}
            self._output().add_metadata(metadata.name, facts)
        elif record.opcode == Opcode.ATTACHMENT:
            found = parse(Attachment.read, record.body)
            self._output().add_attachment(found.name, found.media_type, found.data, found.log_time)

    def _output(self) -> McapFile:
        if self._out is None:
            raise DamagedRecordError("it stands before the header")
        return self._out

    def _take_contents(self, data: bytes) -> None:
        out = self._output()
        parts = segments(data)
        described = [self._describe(data, part) for part in parts]
        known = set(self._channels) | {entry.id for entry in described if isinstance(entry, Channel)}
        for part in parts:
            if part.opcode == Opcode.MESSAGE and part.channel not in known:
                raise DamagedRecordError(f"a message on channel {part.channel}, which nothing describes")
        for part, entry in zip(parts, described, strict=True):
            raw = data[part.offset : part.offset + part.size * part.repeats]
            if entry is None:
                self._add_messages(part, raw)
            elif self._is_new(entry):
                out.register(entry)
                self._chunk.add_record(raw)
        if self._chunk.size > CHUNK_SIZE:
            self._write_chunk(out)

    def _describe(self, data: bytes, part: Segment) -> Schema | Channel | None:
        body = data[part.offset + HEAD_SIZE : part.offset + part.size]
        entry: Schema | Channel | None = None
        if part.opcode == Opcode.SCHEMA:
            entry = parse(Schema.read, body)
        elif part.opcode == Opcode.CHANNEL:
            entry = parse(Channel.read, body)
        return entry

    def _is_new(self, entry: Schema | Channel) -> bool:
        if isinstance(entry, Schema):
            new = entry.id not in self._schemas
            self._schemas.add(entry.id)
            return new
        new = entry.id not in self._channels
        self._channels[entry.id] = entry.topic
        return new

    def _add_messages(self, part: Segment, raw: bytes) -> None:
        records = np.frombuffer(raw, message_dtype(part.size - _MESSAGE_PREFIX))
        self._chunk.add_messages(part.channel, raw, records["log_time"])
        self._counts[part.channel] = self._counts.get(part.channel, 0) + part.repeats

    def _write_chunk(self, out: McapFile) -> None:
        if self._chunk.counts:
            out.add_chunk(self._chunk)
            self._chunk = ChunkBuilder()

    def finish(self, scanner: Scanner, target: Path) -> RecoverReport:
        """The last chunk, the account of what was done, the index."""
        if self._out is None:
            raise RecordingError(f"{self._source}: nothing to recover, it {scanner.tear or 'has no header'}")
        report = RecoverReport(
            path_in=self._source,
            path_out=target,
            was_complete=scanner.tear is None,
            reason=scanner.tear or "",
            rows=sum(count for channel, count in self._counts.items() if self._channels[channel] == ROW_TOPIC),
            messages=sum(self._counts.values()),
            bytes_in=scanner.size,
            bytes_discarded=scanner.size - scanner.whole_bytes,
        )
        facts = {
            name: str(getattr(report, name)) for name in ("reason", "rows", "messages", "bytes_in", "bytes_discarded")
        }
        self._write_chunk(self._out)
        self._out.add_metadata(SUMMARY_NAME, {"recovered": "true", **facts})
        self._out.finish()
        os.fsync(self._file.fileno())
        self._file.close()
        return report

    def discard(self) -> None:
        """Remove the new file."""
        with contextlib.suppress(OSError):
            self._file.close()
            self._part.unlink()

"""An MCAP file that grows by whole records, written in batches with the public record classes of `mcap`.

The library's own `Writer` takes one message at a time (7 us each) and, if a write fails half-way, continues after the
torn record, so that nothing after it can be read. Here a batch of rows is one block of memory, and a failed write is
truncated: the file always ends with a complete record. Layout and order of records are those of `mcap.writer.Writer`;
a test compares the two byte for byte. Format: https://mcap.dev/spec
"""

from __future__ import annotations

import contextlib
import errno
import struct
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from .settings import BinaryFile, Compression

MAGIC = b"\x89MCAP0\r\n"
ZSTD_LEVEL = 3  # twice the level buys 1 % of size for twice the time


class ChunkBuilder:
    """The records of the chunk being filled, and where its messages begin."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._index: dict[int, list[np.ndarray[Any, np.dtype[np.uint64]]]] = {}
        self.size = 0
        self.start_ns = 0
        self.end_ns = 0
        self.counts: dict[int, int] = {}

    def add_record(self, record: bytes) -> None:
        """A record other than a message: a schema or channel."""
        self._add(record)

    def add_messages(self, channel: int, block: bytes, log_times: np.ndarray[Any, Any]) -> None:
        """Message records of equal size, one after the other in `block`; `log_times` (n,) uint64, n >= 1."""
        count = len(log_times)
        places = np.empty((count, 2), "<u8")
        places[:, 0] = log_times
        places[:, 1] = self.size + np.arange(count, dtype=np.uint64) * np.uint64(len(block) // count)
        first, last = int(log_times.min()), int(log_times.max())
        self.start_ns = min(self.start_ns, first) if self.counts else first
        self.end_ns = max(self.end_ns, last)
        self._index.setdefault(channel, []).append(places)
        self.counts[channel] = self.counts.get(channel, 0) + count
        self._add(block)

    def _add(self, data: bytes) -> None:
        self._parts.append(data)
        self.size += len(data)

    def content(self) -> bytes:
        """The chunk before compression."""
        return b"".join(self._parts)

    def index_records(self, start: int) -> tuple[bytes, dict[int, int]]:
        """All MessageIndex records, and where each channel's begins when the first one stands at `start`."""
        builder: Any = RecordBuilder()
        offsets = {}
        for channel, places in self._index.items():
            offsets[channel] = start + builder.count
            data = b"".join(part.tobytes() for part in places)
            builder.start_record(Opcode.MESSAGE_INDEX)
            builder.write2(channel)
            builder.write4(len(data))
            builder.write(data)
            builder.finish_record()
        return builder.end(), offsets


class McapFile:
    """Appends to an open, empty file. A method that raises OSError has written nothing."""

    def __init__(self, file: BinaryFile, profile: str, library: str, compression: Compression = "zstd") -> None:
        if compression not in ("zstd", "none"):
            raise ValueError(f"compression {compression!r}: use 'zstd' or 'none'")
        self._file = file
        self._compression = "" if compression == "none" else compression
        self._compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL)
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunk_indexes: list[ChunkIndex] = []
        self._attachment_indexes: list[AttachmentIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._start_ns = 0
        self._end_ns = 0
        self.size = 0  # bytes in the file, always the end of a whole record
        self._append(MAGIC + record_bytes(Header(profile, library)))

    def _append(self, data: bytes) -> None:
        view = memoryview(data)
        try:
            while view:
                written = self._file.write(view)
                if not written:
                    raise OSError(errno.EIO, "the file takes no more bytes")
                view = view[written:]
        except BaseException:
            with contextlib.suppress(OSError, ValueError):
                self._file.seek(self.size)
                self._file.truncate(self.size)
            raise
        self.size += len(data)

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """A Metadata record: a named map of strings."""
        record = record_bytes(Metadata(name=_utf8(name), metadata={_utf8(k): _utf8(v) for k, v in data.items()}))
        index = MetadataIndex(offset=self.size, length=len(record), name=_utf8(name))
        self._append(record)
        self._metadata_indexes.append(index)

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int = 0) -> None:
        """An Attachment record; `time_ns` is both its log time and its time of creation."""
        record = record_bytes(
            Attachment(create_time=time_ns, log_time=time_ns, name=_utf8(name), media_type=media_type, data=data)
        )
        index = AttachmentIndex(
            offset=self.size,
            length=len(record),
            log_time=time_ns,
            create_time=time_ns,
            data_size=len(data),
            name=_utf8(name),
            media_type=media_type,
        )
        self._append(record)
        self._attachment_indexes.append(index)

    @property
    def chunk_count(self) -> int:
        """Chunks in the file."""
        return len(self._chunk_indexes)

    def register(self, record: Schema | Channel) -> None:
        """Repeat this schema or channel in the summary. It is also in a chunk, before its messages."""
        if isinstance(record, Schema):
            self._schemas.append(record)
        else:
            self._channels.append(record)

    def add_chunk(self, chunk: ChunkBuilder) -> None:
        """Compress and append a chunk and its indexes, all or nothing; one without messages is left out."""
        if not chunk.counts:
            return
        content = chunk.content()
        data = self._compressor.compress(content) if self._compression == "zstd" else content
        record = Chunk(
            compression=self._compression,
            data=data,
            message_start_time=chunk.start_ns,
            message_end_time=chunk.end_ns,
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        packed = record_bytes(record)
        indexes, offsets = chunk.index_records(self.size + len(packed))
        index = ChunkIndex(
            message_start_time=chunk.start_ns,
            message_end_time=chunk.end_ns,
            chunk_start_offset=self.size,
            chunk_length=len(packed),
            message_index_offsets=offsets,
            message_index_length=len(indexes),
            compression=self._compression,
            compressed_size=len(data),
            uncompressed_size=len(content),
        )
        self._append(packed + indexes)
        first = not self._chunk_indexes
        self._chunk_indexes.append(index)
        self._start_ns = chunk.start_ns if first else min(self._start_ns, chunk.start_ns)
        self._end_ns = max(self._end_ns, chunk.end_ns)
        for channel, count in chunk.counts.items():
            self._counts[channel] = self._counts.get(channel, 0) + count

    def finish(self) -> None:
        """Write the index: end of data, summary, footer, magic. The file stays open."""
        data_end = record_bytes(DataEnd(0))
        summary_start = self.size + len(data_end)
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, list(self._schemas)),
            (Opcode.CHANNEL, list(self._channels)),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, list(self._chunk_indexes)),
            (Opcode.ATTACHMENT_INDEX, list(self._attachment_indexes)),
            (Opcode.METADATA_INDEX, list(self._metadata_indexes)),
        ]
        summary = b""
        offsets = b""
        for opcode, records in groups:
            group = b"".join(record_bytes(record) for record in records)
            place = SummaryOffset(
                group_opcode=opcode, group_start=summary_start + len(summary), group_length=len(group)
            )
            offsets += record_bytes(place) if records else b""
            summary += group
        offset_start = summary_start + len(summary)
        summary += offsets
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, offset_start)
        footer = Footer(
            summary_start=summary_start,
            summary_offset_start=offset_start,
            summary_crc=zlib.crc32(head, zlib.crc32(summary)),
        )
        self._append(data_end + summary + record_bytes(footer) + MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self._counts.values()),
            message_end_time=self._end_ns,
            message_start_time=self._start_ns,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )


def record_bytes(record: McapRecord) -> bytes:
    """A record as it stands in the file."""
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _utf8(text: str) -> str:
    """Text that UTF-8 can hold: paths may carry lone surrogates."""
    return text.encode("utf-8", "replace").decode()

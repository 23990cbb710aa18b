"""Walks through an MCAP file record by record and stops, with a reason, where it is torn or damaged.

The readers of `mcap` need the index at the end, or raise from deep inside when a record is cut off. This one
trusts nothing: a record is valid if all its bytes are there, a chunk if it decompresses to the size and checksum that
it states.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream

from .container import MAGIC
from .errors import RecordingError
from .unpack import Allowance

HEAD_SIZE = 9  # opcode u1, length u8
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")
_MESSAGE_HEAD = np.dtype([("opcode", "u1"), ("length", "<u8"), ("channel", "<u2")])
LARGEST_CHUNK = 64 * 1024 * 1024  # bytes; ours have 256 kB, those of others some MB
_IN_CHUNKS = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))
_SKIPPED = frozenset(  # found again from the data, or of no use here
    (
        Opcode.MESSAGE_INDEX,
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT_INDEX,
        Opcode.METADATA_INDEX,
        Opcode.SUMMARY_OFFSET,
        Opcode.DATA_END,
    )
)

T = TypeVar("T")


class DamagedRecordError(Exception):
    """Bytes that do not match their header. Never leaves this package."""


class McapRecord(NamedTuple):
    """A record of the file's top level."""

    opcode: int
    offset: int
    body: bytes  # empty for indexes


def record_data(record: McapRecord) -> bytes:
    """A top-level record as it stands in the file, to be treated like a chunk with one record."""
    return _HEAD.pack(record.opcode, len(record.body)) + record.body


class Segment(NamedTuple):
    """A stretch of a chunk: one schema or channel, or `repeats` messages of one channel and size."""

    opcode: int
    channel: int
    offset: int
    size: int  # of one record, with its head
    repeats: int


class Scanner:
    """Iterates over the top-level records of an open file; then `tear` says why it ended early, or is None.

    Raises RecordingError if the file is not an MCAP file.
    """

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file = file
        self._name = name
        self.size = os.fstat(file.fileno()).st_size  # a file that grows meanwhile is read up to here
        self._allowance = Allowance(name, self.size)
        self.whole_bytes = 0  # up to the end of the last whole record
        self.tear: str | None = None

    def __iter__(self) -> Iterator[McapRecord]:
        magic = self._file.read(len(MAGIC))
        if magic != MAGIC[: len(magic)]:
            raise RecordingError(f"{self._name}: not an MCAP file (it begins with {magic[:8]!r})")
        if len(magic) < len(MAGIC):
            self.tear = f"ends at byte {self.size}, inside the magic at its beginning"
            return
        self.whole_bytes = len(MAGIC)
        opcode = 0
        while opcode != Opcode.FOOTER:
            head = self._file.read(HEAD_SIZE)
            if len(head) < HEAD_SIZE:
                self.tear = f"ends at byte {self.size}, before its index: it was never closed"
                return
            opcode, length = _HEAD.unpack(head)
            if opcode == 0:
                self.tear = f"is damaged at byte {self.whole_bytes}: a record of kind 0, which there is none of"
                return
            begin = self.whole_bytes + HEAD_SIZE
            if begin + length > self.size:
                needs = f"{_title(opcode)} that takes {length} bytes from {begin}"
                self.tear = f"ends at byte {self.size}, inside {needs}"
                return
            if opcode in _SKIPPED or opcode > max(Opcode):
                self._file.seek(length, os.SEEK_CUR)
                body = b""
            else:
                body = self._file.read(length)
            yield McapRecord(opcode, self.whole_bytes, body)
            self.whole_bytes = begin + length
        if self._file.read(len(MAGIC)) != MAGIC:
            self.tear = f"ends at byte {self.size} without the closing magic"
            return
        self.whole_bytes += len(MAGIC)

    def contents(self, record: McapRecord) -> bytes:
        """As `open_chunk`, within what this file may unpack to."""
        return open_chunk(record.body, self._allowance)

    def damage(self, record: McapRecord, reason: str) -> None:
        """Note that the scan ends at this record, which is all there but wrong."""
        self.tear = f"is damaged at byte {record.offset}, in {_title(record.opcode)}: {reason}"
        self.whole_bytes = record.offset


def _title(opcode: int) -> str:
    try:
        return f"a {Opcode(opcode).name.lower().replace('_', ' ')} record"
    except ValueError:
        return f"a record of unknown kind {opcode}"


def parse(read: Callable[[ReadDataStream], T], body: bytes | memoryview) -> T:
    """One record by a `read` of `mcap.records`; DamagedRecordError when the body does not fit."""
    stream = io.BytesIO(body)
    try:
        result = read(ReadDataStream(stream))
    except (McapError, struct.error, UnicodeDecodeError, ValueError, MemoryError, OverflowError) as error:
        raise DamagedRecordError(f"{type(error).__name__} {error}".strip()) from error
    return result


def open_chunk(body: bytes, allowance: Allowance | None = None) -> bytes:
    """The records in a Chunk, decompressed and checked.

    Raises DamagedRecordError; RecordingError for a sound one that takes more than the file is allowed.
    """
    if len(body) < _CHUNK.size + 4:
        raise DamagedRecordError("too short for a chunk")
    _, _, size, crc = _CHUNK.unpack_from(body)
    (name_length,) = struct.unpack_from("<I", body, _CHUNK.size)
    begin = _CHUNK.size + 4 + name_length
    compression = body[_CHUNK.size + 4 : begin]
    if begin + 8 > len(body) or begin + 8 + struct.unpack_from("<Q", body, begin)[0] != len(body):
        raise DamagedRecordError("the chunk's size does not fit its record")
    data = memoryview(body)[begin + 8 :]
    if _size_inside(compression, data, size) != size:
        raise DamagedRecordError(f"it does not unpack to the {size} bytes that it states")
    if allowance is not None:
        allowance.take(size)
    if size > LARGEST_CHUNK:
        raise DamagedRecordError(f"it unpacks to {size} bytes; no chunk has more than {LARGEST_CHUNK}")
    content = _decompress(compression, data, size, body)
    if len(content) != size:
        raise DamagedRecordError(f"{len(content)} bytes after decompression, {size} are stated")
    if crc and zlib.crc32(content) != crc:
        raise DamagedRecordError("checksum does not match")
    return content


def _size_inside(compression: bytes, data: memoryview, stated: int) -> int:
    """Unpacked size from the compressed bytes; from the chunk header if they do not state it."""
    if compression == b"":
        return len(data)
    if compression != b"zstd":
        return stated
    try:
        size = int(zstandard.frame_content_size(data))
    except zstandard.ZstdError:
        raise DamagedRecordError("it cannot be decompressed") from None
    return size if size >= 0 else stated


def _decompress(compression: bytes, data: memoryview, size: int, body: bytes) -> bytes:
    if compression == b"":
        return bytes(data)
    try:
        if compression == b"zstd":
            return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
        stream, length = get_chunk_data_stream(parse(Chunk.read, body))
        return stream.read(length)
    except (zstandard.ZstdError, McapError, RuntimeError, MemoryError) as error:
        raise DamagedRecordError("it cannot be decompressed") from error


def segments(data: bytes) -> list[Segment]:
    """What a chunk consists of; messages of one channel and size that follow each other are one segment."""
    found: list[Segment] = []
    position = 0
    while position < len(data):
        if position + HEAD_SIZE > len(data):
            raise DamagedRecordError("the last record of the chunk is cut off")
        opcode, length = _HEAD.unpack_from(data, position)
        size = HEAD_SIZE + length
        if position + size > len(data):
            raise DamagedRecordError("a record is longer than its chunk")
        if opcode not in _IN_CHUNKS:
            raise DamagedRecordError(f"{_title(opcode)} in a chunk, which holds schemas, channels and messages")
        segment = Segment(opcode, 0, position, size, 1)
        if opcode == Opcode.MESSAGE:
            if length < 22:
                raise DamagedRecordError("a message that is too short")
            segment = _message_segment(data, position, size)
        found.append(segment)
        position += segment.size * segment.repeats
    return found


def _message_segment(data: bytes, position: int, size: int) -> Segment:
    heads: np.ndarray[Any, Any] = np.ndarray(
        ((len(data) - position) // size,), _MESSAGE_HEAD, buffer=data, offset=position, strides=(size,)
    )
    channel = int(heads["channel"][0])
    same = (heads["length"] == size - HEAD_SIZE) & (heads["channel"] == channel) & (heads["opcode"] == Opcode.MESSAGE)
    count = len(heads) if same.all() else int(np.argmin(same))
    return Segment(Opcode.MESSAGE, channel, position, size, count)

"""The index at the end of a finished recording: where everything is, without reading what lies between."""

from __future__ import annotations

import os
import struct
import zlib
from typing import BinaryIO

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import ChunkIndex
from mcap.summary import Summary

from .container import MAGIC
from .errors import RecordingError
from .scan import HEAD_SIZE, McapRecord

_FOOTER = struct.Struct("<BQQQI")  # opcode, length, where the summary and its offsets begin, checksum of all before


def read_index(file: BinaryIO) -> Summary | None:
    """The index of an open file; None where there is none, or no sound one: then only a scan helps."""
    size = file.seek(0, os.SEEK_END)
    begin = size - _FOOTER.size - len(MAGIC)
    if begin < len(MAGIC):
        return None
    file.seek(begin)
    tail = file.read()
    opcode, _, summary_start, _, checksum = _FOOTER.unpack_from(tail)
    if opcode != Opcode.FOOTER or tail[_FOOTER.size :] != MAGIC or not 0 < summary_start < begin:
        return None
    file.seek(summary_start)
    whole = file.read(begin - summary_start) + tail[: _FOOTER.size - 4]
    if checksum and zlib.crc32(whole) != checksum:
        return None
    file.seek(0)
    try:
        summary = SeekingReader(file).get_summary()
    except (McapError, struct.error, UnicodeDecodeError, ValueError, MemoryError, OverflowError, StopIteration):
        return None
    if summary is None or summary.statistics is None or not summary.channels:
        return None
    stated = summary.statistics
    indexed = (len(summary.chunk_indexes), len(summary.attachment_indexes), len(summary.metadata_indexes))
    if indexed != (stated.chunk_count, stated.attachment_count, stated.metadata_count):
        return None
    if stated.message_count and not summary.chunk_indexes:
        return None  # messages outside of chunks are in no index
    if not all(_is_inside(chunk, summary_start) and chunk.message_index_offsets for chunk in summary.chunk_indexes):
        return None
    return summary


def _is_inside(chunk: ChunkIndex, end: int) -> bool:
    return chunk.chunk_start_offset + chunk.chunk_length <= end


def record_at(file: BinaryIO, opcode: int, offset: int, length: int) -> McapRecord:
    """A record of the file's top level. Raises RecordingError where it is not what the index says."""
    file.seek(offset)
    data = file.read(length)
    if len(data) < HEAD_SIZE or data[0] != opcode or int.from_bytes(data[1:HEAD_SIZE], "little") != length - HEAD_SIZE:
        raise RecordingError(
            f"{file.name}: its index names a record at byte {offset} that is not there; `fffo-drive log recover "
            f"{file.name} NEW.mcap` makes a whole file of what is"
        )
    return McapRecord(opcode, offset, data[HEAD_SIZE:])

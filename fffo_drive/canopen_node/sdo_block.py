"""SDO block transfer (CiA 301, 7.2.4.2.9 to 7.2.4.2.16): one transfer in each class, from its begin to its end.

`receive` takes the 8 bytes of a client's message and gives the server's answers; `done` says that it is over.
What the protocol forbids raises SdoAbortError. The CRC is CRC-16-CCITT with initial value 0, of the data alone.
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Callable

from .abort import Abort, SdoAbortError

LONGEST_BLOCK = 127  # segments
SEGMENT = 7  # data bytes
LAST = 0x80  # of a sequence number: nothing follows
END_DOWNLOAD, BLOCK_ACKNOWLEDGED, UPLOAD_STARTED = 0xC1, 0xA2, 0xA3
WITH_CRC = 0x04
_SPECIFIER = 0xE3  # command specifier and subcommand of a byte, without the count of unused bytes


def block_crc(data: bytes) -> int:
    """CRC-16-CCITT as block transfer uses it; of "123456789" it is 0x31C3."""
    return binascii.crc_hqx(data, 0)


class BlockDownload:
    """From client to server. `store(data)` is called once with everything; it may raise SdoAbortError."""

    def __init__(self, with_crc: bool, announced: int | None, limit: int, store: Callable[[bytes], None]) -> None:
        """`announced`: bytes that the client promised; `limit`: the longest that the object takes."""
        self._with_crc, self._announced, self._limit, self._store = with_crc, announced, limit, store
        self._data = bytearray()
        self._received = 0  # the last segment of this block that came in order
        self._in_segments = True
        self._complete = False  # the last segment is here
        self.done = False

    def receive(self, data: bytes) -> list[bytes]:
        """A segment, or the end of the transfer."""
        return self._segment(data) if self._in_segments else self._end(data)

    def _segment(self, data: bytes) -> list[bytes]:
        number, last = data[0] & ~LAST, bool(data[0] & LAST)
        if number == 0:
            raise SdoAbortError(Abort.SEQUENCE_NUMBER)
        if number == self._received + 1:
            self._received = number
            self._data += data[1:]
            self._complete = last
            if len(self._data) - SEGMENT >= max(self._limit if self._announced is None else self._announced, 1):
                raise SdoAbortError(Abort.TOO_LONG)
        if not last and number < LONGEST_BLOCK:
            return []
        answer = bytes([0xA2, self._received, LONGEST_BLOCK]) + bytes(5)
        self._in_segments = not self._complete
        self._received = 0
        return [answer]

    def _end(self, data: bytes) -> list[bytes]:
        if data[0] & _SPECIFIER != END_DOWNLOAD:
            raise SdoAbortError(Abort.INVALID_COMMAND)
        content = bytes(self._data[: len(self._data) - (data[0] >> 2 & 7)])
        if self._announced is not None and len(content) != self._announced:
            raise SdoAbortError(Abort.TOO_LONG if len(content) > self._announced else Abort.TOO_SHORT)
        if self._with_crc and block_crc(content) != struct.unpack_from("<H", data, 1)[0]:
            raise SdoAbortError(Abort.CRC)
        self._store(content)
        self.done = True
        return [bytes([0xA1]) + bytes(7)]


class BlockUpload:
    """From server to client, `block` segments at a time. Raises SdoAbortError for a block of 0 or above 127."""

    def __init__(self, content: bytes, block: int, with_crc: bool) -> None:
        self._content, self._block, self._with_crc = content, checked_block(block), with_crc
        self._sent = 0  # segments of the present block
        self._acknowledged = 0  # bytes
        self._started = False
        self._ended = False
        self.done = False

    def receive(self, data: bytes) -> list[bytes]:
        """The start, an acknowledgement, or the client's end of the transfer."""
        if self._ended:
            if data[0] & _SPECIFIER != 0xA1:
                raise SdoAbortError(Abort.INVALID_COMMAND)
            self.done = True
            return []
        if not self._started:
            if data[0] != UPLOAD_STARTED:
                raise SdoAbortError(Abort.INVALID_COMMAND)
            self._started = True
            return self._segments()
        return self._acknowledge(data)

    def _acknowledge(self, data: bytes) -> list[bytes]:
        if data[0] != BLOCK_ACKNOWLEDGED:
            raise SdoAbortError(Abort.INVALID_COMMAND)
        if data[1] > self._sent:
            raise SdoAbortError(Abort.SEQUENCE_NUMBER)
        self._acknowledged += data[1] * SEGMENT
        self._block = checked_block(data[2])
        if self._acknowledged < len(self._content):
            return self._segments()
        self._ended = True
        unused = -len(self._content) % SEGMENT
        crc = block_crc(self._content) if self._with_crc else 0
        return [struct.pack("<BH5x", 0xC1 | unused << 2, crc)]

    def _segments(self) -> list[bytes]:
        left = self._content[self._acknowledged :]
        parts = [left[k : k + SEGMENT] for k in range(0, len(left), SEGMENT)][: self._block]
        self._sent = len(parts)
        ends = self._acknowledged + self._sent * SEGMENT >= len(self._content)
        return [
            bytes([number | (LAST if ends and number == self._sent else 0)]) + part.ljust(SEGMENT, b"\x00")
            for number, part in enumerate(parts, 1)
        ]


def checked_block(size: int) -> int:
    """A block size that the client asked for. Raises SdoAbortError."""
    if not 1 <= size <= LONGEST_BLOCK:
        raise SdoAbortError(Abort.BLOCK_SIZE)
    return size

"""SDO server (CiA 301, 7.2.4): expedited and segmented transfer in both directions.

Block transfer, which is optional, is refused with 0x05040001. A new request to begin ends the transfer under
way, as a client that gave up would expect. Requests shorter than 8 bytes are no SDO and are not answered.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from ....can.frame import DATA_OFFSET, LENGTH_OFFSET, MAX_DATA, SDO_REQUEST, SDO_RESPONSE
from .abort import Abort, SdoAbortError
from .bus import NEVER, NS_PER_MS, Bus
from .dictionary import ObjectDictionary
from .nmt import NmtSlave

TIMEOUT_NS = 1000 * NS_PER_MS  # between two segments
SEGMENT = 7  # data bytes of a segment
EXPEDITED = 4  # data bytes of an expedited transfer

# command specifiers: bits 7 to 5 of the first byte
DOWNLOAD_SEGMENT, INITIATE_DOWNLOAD, INITIATE_UPLOAD, UPLOAD_SEGMENT, ABORT_TRANSFER = 0, 1, 2, 3, 4
_MULTIPLEXER = struct.Struct("<HB")
_SIZE = struct.Struct("<I")


@dataclass(slots=True)
class Transfer:
    """A segmented transfer under way. Upload: `data` is what is left. Download: what came so far."""

    index: int
    sub: int
    upload: bool
    data: bytes
    announced: int | None = None  # length that the client promised
    limit: int = 0  # the longest that the object takes
    toggle: int = 0


class SdoServer:
    """Answers on 0x580 + node-ID what it is asked on 0x600 + node-ID."""

    def __init__(self, bus: Bus, od: ObjectDictionary, nmt: NmtSlave) -> None:
        self.bus, self.od, self.nmt = bus, od, nmt
        self.request_id = SDO_REQUEST + nmt.node_id
        self._response_id = SDO_RESPONSE + nmt.node_id
        self._transfer: Transfer | None = None
        self.deadline_ns = NEVER

    def reset(self) -> None:
        """Drop the transfer under way: NMT reset, or STOPPED."""
        self._transfer = None
        self.deadline_ns = NEVER

    def poll(self) -> None:
        """The client fell silent in the middle of a transfer."""
        self._abort(Abort.TIMEOUT)

    def receive(self, frame: bytes) -> None:
        """A request."""
        if not self.nmt.communicates or frame[LENGTH_OFFSET] < MAX_DATA:
            return
        data = frame[DATA_OFFSET:]
        specifier = data[0] >> 5
        try:
            if specifier == INITIATE_DOWNLOAD:
                self._initiate_download(data)
            elif specifier == INITIATE_UPLOAD:
                self._initiate_upload(data)
            elif specifier == DOWNLOAD_SEGMENT:
                self._download_segment(data)
            elif specifier == UPLOAD_SEGMENT:
                self._upload_segment(data)
            elif specifier == ABORT_TRANSFER:
                self.reset()
            else:
                self._begin(data)
                raise SdoAbortError(Abort.INVALID_COMMAND)
        except SdoAbortError as error:
            self._abort(error.code)

    def _begin(self, data: bytes) -> Transfer:
        index, sub = _MULTIPLEXER.unpack_from(data, 1)
        self._transfer = Transfer(index, sub, upload=data[0] >> 5 == INITIATE_UPLOAD, data=b"")
        return self._transfer

    def _continue(self, upload: bool, toggle: int) -> Transfer:
        transfer = self._transfer
        if transfer is None or transfer.upload is not upload:
            raise SdoAbortError(Abort.INVALID_COMMAND)
        if toggle != transfer.toggle:
            raise SdoAbortError(Abort.TOGGLE_BIT)
        transfer.toggle ^= 1
        self.deadline_ns = self.bus.now_ns + TIMEOUT_NS
        return transfer

    def _finish(self) -> None:
        self._transfer = None
        self.deadline_ns = NEVER

    def _abort(self, code: Abort) -> None:
        transfer = self._transfer
        index, sub = (transfer.index, transfer.sub) if transfer else (0, 0)
        self._finish()
        self._answer(0x80, index, sub, _SIZE.pack(code))

    def _answer(self, command: int, index: int, sub: int, data: bytes = b"") -> None:
        self.bus.send(self._response_id, struct.pack("<BHB4s", command, index, sub, data))

    def _initiate_download(self, data: bytes) -> None:
        transfer = self._begin(data)
        expedited, size_given = data[0] >> 1 & 1, data[0] & 1
        if expedited:
            length = EXPEDITED - (data[0] >> 2 & 3) if size_given else None
            entry = self.od.check_download(transfer.index, transfer.sub, length)
            content = data[4 : 4 + (entry.size or EXPEDITED if length is None else length)]
            self.od.download(transfer.index, transfer.sub, content)
            self._finish()
        else:
            transfer.announced = _SIZE.unpack_from(data, 4)[0] if size_given else None
            entry = self.od.check_download(transfer.index, transfer.sub, transfer.announced)
            transfer.limit = entry.size or entry.high or 0
            self.deadline_ns = self.bus.now_ns + TIMEOUT_NS
        self._answer(0x60, transfer.index, transfer.sub)

    def _download_segment(self, data: bytes) -> None:
        transfer = self._continue(upload=False, toggle=data[0] >> 4 & 1)
        transfer.data += data[1 : 1 + SEGMENT - (data[0] >> 1 & 7)]
        if len(transfer.data) > (transfer.limit if transfer.announced is None else transfer.announced):
            raise SdoAbortError(Abort.TOO_LONG)
        if data[0] & 1:  # the last one
            if transfer.announced is not None and len(transfer.data) < transfer.announced:
                raise SdoAbortError(Abort.TOO_SHORT)
            self.od.download(transfer.index, transfer.sub, transfer.data)
            self._finish()
        self.bus.send(self._response_id, bytes([0x20 | data[0] & 0x10]) + bytes(7))

    def _initiate_upload(self, data: bytes) -> None:
        transfer = self._begin(data)
        content = self.od.upload(transfer.index, transfer.sub)
        if 0 < len(content) <= EXPEDITED:
            self._finish()
            self._answer(0x43 | (EXPEDITED - len(content)) << 2, transfer.index, transfer.sub, content)
            return
        transfer.data = content
        self.deadline_ns = self.bus.now_ns + TIMEOUT_NS
        self._answer(0x41, transfer.index, transfer.sub, _SIZE.pack(len(content)))

    def _upload_segment(self, data: bytes) -> None:
        toggle = data[0] >> 4 & 1
        transfer = self._continue(upload=True, toggle=toggle)
        part, transfer.data = transfer.data[:SEGMENT], transfer.data[SEGMENT:]
        last = not transfer.data
        if last:
            self._finish()
        self.bus.send(
            self._response_id,
            bytes([toggle << 4 | (SEGMENT - len(part)) << 1 | last]) + part.ljust(SEGMENT, b"\x00"),
        )

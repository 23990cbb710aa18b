"""SDO server (CiA 301, 7.2.4): expedited, segmented and block transfer in both directions.

A new initiate request ends a segmented transfer under way, as a client that gave up expects. Segments of a block can
look like any request, so a block transfer ends only when complete, aborted or timed out. Requests shorter than 8 bytes
are no SDO and are not answered.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from ..can.frame import DATA_OFFSET, LENGTH_OFFSET, MAX_DATA, SDO_REQUEST, SDO_RESPONSE
from .abort import Abort, SdoAbortError
from .bus import NEVER, NS_PER_MS, Bus, Timed
from .dictionary import ObjectDictionary, longest_of
from .nmt import NmtSlave
from .sdo_block import LONGEST_BLOCK, WITH_CRC, BlockDownload, BlockUpload, checked_block

TIMEOUT_NS = 1000 * NS_PER_MS  # between two segments
SEGMENT = 7  # data bytes of a segment
EXPEDITED = 4  # data bytes of an expedited transfer

# command specifiers: bits 7 to 5 of the first byte
DOWNLOAD_SEGMENT, INITIATE_DOWNLOAD, INITIATE_UPLOAD, UPLOAD_SEGMENT, ABORT_TRANSFER = 0, 1, 2, 3, 4
BLOCK_UPLOAD, BLOCK_DOWNLOAD = 5, 6
ABORT_COMMAND = 0x80  # the whole byte
_SIZE_GIVEN = 0x02  # of a block download
_MULTIPLEXER = struct.Struct("<HB")
_SIZE = struct.Struct("<I")


@dataclass(slots=True)
class Transfer:
    """A transfer under way. Segmented upload: `data` remains to be sent. Download: `data` came so far."""

    index: int
    sub: int
    upload: bool
    data: bytes
    announced: int | None = None  # length that the client promised
    limit: int = 0  # the longest that the object takes
    toggle: int = 0
    block: BlockDownload | BlockUpload | None = None


class SdoServer(Timed):
    """Answers requests on 0x600 + node-ID with 0x580 + node-ID."""

    def __init__(self, bus: Bus, od: ObjectDictionary, nmt: NmtSlave) -> None:
        super().__init__(bus)
        self.od, self.nmt = od, nmt
        self._transfer: Transfer | None = None

    @property
    def request_id(self) -> int:
        """The identifier to listen to."""
        return SDO_REQUEST + self.nmt.node_id

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
        transfer = self._transfer
        try:
            if transfer is not None and transfer.block is not None and data[0] != ABORT_COMMAND:
                self._continue_block(transfer.block, data)
            else:
                self._serve(data)
        except SdoAbortError as error:
            self._abort(error.code)

    def _serve(self, data: bytes) -> None:
        specifier = data[0] >> 5
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
        elif specifier == BLOCK_DOWNLOAD and not data[0] & 0x01:
            self._initiate_block_download(data)
        elif specifier == BLOCK_UPLOAD and not data[0] & 0x03:
            self._initiate_block_upload(data)
        else:
            self._begin(data)
            raise SdoAbortError(Abort.INVALID_COMMAND)

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
        self.bus.send(SDO_RESPONSE + self.nmt.node_id, struct.pack("<BHB4s", command, index, sub, data))

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
            transfer.limit = longest_of(entry)
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
        self.bus.send(SDO_RESPONSE + self.nmt.node_id, bytes([0x20 | data[0] & 0x10]) + bytes(7))

    def _initiate_upload(self, data: bytes) -> None:
        transfer = self._begin(data)
        self._begin_upload(transfer, self.od.upload(transfer.index, transfer.sub))

    def _begin_upload(self, transfer: Transfer, content: bytes) -> None:
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
            SDO_RESPONSE + self.nmt.node_id,
            bytes([toggle << 4 | (SEGMENT - len(part)) << 1 | last]) + part.ljust(SEGMENT, b"\x00"),
        )

    # block transfer

    def _initiate_block_download(self, data: bytes) -> None:
        transfer = self._begin(data)
        index, sub = transfer.index, transfer.sub
        announced = _SIZE.unpack_from(data, 4)[0] if data[0] & _SIZE_GIVEN else None
        entry = self.od.check_download(index, sub, announced)
        transfer.block = BlockDownload(
            bool(data[0] & WITH_CRC),
            announced,
            longest_of(entry),
            lambda content: self.od.download(index, sub, content),
        )
        self.deadline_ns = self.bus.now_ns + TIMEOUT_NS
        self._answer(0xA0 | WITH_CRC, index, sub, bytes([LONGEST_BLOCK]))

    def _initiate_block_upload(self, data: bytes) -> None:
        transfer = self._begin(data)
        block, switch_below = data[4], data[5]
        content = self.od.upload(transfer.index, transfer.sub)
        checked_block(block)
        if len(content) <= switch_below:  # the client prefers segments for so few bytes
            transfer.upload = True
            self._begin_upload(transfer, content)
            return
        transfer.block = BlockUpload(content, block, bool(data[0] & WITH_CRC))
        self.deadline_ns = self.bus.now_ns + TIMEOUT_NS
        self._answer(0xC2 | WITH_CRC, transfer.index, transfer.sub, _SIZE.pack(len(content)))

    def _continue_block(self, block: BlockDownload | BlockUpload, data: bytes) -> None:
        self.deadline_ns = self.bus.now_ns + TIMEOUT_NS
        for answer in block.receive(data):
            self.bus.send(SDO_RESPONSE + self.nmt.node_id, answer)
        if block.done:
            self._finish()

"""LSS master (CiA 305): finds nodes without an id by fastscan, and assigns one.

Fastscan determines the address of a node (0x1018: vendor, product, revision, serial number) bit by bit; matching nodes
answer. A node that was found leaves the scan, so that the next one is found by the next scan. `ask` sends a request and
returns the answers to it.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

from ...can import frame as can
from ...can.bpf import CanFilter
from ...can.frame import pack_frame, unpack_frame
from ...can.link import LinkError, open_link
from ..port import BusUnavailableError, DriveRefusedError

REQUEST_ID, ANSWER_ID = 0x7E5, 0x7E4
SWITCH_GLOBAL, CONFIGURE_NODE_ID, STORE, SELECT, SELECTED = 0x04, 0x11, 0x17, 0x40, 0x44
IDENTIFIED, FASTSCAN = 0x4F, 0x51
WAITING = 0
ANYBODY = 0x80  # fastscan: is there a node without an id?
ADDRESS_BITS = 32
PATIENCE_S = (0.05, 0.2)  # waiting time for an answer; a scan without a complete address is repeated with the next one
QUIET_S = 0.005  # after an answer, for equal answers of other nodes
MOST_NODES = 16

Ask = Callable[[bytes, float], list[bytes]]  # request, waiting time (s) -> answers


class LssAddress(NamedTuple):
    """0x1018 of a node: unique."""

    vendor_id: int
    product_code: int
    revision: int
    serial_number: int

    @property
    def text(self) -> str:
        """For messages."""
        return (
            f"vendor 0x{self.vendor_id:08X}, product 0x{self.product_code:08X}, revision 0x{self.revision:08X}, "
            f"serial {self.serial_number}"
        )


class LssMaster:
    """Requests to the nodes of a bus."""

    def __init__(self, ask: Ask, progress: Callable[[float], None] = lambda share: None) -> None:
        self._ask, self._progress = ask, progress

    def nodes_without_id(self) -> list[LssAddress]:
        """All nodes without an id; they keep it that way. Raises DriveRefusedError for answers that form no address."""
        found: list[LssAddress] = []
        try:
            while len(found) < MOST_NODES and (address := self._scan()) is not None:
                found.append(address)
        finally:
            self._send(SWITCH_GLOBAL, WAITING)  # nodes that were found no longer answer the scan
        return found

    def assign(self, address: LssAddress, node_id: int) -> bool:
        """Give a node an id, which it uses from the next boot. True when the node has stored it. Raises
        DriveRefusedError.
        """
        if node_id not in can.NODE_IDS:
            raise DriveRefusedError(f"node id {node_id}: 1 to 127")
        try:
            for part, number in enumerate(address):
                wait_s = PATIENCE_S[-1] if part == len(address) - 1 else 0.0
                answers = self._ask(struct.pack("<BI3x", SELECT + part, number), wait_s)
            if not any(answer[0] == SELECTED for answer in answers):
                raise DriveRefusedError(f"the node with {address.text} does not answer LSS any more")
            error = self._configure(CONFIGURE_NODE_ID, node_id)
            if error:
                said = "does not answer" if error < 0 else f"refuses (error {error})"
                raise DriveRefusedError(f"the node with {address.text} {said} when given the node id {node_id} (LSS)")
            return self._configure(STORE) == 0
        finally:
            self._send(SWITCH_GLOBAL, WAITING)  # this activates the id

    def _configure(self, command: int, value: int = 0) -> int:
        """The error byte of the answer, 0 for no error; -1 for silence."""
        answers = self._ask(struct.pack("<BB6x", command, value), PATIENCE_S[-1])
        return next((answer[1] for answer in answers if answer[0] == command), -1)

    def _send(self, command: int, value: int) -> None:
        self._ask(struct.pack("<BB6x", command, value), 0.0)

    def _fits(self, number: int, bit: int, part: int, following: int, patience_s: float) -> bool:
        request = struct.pack("<BIBBB", FASTSCAN, number, bit, part, following)
        return any(answer[0] == IDENTIFIED for answer in self._ask(request, patience_s))

    def _scan(self) -> LssAddress | None:
        for patience_s in PATIENCE_S:
            if not self._fits(0, ANYBODY, 0, 0, PATIENCE_S[-1]):
                return None
            parts = list(self._parts(patience_s))
            if len(parts) == len(LssAddress._fields):
                return LssAddress(*parts)
        raise DriveRefusedError(
            "a node without an id answers LSS fastscan, but not to an address: it lacks a part of 0x1018, or two nodes "
            "have the same one; connect one at a time"
        )

    def _parts(self, patience_s: float) -> Iterator[int]:
        """The parts of the address; ends early where the node does not confirm one."""
        count = len(LssAddress._fields)
        for part in range(count):
            number = 0
            for bit in range(ADDRESS_BITS - 1, -1, -1):
                if not self._fits(number, bit, part, part, patience_s):
                    number |= 1 << bit
                self._progress((part * ADDRESS_BITS + ADDRESS_BITS - bit) / (count * ADDRESS_BITS))
            if not self._fits(number, 0, part, (part + 1) % count, PATIENCE_S[-1]):
                return
            yield number


class LssLink:
    """The link of an LSS master on a bus, with the `ask` that `LssMaster` needs."""

    def __init__(self, bus: str) -> None:
        """Raises LinkError."""
        self._link = open_link(bus, filters=[CanFilter(ANSWER_ID)])

    def ask(self, request: bytes, patience_s: float) -> list[bytes]:
        """Send and collect. Raises BusUnavailableError."""
        try:
            while self._link.receive(0.0) is not None:  # late answers belong to an earlier request
                pass
            self._link.send(pack_frame(REQUEST_ID, request))
            answers: list[bytes] = []
            end_s = time.monotonic() + patience_s
            while (left_s := end_s - time.monotonic()) > 0.0:
                raw = self._link.receive(left_s)
                if raw is None:
                    break
                frame = unpack_frame(raw)
                if frame.can_id == ANSWER_ID and len(frame.data) == can.MAX_DATA:
                    answers.append(frame.data)
                    end_s = min(end_s, time.monotonic() + QUIET_S)
            return answers
        except LinkError as error:
            raise BusUnavailableError(str(error)) from error

    def close(self) -> None:
        """Close the link."""
        self._link.close()

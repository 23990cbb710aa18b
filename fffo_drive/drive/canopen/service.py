"""Ordinary CANopen traffic with one node: SDO through `canopen`, NMT commands, boot-up, heartbeat and EMCY.

It has its own link, on which the kernel filters out the cyclic frames. While the loop runs, its frames go through the
loop's queue, so that they reach the bus only in the slot after the command.

`canopen`'s SDO client is used alone, without its network: one transfer at a time under a lock, whole
transfers repeated after a timeout, frames checked before the client sees them (it takes extended ones for its
own), and both directions counted, because two nodes with one id answer one request twice.
"""

from __future__ import annotations

import contextlib
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from ...can import frame as can
from ...can.bpf import CanFilter
from ...can.frame import Frame, pack_frame, unpack_frame
from ...can.link import Link, LinkError
from ..port import BusUnavailableError, DriveRefusedError
from .object_lengths import SDO_ABORT, SDO_DOWNLOADED, LengthOf, standard_length
from .object_map import MappedObject, object_name
from .service_queue import ServiceQueue

NMT_START, NMT_PRE_OPERATIONAL, NMT_RESET_COMMUNICATION = 0x01, 0x80, 0x82
STATE_BOOT_UP, STATE_STOPPED, STATE_OPERATIONAL, STATE_PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F
READ_ONLY = 0x06010002  # abort code: the object cannot be written
ABSENT = (0x06020000, 0x06090011)  # abort codes: no such object, no such sub-index
KEPT_EMERGENCIES = 64
KEPT_ANSWERS = 128  # answers that nobody waits for; the client drops them before its next request
RECEIVE_SLICE_S = 0.05

T = TypeVar("T")


class SdoRefusedError(DriveRefusedError):
    """The drive refused an access. `code` is its abort code (CiA 301 7.2.4.3.17)."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code

    @property
    def absent(self) -> bool:
        """True when the drive does not have the object."""
        return self.code in ABSENT


class SdoAnswerError(DriveRefusedError):
    """The node answers, but not what was asked."""


class Emergency(NamedTuple):
    """One EMCY message."""

    monotonic_ns: int
    code: int
    error_register: int
    vendor: bytes  # up to five bytes


class Kept(NamedTuple):
    """What an object of the drive was told, and has to be for as long as the drive is in use."""

    value: int
    size: int  # bytes
    mask: int  # of the bits that count
    purpose: str  # completes "needed for ..."

    def is_still(self, read: int) -> bool:
        """Whether a value that was read is the one that was told."""
        return (read ^ self.value) & self.mask == 0


QUIET_TRIES = 20  # unanswered requests before an error
REQUESTS_THAT_COUNT = 2  # requests answered twice before two nodes are reported to have one id
READ_DEVICE_TYPE = bytes([0x40, 0x00, 0x10, 0, 0, 0, 0, 0])  # SDO upload of 0x1000:00 (CiA 301 7.2.4.3.5)


def expedited_download(node_id: int, item: MappedObject, value: int) -> bytes:
    """The frame that writes an object of 1 to 4 bytes by SDO (CiA 301 7.2.4.3.3)."""
    size = item.bits // 8
    command = 0x23 | (4 - size) << 2
    data = struct.pack("<BHB", command, item.index, item.sub) + value.to_bytes(size, "little").ljust(4, b"\0")
    return pack_frame(can.SDO_REQUEST + node_id, data)


def shown_value(value: int, size: int) -> str:
    """For instance 150 (0x0096)."""
    return f"{value} (0x{value & ((1 << 8 * size) - 1):0{2 * size}X})"


def service_filters(node_id: int) -> list[CanFilter]:
    """Filters of the service link: the node's SDO answers and EMCY, and frames of others on the bus."""
    heartbeats = CanFilter(can.HEARTBEAT, can.STANDARD_MASK & ~0x7F)
    return [CanFilter(can.SDO_RESPONSE + node_id), CanFilter(can.EMERGENCY + node_id), heartbeats]


class Service:
    """Service traffic with one node; a thread reads the link until `close`."""

    def __init__(
        self, link: Link, node_id: int, queue: ServiceQueue, answer_timeout_s: float, attempts: int,
        length_of: LengthOf = standard_length, loop_writes: frozenset[tuple[int, int]] = frozenset(),
    ) -> None:  # fmt: skip
        """`length_of`: of objects whose size an answer does not state. `loop_writes`: index and sub-index of objects
        that the loop writes too, without waiting for the answers.
        """
        self.link, self.node_id, self.queue = link, node_id, queue
        self.boot_ups = 0  # messages since the last `forget`
        self.nmt_state = -1
        self.others: set[int] = set()  # node ids of other heartbeats and boot-ups
        self.emergencies: deque[Emergency] = deque(maxlen=KEPT_EMERGENCIES)
        self.failure: LinkError | None = None  # of the last attempt to receive
        self.has_written = False  # to an object of the node
        self.kept: dict[tuple[int, int], Kept] = {}  # index and sub-index -> what was written and read back
        self._attempts = attempts
        self._loop_writes = loop_writes
        self._asked: tuple[int, int] | None = None  # the object of the transfer under way
        self._requests = 0
        self._responses = 0
        self._transfer = threading.RLock()
        self._changed = threading.Condition()
        self._closing = threading.Event()
        self._direct = False
        from .sdo_client import NO_OBJECTS, QuietSdoClient

        client_type: Any = QuietSdoClient
        self._client = client_type(can.SDO_REQUEST + node_id, can.SDO_RESPONSE + node_id, NO_OBJECTS)
        self._client.network = self
        self._client.RESPONSE_TIMEOUT = answer_timeout_s
        self._client.length_of = length_of
        self._thread = threading.Thread(target=self._read, name=f"canopen-{node_id}", daemon=True)
        self._thread.start()

    # --- sending ---

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a frame: at once, or through the loop's queue while it runs. Raises BusUnavailableError."""
        frame = pack_frame(can_id, bytes(data), remote=remote)
        if can_id == can.SDO_REQUEST + self.node_id and data[0] != SDO_ABORT:
            self._requests += 1
        if not self._direct and self.queue.loop_runs:
            if not self.queue.put(frame):
                raise BusUnavailableError(f"{self.link.spec}: the loop does not let service frames out")
            return
        self.queue.count_aside(1)
        try:
            self.link.send(frame)
        except LinkError as error:
            self.queue.count_aside(-1)
            raise BusUnavailableError(str(error)) from error

    def command_nmt(self, command: int) -> None:
        """Send an NMT command to the node."""
        self.send_message(can.NMT, bytes([command, self.node_id]))

    def send_directly(self) -> None:
        """Bypass the queue from now on: the loop has ended."""
        self._direct = True

    # --- SDO ---

    def read(self, index: int, sub: int, attempts: int | None = None) -> bytes:
        """Upload an object; `attempts`: another number of them than otherwise.

        Raises SdoRefusedError, SdoAnswerError (of another request), DriveRefusedError (two nodes),
        BusUnavailableError (no answer).
        """
        return bytes(self._transact(index, sub, "read", lambda: self._client.upload(index, sub), attempts))

    def write(self, index: int, sub: int, data: bytes) -> None:
        """Download an object. Raises as `read`."""
        self.has_written = True
        value = f"write {data.hex(' ')} to"
        self._transact(index, sub, value, lambda: self._client.download(index, sub, data))

    def read_int(self, index: int, sub: int) -> int:
        """An object as an unsigned number, of whatever size the drive sends."""
        return int.from_bytes(self.read(index, sub), "little")

    def read_optional_int(self, index: int, sub: int) -> int | None:
        """As `read_int`; None when the drive does not have the object."""
        try:
            return self.read_int(index, sub)
        except SdoRefusedError as refusal:
            if refusal.absent:
                return None
            raise

    def _transact(self, index: int, sub: int, what: str, transfer: Callable[[], T], attempts: int | None = None) -> T:
        from canopen import SdoAbortedError, SdoCommunicationError

        from .sdo_client import WrongAnswerError

        name = object_name(index, sub)
        attempts = attempts or self._attempts
        with self._transfer:
            self._asked = index, sub
            wrong = ""  # answers to the last attempt
            for _ in range(attempts):
                try:
                    result = transfer()
                except SdoAbortedError as abort:
                    self.check_one_node()
                    text = SdoAbortedError.CODES.get(abort.code, "unknown reason")
                    raise SdoRefusedError(
                        f"node {self.node_id}: cannot {what} {name}: {text} (abort 0x{abort.code:08X})",
                        abort.code,
                    ) from abort
                except SdoCommunicationError as error:
                    wrong = str(error) if isinstance(error, WrongAnswerError) else ""
                    self.check_one_node()
                    continue
                self.check_one_node()
                return result
        if wrong:
            raise SdoAnswerError(
                f"{self.link.spec}: node {self.node_id} answers wrongly when asked to {what} {name} "
                f"({attempts} times): {wrong}"
            )
        raise BusUnavailableError(
            f"{self.link.spec}: node {self.node_id} does not answer when asked to {what} {name} "
            f"({attempts} times, {self._client.RESPONSE_TIMEOUT} s each); "
            "is it powered, wired and terminated, and are bit rate and node id right? "
            f"Heard of: {', '.join(f'node {other}' for other in sorted(self.others)) or 'no other node'}"
        )

    def check_one_node(self) -> None:
        """Raise DriveRefusedError when there were more SDO answers than requests, and two more requests show why."""
        if self._responses <= self._requests + self.queue.loop_requests:
            return
        # a late answer comes once, a second node answers every request
        if all(self._answers_to_one_request() > 1 for _ in range(REQUESTS_THAT_COUNT)):
            raise DriveRefusedError(
                f"{self.link.spec}: more than one SDO answer to one request: two nodes have the id {self.node_id}; "
                "give one of them another"
            )

    def _answers_to_one_request(self) -> int:
        """Ask once after a silence and count the answers: a slow node may still answer requests of a former
        connection.
        """
        with self._transfer:
            for _ in range(QUIET_TRIES):
                if not self._answers_beyond(self._responses):
                    break
            self._requests, self._responses = -self.queue.loop_requests, 0
            self.send_message(can.SDO_REQUEST + self.node_id, READ_DEVICE_TYPE)
            self._answers_beyond(1)
            while not self._client.responses.empty():
                self._client.responses.get_nowait()
            of_loop = self._requests + self.queue.loop_requests - 1  # requests that it made meanwhile
            return self._responses - of_loop

    def _answers_beyond(self, known: int) -> bool:
        """Wait for more SDO answers than so many, for as long as an answer may take."""
        return self.wait_until(lambda: self._responses > known, self._client.RESPONSE_TIMEOUT)

    # --- receiving ---

    def forget(self) -> None:
        """Restart the count of boot-up messages; the NMT state is unknown."""
        with self._changed:
            self.boot_ups = 0
            self.nmt_state = -1

    def wait_until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition that a received frame changes. True when it holds."""
        with self._changed:
            return self._changed.wait_for(condition, timeout_s)

    def _read(self) -> None:
        while not self._closing.is_set():
            try:
                raw = self.link.receive(RECEIVE_SLICE_S)
                self.failure = None
            except LinkError as error:
                self.failure = error
                self._closing.wait(RECEIVE_SLICE_S)
                continue
            if raw is not None:
                self._take(unpack_frame(raw))

    def _take(self, frame: Frame) -> None:
        if frame.extended or frame.remote or frame.error:
            return
        kind, data = frame.can_id - self.node_id, frame.data
        with self._changed:
            if kind == can.SDO_RESPONSE and len(data) == can.MAX_DATA:
                self._responses += 1
                if not self._is_of_loop(data) and self._client.responses.qsize() < KEPT_ANSWERS:
                    self._client.on_response(frame.can_id, data, 0.0)
            elif kind == can.HEARTBEAT and len(data) == 1:
                self.nmt_state = data[0] & 0x7F
                self.boot_ups += self.nmt_state == STATE_BOOT_UP
            elif frame.can_id & ~0x7F == can.HEARTBEAT:
                self.others.add(frame.can_id & 0x7F)
            elif kind == can.EMERGENCY and len(data) >= 3:
                code = int.from_bytes(data[:2], "little")
                self.emergencies.append(Emergency(time.monotonic_ns(), code, data[2], data[3:]))
            self._changed.notify_all()

    def _is_of_loop(self, data: bytes) -> bool:
        """Whether an answer (to a download, or an abort) is to a request of the loop's own, which nobody waits for."""
        multiplexer = int.from_bytes(data[1:3], "little"), data[3]
        answers = data[0] in (SDO_DOWNLOADED, SDO_ABORT)
        return answers and multiplexer in self._loop_writes and multiplexer != self._asked

    def close(self) -> None:
        """Stop reading and close the link; never raises."""
        self._closing.set()
        self._thread.join(1.0)
        with contextlib.suppress(OSError):
            self.link.close()

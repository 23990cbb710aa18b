"""Scan of a bus: its nodes and their names.

Each node id is asked once for its device type (0x1000, mandatory in CiA 301); heartbeats and boot-ups received
meanwhile reveal nodes that do not answer SDO (STOPPED). Nothing is reset and nothing is written. A node without an id
answers LSS alone (`lss`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from ...can import frame as can
from ...can.frame import Frame, pack_frame, unpack_frame
from ...can.link import Link, LinkError
from ..port import BusUnavailableError, DriveError
from .bring_up import read_identity, read_text
from .listening import NODE_ID_MASK, STATE_NAMES
from .needs import DRIVE_PROFILE
from .service import READ_DEVICE_TYPE, Emergency, Service
from .service_queue import ServiceQueue

UPLOAD_ANSWER, ABORT = 2, 4  # command specifiers of a server
PACE_S = 0.002  # between two requests: a CAN controller's queue holds ten frames or so
ANSWER_S = 0.3  # after the last request
NAME_TIMEOUT_S = 0.3
NAME_ATTEMPTS = 2
# 0x1018:01, as assigned by CiA: vendors whose public EDS or header shows the number
VENDORS = {
    0x0000009A: "Elmo", 0x000000AB: "Copley", 0x000000FB: "maxon", 0x000001A3: "Technosoft", 0x0000026C: "Nanotec",
    0x00000469: "Roboteq",
}  # fmt: skip


@dataclass
class Sign:
    """Information on one node."""

    node_id: int
    answers: int = 0  # to one request
    device_type: int | None = None  # 0x1000
    nmt_state: int | None = None  # of the last heartbeat or boot-up
    emergencies: list[Emergency] = field(default_factory=list)

    @property
    def is_drive(self) -> bool:
        """0x1000 names CiA 402 in its low word."""
        return self.device_type is not None and self.device_type & 0xFFFF == DRIVE_PROFILE

    @property
    def state_name(self) -> str:
        """The NMT state; empty where no heartbeat reported one."""
        return "" if self.nmt_state is None else STATE_NAMES.get(self.nmt_state, f"0x{self.nmt_state:02X}")


class Roll:
    """The nodes of a bus, from the frames that they sent."""

    def __init__(self, heard: Iterable[int] = ()) -> None:
        """`heard`: ids whose heartbeat was heard before."""
        self._signs: dict[int, Sign] = {node_id: Sign(node_id) for node_id in heard if node_id in can.NODE_IDS}

    def take(self, frame: Frame) -> None:
        """Take one frame of the bus; frames come in order."""
        if frame.extended or frame.remote or frame.error:
            return
        node, data = frame.can_id & NODE_ID_MASK, frame.data
        if node not in can.NODE_IDS:
            return
        kind = frame.can_id & ~NODE_ID_MASK
        if kind == can.HEARTBEAT and len(data) == 1:
            self._of(node).nmt_state = data[0] & 0x7F
        elif kind == can.SDO_RESPONSE and len(data) == can.MAX_DATA and data[1:4] == READ_DEVICE_TYPE[1:4]:
            self._take_answer(self._of(node), data)
        elif kind == can.EMERGENCY and len(data) >= 3:
            code = int.from_bytes(data[:2], "little")
            self._of(node).emergencies.append(Emergency(0, code, data[2], data[3:]))

    def _of(self, node_id: int) -> Sign:
        return self._signs.setdefault(node_id, Sign(node_id))

    @staticmethod
    def _take_answer(sign: Sign, data: bytes) -> None:
        if data[0] >> 5 in (UPLOAD_ANSWER, ABORT):
            sign.answers += 1
        if data[0] >> 5 == UPLOAD_ANSWER and data[0] & 2:  # expedited
            size = 4 - (data[0] >> 2 & 3) if data[0] & 1 else 4
            sign.device_type = int.from_bytes(data[4 : 4 + size], "little")

    @property
    def signs(self) -> list[Sign]:
        """By node id."""
        return [self._signs[node_id] for node_id in sorted(self._signs)]


def ask_every_node(
    link: Link,
    roll: Roll,
    node_ids: Iterable[int] = can.NODE_IDS,
    progress: Callable[[int], None] = lambda node_id: None,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Ask each id for 0x1000 and take what comes. `progress` gets each id asked. Raises BusUnavailableError."""
    try:
        for node_id in node_ids:
            link.send(pack_frame(can.SDO_REQUEST + node_id, READ_DEVICE_TYPE))
            progress(node_id)
            _listen(link, roll, PACE_S, clock)
        _listen(link, roll, ANSWER_S, clock)
    except LinkError as error:
        raise BusUnavailableError(str(error)) from error


def _listen(link: Link, roll: Roll, duration_s: float, clock: Callable[[], float]) -> None:
    end_s = clock() + duration_s
    while (left_s := end_s - clock()) > 0.0:
        raw = link.receive(left_s)
        if raw is not None:
            roll.take(unpack_frame(raw))


class NodeName(NamedTuple):
    """Names of a node; empty or 0 if it has none."""

    node_id: int
    device_type: int | None
    nmt_state: str
    device_name: str = ""  # 0x1008
    hardware_version: str = ""  # 0x1009
    software_version: str = ""  # 0x100A
    vendor_id: int = 0  # 0x1018
    product_code: int = 0
    revision: int = 0
    serial_number: int = 0
    remark: str = ""  # why it cannot be used

    @property
    def is_drive(self) -> bool:
        """0x1000 names CiA 402."""
        return self.device_type is not None and self.device_type & 0xFFFF == DRIVE_PROFILE

    @property
    def vendor(self) -> str:
        """By name where the number is known."""
        return VENDORS.get(self.vendor_id, f"vendor 0x{self.vendor_id:08X}" if self.vendor_id else "no vendor id")

    @property
    def text(self) -> str:
        """One line."""
        kind = "CiA 402 drive" if self.is_drive else self._other_kind()
        parts = [f"node {self.node_id}: {self.device_name or 'without a name'}, {kind}, {self.vendor}"]
        parts += [f"serial {self.serial_number}"] * bool(self.serial_number)
        parts += [f"hardware {self.hardware_version}"] * bool(self.hardware_version)
        parts += [f"software {self.software_version}"] * bool(self.software_version)
        parts += [self.nmt_state] * bool(self.nmt_state)
        return ", ".join(parts) + (f": {self.remark}" if self.remark else "")

    def _other_kind(self) -> str:
        if self.device_type is None:
            return "type unknown"
        return f"device profile {self.device_type & 0xFFFF}" if self.device_type & 0xFFFF else "no device profile"


def name_node(sign: Sign, open_service_link: Callable[[int], Link]) -> NodeName:
    """Ask a node for its names. `open_service_link` opens a link for a node id. Raises BusUnavailableError."""
    if sign.answers == 0:
        return NodeName(
            sign.node_id, None, sign.state_name,
            remark="heard, but answers no SDO request" + "; it is stopped" * (sign.state_name == "stopped"),
        )  # fmt: skip
    if sign.answers > 1:
        remark = f"{sign.answers} answers to one request: two nodes have this id"
        return NodeName(sign.node_id, sign.device_type, sign.state_name, remark=remark)
    service = open_service(open_service_link(sign.node_id), sign.node_id)
    try:
        identity = read_identity(service)
        hardware = read_text(service, 0x1009)
    except BusUnavailableError:
        return NodeName(sign.node_id, sign.device_type, sign.state_name, remark="answered once, and no more")
    except DriveError as error:
        return NodeName(sign.node_id, sign.device_type, sign.state_name, remark=str(error))
    finally:
        service.close()
    return NodeName(
        sign.node_id, sign.device_type, sign.state_name, identity.device_name, hardware, identity.software_version,
        identity.vendor_id, identity.product_code, identity.revision, identity.serial_number,
    )  # fmt: skip


def open_service(link: Link, node_id: int) -> Service:
    """Service traffic with a node while no loop runs."""
    return Service(link, node_id, ServiceQueue(0), NAME_TIMEOUT_S, NAME_ATTEMPTS)

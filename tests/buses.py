"""The bus of a test that runs on the loopback bus and, where there is one, on a kernel's vcan0; and a witness on it."""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from needs import VCAN

from fffo_drive.can.frame import HEARTBEAT, unpack_frame
from fffo_drive.can.link import LinkError, StampedFrame, free_loopback_port, open_link
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.process import run_node

SOCKETCAN = f"socketcan:{VCAN}"
PATIENCE_S = 60.0  # for anything that must happen, on the slowest machine

_PCAP_HEADER = struct.Struct("<IHHiIII")
_PCAP_RECORD = struct.Struct("<IIII")
_PCAP_NANOSECONDS = 0xA1B23C4D
_LINKTYPE_CAN_SOCKETCAN = 227


def one_bus(kind: str) -> str:
    """`loopback`: one of its own; `vcan`: the one that there is."""
    return SOCKETCAN if kind == "vcan" else f"loopback:{free_loopback_port()}"


def python_can_arguments(bus: str) -> dict[str, Any]:
    """The bus for python-can, and for `canopen` that sits on it."""
    kind, _, where = bus.partition(":")
    return {"interface": "socketcan" if kind == "socketcan" else "fffo_loopback", "channel": where}


@contextmanager
def simulated_node(bus: str, config: NodeConfig) -> Iterator[None]:
    """The simulated drive in a thread of the test, from its boot-up message on."""
    stop = threading.Event()
    with open_link(bus) as link, open_link(bus) as listener:
        thread = threading.Thread(target=run_node, args=(config, link, stop), daemon=True)
        thread.start()
        try:
            while (raw := listener.receive(PATIENCE_S)) is not None:
                if unpack_frame(raw).can_id == HEARTBEAT + config.node_id:
                    break
            assert raw is not None, "no boot-up message"
            yield
        finally:
            stop.set()
            thread.join(PATIENCE_S)


class BusLog:
    """Everything on a bus, in its order, from entry to exit of the context."""

    def __init__(self, bus: str) -> None:
        self.frames: list[StampedFrame] = []
        self.lost = 0  # frames that the log missed; known at the end
        self._link = open_link(bus)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)

    def __enter__(self) -> BusLog:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(PATIENCE_S)
        self.lost = self._link.dropped_frames()
        self._link.close()

    def _listen(self) -> None:
        while True:
            ending = self._stop.is_set()
            try:
                received = self._link.receive_stamped(0.0 if ending else 0.1)
            except LinkError:  # the interface went down; it is heard again when it comes back
                continue
            if received is not None:
                self.frames.append(received)
            elif ending:  # nothing is left in the queue
                return


def write_pcap(path: Path, frames: list[StampedFrame]) -> None:
    """The frames as Wireshark reads them from a CAN interface: LINKTYPE_CAN_SOCKETCAN, nanoseconds."""
    with path.open("wb") as file:
        file.write(_PCAP_HEADER.pack(_PCAP_NANOSECONDS, 2, 4, 0, 0, 0xFFFF, _LINKTYPE_CAN_SOCKETCAN))
        for frame in frames:
            word, rest = struct.unpack("=I12s", frame.raw)
            data = struct.pack(">I", word) + rest[: 4 + rest[0]]  # the identifier is in network order there
            seconds, nanoseconds = divmod(round(frame.time_s * 1e9), 1_000_000_000)
            file.write(_PCAP_RECORD.pack(seconds, nanoseconds, len(data), len(data)) + data)


def as_text(raw: bytes) -> str:
    """A frame as candump -L writes it."""
    frame = unpack_frame(raw)
    if frame.error:
        return f"{frame.can_id | 0x20000000:08X}#{frame.data.hex().upper()}"
    name = f"{frame.can_id:08X}" if frame.extended else f"{frame.can_id:03X}"
    if frame.remote:
        return f"{name}#R{len(frame.data) or ''}"
    return f"{name}#{frame.data.hex().upper()}"

"""Garbage at the controller's receiving code: the compiled kernel, a socket, and the service thread."""

from __future__ import annotations

import math
import socket
import struct
from typing import Any, NamedTuple

import numpy as np
import pytest
from node.garbage import anything, malformed
from scripted_node import ScriptedNode

from fffo_drive.can.frame import ERROR_FLAG, EXTENDED_MASK, FRAME_SIZE, SYNC, pack_frame
from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.drive.canopen.config import CanopenDriveConfig
from fffo_drive.drive.canopen.port_memory import CanopenPort, make_port
from fffo_drive.drive.canopen.receiving import read_frame, take_frame
from fffo_drive.drive.canopen.service import (
    KEPT_ANSWERS,
    KEPT_EMERGENCIES,
    STATE_OPERATIONAL,
    STATE_STOPPED,
    Service,
    service_filters,
)
from fffo_drive.drive.canopen.service_queue import ServiceQueue
from fffo_drive.jit import njit

NODE = 5
LENGTHS = {0x185: 8, 0x285: 4, 0x385: 2}  # of its TPDOs
OWN_IDS = [*LENGTHS, 0x085, 0x705]
OF_MASTERS = [0x000, SYNC, 0x205, 0x305, 0x405, 0x505, 0x605, 0x77F]


class Ends(NamedTuple):
    """What `make_port` needs of a link."""

    rx_fd: int
    tx_fd: int


@njit
def feed(port: CanopenPort, frames: np.ndarray[Any, Any]) -> int:
    """Take every row of `frames` (n, 16) for a received frame. Returns how many."""
    for k in range(frames.shape[0]):
        for i in range(frames.shape[1]):
            port.received[i] = frames[k, i]
        take_frame(port, k, k % 2 == 0)
    return int(frames.shape[0])


def new_port(fd: int = -1) -> CanopenPort:
    config = CanopenDriveConfig(
        bus="loopback:20000", node_id=NODE, period_ns=500_000, counts_per_rev=32768, velocity_units_per_rps=32768.0,
        torque_constant_nm_per_a=0.2, rated_torque_nm=4.0,
    )  # fmt: skip
    link: Any = Ends(fd, fd)
    return make_port(config, link, ServiceQueue(10_000_000_000).memory)


def bytes_of(frames: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    return frames.view(np.uint8).reshape(-1, FRAME_SIZE)


def malformed_frames_are_counted_and_change_nothing(count: int) -> None:
    port = new_port()
    feed(port, bytes_of(np.array([pack_frame(0x185, bytes(8)), pack_frame(0x285, bytes(4))]).view(np.uint8)))
    before = port.feedback.copy()
    bad = 0
    ours: list[int] = []
    for frames in malformed(5, count, OWN_IDS):
        feed(port, bytes_of(frames))
        word = frames["word"]
        addressed = np.isin(word & EXTENDED_MASK, OWN_IDS) & (word & ERROR_FLAG == 0)
        bad += int(addressed.sum())
        ours += word[np.isin(word, OF_MASTERS)].tolist()
    assert bad > count // 3
    assert port.feedback[0]["bad_frames"] == bad
    assert ours
    before["bad_frames"], before["foreign_frames"], before["foreign_id"] = bad, len(ours), ours[0]
    assert port.feedback.tobytes() == before.tobytes()


def any_frames_leave_finite_numbers(count: int) -> None:
    port = new_port()
    expected = 0
    for frames in anything(6, count, OWN_IDS, [0]):
        feed(port, bytes_of(frames))
        word, length = frames["word"], frames["length"]
        wanted = np.array([LENGTHS.get(int(w), -1) for w in word])
        expected += int(((word == 0x185) & (length == wanted)).sum())
    feedback = port.feedback[0]
    assert expected > 0
    for name in port.feedback.dtype.names or ():
        assert math.isfinite(float(feedback[name])) or name.startswith("true_"), name
    assert abs(feedback["velocity_rps"]) <= 2**31 / 32768
    assert 0 <= feedback["statusword"] <= 0xFFFF
    assert 0 <= feedback["emergency_code"] <= 0xFFFF
    assert 0 <= feedback["nmt_state"] <= 0x7F
    # and a good frame is understood as ever
    good = pack_frame(0x185, struct.pack("<ii", -32768, 77))
    feed(port, np.frombuffer(good, np.uint8).reshape(1, FRAME_SIZE))
    assert feedback["velocity_rps"] == -1.0


def test_malformed_frames_are_counted_and_change_nothing() -> None:
    malformed_frames_are_counted_and_change_nothing(20_000)


@pytest.mark.slow
@pytest.mark.conformance("CiA 402", "a million frames of garbage: nothing crashes, hangs or enables")
def test_a_million_malformed_frames_are_counted_and_change_nothing() -> None:
    malformed_frames_are_counted_and_change_nothing(1_000_000)


def test_any_frames_leave_finite_numbers() -> None:
    any_frames_leave_finite_numbers(20_000)


@pytest.mark.slow
@pytest.mark.conformance("CiA 402", "a million frames of garbage: nothing crashes, hangs or enables")
def test_a_million_of_any_frames_leave_finite_numbers() -> None:
    any_frames_leave_finite_numbers(1_000_000)


def test_datagrams_that_are_no_frames() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, theirs:
        ours.setblocking(False)
        port = new_port(ours.fileno())
        for length in (1, 4, 15):  # longer ones do not pass the kernel's filter
            theirs.send(bytes(length))
        theirs.send(pack_frame(0x705, b"\x05"))
        assert read_frame(port) == 1
        assert read_frame(port) == 0
        assert port.feedback[0]["bad_frames"] == 3


def test_the_service_thread_survives_and_keeps_little() -> None:
    bus = f"loopback:{free_loopback_port()}"
    with ScriptedNode(bus, NODE), open_link(bus) as sender:
        link = open_link(bus, filters=service_filters(NODE))
        service = Service(link, NODE, ServiceQueue(10_000_000_000), answer_timeout_s=1.0, attempts=3)
        try:
            frames = next(iter(anything(7, 8192, [0x085, 0x585, 0x705, 0x706], [0])))
            frames["word"][frames["word"] & 0x7FF == 0x605] = 0x705  # the scripted node is not what is tested
            own_answers = bytes_of(frames[(frames["word"] == 0x585) & (frames["length"] == 8)])
            for row in bytes_of(frames[frames["word"] != 0x585]):
                sender.send(row.tobytes())
            assert service.read_int(0x1000, 0) == 0x00020192  # in between it does its work
            assert len(service.emergencies) <= KEPT_EMERGENCIES
            assert len(service.others) < 128
            for row in own_answers:
                sender.send(row.tobytes())
            # a request among them would be answered by one of them: ask when the last has been taken
            last = next(state for state in (STATE_STOPPED, STATE_OPERATIONAL) if state != service.nmt_state)
            for _ in range(100):  # a full socket buffer drops frames, the last too
                sender.send(pack_frame(0x705, bytes([last])))
                if service.wait_until(lambda: service.nmt_state == last, 0.1):
                    break
            assert service._responses > len(own_answers) // 2
            assert service._client.responses.qsize() <= KEPT_ANSWERS < len(own_answers)
            # answers to nobody's request are not a second node: one more request is answered once
            assert service.read_int(0x1000, 0) == 0x00020192
        finally:
            service.close()
        assert not service._thread.is_alive()

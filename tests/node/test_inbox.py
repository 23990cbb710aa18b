"""Waiting for frames: what may wait for the next SYNC does, and the node notices nothing of it."""

from __future__ import annotations

import random
import socket
import struct
import time
from collections.abc import Iterator

import pytest
from node.node_rig import Rig, text

from fffo_drive.can.frame import ERROR_BUS_OFF, pack_frame
from fffo_drive.canopen_node.inbox import BOXED, NOTHING, Box, Inbox, wait_for_frame

RPDO, OTHER, SYNC = pack_frame(0x201, b"\x0f\0\x05\0"), pack_frame(0x601, bytes(8)), pack_frame(0x80)


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in ends:
        end.setblocking(False)
    yield ends
    for end in ends:
        end.close()


def wait(inbox: Inbox, end: socket.socket, later_s: float = 0.0) -> int:
    return wait_for_frame(end.fileno(), inbox.memory, time.monotonic_ns() + round(later_s * 1e9))


def test_what_waits_comes_out_before_what_came_after_it_and_with_its_time(pair) -> None:
    near, far = pair
    inbox = Inbox()
    inbox.arrange((Box(0x201, 4), Box(0x301, 2)))
    second = pack_frame(0x301, b"\x06\0")
    before_ns = time.monotonic_ns()
    for frame in (second, RPDO, SYNC, OTHER):
        far.send(frame)
    result = wait(inbox, near, 60.0)
    assert result == BOXED | 16
    assert inbox.frame(16) == SYNC
    (first_ns, first), (second_ns, last) = inbox.waiting()
    assert (first, last) == (second, RPDO)
    assert before_ns <= first_ns <= second_ns <= time.monotonic_ns()
    assert inbox.waiting() == []
    assert (wait(inbox, near, 60.0), inbox.frame(16)) == (16, OTHER)


def test_the_last_of_several_is_kept(pair) -> None:
    near, far = pair
    inbox = Inbox()
    inbox.arrange((Box(0x201, 4),))
    newer = pack_frame(0x201, b"\x0f\0\x06\0")
    for frame in (RPDO, newer, SYNC):
        far.send(frame)
    assert wait(inbox, near, 60.0) == BOXED | 16
    assert [frame for _, frame in inbox.waiting()] == [newer]


@pytest.mark.parametrize(
    "frame",
    [
        pack_frame(0x201, b"\x0f\0\x05"),
        pack_frame(0x201, b"\x0f\0\x05\0\0"),
        pack_frame(0x201, b"\x0f\0\x05\0", remote=True),
        pack_frame(0x201, b"\x0f\0\x05\0", extended=True),
        pack_frame(ERROR_BUS_OFF, bytes(4), error=True),
        b"\x01\x02\0\0\x04",  # no frame at all
    ],
)
def test_all_else_is_handed_over_at_once(pair, frame: bytes) -> None:
    near, far = pair
    inbox = Inbox()
    inbox.arrange((Box(0x201, 4),))
    far.send(frame)
    assert wait(inbox, near, 60.0) == len(frame)
    assert inbox.frame(len(frame)) == frame


def test_the_deadline_ends_the_wait_with_what_there_is(pair) -> None:
    near, far = pair
    inbox = Inbox()
    inbox.arrange((Box(0x201, 4),))
    assert wait(inbox, near) == NOTHING
    far.send(RPDO)
    far.send(SYNC)
    assert wait(inbox, near, -1.0) == NOTHING | BOXED  # one frame a turn, when it is late already
    assert wait(inbox, near, -1.0) == 16
    far.send(RPDO)
    assert wait(inbox, near, 0.002) == NOTHING | BOXED


def test_a_link_that_fails_is_reported() -> None:
    assert wait_for_frame(10_000, Inbox().memory, time.monotonic_ns()) < 0


def frames(seed: int) -> list[bytes]:
    """Commands of right and wrong length, SYNC, NMT and SDO in any order."""
    pick = random.Random(seed)
    found = []
    for _ in range(200):  # as many as a socket's queue takes
        command = struct.pack("<Hh", pick.choice([0, 6, 7, 15, 15, 15, 2]), pick.randrange(-50, 50))
        kind = pick.randrange(12)
        if kind < 6:
            found.append(pack_frame(0x201, command))
        elif kind < 9:
            found.append(SYNC)
        elif kind == 9:
            found.append(pack_frame(0x201, command[: pick.randrange(5)] + bytes(pick.randrange(3))))
        elif kind == 10:
            found.append(pack_frame(0, bytes([pick.choice([1, 1, 1, 128, 2, 130]), 1])))
        else:
            found.append(pack_frame(0x601, struct.pack("<BHB4x", 0x40, pick.choice([0x6041, 0x6071, 0x2020]), 0)))
    return found


def prepared() -> Rig:
    rig = Rig()
    rig.map_cyclic()
    rig.write(0x6060, 0, 10, 1)
    rig.operational()
    return rig


@pytest.mark.parametrize("seed", range(6))
def test_a_node_behind_an_inbox_does_what_one_without_does(pair, seed: int) -> None:
    near, far = pair
    direct, behind = prepared(), prepared()
    inbox = Inbox()
    boxes: tuple[Box, ...] = ()
    answers: list[list[str]] = [[], []]
    script = frames(seed)
    for raw in script:
        answers[0] += [text(answer) for answer in direct.node.handle(raw, direct.now_ns)]
    for raw in script:
        far.send(raw)
    while True:  # as the process does it
        if behind.node.boxes is not boxes:
            boxes = behind.node.boxes
            inbox.arrange(boxes)
        result = wait(inbox, near, 0.05)
        for _, frame in inbox.waiting():
            answers[1] += [text(answer) for answer in behind.node.handle(frame, behind.now_ns)]
        if result & 0xFF:
            answers[1] += [text(answer) for answer in behind.node.handle(inbox.frame(16), behind.now_ns)]
        elif result == NOTHING:
            break
    assert answers[0] == answers[1]
    assert len(answers[0]) > 50
    statistics = direct.node.od.slots[0x2020 << 8 | 3]  # RPDOs applied
    assert direct.node.od.values == behind.node.od.values
    assert direct.node.od.values[statistics] > 10

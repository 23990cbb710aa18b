"""An SDO server that answers wrongly is told apart from one that does not answer (CiA 301 7.2.4.3)."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scripted_node import ScriptedNode

from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.drive.canopen.sdo_client import wrong_answer
from fffo_drive.drive.canopen.sdo_objects import SdoObjects
from fffo_drive.drive.canopen.service import SdoAnswerError, SdoRefusedError, Service, service_filters
from fffo_drive.drive.canopen.service_queue import ServiceQueue
from fffo_drive.drive.port import BusUnavailableError

NODE = 5
READ_STATUSWORD = bytes.fromhex("4041600000000000")
LATE = "a late answer to an earlier request, or a second master that asks this node"


class OddNode(ScriptedNode):
    """Answers in a way of its own: `twist` makes the frames that are sent of the one that a right server would send."""

    def __init__(self, bus: str, twist: Any) -> None:
        super().__init__(bus, NODE)
        self.twist = twist
        self.answers: list[bytes] = []

    def _answer(self, head: bytes, data: bytes = b"") -> None:
        self.answers.append((head + data).ljust(8, b"\0"))
        for answer in self.twist(self.answers):
            self.send(0x580 + NODE, answer)


def asked(twist: Any, action: Any, timeout_s: float = 0.05) -> Any:
    """What a service makes of such a node."""
    bus = f"loopback:{free_loopback_port()}"
    link = open_link(bus, filters=service_filters(NODE))
    service = Service(link, NODE, ServiceQueue(0), timeout_s, 2)
    try:
        with OddNode(bus, twist):
            return action(service)
    finally:
        service.close()


def other_object(answers: list[bytes]) -> list[bytes]:
    return [answers[-1][:1] + b"\x40\x60\x00" + answers[-1][4:]]


def other_command(answers: list[bytes]) -> list[bytes]:
    return [b"\x60" + answers[-1][1:]]


def wrong_toggle(answers: list[bytes]) -> list[bytes]:
    segment = not answers[-1][0] & 0xE0
    return [bytes([answers[-1][0] ^ 0x10 * segment]) + answers[-1][1:]]


def one_late(answers: list[bytes]) -> list[bytes]:
    return answers[-2:-1]


@pytest.mark.parametrize(
    ("twist", "index", "said"),
    [
        (other_object, 0x6041, f"expected the answer to 0x6041:00, got one to 0x6040:00 ({LATE})"),
        (other_command, 0x6041, f"the answer to a read (0x40 in its upper three bits), got the command 0x60 ({LATE})"),
        (wrong_toggle, 0x1008, "the toggle bit of a segment does not alternate (command 0x10 after 0x60)"),
        (one_late, 0x1008, f"a segment read (0x00 in its upper three bits), got the command 0x41 ({LATE})"),
        (lambda answers: [b"\x80\x40\x60\x00\x11\x00\x09\x06"], 0x6041, "got an abort of 0x6040:00"),
    ],
)
def test_an_answer_to_something_else_is_no_silence(twist: Any, index: int, said: str) -> None:
    with pytest.raises(SdoAnswerError) as caught:
        asked(twist, lambda service: service.read(index, 0))
    text = str(caught.value)
    assert f"node 5 answers wrongly when asked to read 0x{index:04X}:00 (2 times): " in text
    assert said in text
    assert "powered" not in text


def test_an_acknowledgement_of_another_write_is_none() -> None:
    with pytest.raises(SdoAnswerError, match=r"write 0f 00 to 0x6040:00 .*got one to 0x6060:00"):
        asked(lambda answers: [b"\x60\x60\x60\x00" + bytes(4)], lambda service: service.write(0x6040, 0, b"\x0f\0"))


def test_silence_is_silence() -> None:
    with pytest.raises(BusUnavailableError, match="node 5 does not answer when asked to read 0x6041:00"):
        asked(lambda answers: [], lambda service: service.read(0x6041, 0))


def test_a_late_answer_before_the_right_one_is_passed_over() -> None:
    def both(answers: list[bytes]) -> list[bytes]:
        return [b"\x4b\x40\x60\x00" + bytes(4), answers[-1]]

    def read_after_a_late_one(service: Service) -> int:
        service._requests += 1  # of the connection before
        return service.read_int(0x6041, 0)

    assert asked(both, read_after_a_late_one, 1.0) == 0x40


def test_an_abort_without_its_object_is_one() -> None:
    with pytest.raises(SdoRefusedError, match="0x06020000"):
        asked(lambda answers: [b"\x80\0\0\0\0\0\x02\x06"], lambda service: service.read(0x6041, 0))


def test_objects_that_are_answered_wrongly_are_listed_as_such() -> None:
    def look(service: Service) -> dict[str, str]:
        objects = SdoObjects(service.read)
        assert objects.value(0x6041) is None
        return objects.unreadable

    assert asked(other_object, look) == {"0x6041:00": "a wrong answer"}
    assert asked(lambda answers: [], look) == {"0x6041:00": "no answer"}


@given(answer=st.binary(min_size=8, max_size=8))
def test_only_an_answer_to_the_request_is_taken(answer: bytes) -> None:
    taken = not wrong_answer(READ_STATUSWORD, b"\x41\x60\0", answer)
    abort = answer[0] == 0x80 and answer[1:4] in (b"\x41\x60\0", bytes(3))
    assert taken == (abort or (answer[0] >> 5 == 2 and answer[1:4] == b"\x41\x60\0"))


@given(data=st.binary(min_size=7, max_size=7), toggle=st.booleans())
def test_a_segment_names_no_object_and_alternates(data: bytes, toggle: bool) -> None:
    request, answer = bytes([0x60 | toggle << 4]), bytes([toggle << 4]) + data
    assert wrong_answer(request.ljust(8, b"\0"), b"\x08\x10\0", answer) == ""
    assert "toggle" in wrong_answer(bytes([0x60 | (not toggle) << 4]).ljust(8, b"\0"), b"\x08\x10\0", answer)

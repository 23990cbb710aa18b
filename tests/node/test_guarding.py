"""Node guarding by remote frame, and life guarding of whoever asks."""

from __future__ import annotations

import pytest
from node.node_rig import Rig, text

from fffo_drive.can.frame import pack_frame


def ask(rig: Rig, node_id: int = 1) -> list[str]:
    """The remote frame of node guarding."""
    raw = pack_frame(0x700 + node_id, b"\0", remote=True)
    return [text(answer) for answer in rig.node.handle(raw, rig.now_ns)]


@pytest.mark.conformance("CiA 301", "node guarding and life guarding (0x100C, 0x100D)")
def test_each_answer_has_the_state_and_a_bit_that_changes() -> None:
    rig = Rig()
    assert [ask(rig) for _ in range(3)] == [["701#7F"], ["701#FF"], ["701#7F"]]
    rig.operational()
    assert ask(rig)[0] == "701#85"
    rig.send("000#0201")
    assert ask(rig) == ["701#04"]  # STOPPED answers too
    rig.send("000#8201")
    assert ask(rig) == ["701#7F"]  # the bit begins anew
    assert ask(rig, 2) == []


@pytest.mark.conformance("CiA 301", "node guarding and life guarding (0x100C, 0x100D)")
def test_a_heartbeat_takes_its_place() -> None:
    rig = Rig()
    rig.write(0x1017, 0, 100, 2)
    rig.wait(1)
    assert ask(rig) == []
    rig.write(0x1017, 0, 0, 2)
    assert ask(rig) == ["701#7F"]


@pytest.mark.conformance("CiA 301", "node guarding and life guarding (0x100C, 0x100D)")
def test_life_guarding_begins_with_the_first_question_and_its_end_is_reported_once() -> None:
    rig = Rig()
    rig.write(0x100C, 0, 50, 2)
    rig.write(0x100D, 0, 3, 1)
    assert rig.wait(1000) == []
    ask(rig)
    assert rig.wait(149) == []
    ask(rig)
    assert rig.wait(151) == ["081#3081110000000000"]
    assert rig.wait(1000) == []
    assert ask(rig) == ["701#7F", "081#0000000000000000"]
    assert rig.read(0x1001) == 0


@pytest.mark.conformance("CiA 301", "node guarding and life guarding (0x100C, 0x100D)")
def test_a_life_guarding_event_stops_the_axis_and_the_node() -> None:
    rig = Rig()
    rig.write(0x100C, 0, 50, 2)
    rig.write(0x100D, 0, 2, 1)
    rig.write(0x6007, 0, 1, 2)  # malfunction
    rig.operational()
    rig.enable()
    ask(rig)
    rig.wait(101)
    assert rig.node.nmt.state == 127  # 0x1029:1 is 0
    assert rig.read(0x603F) == 0x8130
    assert rig.state in (0x0F, 0x08)


def test_no_life_time_no_supervision_and_other_times_begin_anew() -> None:
    rig = Rig()
    rig.write(0x100C, 0, 50, 2)
    ask(rig)
    assert rig.wait(1000) == []
    rig.write(0x100D, 0, 1, 1)
    assert rig.wait(1000) == []
    ask(rig)
    assert rig.wait(51) == ["081#3081110000000000"]
    rig.write(0x100D, 0, 0, 1)
    assert rig.read(0x1001) == 0

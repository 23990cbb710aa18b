"""When a TPDO is sent: each transmission type, inhibit time, event timer, SYNC start value."""

from __future__ import annotations

import itertools

import pytest
from node.node_rig import Rig

POSITION = 0x60640020
STATUS = 0x60410010
OFF = 0xC0000381
ON = 0x40000381


def third_tpdo(transmission: int, entry: int, *, inhibit: int = 0, timer: int = 0, start: int = 0) -> Rig:
    """TPDO3 alone, operational; what entering OPERATIONAL sends is taken."""
    rig = Rig()
    for index, cob_id in ((0x1800, 0xC0000181), (0x1801, 0xC0000281)):
        assert rig.write(index, 1, cob_id, 4) == 0
    for sub, value, size in ((1, OFF, 4), (2, transmission, 1), (3, inhibit, 2), (5, timer, 2), (6, start, 1)):
        assert rig.write(0x1802, sub, value, size) == 0
    for sub, value, size in ((0, 0, 1), (1, entry, 4), (0, 1, 1)):
        assert rig.write(0x1A02, sub, value, size) == 0
    assert rig.write(0x1802, 1, ON, 4) == 0
    return rig


def count(frames: list[str]) -> int:
    return sum(frame.startswith("381#") for frame in frames)


@pytest.mark.conformance("CiA 301", "silent without SYNC; type 1: one a SYNC")
def test_one_a_sync() -> None:
    rig = third_tpdo(1, POSITION)
    rig.operational()
    assert count(rig.wait(1000)) == 0
    assert [count(rig.send("080#")) for _ in range(100)] == [1] * 100
    assert count(rig.wait(1000)) == 0


@pytest.mark.conformance("CiA 301", "types 2 to 240: every n-th SYNC")
@pytest.mark.parametrize("n", [2, 3, 10, 240])
def test_every_nth_sync(n: int) -> None:
    rig = third_tpdo(n, POSITION)
    rig.operational()
    sent = [count(rig.send("080#")) for _ in range(3 * n)]
    assert sum(sent) == 3
    places = [k for k, number in enumerate(sent) if number]
    assert [later - earlier for earlier, later in itertools.pairwise(places)] == [n, n]


@pytest.mark.conformance("CiA 301", "type 0: with a SYNC after an event only")
def test_acyclic_synchronous() -> None:
    rig = third_tpdo(0, STATUS)
    rig.operational()
    assert [count(rig.send("080#")) for _ in range(3)] == [1, 0, 0]  # the first value is an event
    assert count(rig.send("201#0600")) == 0  # the event: the statusword changes; it waits for SYNC
    assert [rig.send("080#") for _ in range(2)] == [["381#3102"], []]


@pytest.mark.conformance("CiA 301", "types 254 and 255: on an event")
def test_on_an_event_of_the_profile() -> None:
    rig = third_tpdo(255, STATUS)
    assert count(rig.send("000#0101")) == 1  # entering OPERATIONAL
    assert rig.send("201#0600") == ["381#3102"]
    assert rig.send("201#0600") == []
    assert rig.send("080#") == []
    assert rig.send("201#0700") == ["381#3302"]


@pytest.mark.conformance("CiA 301", "types 254 and 255: on an event")
def test_on_any_change_of_what_is_mapped() -> None:
    rig = third_tpdo(254, POSITION)
    rig.operational()
    assert count(rig.send("080#")) == 0
    rig.plant.angle_rev = 0.5
    assert rig.wait(10) == ["381#00400000"]  # as soon as the plant is looked at
    assert rig.wait(1000) == []


@pytest.mark.conformance("CiA 301", "inhibit time")
def test_inhibit_time_holds_back_and_sends_the_last() -> None:
    rig = third_tpdo(255, STATUS, inhibit=100)  # 10 ms
    assert count(rig.send("000#0101")) == 1
    assert rig.send("201#0600") == []
    assert rig.send("201#0700") == []
    assert rig.wait(9.9) == []
    assert rig.wait(0.2) == ["381#3302"]


@pytest.mark.conformance("CiA 301", "event timer")
def test_event_timer_repeats() -> None:
    rig = third_tpdo(255, STATUS, timer=20)
    assert count(rig.send("000#0101")) == 1
    assert count(rig.wait(100)) == 5
    assert count(rig.send("201#0600")) == 1  # the event starts the timer anew
    assert count(rig.wait(19.9)) == 0
    assert count(rig.wait(0.2)) == 1
    rig.send("000#8001")
    assert count(rig.wait(1000)) == 0


@pytest.mark.conformance("CiA 301", "SYNC start value", "counter 0x1019")
def test_the_count_begins_with_the_start_value() -> None:
    rig = third_tpdo(4, POSITION, start=3)
    assert rig.write(0x1019, 0, 8, 1) == 0
    rig.operational()
    sent = [count(rig.send(f"080#{counter:02X}")) for counter in (7, 8, 1, 2, 3, 4, 5, 6, 7, 8, 1, 2, 3)]
    assert sent == [0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1]

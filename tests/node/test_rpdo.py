"""When an RPDO acts, and what is reported of one that is wrong or stays away."""

from __future__ import annotations

import pytest
from node.node_rig import OPERATION_ENABLED, Rig


def rig_with(index: int, transmission: int, *, deadline_ms: int = 0) -> Rig:
    """Operational; RPDO 2 (0x1401: controlword, torque) or RPDO 1 (0x1400: controlword) of this type."""
    rig = Rig()
    cob_id = 0x201 + 0x100 * (index - 0x1400)
    for sub, value, size in ((1, cob_id | 0x80000000, 4), (2, transmission, 1), (5, deadline_ms, 2), (1, cob_id, 4)):
        assert rig.write(index, sub, value, size) == 0
    rig.operational()
    rig.send("080#")
    return rig


@pytest.mark.conformance("CiA 301", "types 0 to 240: buffered, acts at the next SYNC")
@pytest.mark.parametrize("transmission", [0, 1, 7, 240])
def test_synchronous(transmission: int) -> None:
    rig = rig_with(0x1401, transmission)
    rig.send("301#06003412")
    rig.wait(5)
    assert rig.read(0x6071) == 0
    rig.send("301#06007856")  # the last one before SYNC counts
    rig.send("080#")
    assert rig.read(0x6071) == 0x5678
    assert rig.state == 0x21


@pytest.mark.conformance("CiA 301", "types 254 and 255: acts at once")
@pytest.mark.parametrize("transmission", [254, 255])
def test_at_once(transmission: int) -> None:
    rig = rig_with(0x1401, transmission)
    rig.send("301#06003412")
    assert rig.read(0x6071) == 0x1234
    assert rig.state == 0x21


def test_what_waits_for_sync_is_forgotten_outside_operational() -> None:
    rig = rig_with(0x1401, 1)
    rig.send("301#06003412")
    rig.send("000#8001")
    rig.send("000#0101")
    rig.send("080#")
    assert rig.read(0x6071) == 0
    assert rig.state == 0x40


@pytest.mark.conformance("CiA 301", "window 0x1007: synchronous RPDOs outside it are discarded")
def test_synchronous_window() -> None:
    rig = rig_with(0x1401, 1)
    assert rig.write(0x1007, 0, 300, 4) == 0  # us
    for late_ms, taken in ((0.2, True), (0.31, False), (0.3, True)):
        rig.send("080#")
        rig.wait(late_ms)
        rig.send("301#06001111" if taken else "301#06002222")
        rig.wait(0.2)
        rig.send("080#")
        assert rig.read(0x6071) == 0x1111
    assert rig.read(0x2020, 4) == 1


@pytest.mark.conformance("CiA 301", "too short: EMCY 0x8210, discarded")
def test_too_short() -> None:
    rig = rig_with(0x1401, 255)
    assert rig.send("301#060034")[0] == "081#1082110200000000"
    assert rig.read(0x6071) == 0
    assert rig.state == 0x40
    assert rig.send("301#060034") == []  # reported once
    assert "081#0000000000000000" in rig.send("301#06003412")
    assert rig.read(0x6071) == 0x1234


@pytest.mark.conformance("CiA 301", "too long: EMCY 0x8220, the mapped bytes are used")
def test_too_long() -> None:
    rig = rig_with(0x1401, 255)
    assert rig.send("301#06003412FFFF")[0] == "081#2082110200000000"
    assert rig.read(0x6071) == 0x1234
    assert "081#0000000000000000" in rig.send("301#06003412")


@pytest.mark.conformance("CiA 301", "deadline (sub 5): EMCY 0x8250 after the first reception")
def test_deadline() -> None:
    rig = rig_with(0x1401, 255, deadline_ms=20)
    assert not [frame for frame in rig.wait(5000) if frame.startswith("081")]
    rig.send("301#00000000")
    assert rig.wait(19.9) == []
    assert rig.wait(0.2)[0] == "081#5082110200000000"
    assert [frame for frame in rig.wait(5000) if frame.startswith("081")] == []  # reported once
    assert "081#0000000000000000" in rig.send("301#00000000")


@pytest.mark.conformance("CiA 301", "recovery of one RPDO leaves the error of another")
def test_two_deadlines_are_two_errors() -> None:
    rig = rig_with(0x1401, 255, deadline_ms=20)
    for sub, value, size in ((1, 0x80000201, 4), (5, 20, 2), (1, 0x201, 4)):
        assert rig.write(0x1400, sub, value, size) == 0
    rig.send("201#0000")
    rig.send("301#00000000")
    emergencies = [frame for frame in rig.wait(21) if frame.startswith("081")]
    assert emergencies == ["081#5082110100000000", "081#5082110200000000"]
    assert "081#0000110000000000" in rig.send("201#0000")  # bit 4 of 0x1001 stays: RPDO 2 is still missing
    assert rig.read(0x1001) == 0x11
    assert "081#0000000000000000" in rig.send("301#00000000")


@pytest.mark.conformance("CiA 402", "no RPDO within its deadline: 0x6007")
@pytest.mark.parametrize(("option", "state"), [(0, OPERATION_ENABLED), (1, 0x08), (2, 0x40), (3, 0x40)])
def test_deadline_and_abort_connection(option: int, state: int) -> None:
    rig = rig_with(0x1401, 255, deadline_ms=20)
    assert rig.write(0x6007, 0, option, 2) == 0
    rig.enable()
    rig.send("301#0F000000")
    rig.wait(100)
    assert rig.state == state


def test_values_outside_the_limits_of_an_object_leave_it_as_it_was() -> None:
    rig = Rig()
    for index, sub, value, size in (
        (0x1400, 1, 0x80000201, 4), (0x1600, 0, 0, 1), (0x1600, 1, 0x60850020, 4), (0x1600, 0, 1, 1),
        (0x1400, 1, 0x201, 4),
    ):  # fmt: skip
        assert rig.write(index, sub, value, size) == 0
    rig.operational()
    before = rig.read(0x6085)
    rig.send("201#00000000")  # below its lower limit of 1
    assert rig.read(0x6085) == before
    rig.send("201#10000000")
    assert rig.read(0x6085) == 16

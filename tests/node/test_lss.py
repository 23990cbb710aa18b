"""LSS (CiA 305), frame by frame: the node-ID set over the bus."""

from __future__ import annotations

import struct

import pytest
from node.node_rig import Rig

from fffo_drive.drive.simulated.node.config import Identity, NodeConfig

VENDOR, PRODUCT, REVISION, SERIAL = ADDRESS = (0x11, 0x50455332, 0x00010000, 0xCAFE0042)
FASTSCAN_CONFIRM, CONFIGURE, STORE = 0x80, 0x11, 0x17


def new_rig() -> Rig:
    return Rig(NodeConfig(identity=Identity(VENDOR, PRODUCT, REVISION, SERIAL)))


def lss(rig: Rig, command: int, number: int = 0, *rest: int) -> list[str]:
    """A request with a number of four bytes and up to three more bytes."""
    return rig.send("7E5#" + (struct.pack("<BI", command, number) + bytes(rest)).ljust(8, b"\0").hex())


def to_configuration(rig: Rig) -> None:
    assert lss(rig, 0x04, 1) == []


def answer(*values: int) -> list[str]:
    return ["7E4#" + bytes(values).ljust(8, b"\0").hex().upper()]


@pytest.mark.conformance("CiA 301", "LSS: node-ID over the bus (CiA 305)")
def test_a_node_id_acts_from_the_next_communication_reset_on() -> None:
    rig = new_rig()
    assert lss(rig, 0x5E) == []  # it waits
    to_configuration(rig)
    assert lss(rig, 0x5E) == answer(0x5E, 1)
    assert lss(rig, CONFIGURE, 42) == answer(CONFIGURE, 0)
    assert rig.read(0x1000) == 0x00020192  # still node 1
    rig.write(0x1017, 0, 100, 2)
    assert rig.send("000#8201") == ["72A#00"]
    assert rig.send("601#4000100000000000") == []
    assert rig.send("62A#4000100000000000") == ["5AA#4300100092010200"]
    assert rig.send("62A#4014100000000000") == ["5AA#43141000AA000000"]  # COB-ID EMCY
    assert rig.send("62A#4000120100000000") == ["5AA#430012012A060000"]  # 0x1200
    assert rig.send("62A#4000120200000000") == ["5AA#43001202AA050000"]
    assert rig.send("000#0101") == []
    assert rig.send("000#012A") == ["1AA#5002"]  # TPDO1
    assert rig.send("000#812A") == ["701#00"]  # it was not stored


@pytest.mark.conformance("CiA 301", "LSS: node-ID over the bus (CiA 305)")
def test_a_stored_node_id_outlives_a_reset_of_the_node() -> None:
    rig = new_rig()
    to_configuration(rig)
    lss(rig, CONFIGURE, 5)
    assert lss(rig, STORE) == answer(STORE, 0)
    assert rig.send("000#8101") == ["705#00"]
    assert lss(rig, 0x5E) == []  # and waits again


@pytest.mark.parametrize("node_id", [0, 128, 200, 254])
def test_other_numbers_and_bit_timings_are_refused(node_id: int) -> None:
    rig = new_rig()
    to_configuration(rig)
    assert lss(rig, CONFIGURE, node_id) == answer(CONFIGURE, 1)
    assert lss(rig, 0x13, 0x0200) == answer(0x13, 1)
    assert rig.send("000#8201") == ["701#00"]


@pytest.mark.conformance("CiA 301", "LSS: node-ID over the bus (CiA 305)")
def test_the_drive_is_selected_and_inquired_by_its_address() -> None:
    rig = new_rig()
    for wrong in range(4):
        parts = [part + (n == wrong) for n, part in enumerate(ADDRESS)]
        assert [lss(rig, 0x40 + n, part) for n, part in enumerate(parts)] == [[]] * 4
    assert [lss(rig, 0x40 + n, part) for n, part in enumerate(ADDRESS)] == [[], [], [], answer(0x44)]
    for n, part in enumerate(ADDRESS):
        assert lss(rig, 0x5A + n) == answer(0x5A + n, *struct.pack("<I", part))
    assert lss(rig, 0x04, 0) == []
    assert lss(rig, 0x5A) == []


@pytest.mark.parametrize(
    ("low", "high", "found"), [(0, 0xFFFFFFFF, True), (SERIAL, SERIAL, True), (0, SERIAL - 1, False)]
)
def test_identification_by_a_range_of_serial_numbers(low: int, high: int, found: bool) -> None:
    rig = new_rig()
    steps = (VENDOR, PRODUCT, REVISION, REVISION, low, high)
    answers = [lss(rig, 0x46 + n, number) for n, number in enumerate(steps)]
    assert answers == [[]] * 5 + [answer(0x4F) if found else []]
    assert lss(rig, 0x4C) == []  # it has a node-ID


def fastscan(rig: Rig) -> list[int]:
    """As a master does it."""
    assert lss(rig, 0x51, 0, FASTSCAN_CONFIRM, 0, 0) == answer(0x4F)
    found = []
    for sub in range(4):
        number = 0
        for bit in range(31, -1, -1):
            if not lss(rig, 0x51, number, bit, sub, sub):
                number |= 1 << bit
        assert lss(rig, 0x51, number, 0, sub, (sub + 1) % 4) == answer(0x4F)
        found.append(number)
    return found


@pytest.mark.conformance("CiA 301", "LSS: node-ID over the bus (CiA 305)")
def test_without_a_node_id_there_is_lss_alone_and_fastscan_finds_it() -> None:
    rig = new_rig()
    rig.write(0x1017, 0, 10, 2)
    rig.write(0x1010, 1, int.from_bytes(b"save", "little"), 4)
    to_configuration(rig)
    lss(rig, CONFIGURE, 255)
    lss(rig, 0x04, 0)
    rig.wait(1)
    assert rig.send("000#8201") == []  # no boot-up
    assert rig.wait(1000) == []  # no heartbeat
    for frame in ("000#8100", "000#0100", "601#4000100000000000", "67F#4000100000000000", "080#", "6FF#40001000"):
        assert rig.send(frame) == []
    assert lss(rig, 0x4C) == answer(0x50)
    assert fastscan(rig) == list(ADDRESS)
    assert lss(rig, 0x5E) == answer(0x5E, 255)
    assert lss(rig, CONFIGURE, 9) == answer(CONFIGURE, 0)
    assert lss(rig, 0x04, 0) == ["709#00"]
    assert rig.wait(10)[0] == "709#7F"
    assert lss(rig, 0x51, 0, FASTSCAN_CONFIRM, 0, 0) == []  # it is found


def test_what_is_no_lss_request_is_ignored() -> None:
    rig = new_rig()
    for frame in ("7E5#04", "7E5#0401", "7E5#0601000000000000", "7E5#", "7E4#0401000000000000"):
        assert rig.send(frame) == []
    assert lss(rig, 0x5E) == []


def test_a_change_of_the_node_id_ends_torque() -> None:
    rig = new_rig()
    rig.operational()
    rig.enable()
    to_configuration(rig)
    lss(rig, CONFIGURE, 7)
    assert rig.state == 0x27  # nothing has changed yet
    assert "707#00" in rig.send("000#8201")
    assert rig.state != 0x27

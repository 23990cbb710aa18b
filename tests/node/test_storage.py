"""Store and restore parameters, and what resets make of the values."""

from __future__ import annotations

import pytest
from node.node_rig import Rig

SAVE, LOAD = int.from_bytes(b"save", "little"), int.from_bytes(b"load", "little")
NOT_STORED = 0x08000020


@pytest.mark.conformance("CiA 301", "store 0x1010 and restore 0x1011, with their signatures")
@pytest.mark.parametrize(("index", "signature", "other"), [(0x1010, SAVE, LOAD), (0x1011, LOAD, SAVE)])
def test_signatures(index: int, signature: int, other: int) -> None:
    rig = Rig()
    assert rig.read(index, 0) == 4
    for sub in range(1, 5):
        assert rig.read(index, sub) == 1  # on command
        for wrong in (0, 1, other, signature ^ 1, int.from_bytes(b"evas", "little")):
            assert rig.write(index, sub, wrong, 4) == NOT_STORED
        assert rig.write(index, sub, signature, 4) == 0


@pytest.mark.conformance("CiA 301", "store 0x1010 and restore 0x1011, with their signatures")
def test_saved_values_are_those_of_the_next_power_on_until_they_are_restored() -> None:
    rig = Rig()
    rig.write(0x1017, 0, 50, 2)
    rig.write(0x6085, 0, 777, 4)
    assert rig.write(0x1010, 1, SAVE, 4) == 0
    rig.write(0x1017, 0, 0, 2)
    rig.write(0x6085, 0, 1, 4)
    rig.send("000#8101")
    assert (rig.read(0x1017), rig.read(0x6085)) == (50, 777)
    assert rig.write(0x1011, 2, LOAD, 4) == 0  # the communication's only
    assert rig.read(0x1017) == 50  # at the next reset
    rig.send("000#8101")
    assert (rig.read(0x1017), rig.read(0x6085)) == (0, 777)
    assert rig.write(0x1011, 3, LOAD, 4) == 0
    rig.send("000#8101")
    assert rig.read(0x6085) not in (1, 777)


@pytest.mark.parametrize(("sub", "kept"), [(1, {0x1006, 0x2010, 0x6085}), (2, {0x1006}), (3, {0x6085}), (4, {0x2010})])
def test_groups(sub: int, kept: set[int]) -> None:
    rig = Rig()
    sizes = {0x1006: 4, 0x2010: 2, 0x6085: 4}
    for index, size in sizes.items():
        assert rig.write(index, 0, 123, size) == 0
    assert rig.write(0x1010, sub, SAVE, 4) == 0
    rig.send("000#8101")
    assert {index for index in sizes if rig.read(index) == 123} == kept


@pytest.mark.conformance("CiA 301", "a reset gives the communication objects their defaults")
def test_a_communication_reset_leaves_the_drive_alone() -> None:
    rig = Rig()
    rig.map_cyclic()
    rig.write(0x6085, 0, 777, 4)
    rig.write(0x2000, 0, 0x41424344, 4)
    rig.send("000#8201")
    assert rig.read(0x1A00, 1) == 0x60410010
    assert rig.read(0x1400, 2) == 255
    assert rig.read(0x6085) == 777
    assert rig.node.od.upload(0x2000, 0) == b"DCBA"
    rig.send("000#8101")
    assert rig.node.od.upload(0x2000, 0) == b""


def test_commands_are_no_parameters() -> None:
    rig = Rig()
    rig.enable()
    rig.write(0x6071, 0, 300, 2)
    rig.write(0x1010, 1, SAVE, 4)
    rig.send("000#8101")
    assert [rig.read(index) for index in (0x6040, 0x6071, 0x6060)] == [0, 0, 0]
    assert rig.state == 0x40

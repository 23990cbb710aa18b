"""The drive as SYNC producer: bit 30 of 0x1005."""

from __future__ import annotations

import pytest
from node.node_rig import Rig

from fffo_drive.drive.simulated.node.config import NodeConfig

INVALID_VALUE, TOO_LOW, DEVICE_STATE = 0x06090030, 0x06090032, 0x08000022
PRODUCER = 0x40000080


@pytest.mark.conformance("CiA 301", "SYNC producer (bit 30 of 0x1005)")
def test_the_sync_comes_every_0x1006_and_the_drive_follows_it() -> None:
    rig = Rig()
    rig.write(0x1006, 0, 1000, 4)
    assert rig.wait(5) == []
    assert rig.write(0x1005, 0, PRODUCER, 4) == 0
    assert rig.wait(3.5) == ["080#"] * 3  # pre-operational: no PDO
    rig.operational()
    assert rig.wait(1) == ["080#", "281#0000000000000000"]
    assert rig.read(0x2020, 1) == 4
    assert rig.write(0x1005, 0, 0x80, 4) == 0
    assert rig.wait(5) == []


@pytest.mark.conformance("CiA 301", "SYNC producer (bit 30 of 0x1005)")
def test_it_counts_where_0x1019_says_so_and_is_silent_in_stopped() -> None:
    rig = Rig()
    rig.write(0x1019, 0, 3, 1)
    rig.write(0x1006, 0, 1000, 4)
    rig.write(0x1005, 0, PRODUCER, 4)
    assert rig.wait(4) == ["080#01", "080#02", "080#03", "080#01"]
    rig.send("000#0201")
    assert rig.wait(5) == []
    rig.send("000#8001")
    assert rig.wait(2) == ["080#01", "080#02"]  # counts anew
    rig.send("000#8201")
    assert rig.wait(5) == []  # the default: no producer


def test_without_a_period_and_with_one_that_it_cannot_keep_nothing_is_sent() -> None:
    rig = Rig()
    assert rig.write(0x1005, 0, PRODUCER, 4) == 0
    assert rig.wait(100) == []
    assert rig.write(0x1006, 0, 199, 4) == TOO_LOW
    assert rig.write(0x1006, 0, 200, 4) == 0
    assert rig.wait(1) == ["080#"] * 5
    assert rig.write(0x1005, 0, PRODUCER + 1, 4) == INVALID_VALUE  # not while it produces
    assert rig.write(0x1005, 0, 0x80, 4) == 0
    assert rig.write(0x1006, 0, 100, 4) == 0
    assert rig.write(0x1005, 0, PRODUCER, 4) == DEVICE_STATE


@pytest.mark.conformance("CiA 301", "SYNC producer (bit 30 of 0x1005)")
def test_while_it_produces_its_identifier_stays_even_in_the_write_that_ends_it() -> None:
    rig = Rig()
    rig.write(0x1006, 0, 1000, 4)
    assert rig.write(0x1005, 0, PRODUCER, 4) == 0
    assert rig.write(0x1005, 0, 0x90, 4) == INVALID_VALUE
    assert rig.wait(2) == ["080#"] * 2  # nothing has changed
    assert rig.write(0x1005, 0, 0x80, 4) == 0
    assert rig.write(0x1005, 0, 0x40000090, 4) == 0  # it does not produce: both at once
    assert rig.wait(2) == ["090#"] * 2


def test_a_drive_whose_time_is_made_of_syncs_makes_its_own() -> None:
    rig = Rig(NodeConfig(step_by_sync=True))
    rig.write(0x1006, 0, 500, 4)
    rig.operational()
    rig.wait(100)
    assert rig.plant.torque_seen == []
    rig.write(0x1005, 0, PRODUCER, 4)
    rig.wait(10)
    assert len(rig.plant.torque_seen) == 20

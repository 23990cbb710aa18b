"""NMT as frames: boot-up, states and what each of them lets through."""

from __future__ import annotations

import pytest
from node.node_rig import Rig

from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.personality import Personality


@pytest.mark.conformance(
    "CiA 301", "boot-up message after power-on, reset node and reset communication, then PRE-OPERATIONAL"
)
def test_power_on_is_announced_by_boot_up_and_ends_in_pre_operational() -> None:
    rig = Rig()
    assert rig.boot == ["701#00"]
    assert rig.node.nmt.state == 127


@pytest.mark.conformance(
    "CiA 301", "boot-up message after power-on, reset node and reset communication, then PRE-OPERATIONAL"
)
def test_both_resets_boot_up_again() -> None:
    Rig().script("""
        > 000#8101      ; reset node
        < 701#00
        > 000#8201      ; reset communication
        < 701#00
        > 000#8200      ; to all nodes
        < 701#00
        > 000#8102      ; to another node
    """)


@pytest.mark.conformance(
    "CiA 301", "heartbeat producer 0x1017 changes at run time, 0 is off", "OPERATIONAL: all services"
)
def test_heartbeat_shows_each_state() -> None:
    Rig().script("""
        > 601#2B171000.0A000000
        < 581#60171000.00000000
        + 0
        < 701#7F
        > 000#0101
        < 181#5002      ; event-driven, sent on entering OPERATIONAL
        + 10
        < 701#05
        > 000#0201
        + 10
        < 701#04
        > 000#8001
        + 10
        < 701#7F
    """)


@pytest.mark.conformance("CiA 301", "a reset gives the communication objects their defaults")
def test_a_reset_restores_the_heartbeat_time_of_power_on() -> None:
    Rig().script("""
        > 601#2B171000.0A000000
        < 581#60171000.00000000
        + 5
        < 701#7F
        > 000#8201
        < 701#00
        + 1000
        > 601#40171000.00000000
        < 581#4B171000.00000000
    """)


@pytest.mark.conformance("CiA 301", "PRE-OPERATIONAL: SDO, SYNC, heartbeat and EMCY, no PDO")
def test_pre_operational_has_sdo_and_no_pdo() -> None:
    Rig().script("""
        > 201#0600
        > 080#
        + 100
        > 601#4041600000000000
        < 581#4B41600050020000
    """)


@pytest.mark.conformance("CiA 301", "STOPPED: NMT and heartbeat alone; no SDO, no PDO, no EMCY")
def test_stopped_has_neither_sdo_nor_pdo_nor_emcy() -> None:
    rig = Rig()
    rig.script("""
        > 000#0101
        < 181#5002
        > 000#0201
        > 601#4000100000000000
        > 080#
        > 201#0600
        + 100
    """)
    rig.node.emergency.raise_error(0xFF01)
    assert rig.wait(100) == []
    assert rig.send("000#8001") == ["081#01FF810000000000"]  # what happened in STOPPED follows


@pytest.mark.conformance("CiA 301", "NMT commands for others, unknown and ill-formed ones are ignored")
def test_unknown_and_ill_formed_commands_are_ignored() -> None:
    rig = Rig()
    for frame in ("000#", "000#01", "000#010100", "000#0001", "000#FF01", "000#0301", "000#0180"):
        assert rig.send(frame) == []
    assert rig.node.nmt.state == 127


@pytest.mark.conformance("CiA 301", "heartbeat producer 0x1017 changes at run time, 0 is off")
def test_heartbeat_time_changes_at_run_time_and_zero_ends_it() -> None:
    rig = Rig()
    assert rig.write(0x1017, 0, 100, 2) == 0
    assert rig.wait(350) == ["701#7F"] * 4
    assert rig.write(0x1017, 0, 10, 2) == 0
    assert rig.wait(35) == ["701#7F"] * 4
    assert rig.write(0x1017, 0, 0, 2) == 0
    assert rig.wait(5000) == []


@pytest.mark.conformance(
    "CiA 301", "PRE-OPERATIONAL: SDO, SYNC, heartbeat and EMCY, no PDO", "OPERATIONAL: all services"
)
def test_what_passes_in_the_states_with_communication() -> None:
    rig = Rig()
    rig.write(0x1017, 0, 10, 2)
    for started in (False, True):
        if started:
            rig.operational()
        before = rig.read(0x2020, 1)
        pdos = rig.send("080#")
        assert rig.read(0x2020, 1) == before + 1  # SYNC is heard
        assert any(frame.startswith("281#") for frame in pdos) is started
        rig.node.emergency.bus.now_ns = rig.now_ns
        rig.node.emergency.announce(0xFF02)
        assert "081#02FF000000000000" in rig.wait(10)


@pytest.mark.conformance("CiA 301", "NMT commands to node 0 reach every node")
@pytest.mark.parametrize("node_id", [1, 64, 127])
def test_broadcast(node_id: int) -> None:
    rig = Rig(NodeConfig(node_id=node_id))
    for command, state in ((1, 5), (2, 4), (0x80, 127), (1, 5)):
        rig.send(f"000#{command:02X}00")
        assert rig.node.nmt.state == state
    assert rig.send("000#8100")[-1] == f"{0x700 + node_id:03X}#00"
    assert rig.node.nmt.state == 127


@pytest.mark.conformance("CiA 301", "self-starting node: bit 2 of 0x1F80 (CiA 302-2)")
def test_a_node_that_starts_itself() -> None:
    rig = Rig(NodeConfig(personality=Personality(values={"0x1F80:00": 0})))
    assert rig.boot == ["701#00", "181#5002"]
    assert rig.node.nmt.state == 5
    assert Rig().node.nmt.state == 127
    assert Rig().read(0x1F80) == 4


def test_a_node_may_start_itself_without_the_object() -> None:
    assert Rig(NodeConfig(personality=Personality(starts_itself=True))).node.nmt.state == 5


@pytest.mark.conformance("CiA 301", "self-starting node: bit 2 of 0x1F80 (CiA 302-2)")
def test_self_starting_is_stored_and_acts_with_the_next_reset() -> None:
    rig = Rig()
    assert rig.write(0x1F80, 0, 5, 4) == 0x06090030  # it is no NMT master
    assert rig.write(0x1F80, 0, 0, 4) == 0
    assert rig.node.nmt.state == 127
    assert rig.write(0x1010, 2, int.from_bytes(b"save", "little"), 4) == 0
    rig.send("000#8101")
    assert rig.node.nmt.state == 5

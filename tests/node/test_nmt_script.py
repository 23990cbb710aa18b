"""NMT as frames: boot-up, states and what each of them lets through."""

from __future__ import annotations

from node.node_rig import Rig


def test_power_on_is_announced_by_boot_up_and_ends_in_pre_operational() -> None:
    rig = Rig()
    assert rig.boot == ["701#00"]
    assert rig.node.nmt.state == 127


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


def test_pre_operational_has_sdo_and_no_pdo() -> None:
    Rig().script("""
        > 201#0600
        > 080#
        + 100
        > 601#4041600000000000
        < 581#4B41600050020000
    """)


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


def test_unknown_and_ill_formed_commands_are_ignored() -> None:
    rig = Rig()
    for frame in ("000#", "000#01", "000#010100", "000#0001", "000#FF01", "000#0301", "000#0180"):
        assert rig.send(frame) == []
    assert rig.node.nmt.state == 127

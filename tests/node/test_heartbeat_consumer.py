"""Heartbeat consumer: when supervision begins, what a loss does, what ends it."""

from __future__ import annotations

import pytest
from node.node_rig import Rig

CONFIGURE = "601#2316100164007F00"  # 0x1016:1 = node 127, 100 ms
CONFIGURED = "581#6016100100000000"
INVALID_VALUE, INCOMPATIBLE = 0x06090030, 0x06040043


@pytest.mark.conformance(
    "CiA 301",
    "heartbeat consumer 0x1016 begins with the first heartbeat",
    "heartbeat consumer times out to EMCY 0x8130 and bit 4 of 0x1001",
    "once an error, and once its end (0x0000)",
)
def test_supervision_begins_with_the_first_heartbeat_and_a_loss_is_reported_once() -> None:
    rig = Rig()
    rig.script(f"""
        > {CONFIGURE}
        < {CONFIGURED}
        + 5000              ; never heard: not supervised
        > 77F#05
        + 99
        > 77F#05
        + 100
        < 081#3081117F00000000
        + 5000
        > 77F#05            ; back: the error is reset
        < 081#0000000000000000
    """)
    assert rig.read(0x1001) == 0
    assert rig.read(0x1003, 1) == 0x007F8130


@pytest.mark.conformance("CiA 301", "boot-up of a monitored node is a loss (this project's choice)")
def test_boot_up_of_a_supervised_node_is_a_loss() -> None:
    Rig().script(f"""
        > {CONFIGURE}
        < {CONFIGURED}
        > 77F#00            ; before the first heartbeat: nothing
        > 77F#7F
        > 77F#00
        < 081#3081117F00000000
    """)


@pytest.mark.parametrize(("behaviour", "state"), [(0, 127), (1, 5), (2, 4)])
@pytest.mark.conformance("CiA 301", "error behaviour 0x1029:1 decides the NMT state (0, 1, 2)")
def test_error_behaviour_0x1029_decides_the_state(behaviour: int, state: int) -> None:
    rig = Rig()
    rig.write(0x1016, 1, 127 << 16 | 100, 4)
    rig.write(0x1029, 1, behaviour, 1)
    rig.operational()
    rig.send("77F#05")
    assert "081#3081117F00000000" in rig.wait(101)
    assert rig.node.nmt.state == state


def test_pre_operational_stays_by_error_behaviour_0() -> None:
    rig = Rig()
    rig.write(0x1016, 1, 127 << 16 | 100, 4)
    rig.send("77F#05")
    rig.wait(101)
    assert rig.node.nmt.state == 127


@pytest.mark.conformance("CiA 301", "a node-ID twice in 0x1016 is refused (06040043)")
def test_entries_are_checked() -> None:
    rig = Rig()
    assert rig.write(0x1016, 1, 127 << 16 | 100, 4) == 0
    assert rig.write(0x1016, 2, 127 << 16 | 50, 4) == INCOMPATIBLE
    assert rig.write(0x1016, 2, 128 << 16 | 50, 4) == INVALID_VALUE
    assert rig.write(0x1016, 2, 127 << 16, 4) == 0  # time 0: not in use
    assert rig.write(0x1016, 1, 127 << 16 | 50, 4) == 0  # the same entry may change


def test_a_changed_entry_waits_for_a_heartbeat_again_and_ends_its_error() -> None:
    Rig().script(f"""
        > {CONFIGURE}
        < {CONFIGURED}
        > 77F#05
        + 100
        < 081#3081117F00000000
        > 601#2316100100000000  ; no longer supervised
        < 081#0000000000000000
        < 581#6016100100000000
        + 5000
    """)


def test_two_nodes_are_two_errors() -> None:
    rig = Rig()
    rig.write(0x1016, 1, 10 << 16 | 100, 4)
    rig.write(0x1016, 2, 11 << 16 | 100, 4)
    rig.send("70A#05")
    rig.send("70B#05")
    assert rig.wait(100) == ["081#3081110A00000000", "081#3081110B00000000"]
    assert rig.send("70A#05") == ["081#0000110000000000"]  # one is left: the register says so
    assert rig.send("70B#05") == ["081#0000000000000000"]

"""How long the node takes: on its own clock nothing, whatever else is asked of it; only a planned fault adds time."""

from __future__ import annotations

import pytest
from node.node_rig import Rig

SYNC_TPDO = 0x281  # TPDO2, type 1 by default: position and velocity
READ_TYPE = "601#40.00.10.00.00.00.00.00"
TYPE = "581#4300100092010200"


def operational() -> Rig:
    rig = Rig()
    rig.send("000#01.01")
    return rig


@pytest.mark.conformance("CiA 301", "boot-up message at once, after power-on and after each reset")
def test_boot_up_takes_no_time_of_its_own() -> None:
    rig = Rig()
    assert rig.boot == ["701#00"]
    for command in ("81", "82"):
        assert rig.send(f"000#{command}.01") == ["701#00"]


@pytest.mark.conformance("CiA 301", "SDO answers at once, in every state that has SDO, and between SYNCs")
@pytest.mark.parametrize("command", ["80", "01"])
def test_an_sdo_is_answered_before_anything_else_is_taken(command: str) -> None:
    rig = Rig()
    rig.send(f"000#{command}.01")
    for _ in range(200):
        rig.send("080#")
        assert rig.send(READ_TYPE) == [TYPE]
        rig.now_ns += 500_000


@pytest.mark.conformance("CiA 301", "TPDOs answer their SYNC at once, also under a load of SDO and other nodes' frames")
def test_the_turnaround_of_a_tpdo_does_not_depend_on_the_load() -> None:
    rig = operational()
    idle = rig.send("080#")
    assert [frame.partition("#")[0] for frame in idle] == [f"{SYNC_TPDO:03X}"]
    for n in range(200):
        for other in ("702#05", "182#0011223344556677", READ_TYPE):
            rig.send(other)
        answer = rig.send("080#")
        assert [frame.partition("#")[0] for frame in answer] == [f"{SYNC_TPDO:03X}"], n
        rig.now_ns += 500_000

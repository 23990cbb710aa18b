"""npm's `canopen` as a second master that is not ours: SDO (expedited, segmented, block), NMT, PDO with SYNC, EMCY."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest
from buses import one_bus, simulated_node
from needs import ROOT

from fffo_drive.drive.simulated.node.config import NodeConfig

pytestmark = [pytest.mark.realtime, pytest.mark.slow, pytest.mark.node_canopen]

MODULES = ROOT / ".venv" / "counterparts" / "node_modules"
MASTER = Path(__file__).with_name("node_master.cjs")


@pytest.fixture(scope="module")
def seen() -> dict[str, object]:
    """What it reports."""
    bus = one_bus("loopback")
    with simulated_node(bus, NodeConfig()):
        command = ["node", str(MASTER), bus.partition(":")[2]]
        environment = {**os.environ, "COUNTERPARTS_MODULES": str(MODULES)}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    result: dict[str, object] = json.loads(done.stdout)
    return result


def test_sdo_expedited_and_segmented(seen):
    assert seen["boot_up"] is True
    assert seen["device_type"] == 0x00020192
    assert seen["product_code"] == 0x50455332
    assert seen["device_name"] == "fffo-drive simulated servo drive"


def test_sdo_block_transfers_both_ways(seen):
    assert seen["device_name_by_block"] == seen["device_name"]
    assert seen["texts"] == [True] * 16


def test_sdo_aborts(seen):
    assert seen["abort_no_object"] == 0x06020000
    assert seen["abort_read_only"] == 0x06010002


def test_nmt_states_in_the_heartbeat(seen):
    assert seen["nmt"] == [5, 4, 5, 127, 5]


def test_a_synchronous_rpdo_acts_with_sync(seen):
    """Each statusword before and after the SYNC: ready to switch on, switched on, operation enabled."""
    assert seen["statuswords"] == [[0x40, 0x21], [0x21, 0x23], [0x23, 0x27]]


def test_a_fault_comes_as_emcy(seen):
    assert seen["emcy"] == [0x2310, 0x03]  # generic, current
    assert seen["fault"] == 0x08
    assert seen["error_code"] == 0x2310

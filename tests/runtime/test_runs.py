"""A run on a bus that does not end as planned: the drive's words in its result and in its recording."""

from __future__ import annotations

import json
import struct
import threading
import time

import pytest
from daemon.rig import PATIENCE_S, CommandedNode, axis_file, edit

from fffo_drive.can.frame import pack_frame
from fffo_drive.can.link import free_loopback_port
from fffo_drive.cli import main
from fffo_drive.drive.simulated.cia402_device import OPERATION_ENABLED
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.faults import Fault, FaultKind
from fffo_drive.recording.reader import read_run
from fffo_drive.runtime import runs

pytestmark = [pytest.mark.slow, pytest.mark.realtime, pytest.mark.timeout(300)]


def run(tmp_path, capsys, node_faults=(), meanwhile=None, **drive):
    """Exit code, result and events of `run` on a node; `meanwhile` gets the node once it is enabled."""
    axis = axis_file(tmp_path)
    edit(axis, lambda content: content["drive"].update(drive))
    bus, out = f"loopback:{free_loopback_port()}", tmp_path / "run.mcap"
    over = threading.Event()
    with CommandedNode(bus, NodeConfig(sync_loss_tolerance_ms=10_000, faults=node_faults)) as node:

        def watch():
            while not over.wait(0.02):
                if node.node.drive.state == OPERATION_ENABLED:
                    meanwhile(node, over)
                    return

        helper = threading.Thread(target=watch if meanwhile else over.wait)
        helper.start()
        code = main(["run", str(axis), "--bus", bus, "--uncommissioned", "--json", "--out", str(out)])
        over.set()
        helper.join(PATIENCE_S)
    return code, json.loads(capsys.readouterr().out), [(event.source, event.text) for event in read_run(out).events]


def warn_then_fail(node, over):
    node.tell(lambda its: node._send([pack_frame(0x081, struct.pack("<HB5s", 0xFF00, 0, b"\x07"))]))
    deadline_s = time.monotonic() + 0.5  # several polls of the run
    while time.monotonic() < deadline_s and not over.wait(0.02):
        pass
    node.tell(lambda its: its.faults.inject(Fault(FaultKind.OVERCURRENT)))


def test_a_fault_and_the_warning_before_it_are_reported_with_their_words(tmp_path, capsys):
    code, result, events = run(tmp_path, capsys, meanwhile=warn_then_fail, warning_codes=[0xFF00])
    assert code == 70
    assert "EMCY 0x2310 (continuous over-current at the output), error register 0x03" in result["fault"]
    assert result["fault"].count("0x2310") == 1  # not again from 0x603F and 0x1003
    assert "statusword 0x" in result["fault"]
    (warning,) = result["warnings"]
    assert warning.startswith("the drive warns: EMCY 0xFF00")
    assert ("drive", warning) in events
    assert ("drive", result["fault"]) in events
    assert result["ticks"]["warning_count"] == 1


def test_a_drive_that_is_not_enabled_says_in_which_state_it_stood(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(runs, "ENABLE_TIMEOUT_S", 0.3)
    code, result, events = run(tmp_path, capsys, node_faults=(Fault(FaultKind.NO_RPDO),))
    assert code == 70
    assert result["fault"].startswith(
        "the drive did not reach Operation Enabled in time (0x603F says no error; "
        "statusword 0x0250: switch on disabled; 0x60FD 0x00000000 (no limit switch, no interlock); DC link "
    )
    assert ("drive", result["fault"]) in events

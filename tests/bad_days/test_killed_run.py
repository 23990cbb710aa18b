"""`kill -9` of the whole controller in the middle of a run on a bus: the drive stops by itself, the file is rescued.

In real time, on processes of their own; nothing is asserted about how long anything takes.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from interpreted import TESTS

from fffo_drive.can.frame import pack_frame, unpack_frame
from fffo_drive.can.link import Link, free_loopback_port, open_link
from fffo_drive.cli import main
from fffo_drive.recording.reader import read_run
from fffo_drive.workflows.simulated_process import SimulatedProcess

FILES = TESTS / "bad_input" / "files"
NODE = 1
RPDO1, EMERGENCY, HEARTBEAT = 0x200 + NODE, 0x080 + NODE, 0x700 + NODE
STATE_MASK, OPERATION_ENABLED = 0x6F, 0x27
HEARTBEAT_LOST, COMMAND_LATE, SYNC_LOST = 0x8130, 0x8250, 0x8700
DRIVEN_TICKS = 1000
PATIENCE_S = 60.0


def patient_axis(directory: Path) -> Path:
    """The axis of the bad inputs at 500 Hz, with a drive and an envelope that forgive a shared machine its pauses."""
    shutil.copytree(FILES, directory, dirs_exist_ok=True)
    text = (FILES / "bus.yaml").read_text()
    text = text.replace("  node_id: 1\n", "  node_id: 1\n  heartbeat_timeout_ms: 3000\n  command_timeout_ms: 3000\n")
    limits = "  feedback_missing_ticks: 5000\n  accept_runaway: true\n  status_missing_ticks: 5000\n"
    limits += "  heartbeat_timeout_s: 20\n"
    text = text.replace("  following_error_s: 0.2\n", f"  following_error_s: 20\n{limits}")
    text = text.replace("{kind: paper, duration_s: 60}", "{kind: sine, duration_s: 600, amplitude: 3, frequency_hz: 1}")
    path = directory / "patient.yaml"
    path.write_text(f"{text}loop: {{rate_hz: 500}}\nrealtime: {{priority: 0, lock_memory: false, required: false}}\n")
    drive = directory / "drive.yaml"
    drive.write_text(drive.read_text().replace("sync_loss_tolerance_ms: 500", "sync_loss_tolerance_ms: 5000"))
    return path


def driven(witness: Link, controller: subprocess.Popen[bytes], ticks: int) -> int:
    """Wait until the controller has asked for so many torques. Returns how many ticks it asked for in all."""
    asked, sent = 0, 0
    while asked < ticks:
        raw = witness.receive(PATIENCE_S)
        assert raw is not None, f"the bus is silent after {sent} commands"
        assert controller.poll() is None, controller.stderr.read().decode()  # the drive's heartbeat would go on
        frame = unpack_frame(raw)
        if frame.can_id == RPDO1:
            sent += 1
            asked += struct.unpack("<Hh", frame.data)[1] != 0
    return sent


def emergency(witness: Link) -> int:
    """The next EMCY of the drive with an error."""
    while (raw := witness.receive(PATIENCE_S)) is not None:
        frame = unpack_frame(raw)
        code = int.from_bytes(frame.data[:2], "little")
        if frame.can_id == EMERGENCY and code:
            return code
    raise AssertionError("the drive did not notice that the controller is gone")


def statusword(witness: Link) -> int:
    """By SDO; the drive answers in NMT pre-operational too."""
    witness.send(pack_frame(0x600 + NODE, struct.pack("<BHB4x", 0x40, 0x6041, 0)))
    while (raw := witness.receive(PATIENCE_S)) is not None:
        frame = unpack_frame(raw)
        if frame.can_id == 0x580 + NODE:
            return int.from_bytes(frame.data[4:6], "little")
    raise AssertionError("the drive does not answer")


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.timeout(400)  # two processes may have to compile first
def test_a_killed_controller_leaves_a_drive_that_stops_and_a_file_that_can_be_rescued(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(TESTS))  # the tests' kernel cache names types of the tests: see conftest
    axis = patient_axis(tmp_path / "axis")
    bus = f"loopback:{free_loopback_port()}"
    out = tmp_path / "run.mcap"
    command = [
        sys.executable,
        "-m",
        "fffo_drive",
        "run",
        str(axis),
        "--bus",
        bus,
        "--out",
        str(out),
        "--uncommissioned",
        "--json",
    ]
    with open_link(bus) as witness, SimulatedProcess(tmp_path / "axis" / "drive.yaml", bus) as drive:
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as controller:
            try:
                commands = driven(witness, controller, DRIVEN_TICKS)
            finally:
                controller.send_signal(signal.SIGKILL)
        assert emergency(witness) in (HEARTBEAT_LOST, COMMAND_LATE, SYNC_LOST)
        assert statusword(witness) & STATE_MASK != OPERATION_ENABLED
        drive.check()  # and is still there
    assert set(os.listdir(tmp_path)) == {"axis", "run.mcap.part"}
    assert main(["log", "recover", f"{out}.part", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    run = read_run(out)
    assert run.complete
    assert report["rows"] == len(run.rows) > 0
    assert (np.diff(run.rows["tick"].astype(np.int64)) > 0).all()
    assert (run.rows["trip"] == 0).all()
    assert commands > DRIVEN_TICKS  # the ticks before Operation Enabled

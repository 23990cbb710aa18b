"""The simulated drive, in a process of its own, with the dictionaries of real drives: brought up, enabled, turned.

Each axis file names the profile that ships for its family and what belongs to the one axis. Only logic is asserted,
never how punctual a shared machine is: the limits on silence are wide.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from shared_data import shared_files

from fffo_drive.can.link import free_loopback_port
from fffo_drive.cli import main
from fffo_drive.commissioning.record import read_record
from fffo_drive.recording.reader import read_run

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
NODE = 32
RATED_NM = 1.2284  # of the plant in configs/simulated_drive.yaml
IPOS_UNITS_PER_A = 65536.0 * 3276.0  # of 0x201C, in a drive with a peak of 10 A
PATIENT: dict[str, Any] = {
    "heartbeat_timeout_ms": 10_000, "drive_heartbeat_ms": 100, "answer_timeout_s": 2.0, "start_timeout_s": 20.0,
}  # fmt: skip
RATING_MNM = {"object": 0x6076, "value": 1228, "bytes": 4, "why": "the rating of the motor"}
NODE_IDS_FIT = {"0x1016:01": 0x7FFFFF}  # the file has 65535, which leaves no room for a node id
OF_IPOS = {  # objects of the vendor's own, which the public file leaves out
    "0x201C:00": {"type": "0x4", "access": "rww", "pdo": "1"},
    "0x201D:00": {"type": "0x6", "access": "rw", "pdo": "0", "default": "0"},
}
DRIVES: dict[str, dict[str, Any]] = {
    "e35": {"profile": "e35", "axis": {"sdo": [RATING_MNM]}},
    "elmo_gold": {
        "profile": "elmo_gold", "personality": {"highest": NODE_IDS_FIT}, "axis": {"sdo": [RATING_MNM]},
    },
    "epos4": {
        "profile": "maxon_epos4",
        "personality": {"rated_torque_unit_nm": 1e-6},
        "axis": {"sdo": [{**RATING_MNM, "value": 1_228_400}]},
    },
    "foc_mc": {"profile": "amd_foc_mc"},
    "nanotec_cl4e": {"profile": "nanotec_cl4e"},
    "roboteq": {"profile": "roboteq", "node": {"velocity_counts_per_rps": 60}},
    "ipos": {
        "profile": "technosoft_ipos",
        "personality": {
            "vendor_mode": -5, "vendor_target": "0x201C:00", "vendor_target_bits": 32,
            "vendor_units_per_a": IPOS_UNITS_PER_A,
        },
        "objects": OF_IPOS,
        "axis": {"target": {"units_per_a": IPOS_UNITS_PER_A}, "torque_feedback": {"object": 0x6077}},
    },
}  # fmt: skip


@contextlib.contextmanager
def foreign(name: str, keys: dict[str, Any], folder: Path, bus: str) -> Iterator[None]:
    """The simulated drive as a process with the dictionary of another drive."""
    drive = yaml.safe_load((CONFIGS / "simulated_drive.yaml").read_text())
    drive |= {"node_id": NODE, "sync_loss_tolerance_ms": 5000, **keys.get("node", {})}
    drive["personality"] = keys.get("personality", {})
    path, objects = folder / "drive.yaml", folder / "objects.yaml"
    path.write_text(yaml.safe_dump(drive))
    dictionary = yaml.safe_load(shared_files(f"drives/{name}.yaml")[0].read_text())
    dictionary["objects"] |= keys.get("objects", {})
    objects.write_text(yaml.safe_dump(dictionary))
    command = [sys.executable, "-m", "fffo_drive", "sim", str(path), "--dictionary", str(objects), "--bus", bus]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert "ready" in process.stdout.readline()
            yield
        finally:
            process.terminate()
            process.wait()


def axis_of(keys: dict[str, Any], bus: str, rate_hz: int) -> dict[str, Any]:
    """The bench's axis, with the drive's profile and a short motion."""
    axis: dict[str, Any] = yaml.safe_load((CONFIGS / "axis_bench.yaml").read_text())
    axis["drive"] = {
        "kind": "canopen", "bus": bus, "node_id": NODE, "profile": keys["profile"], "rated_torque_nm": RATED_NM,
        **PATIENT, **keys.get("axis", {}),
    }  # fmt: skip
    axis["model"] = str(CONFIGS / "models" / "table1.yaml")
    axis["loop"] = {"rate_hz": rate_hz}
    axis["controller"]["at_rest"] = {}  # the hold is for the bench's counts, and this drive has its own
    axis["profile"] = {"kind": "sine", "duration_s": 2, "amplitude": 2, "frequency_hz": 1}
    axis["envelope"] |= {
        "following_error_rps": 24, "feedback_missing_ticks": 4000, "status_missing_ticks": 8000,
        "heartbeat_timeout_s": 10,
    }  # fmt: skip
    return axis


def follows(name: str, keys: dict[str, Any], rate_hz: int, folder: Path) -> None:
    """Run the axis, and see that it moved as it was told, with torque only while it was enabled."""
    bus = f"loopback:{free_loopback_port()}"
    path, out = folder / "axis.yaml", folder / "run.mcap"
    path.write_text(yaml.safe_dump(axis_of(keys, bus, rate_hz)))
    with foreign(name, keys, folder, bus):
        assert main(["run", str(path), "--uncommissioned", "--out", str(out)]) == 0
    run = read_run(out)
    assert run.complete
    rows = run.rows
    assert (rows["trip"] == 0).all()
    enabled = (rows["statusword"] & 0x6F) == 0x27
    assert (rows["current_command_a"][~enabled] == 0).all()
    inside = rows[rows["profile_sample"] >= 0]
    assert inside["profile_sample"].max() >= 2 * rate_hz - 1
    moving = np.abs(inside["reference_rps"]) > 0.5
    assert np.corrcoef(inside["reference_rps"][moving], inside["velocity_rps"][moving])[0, 1] > 0.9
    wanted = np.ptp(np.cumsum(inside["reference_rps"])) / rate_hz
    assert np.ptp(inside["position_rev"]) == pytest.approx(wanted, rel=0.2)


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.parametrize(("name", "rate_hz"), [(name, 1000 if name == "elmo_gold" else 500) for name in DRIVES])
def test_the_axis_follows(name: str, rate_hz: int, tmp_path: Path) -> None:
    follows(name, DRIVES[name], rate_hz, tmp_path)


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.parametrize("name", DRIVES)
def test_the_axis_is_commissioned(name: str, tmp_path: Path) -> None:
    bus, path = f"loopback:{free_loopback_port()}", tmp_path / "axis.yaml"
    path.write_text(yaml.safe_dump(axis_of(DRIVES[name], bus, 500)))
    with foreign(name, DRIVES[name], tmp_path, bus):
        assert main(["commission", str(path), "--yes", "--out", str(tmp_path / "record.yaml")]) == 0
    record = read_record(tmp_path / "record.yaml")
    assert record.passed
    checks = {check.name: check.verdict for check in record.checks}
    signs = ("torque_sign", "velocity_sign", "position_sign", "counts_per_rev", "velocity_scale")
    assert {checks[sign] for sign in signs} == {"ok"}


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize(
    ("personality", "axis"),
    [
        ({"brake_release_s": 0.05}, {"enable_delay_s": 0.1}),
        ({"command_following": "not_shown"}, {"unserved_status_bits": [12]}),
        ({"mode_display": "with_sync"}, {"mode_display": "with_sync"}),
        ({"warning_code": 0xFF00}, {"warning_codes": [0xFF00]}),
    ],
    ids=["brake", "bit 12", "late mode", "warning"],
)  # fmt: skip
def test_the_axis_follows_a_drive_with_quirks(
    personality: dict[str, Any], axis: dict[str, Any], tmp_path: Path
) -> None:
    plain = DRIVES["nanotec_cl4e"]
    follows("nanotec_cl4e", {**plain, "personality": personality, "axis": axis}, 500, tmp_path)

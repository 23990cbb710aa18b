"""The whole path in real time on a loopback bus: a node in a process of its own, bring-up, a short run, its record.

Only logic is asserted, never how punctual a shared machine is: the limits on silence are wide.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fffo_drive.cli import main
from fffo_drive.recording.reader import read_run

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


@pytest.fixture
def bench_file(tmp_path):
    """The bench's axis with a two-second profile, patient with a machine that stalls."""
    text = (CONFIGS / "axis_bench.yaml").read_text()
    text = text.replace("duration_s: 60", "duration_s: 2, low_rps: 0.5, high_rps: 3")
    text = text.replace("feedback_missing_ticks: 200", "feedback_missing_ticks: 4000")
    text = text.replace("status_missing_ticks: 400", "status_missing_ticks: 8000")
    text = text.replace("heartbeat_timeout_s: 2", "heartbeat_timeout_s: 10")
    text = text.replace("heartbeat_timeout_ms: 1000", "heartbeat_timeout_ms: 5000")
    text = text.replace("command_timeout_ms: 200", "command_timeout_ms: 5000")
    text = text.replace("following_error_rps: 8", "following_error_rps: 24")
    text = text.replace("models/table1.yaml", str(CONFIGS / "models" / "table1.yaml"))
    path = tmp_path / "axis.yaml"
    path.write_text(text)
    drive = (CONFIGS / "simulated_drive.yaml").read_text()
    drive = drive.replace("sync_loss_tolerance_ms: 500", "sync_loss_tolerance_ms: 5000")
    (tmp_path / "drive.yaml").write_text(drive)
    return path


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.realtime
def test_the_bench_runs_four_controllers_and_reports_them(bench_file, tmp_path, capsys):
    drive = str(tmp_path / "drive.yaml")
    assert main(["bench", "--config", str(bench_file), "--drive", drive, "--out", str(tmp_path), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result["controllers"]) == {"PI", "PI+FBFO", "PI+FFFO", "PI+FFFO+"}
    assert result["label"] == ""
    assert all(set(metrics) == {"ise", "mae", "max", "std"} for metrics in result["controllers"].values())
    assert len(result["files"]) == 4
    for name, file in result["ticks"].items():
        assert file["rows_lost"] == 0, name
    for file in result["files"]:
        run = read_run(file)
        assert run.complete
        assert run.metadata["drive_product"] == "0x50455332"
        rows = run.rows
        assert (rows["trip"] == 0).all()
        # the profile ran to its end, each tick with the sample that belongs to its number
        inside = rows[(rows["profile_sample"] >= 0)]
        assert inside["profile_sample"].max() >= 4000
        offset = inside["tick"].astype(np.int64) - inside["profile_sample"]
        assert (offset == offset[0]).all()
        # no torque is commanded outside Operation Enabled
        enabled = (rows["statusword"] & 0x6F) == 0x27
        assert (rows["current_command_a"][~enabled] == 0).all()
        # the axis really followed
        moving = np.abs(inside["reference_rps"]) > 0.5
        assert np.corrcoef(inside["reference_rps"][moving], inside["velocity_rps"][moving])[0, 1] > 0.8

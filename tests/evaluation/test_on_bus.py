"""A scenario on a bus in real time: recorded, named by its controllers, and replayed bit for bit."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fffo_drive.can.link import free_loopback_port
from fffo_drive.cli import main

CONFIGS = Path(__file__).resolve().parents[2] / "configs"

SCENARIO = f"""\
format: fffo_drive/scenario/1
name: bus
axis: {CONFIGS / "axis_bench.yaml"}
seeds: 1
reference: {{kind: paper, duration_s: 2, slope: 0}}
mismatch: {{friction_share: 0.1}}
controllers:
  pi: {{toggle: "off"}}
  pi+fffo+: {{toggle: ff, feedforward: {{inertia: true, preview: true, delay_aware: true}}}}
"""


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.realtime
def test_a_scenario_runs_on_a_bus_and_its_records_carry_what_controlled_them(tmp_path, capsys):
    file, out = tmp_path / "bus.yaml", tmp_path / "out"
    file.write_text(SCENARIO)
    node = str(CONFIGS / "simulated_drive.yaml")
    bus = f"loopback:{free_loopback_port()}"
    assert main(["evaluate", str(file), "--bus", bus, "--node", node, "--out", str(out), "--json"]) == 0
    results = json.loads(capsys.readouterr().out)
    assert results["controllers"] == ["pi", "pi+fffo+"]
    assert "true.ise" not in results["figures"]  # nobody on the bus knows it
    assert results["figures"]["measured.ise"]["pi"]["value"] > 0.0
    recordings = sorted(out.glob("*.mcap"))
    assert len(recordings) == 2
    for recording in recordings:
        assert main(["replay", str(recording)]) == 0
    capsys.readouterr()
    again = [str(recording) for recording in recordings]
    assert main(["evaluate", "--runs", *again, "--out", str(tmp_path / "again"), "--json"]) == 0
    repeated = json.loads(capsys.readouterr().out)
    assert repeated["figures"]["measured.mae"]["pi"] == results["figures"]["measured.mae"]["pi"]


def test_a_simulated_axis_is_not_on_a_bus(tmp_path, capsys):
    file = CONFIGS / "scenarios" / "paper.yaml"
    assert main(["evaluate", str(file), "--bus", "--out", str(tmp_path)]) == 78
    assert "--bus needs an axis file with a canopen drive" in capsys.readouterr().err

"""The manual's scripts do what the manual says, in at most thirty lines."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fffo_drive as fd
import fffo_drive.manual

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = Path(fffo_drive.manual.__file__).parent / "scripts"
AXIS = ROOT / "configs" / "axis_simulated.yaml"
UNDECLARED = ROOT / "configs" / "axis_undeclared.yaml"  # cogging that its model does not have


def said_by(script: str, *arguments: object) -> str:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, SCRIPTS / script, *map(str, arguments)], capture_output=True, text=True, env=environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("script", sorted(SCRIPTS.glob("*.py")), ids=lambda path: path.name)
def test_a_script_is_short(script):
    assert len(script.read_text().splitlines()) <= 30


@pytest.mark.long
@pytest.mark.timeout(300)
def test_three_controllers_are_compared():
    lines = said_by("compare_controllers.py", AXIS).splitlines()
    ises = [float(line.split()[2]) for line in lines[:3]]
    assert [line.split()[0] for line in lines[:3]] == ["PI", "PI+FBFO", "PI+FFFO"]
    assert ises == sorted(ises, reverse=True)


@pytest.mark.long
@pytest.mark.timeout(300)
def test_each_gain_of_a_sweep_has_an_error_of_its_own():
    ises = [float(line.split()[4]) for line in said_by("gain_sweep.py", AXIS).splitlines()]
    assert len(set(ises)) == 50
    apart = ises[::12]  # five of them: neighbours differ by less than their noise
    assert apart == sorted(apart, reverse=True)


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_recorded_run_is_replayed_with_another_model(tmp_path):
    text = said_by("replay_other_model.py", AXIS, tmp_path / "run.mcap")
    assert "bit for bit: True" in text
    assert "with that model the command differs by" in text


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_csv_of_anyone_ends_in_a_named_effect(tmp_path):
    """Cogging of a simulated axis, in degrees and under foreign names."""
    for place, seed in enumerate((1, 2)):
        run = fd.simulate(UNDECLARED, seed=seed)
        table = np.column_stack([run.time_s, 360.0 * run["position_rev"], run["current_command_a"]])
        np.savetxt(tmp_path / f"{place}.csv", table, delimiter=",", header="t,angle,iq", comments="", fmt="%.9g")
    text = said_by("csv_to_effect.py", tmp_path / "0.csv", tmp_path / "1.csv")
    assert "cogging" in text

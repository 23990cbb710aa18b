"""The whole path in simulated time: axis file, simulated drive, loop, recorder, reader, metrics."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fffo_drive.cli import main
from fffo_drive.config.simulated import read_simulated
from fffo_drive.control.friction_observer import TOGGLE_FEEDBACK, TOGGLE_FEEDFORWARD, TOGGLE_OFF
from fffo_drive.documents import DocumentError
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.evaluation.metrics import run_metrics
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime.runs import simulated_ring_rows
from fffo_drive.runtime.session import Session
from fffo_drive.signals import ROW, UNITS
from fffo_drive.workflows.plan import make_plan, plan_session
from fffo_drive.workflows.recorded_facts import facts_for

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
AXIS = CONFIGS / "axis_simulated.yaml"


def simulate(toggle: int, seed: int):
    """Rows of the shipped axis under one controller."""
    from dataclasses import replace

    plan = make_plan(AXIS)
    config = read_simulated(CONFIGS / "simulated_drive.yaml")
    drive = SimulatedDrive(replace(config.plant, seed=seed), config.device)
    drive.connect()
    session = Session(drive, plan_session(plan, simulated_ring_rows(plan.profile, plan.axis.loop.tail_s)))
    session.run_profile(plan.profile, toggle)
    assert session.status(b.TRIP) == 0
    return RingReader(session.ring).read().rows, plan


@pytest.mark.long
@pytest.mark.slow
def test_fffo_is_best_and_pi_worst_over_ten_seeds():
    for seed in range(1, 11):
        metrics = {}
        for toggle in (TOGGLE_OFF, TOGGLE_FEEDBACK, TOGGLE_FEEDFORWARD):
            rows, plan = simulate(toggle, seed)
            metrics[toggle] = run_metrics(rows, plan.profile.period_s, plan.profile.values.size)
        for key in ("ise", "mae"):
            pi, fbfo, fffo = (getattr(metrics[t], key) for t in (TOGGLE_OFF, TOGGLE_FEEDBACK, TOGGLE_FEEDFORWARD))
            assert fffo < fbfo < pi, (seed, key)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_run_and_another_one_does_not():
    first, _ = simulate(TOGGLE_FEEDFORWARD, 3)
    again, _ = simulate(TOGGLE_FEEDFORWARD, 3)
    other, _ = simulate(TOGGLE_FEEDFORWARD, 4)
    assert first.tobytes() == again.tobytes()
    assert not np.array_equal(first["velocity_rps"], other["velocity_rps"])


@pytest.mark.slow
def test_the_run_command_records_what_it_reports(tmp_path, capsys):
    out = tmp_path / "run.mcap"
    assert main(["run", str(AXIS), "--toggle", "ff", "--out", str(out), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    run = read_run(out)
    assert run.complete
    assert run.rows.dtype == ROW
    assert run.units["velocity_rps"] == UNITS["velocity_rps"]
    assert run.metadata["controller"] == "ff"
    assert set(run.attachments) == {"axis_simulated.yaml", "table1.yaml"}
    samples = int(run.metadata["profile_samples"])
    assert run_metrics(run.rows, 5e-4, samples)._asdict() == pytest.approx(summary["metrics"])
    np.testing.assert_array_equal(np.diff(run.rows["tick"].astype(np.int64)), 1)
    # nothing acts outside Operation Enabled, and the first command waits for it
    enabled = (run.rows["statusword"] & 0x6F) == 0x27
    assert (run.rows["current_command_a"][~enabled] == 0).all()
    forward_nm = run.rows["friction_nm"] + run.rows["inertia_nm"]
    total = run.rows["proportional_a"] + run.rows["integral_a"] + run.rows["hold_a"] + forward_nm / 0.148
    np.testing.assert_allclose(run.rows["requested_a"], total, atol=1e-12)
    # identify and diagnose need no file beside it
    facts = facts_for(None, [out])
    assert (facts.torque_constant_nm_per_a, facts.resolver_bits, facts.absolute_angle) == (0.148, 15, True)
    log = tmp_path / "log.csv"
    log.write_text("time_s\n0\n1\n")
    with pytest.raises(DocumentError, match=r"log\.csv: a table has no facts"):
        facts_for(None, [out, log])


def test_the_motion_that_decides_about_an_effect_is_run_by_its_name(tmp_path, capsys):
    out = tmp_path / "run.mcap"
    assert main(["run", str(AXIS), "--decide", "quadratic_drag", "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["fault"] is None
    run = read_run(out)
    assert run.metadata["profile"] == "decide-quadratic_drag"
    levels = np.round(np.abs(run.rows["reference_rps"]), 6)
    assert sum(np.count_nonzero(levels == level) > 2000 for level in np.unique(levels[levels > 0])) == 8  # a staircase
    with pytest.raises(SystemExit):
        main(["run", str(AXIS), "--decide", "quadratic_frag"])
    assert "did you mean 'quadratic_drag'?" in capsys.readouterr().err


@pytest.mark.slow
def test_a_trip_ends_the_run_with_its_exit_code_and_its_record(tmp_path, capsys):
    text = AXIS.read_text().replace("following_error_rps: 8", "following_error_rps: 0.02")
    text = text.replace("following_error_s: 0.2", "following_error_s: 0.01")
    for name in ("model: models/table1.yaml", "file: simulated_drive.yaml"):
        key, value = name.split(": ")
        text = text.replace(name, f"{key}: {CONFIGS / value}")
    path = tmp_path / "axis.yaml"
    path.write_text(text)
    out = tmp_path / "run.mcap"
    assert main(["run", str(path), "--out", str(out)]) == 70
    assert "following_error" in capsys.readouterr().err
    rows = read_run(out).rows
    tripped = rows["trip"] != 0
    assert tripped.any()
    assert (rows["current_command_a"][tripped] == 0).all()
    assert abs(rows["true_velocity_rps"][-1]) < 0.2  # the quick stop braked before the loop left


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["run", "none.yaml"], 78, "cannot be read"),
        (["log", "info", "none.mcap"], 78, "none.mcap"),
        (["config", "check", "none.yaml"], 78, "cannot be read"),
        (["config", "check", str(CONFIGS / "axis_simulate.yaml")], 78, "did you mean 'axis_simulated.yaml'?"),
        (["bench", "--config", str(CONFIGS / "axis_simulated.yaml")], 78, "bench needs an axis on a bus"),
        (["evaluate"], 78, "fffo-drive evaluate: give a SCENARIO"),
        (["identify", str(CONFIGS / "axis_simulated.yaml"), "--out", "none"], 78, "no lines of numbers in it"),
        (["run", str(CONFIGS / "axis_canopen.yaml"), "--bus", "socketcan:nosuch0", "--uncommissioned"], 69, "nosuch0"),
    ],
)
def test_errors_are_one_message_and_an_exit_code(words, code, text, capsys):
    assert main(words) == code
    captured = capsys.readouterr()
    assert text in captured.err
    assert "Traceback" not in captured.err


@pytest.mark.parametrize(("option", "value"), [("--phase-margin-deg", "200"), ("--gain-margin", "0.5")])
def test_a_margin_that_no_axis_file_takes_is_not_tuned_for(option, value, tmp_path, capsys):
    model = str(CONFIGS / "models" / "table1.yaml")
    with pytest.raises(SystemExit) as ended:
        main(["tune", model, "--out", str(tmp_path / "out"), option, value])
    assert ended.value.code == 2
    assert f"argument {option}: {value} is outside" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["run", "sim", "bench", "log", "config"])
def test_every_command_has_help(command, capsys):
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    assert f"fffo-drive {command}" in capsys.readouterr().out

"""A recorded run, put through the law again, gives every term and command bit for bit; a changed law does not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from runtime.scripted_port import ANSWERS, STATUSWORD, WAKE_DELAY_NS, scripted
from runtime.test_loop import CONTROLLER, Rig, envelope

from fffo_drive.cli import main
from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.control.controller import pack_controller
from fffo_drive.control.envelope import TRIP_FOLLOWING_ERROR
from fffo_drive.control.friction_observer import TOGGLE_FEEDBACK, TOGGLE_FEEDFORWARD, TOGGLE_OFF
from fffo_drive.control.position_hold import HoldConfig
from fffo_drive.control.reference import MODE_VELOCITY, piecewise_linear
from fffo_drive.control.velocity_estimator import BRIDGED_TICKS, estimator_config
from fffo_drive.drive.cia402 import GOAL_ENABLED
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.drive.simulated.parameters import EffectConfig
from fffo_drive.evaluation.replay import TERMS, WORDS, Replay, law_in_force
from fffo_drive.recording.reader import read_run
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime.session import Session
from fffo_drive.runtime.tick import FLAG_ADAPTS, FLAG_ESTIMATED_VELOCITY

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


@pytest.fixture(scope="module")
def axis_file(tmp_path_factory):
    """The shipped axis with a short profile, a tight slew limit and all feed-forward on: every branch of the law."""
    text = (CONFIGS / "axis_simulated.yaml").read_text()
    text = text.replace("profile: {kind: paper, duration_s: 60}", "profile: {kind: paper, duration_s: 6}")
    text = text.replace("envelope:\n", "envelope:\n  slew_a_per_s: 200\n")
    text = text.replace(
        "  observer:\n", "  feedforward: {inertia: true, preview: true, delay_aware: true}\n  observer:\n"
    )
    text = text.replace("file: simulated_drive.yaml", f"file: {CONFIGS / 'simulated_drive.yaml'}")
    text = text.replace("model: models/table1.yaml", f"model: {CONFIGS / 'models' / 'table1.yaml'}")
    path = tmp_path_factory.mktemp("replay") / "axis.yaml"
    path.write_text(text)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("toggle", ["off", "ff", "fb"])
def test_a_run_is_reproduced_bit_for_bit(axis_file, tmp_path, toggle, capsys):
    run = tmp_path / "run.mcap"
    assert main(["run", str(axis_file), "--toggle", toggle, "--out", str(run), "--json"]) == 0
    capsys.readouterr()
    assert main(["replay", str(run), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["exact"]
    assert report["rows"] > 12_000


@pytest.mark.slow
def test_a_run_that_adapts_is_reproduced_bit_for_bit(axis_file, tmp_path, capsys):
    adapting = axis_file.with_name("adapting.yaml")
    text = axis_file.read_text().replace(
        "controller:\n", "controller:\n  adaptation: {enabled: true, time_s: 5, bound_share: 0.001}\n"
    )
    adapting.write_text(text.replace("  observer:\n", "  observer:\n    learns_in: integral\n"))
    run = tmp_path / "run.mcap"
    assert main(["run", str(adapting), "--toggle", "ff", "--out", str(run), "--json"]) == 0
    warnings = json.loads(capsys.readouterr().out)["warnings"]
    assert [text for text in warnings if "has reached its bound" in text]
    assert main(["replay", str(run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["exact"]
    content = read_run(run)
    assert [event.text for event in content.events if event.source == "adaptation"] == warnings
    rows = content.rows
    assert (rows["flags"] & FLAG_ADAPTS != 0).mean() > 0.5
    assert np.abs(rows["adapted_coulomb_nm"]).max() > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("toggle", ["ff", "fb"])
def test_a_run_on_the_estimated_velocity_is_reproduced_bit_for_bit(axis_file, tmp_path, toggle, capsys):
    estimated = axis_file.with_name("estimated.yaml")
    estimated.write_text(
        axis_file.read_text().replace("controller:\n", "controller:\n  velocity: {source: estimated}\n")
    )
    run = tmp_path / "run.mcap"
    assert main(["run", str(estimated), "--toggle", toggle, "--out", str(run), "--json"]) == 0
    rows = read_run(run).rows
    acts = rows["mode"] == MODE_VELOCITY
    used = rows["flags"] & FLAG_ESTIMATED_VELOCITY != 0
    assert used.sum() > 0.99 * acts.sum()
    taken = np.where(used, rows["estimated_rps"], rows["velocity_rps"])
    np.testing.assert_array_equal(rows["error_rps"][acts], (rows["expected_rps"] - taken)[acts])
    lags = [lag_s(rows[name][used], rows["true_velocity_rps"][used]) for name in ("velocity_rps", "estimated_rps")]
    assert lags[0] == pytest.approx(0.0007, abs=2e-4)
    assert abs(lags[1]) < 1.5e-4
    capsys.readouterr()
    assert main(["replay", str(run), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["exact"]
    assert report["rows"] > 12_000


@pytest.mark.slow
def test_a_run_with_notches_is_reproduced_bit_for_bit(axis_file, tmp_path, capsys):
    notched = axis_file.with_name("notched.yaml")
    notches = "[{frequency_hz: 110, width: 0.3}, {frequency_hz: 240, width: 0.5, depth: 0}]"
    notched.write_text(axis_file.read_text().replace("controller:\n", f"controller:\n  notches: {notches}\n"))
    run = tmp_path / "run.mcap"
    assert main(["run", str(notched), "--out", str(run), "--json"]) == 0
    capsys.readouterr()
    assert main(["replay", str(run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["exact"]
    rows = read_run(run).rows
    acts = rows["mode"] == MODE_VELOCITY
    behind, before = (np.std(np.diff(rows[name][acts])) for name in ("filtered_error_rps", "error_rps"))
    assert behind < 0.9 * before


@pytest.mark.slow
@pytest.mark.parametrize("toggle", [TOGGLE_OFF, TOGGLE_FEEDFORWARD, TOGGLE_FEEDBACK])
def test_a_run_with_a_hold_of_the_position_is_reproduced_bit_for_bit(toggle):
    """Stop and go under a load: the hold begins, works at its bound on the integral too, ends with the next motion."""
    case = case_of(read_scenario(CONFIGS / "scenarios" / "paper.yaml"), 1)
    law = next(c.controller for c in case.candidates if c.name == "pi+fffo+")
    hold = HoldConfig(2000.0, 2.0**-15, 1e-3, 0.01)
    law = law._replace(rest=law.rest._replace(gain_share=0.5, fade_share=0.1, release_share=0.1, hold=hold))
    load = EffectConfig("periodic_disturbance", {"amplitude_nm": 0.02, "frequency_hz": 0.7})
    drive = SimulatedDrive(replace(case.plant, effects=(load,)), case.device)
    drive.connect()
    session = Session(drive, case.session._replace(controller=law))
    times_s, values_rps = np.array([0.0, 0.1, 0.3, 0.4, 2.0, 2.1, 2.3, 2.4, 4.0]), np.zeros(9)
    values_rps[[1, 2]], values_rps[[5, 6]] = 2.0, -2.0
    session.run_profile(piecewise_linear("stop and go", MODE_VELOCITY, 5e-4, times_s, values_rps), toggle)
    rows = RingReader(session.ring).read().rows
    held = rows["hold_a"] != 0.0
    assert held.sum() > 2000
    assert np.abs(rows["hold_a"]).max() == hold.bound_a
    nothing = np.zeros(rows.size, np.int64)
    in_force = law_in_force([pack_controller(law)], [session.blocks.effects[0]], case.session.envelope)
    replayed = Replay().run(in_force, rows, nothing, nothing)
    assert replayed.known.all()
    acts = rows["mode"] == MODE_VELOCITY
    for column, name in enumerate(TERMS):
        np.testing.assert_array_equal(replayed.terms[acts, column], rows[name][acts])
    np.testing.assert_array_equal(replayed.commands[:, 0], rows["limited_a"])


def lag_s(velocity_rps, true_rps):
    """How far a velocity lags behind the true one: over its derivative, in the mean."""
    slope = np.gradient(true_rps, 5e-4)
    return float(-np.dot(velocity_rps - true_rps, slope) / np.dot(slope, slope))


@pytest.mark.slow
def test_a_changed_law_is_compared_on_the_same_data(axis_file, tmp_path, capsys):
    run = tmp_path / "run.mcap"
    assert main(["run", str(axis_file), "--out", str(run), "--json"]) == 0
    other = axis_file.with_name("other.yaml")
    other.write_text(axis_file.read_text().replace("gain_nm_per_rev: 5", "gain_nm_per_rev: 6"))
    capsys.readouterr()
    assert main(["replay", str(run), "--with", str(other), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert not report["exact"]
    assert 1e-4 < report["rms_difference_a"] < 2.0


@pytest.mark.parametrize("statusword", [0x1637, 0x0637, 0x1437, 0x0040])
@pytest.mark.parametrize("delay_ticks", [0, 40])
def test_what_the_drive_does_not_heed_and_an_enable_delay_are_reproduced_from_the_rows(statusword, delay_ticks):
    ticks = 400
    rig = Rig(scripted(ticks, velocity_rps=-0.5))
    rig.port.script[100:, STATUSWORD] = statusword
    rig.port.script[:100, STATUSWORD] = 0x1637
    rows = rig.run(loop={"served_status_bits": 0x1200, "enable_delay_ticks": delay_ticks})
    assert (rows["mode"] != 0).sum() > 50
    nothing = np.zeros(ticks, np.int64)
    in_force = law_in_force([pack_controller(CONTROLLER)], [rig.blocks.effects[0]], envelope())
    replayed = Replay().run(in_force, rows, nothing, nothing)
    assert replayed.known.all()
    for column, name in enumerate(WORDS):
        np.testing.assert_array_equal(replayed.words[:, column], rows[name])
    np.testing.assert_array_equal(replayed.commands[:, 0], rows["limited_a"])


def test_the_row_says_where_feedback_that_was_missing_took_the_estimate_away():
    ticks = 400
    config = CONTROLLER._replace(velocity=estimator_config(200.0, 9.4e-4, 0.148, 0.00205, 5e-4, 30.0, 8.0))
    rig = Rig(scripted(ticks, velocity_rps=0.01))  # at a position that stands still
    rig.blocks = b.new_blocks(config, 1000)
    rig.blocks.control[b.GOAL] = GOAL_ENABLED
    short, long = slice(100, 100 + BRIDGED_TICKS), slice(200, 205 + BRIDGED_TICKS)
    rig.port.script[short, ANSWERS] = rig.port.script[long, ANSWERS] = 0
    rig.port.script[300, WAKE_DELAY_NS] = 1_020_000  # two periods are skipped
    rows = rig.run(ticks - 20, feedback_missing_ticks=50)
    estimated = rows["flags"] & FLAG_ESTIMATED_VELOCITY != 0
    settling = config.velocity.settling_ticks
    tick = rows["tick"].astype(int)
    acts = rows["mode"] == MODE_VELOCITY
    begin = int(tick[acts][0])
    lost = (tick >= 200 + BRIDGED_TICKS) & (tick < 205 + BRIDGED_TICKS + settling)
    np.testing.assert_array_equal(estimated, (tick >= begin + settling) & ~lost)
    taken = np.where(estimated, rows["estimated_rps"], rows["velocity_rps"])
    np.testing.assert_array_equal(rows["error_rps"], rows["expected_rps"] - taken)
    nowhere = np.zeros(rows.size, np.int64)
    in_force = law_in_force([pack_controller(config)], [rig.blocks.effects[0]], envelope(feedback_missing_ticks=50))
    replayed = Replay().run(in_force, rows, nowhere, nowhere)
    assert replayed.known.all()
    for column, name in enumerate(TERMS):
        np.testing.assert_array_equal(replayed.terms[acts, column], rows[name][acts])


def test_the_envelopes_following_error_is_that_of_the_drives_own_velocity():
    # the estimate follows the position, which stands still; the drive says 3 rps, within what is believed
    config = CONTROLLER._replace(velocity=estimator_config(200.0, 9.4e-4, 0.148, 0.00205, 5e-4, 30.0, 8.0))
    rig = Rig(scripted(200, velocity_rps=3.0))
    rig.blocks = b.new_blocks(config._replace(pi=config.pi._replace(proportional_a_per_rps=0.0)), 1000)
    rig.blocks.control[b.GOAL] = GOAL_ENABLED
    rows = rig.run(following_error_rps=2.0, following_error_s=0.05)
    assert (np.abs(rows["error_rps"][60:90]) < 2.0).all()
    assert (rows["flags"][60:90] & FLAG_ESTIMATED_VELOCITY != 0).all()
    assert TRIP_FOLLOWING_ERROR in rows["trip"]

"""The section of the estimated velocity: what it makes of the delay and the reference, and mistakes named."""

from __future__ import annotations

from pathlib import Path

import pytest

from fffo_drive.cli import main
from fffo_drive.config.axis import controller_config, loop_axis, model_of, read_axis
from fffo_drive.config.checks import law_margins, law_problems, velocity_problems
from fffo_drive.control.velocity_estimator import DRIVE_VELOCITY
from fffo_drive.documents import DocumentError
from fffo_drive.workflows.plan import make_plan

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
MODEL = (CONFIGS / "models" / "table1.yaml").read_text()
ESTIMATED = "velocity: {source: estimated}"


def axis_file(tmp_path, velocity="", name="axis_simulated", model=MODEL, **replaced):
    text = (CONFIGS / f"{name}.yaml").read_text()
    text = text.replace("file: simulated_drive.yaml", f"file: {CONFIGS / 'simulated_drive.yaml'}")
    text = text.replace("model: models/table1.yaml", "model: model.yaml")
    text = text.replace("controller:\n", f"controller:\n  {velocity}\n" if velocity else "controller:\n")
    for key, value in replaced.items():
        lines = [f"  {key}: {value}" if line.startswith(f"  {key}:") else line for line in text.splitlines()]
        text = "\n".join(lines) + "\n"
    (tmp_path / "model.yaml").write_text(model)
    path = tmp_path / "axis.yaml"
    path.write_text(text)
    return path


def read(path):
    axis = read_axis(path)
    return axis, model_of(path, axis)


def refused(path):
    with pytest.raises(DocumentError) as caught:
        make_plan(path)
    return str(caught.value)


def test_the_drives_own_velocity_is_the_default():
    axis = read_axis(CONFIGS / "axis_simulated.yaml")
    config = controller_config(axis, model_of(CONFIGS / "axis_simulated.yaml", axis))
    assert config.velocity == DRIVE_VELOCITY


def test_an_estimate_takes_the_sensors_lag_from_the_delay_of_the_loop_and_from_the_expected_reference(tmp_path):
    before = controller_config(*read(axis_file(tmp_path, "feedforward: {preview: true, delay_aware: true}")))
    path = axis_file(tmp_path, f"feedforward: {{preview: true, delay_aware: true}}\n  {ESTIMATED}")
    axis, model = read(path)
    after = controller_config(axis, model)
    assert after.velocity.used
    assert loop_axis(axis, model).delay_s == pytest.approx(0.00275 + 0.00025 - 0.0007)
    # a command to the torque that the position shows: 2.05 ms at 2 kHz
    assert after.velocity.delay_periods + after.velocity.delay_share == pytest.approx(4.1)
    # torque acts when it did; what is measured is as old as the position
    assert after.feedforward.ahead_ticks == pytest.approx(before.feedforward.ahead_ticks)
    assert before.feedforward.behind_ticks == pytest.approx(1.4)
    assert after.feedforward.behind_ticks == 0.0


def test_without_preview_the_reference_is_as_late_as_torque_and_position(tmp_path):
    axis, model = read(axis_file(tmp_path, f"feedforward: {{preview: false}}\n  {ESTIMATED}"))
    assert controller_config(axis, model).feedforward.behind_ticks == pytest.approx(2.3e-3 / 5e-4)


def test_the_shipped_gains_have_more_phase_margin_with_it(tmp_path):
    drive = law_margins(*read(axis_file(tmp_path)), True)
    estimated = law_margins(*read(axis_file(tmp_path, ESTIMATED)), True)
    assert drive.phase_deg + 4.0 < estimated.phase_deg < drive.phase_deg + 7.0  # 0.7 ms at 25 Hz are 6.4 deg
    assert estimated.gain == pytest.approx(drive.gain, rel=0.05)  # what is won by the delay the current's cut takes
    assert law_problems(*read(axis_file(tmp_path, ESTIMATED)), True) == []


def test_a_model_without_the_sensors_lag_has_nothing_to_give_back(tmp_path):
    model = "\n".join(line for line in MODEL.splitlines() if not line.startswith("sensor_delay_s")) + "\n"
    text = refused(axis_file(tmp_path, ESTIMATED, model=model))
    assert "controller.velocity.source" in text
    assert "fffo-drive identify" in text
    # nor where an unproven law is accepted
    assert "controller.velocity.source" in refused(
        axis_file(tmp_path, f"{ESTIMATED}\n  accept_unproven: true", model=model)
    )


def test_an_estimate_faster_than_the_loop_can_sample_is_refused(tmp_path):
    path = axis_file(tmp_path, "velocity: {source: estimated, bandwidth_hz: 300}")
    path.write_text(path.read_text() + "loop: {rate_hz: 1000}\n")
    text = refused(path)
    assert "controller.velocity.bandwidth_hz: 300 is more than 200 Hz" in text


def test_a_position_that_is_too_coarse_for_the_estimate_is_named_with_its_noise(tmp_path):
    path = axis_file(tmp_path, ESTIMATED, "axis_canopen")
    assert velocity_problems(*read(path)) == []
    path = axis_file(tmp_path, ESTIMATED, "axis_canopen", counts_per_rev=400)
    (text,) = velocity_problems(*read(path))
    assert "one count of 0x6064 is 0.0025 rev" in text
    assert "A in the command" in text


def test_gains_that_shake_on_the_drives_velocity_are_refused_for_the_estimate_may_be_lost(tmp_path):
    slow_sensor = MODEL.replace("value: 0.0007", "value: 0.0024")
    fast = {"proportional_a_per_rps": 3.2, "integral_a_per_rev": 20, "phase_margin_deg": 5, "gain_margin": 1}
    path = axis_file(
        tmp_path,
        "velocity: {source: estimated, bandwidth_hz: 390}\n  phase_margin_deg: 5\n  gain_margin: 1",
        model=slow_sensor,
        **fast,
    )
    axis, model = read(path)
    assert law_margins(axis, model, True).phase_deg > 30.0
    text = " ".join(law_problems(axis, model, True))
    assert "if the estimate is lost" in text


@pytest.mark.parametrize(
    ("velocity", "said"),
    [
        ("velocity: {source: kalman}", "controller.velocity.source"),
        ("velocity: {source: estimated, bandwidth_hz: 5000}", "controller.velocity.bandwidth_hz"),
        ("velocity: {source: estimated, bandwith_hz: 100}", "bandwidth_hz"),
    ],
)
def test_mistakes_are_named_by_their_key(tmp_path, velocity, said):
    assert said in refused(axis_file(tmp_path, velocity))


def test_tune_designs_for_the_delay_of_the_estimate_and_keeps_the_section(tmp_path, capsys):
    found = {}
    for name, velocity in (("drive", ""), ("estimated", "velocity: {source: estimated, bandwidth_hz: 390}")):
        folder = tmp_path / name
        folder.mkdir()
        path = axis_file(folder, velocity)
        out = folder / "tuned"
        assert main(["tune", str(folder / "model.yaml"), "--axis", str(path), "--out", str(out), "--json"]) == 0
        capsys.readouterr()
        found[name] = read_axis(out / "axis.yaml").controller
    assert found["estimated"].velocity.estimated
    assert found["estimated"].proportional_a_per_rps > 1.1 * found["drive"].proportional_a_per_rps

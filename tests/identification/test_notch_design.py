"""Notches that `tune` chooses for an elastic axis: margins, the plant in time, and what is written and said."""

from __future__ import annotations

import json
import math
import shutil
from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from trial_axes.robustness import STABLE, probe

from fffo_drive.cli import main
from fffo_drive.config.axis import controller_config, loop_axis, model_of, read_axis
from fffo_drive.config.checks import law_margins, law_problems
from fffo_drive.config.scenario import case_of, read_scenario
from fffo_drive.config.sections import ControllerSection
from fffo_drive.control.friction_observer import TOGGLE_FEEDFORWARD
from fffo_drive.control.notch import Notch, notch_config, notch_step, notches_at_rest
from fffo_drive.control.stability import ElasticLoad, linear_axis, loop_margins, margins_of
from fffo_drive.documents import DocumentError, check
from fffo_drive.drive.simulated.parameters import EffectConfig
from fffo_drive.evaluation.campaign import Candidate
from fffo_drive.identification import tuning
from fffo_drive.identification.tuning import NOTCH_GAIN, Wish, gains_in_motion, notches_for, resonances_hz
from fffo_drive.model.parameters import effect_model, read_model, write_model
from fffo_drive.workflows.tune import tune

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
TABLE_1 = read_model(CONFIGS / "models" / "table1.yaml")
AXIS = read_axis(CONFIGS / "axis_simulated.yaml")
PERIOD_S = 5e-4
WISH = Wish()
SHARE, DAMPING = 0.35, 0.03
RESONANCES_HZ = (45.0, 80.0, 110.0, 150.0, 250.0)


def elastic_model(frequency_hz, share=SHARE, damping=DAMPING, sd=None):
    values = {"share": share, "frequency_hz": frequency_hz, "damping": damping}
    return TABLE_1.model_copy(update={"effects": [effect_model("elasticity", values, {"frequency_hz": sd})]})


def elastic_axis(frequency_hz, **known):
    return linear_axis(elastic_model(frequency_hz, **known), PERIOD_S, error_filter_s=2e-4)


def action(axis):
    """Ki Kt + L within the margins; 0 where no gains have them."""
    proportional, integral, observer = gains_in_motion(axis, WISH)
    held = WISH.is_met(loop_margins(axis, proportional, integral, observer))
    return integral * axis.torque_constant_nm_per_a + observer if held else 0.0


@pytest.mark.parametrize("frequency_hz", RESONANCES_HZ)
def test_the_margins_hold_with_the_digits_of_a_file(frequency_hz, monkeypatch):
    """Here a file of two digits: Kp may lose a tenth and Ki nothing."""
    monkeypatch.setattr(tuning, "as_written", lambda value: 0.1 * math.floor(10.0 * value) if value > 0.1 else value)
    axis = elastic_axis(frequency_hz)
    axis = axis._replace(notches=notches_for(axis, WISH))
    gains = tuning.design(axis, 2.0, WISH).gains
    written = [tuning.as_written(gain) for gain in gains.in_motion]
    assert written[0] > 0.0
    assert WISH.is_met(loop_margins(axis, *written))


def test_an_axis_without_a_resonance_gets_no_notch():
    assert notches_for(linear_axis(TABLE_1, PERIOD_S), WISH) == ()
    stuck = linear_axis(TABLE_1, PERIOD_S)._replace(contact_nm_per_rev=30.0)
    assert resonances_hz(linear_axis(TABLE_1, PERIOD_S)) == []
    assert len(resonances_hz(stuck)) == 1  # by the response alone: the motor on its contact


@pytest.mark.parametrize("frequency_hz", RESONANCES_HZ)
def test_a_notch_is_there_only_where_it_gains_and_the_margins_hold_wherever_the_resonance_may_be(frequency_hz):
    axis = elastic_axis(frequency_hz)
    notched = axis._replace(notches=notches_for(axis, WISH))
    assert len(notched.notches) == (0 if frequency_hz == 250.0 else 1)
    gains = gains_in_motion(notched, WISH)
    for factor in (0.9, 0.93, 1.0, 1.04, 1.1):
        elastic = ElasticLoad(SHARE, factor * frequency_hz, DAMPING)
        margins = loop_margins(notched._replace(elastic=elastic, resonance_spread=0.0), *gains)
        assert margins.phase_deg > WISH.phase_margin_deg - 1.0
        assert margins.gain > 0.97 * WISH.gain_margin
    if notched.notches:
        assert action(notched) > NOTCH_GAIN * action(axis)
        (notch,) = notched.notches
        assert 0.8 * frequency_hz < notch.frequency_hz < 1.2 * frequency_hz
        assert not WISH.is_met(loop_margins(axis, *gains))  # the same gains without it


def test_the_spread_of_a_resonance_is_that_of_its_fit_where_it_is_wider():
    assert elastic_axis(110.0).resonance_spread == 0.1
    assert elastic_axis(110.0, sd=0.5).resonance_spread == 0.1
    assert elastic_axis(110.0, sd=11.0).resonance_spread == pytest.approx(0.196)
    assert elastic_axis(110.0, share=0.0).resonance_spread == 0.0


def test_the_gain_margin_counts_every_turn_of_the_phase():
    """A resonance at -540 degrees whose peak is below 1: more gain makes it unstable."""
    omega = 2.0 * math.pi * np.geomspace(0.1, 1000.0, 20_000)
    s, w = 1j * omega, 2.0 * math.pi * 300.0
    # at w the integrator has turned by 90 degrees, the resonance by none, the delay by 450
    loop = 50.0 / s * (1.0 + 0.5 * w * s / (s * s + 2.0 * 0.02 * w * s + w * w))
    at = 50.0 / w * (1.0 + 0.5 / (2.0 * 0.02))
    found = margins_of(omega, loop, 1.25 / 300.0)
    at_first = 50.0 / (2.0 * math.pi * 300.0 / 5.0)  # where the delay has turned by the first 90
    assert at > at_first
    assert found.gain == pytest.approx(1.0 / at, rel=0.01)


def rms_at_the_end(axis, gains, duration_s=3.0):
    """Velocity of the motor in time, after a kick: two masses, held commands, a delay, the kernel's own notches."""
    share, frequency_hz, damping_ratio = axis.elastic
    inertia, kt, period_s = axis.inertia_nm_s2_per_rev, axis.torque_constant_nm_per_a, axis.period_s
    motor, load, omega = (1.0 - share) * inertia, share * inertia, 2.0 * math.pi * frequency_hz
    reduced = motor * share
    stiff, damp = omega * omega * reduced, 2.0 * damping_ratio * omega * reduced
    # speed of the motor, speed of the load, twist; the last row is the held torque
    system = np.zeros((4, 4))
    system[0] = [-(axis.damping_nm_per_rps + damp) / motor, damp / motor, -stiff / motor, 1.0 / motor]
    system[1] = [damp / load, -damp / load, stiff / load, 0.0]
    system[2] = [1.0, -1.0, 0.0, 0.0]
    step = expm(system * period_s)
    waiting = deque([0.0] * round(axis.delay_s / period_s - 0.5))  # half a period is the hold
    config, notches = notch_config(axis.notches, period_s), notches_at_rest()
    state, integral, speeds = np.array([1.0, 1.0, 0.0, 0.0]), 0.0, []
    for _ in range(round(duration_s / period_s)):
        error, notches = notch_step(config, notches, -state[0])
        integral += (gains[1] * kt + gains[2]) * error * period_s
        waiting.append(gains[0] * kt * error + integral)
        state[3] = waiting.popleft()
        state = step @ state
        speeds.append(state[0])
    return float(np.sqrt(np.mean(np.square(speeds[-round(0.5 / period_s) :]))))


@pytest.mark.parametrize("frequency_hz", RESONANCES_HZ)
def test_the_loop_in_time_becomes_unstable_where_its_gain_margin_says(frequency_hz):
    axis = elastic_axis(frequency_hz)._replace(resonance_spread=0.0, error_filter_s=0.0, delay_s=6.5 * PERIOD_S)
    axis = axis._replace(notches=notches_for(axis, WISH) or (Notch(frequency_hz, 0.5, 0.2),))
    gains = gains_in_motion(axis, WISH)
    margin = loop_margins(axis, *gains).gain
    below, beyond = ([factor * margin * gain for gain in gains] for factor in (0.94, 1.06))
    assert rms_at_the_end(axis, below) < 1e-2
    assert rms_at_the_end(axis, beyond) > 1.0


@pytest.fixture(scope="module")
def paper_case():
    return case_of(read_scenario(CONFIGS / "scenarios" / "paper.yaml"), 1)


def on_plant(case, frequency_hz, section, model):
    axis = AXIS.model_copy(update={"controller": check(dict(section), ControllerSection, "tuned")})
    load = EffectConfig("elasticity", {"load_share": SHARE, "frequency_hz": frequency_hz, "damping": DAMPING})
    candidate = Candidate("tuned", TOGGLE_FEEDFORWARD, controller_config(axis, model))
    return probe(case._replace(plant=replace(case.plant, effects=(load,))), candidate)


@pytest.mark.slow
@pytest.mark.parametrize("frequency_hz", RESONANCES_HZ)
def test_the_simulated_drive_does_not_shake_after_tune_and_does_where_the_resonance_is_unknown(
    paper_case, frequency_hz
):
    model = elastic_model(frequency_hz)
    tuned = tune(model, loop_axis(AXIS, model), WISH)
    section = tuned.section(12.0)
    for place in (1.0, 0.9, 1.1):
        found = on_plant(paper_case, place * frequency_hz, section, model)
        assert found.verdict == STABLE, found
        assert found.hunting_rps < 0.01
    rigid = tune(TABLE_1, loop_axis(AXIS, TABLE_1), WISH).section(12.0)
    shakes = on_plant(paper_case, frequency_hz, rigid, TABLE_1).verdict != STABLE
    assert shakes == (frequency_hz in (80.0, 110.0, 150.0))


def test_what_tune_writes_is_read_back_says_the_notch_and_has_its_margins(tmp_path, capsys):
    for name in ("axis_simulated.yaml", "simulated_drive.yaml"):
        shutil.copy(CONFIGS / name, tmp_path / name)
    axis_path, model_path = tmp_path / "axis_simulated.yaml", tmp_path / "elastic.yaml"
    write_model(model_path, elastic_model(110.0))
    # notches of the file are not those of the design
    before = "controller:\n  notches: [{frequency_hz: 30}, {frequency_hz: 40}]\n"
    axis_path.write_text(axis_path.read_text().replace("controller:\n", before).replace("models/table1", "elastic"))
    out = tmp_path / "tuned"
    assert main(["tune", str(model_path), "--axis", str(axis_path), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "a notch at " in said
    assert "times the integral action within the margins" in said
    assert "the resonance of the load (35 % of the inertia) from 99 to 121 Hz" in said
    written = read_axis(out / "axis_simulated.yaml")
    assert len(written.controller.notches) == 1
    model = model_of(out / "axis_simulated.yaml", written)
    assert law_problems(written, model, True) == []
    assert WISH.is_met(law_margins(written, model, True))
    plain = written.model_copy(update={"controller": written.controller.changed({"notches": []})})
    problems = law_problems(plain, model, True)
    assert any("gain margin" in text and " --axis AXIS --out DIR` chooses a notch" in text for text in problems)
    page = json.loads((out / "report.json").read_text())
    assert page["results"]["integral_action_by_notches"] > NOTCH_GAIN


def test_a_resonance_that_leaves_no_gains_is_named_in_the_refusal():
    model = elastic_model(30.0, share=0.85, damping=0.0005)
    wish = Wish(bandwidth_hz=8.0, phase_margin_deg=70.0, gain_margin=6.0)
    with pytest.raises(DocumentError, match=r"the resonance of the load \(85 % of the inertia\) from 27 to 33 Hz"):
        tune(model, loop_axis(AXIS, model), wish)

"""The sweep of commissioning: the elastic load of a drive whose truth is known, none on a rigid one, and its record."""

from __future__ import annotations

import itertools
import math
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from commissioning.misdeclared import HIGHEST_A, HIGHEST_REV, HIGHEST_RPS, LOWEST_REV, MisdeclaredDrive
from commissioning.test_record import CONFIGS, axis_file, record_for
from commissioning.test_wrong_facts import BOUNDS, FACTS, PLAN, PLANT, SESSION
from hypothesis import given, settings
from hypothesis import strategies as st
from trial_axes.random_axis import wide_axis

from fffo_drive.cli import main
from fffo_drive.commissioning import procedure
from fffo_drive.commissioning.motion_checks import MOVED_REV, beliefs_of, contact, resonance
from fffo_drive.commissioning.procedure import NotAgreedError, commission
from fffo_drive.commissioning.record import content_hash, read_record, write_record
from fffo_drive.commissioning.sweep import PAIRS, SWEEP_S, response_record
from fffo_drive.config.axis import hold_dead_band_rev, loop_axis, read_axis
from fffo_drive.config.checks import law_problems, rest_margins
from fffo_drive.config.measured_axis import with_response
from fffo_drive.control.stability import (
    RIGID,
    ElasticLoad,
    LinearAxis,
    contact_nm_per_rev,
    impedance_nm_per_rps,
    loop_margins,
    mechanics_nm_per_rps,
    stuck_axes,
)
from fffo_drive.drive.port import DriveIdentity
from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig, paper_plant
from fffo_drive.identification.sweep_response import SweepLines, fit_contact, fit_sweep
from fffo_drive.model.parameters import effect_model
from fffo_drive.workflows.tune import other_contact, other_load

IDENTITY = DriveIdentity(1, 2, 3, 4, "a servo drive", "1.0")
GAIN = PLANT.torque_constant_nm_per_a / (2.0 * math.pi * PLANT.inertia_kg_m2)


def elastic(share, frequency_hz, damping):
    values = {"load_share": share, "frequency_hz": frequency_hz, "damping": damping}
    return (EffectConfig("elasticity", values),)


@pytest.fixture(scope="module")
def rigid():
    """The sweeps of a rigid axis, and their response."""
    with pytest.MonkeyPatch.context() as patch:
        made = []
        patch.setattr(procedure, "response_record", lambda sweeps: made.append(sweeps) or response_record(sweeps))
        _, response, _ = swept(PLANT)
    return made[0], response


def having(sweeps, measured):
    """These sweeps with nothing but these runs, before one that begins backwards, as the first and third did."""
    again = copy(sweeps)
    again.measured, again._slides, again._way = list(measured), True, -1.0
    return again


def swept(plant, bounds=BOUNDS):
    """The check, the response and all checks; the true shaft never left the bounds."""
    drive = MisdeclaredDrive(plant)
    outcome = commission(drive, SESSION, PLAN.model, FACTS, bounds)
    numbers = drive.port.numbers
    assert numbers[HIGHEST_RPS] < bounds.speed_rps
    assert -bounds.travel_rev < numbers[LOWEST_REV] <= numbers[HIGHEST_REV] < bounds.travel_rev
    assert numbers[HIGHEST_A] <= bounds.current_a
    checks = {check.name: check for check in outcome.checks}
    return checks["resonance"], outcome.response, checks


@pytest.mark.parametrize(
    "truth",
    [(0.35, 110.0, 0.03), (0.6, 32.0, 0.02), (0.05, 150.0, 0.03), (0.5, 380.0, 0.1), (0.3, 22.0, 0.01)],
)
def test_the_elastic_load_of_a_drive_is_found(truth):
    check, response, checks = swept(replace(PLANT, effects=elastic(*truth)))
    found, (share, frequency_hz, damping) = response.elastic, truth
    assert check.verdict == "warning"
    assert found.frequency_hz == pytest.approx(frequency_hz, rel=0.04)
    assert found.share == pytest.approx(share, abs=0.03)
    # friction takes power from a slow and wide resonance as well: its damping comes out too large
    assert found.damping == pytest.approx(damping, rel=0.25, abs=0.01 if frequency_hz > 50.0 else 0.06)
    assert response.gain_rps2_per_a == pytest.approx(GAIN, rel=0.03 if frequency_hz > 50.0 else 0.08)
    assert checks["torque_per_inertia"].measured == response.gain_rps2_per_a  # of motor and load
    assert checks["torque_per_inertia"].verdict == checks["delay"].verdict == "ok"
    assert response.delay_s == pytest.approx(PLANT.delay_s - 0.5 * PLANT.sync_period_s, abs=1.5e-4)
    assert "tune" in check.remedy


@pytest.mark.parametrize(
    "plant",
    [
        replace(PLANT, effects=(EffectConfig("cogging", {"amplitude_nm": 0.01}), EffectConfig("resolver_error", {}))),
        wide_axis(PlantConfig(), 5005).plant,  # cogging, friction by direction and angle
        wide_axis(PlantConfig(), 5017).plant,  # LuGre, another shape of presliding
        wide_axis(PlantConfig(), 5033).plant,  # an encoder; sticky patches
    ],
    ids=["cogging and resolver", "5005", "5017", "5033"],
)
def test_a_rigid_axis_has_no_elastic_load(plant):
    check, response, _ = swept(plant)
    assert check.verdict == "ok", check.text
    assert response.elastic is None


def test_the_default_axis_has_none(rigid):
    sweeps, response = rigid
    assert resonance(response).verdict == "ok"
    assert response.elastic is None


def test_the_noise_of_a_moving_position_is_that_of_its_counts_and_the_record_keeps_it(tmp_path):
    """Counts of a moving shaft are white noise of their variance, 1/12; at rest one of them may stay for ever."""
    coarse = replace(PLANT.resolver, bits=12, noise_rev=0.0)
    noise = commission(MisdeclaredDrive(replace(PLANT, resolver=coarse)), SESSION, PLAN.model, FACTS, BOUNDS).noise
    fast = np.array(noise.frequency_hz) > 100.0
    variance_rev2 = np.mean(np.array(noise.position_rev2_per_hz)[fast]) * 0.5 / PLANT.sync_period_s
    assert variance_rev2 == pytest.approx(2.0 ** (-2 * 12) / 12.0, rel=0.25)
    older = record_for(axis_file(tmp_path, named=False), IDENTITY)
    assert "noise" not in older.model_dump(mode="json")
    record = write_record(tmp_path / "record.yaml", older.model_copy(update={"noise": noise}))
    assert read_record(tmp_path / "record.yaml") == record
    assert record.noise == noise


@pytest.mark.parametrize("load", [(), elastic(0.35, 110.0, 0.03)], ids=["rigid", "elastic"])
def test_at_rest_the_contact_that_holds_the_axis_is_found_and_the_axis_stays(load):
    plant = replace(paper_plant(), effects=load)
    _, response, checks = swept(plant)
    softest, stiffest = response.contact_nm_per_rev(plant.torque_constant_nm_per_a)
    unloaded, _ = contact_nm_per_rev(PLAN.model)  # that of this plant: dF/dx of (2) and (3) at F = 0
    assert 0.5 * unloaded < softest < unloaded
    assert unloaded < stiffest < 1.2 * unloaded
    contacts = response.at_rest.contacts
    assert all(one.travel_rev < MOVED_REV for one in contacts)
    assert contacts[-1].current_a * plant.torque_constant_nm_per_a < PLAN.model.friction.static_nm.value
    assert contacts[0].contact_per_s2 > contacts[-1].contact_per_s2  # friction gives way the more it is loaded
    assert checks["contact"].verdict == "ok", checks["contact"].text
    assert "`tune` holds its margins at rest on it" in checks["contact"].text


def test_a_contact_that_is_not_the_model_s_is_a_warning_and_that_of_an_assumed_model_is_none():
    _, response, _ = swept(paper_plant())
    beliefs = beliefs_of(PLAN.model)
    assert contact(response, beliefs).verdict == "ok"
    soft, stiff = (10.0 * value for value in beliefs.contact_nm_per_rev)
    other = beliefs._replace(contact_nm_per_rev=(soft, stiff))
    assert contact(response, other).verdict == "warning"
    assert f"the model's contact has {soft:.3g} to {stiff:.3g} Nm/rev" in contact(response, other).text
    assert contact(response, other._replace(contact_assumed=True)).verdict == "ok"


def test_an_axis_that_no_rigid_inertia_explains_reaches_the_sweep_which_finds_its_load():
    plant = wide_axis(PlantConfig(), 6027).plant  # 43 % of the inertia at 149 Hz: pulses leave 70 % unexplained
    _, response, checks = swept(plant)
    assert response.elastic.frequency_hz == pytest.approx(149.4, rel=0.03)
    assert response.elastic.share == pytest.approx(0.425, abs=0.04)
    assert checks["motion"].verdict == "warning"
    assert "velocity variance unexplained: a load swings, see resonance" in checks["motion"].text
    assert checks["torque_per_inertia"].measured == response.gain_rps2_per_a


def test_behind_backlash_no_resonance_and_no_contact_is_read_and_both_are_said():
    check, response, checks = swept(wide_axis(PlantConfig(), 6036).plant)
    assert response.elastic is None
    assert response.at_rest is None
    assert check.verdict == checks["contact"].verdict == "warning"
    assert "neither as one inertia nor as one with a load on a spring" in check.text
    assert "cannot tell: the axis at rest does not answer as one" in checks["contact"].text


def test_a_sensor_that_does_not_show_the_axis_at_rest_is_named_and_one_that_does_finds_its_spring():
    moving = fit_sweep(made_lines(RIGID, 0.003, 1), 0.003)
    s = 2j * np.pi * moving_hz()
    stuck = moving.gain_rps2_per_a * np.exp(-s * moving.delay_s) / (s + 30.0 + (2.0 * np.pi * 30.0) ** 2 / s)
    random = np.random.default_rng(1)
    for noise_rps_per_a, doubt in ((0.02, ""), (20.0, "the sensor hardly shows")):
        noise = noise_rps_per_a * (random.normal(size=s.size) + 1j * random.normal(size=s.size)) / math.sqrt(2.0)
        fit = fit_contact(SweepLines(moving_hz(), stuck + noise, np.full(s.size, noise_rps_per_a)), moving)
        assert fit.doubt.startswith(doubt)
        assert bool(fit.doubt) == bool(doubt)
        if not doubt:
            assert math.sqrt(fit.contact_per_s2) == pytest.approx(2.0 * np.pi * 30.0, rel=0.02)


def moving_hz():
    return np.arange(10.5, 400.0)


def test_margins_at_rest_stand_on_the_contact_that_was_measured_and_older_records_keep_their_hash():
    plant, model = paper_plant(), PLAN.model
    _, response, _ = swept(plant)
    without = response.model_copy(update={"at_rest": None})
    assert "at_rest" not in without.model_dump(mode="json")
    known = loop_axis(PLAN.axis, model)
    dead_band_rev = hold_dead_band_rev(PLAN.axis)
    by_model = stuck_axes(with_response(known, model, without), model, dead_band_rev)
    assert by_model[0].contact_nm_per_rev == stuck_axes(known, model, dead_band_rev)[0].contact_nm_per_rev
    axis = with_response(known, model, response)
    soft, stiff = stuck_axes(axis, model, dead_band_rev)
    softest, stiffest = response.contact_nm_per_rev(model.torque_constant_nm_per_a)
    assert soft.contact_nm_per_rev == pytest.approx(softest / 1.2)
    assert stiff.contact_nm_per_rev == pytest.approx(stiffest * 1.2)
    assert stiff.contact_nm_per_rev < by_model[1].contact_nm_per_rev  # of a contact that this axis does not have
    assert other_contact(model, axis) == []
    (sentence,) = other_contact(model, axis._replace(measured_contact_nm_per_rev=(500.0, 600.0)))
    assert "commissioning measured 500 to 600: the measured one counts" in sentence


def test_small_bounds_are_kept_and_what_they_do_not_allow_is_said():
    bounds = BOUNDS._replace(travel_rev=0.3, speed_rps=3.0)
    check, *_ = swept(replace(PLANT, effects=elastic(0.35, 110.0, 0.03)), bounds)
    late = BOUNDS._replace(time_s=12.0)  # enough for all but the sweep
    check, response, checks = swept(PLANT, late)
    assert (check.verdict, response) == ("warning", None)
    assert "moved for 12 s" in check.text
    assert "tune" in check.remedy
    assert "the response in motion was not measured" in checks["contact"].text


def test_the_sweep_is_asked_for_with_its_speed_and_how_far_it_goes():
    asked = []

    def may_move(motion):
        asked.append(motion)
        return "resonance" not in motion.checks

    with pytest.raises(NotAgreedError):
        commission(MisdeclaredDrive(PLANT), SESSION, PLAN.model, FACTS, BOUNDS, may_move=may_move)
    assert asked[-1].checks == ("resonance",)
    assert "10 to 400 Hz" in asked[-1].text
    assert "5 rps and 2 rev" in asked[-1].text


@settings(max_examples=8, deadline=None)
@given(
    share=st.floats(0.05, 0.6),
    frequency_hz=st.floats(22.0, 380.0),
    damping=st.floats(0.01, 0.1),
    delay_s=st.floats(0.0015, 0.008),
    seed=st.integers(0, 2**16),
)
def test_the_fit_finds_what_the_response_was_made_of(share, frequency_hz, damping, delay_s, seed):
    lines = made_lines(ElasticLoad(share, frequency_hz, damping), delay_s, seed)
    fit = fit_sweep(lines, 0.003)
    assert fit.elastic.frequency_hz == pytest.approx(frequency_hz, rel=0.02)
    assert fit.elastic.share == pytest.approx(share, abs=0.04)
    assert fit.delay_s == pytest.approx(delay_s, abs=3e-4)


def made_lines(load, delay_s, seed, noise=0.01):
    frequency_hz = moving_hz()
    s = 2j * np.pi * frequency_hz
    response = 157.0 * np.exp(-s * delay_s) / (mechanics_nm_per_rps(1.0, load, s) + 3.0)
    random = np.random.default_rng(seed)
    error = noise * np.abs(response)
    response = response + error * (random.normal(size=s.size) + 1j * random.normal(size=s.size)) / math.sqrt(2.0)
    return SweepLines(frequency_hz, response, error)


def test_noise_alone_is_no_resonance():
    found = [fit_sweep(made_lines(RIGID, 0.003, seed, noise), 0.003) for seed in range(3) for noise in (0.01, 0.1)]
    assert all(fit.elastic == RIGID for fit in found)


def test_a_drive_that_answers_late_is_fitted_from_the_delay_that_the_pulses_found():
    fit = fit_sweep(made_lines(RIGID, 0.0125, 1), 0.0122)
    assert fit.delay_s == pytest.approx(0.0125, abs=1e-4)
    assert fit.gain_rps2_per_a == pytest.approx(157.0, rel=0.02)


def without_answers(sweeps, gap_s):
    """The same runs where no feedback came for so long, three quarters through the last sweep but one."""
    period_s = PLANT.sync_period_s
    first = sweeps._samples(2 * PAIRS)[-round(1.25 * SWEEP_S / period_s)]
    after = first + round(gap_s / period_s)
    return [motion.part((motion.sample < first) | (motion.sample >= after)) for motion in sweeps.measured]


def test_a_run_in_which_feedback_was_missing_is_made_again(rigid):
    sweeps, _ = rigid
    whole = sweeps.measured
    torn, nearly = (without_answers(sweeps, gap_s) for gap_s in (0.004, 0.001))
    axis = read_axis(CONFIGS / "axis_bench.yaml")
    true = np.array(response_record(having(sweeps, whole)).gain_rps_per_a)

    def worst(measured):
        axis._response = response_record(having(sweeps, measured))
        assert rest_margins(axis, PLAN.model).gain > 1.0  # single lines make no stable axis an unstable one
        return np.abs(np.log(np.array(axis._response.gain_rps_per_a) / true)).max()

    assert worst(torn) > 2.0 * worst(nearly)
    again = having(sweeps, [])
    for motion in (torn[0], whole[1], torn[2], torn[1], nearly[0], whole[1]):  # in turn backwards and forwards
        assert again.refusal is None
        assert not again.done
        again.made(motion)
    assert again.done
    assert [id(motion) for motion in again.measured] == [id(one) for one in (whole[1], nearly[0], whole[1])]


def test_a_response_without_a_whole_run_is_not_measured_and_said(rigid):
    sweeps, _ = rigid
    late = having(sweeps, [])
    torn = itertools.cycle(without_answers(sweeps, 0.004)[:2])
    while late.refusal is None:
        late.made(next(torn))
    assert late.measured == []
    check = resonance(late.refusal)
    assert check.verdict == "warning"
    assert "feedback was missing for more than 1 ms" in check.text
    assert "realtime." in check.remedy


def test_a_record_keeps_the_response_and_an_older_one_its_hash(tmp_path):
    path = axis_file(tmp_path, named=False)
    older = record_for(path, IDENTITY)
    assert "response" not in older.model_dump(mode="json")
    _, response, _ = swept(replace(PLANT, effects=elastic(0.35, 110.0, 0.03)))
    record = write_record(tmp_path / "record.yaml", older.model_copy(update={"response": response}))
    again = read_record(tmp_path / "record.yaml")
    assert again == record
    assert again.response == response
    assert content_hash(again) != content_hash(older)
    assert write_record(tmp_path / "older.yaml", older) == read_record(tmp_path / "older.yaml")


def test_the_axis_of_the_margins_is_the_drive_itself_with_the_filter_of_its_velocity():
    truth, sigma = ElasticLoad(0.35, 110.0, 0.03), 0.003
    _, response, _ = swept(replace(PLANT, effects=elastic(*truth)))
    kt, inertia = PLANT.torque_constant_nm_per_a, 2.0 * math.pi * PLANT.inertia_kg_m2
    model = LinearAxis(inertia, sigma, PLANT.delay_s, kt)
    measured = with_response(model, PLAN.model, response)
    s = 2j * np.pi * np.geomspace(15.0, 250.0, 200)
    resolver = PLANT.resolver
    normal = s / (2.0 * np.pi * resolver.tracking_hz)
    filtered = 1.0 / (1.0 + 2.0 * resolver.tracking_damping * normal + normal**2)
    lag_s = resolver.tracking_damping / (np.pi * resolver.tracking_hz)
    true = filtered * np.exp(-s * (PLANT.delay_s - lag_s)) / (mechanics_nm_per_rps(inertia, truth, s) + sigma)
    ratio = np.exp(-s * measured.delay_s) / impedance_nm_per_rps(measured, s) / true
    assert np.percentile(np.abs(20.0 * np.log10(np.abs(ratio))), 95) < 1.0  # dB
    assert np.percentile(np.abs(np.degrees(np.angle(ratio))), 95) < 7.0
    # a proportional gain that a rigid axis takes shakes this one
    gains = (0.9, 10.0, 3.0)
    assert loop_margins(model, *gains).gain > 1.8
    assert loop_margins(measured, *gains).gain < 1.0
    # without its elastic load the points alone carry the resonance
    alone = with_response(model, PLAN.model, response.model_copy(update={"elastic": None}))
    assert loop_margins(alone, *gains).gain < 1.1


def test_tune_holds_its_margins_on_the_record_that_the_axis_file_names_and_says_what_counts(tmp_path, capsys):
    plan_path = tmp_path / "axis.yaml"
    text = (CONFIGS / "axis_simulated.yaml").read_text()
    text = text.replace("models/table1.yaml", str(CONFIGS / "models" / "table1.yaml"))
    text = text.replace("simulated_drive.yaml", str(CONFIGS / "simulated_drive.yaml"))
    plan_path.write_text(text + "\ncommissioning: record.yaml\n")
    axis, model = read_axis(plan_path), PLAN.model
    rigid = loop_axis(axis, model)
    assert rigid.measured is None
    _, response, _ = swept(replace(PLANT, effects=elastic(0.35, 110.0, 0.03)))
    write_record(tmp_path / "record.yaml", record_for(plan_path, IDENTITY).model_copy(update={"response": response}))
    axis = read_axis(plan_path)
    found = loop_axis(axis, model)
    assert found.elastic.frequency_hz == pytest.approx(110.0, rel=0.02)
    assert found.inertia_nm_s2_per_rev == rigid.inertia_nm_s2_per_rev
    problems = law_problems(axis, model, True)
    assert any("gain margin" in text for text in problems)  # the file's gains are those of a rigid axis
    words = ["tune", str(CONFIGS / "models" / "table1.yaml"), "--axis", str(plan_path), "--out", str(tmp_path / "t")]
    assert main(words) == 0
    said = capsys.readouterr()
    assert "margins from the response that commissioning measured, 10 to 395 Hz; at rest from the contact" in said.out
    assert "a notch at" in said.out
    tuned = read_axis(tmp_path / "t" / "axis.yaml")
    assert law_problems(tuned, model, True) == []
    # a model of another elastic load, or of one that is gone, does not count in silence
    other = effect_model("elasticity", {"share": 0.2, "frequency_hz": 60.0, "damping": 0.03}, {})
    with_other = model.model_copy(update={"effects": [other]})
    known = loop_axis(axis, with_other)
    assert known.elastic == found.elastic
    (sentence,) = other_load(with_other, known)
    assert "20 % of the inertia at 60 Hz" in sentence
    assert "110 Hz: the response counts" in sentence
    assert other_load(model, found) == []

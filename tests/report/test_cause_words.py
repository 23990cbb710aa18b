"""Sentences about effects: what a machine's owner reads, from the numbers of a finding."""

from __future__ import annotations

import pytest
from report.test_diagnose_report import TABLE_1, finding

from fffo_drive.diagnosis.results import Number
from fffo_drive.model.effects.registry import LAWS, law_of
from fffo_drive.model.parameters import read_model
from fffo_drive.report.cause_words import SAID, in_words, sized
from fffo_drive.report.diagnose_figures import LINEAR, ROTARY

MODEL = read_model(TABLE_1)  # sigma 0.026 Nm/rps or so: shares are of it
VISCOUS = MODEL.friction.viscous_nm_per_rps.value


def effect(name, torque_rms_nm=0.008, per_run=(), **values):
    parameters = tuple(
        Number(key, value, None, next(p.unit for p in law_of(name).parameters if p.name == key), run)
        for key, value in values.items()
        for run in (per_run or (None,))
    )
    return finding(name=name, alternatives=(), parameters=parameters, torque_rms_nm=torque_rms_nm)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (26.348, "Nm", "26 Nm"),
        (1.0, "N", "1.0 N"),
        (0.0123, "Nm", "12 mNm"),
        (4.2e-5, "Nm", "42 µNm"),
        (0.0, "Nm", "0 Nm"),
        (0.0031, "s", "3.1 ms"),
        (0.012, "rev", "0.012 rev"),  # nobody says millirevolutions
    ],
)
def test_a_size_is_written_as_a_person_would(value, unit, text):
    assert sized(value, unit) == text


@pytest.mark.parametrize(
    ("found", "text"),
    [
        (
            effect("asymmetric_viscous", excess_nm_per_rps=-0.2 * VISCOUS),
            f"viscous friction is {sized(0.2 * VISCOUS, 'Nm/rps')} (20 %) higher backwards and the same amount lower "
            "forwards",
        ),
        (
            effect("asymmetric_coulomb", share=0.1),
            "sliding friction is 10 % higher forwards and the same amount lower backwards",
        ),
        (effect("torque_offset", torque_nm=0.003), "a constant torque of 3.0 mNm pulls backwards"),
        (
            effect("cogging", cos_nm=0.03, sin_nm=-0.04, order=72.0),
            "a torque of ±50 mNm with 72 periods per motor turn",
        ),
        (effect("delay", delay_s=0.0021), "torque comes 2.1 ms later than the model says"),
        (
            effect("quadratic_drag", drag_nm_per_rps2=1.2e-4),
            "drag grows with the square of the speed, 120 µNm/rps2",
        ),
        (
            effect("position_dependent_friction", cos_share=0.03, sin_share=0.04, period_rev=12.0),
            "friction varies by up to 5.0 % along the travel",
        ),
        (
            effect("frictional_lag", share=0.3, length_rev=0.05),
            "30 % of the friction follows a change of speed only over 0.050 rev of travel",
        ),
        (effect("coulomb_drift", share=-0.25, tau_s=30.0), "sliding friction falls by 25 % (time constant 30 s)"),
    ],
)
def test_a_cause_is_told_in_words_of_a_machine(found, text):
    assert in_words(found, MODEL, ROTARY) == f"{text} (8.0 mNm rms)"


def test_a_wave_with_a_phase_for_each_run_has_one_amplitude():
    found = effect("unbalance", cos_nm=0.0, sin_nm=0.0, ratio=1.0)
    numbers = (
        Number("cos_nm", 3.0, None, "Nm", "a"),
        Number("sin_nm", 4.0, None, "Nm", "a"),
        Number("cos_nm", -5.0, None, "Nm", "b"),
        Number("sin_nm", 0.0, None, "Nm", "b"),
    )
    found = finding(name="unbalance", alternatives=(), parameters=numbers, torque_rms_nm=3.5)
    said = "the weight of the load needs up to 5.0 Nm at the motor shaft, depending on the output angle (3.5 Nm rms)"
    assert in_words(found, MODEL, ROTARY) == said


def test_on_a_linear_axis_there_are_newtons_and_metres():
    found = effect("asymmetric_viscous", 3.0, excess_nm_per_rps=41.0)
    assert in_words(found, None, LINEAR) == (
        "viscous friction is 41 N s/m higher forwards and the same amount lower backwards (3.0 N rms)"
    )
    assert "backlash of 12 µm at the motor" in in_words(effect("backlash", share=0.4, gap_rev=1.2e-5), None, LINEAR)


@pytest.mark.parametrize("name", [name for name in LAWS if name != "lookup"])
def test_every_law_has_words(name):
    law = law_of(name)
    found = effect(name, **{p.name: p.typical for p in law.parameters})
    text = in_words(found, MODEL, ROTARY)
    assert "8.0 mNm rms" in text
    assert (name in SAID) != (law.meaning in text)


def test_only_laws_have_sentences():
    assert SAID.keys() <= LAWS.keys()

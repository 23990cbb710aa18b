"""The whole diagnosis on a simulated axis whose truth is known: found by name, not invented, proven on a run apart."""

from dataclasses import replace

import numpy as np
import pytest
from identification.rig import random_plant, record
from identification.synthetic import PERIOD_S

from fffo_drive.control.reference import MODE_VELOCITY, Profile
from fffo_drive.diagnosis.base import NAMES
from fffo_drive.diagnosis.diagnose import DiagnosisSettings, base_figures, delay_finding, diagnose
from fffo_drive.diagnosis.fitting import Fitted
from fffo_drive.diagnosis.results import report
from fffo_drive.drive.simulated.parameters import EffectConfig
from fffo_drive.identification.dataset import DataError
from fffo_drive.identification.excitation import identification_sequence, separating_recipe
from fffo_drive.identification.facts import DriveFacts

FACTS = DriveFacts(torque_constant_nm_per_a=0.148, rated_current_a=8.3, gear_ratio=160.0, resolver_bits=15)
SEED = 5


def multisine(seed, duration_s=20.0, top_rps=12.0):
    time_s = np.arange(round(duration_s / PERIOD_S)) * PERIOD_S
    draw = np.random.default_rng(seed)
    wave = sum(
        np.sin(2 * np.pi * f * time_s + draw.uniform(0, 2 * np.pi)) / np.sqrt(f) for f in (0.11, 0.23, 0.47, 0.9, 1.7)
    )
    values = top_rps * wave / np.abs(wave).max() * np.minimum(1.0, np.minimum(time_s, time_s[::-1]) / 2.0)
    return Profile("track", MODE_VELOCITY, PERIOD_S, values, np.gradient(values, PERIOD_S))


def runs(*effects):
    plant = replace(random_plant(SEED), roughness_nm=2e-4, effects=effects)
    fit = [
        record(plant, identification_sequence(24.0, PERIOD_S, 0.5, 1.1, 0.1, 10.0), "identify"),
        record(plant, separating_recipe(PERIOD_S, 12.0, 80.0, 1), "recipe"),
    ]
    return fit, [record(replace(plant, seed=99), multisine(1), "check")]


@pytest.mark.slow
def test_an_undeclared_effect_is_named_and_the_held_out_error_falls():
    fit, held_out = runs(EffectConfig("asymmetric_viscous", {"share": 0.4}))
    shares = []
    found = diagnose(fit, held_out, FACTS, progress=lambda share, text: shares.append(share))
    content = report(found)
    assert content["verdict"] == "effects_found"
    first = content["effects"][0]
    assert first["name"] == "asymmetric_viscous"
    assert first["accepted"]
    assert first["false_alarm_probability"] < 0.01
    before, after = content["before"]["held_out"], content["after"]["held_out"]
    assert after["torque_rms_nm"] ** 2 < 0.2 * before["torque_rms_nm"] ** 2
    assert after["velocity_rms_rps"] < 0.5 * before["velocity_rms_rps"]
    assert [e.name for e in found.model_after.effects] == ["asymmetric_viscous"]
    assert not found.model_before.effects
    assert shares == sorted(shares)
    assert base_figures(fit, held_out, FACTS).torque_rms_nm.value == pytest.approx(before["torque_rms_nm"], rel=0.1)


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is():
    fit, held_out = runs()
    found = diagnose(fit, held_out, FACTS)
    assert found.verdict == "no_effect_found"
    assert not found.findings
    assert found.after == found.before


def test_a_delay_is_judged_by_what_is_declared():
    physical = np.zeros(len(NAMES))
    physical[NAMES.index("delay_s")] = 0.0052
    fitted = Fitted(physical, (), 1.0, np.zeros(1), np.zeros(1))
    (usual,) = delay_finding(fitted, FACTS, DiagnosisSettings())
    assert usual.parameters[0].value == pytest.approx(0.0022)
    assert "nominal_delay_s" in usual.reason
    assert delay_finding(fitted, FACTS.model_copy(update={"nominal_delay_s": 0.005}), DiagnosisSettings()) == []
    (declared,) = delay_finding(fitted, FACTS.model_copy(update={"nominal_delay_s": 0.001}), DiagnosisSettings())
    assert declared.parameters[0].value == pytest.approx(0.0042)
    assert "1.00 ms are declared" in declared.reason
    assert delay_finding(fitted, FACTS.model_copy(update={"units": "linear"}), DiagnosisSettings()) == []


def test_no_runs_are_refused():
    with pytest.raises(DataError, match="no runs"):
        diagnose([], [], FACTS)

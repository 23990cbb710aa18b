"""A friction of two surfaces: reported as its form, with its constants, and never as an effect beside it."""

import json

import numpy as np
import pytest
from diagnosis.planted import FACTS, NOISE_NM, only, runs

from fffo_drive.diagnosis.diagnose import DiagnosisSettings, diagnose
from fffo_drive.diagnosis.results import report

RISE_NM, TRAVEL_REV, SPEED_RPS, MEMORY_REV = 0.02, 0.06, 0.4, 0.12
SETTINGS = DiagnosisSettings(
    without=only("second_surface", "presliding_shape", "dwell_stiction", "quadratic_drag", "cogging"),
    ablate=frozenset({"curves"}),
)


def second_surface(motion):
    """Step by step as the equations have it: dz/dx = (sgn w - z)/travel, dm/dx = (exp(-|w|/v) - m)/memory."""
    torque = np.zeros(motion.time_s.size)
    steps = np.diff(motion.position_rev, prepend=motion.position_rev[:1])
    z, m = 0.0, 1.0
    for k, (step, speed) in enumerate(zip(steps, motion.velocity_rps, strict=True)):
        z += (1.0 - np.exp(-abs(step) / TRAVEL_REV)) * (np.sign(step) - z)
        m += (1.0 - np.exp(-abs(step) / MEMORY_REV)) * (np.exp(-abs(speed) / SPEED_RPS) - m)
        torque[k] = z * RISE_NM * m
    return torque


def test_a_second_surface_is_the_form_of_the_friction_and_has_the_constants_it_was_made_with():
    found = diagnose(
        runs(second_surface, second_surface, duration_s=14.0), runs(second_surface, seed=31), FACTS, settings=SETTINGS
    )
    said = report(found)
    assert [one for one in said["effects"] if one["accepted"]] == []
    (form,) = said["friction_form"]
    assert form["name"] == "second_surface"
    numbers = form["parameters"]
    assert numbers["travel_rev"] == pytest.approx(TRAVEL_REV, rel=0.25)
    assert numbers["speed_rps"] == pytest.approx(SPEED_RPS, rel=0.25)
    assert numbers["memory_rev"] == pytest.approx(MEMORY_REV, rel=0.25)
    assert numbers["level_nm"] + numbers["rise_nm"] == pytest.approx(RISE_NM, rel=0.15)
    assert found.verdict == "no_effect_found"
    assert "not that of a single surface: second_surface" in found.headline
    assert found.after.torque_rms_nm.value < NOISE_NM < found.before.torque_rms_nm.value
    assert [effect.name for effect in found.model_after.effects] == ["second_surface"]
    json.dumps(said, default=float)

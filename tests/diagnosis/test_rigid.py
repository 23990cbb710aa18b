"""A rigid linear axis: an effect that was put in is found by name and size, nothing is found where nothing is; EMPS."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from shared_data import shared_files

from fffo_drive.diagnosis.diagnose import diagnose
from fffo_drive.identification.dataset import Record, load_record
from fffo_drive.identification.facts import DriveFacts, read_facts

FACTS = DriveFacts(torque_constant_nm_per_a=35.0, units="linear", position_lsb_rev=5e-8, sample_rate_hz=1000)
EMPS = Path(__file__).resolve().parents[1] / "identification" / "emps.yaml"
MASS, VISCOUS, COULOMB, OFFSET = 95.0, 205.0, 20.0, -3.0
PERIOD_S = 0.001


def motion(seed):
    """A smooth motion that is repeated: speeds both ways, without a rest. Position, velocity, acceleration (n,)."""
    draw = np.random.default_rng(seed)
    time_s = np.arange(24_000) * PERIOD_S
    velocity, acceleration = np.zeros_like(time_s), np.zeros_like(time_s)
    for number in range(1, 16):
        omega, phase, size = 2 * np.pi * number / 6.0, draw.uniform(0, 2 * np.pi), draw.uniform(0.2, 1.0) / number**0.5
        velocity += size * np.sin(omega * time_s + phase)
        acceleration += size * omega * np.cos(omega * time_s + phase)
    scale = 0.12 / np.abs(velocity).max()
    position = scale * PERIOD_S * (np.cumsum(velocity) - 0.5 * velocity)
    return position, scale * velocity, scale * acceleration


def record(effect, seed=1, name="fit"):
    """A record whose force has `effect(position, velocity, acceleration)` (N) in it."""
    position, velocity, acceleration = motion(seed)
    draw = np.random.default_rng(seed + 100)
    force = MASS * acceleration + VISCOUS * velocity + COULOMB * np.sign(velocity) + OFFSET
    force += effect(position, velocity, acceleration)
    rough = np.convolve(draw.normal(size=force.size), np.ones(40) / 40, "same")  # a surface is a little rough
    force = force + 2.0 * rough
    # the command that is, held, this force: the mean of a sample and the one before
    current = np.zeros_like(force)
    current[0] = force[0]
    smooth = 0.5 * (force + np.roll(force, -1))
    current[:-1] = smooth[:-1]
    current[-1] = force[-1]
    return Record(
        name=name, path=Path(name), period_s=PERIOD_S, torque_constant_nm_per_a=35.0, current_a=current / 35.0,
        position_rev=np.round(position / 5e-8) * 5e-8, velocity_rps=None, reference_rps=velocity, lsb_rev=5e-8,
        breaks=(), digest="",
    )  # fmt: skip


def nothing(position, velocity, acceleration):
    return 0.0


def asymmetric(position, velocity, acceleration):
    return 40.0 * np.abs(velocity)


@pytest.mark.slow
def test_viscous_friction_that_differs_by_direction_is_found_and_takes_the_error_away():
    found = diagnose([record(asymmetric)], [record(asymmetric, 2, "held out")], FACTS)
    accepted = [finding for finding in found.findings if finding.accepted]
    first = next(finding for finding in accepted if finding.name == "asymmetric_viscous")
    # OFFSET is there; what is not is the open false finding of `test_nothing_is_found_where_nothing_is`
    known = {"presliding_shape", "stribeck_shape"}
    assert {finding.name for finding in accepted} - known <= {"asymmetric_viscous", "torque_offset"}
    assert first.false_alarm_probability <= 0.01
    assert {n.name: n.value for n in first.parameters}["excess_nm_per_rps"] == pytest.approx(40.0, rel=0.15)
    assert found.after.torque_rms_nm.value < 0.6 * found.before.torque_rms_nm.value
    assert found.units == "linear"
    assert found.verdict == "effects_found"
    masses = [2 * np.pi * model.inertia_kg_m2.value for model in (found.model_before, found.model_after)]
    assert masses == pytest.approx([MASS, MASS], rel=0.02)


@pytest.mark.slow
def test_a_periodic_effect_is_found_and_its_datum_on_the_first_part_of_another_run():
    def cogging(position, velocity, acceleration):
        return 3.0 * np.cos(2 * np.pi * 37.0 * position)

    found = diagnose([record(cogging)], [record(cogging, 2, "held out")], FACTS)
    first = next(finding for finding in found.findings if finding.accepted and finding.name == "cogging")
    assert {n.name: n.value for n in first.parameters}["order"] == pytest.approx(37.0, rel=0.01)
    assert any("datum" in text for text in found.cautions)
    assert first.held_out_gain is not None
    assert first.held_out_gain[0] > 0.0


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="friction that turns at once is reported as one that takes some travel to turn")
def test_nothing_is_found_where_nothing_is():
    accepted = [
        finding.name
        for seed in (3, 4)
        for finding in diagnose([record(nothing, seed)], [], FACTS).findings
        if finding.accepted
    ]
    assert set(accepted) <= {"torque_offset"}  # OFFSET is there


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_emps_held_out_error_falls_to_what_is_asked_for():
    paths = [path for name in ("DATA_EMPS", "DATA_EMPS_PULSES") for path in shared_files(f"emps/{name}.mat")]
    facts = read_facts(EMPS)
    fit, held_out = (load_record(path, facts) for path in paths)
    found = diagnose([fit], [held_out], facts)
    accepted = [finding for finding in found.findings if finding.accepted]
    assert accepted
    assert all(finding.reason and finding.false_alarm_probability <= 0.01 for finding in accepted)
    assert found.after.torque_relative_percent.value < 3.1

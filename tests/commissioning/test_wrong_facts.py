"""A drive with one wrong fact: exactly the check that is about it fails, and says what to do; no bound is broken."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commissioning.misdeclared import HIGHEST_A, HIGHEST_REV, HIGHEST_RPS, LOWEST_REV, MisdeclaredDrive, TalkingDrive
from trial_axes.random_axis import wide_axis

from fffo_drive.commissioning.bounds import BoundsError, make_bounds
from fffo_drive.commissioning.estimate import LARGEST_UNEXPLAINED, RIGID_UNEXPLAINED
from fffo_drive.commissioning.judge import CHECKS
from fffo_drive.commissioning.procedure import commission
from fffo_drive.commissioning.record import DeclaredFacts, overall
from fffo_drive.config.commissioning import declared_facts
from fffo_drive.drive.simulated.cia402_device import OPERATION_ENABLED
from fffo_drive.drive.simulated.parameters import DeviceConfig, EffectConfig, PlantConfig, paper_plant
from fffo_drive.workflows.plan import make_plan, plan_session

pytestmark = pytest.mark.slow

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PLAN = make_plan(CONFIGS / "axis_simulated.yaml")
SESSION = plan_session(PLAN)
BOUNDS = make_bounds(SESSION.envelope)
FACTS = declared_facts(PLAN.axis, PLAN.model)
PLANT = PlantConfig()


def of_plant(**changes):
    return {"plant": replace(PLANT, **changes)}


def checks_of(drive, facts=FACTS, bounds=BOUNDS, session=SESSION):
    """All checks by name; the drive was left alone, without torque, and never left the bounds."""
    said = []
    outcome = commission(drive, session, PLAN.model, facts, bounds, said.append)
    assert [check.name for check in outcome.checks] == list(CHECKS)
    assert drive.connected == 0
    assert drive.inner.device_state != OPERATION_ENABLED
    assert outcome.identity.device_name == "simulated drive, in process"
    assert said
    numbers = drive.port.numbers
    assert numbers[HIGHEST_RPS] < bounds.speed_rps
    assert -bounds.travel_rev < numbers[LOWEST_REV] <= numbers[HIGHEST_REV] < bounds.travel_rev
    assert numbers[HIGHEST_A] <= bounds.current_a
    return {check.name: check for check in outcome.checks}


def failed(checks):
    return {name for name, check in checks.items() if check.verdict == "failed"}


def warned(checks):
    return {name for name, check in checks.items() if check.verdict == "warning"}


@pytest.mark.parametrize("plant", [PLANT, paper_plant(), replace(PLANT, seed=7), replace(PLANT, initial_angle_rev=0.3)])
def test_a_drive_as_declared_passes_everything(plant):
    checks = checks_of(MisdeclaredDrive(plant))
    assert overall(list(checks.values())) == "ok", [c for c in checks.values() if c.verdict != "ok"]
    assert not any(check.remedy for check in checks.values())
    assert checks["delay"].measured == pytest.approx(0.00275, abs=1e-4)
    assert checks["velocity_age"].measured == pytest.approx(0.0007, abs=1e-4)
    assert checks["velocity_scale"].measured == pytest.approx(1.0, abs=2e-3)
    assert checks["torque_per_inertia"].measured == pytest.approx(157.0, rel=0.08)
    assert checks["velocity_update"].measured == pytest.approx(5e-4)


def test_an_axis_whose_brake_opens_late_passes_everything():
    session = SESSION._replace(loop=SESSION.loop._replace(enable_delay_ticks=600))
    checks = checks_of(MisdeclaredDrive(PLANT), session=session)
    assert overall(list(checks.values())) == "ok", [c for c in checks.values() if c.verdict != "ok"]
    assert checks["delay"].measured == pytest.approx(0.00275, abs=1e-4)


# what is wrong -> the check that fails, a part of its remedy
WRONG = [
    ({"torque": -1.0}, "torque_sign", "phases"),
    ({"velocity": -1.0}, "velocity_sign", "0x607E"),
    ({"velocity": 0.0}, "velocity_sign", "0x606C"),
    ({"position": -1.0}, "position_sign", "0x6064"),
    ({"position": 0.0}, "position_sign", "0x6064"),
    ({"position": 2.0}, "counts_per_rev", "drive.counts_per_rev"),
    ({"position": 0.5}, "counts_per_rev", "drive.counts_per_rev"),
    ({"velocity": 2.0}, "velocity_scale", "velocity_units_per_rps"),
    ({"velocity": 0.5}, "velocity_scale", "velocity_units_per_rps"),
    ({"velocity": 60.0}, "velocity_scale", "velocity_units_per_rps"),  # rpm for rps
    ({"velocity": 1.0 / 60.0}, "velocity_scale", "velocity_units_per_rps"),
    ({"velocity": 2.0 * np.pi}, "velocity_scale", "velocity_units_per_rps"),
    ({"velocity": 1.05}, "velocity_scale", "velocity_units_per_rps"),
    ({"current": 1.3}, "current_scale", "0x6076"),
    (of_plant(torque_constant_nm_per_a=0.074), "torque_per_inertia", "torque_constant_nm_per_a"),
    (of_plant(torque_constant_nm_per_a=0.296), "torque_per_inertia", "torque_constant_nm_per_a"),
    (of_plant(inertia_kg_m2=PLANT.inertia_kg_m2 * 4.0), "torque_per_inertia", "inertia_kg_m2"),
    (of_plant(extra_delay_s=0.004), "delay", "delay_s: {value: 0.00"),
    ({"torque": 0.0}, "motion", "motor connected"),
    (of_plant(friction=PLANT.friction.scaled(level=30.0)), "motion", "brake released"),
    (of_plant(friction=PLANT.friction.scaled(level=300.0, stiffness=300.0)), "motion", "brake released"),
    (of_plant(effects=(EffectConfig("torque_offset", {"torque_nm": 0.04}),)), "standstill", "without torque"),
    ({"device": DeviceConfig(quick_stop_option=0)}, "quick_stop", "0x605A"),
]


@pytest.mark.parametrize(("wrong", "name", "remedy"), WRONG, ids=lambda value: str(value)[:40])
def test_one_wrong_fact_fails_exactly_its_check(wrong, name, remedy):
    checks = checks_of(MisdeclaredDrive(**wrong))
    assert failed(checks) == {name}, checks[name]
    assert remedy in checks[name].remedy
    assert overall(list(checks.values())) == "failed"


def test_nothing_is_provoked_after_a_surprise():
    for wrong in ({"torque": -1.0}, {"position": 2.0}, {"velocity": -1.0}):
        checks = checks_of(MisdeclaredDrive(**wrong))
        for name in ("current_limit", "speed_limit", "position_window", "quick_stop"):
            assert checks[name].verdict == "not_done"
            assert "failed" in checks[name].text


def test_a_wrong_scale_that_nothing_can_assign_makes_both_suspect():
    checks = checks_of(MisdeclaredDrive(position=50.0))
    assert failed(checks) == {"counts_per_rev", "velocity_scale"}


def test_a_velocity_that_is_computed_seldom_is_a_warning_and_makes_the_delay_longer():
    checks = checks_of(MisdeclaredDrive(hold=3))
    assert not failed(checks)
    assert "velocity_update" in warned(checks)
    assert checks["velocity_update"].measured == pytest.approx(1.5e-3)
    assert checks["velocity_age"].measured == pytest.approx(0.0007 + 0.0005, abs=1.5e-4)  # mean age of a held word
    checks = checks_of(MisdeclaredDrive(hold=10))
    assert "velocity_update" in failed(checks)


@pytest.mark.parametrize("number", [4034, 4154, 4234])  # break away at 3.5 to 4.7 times their sliding friction
def test_friction_that_falls_with_speed_does_not_hide_the_delay(number):
    plant = wide_axis(PLANT, number).plant
    checks = checks_of(MisdeclaredDrive(plant))
    hold_s = 0.5 * SESSION.loop.period_ns * 1e-9
    assert checks["motion"].verdict != "failed"
    assert checks["delay"].measured == pytest.approx(plant.delay_s - hold_s, abs=1e-3)


def elastic(load_share):
    return of_plant(
        effects=(EffectConfig("elasticity", {"load_share": load_share, "frequency_hz": 20.0, "damping": 0.02}),)
    )


def test_a_load_that_swings_back_does_not_pass_for_a_long_delay():
    assert checks_of(MisdeclaredDrive(**elastic(0.5)))["delay"].measured == pytest.approx(0.00275, abs=1e-3)
    checks = checks_of(MisdeclaredDrive(**elastic(0.8)))
    assert failed(checks) == {"motion"}
    assert "velocity variance unexplained" in checks["motion"].text
    assert "elastic coupling" in checks["motion"].remedy


def test_an_axis_with_play_is_no_rigid_inertia_and_is_commissioned_all_the_same():
    play = EffectConfig("backlash", {"gap_rev": 0.01, "load_share": 0.5})
    checks = checks_of(MisdeclaredDrive(**of_plant(effects=(play,))))
    assert not failed(checks)
    assert {"motion", "delay"} <= warned(checks)
    assert "backlash" in checks["motion"].remedy
    share = checks["motion"].numbers["unexplained_share"]
    assert RIGID_UNEXPLAINED < share < LARGEST_UNEXPLAINED
    assert 0.0 < checks["delay"].measured < 0.00275  # play hides a part of it, which is why a model's longer one counts


def test_a_smooth_axis_is_an_ok_one_but_not_the_one_of_the_model():
    checks = checks_of(MisdeclaredDrive(**of_plant(friction=PLANT.friction.scaled(level=0.1))))
    assert not failed(checks)
    assert warned(checks) == {"static_friction"}


def test_tighter_bounds_are_kept():
    bounds = make_bounds(SESSION.envelope, current_a=1.0, speed_rps=3.0, travel_rev=0.3)
    checks = checks_of(MisdeclaredDrive(), bounds=bounds)
    assert not failed(checks)


def test_a_current_bound_that_is_too_small_is_said():
    checks = checks_of(MisdeclaredDrive(), bounds=make_bounds(SESSION.envelope, current_a=0.2))
    assert failed(checks) == {"motion"}
    assert "--current" in checks["motion"].remedy


def test_a_time_bound_ends_it():
    bounds = BOUNDS._replace(time_s=0.5)
    checks = checks_of(MisdeclaredDrive(), bounds=bounds)
    assert not failed(checks)
    assert overall(list(checks.values())) == "failed"
    assert "0.5 s" in checks["quick_stop"].text


def test_the_position_window_of_the_axis_is_kept():
    envelope = SESSION.envelope._replace(position_low_rev=-0.5, position_high_rev=0.5)
    with pytest.raises(BoundsError, match="--travel"):
        commission(MisdeclaredDrive(), SESSION._replace(envelope=envelope), PLAN.model, FACTS, BOUNDS)


@pytest.mark.parametrize(
    ("objects", "fails", "warns"),
    [
        ({(0x608F, 1): 32768, (0x608F, 2): 1, (0x6075, 0): 8300, (0x6076, 0): 1228}, set(), set()),
        ({(0x608F, 1): 65536, (0x608F, 2): 1}, {"counts_per_rev"}, set()),
        ({(0x6090, 1): 4096, (0x6090, 2): 1}, set(), {"velocity_scale"}),
        ({(0x6075, 0): 5000, (0x6076, 0): 1228}, set(), {"current_scale"}),
    ],
)
def test_what_the_drive_says_about_itself_counts(objects, fails, warns):
    facts = DeclaredFacts(
        drive_kind="canopen", counts_per_rev=32768, velocity_units_per_rps=32768, torque_constant_nm_per_a=0.148,
        rated_torque_nm=1.2284,
    )  # fmt: skip
    checks = checks_of(TalkingDrive(objects), facts=facts)
    assert failed(checks) == fails
    assert warned(checks) == warns


@pytest.mark.parametrize("unit_nm", [1e-3, 1e-6])
def test_the_torque_constant_of_the_name_plate_is_in_the_unit_of_the_drive(unit_nm):
    """0x6076 in mNm, and in uNm as that of an EPOS4; 0x6075 in mA."""
    rated_torque_nm, rated_current_a = 1.2284, 8.3
    facts = DeclaredFacts(
        drive_kind="canopen", torque_constant_nm_per_a=rated_torque_nm / rated_current_a, rated_torque_unit_nm=unit_nm
    )
    objects = {(0x6076, 0): round(rated_torque_nm / unit_nm), (0x6075, 0): round(rated_current_a / 1e-3)}
    check = checks_of(TalkingDrive(objects), facts=facts)["current_scale"]
    assert check.numbers["name_plate_torque_constant_nm_per_a"] == pytest.approx(0.148, rel=1e-3)
    assert check.verdict == "ok"


def test_encoder_objects_decide_which_word_is_wrong():
    facts = DeclaredFacts(
        drive_kind="canopen", counts_per_rev=32768, velocity_units_per_rps=32768, torque_constant_nm_per_a=0.148
    )
    objects = {(0x608F, 1): 32768, (0x608F, 2): 1}
    checks = checks_of(TalkingDrive(objects, velocity=0.02), facts=facts)
    assert failed(checks) == {"velocity_scale"}
    would = float(checks["velocity_scale"].remedy.split("(")[1].split()[0])
    assert would == pytest.approx(0.02 * 32768, rel=0.005)

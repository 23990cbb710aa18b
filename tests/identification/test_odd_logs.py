"""Odd logs: the inertia is right or doubted, what was wrong is told, and a clean log is left as it is."""

from __future__ import annotations

import numpy as np
import pytest
from identification.odd_logs import (
    COULOMB_NM,
    INERTIA_KG_M2,
    KT_NM_PER_A,
    ODD,
    RATE_HZ,
    VISCOUS_NM_PER_RPS,
    counted,
    counts_lost,
    eight_bits,
    hall,
    motion,
    positions_off,
    scale_damaged,
    slips,
    spikes_each_turn,
    stands_still,
    steady,
    velocities_off,
    with_position,
    with_velocity,
)

from fffo_drive.identification.dataset import DataError, record_of_columns
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.identification.fit import FitSettings, fit_records
from fffo_drive.identification.impossible import impossible_samples, resolution
from fffo_drive.identification.regression import regression_start
from fffo_drive.units import inertia_kg_m2

FACTS = DriveFacts(torque_constant_nm_per_a=KT_NM_PER_A)
QUICK = FitSettings(compare_literal=False, starts=1)


def record(log):
    return record_of_columns("odd", log, FACTS)


def said(log):
    return [text.removeprefix("odd: ") for text in record(log).warnings if "current command" not in text]


def found_in(values, position=True, period_s=1.0 / RATE_HZ):
    return impossible_samples(values, period_s, resolution(values), position)


def inertia_of(fit):
    return inertia_kg_m2(fit.value("inertia_nm_s2_per_rev"))


def doubted(fit):
    return {doubt.name for doubt in fit.uncertainty.doubts}


@pytest.mark.parametrize("spoil", ODD, ids=lambda spoil: spoil.__name__)
def test_the_inertia_of_an_odd_log_is_right_or_doubted(spoil):
    try:
        fit = fit_records([record(spoil(motion()))], QUICK, FACTS)
    except DataError:
        return  # a refusal is no wrong number
    right = inertia_of(fit) == pytest.approx(INERTIA_KG_M2, rel=0.05)
    assert right or "inertia_nm_s2_per_rev" in doubted(fit)


def test_what_no_motion_makes_is_told_in_numbers_and_left_out():
    log = motion()
    off = record(velocities_off(log))
    assert any("20 of 6,000 velocities are impossible" in text for text in off.warnings)
    assert int(np.count_nonzero(~off.good)) == 20
    assert any("20 of 6,000 positions are impossible" in text for text in said(positions_off(log)))
    assert any("96 of 6,000 positions stand still while the axis moves" in text for text in said(stands_still(log)))
    slipped = record(slips(log))
    assert len(slipped.breaks) == 3
    assert any("slips 3 times, by up to 0.5 rev" in text for text in slipped.warnings)


@pytest.mark.parametrize("spoil", [counts_lost, scale_damaged])
@pytest.mark.parametrize("step_rev", [0.0015, 0.004, 0.02])
def test_a_position_that_jumps_at_one_angle_is_told_with_the_place(spoil, step_rev):
    log = motion()
    fault = record(spoil(log, step_rev)).fault
    assert f"jumps by {step_rev:.3f}"[:-1] in fault
    angle_rev = float(fault.split("(")[1].split(" ")[0])
    assert abs(angle_rev - 0.37) < 0.06  # either end of a damaged part
    assert fault in "\n".join(said(spoil(log, step_rev)))


@pytest.mark.parametrize("spoil", [positions_off, slips, stands_still, hall, eight_bits])
def test_what_happens_at_any_angle_is_no_fault_at_one(spoil):
    assert record(spoil(motion())).fault == ""
    linear = FACTS.model_copy(update={"units": "linear"})
    assert record_of_columns("odd", counts_lost(motion()), linear).fault == ""


def test_the_velocity_at_an_outlier_is_that_of_its_neighbours():
    log = motion()
    record_ = record(spikes_each_turn(log))
    derived = np.gradient(record_.position_rev, record_.period_s)
    assert np.abs(derived - log["velocity_rps"])[5:-5].max() < 0.1


@pytest.mark.parametrize("rate_hz", [100.0, 250.0, 1000.0, 4000.0])
def test_nothing_is_impossible_in_a_clean_log(rate_hz):
    log = motion(rate_hz=rate_hz)
    for counts in (42, 256, 4096, 2**20):
        assert found_in(counted(log["position_rev"], counts), True, 1.0 / rate_hz) is None
    for values in (log["velocity_rps"], np.round(2.0 * log["velocity_rps"]) / 2.0):
        assert found_in(values, False, 1.0 / rate_hz) is None
    assert said(with_position(log, counted(log["position_rev"]))) in ([], said(with_position(log, log["position_rev"])))


def test_a_trapezoid_a_blow_and_a_rest_are_motion():
    """Velocity at rest, a ramp of 20 ms, a blow that stays, and rest again."""
    parts = np.zeros(300), np.linspace(0.0, 5.0, 10), np.full(200, 5.0), np.full(300, 2.0), np.zeros(300)
    velocity = np.concatenate(parts)
    velocity += 0.002 * np.random.default_rng(1).standard_normal(velocity.size)
    assert found_in(velocity, False) is None
    assert found_in(counted(np.cumsum(velocity) / RATE_HZ), True) is None


def test_a_hall_sensor_is_seen_below_its_noise():
    """42 edges a turn: at 40 Hz the acceleration is noise, and the inertia would be 20 times too small."""
    log = motion()
    start = regression_start([record(with_position(log, counted(log["position_rev"], 42)))])
    assert start.is_noisy
    assert start.cutoff_hz <= 20.0
    assert inertia_kg_m2(start.inertia_nm_s2_per_rev) == pytest.approx(INERTIA_KG_M2, rel=0.1)
    assert not regression_start([record(with_position(log, counted(log["position_rev"])))]).is_noisy


def test_a_delay_beyond_the_scan_is_found_where_it_is():
    log = motion()
    late = round(0.06 * RATE_HZ)
    spoiled = with_velocity(log, np.concatenate([np.full(late, log["velocity_rps"][0]), log["velocity_rps"][:-late]]))
    start = regression_start([record(spoiled)])
    assert start.has_delay
    assert start.delay_s == pytest.approx(0.06, abs=0.002)


def test_a_delay_that_has_no_minimum_is_none_and_the_inertia_is_doubted():
    """Current and motion of two different runs."""
    log = motion()
    wrong = with_velocity(log, log["velocity_rps"][::-1].copy())
    try:
        fit = fit_records([record(wrong)], QUICK, FACTS)
    except DataError:
        return
    assert "inertia_nm_s2_per_rev" in doubted(fit)


def test_steady_speeds_give_the_friction_and_no_inertia():
    fit = fit_records([record(steady())], QUICK, FACTS)
    assert fit.value("coulomb_nm") == pytest.approx(COULOMB_NM, rel=0.03)
    assert fit.value("viscous_nm_per_rps") == pytest.approx(VISCOUS_NM_PER_RPS, rel=0.03)
    known = {name for name, sd in zip(fit.space.names, fit.uncertainty.sd, strict=False) if sd > 0.0}
    assert known <= {"coulomb_nm", "viscous_nm_per_rps", "offset_nm"}
    assert "inertia_nm_s2_per_rev" in doubted(fit)


@pytest.mark.parametrize("rate_hz", [20.0, 25.0])
def test_twenty_hertz_are_enough_for_an_inertia_and_what_they_hide_is_said(rate_hz):
    log = motion(60.0, rate_hz)
    slow = with_position(log, counted(log["position_rev"]))
    assert any("cannot be seen" in text for text in said(slow))
    fit = fit_records([record(slow)], QUICK, FACTS)
    right = inertia_of(fit) == pytest.approx(INERTIA_KG_M2, rel=0.05)
    assert right or "inertia_nm_s2_per_rev" in doubted(fit)
    known = fit.value("coulomb_nm") == pytest.approx(COULOMB_NM, rel=0.05)
    assert known or "coulomb_nm" in doubted(fit)

"""Causes that a search once named and that were not there, each with the relative that has to be found.

Searches look at the laws that were confused.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from diagnosis.planted import begun, only
from diagnosis.small_axis import FACTS, LINE_HZ, MACHINE, PERIOD_S, three_sines

from fffo_drive.diagnosis.select import DiagnosisSettings, Selector


def time_of(record):
    """On the clock of the log, (n,)."""
    return record.begin_s + np.arange(record.samples) * PERIOD_S


def searched(runs, *laws):
    """The selection of a search that looks at these laws alone."""
    rules = DiagnosisSettings(without=only(*laws), ablate=frozenset({"curves"}))
    return Selector(FACTS, rules, lambda share, text: None).run(*begun(runs, FACTS, rules.without))


def values_of(selection, name):
    """Numbers of an effect that was found."""
    return next(effect.values(0) for effect in selection.fitted.effects if effect.name == name)


# A frequency at which the motion itself has a line


@cache
def disturbed(frequency_hz):
    """What is found of a torque of 1 mNm at a frequency, to which the command adds what it takes."""
    size_a = 0.001 / MACHINE.torque_constant_nm_per_a
    runs = [
        replace(one, current_a=one.current_a + size_a * np.sin(2.0 * np.pi * frequency_hz * time_of(one)))
        for one in three_sines()
    ]
    return searched(runs, "periodic_disturbance", "elasticity")


def test_a_frequency_at_which_the_motion_has_a_line_is_no_cause():
    selection = disturbed(LINE_HZ)
    assert selection.accepted == ()
    reasons = {one.name: one.reason for one in selection.refused}
    assert "the motion itself has a line at" in reasons["periodic_disturbance"]


@pytest.mark.parametrize("frequency_hz", [2.9, 5.3])
def test_a_disturbance_at_a_frequency_of_its_own_is_found_beside_those_lines(frequency_hz):
    selection = disturbed(frequency_hz)
    assert [one.name for one in selection.accepted] == ["periodic_disturbance"]
    assert values_of(selection, "periodic_disturbance")["frequency_hz"] == pytest.approx(frequency_hz, abs=0.003)


# Torque per ampere

DRIFTS = ("coulomb_drift", "viscous_drift", "torque_constant_drift", "periodic_disturbance")


def weaker(lost):
    """The runs of a motor that has lost a share of its torque per ampere by a time."""
    return [replace(one, current_a=one.current_a / (1.0 - lost(time_of(one)))) for one in three_sines()]


def test_a_torque_constant_that_drops_at_once_is_found_with_the_time():
    selection = searched(weaker(lambda time_s: 0.25 * (time_s > 9.0)), *DRIFTS)
    assert [one.name for one in selection.accepted] == ["torque_constant_drift"]
    found = values_of(selection, "torque_constant_drift")
    assert found["share"] == pytest.approx(0.25, abs=0.01)
    assert found["begin_s"] == pytest.approx(9.0, abs=0.1)
    assert found["tau_s"] < 0.2


def test_a_torque_constant_that_falls_as_the_motor_warms_is_found():
    selection = searched(weaker(lambda time_s: 0.18 * (1.0 - np.exp(-time_s / 12.0))), *DRIFTS)
    assert [one.name for one in selection.accepted] == ["torque_constant_drift"]
    found = values_of(selection, "torque_constant_drift")
    assert found["share"] == pytest.approx(0.18, abs=0.01)
    assert found["tau_s"] == pytest.approx(12.0, rel=0.1)


def test_a_friction_that_falls_as_the_bearing_warms_is_not_taken_for_it():
    selection = searched(three_sines(replace(MACHINE, warming_share=0.3, warming_s=12.0)), *DRIFTS)
    assert [one.name for one in selection.accepted] == ["coulomb_drift"]
    assert values_of(selection, "coulomb_drift")["share"] == pytest.approx(-0.3, abs=0.02)

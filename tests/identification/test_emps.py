"""The measured EMPS axis (Janot, Gautier and Brunot, 2019): published errors, by the authors' metric.

Reading of the filter: Butterworth of order 4 in all (2 each way) at 100 Hz on the position, central differences, the
first 49 samples dropped, Chebyshev decimation by 10 without phase on force and regressors alike.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rigid_regression import RigidSettings, fit_rigid, rigid_error_percent
from shared_data import shared_files

from fffo_drive.identification.dataset import load_record
from fffo_drive.identification.facts import read_facts
from fffo_drive.identification.fit import FitSettings, fit_records
from fffo_drive.identification.ladder import climb
from fffo_drive.identification.layout import EffectStart
from fffo_drive.identification.regression import regression_start

FACTS = Path(__file__).parent / "emps.yaml"


def emps(name):
    (path,) = shared_files(f"emps/{name}.mat")
    return load_record(path, read_facts(FACTS))


def test_the_published_errors_are_met():
    fitted, held_out = emps("DATA_EMPS"), emps("DATA_EMPS_PULSES")
    rigid = fit_rigid(fitted)
    assert rigid.error_percent == pytest.approx(4.0834, abs=0.1)
    assert rigid_error_percent(held_out, rigid.parameters) == pytest.approx(5.9824, abs=0.1)
    published = {"inertia": 95.1089, "viscous": 203.5034, "coulomb": 20.3935, "offset": -3.1648}
    assert rigid.parameters == pytest.approx(published, rel=0.01)
    assert fit_rigid(fitted, RigidSettings(directional=True)).error_percent == pytest.approx(3.1117, abs=0.1)


def test_the_hold_of_the_command_alone_lowers_the_held_out_error():
    fitted, held_out = emps("DATA_EMPS"), emps("DATA_EMPS_PULSES")
    held = RigidSettings(hold=True)
    rigid = fit_rigid(fitted, held)
    assert rigid_error_percent(held_out, rigid.parameters, held) < 5.0


@pytest.mark.slow
def test_a_linear_axis_is_fitted_by_simulation_too():
    record = emps("DATA_EMPS")
    constant = EffectStart("torque_offset", {"torque_nm": regression_start([record]).constant_nm})
    fit = fit_records([record], FitSettings(compare_literal=False, effects=(constant,)), read_facts(FACTS))
    assert fit.value("inertia_nm_s2_per_rev") == pytest.approx(95.1, rel=0.02)
    assert fit.value("offset_nm") == pytest.approx(-3.16, rel=0.1)
    speed = 0.1
    names = ("coulomb_nm", "static_nm", "stribeck_velocity_rps", "stribeck_exponent", "viscous_nm_per_rps")
    coulomb, static, velocity, exponent, viscous = (fit.value(name) for name in names)
    friction = coulomb + (static - coulomb) * np.exp(-((speed / velocity) ** exponent)) + viscous * speed
    assert friction == pytest.approx(20.39 + 203.5 * speed, rel=0.05)
    assert fit.uncertainty.doubts  # no slow reversals in it: presliding cannot be known


@pytest.mark.parametrize("name", ["DATA_EMPS", "DATA_EMPS_PULSES"])
def test_the_first_rung_of_this_axis_is_friction_that_differs_by_direction(name):
    """The published model with friction by direction has Fv+ below Fv-; the constant is then not needed."""
    record = emps(name)
    ladder = climb([record], regression_start([record]), read_facts(FACTS))
    assert [one.candidate.name for one in ladder.accepted] == ["asymmetric_viscous"]
    assert ladder.accepted[0].coefficients == pytest.approx([-40.0], rel=0.1)

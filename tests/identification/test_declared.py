"""A declared weight against what the data show of it."""

import math

import pytest

from fffo_drive.identification.declared import gravity_remark, wave_size, weight_remarks
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.identification.results import symbol_of


def facts(**declared):
    return DriveFacts(torque_constant_nm_per_a=0.1, **declared)


def test_the_size_of_a_wave_and_its_deviation_are_those_of_its_parts():
    assert wave_size(3.0, 4.0, 0.1, 0.1) == pytest.approx((5.0, 0.1))
    assert wave_size(2.0, 0.0, 0.3, 9.0) == pytest.approx((2.0, 0.3))
    assert math.isnan(wave_size(2.0, 0.0, None, 0.1)[1])


@pytest.mark.parametrize(
    ("found", "travel_rev", "said"),
    [
        ((0.51, 0.01), 50.0, ""),
        ((0.60, 0.06), 50.0, ""),  # inside its interval
        ((0.80, 0.01), 50.0, "1.6 times the true one"),
        (None, 50.0, "show no weight"),
        (None, 5.0, "0.1 turns of the output"),
    ],
)
def test_a_declared_weight_is_compared_and_never_fitted(found, travel_rev, said):
    remark = gravity_remark(facts(load_gravity_nm=0.5, gear_ratio=50.0), found, travel_rev)
    assert (said in remark) if said else remark == ""
    assert gravity_remark(facts(), found, travel_rev) == ""


def test_the_weight_is_found_among_the_effects_by_its_law():
    declared = facts(load_gravity_nm=0.5, gear_ratio=50.0)
    weight = ("unbalance", [("cos_nm", 0.48, 0.003), ("sin_nm", 0.64, 0.003), ("ratio", 50.0, None)])
    cogging = ("cogging", [("cos_nm", 0.5, 0.003), ("sin_nm", 0.0, 0.003), ("order", 12.0, None)])
    assert weight_remarks(declared, [cogging, weight], 50.0) == [gravity_remark(declared, (0.8, 0.003), 50.0)]
    assert weight_remarks(declared, [cogging], 50.0) == [gravity_remark(declared, None, 50.0)]
    assert weight_remarks(facts(), [weight], 50.0) == []


def test_a_linear_axis_has_a_mass_and_no_inertia():
    assert symbol_of("inertia_nm_s2_per_rev", facts(units="linear")) == "M"
    assert symbol_of("inertia_nm_s2_per_rev", facts()) == "J"
    assert symbol_of("coulomb_nm", facts(units="linear")) == "Fc"

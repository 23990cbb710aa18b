"""What commissioning says of a model that nobody has measured: its numbers are told, and are no reason to fail."""

from __future__ import annotations

import pytest

from fffo_drive.commissioning.motion_checks import Beliefs, delay, torque_per_inertia
from fffo_drive.units import inertia_nm_s2_per_rev

KT_NM_PER_A = 0.1


@pytest.mark.parametrize("factor", [0.01, 0.5, 2.0, 100.0])
def test_the_inertia_is_measured_where_it_was_assumed(factor):
    believed = Beliefs(100.0, 2e-3, 0.0, 0.05, KT_NM_PER_A, inertia_assumed=True)
    check = torque_per_inertia(100.0 * factor, believed)
    assert check.verdict == "warning"
    said = float(check.remedy.partition("{value: ")[2].partition(",")[0])
    # Kt/J is what was measured: J in Nm s2/rev is Kt over it
    assert KT_NM_PER_A / inertia_nm_s2_per_rev(said) == pytest.approx(100.0 * factor, rel=0.01)
    assert torque_per_inertia(100.0 * factor, believed._replace(inertia_assumed=False)).verdict == "failed"


def test_an_assumed_inertia_that_is_right_is_ok_and_a_gain_that_is_none_has_failed():
    believed = Beliefs(100.0, 2e-3, 0.0, 0.05, KT_NM_PER_A, inertia_assumed=True)
    assert torque_per_inertia(101.0, believed).verdict == "ok"
    assert torque_per_inertia(-100.0, believed).verdict == "failed"
    assert torque_per_inertia(float("nan"), believed).verdict == "failed"


def test_the_delay_likewise():
    believed = Beliefs(100.0, 2e-3, 0.0, 0.05, KT_NM_PER_A, delay_assumed=True)
    check = delay(9e-3, 5e-4, believed)
    assert (check.verdict, "value: 0.00900" in check.remedy) == ("warning", True)
    assert delay(9e-3, 5e-4, believed._replace(delay_assumed=False)).verdict == "failed"

"""What commissioning says of a model that nobody has measured: its numbers are reported, and are no reason to fail."""

from __future__ import annotations

import pytest

from fffo_drive.commissioning.motion_checks import Beliefs, delay, torque_per_inertia
from fffo_drive.commissioning.objects import read_name_plate
from fffo_drive.drive.port import DriveRefusedError
from fffo_drive.units import inertia_kg_m2, inertia_nm_s2_per_rev

KT_NM_PER_A = 0.1
ASSUMED_KG_M2 = inertia_kg_m2(KT_NM_PER_A / 100.0)  # of a Kt/J of 100 rps2/A


@pytest.mark.parametrize("factor", [0.01, 0.5, 2.0, 100.0])
def test_the_inertia_is_measured_where_it_was_assumed(factor):
    believed = Beliefs(100.0, 2e-3, 0.0, 0.05, KT_NM_PER_A, assumed_kg_m2=ASSUMED_KG_M2)
    check = torque_per_inertia(100.0 * factor, believed)
    assert check.verdict == "warning"
    said = float(check.remedy.partition("{value: ")[2].partition(",")[0])
    # Kt/J is what was measured: J in Nm s2/rev is Kt over it
    assert KT_NM_PER_A / inertia_nm_s2_per_rev(said) == pytest.approx(100.0 * factor, rel=0.01)
    assert torque_per_inertia(100.0 * factor, believed._replace(assumed_kg_m2=None)).verdict == "failed"


def test_an_assumed_inertia_that_is_right_is_ok_and_a_gain_that_is_none_has_failed():
    believed = Beliefs(100.0, 2e-3, 0.0, 0.05, KT_NM_PER_A, assumed_kg_m2=ASSUMED_KG_M2)
    assert torque_per_inertia(101.0, believed).verdict == "ok"
    assert torque_per_inertia(-100.0, believed).verdict == "failed"
    assert torque_per_inertia(float("nan"), believed).verdict == "failed"


def test_the_delay_likewise():
    believed = Beliefs(100.0, 2e-3, 0.0, 0.05, KT_NM_PER_A, delay_assumed=True)
    check = delay(9e-3, 5e-4, believed)
    assert (check.verdict, "value: 0.00900" in check.remedy) == ("warning", True)
    assert delay(9e-3, 5e-4, believed._replace(delay_assumed=False)).verdict == "failed"


class Source:
    """A connected drive: numbers of four bytes."""

    def __init__(self, objects):
        self.objects = objects

    def read_object(self, index, sub):
        if (index, sub) not in self.objects:
            raise DriveRefusedError("no such object")
        return self.objects[index, sub].to_bytes(4, "little")


ENCODER = {(0x608F, 1): 2000, (0x608F, 2): 1, (0x6075, 0): 5000, (0x6076, 0): 500}


@pytest.mark.parametrize(
    ("objects", "counts", "velocity", "said_by"),
    [
        (ENCODER | {(0x6090, 1): 4000, (0x6090, 2): 1}, 2000, 4000.0, ("0x608F", "0x6090")),
        (ENCODER | {(0x60A8, 0): 0xFF410000, (0x60A9, 0): 0x00B44700}, 3600, 60.0, ("0x60A8", "0x60A9")),
        (ENCODER | {(0x60A8, 0): 0x00B50000, (0x60A9, 0): 0x00B50300}, 2000, 2000.0, ("0x608F", "0x60A9")),
        ({}, None, None, ("0x608F", "0x6090")),
    ],
)
def test_the_name_plate_has_the_units_in_which_the_drive_counts(objects, counts, velocity, said_by):
    plate = read_name_plate(Source(objects))
    assert (plate.counts_per_rev, plate.velocity_units_per_rps) == (counts, velocity)
    assert (plate.counts_object, plate.velocity_object) == said_by
    assert plate.torque_constant_nm_per_a == (0.1 if objects else None)

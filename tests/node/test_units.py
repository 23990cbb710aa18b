"""The factor group: what a count of position, velocity and torque is, in closed form on a body whose speed is known."""

from __future__ import annotations

import math

import pytest
from node.node_rig import Rig

from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.personality import Personality

COUNTS = 32768  # of the resolver in a revolution
RPM, INCREMENTS_PER_S, DEGREES_PER_S, RADIANS_PER_S = 0x00B44700, 0x00B50300, 0x00410300, 0x00100300
TENTHS_OF_A_DEGREE, INCREMENTS, REVOLUTIONS, MILLIREVOLUTIONS = 0xFF410000, 0x00B50000, 0x00B40000, 0xFDB40000
INVALID, WRONG_STATE = 0x06090030, 0x08000022


def signed(value: int, bits: int = 32) -> int:
    return value - (value >> bits - 1 << bits)


def turning(rig: Rig, angle_rev: float = 2.25, velocity_rps: float = 3.5) -> tuple[int, int]:
    """0x6064 and 0x606C of a body at that angle and speed."""
    rig.plant.angle_rev, rig.plant.velocity_rps = angle_rev, velocity_rps
    rig.send("080#")
    return signed(rig.read(0x6064)), signed(rig.read(0x606C))


@pytest.mark.conformance("CiA 402", "0x606C by 0x6090 and 0x60A9")
@pytest.mark.parametrize(
    ("unit", "per_rps"),
    [
        (INCREMENTS_PER_S, COUNTS), (RPM, 60.0), (0xFDB44700, 60_000.0), (0xFFB44700, 600.0), (0x00B40300, 1.0),
        (DEGREES_PER_S, 360.0), (RADIANS_PER_S, 2.0 * math.pi), (0xFAB40300, 1e6), (0x00B54700, COUNTS * 60.0),
    ],
)  # fmt: skip
def test_velocity_counts_as_its_unit_says(unit: int, per_rps: float) -> None:
    rig = Rig()
    assert rig.write(0x60A9, 0, unit, 4) == 0
    assert turning(rig)[1] == round(3.5 * per_rps)
    assert turning(rig, velocity_rps=-3.5)[1] == -round(3.5 * per_rps)


@pytest.mark.conformance("CiA 402", "0x6064 by 0x608F, 0x6091, 0x6092 and 0x60A8")
@pytest.mark.parametrize(
    ("unit", "counts"),
    [(INCREMENTS, 2.25 * COUNTS), (TENTHS_OF_A_DEGREE, 8100), (REVOLUTIONS, 2), (MILLIREVOLUTIONS, 2250)],
)
def test_position_counts_as_its_unit_says(unit: int, counts: float) -> None:
    rig = Rig()
    assert rig.write(0x60A8, 0, unit, 4) == 0
    assert turning(rig)[0] == counts


@pytest.mark.parametrize("unit", [0x00010000, 0x00B50100, 0x00B54700, 0x7FB40000, 0x00B40001])
def test_units_that_this_machine_does_not_have_are_refused(unit: int) -> None:
    rig = Rig()
    assert rig.write(0x60A8, 0, unit, 4) == INVALID
    assert rig.read(0x60A8) == INCREMENTS
    assert rig.write(0x60A9, 0, 0x00010300, 4) == INVALID
    assert rig.write(0x60A9, 0, 0x00B40000, 4) == INVALID


@pytest.mark.conformance("CiA 402", "0x6064 by 0x608F, 0x6091, 0x6092 and 0x60A8")
def test_feed_and_gear() -> None:
    rig = Rig()
    assert rig.write(0x6092, 1, 10_000, 4) == 0  # units in a turn of the shaft
    assert turning(rig)[0] == 22_500
    assert (rig.write(0x6091, 1, 5, 4), rig.write(0x6091, 2, 2, 4)) == (0, 0)  # 2.5 turns of the motor to one
    assert turning(rig)[0] == 9_000
    assert turning(rig)[1] == round(3.5 * COUNTS / 2.5)
    assert rig.write(0x6091, 1, 0, 4) == 0x06090032


@pytest.mark.conformance("CiA 402", "0x6064 by 0x608F, 0x6091, 0x6092 and 0x60A8")
@pytest.mark.parametrize("counts", [500, 2000, 4096, 10_000])
def test_an_encoder_of_any_number_of_counts(counts: int) -> None:
    rig = Rig(NodeConfig(personality=Personality(encoder_counts_per_rev=counts)))
    assert rig.read(0x608F, 1) == counts
    assert turning(rig)[0] == math.floor(2.25 * counts)
    assert turning(rig, angle_rev=-0.1)[0] == math.floor(math.trunc(-0.1 * COUNTS) * counts / COUNTS)


def test_a_wrong_encoder_resolution_changes_what_the_drive_makes_of_the_encoder_and_not_the_encoder() -> None:
    rig = Rig()
    assert rig.write(0x608F, 1, COUNTS // 2, 4) == 0
    assert rig.plant.counts == 0
    assert turning(rig) == (round(2.25 * 2 * COUNTS), round(3.5 * COUNTS))  # 6092 units for each turn that it counts
    assert rig.write(0x60A9, 0, RPM, 4) == 0
    assert turning(rig)[1] == 420  # twice as fast, it believes
    rig.send("000#8101")
    assert rig.read(0x608F, 1) == COUNTS
    assert turning(rig)[0] == 2.25 * COUNTS


@pytest.mark.conformance("CiA 402", "polarity 0x607E")
@pytest.mark.parametrize(("polarity", "signs"), [(0x00, (1, 1)), (0x80, (-1, 1)), (0x40, (1, -1)), (0xC0, (-1, -1))])
def test_polarity(polarity: int, signs: tuple[int, int]) -> None:
    rig = Rig()
    assert rig.write(0x607E, 0, polarity, 1) == 0
    position, velocity = turning(rig)
    assert (position, velocity) == (signs[0] * 2.25 * COUNTS, signs[1] * round(3.5 * COUNTS))


def torque_a(rig: Rig, permille: int) -> float:
    """What the current loop is told for a target torque."""
    rig.enable()
    assert rig.write(0x6071, 0, permille, 2) == 0
    return rig.node.drive.current_command_a


@pytest.mark.conformance("CiA 402", "ratings 0x6075 and 0x6076 may be written: thousandths follow, the motor does not")
def test_thousandths_follow_the_written_rating() -> None:
    rig = Rig()
    rig.operational()
    constant = rig.config.plant.torque_constant_nm_per_a
    assert rig.write(0x6076, 0, 500, 4) == 0  # mNm
    assert torque_a(rig, 400) == pytest.approx(0.4 * 0.5 / constant)
    rig.wait(10)
    rig.send("080#")
    assert signed(rig.read(0x6077), 16) == 400
    assert signed(rig.read(0x6078), 16) == round(1000 * 0.4 * 0.5 / constant / rig.config.ratings.rated_current_a)
    assert rig.write(0x6071, 0, 32767, 2) == 0
    assert rig.node.drive.current_command_a <= rig.config.plant.peak_current_a + 1e-9


@pytest.mark.conformance("CiA 402", "0x6076 = 0: the drive was not told its motor")
def test_a_drive_that_was_not_told_its_motor_goes_by_what_its_maker_set() -> None:
    rated_a = Rig().config.ratings.rated_current_a
    unset = Personality(values={"0x6075:00": 0, "0x6076:00": 0})
    rig = Rig(NodeConfig(personality=unset))
    assert (rig.read(0x6075), rig.read(0x6076)) == (0, 0)
    assert torque_a(rig, 100) == pytest.approx(0.1 * rated_a)
    by_current = Rig(NodeConfig(personality=Personality(values={"0x6075:00": 4000, "0x6076:00": 0})))
    assert torque_a(by_current, 100) == pytest.approx(0.4)


def test_ratings_in_micronewtonmetres() -> None:
    rig = Rig(NodeConfig(personality=Personality(rated_torque_unit_nm=1e-6)))
    assert rig.read(0x6076) == round(rig.config.ratings.rated_torque_nm * 1e6)
    assert torque_a(rig, 100) == pytest.approx(0.1 * rig.config.ratings.rated_current_a)


@pytest.mark.conformance("CiA 402", "factors do not change under power (08000022)")
@pytest.mark.parametrize(
    ("index", "sub", "size"),
    [(0x6075, 0, 4), (0x6076, 0, 4), (0x607E, 0, 1), (0x608F, 1, 4), (0x6091, 1, 4), (0x6092, 1, 4), (0x60A8, 0, 4),
     (0x60A9, 0, 4)],
)  # fmt: skip
def test_no_factor_changes_under_power(index: int, sub: int, size: int) -> None:
    rig = Rig()
    value = rig.read(index, sub)
    rig.enable()
    assert rig.write(index, sub, value, size) == WRONG_STATE
    assert rig.write(0x6040, 0, 0, 2) == 0
    assert rig.write(index, sub, value, size) == 0

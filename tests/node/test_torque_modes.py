"""Cyclic synchronous torque and torque profile: what reaches the motor, and what the statusword says of it."""

from __future__ import annotations

import pytest
from node.node_rig import OPERATION_ENABLED, Rig

from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.personality import Personality

CYCLIC, PROFILE = 10, 4
REACHED, LIMITED, FOLLOWS = 0x0400, 0x0800, 0x1000


def enabled(
    mode: int = CYCLIC, setup: tuple[tuple[int, int, int, int], ...] = (), config: NodeConfig | None = None
) -> Rig:
    rig = Rig(config)
    rig.operational()
    for step in setup:
        assert rig.write(*step) == 0
    rig.enable(mode)
    return rig


def permille(rig: Rig) -> float:
    """What the current loop is told, in thousandths of the rated torque."""
    return rig.node.drive.current_command_a / rig.config.ratings.a_per_permille


def target(rig: Rig, torque: int, offset: int = 0) -> float:
    assert rig.write(0x60B2, 0, offset, 2) == 0
    assert rig.write(0x6071, 0, torque, 2) == 0
    return permille(rig)


@pytest.mark.conformance("CiA 402", "0x6071 + 0x60B2 act")
def test_target_and_offset_add_up_to_an_acceleration() -> None:
    rig = enabled()
    assert target(rig, 300, -100) == pytest.approx(200.0)
    before = rig.plant.velocity_rps
    rig.wait(100)
    rig.send("080#")
    amperes = 0.2 * rig.config.ratings.rated_current_a
    assert rig.plant.velocity_rps - before == pytest.approx(amperes * rig.plant.rps2_per_a * 0.1, rel=1e-9)
    assert rig.read(0x6074) == 200


@pytest.mark.conformance(
    "CiA 402",
    "limits 0x6072, 0x6073, 0x60E0, 0x60E1",
    "bit 11 internal limit",
    "bit 12 drive follows the command value",
)
@pytest.mark.parametrize(
    ("index", "forward", "backward"),
    [(0x6072, 250, -250), (0x6073, 250, -250), (0x60E0, 250, -500), (0x60E1, 500, -250)],
)
def test_limits(index: int, forward: int, backward: int) -> None:
    rig = enabled()
    assert rig.write(index, 0, 250, 2) == 0
    assert target(rig, 500) == pytest.approx(forward)
    assert (rig.statusword & LIMITED != 0, rig.statusword & FOLLOWS == 0) == (forward == 250,) * 2
    assert target(rig, -500) == pytest.approx(backward)
    assert (rig.statusword & LIMITED != 0, rig.statusword & FOLLOWS == 0) == (backward == -250,) * 2
    assert target(rig, 200) == pytest.approx(200)
    assert rig.statusword & (LIMITED | FOLLOWS) == FOLLOWS
    assert rig.write(index, 0, rig.config.ratings.peak_permille + 1, 2) == 0x06090031


def test_a_drive_that_does_not_show_its_limit_limits_all_the_same() -> None:
    rig = enabled(config=NodeConfig(personality=Personality(limit_shown=False)))
    assert rig.write(0x6073, 0, 250, 2) == 0
    assert target(rig, 500) == pytest.approx(250)
    assert rig.statusword & (LIMITED | FOLLOWS) == FOLLOWS


def test_a_limit_of_the_plant_is_reported() -> None:
    rig = enabled()
    rig.plant.limited = True
    rig.send("080#")
    assert rig.statusword & (LIMITED | FOLLOWS) == LIMITED


@pytest.mark.conformance(
    "CiA 402", "slope 0x6087 acts in the profile mode, not in the cyclic one", "bit 10 target reached"
)
def test_slope() -> None:
    setup = ((0x6087, 0, 1000, 4),)  # per mille a second
    assert target(enabled(CYCLIC, setup), 500) == pytest.approx(500.0)
    rig = enabled(PROFILE, setup)
    assert target(rig, 500) == pytest.approx(0.0)
    for milliseconds, expected in ((100, 100.0), (300, 400.0), (50, 450.0)):
        rig.wait(milliseconds)
        rig.send("080#")
        assert permille(rig) == pytest.approx(expected, abs=1e-6)
        assert rig.statusword & REACHED == 0
    rig.wait(51)
    rig.send("080#")
    assert permille(rig) == pytest.approx(500.0)
    assert rig.statusword & REACHED


@pytest.mark.conformance("CiA 402", "speed limit 0x6080", "bit 11 internal limit")
@pytest.mark.parametrize("direction", [1, -1])
def test_speed_limit(direction: int) -> None:
    rig = enabled(CYCLIC, ((0x6080, 0, 600, 4),))  # 10 rev/s
    assert rig.write(0x6071, 0, direction * 1000, 2) == 0
    for _ in range(4000):
        rig.wait(0.5)
        rig.send("080#")
    assert 9.7 < direction * rig.plant.velocity_rps <= 10.0
    assert rig.statusword & LIMITED
    assert target(rig, -direction * 500) == pytest.approx(-direction * 500.0)  # back is free


@pytest.mark.conformance("CiA 402", "bit 12 drive follows the command value", "bit 10 target reached")
def test_bit_12_is_set_in_the_cyclic_mode_of_operation_enabled_alone() -> None:
    rig = Rig()
    rig.operational()
    assert rig.statusword & FOLLOWS == 0
    rig.enable(CYCLIC)
    assert rig.statusword & (FOLLOWS | REACHED) == FOLLOWS
    assert rig.write(0x6060, 0, PROFILE, 1) == 0
    assert rig.statusword & (FOLLOWS | REACHED) == REACHED
    assert rig.write(0x6060, 0, 0, 1) == 0
    assert rig.statusword & (FOLLOWS | REACHED) == 0
    assert rig.write(0x6060, 0, CYCLIC, 1) == 0
    rig.node.drive.trip(0xFF01)
    rig.wait(20)
    assert rig.statusword & FOLLOWS == 0


@pytest.mark.conformance("CiA 402", "0x6060, 0x6061, 0x6502; an unsupported mode is refused (06090030)")
def test_modes() -> None:
    rig = Rig()
    assert rig.read(0x6502) == 1 << 3 | 1 << 9
    for mode in range(-128, 128):
        supported = mode in (0, PROFILE, CYCLIC)
        assert rig.write(0x6060, 0, mode, 1) == (0 if supported else 0x06090030)
        if supported:
            assert rig.read(0x6061) == mode


@pytest.mark.conformance(
    "CiA 402",
    "change of mode in OPERATION ENABLED",
    "target torque is zero on entry to a mode, and on entry to and exit from OPERATION ENABLED",
)
def test_a_change_of_mode_ends_the_torque() -> None:
    rig = enabled()
    assert target(rig, 400, 50) == pytest.approx(450.0)
    assert rig.write(0x6060, 0, PROFILE, 1) == 0
    assert (rig.read(0x6061), rig.read(0x6071), rig.read(0x60B2)) == (PROFILE, 0, 0)
    rig.wait(100)
    assert permille(rig) == 0.0
    assert rig.state == OPERATION_ENABLED
    assert target(rig, 400) == 0.0  # the ramp begins at zero
    rig.wait(20)
    rig.send("080#")
    assert permille(rig) == pytest.approx(400.0)
    assert rig.write(0x6060, 0, CYCLIC, 1) == 0
    assert permille(rig) == 0.0


@pytest.mark.conformance(
    "CiA 402", "target torque is zero on entry to a mode, and on entry to and exit from OPERATION ENABLED"
)
@pytest.mark.parametrize("word", [0x00, 0x02, 0x06, 0x07])
def test_the_target_is_zero_after_each_exit_and_entry(word: int) -> None:
    rig = enabled()
    target(rig, 400, 50)
    assert rig.write(0x6040, 0, word, 2) == 0
    assert (rig.read(0x6071), rig.read(0x60B2), permille(rig)) == (0, 0, 0.0)
    assert rig.write(0x6071, 0, 300, 2) == 0  # written while disabled
    for enable in (0x00, 0x06, 0x07, 0x0F):
        rig.wait(1000)
        assert rig.write(0x6040, 0, enable, 2) == 0
    assert rig.state == OPERATION_ENABLED
    assert (rig.read(0x6071), permille(rig)) == (0, 0.0)


@pytest.mark.conformance(
    "CiA 402",
    "ratings 0x6075 and 0x6076",
    "actual values 0x6077, 0x6078, 0x6079, 0x606C, 0x6064, as much as the plant says",
)
def test_ratings_and_actual_values() -> None:
    rig = enabled()
    ratings = rig.config.ratings
    assert rig.read(0x6075) == round(ratings.rated_current_a * 1000)
    assert rig.read(0x6076) == round(ratings.rated_torque_nm * 1000)
    target(rig, -250)
    rig.plant.dc_link_v = 47.25
    rig.wait(500)
    rig.send("080#")
    signed = {2: 1 << 15, 4: 1 << 31}
    for index, size, expected in (
        (0x6077, 2, -250), (0x6078, 2, -250), (0x6064, 4, rig.plant.counts),
        (0x606C, 4, round(rig.plant.velocity_rps * ratings.velocity_counts_per_rps)),
    ):  # fmt: skip
        raw = rig.read(index)
        assert raw - (raw >= signed[size]) * 2 * signed[size] == pytest.approx(expected, abs=1)
    assert rig.read(0x6079) == 47250


@pytest.mark.conformance(
    "CiA 402",
    "interpolation period 0x60C2 that is not 0x1006: EMCY 0x8700 (this project's choice)",
)
def test_interpolation_period() -> None:
    rig = Rig()
    rig.operational()
    assert rig.write(0x1006, 0, 500, 4) == 0
    rig.enable()
    assert rig.read(0x1003, 1) & 0xFFFF == 0x8700
    assert rig.statusword & 0x80
    assert rig.write(0x6040, 0, 0x06, 2) == 0
    assert (rig.write(0x60C2, 1, 5, 1), rig.write(0x60C2, 2, -4, 1)) == (0, 0)
    rig.enable()
    assert (rig.read(0x1001), rig.statusword & 0x80) == (0, 0)

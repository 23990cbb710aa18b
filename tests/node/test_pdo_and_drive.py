"""PDO and CiA 402 as frames: mapping rules, SYNC, deadlines; the state machine, torque and how it stops."""

from __future__ import annotations

import struct

import pytest
from node.node_rig import OPERATION_ENABLED, Rig

CANNOT_MAP = 0x06040041
READ_ONLY = (0x06010002, 0x06010000)


def moving_rig() -> Rig:
    """Mapped, operational, enabled in cyclic synchronous torque."""
    rig = Rig()
    rig.map_cyclic()
    rig.operational()
    assert rig.write(0x6060, 0, 10, 1) == 0
    for word in (0x00, 0x06, 0x07, 0x0F, 0x0F):  # a command before the first SYNC is outside its window
        rig.cycle(word, 0)
    assert rig.state == OPERATION_ENABLED
    return rig


def test_a_mapping_changes_only_while_its_pdo_is_disabled() -> None:
    rig = Rig()
    rig.map_cyclic()
    assert rig.write(0x1A00, 0, 0, 1) != 0
    assert rig.write(0x1800, 1, 0xC0000181, 4) == 0
    assert rig.write(0x1A00, 0, 0, 1) == 0
    assert rig.write(0x1A00, 1, 0x10180120, 4) in (CANNOT_MAP, 0x06020000)  # an identity cannot be mapped
    assert rig.write(0x1A00, 1, 0x606C0020, 4) == 0


def test_a_sync_is_answered_with_what_is_mapped_and_applies_the_last_command() -> None:
    rig = moving_rig()
    sent = rig.cycle(0x0F, 100)
    assert [frame.partition("#")[0] for frame in sent] == ["181", "281"]
    before = rig.plant.velocity_rps
    rig.cycle(0x0F, 100)  # the command of the last cycle acts from that SYNC to this one
    amperes = 100 * rig.config.ratings.a_per_permille
    assert rig.plant.velocity_rps - before == pytest.approx(amperes * rig.plant.rps2_per_a * 5e-4, rel=0.02)
    velocity, position = struct.unpack("<ii", bytes.fromhex(rig.cycle(0x0F, 0)[0].partition("#")[2]))
    assert velocity == pytest.approx(rig.plant.velocity_rps * 32768, rel=0.02)
    assert position == rig.plant.counts


def test_a_short_command_is_refused_and_a_long_one_taken_with_a_warning() -> None:
    rig = moving_rig()
    assert "081#1082" in rig.send("201#0F00")[0]
    assert rig.read(0x1003, 1) & 0xFFFF == 0x8210
    rig.send("201#0F0064000000")
    assert rig.read(0x1003, 1) & 0xFFFF == 0x8220


def test_a_command_that_stays_away_is_a_fault_after_its_deadline() -> None:
    rig = Rig()
    rig.map_cyclic()
    assert rig.write(0x1400, 1, 0x80000201, 4) == 0
    assert rig.write(0x1400, 5, 20, 2) == 0
    assert rig.write(0x1400, 1, 0x201, 4) == 0
    rig.operational()
    assert rig.write(0x6060, 0, 10, 1) == 0
    for word in (0x00, 0x06, 0x07, 0x0F, 0x0F):  # a command before the first SYNC is outside its window
        rig.cycle(word, 0)
    assert rig.state == OPERATION_ENABLED
    for _ in range(60):  # SYNC goes on, commands do not
        rig.wait(0.5)
        rig.send("080#")
    assert rig.read(0x1003, 1) & 0xFFFF == 0x8250
    assert rig.state != OPERATION_ENABLED


def test_quick_stop_brakes_and_ends_disabled() -> None:
    rig = moving_rig()
    for _ in range(400):
        rig.cycle(0x0F, 200)
    speed = rig.plant.velocity_rps
    assert speed > 2.0
    for _ in range(2000):
        rig.cycle(0x02, 200)
        if rig.state == 0x40:
            break
    assert rig.state == 0x40
    assert abs(rig.plant.velocity_rps) < 0.2  # a rigid body without friction would have run on
    assert min(rig.plant.torque_seen) < 0.0


def test_disabling_the_voltage_coasts() -> None:
    rig = moving_rig()
    for _ in range(200):
        rig.cycle(0x0F, 200)
    rig.cycle(0x00, 200)
    rig.cycle(0x00, 200)
    speed = rig.plant.velocity_rps
    for _ in range(100):
        rig.cycle(0x00, 200)
    assert rig.plant.velocity_rps == speed


def test_the_target_is_zero_after_the_drive_is_enabled_again() -> None:
    rig = moving_rig()
    rig.cycle(0x0F, 300)
    rig.cycle(0x00, 0)
    for word in (0x06, 0x07, 0x0F):
        assert rig.write(0x6040, 0, word, 2) == 0
    speed = rig.plant.velocity_rps
    rig.wait(50)
    assert rig.plant.velocity_rps == pytest.approx(speed, abs=1e-9)


def test_the_command_is_clamped_to_the_torque_limit() -> None:
    rig = moving_rig()
    assert rig.write(0x6072, 0, 100, 2) == 0
    rig.cycle(0x0F, 1000)
    rig.cycle(0x0F, 1000)
    assert max(rig.plant.torque_seen) <= 100 * rig.config.ratings.a_per_permille + 1e-9
    assert rig.statusword & 0x0800  # internal limit active


def test_feedback_objects_are_read_only() -> None:
    rig = Rig()
    for index, size in ((0x6041, 2), (0x6064, 4), (0x606C, 4), (0x6077, 2), (0x6061, 1), (0x6502, 4)):
        assert rig.write(index, 0, 0, size) in READ_ONLY

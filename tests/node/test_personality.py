"""What drives do otherwise: late modes, warnings, brakes, safe torque off, a low DC link, local control."""

from __future__ import annotations

import pytest
from node.node_rig import ENABLE, OPERATION_ENABLED, Rig, RigidBody

from fffo_drive.documents import DocumentError
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.personality import Personality
from fffo_drive.drive.simulated.node.simulated_plant import SimulatedPlant
from fffo_drive.drive.simulated.parameters import PlantConfigError

SWITCH_ON_DISABLED, READY = 0x40, 0x21
FOLLOWS, REMOTE, VOLTAGE, WARNING = 0x1000, 0x0200, 0x0010, 0x0080


def rig_of(**personality: object) -> Rig:
    return Rig(NodeConfig(personality=Personality(**personality)).validate())  # type: ignore[arg-type]


def command_all(rig: Rig) -> None:
    for word in ENABLE:
        assert rig.write(0x6040, 0, word, 2) == 0


@pytest.mark.conformance("CiA 402", "0x6061 that follows late: with the next SYNC, or when enabled")
def test_the_mode_is_shown_with_the_next_sync() -> None:
    rig = rig_of(mode_display="with_sync")
    assert rig.write(0x6060, 0, 10, 1) == 0
    rig.wait(100)
    assert rig.read(0x6061) == 0
    rig.send("080#")
    assert rig.read(0x6061) == 10


@pytest.mark.conformance("CiA 402", "0x6061 that follows late: with the next SYNC, or when enabled")
def test_the_mode_is_shown_when_enabled_and_acts_from_then_on() -> None:
    rig = rig_of(mode_display="when_enabled")
    assert rig.write(0x6060, 0, 10, 1) == 0
    for word in ENABLE[:-1]:
        assert rig.write(0x6040, 0, word, 2) == 0
        rig.send("080#")
        assert rig.read(0x6061) == 0
    assert rig.write(0x6040, 0, ENABLE[-1], 2) == 0
    assert rig.read(0x6061) == 10
    assert rig.write(0x6071, 0, 100, 2) == 0
    assert rig.node.drive.current_command_a > 0.0
    assert rig.write(0x6060, 0, 4, 1) == 0
    assert rig.read(0x6061) == 4


@pytest.mark.conformance("CiA 301", "a warning: a code, 0x1001 = 0, no fault")
def test_a_warning_with_each_enabling() -> None:
    rig = rig_of(warning_code=0xFF10)
    assert rig.write(0x6060, 0, 10, 1) == 0
    sent = [frame for word in ENABLE for frame in rig.send(f"601#2B406000{word:02X}000000")]
    assert "081#10FF000000000000" in sent
    assert (rig.state, rig.read(0x1001), rig.statusword & WARNING) == (OPERATION_ENABLED, 0, 0)
    assert rig.read(0x1003, 1) == 0xFF10


@pytest.mark.conformance("CiA 301", "a warning: a code, 0x1001 = 0, no fault")
def test_a_warning_at_a_time() -> None:
    rig = rig_of(warning_code=0x5441, warning_at_s=2.0)
    assert rig.wait(1999) == []
    assert rig.wait(2) == ["081#4154000000000000"]
    assert rig.wait(10_000) == []


def test_a_command_that_is_not_followed_shows_in_bit_12() -> None:
    hidden, refused, normal = rig_of(command_following="not_shown"), rig_of(command_following="refused"), Rig()
    for rig in (hidden, refused, normal):
        rig.enable()
        assert rig.write(0x6071, 0, 200, 2) == 0
    assert [rig.statusword & FOLLOWS for rig in (hidden, refused, normal)] == [0, 0, FOLLOWS]
    assert hidden.node.drive.current_command_a == normal.node.drive.current_command_a > 0.0
    assert refused.node.drive.current_command_a == 0.0


def test_local_control_takes_no_controlword() -> None:
    rig = rig_of(remote=False)
    assert rig.write(0x6060, 0, 10, 1) == 0
    command_all(rig)
    assert (rig.state, rig.statusword & REMOTE) == (SWITCH_ON_DISABLED, 0)


@pytest.mark.conformance("CiA 402", "0x60FD shows safe torque off; the drive then does not switch on")
@pytest.mark.parametrize("bit", [3, 23])
def test_safe_torque_off(bit: int) -> None:
    rig = rig_of(sto_active=True, sto_input_bit=bit)
    assert rig.write(0x6060, 0, 10, 1) == 0
    command_all(rig)
    assert (rig.state, rig.statusword & VOLTAGE) == (SWITCH_ON_DISABLED, 0)
    assert rig.read(0x60FD) == 1 << bit
    assert Rig().read(0x60FD) == 0


@pytest.mark.conformance("CiA 402", "low DC link: 0x6079 and bit 4 tell it, the drive does not switch on")
def test_a_low_dc_link() -> None:
    rig = rig_of(dc_link_share=0.5)
    assert rig.write(0x6060, 0, 10, 1) == 0
    command_all(rig)
    rig.send("080#")
    assert (rig.state, rig.statusword & VOLTAGE, rig.read(0x6079)) == (SWITCH_ON_DISABLED, 0, 24_000)
    enough = rig_of(dc_link_share=0.7)
    enough.enable()
    assert enough.statusword & VOLTAGE


def test_a_fault_can_be_reset_without_power() -> None:
    rig = rig_of(sto_active=True)
    rig.node.drive.trip(0x4310)
    rig.send("080#")
    assert rig.state == 0x08
    for word in (0x00, 0x80):
        assert rig.write(0x6040, 0, word, 2) == 0
    assert rig.state == SWITCH_ON_DISABLED


# --- brake


class Held(RigidBody):
    """A body with a holding brake."""

    held = False

    def hold(self, held: bool) -> None:
        self.held = held
        if held:
            self.velocity_rps = 0.0

    def advance(self, until_ns: int, current_a: float) -> None:
        angle_rev = self.angle_rev
        super().advance(until_ns, current_a)
        if self.held:
            self.angle_rev, self.velocity_rps = angle_rev, 0.0


@pytest.mark.conformance("CiA 402", "a brake that opens after enabling: torque acts on a held shaft")
def test_torque_meets_a_held_shaft_until_the_brake_opens() -> None:
    rig = Rig(NodeConfig(personality=Personality(brake_release_s=0.05)), Held())
    rig.enable()
    assert rig.write(0x6071, 0, 100, 2) == 0
    rig.wait(49)
    assert (rig.plant.velocity_rps, rig.plant.current_a > 0.0) == (0.0, True)
    rig.wait(1)
    rig.wait(100)
    current_a = rig.node.drive.current_command_a
    assert rig.plant.velocity_rps == pytest.approx(current_a * RigidBody.rps2_per_a * 0.1, rel=0.11)  # polled at 10 ms
    assert rig.write(0x6040, 0, 0, 2) == 0
    assert (rig.plant.held, rig.plant.velocity_rps) == (True, 0.0)  # type: ignore[attr-defined]


@pytest.mark.conformance("CiA 402", "0x60FE digital outputs; its bit 0 sets the brake")
def test_the_brake_is_a_digital_output() -> None:
    plant = Held()
    rig = Rig(NodeConfig(personality=Personality(brake_release_s=0.01)), plant)
    rig.enable()
    rig.wait(20)
    assert not plant.held
    assert rig.write(0x60FE, 1, 1, 4) == 0
    assert not plant.held  # the mask does not let it act
    assert rig.write(0x60FE, 2, 1, 4) == 0
    assert plant.held
    assert rig.write(0x60FE, 1, 0xFFFE, 4) == 0
    assert not plant.held
    assert rig.read(0x60FE, 1) == 0xFFFE


def test_the_brake_holds_the_plant_itself() -> None:
    plant = SimulatedPlant(NodeConfig().plant)
    plant.hold(True)
    plant.advance(20_000_000, 5.0)
    assert (plant.true_velocity_rps, plant.current_a > 3.0) == (0.0, True)
    plant.hold(False)
    plant.advance(40_000_000, 5.0)
    assert plant.true_velocity_rps > 1.0
    plant.hold(True)
    plant.advance(41_000_000, 5.0)
    assert plant.true_velocity_rps == 0.0


# --- the vendor's mode


@pytest.mark.conformance("CiA 402", "a mode of the vendor's own with its own target")
def test_a_torque_mode_of_the_vendor() -> None:
    rig = rig_of(vendor_mode=-5, vendor_target="0x201C:00", vendor_units_per_a=2000.0)
    assert rig.write(0x201C, 0, 3000, 4) == 0
    rig.enable(mode=-5)
    assert rig.read(0x6061) == 0xFB
    assert rig.node.drive.current_command_a == 0.0  # the target of before is forgotten
    assert rig.write(0x201C, 0, 3000, 4) == 0
    assert rig.node.drive.current_command_a == pytest.approx(1.5)
    assert rig.write(0x6071, 0, 500, 2) == 0
    assert rig.node.drive.current_command_a == pytest.approx(1.5)  # 0x6071 is not the target of this mode
    assert rig.write(0x201C, 0, -2_000_000_000, 4) == 0
    assert rig.node.drive.current_command_a == pytest.approx(-rig.config.plant.peak_current_a)
    assert rig.write(0x1400, 1, 0x80000201, 4) == 0  # and it can be mapped
    assert rig.write(0x1600, 0, 0, 1) == 0
    assert rig.write(0x1600, 1, 0x201C0020, 4) == 0


def test_the_profile_torque_of_a_drive_whose_slope_was_never_set_jumps() -> None:
    rig = rig_of(lowest={"0x6087:00": 0}, values={"0x6087:00": 0})
    rig.enable(mode=4)
    rig.wait(1)
    assert rig.write(0x6071, 0, 300, 2) == 0
    assert rig.read(0x6074) == 300


# --- values and limits


def test_other_values_and_limits() -> None:
    rig = rig_of(
        values={"0x1000:00": 0xFFFF0192},
        lowest={"0x60C2:01": 1, "0x60C2:02": -3},
        highest={"0x60C2:02": -3},
    )
    assert rig.read(0x1000) == 0xFFFF0192
    assert rig.write(0x60C2, 2, -4, 1) == 0x06090032
    assert rig.write(0x60C2, 2, -2, 1) == 0x06090031
    assert rig.write(0x60C2, 1, 0, 1) == 0x06090032
    assert (rig.write(0x60C2, 1, 2, 1), rig.write(0x60C2, 2, -3, 1)) == (0, 0)


@pytest.mark.parametrize(
    ("personality", "said"),
    [
        ({"values": {"6076": 0}}, "personality.values.6076: an object is named 0xINDEX:SUB"),
        ({"values": {"0x6999:00": 0}}, "personality.values.0x6999:00: the drive has no such number"),
        ({"values": {"0x1008:00": 0}}, "personality.values.0x1008:00: the drive has no such number"),
        ({"lowest": {"0x60C2:02": -300}}, "-300 is outside -128 to 127, the range of INTEGER8"),
        ({"lowest": {"0x60C2:02": -2}, "highest": {"0x60C2:02": -3}}, "-3 is below the lowest, -2"),
        ({"vendor_mode": -5}, "personality.vendor_target: the vendor's mode needs an object"),
        ({"vendor_target": "201C"}, "personality.vendor_target: the vendor's mode needs an object"),
        ({"vendor_target": "0x201C:00", "vendor_target_bits": 12}, "12 is none of 8, 16, 32"),
        ({"vendor_mode": -5, "vendor_target": "0x1008:00"}, "0x1008:00 is VISIBLE_STRING, no number"),
        ({"dc_link_share": 3.0}, "personality.dc_link_share: 3 is outside 0 to 2"),
    ],
)
def test_a_personality_that_no_drive_has(personality: dict[str, object], said: str) -> None:
    with pytest.raises(PlantConfigError) as caught:
        NodeConfig(personality=Personality(**personality)).validate()  # type: ignore[arg-type]
    assert said in str(caught.value)


def test_the_section_of_the_file(tmp_path) -> None:
    from fffo_drive.config.simulated import read_simulated

    path = tmp_path / "drive.yaml"
    path.write_text(
        "format: fffo_drive/simulated/1\npersonality:\n  rtr_bit: required\n  mode_display: with_sync\n"
        "  values: {'0x6076:00': 0}\n  vendor_mode: -5\n  vendor_target: '0x201C:00'\n"
    )
    personality = read_simulated(path).personality
    assert personality == Personality(
        rtr_bit="required", mode_display="with_sync", values={"0x6076:00": 0}, vendor_mode=-5, vendor_target="0x201C:00"
    )
    path.write_text("personality: {rtr_bit: maybe, values: {'0x6999:00': 1}}\n")
    with pytest.raises(DocumentError, match=r"drive.yaml:1: personality.rtr_bit: 'free' or 'required' is needed"):
        read_simulated(path)
    path.write_text("personality: {values: {'0x6999:00': 1}}\n")
    with pytest.raises(
        DocumentError, match=r"drive.yaml:1: personality.values.0x6999:00: the drive has no such number"
    ):
        read_simulated(path)

"""Injected faults of the drive: resolver, supply, electronics; what the bus shows of them, and what the motor does."""

from __future__ import annotations

import struct

import pytest
from node.injection_rig import FAULT, FRA, SOD, cycles, flat, identifiers, inject, turning
from node.node_rig import OPERATION_ENABLED, Rig

from fffo_drive.can.frame import ERROR_BUS_OFF, ERROR_RESTARTED
from fffo_drive.config.simulated import read_simulated
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.faults import Fault, FaultKind
from fffo_drive.drive.simulated.node.simulated_plant import SimulatedPlant
from fffo_drive.drive.simulated.parameters import PlantConfig


@pytest.mark.conformance(
    "CiA 402", "resolver lost with a jump of the angle; a slip that nothing tells of", "0x7303 resolver"
)
def test_resolver_loss() -> None:
    rig = turning()
    rig.plant.velocity_rps = 5.0
    cycles(rig, 1)
    before = struct.unpack("<i", struct.pack("<I", rig.read(0x6064)))[0]
    assert "081#0373210000000000" in inject(rig, FaultKind.RESOLVER_LOSS, value=250, ms=100)
    cycles(rig, 20, torque=500)
    assert (rig.read(0x603F), rig.read(0x1001) & 0x21) == (0x7303, 0x21)
    assert rig.state == FAULT  # at once: without an angle there is no braking
    held = rig.read(0x6064)
    assert held - before == pytest.approx(8192, abs=100)  # a quarter of 32768
    speed = rig.plant.velocity_rps
    rig.wait(50)
    assert rig.read(0x6064) == held  # frozen, the shaft turns on
    assert rig.plant.velocity_rps == speed
    assert rig.write(0x6040, 0, 0x00, 2) == 0
    assert rig.write(0x6040, 0, 0x80, 2) == 0
    assert rig.state == FAULT  # not while the signal is away
    rig.wait(100)
    assert rig.write(0x6040, 0, 0x00, 2) == 0
    assert rig.write(0x6040, 0, 0x80, 2) == 0
    assert rig.state == SOD
    rig.wait(10)
    assert rig.read(0x6064) == rig.plant.counts != held


@pytest.mark.conformance("CiA 402", "resolver lost with a jump of the angle; a slip that nothing tells of")
def test_resolver_slip_is_reported_by_nobody() -> None:
    rig = turning()
    cycles(rig, 1)
    assert inject(rig, FaultKind.RESOLVER_SLIP, value=-125) == []
    assert "081" not in flat(cycles(rig, 10))
    assert rig.state == OPERATION_ENABLED
    assert rig.read(0x6064) == rig.plant.counts % (1 << 32)
    assert rig.plant.counts == pytest.approx(rig.plant.angle_rev * 32768 - 4096, abs=2)


@pytest.mark.conformance("CiA 402", "DC link lost")
def test_dc_link_loss() -> None:
    rig = turning()
    assert "081#2032050000000000" in inject(rig, FaultKind.DC_LINK_LOSS, ms=100)
    speed = rig.plant.velocity_rps
    assert "081" not in flat(cycles(rig, 20, torque=500))
    assert (rig.read(0x603F), rig.state, rig.statusword & 0x10) == (0x3220, FAULT, 0)
    assert rig.plant.velocity_rps == pytest.approx(speed, abs=1e-9)
    rig.wait(200)
    assert rig.statusword & 0x10  # the supply is back, the fault stays
    assert rig.state == FAULT


@pytest.mark.conformance(
    "CiA 402", "DC link lost", "resolver lost with a jump of the angle; a slip that nothing tells of"
)
def test_the_real_plant_loses_supply_and_resolver() -> None:
    faults = (
        Fault(FaultKind.DC_LINK_LOSS, at_s=0.2, duration_s=0.3),
        Fault(FaultKind.RESOLVER_LOSS, at_s=1.0, jump_rev=0.5),
    )
    plant = SimulatedPlant(PlantConfig())
    rig = Rig(NodeConfig(faults=faults), plant)  # type: ignore[arg-type]
    rig.operational()
    rig.enable()
    rig.write(0x6071, 0, 500, 2)
    rig.wait(199)
    assert plant.true_velocity_rps > 1.0
    rig.wait(30)
    assert rig.state == FAULT
    assert rig.read(0x603F) == 0x3220
    assert rig.read(0x6079) < 30_000
    rig.wait(350)
    assert rig.read(0x6079) == 48_000
    for word in (0x00, 0x80, 0x06, 0x0F):
        rig.write(0x6040, 0, word, 2)
    rig.write(0x6071, 0, 500, 2)
    rig.wait(100)
    assert rig.state == OPERATION_ENABLED
    rig.wait(600)
    assert (rig.state, rig.read(0x603F)) == (FAULT, 0x7303)
    assert plant.true_velocity_rps > 0.5  # coasts
    frozen = rig.read(0x6064)
    rig.wait(50)
    assert rig.read(0x6064) == frozen
    assert plant.current_a == pytest.approx(0.0, abs=0.2)


@pytest.mark.conformance("CiA 402", "overcurrent and temperature")
@pytest.mark.parametrize(
    ("kind", "code", "brakes"), [(FaultKind.OVERCURRENT, 0x2310, False), (FaultKind.OVERTEMPERATURE, 0x4310, True)]
)
def test_conditions(kind: FaultKind, code: int, brakes: bool) -> None:
    rig = turning()
    assert [frame for frame in inject(rig, kind, ms=2000) if frame.startswith(f"081#{code & 0xFF:02X}{code >> 8:02X}")]
    cycles(rig, 5)
    assert rig.read(0x603F) == code
    speed = rig.plant.velocity_rps
    rig.wait(1500)
    assert rig.state == FAULT
    assert (abs(rig.plant.velocity_rps) < 0.2) is brakes
    assert (rig.plant.velocity_rps == speed) is not brakes
    rig.wait(1000)
    assert rig.write(0x6040, 0, 0x00, 2) == 0
    assert rig.write(0x6040, 0, 0x80, 2) == 0
    assert rig.state == SOD


@pytest.mark.conformance("CiA 402", "bus-off as error frames")
def test_bus_off() -> None:
    rig = turning()
    assert inject(rig, FaultKind.BUS_OFF, ms=100) == [f"{ERROR_BUS_OFF:08X}#!"]
    assert rig.wait(10) == []  # nothing leaves
    assert rig.send("601#4000100000000000") == []  # nothing arrives
    assert rig.state in (FRA, FAULT)
    sent = rig.wait(1000)
    assert sent[:2] == [f"{ERROR_RESTARTED:08X}#!", "081#4081110000000000"]
    assert rig.node.nmt.state == 127
    assert rig.state == FAULT
    assert abs(rig.plant.velocity_rps) < 0.2
    assert rig.read(0x603F) == 0x8100


def test_bus_off_begins_with_an_error_frame() -> None:
    rig = Rig(NodeConfig(faults=(Fault(FaultKind.BUS_OFF, at_s=0.01, duration_s=0.02),)))
    assert rig.wait(50) == [f"{ERROR_BUS_OFF:08X}#!", f"{ERROR_RESTARTED:08X}#!", "081#4081000000000000"]


@pytest.mark.conformance("CiA 402", "statusword stuck")
def test_stuck_statusword() -> None:
    rig = turning(deadline_ms=0)
    word = rig.statusword
    inject(rig, FaultKind.STUCK_STATUSWORD, ms=300)
    for _ in range(100):
        sent = rig.cycle(0x02, 0)  # quick stop
        assert sent[1].startswith(f"281#{word.to_bytes(2, 'little').hex().upper()}")
    rig.wait(200)
    assert rig.statusword == word
    assert abs(rig.plant.velocity_rps) < 1.0  # it brakes all the same
    rig.wait(500)
    assert (rig.state, abs(rig.plant.velocity_rps) < 0.2) == (SOD, True)


@pytest.mark.conformance("CiA 402", "EMCY storm")
def test_emcy_storm() -> None:
    rig = turning()
    inject(rig, FaultKind.EMCY_STORM, value=1000, ms=100)
    seen = flat(cycles(rig, 300))
    assert 99 <= seen.count("081") <= 101
    assert rig.read(0x1003, 0) == 8
    assert rig.state == OPERATION_ENABLED  # messages, no error
    assert rig.read(0x1001) == 0


@pytest.mark.conformance("CiA 402", "reboot in mid-run")
def test_reboot() -> None:
    rig = turning()
    cycles(rig, 3, torque=300)
    rig.write(0x1017, 0, 10, 2)
    inject(rig, FaultKind.REBOOT, ms=100)
    speed = rig.plant.velocity_rps
    seen = cycles(rig, 199, torque=300)
    assert flat(seen) == []  # the electronics are dead
    assert rig.plant.velocity_rps == pytest.approx(speed, abs=1e-9)  # the shaft coasts
    assert flat(cycles(rig, 3, torque=300)) == ["701"]  # boot-up
    assert (rig.node.nmt.state, rig.state) == (127, SOD)
    assert rig.read(0x1017) == 0
    assert rig.read(0x1A00, 1) == 0x60410010  # the mapping of power-on
    assert rig.plant.velocity_rps == pytest.approx(speed, abs=1e-9)


def test_silence_is_a_cable_that_is_pulled() -> None:
    rig = turning()
    inject(rig, FaultKind.SILENCE, ms=100)
    assert flat(cycles(rig, 150)) == []
    rig.wait(1000)
    assert rig.state == FAULT  # its RPDO deadline passed
    assert abs(rig.plant.velocity_rps) < 0.2


@pytest.mark.conformance("CiA 402", "from the configuration, and at run time by 0x2100")
def test_a_schedule_from_a_file(tmp_path) -> None:
    path = tmp_path / "drive.yaml"
    path.write_text(
        "format: fffo_drive/simulated/1\nfaults:\n"
        "  - {kind: drop_sent, at_s: 0.1, duration_s: 0.1, can_id: 0x701}\n"
        "  - {kind: emcy_storm, at_s: 0.3, duration_s: 0.01, rate_hz: 1000}\n"
    )
    config = read_simulated(path)
    assert [fault.kind for fault in config.faults] == [FaultKind.DROP_SENT, FaultKind.EMCY_STORM]
    rig = Rig(config)
    rig.write(0x1017, 0, 10, 2)
    assert identifiers(rig.wait(400)).count("701") == pytest.approx(31, abs=1)
    assert rig.read(0x1003, 0) == 8


def test_what_0x2100_refuses() -> None:
    rig = Rig()
    assert rig.write(0x2100, 1, 99, 1) == 0x06090030
    assert rig.write(0x2100, 6, 1, 1) == 0x08000022  # no kind chosen
    assert rig.write(0x2100, 3, 1001, 2) == 0x06090031


def test_every_kind_can_begin_and_end_at_any_time() -> None:
    for kind in FaultKind:
        rig = turning()
        inject(rig, kind, value=100, ms=20)
        cycles(rig, 100, torque=100)
        rig.wait(500)
        assert not rig.node.faults.dark
        assert rig.node.faults.quiet
        assert not rig.node.drive.injected

"""Faults that the drive measures: one code in EMCY, 0x603F and 0x1003, and what becomes of the torque."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from node.node_rig import Rig, RigidBody, text

from fffo_drive.can.frame import ERROR_BUS_OFF, ERROR_RESTARTED, MAX_DATA, pack_frame

FAULT, FRA, SOD = 0x08, 0x0F, 0x40


class Measured(RigidBody):
    """A motor whose measured current can be another than the commanded one."""

    excess_a = 0.0

    def advance(self, until_ns: int, current_a: float) -> None:
        super().advance(until_ns, current_a)
        self.current_a += self.excess_a


def turning() -> Rig:
    rig = Rig(plant=Measured())
    rig.operational()
    rig.enable()
    rig.plant.velocity_rps = 5.0
    rig.write(0x6071, 0, 100, 2)
    rig.wait(20)
    return rig


def overcurrent(rig: Rig) -> None:
    ratings = rig.config.ratings
    rig.plant.excess_a = 1.6 * ratings.peak_permille * ratings.a_per_permille


def undervoltage(rig: Rig) -> None:
    rig.plant.dc_link_v = 20.0


def overvoltage(rig: Rig) -> None:
    rig.plant.dc_link_v = 70.0


def heat(rig: Rig) -> None:
    rig.plant.temperature_k = 81.0


def overspeed(rig: Rig) -> None:
    rig.plant.velocity_rps = 1.25 * rig.node.od.number(0x6080) / 60.0


@pytest.mark.conformance(
    "CiA 402",
    "EMCY, 0x603F and 0x1001 tell the same; FAULT REACTION ACTIVE, then FAULT",
    "0x2310 overcurrent",
    "0x3210 and 0x3220 DC link",
    "0x4310 temperature",
    "0x7310 speed",
)
@pytest.mark.parametrize(
    ("cause", "code", "register", "brakes"),
    [
        (overcurrent, 0x2310, 0x03, False),
        (undervoltage, 0x3220, 0x05, False),
        (overvoltage, 0x3210, 0x05, False),
        (heat, 0x4310, 0x09, True),
        (overspeed, 0x7310, 0x21, True),
    ],
)
def test_measured_faults(cause: Callable[[Rig], None], code: int, register: int, brakes: bool) -> None:
    rig = turning()
    cause(rig)
    sent = rig.wait(10)
    assert [frame for frame in sent if frame.startswith("081")] == [
        f"081#{code.to_bytes(2, 'little').hex().upper()}{register:02X}0000000000"
    ]
    assert (rig.read(0x603F), rig.read(0x1001), rig.read(0x1003, 1)) == (code, register, code)
    assert rig.state == (FRA if brakes else FAULT)
    speed = rig.plant.velocity_rps
    rig.plant.excess_a = 0.0
    rig.wait(2000)
    assert rig.state == FAULT
    if brakes:
        assert abs(rig.plant.velocity_rps) < 0.1
    else:  # without current measurement or supply there is nothing to brake with
        assert rig.plant.velocity_rps == speed
    rig.plant.dc_link_v, rig.plant.temperature_k = 48.0, 0.0
    assert "081#0000000000000000" in rig.send("601#2B40600080000000")
    assert (rig.state, rig.read(0x603F), rig.read(0x1001)) == (SOD, 0, 0)


def test_the_end_of_a_fault_is_reported_once() -> None:
    rig = turning()
    heat(rig)
    rig.wait(1000)
    rig.plant.temperature_k = 0.0
    assert "081#0000000000000000" in rig.send("601#2B40600080000000")
    assert not [frame for frame in rig.send("601#2B40600000000000") if frame.startswith("081")]


def test_a_second_fault_does_not_hide_the_first() -> None:
    rig = turning()
    heat(rig)
    rig.wait(10)
    undervoltage(rig)
    rig.wait(1000)
    assert rig.read(0x603F) == 0x4310


@pytest.mark.conformance("CiA 402", "0x8140 after a bus-off")
def test_bus_off_and_its_end() -> None:
    rig = turning()
    off = pack_frame(ERROR_BUS_OFF, bytes(MAX_DATA), error=True)
    assert "081#0081110000000000" in map(text, rig.node.handle(off, rig.now_ns))
    assert rig.node.nmt.state == 127  # 0x1029:1 = 0
    rig.wait(1000)
    assert (rig.state, rig.read(0x603F)) == (FAULT, 0x8100)
    back = pack_frame(ERROR_RESTARTED, bytes(MAX_DATA), error=True)
    assert [text(frame) for frame in rig.node.handle(back, rig.now_ns)] == ["081#4081110000000000"]
    assert rig.state == FAULT  # being back enables nothing


def test_an_interface_that_goes_away_is_a_bus_off() -> None:
    rig = turning()
    rig.node.bus_changed(False, rig.now_ns)
    rig.wait(1000)
    assert rig.state == FAULT
    assert [text(frame) for frame in rig.node.bus_changed(True, rig.now_ns)] == ["081#4081110000000000"]

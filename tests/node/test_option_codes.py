"""Option codes as motion: how long a stop takes is compared with the closed form of the brake.

The motor is a rigid body, dv/dt = c i (c = 20 (rev/s2)/A). On a ramp r(t) = v0 - a t with the drive's own speed loop
i = K (r - v), the lag e = v - r obeys e' = a - k e with k = c K; after the ramp v decays with k. At the current limit I
the speed falls with c I until K v = I, then with k.
"""

from __future__ import annotations

import math

import pytest
from node.node_rig import NS_PER_MS, OPERATION_ENABLED, Rig, RigidBody

from fffo_drive.can.frame import ERROR_BUS_OFF, MAX_DATA, pack_frame
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.parameters import DeviceConfig

GAIN_A_PER_RPS = 4.0
SLOW_RPS2, QUICK_RPS2 = 20.0, 80.0
STANDSTILL_RPS = 0.1
SPEED_RPS = 10.0
DECAY_HZ = RigidBody.rps2_per_a * GAIN_A_PER_RPS
STEP_MS = 0.5
SOD, RTSO, SO, QSA, FRA, FAULT = 0x40, 0x21, 0x23, 0x07, 0x0F, 0x08
COASTS = math.inf


def turning(mode: int = 10, **options: int) -> Rig:
    """Enabled without torque, at 10 rev/s. `options`: o605A=1 and so on."""
    device = DeviceConfig(
        brake_gain_a_per_rps=GAIN_A_PER_RPS,
        slow_ramp_rps2=SLOW_RPS2,
        quick_ramp_rps2=QUICK_RPS2,
        standstill_rps=STANDSTILL_RPS,
    )
    rig = Rig(NodeConfig(device=device))
    rig.operational()
    for name, value in options.items():
        assert rig.write(int(name[1:], 16), 0, value, 2) == 0
    rig.enable(mode)
    rig.plant.velocity_rps = SPEED_RPS
    return rig


def ramp_s(deceleration_rps2: float) -> float:
    """Closed form of the time to standstill on a ramp."""
    ramp = SPEED_RPS / deceleration_rps2
    lag_rps = deceleration_rps2 / DECAY_HZ * (1.0 - math.exp(-DECAY_HZ * ramp))
    return ramp + max(0.0, math.log(lag_rps / STANDSTILL_RPS)) / DECAY_HZ


def limit_s(rig: Rig) -> float:
    """Closed form of the time to standstill at the current limit 0x6072."""
    limit_a = rig.node.od.number(0x6072) * rig.config.ratings.a_per_permille
    linear_to_rps = limit_a / GAIN_A_PER_RPS
    linear_s = (SPEED_RPS - linear_to_rps) / (RigidBody.rps2_per_a * limit_a)
    return linear_s + math.log(linear_to_rps / STANDSTILL_RPS) / DECAY_HZ


def stop_s(rig: Rig, most_s: float = 1.5) -> float:
    """Time until the motor stands, SYNC going on; infinite when it does not."""
    begin_ns = rig.now_ns
    while rig.now_ns - begin_ns < most_s * 1e3 * NS_PER_MS:
        if abs(rig.plant.velocity_rps) < STANDSTILL_RPS:
            return (rig.now_ns - begin_ns) / 1e9
        rig.wait(STEP_MS)
        rig.send("080#")
    return COASTS


def closely(expected_s: float) -> object:
    """Within what steps of 0.5 ms and a current that is held for one allow."""
    return pytest.approx(expected_s, abs=3e-3)


@pytest.mark.conformance("CiA 402", "0x605A 0: coasts")
def test_quick_stop_0_disables() -> None:
    rig = turning(o605A=0)
    rig.write(0x6040, 0, 0x02, 2)
    rig.send("080#")
    assert rig.state == SOD
    assert stop_s(rig) == COASTS
    assert rig.plant.velocity_rps == SPEED_RPS


@pytest.mark.conformance("CiA 402", "0x605A 1 and 2: ramps of 0x6084 and 0x6085")
@pytest.mark.parametrize(("option", "deceleration"), [(1, SLOW_RPS2), (2, QUICK_RPS2)])
def test_quick_stop_on_a_ramp(option: int, deceleration: float) -> None:
    rig = turning(o605A=option)
    rig.write(0x6040, 0, 0x02, 2)
    assert rig.state == QSA
    assert stop_s(rig) == closely(ramp_s(deceleration))
    rig.wait(1)
    rig.send("080#")
    assert rig.state == SOD
    assert rig.node.drive.current_command_a == 0.0


def test_a_ramp_that_is_changed_takes_another_time() -> None:
    rig = turning(o605A=2)
    per_rps = rig.config.ratings.velocity_counts_per_rps
    assert rig.write(0x6085, 0, 40 * per_rps, 4) == 0
    rig.write(0x6040, 0, 0x02, 2)
    assert stop_s(rig) == closely(ramp_s(40.0))


@pytest.mark.conformance("CiA 402", "0x605A 3: current limit")
@pytest.mark.parametrize("limit_permille", [100, 300])
def test_quick_stop_at_the_current_limit(limit_permille: int) -> None:
    rig = turning(o605A=3)
    assert rig.write(0x6072, 0, limit_permille, 2) == 0
    rig.write(0x6040, 0, 0x02, 2)
    assert stop_s(rig) == closely(limit_s(rig))
    limit_a = limit_permille * rig.config.ratings.a_per_permille
    assert min(rig.plant.torque_seen) == pytest.approx(-limit_a)


@pytest.mark.conformance("CiA 402", "0x605A 5, 6, 7: stays in QUICK STOP ACTIVE, transition 16")
@pytest.mark.parametrize("option", [5, 6, 7])
def test_quick_stop_that_stays(option: int) -> None:
    rig = turning(o605A=option)
    expected = {5: ramp_s(SLOW_RPS2), 6: ramp_s(QUICK_RPS2), 7: limit_s(rig)}[option]
    rig.write(0x6040, 0, 0x02, 2)
    assert stop_s(rig) == closely(expected)
    rig.wait(1000)
    assert rig.state == QSA
    rig.plant.velocity_rps = 1.0  # pushed: it holds
    assert stop_s(rig) < 0.1
    seen: list[int] = []
    rig.node.drive.on_transition.append(seen.append)
    rig.write(0x6040, 0, 0x0F, 2)
    assert (rig.state, seen) == (OPERATION_ENABLED, [16])
    assert rig.read(0x6071) == 0


@pytest.mark.conformance("CiA 402", "0x605B shutdown: 0 coasts, 1 ramp", "0x605C disable operation: 0 coasts, 1 ramp")
@pytest.mark.parametrize(("option", "word", "state"), [(0x605B, 0x06, RTSO), (0x605C, 0x07, SO)])
def test_shutdown_and_disable_operation(option: int, word: int, state: int) -> None:
    rig = turning(**{f"o{option:04X}": 0})
    rig.write(0x6040, 0, word, 2)
    assert rig.state == state
    assert stop_s(rig) == COASTS
    rig = turning(**{f"o{option:04X}": 1})
    rig.write(0x6040, 0, word, 2)
    assert rig.state == OPERATION_ENABLED  # until the ramp has ended
    assert stop_s(rig) == closely(ramp_s(SLOW_RPS2))
    rig.wait(2)
    rig.send("080#")
    assert rig.state == state


def test_a_deferred_shutdown_is_given_up_for_a_quick_stop() -> None:
    rig = turning(o605B=1, o605A=2)
    rig.write(0x6040, 0, 0x06, 2)
    rig.write(0x6040, 0, 0x02, 2)
    assert rig.state == QSA
    assert stop_s(rig) == closely(ramp_s(QUICK_RPS2))
    rig.wait(10)
    assert rig.state == SOD


@pytest.mark.conformance("CiA 402", "0x605D halt: 1, 2, 3", "bit 10 target reached")
@pytest.mark.parametrize("option", [1, 2, 3])
def test_halt_in_the_torque_profile_mode(option: int) -> None:
    rig = turning(mode=4, o605D=option)
    expected = {1: ramp_s(SLOW_RPS2), 2: ramp_s(QUICK_RPS2), 3: limit_s(rig)}[option]
    rig.write(0x6071, 0, 100, 2)
    rig.write(0x6040, 0, 0x010F, 2)
    assert rig.state == OPERATION_ENABLED
    assert rig.statusword & 0x0400 == 0
    assert stop_s(rig) == closely(expected)
    rig.wait(1)
    rig.send("080#")
    assert rig.statusword & 0x0400  # it stands
    rig.wait(1000)
    assert abs(rig.plant.velocity_rps) < STANDSTILL_RPS
    rig.write(0x6040, 0, 0x000F, 2)  # the target acts again
    rig.wait(100)
    rig.send("080#")
    assert rig.node.drive.current_command_a == pytest.approx(100 * rig.config.ratings.a_per_permille)


def test_the_cyclic_mode_has_no_halt() -> None:
    rig = turning(o605D=2)
    rig.write(0x6040, 0, 0x010F, 2)
    assert stop_s(rig) == COASTS


@pytest.mark.conformance("CiA 402", "0x605E fault reaction: 0 coasts, 1, 2, 3")
@pytest.mark.parametrize("option", [0, 1, 2, 3])
def test_fault_reaction(option: int) -> None:
    rig = turning(o605E=option)
    expected = {0: COASTS, 1: ramp_s(SLOW_RPS2), 2: ramp_s(QUICK_RPS2), 3: limit_s(rig)}[option]
    rig.node.drive.trip(0xFF01)
    rig.send("080#")
    assert rig.state == (FRA if option else FAULT)
    assert stop_s(rig) == (closely(expected) if option else COASTS)
    rig.wait(1)
    rig.send("080#")
    assert rig.state == FAULT
    assert rig.node.drive.current_command_a == 0.0


def test_a_load_that_does_not_stop_is_let_go() -> None:
    class Driven(RigidBody):
        def advance(self, until_ns: int, current_a: float) -> None:
            super().advance(until_ns, current_a)
            self.velocity_rps = SPEED_RPS

    rig = Rig(plant=Driven())
    rig.operational()
    rig.enable()
    rig.wait(20)
    rig.write(0x6040, 0, 0x02, 2)
    rig.wait(2900)
    assert rig.state == QSA
    rig.wait(500)
    assert rig.state == SOD


# --- 0x6007


def lose_heartbeat(rig: Rig) -> None:
    assert rig.write(0x1029, 1, 1, 1) == 0  # the NMT state stays
    assert rig.write(0x1016, 1, 127 << 16 | 10, 4) == 0
    rig.send("77F#05")
    rig.wait(11)


def lose_bus(rig: Rig) -> None:
    rig.node.handle(pack_frame(ERROR_BUS_OFF, bytes(MAX_DATA), error=True), rig.now_ns)


def lose_commands(rig: Rig) -> None:
    for sub, value, size in ((1, 0x80000301, 4), (5, 10, 2), (1, 0x301, 4)):
        assert rig.write(0x1401, sub, value, size) == 0
    rig.send("301#0F000000")
    rig.wait(11)


def lose_sync(rig: Rig) -> None:
    assert rig.write(0x60C2, 1, 1, 1) == 0
    assert rig.write(0x1006, 0, 1000, 4) == 0
    assert rig.write(0x2010, 0, 10, 2) == 0
    rig.send("080#")
    rig.wait(12)


LOSSES = {
    "heartbeat": (lose_heartbeat, 0x8130),
    "bus": (lose_bus, 0x8100),
    "stop": (lambda rig: rig.send("000#0201"), 0x8100),
    "pre-operational": (lambda rig: rig.send("000#8001"), 0x8100),
    "reset": (lambda rig: rig.send("000#8201"), 0x8100),
    "commands": (lose_commands, 0x8250),
    "sync": (lose_sync, 0x8700),
}


@pytest.mark.conformance(
    "CiA 402",
    "0x6007 (0, 1, 2, 3) on loss of heartbeat, bus-off, NMT stop and reset, RPDO deadline, loss of SYNC",
    "0x8130, 0x8250, 0x8700 as faults by 0x6007 = 1",
)
@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("option", [0, 1, 2, 3])
def test_abort_connection(loss: str, option: int) -> None:
    rig = turning(o6007=option, o605A=2, o605E=1)
    lose, code = LOSSES[loss]
    lose(rig)
    assert rig.state == {0: OPERATION_ENABLED, 1: FRA, 2: SOD, 3: QSA}[option]
    rig.wait(1000)
    assert rig.state == {0: OPERATION_ENABLED, 1: FAULT, 2: SOD, 3: SOD}[option]
    assert rig.node.od.number(0x603F) == (code if option == 1 else 0)
    if option in (0, 2):
        assert rig.plant.velocity_rps == SPEED_RPS
    else:
        assert abs(rig.plant.velocity_rps) < STANDSTILL_RPS


@pytest.mark.parametrize("loss", LOSSES)
def test_a_drive_without_torque_takes_no_notice(loss: str) -> None:
    rig = turning(o6007=1)
    rig.write(0x6040, 0, 0x00, 2)
    LOSSES[loss][0](rig)
    assert rig.state == SOD

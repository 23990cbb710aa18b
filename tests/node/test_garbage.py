"""Garbage at the node: it neither crashes nor hangs, and no torque flows that nobody ordered."""

from __future__ import annotations

import random
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from node.garbage import anything, malformed, raw
from node.node_rig import OPERATION_ENABLED, Rig, RigidBody

from fffo_drive.can.frame import pack_frame
from fffo_drive.drive.simulated import cia402_device as cia402
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.faults import FaultKind

OWN_IDS = [0x000, 0x080, 0x201, 0x301, 0x601, 0x77F]
LSS = 0x7E5
MAY_BRAKE = (cia402.QUICK_STOP_ACTIVE, cia402.FAULT_REACTION_ACTIVE)
# injected faults have tests of their own; "load" is not hit by chance, "save" would keep what chance wrote
NOT_BY_CHANCE = (0x2100, 0x1010, 0x1011)
MOST_ANSWERS = 200  # of one frame: a block of 127 segments, and TPDOs


class Guarded(RigidBody):
    """A motor that knows whether it may be driven."""

    rig: Rig | None = None
    watched = 0

    def advance(self, until_ns: int, current_a: float) -> None:
        if self.rig is not None and current_a != 0.0:
            drive = self.rig.node.drive
            allowed = drive.state == cia402.OPERATION_ENABLED or (drive.braking and drive.state in MAY_BRAKE)
            assert allowed, f"{current_a} A in state {cia402.STATE_NAMES[drive.state]}"
            self.watched += 1
        super().advance(until_ns, current_a)


def guarded() -> Rig:
    plant = Guarded()
    plant.rig = rig = Rig(NodeConfig(), plant)
    return rig


def still_a_drive(rig: Rig) -> None:
    """After a reset it boots, answers and can be used."""
    rig.node.faults.clear()
    rig.wait(2000)
    assert "701#00" in rig.send("000#8101")
    assert rig.read(0x1000) == 0x00020192
    rig.plant.velocity_rps = 0.0
    rig.map_cyclic()
    rig.operational()
    rig.enable()


def bombard(rig: Rig, batches: object, seed: int) -> None:
    """Hand every frame over, with time passing in between."""
    steps = np.random.default_rng(seed)
    node = rig.node
    for frames in batches:  # type: ignore[attr-defined]
        for frame, step_ns in zip(raw(frames), steps.integers(0, 100_000, len(frames)).tolist(), strict=True):
            rig.now_ns += step_ns
            if node.deadline_ns <= rig.now_ns:
                assert len(node.poll(rig.now_ns)) < MOST_ANSWERS
                assert node.deadline_ns > rig.now_ns
            assert len(node.handle(frame, rig.now_ns)) < MOST_ANSWERS


def malformed_frames_change_nothing(count: int) -> None:
    rig = guarded()
    rig.map_cyclic()
    assert rig.write(0x1017, 0, 1000, 2) == 0  # with a heartbeat the remote frame of node guarding is no question
    rig.operational()
    rig.send("080#")
    rig.wait(20)
    before = list(rig.node.od.values)
    sent: list[bytes] = []
    for frames in malformed(1, count, [*OWN_IDS, 0x701, LSS]):
        for frame in raw(frames):
            sent += rig.node.handle(frame, rig.now_ns)
    assert sent == []
    counter = rig.node.od.slots[0x202006]
    assert rig.node.od.values[counter] > 0
    before[counter] = rig.node.od.values[counter]
    assert rig.node.od.values == before
    assert (rig.state, rig.node.nmt.state) == (0x40, 5)


def anything_goes_without_torque(count: int) -> None:
    rig = guarded()
    rig.map_cyclic()
    for index, sub, value, size in ((0x1016, 1, 127 << 16 | 50, 4), (0x6060, 0, 10, 1)):
        assert rig.write(index, sub, value, size) == 0
    assert rig.write(0x1010, 1, int.from_bytes(b"save", "little"), 4) == 0  # resets come back to this
    objects = [entry.index << 8 | entry.sub for entry in rig.node.od.entries if entry.index not in NOT_BY_CHANCE]
    bombard(rig, anything(2, count, OWN_IDS, objects), 3)
    assert rig.plant.watched > count // 10_000  # it was enabled, by legal commands, and stopped, again and again
    still_a_drive(rig)


@pytest.mark.conformance("CiA 402", "a million frames of garbage: nothing crashes, hangs or enables")
def test_malformed_frames_change_nothing() -> None:
    malformed_frames_change_nothing(20_000)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.conformance("CiA 402", "a million frames of garbage: nothing crashes, hangs or enables")
def test_a_million_malformed_frames_change_nothing() -> None:
    malformed_frames_change_nothing(1_000_000)


@pytest.mark.conformance(
    "CiA 402",
    "a million frames of garbage: nothing crashes, hangs or enables",
    "no torque outside OPERATION ENABLED but the drive's own braking, whatever is sent",
)
def test_any_frames() -> None:
    anything_goes_without_torque(20_000)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.conformance("CiA 402", "a million frames of garbage: nothing crashes, hangs or enables")
def test_a_million_of_any_frames() -> None:
    anything_goes_without_torque(1_000_000)


@pytest.mark.parametrize("length", [0, 1, 4, 5, 8, 15, 17, 64, 72])
def test_what_is_no_frame_at_all(length: int) -> None:
    rig = guarded()
    assert rig.node.handle(bytes(range(length)), rig.now_ns) == []
    assert rig.read(0x2020, 6) == 1


@pytest.mark.conformance("CiA 402", "random access to the object dictionary")
def test_random_access_to_the_object_dictionary() -> None:
    rig = guarded()
    rig.operational()
    chance = random.Random(4)
    entries = rig.node.od.entries
    for _ in range(20_000):
        entry = chance.choice(entries)
        index = chance.choice((entry.index, entry.index, entry.index, chance.randrange(0x10000)))
        sub = chance.choice((entry.sub, entry.sub, entry.sub, chance.randrange(256)))
        value = chance.choice((0, 1, 6, 7, 15, 0x80, 0x206, chance.getrandbits(32)))
        if index == 0x2100:
            continue  # faults have tests of their own
        command = chance.choice((0x40, 0x23, 0x2B, 0x2F, 0x22, chance.randrange(256)))
        request = pack_frame(0x601, struct.pack("<BHBI", command, index, sub, value))
        assert len(rig.node.handle(request, rig.now_ns)) < MOST_ANSWERS
        if chance.random() < 0.1:
            rig.wait(chance.choice((0.1, 1.0, 11.0)))
        if chance.random() < 0.05:
            rig.send(chance.choice(("080#", "000#0101", "000#8001", "201#0F00", "000#8101")))
    still_a_drive(rig)


class AnyCommands(RuleBasedStateMachine):
    """Controlwords, modes, NMT, faults and pauses in any order: the motor itself watches over its torque."""

    def __init__(self) -> None:
        super().__init__()
        self.rig = guarded()
        self.rig.map_cyclic()
        self.rig.operational()
        self.rig.write(0x6060, 0, 10, 1)

    @rule(
        word=st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x10F, 0x80, 0x8F, 0xFFFF]), torque=st.integers(-3000, 3000)
    )
    def cycle(self, word: int, torque: int) -> None:
        self.rig.cycle(word, torque)

    @rule(torque=st.integers(-3000, 3000))
    def enable(self, torque: int) -> None:
        for word in (0x00, 0x06, 0x07, 0x0F, 0x0F):
            self.rig.cycle(word, torque)

    @rule(word=st.integers(0, 0xFFFF))
    def write_controlword(self, word: int) -> None:
        self.rig.send("601#2B406000" + struct.pack("<I", word).hex())

    @rule(mode=st.sampled_from([0, 4, 10]))
    def select_mode(self, mode: int) -> None:
        self.rig.send(f"601#2F606000{mode:02X}000000")

    @rule(index=st.sampled_from([0x6007, 0x605A, 0x605B, 0x605C, 0x605D, 0x605E]), value=st.integers(0, 7))
    def option(self, index: int, value: int) -> None:
        self.rig.send("601#2B" + struct.pack("<HBI", index, 0, value).hex())

    @rule(command=st.sampled_from(["000#0101", "000#0201", "000#8001", "000#8101", "000#8201"]))
    def network(self, command: str) -> None:
        self.rig.send(command)

    @rule(kind=st.sampled_from(sorted(FaultKind)), milliseconds=st.integers(1, 30))
    def fault(self, kind: FaultKind, milliseconds: int) -> None:
        for sub, value, command in ((1, kind, 0x2F), (4, 100, 0x23), (5, milliseconds, 0x23), (6, 1, 0x2F)):
            self.rig.send(f"601#{command:02X}" + struct.pack("<HBI", 0x2100, sub, value).hex())
        self.rig.wait(0)

    @rule(rps=st.floats(-20, 20))
    def push(self, rps: float) -> None:
        self.rig.plant.velocity_rps = rps

    @rule(milliseconds=st.floats(0.1, 50))
    def wait(self, milliseconds: float) -> None:
        self.rig.wait(milliseconds)

    @invariant()
    def no_torque_outside_operation_enabled(self) -> None:
        drive = self.rig.node.drive
        if drive.state != cia402.OPERATION_ENABLED and not drive.braking:
            assert drive.current_command_a == 0.0


@pytest.mark.conformance("CiA 402", "no torque outside OPERATION ENABLED but the drive's own braking, whatever is sent")
class TestAnyCommands(AnyCommands.TestCase):  # type: ignore[misc, name-defined]
    settings = settings(max_examples=60, stateful_step_count=30, suppress_health_check=[HealthCheck.too_slow])


def test_the_motor_would_notice() -> None:
    """The guard of these tests bites: torque is seen where it belongs, and reported where it does not."""
    rig = guarded()
    rig.operational()
    rig.enable()
    rig.write(0x6071, 0, 100, 2)
    rig.wait(20)
    assert rig.state == OPERATION_ENABLED
    assert rig.plant.watched > 0
    rig.node.drive.state = cia402.SWITCHED_ON
    with pytest.raises(AssertionError, match="switched on"):
        rig.wait(20)

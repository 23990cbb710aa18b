"""Injected faults of the wire: what the bus shows of them, and what the motor does."""

from __future__ import annotations

import pytest
from node.injection_rig import FAULT, clear, cycles, flat, identifiers, inject, turning
from node.node_rig import OPERATION_ENABLED, Rig

from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.faults import Fault, FaultKind


@pytest.mark.conformance(
    "CiA 402",
    "frames dropped, doubled, delayed, with jitter, reordered; in both directions",
    "from the configuration, and at run time by 0x2100",
)
def test_drop_sent() -> None:
    rig = turning()
    inject(rig, FaultKind.DROP_SENT, can_id=0x181)
    assert cycles(rig, 5) == [["281"]] * 5
    inject(rig, FaultKind.DROP_SENT, can_id=0x281)
    assert rig.read(0x2100, 7) == 2
    assert cycles(rig, 5) == [[]] * 5
    clear(rig)
    assert cycles(rig, 5) == [["181", "281"]] * 5


@pytest.mark.conformance("CiA 402", "frames dropped, doubled, delayed, with jitter, reordered; in both directions")
def test_drop_received_is_a_command_that_stays_away() -> None:
    rig = turning()
    inject(rig, FaultKind.DROP_RECEIVED, can_id=0x201)
    seen = flat(cycles(rig, 45))
    assert "081" in seen
    assert rig.read(0x1003, 1) & 0xFFFF == 0x8250
    rig.wait(1000)
    assert rig.state == FAULT  # 0x6007 = 1
    assert abs(rig.plant.velocity_rps) < 0.2


@pytest.mark.conformance("CiA 402", "frames dropped, doubled, delayed, with jitter, reordered; in both directions")
def test_a_share_of_the_frames_and_the_same_share_again() -> None:
    def lost() -> list[int]:
        rig = turning()
        inject(rig, FaultKind.DROP_SENT, can_id=0x181, share=300)
        return [k for k, seen in enumerate(cycles(rig, 400)) if "181" not in seen]

    assert 90 < len(lost()) < 150
    assert lost() == lost()  # the seed


@pytest.mark.conformance("CiA 402", "frames dropped, doubled, delayed, with jitter, reordered; in both directions")
def test_duplicates() -> None:
    rig = turning()
    inject(rig, FaultKind.DUPLICATE_SENT, can_id=0x181)
    assert cycles(rig, 3) == [["181", "181", "281"]] * 3
    clear(rig)
    applied = rig.read(0x2020, 3)
    inject(rig, FaultKind.DUPLICATE_RECEIVED, can_id=0x201)
    speed = rig.plant.velocity_rps
    cycles(rig, 11, torque=100)
    assert rig.read(0x2020, 3) == applied + 11  # buffered twice, applied once
    gained = 10 * 5e-4 * 100 * rig.config.ratings.a_per_permille * rig.plant.rps2_per_a
    assert rig.plant.velocity_rps - speed == pytest.approx(gained)
    inject(rig, FaultKind.DUPLICATE_RECEIVED, can_id=0x80)
    syncs = rig.read(0x2020, 1)
    assert cycles(rig, 2) == [["181", "281", "181", "281"]] * 2  # two SYNCs
    assert rig.read(0x2020, 1) == syncs + 4


@pytest.mark.conformance("CiA 402", "frames dropped, doubled, delayed, with jitter, reordered; in both directions")
def test_each_fault_doubles_the_frame_and_not_what_others_made_of_it() -> None:
    rig = turning()
    for _ in range(40):
        inject(rig, FaultKind.DUPLICATE_SENT, can_id=0x181)
    assert cycles(rig, 1) == [["181"] * 41 + ["281"]]


@pytest.mark.conformance("CiA 402", "frames dropped, doubled, delayed, with jitter, reordered; in both directions")
def test_delays() -> None:
    rig = turning()
    inject(rig, FaultKind.DELAY_SENT, can_id=0x181, value=200)  # us
    rig.send("201#0F000000")
    assert identifiers(rig.send("080#")) == ["281"]
    assert rig.wait(0.199) == []
    assert identifiers(rig.wait(0.002)) == ["181"]
    clear(rig)
    inject(rig, FaultKind.DELAY_RECEIVED, can_id=0x201, value=700)
    rig.send("201#0F006400")
    rig.wait(0.5)
    rig.send("080#")
    assert rig.read(0x6071) == 0  # the command has missed its SYNC
    rig.wait(0.5)
    rig.send("080#")
    assert rig.read(0x6071) == 100


@pytest.mark.conformance(
    "CiA 402",
    "frames dropped, doubled, delayed, with jitter, reordered; in both directions",
    "SYNC lost or with jitter",
)
def test_sync_with_jitter() -> None:
    rig = turning()
    inject(rig, FaultKind.DELAY_RECEIVED, can_id=0x80, value=50, jitter=200)
    late_ns = []
    for _ in range(200):
        rig.send("201#0F000000")
        begin_ns = rig.now_ns
        assert rig.send("080#") == []
        late_ns.append(rig.node.deadline_ns - begin_ns)
        assert "181" in identifiers(rig.wait(0.5))
    assert 50_000 <= min(late_ns) < 60_000
    assert 240_000 < max(late_ns) <= 250_000
    assert sum(late_ns) / 200 == pytest.approx(150_000, rel=0.1)


@pytest.mark.conformance("CiA 402", "SYNC lost or with jitter")
def test_sync_that_stops_is_a_loss_and_a_fault() -> None:
    rig = turning(deadline_ms=0)
    assert rig.write(0x1006, 0, 500, 4) == 0
    assert (rig.write(0x60C2, 1, 5, 1), rig.write(0x60C2, 2, -4, 1)) == (0, 0)
    assert rig.write(0x2010, 0, 10, 2) == 0
    cycles(rig, 2)
    inject(rig, FaultKind.DROP_RECEIVED, can_id=0x80)
    seen = flat(cycles(rig, 30))
    assert "181" not in seen
    assert seen.count("081") == 1
    assert rig.read(0x1003, 1) & 0xFFFF == 0x8700
    rig.wait(1000)
    assert (rig.state, rig.read(0x603F)) == (FAULT, 0x8700)
    assert abs(rig.plant.velocity_rps) < 0.2


@pytest.mark.conformance("CiA 402", "frames dropped, doubled, delayed, with jitter, reordered; in both directions")
def test_reordering() -> None:
    rig = turning()
    inject(rig, FaultKind.REORDER_SENT, can_id=0x181)
    assert cycles(rig, 3) == [["281", "181"]] * 3
    clear(rig)
    inject(rig, FaultKind.REORDER_RECEIVED, can_id=0x201)
    rig.send("201#0F006400")
    rig.send("080#")  # overtakes the command
    assert rig.read(0x6071) == 0
    rig.send("080#")
    assert rig.read(0x6071) == 100


@pytest.mark.conformance("CiA 402", "no answer to SYNC")
def test_no_answer_to_sync() -> None:
    rig = turning()
    rig.write(0x1017, 0, 10, 2)
    inject(rig, FaultKind.NO_SYNC_ANSWER, ms=50)
    seen = cycles(rig, 98, torque=100)
    assert flat(seen).count("701") == 4  # the rest of the node lives
    assert not {"181", "281"} & set(flat(seen))
    assert rig.plant.velocity_rps > 5.5  # and follows its commands
    cycles(rig, 4)
    assert {"181", "281"} <= set(cycles(rig, 1)[0])


def test_no_answer_to_sync_follows_the_identifiers() -> None:
    rig = Rig(NodeConfig(faults=(Fault(FaultKind.NO_SYNC_ANSWER),)))
    rig.wait(1)
    rig.map_cyclic()  # after the fault began; and SDO answers are none to SYNC
    rig.operational()
    assert rig.send("080#") == []


@pytest.mark.conformance("CiA 402", "no heartbeat")
def test_no_heartbeat() -> None:
    rig = turning()
    rig.write(0x1017, 0, 10, 2)
    assert "701" in identifiers(rig.wait(11))
    inject(rig, FaultKind.NO_HEARTBEAT, ms=200)
    assert "701" not in flat(cycles(rig, 300))
    assert rig.state == OPERATION_ENABLED
    assert "701" in flat(cycles(rig, 150))


@pytest.mark.conformance("CiA 402", "no RPDO received")
def test_no_rpdo() -> None:
    rig = turning()
    inject(rig, FaultKind.NO_RPDO, ms=100)
    applied = rig.read(0x2020, 3)
    cycles(rig, 100, torque=500)
    assert rig.read(0x2020, 3) == applied
    assert rig.read(0x1003, 1) & 0xFFFF == 0x8250
    rig.wait(1000)
    assert rig.state == FAULT
    assert abs(rig.plant.velocity_rps) < 0.2
    cycles(rig, 3)  # commands arrive again
    assert rig.read(0x1001) == 0x00 or rig.state == FAULT

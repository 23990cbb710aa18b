"""The cyclic exchange, frame by frame: a peer in the same thread says what a drive, or a broken one, would.

Delivery on the loopback bus is done when send() returns, so the scripts need no waiting: a cut-off in the
past makes `port_receive` take what is there, and only what is there.
"""

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fffo_drive.can.frame import ERROR_BUS_OFF, ERROR_RESTARTED, pack_frame, unpack_frame
from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.drive.canopen import cyclic  # noqa: F401  registers the kernels
from fffo_drive.drive.canopen.config import CanopenDriveConfig
from fffo_drive.drive.canopen.object_map import MappedObject, MappingError, PdoMap
from fffo_drive.drive.canopen.port_memory import SEND_ATTEMPTS, make_port
from fffo_drive.drive.canopen.service_queue import MAX_AGE_NS, SLOTS, ServiceQueue
from fffo_drive.drive.port import (
    port_command,
    port_housekeeping,
    port_now_ns,
    port_receive,
    port_sleep_until,
    port_sync,
)

NODE = 5
COUNTS = 32768
FACTS = {
    "node_id": NODE,
    "period_ns": 500_000,
    "counts_per_rev": COUNTS,
    "velocity_units_per_rps": 1000.0,
    "torque_constant_nm_per_a": 0.1,
    "rated_torque_nm": 1.0,  # so that one ampere is 100 per mille
}


class Bench:
    """A port, and a peer that hears and says everything."""

    def __init__(self, **facts):
        self.config = CanopenDriveConfig(bus=f"loopback:{free_loopback_port()}", **{**FACTS, **facts})
        self.peer = open_link(self.config.bus)
        self.link = open_link(self.config.bus)
        self.queue = ServiceQueue(10_000_000_000)
        self.port = make_port(self.config, self.link, self.queue.memory)
        self.feedback = self.port.feedback[0]
        self.tick = -1

    def close(self):
        self.peer.close()
        self.link.close()

    def sync(self):
        self.tick += 1
        return port_sync(self.port, self.tick)

    def receive(self):
        """Take what is there; the cut-off has passed."""
        return port_receive(self.port, self.tick, port_now_ns(self.port) - 1)

    def say(self, can_id, data=b"", **flags):
        self.peer.send(pack_frame(can_id, data, **flags))

    def motion(self, velocity=0, position=0):
        self.say(0x180 + NODE, struct.pack("<ii", velocity, position))

    def status(self, statusword=0x27, torque=0):
        self.say(0x280 + NODE, struct.pack("<Hh", statusword, torque))

    def heard(self):
        frames = []
        while (raw := self.peer.receive(0.0)) is not None:
            frames.append(unpack_frame(raw))
        return frames

    def count(self, name):
        return int(self.feedback[name])


@pytest.fixture
def bench():
    made = Bench()
    yield made
    made.close()


def test_a_tick_in_order(bench):
    assert bench.sync() == 0
    bench.motion(-2500, COUNTS // 4)
    bench.status(0x1637, -150)
    assert bench.receive() == 1
    assert bench.feedback["velocity_rps"] == -2.5
    assert bench.feedback["position_rev"] == 0.25
    assert bench.feedback["statusword"] == 0x1637
    assert bench.feedback["current_a"] == pytest.approx(-1.5)
    assert bench.count("velocity_tick") == bench.count("status_tick") == 0
    assert math.isnan(bench.feedback["true_velocity_rps"])
    assert port_command(bench.port, 0, 0x000F, -1.234) == pytest.approx(-1.23)
    sync, command = bench.heard()
    assert (sync.can_id, sync.data) == (0x80, b"")
    assert (command.can_id, command.data) == (0x200 + NODE, struct.pack("<Hh", 0x0F, -123))


def test_the_answer_is_waited_for_and_stamped(bench):
    bench.sync()
    before = port_now_ns(bench.port)
    bench.motion()
    assert port_receive(bench.port, 0, before + 10**12) == 1  # returns at once, not at the cut-off
    assert before <= bench.count("received_ns") <= port_now_ns(bench.port)


def test_a_missing_answer_holds_the_last_value(bench):
    bench.sync()
    bench.motion(1000, 0)
    bench.receive()
    bench.sync()
    assert bench.receive() == 0
    assert bench.feedback["velocity_rps"] == 1.0
    assert bench.count("velocity_tick") == 0


def test_the_cut_off_ends_the_wait(bench):
    bench.sync()
    cutoff = port_now_ns(bench.port) + 200_000
    assert port_receive(bench.port, 0, cutoff) == 0
    assert port_now_ns(bench.port) >= cutoff


def test_late_feedback_is_counted_and_never_used(bench):
    bench.sync()
    assert bench.receive() == 0
    bench.motion(9999, 0)  # after the cut-off
    bench.sync()
    assert bench.count("late_feedback") == 1
    assert bench.receive() == 0
    assert bench.feedback["velocity_rps"] == 0.0
    assert bench.count("velocity_tick") == -1


def test_of_two_answers_after_one_sync_the_first_was_late(bench):
    bench.sync()
    bench.motion(1000)
    bench.motion(2000)
    assert bench.receive() == 1
    assert bench.feedback["velocity_rps"] == 2.0
    assert bench.count("late_feedback") == 1


def test_after_a_missing_answer_the_next_tick_waits_for_both(bench):
    bench.sync()
    assert bench.receive() == 0
    bench.sync()
    bench.motion(1000)  # the answer to the first SYNC, a whole period late
    bench.motion(2000)
    assert port_receive(bench.port, 1, port_now_ns(bench.port) + 10**12) == 1
    assert bench.feedback["velocity_rps"] == 2.0
    assert bench.count("late_feedback") == 1
    bench.sync()  # and then all is as before: one answer is enough
    bench.motion(3000)
    assert port_receive(bench.port, 2, port_now_ns(bench.port) + 10**12) == 1
    assert bench.feedback["velocity_rps"] == 3.0


def test_after_a_lost_frame_one_answer_is_taken_at_the_cut_off(bench):
    bench.sync()
    bench.receive()
    bench.sync()
    bench.motion(1000)
    assert bench.receive() == 1
    assert bench.feedback["velocity_rps"] == 1.0
    assert bench.count("late_feedback") == 0


def test_a_late_answer_in_the_queue_leaves_no_doubt(bench):
    bench.sync()
    bench.receive()
    bench.motion(1000)
    bench.sync()  # finds it
    bench.motion(2000)
    assert port_receive(bench.port, 1, port_now_ns(bench.port) + 10**12) == 1
    assert (bench.feedback["velocity_rps"], bench.count("late_feedback")) == (2.0, 1)


@pytest.mark.parametrize(
    "frame",
    [
        pack_frame(0x185, bytes(7)),  # short
        pack_frame(0x185, bytes(0)),
        pack_frame(0x185, bytes(8), extended=True),
        pack_frame(0x185, bytes(8), remote=True),
        pack_frame(0x285, bytes(8)),  # longer than mapped
        pack_frame(0x285, bytes(2)),
        pack_frame(0x705, b""),
        pack_frame(0x705, b"\x05\x00"),
        pack_frame(0x705, b"\x05", extended=True),
        pack_frame(0x085, b"\x10"),
        pack_frame(0x085, bytes(8), remote=True),
        pack_frame(0x185, bytes(8))[:4] + b"\x0c" + pack_frame(0x185, bytes(8))[5:],  # length 12
    ],
)
def test_malformed_frames_are_counted_and_never_used(bench, frame):
    before = bench.port.feedback.copy()
    bench.sync()
    bench.peer.send(frame)
    assert bench.receive() == 0
    assert bench.count("bad_frames") == 1
    before["bad_frames"] = 1
    assert before.tobytes() == bench.port.feedback.tobytes()


@pytest.mark.parametrize("can_id", [0x186, 0x585, 0x606, 0x706, 0x086, 0x206, 0x18FF0185])
def test_frames_of_others_are_passed_over(bench, can_id):
    before = bench.port.feedback.tobytes()
    bench.sync()
    bench.say(can_id, bytes(8), extended=can_id > 0x7FF)
    assert bench.receive() == 0
    assert before == bench.port.feedback.tobytes()


def test_the_position_counter_wraps(bench):
    # 16.7 million counts a tick, twice around the 32-bit counter, then back
    step = 2**24 - 1
    counts = [k * step for k in [*range(520), *range(520, -1, -1)]]
    for count in counts:
        bench.sync()
        bench.motion(0, (count + 2**31) % 2**32 - 2**31)
        assert bench.receive() == 1
        assert bench.feedback["position_rev"] == count / COUNTS


@given(st.integers(-(2**31), 2**31 - 1), st.lists(st.integers(-(2**30), 2**30), max_size=20))
@settings(max_examples=20)
def test_unwrapped_positions_follow_the_truth(first, steps):
    bench = Bench()
    try:
        truth = first
        for step in [0, *steps]:
            truth += step
            bench.sync()
            bench.motion(0, (truth + 2**31) % 2**32 - 2**31)
            assert bench.receive() == 1
            assert bench.feedback["position_rev"] == truth / COUNTS
    finally:
        bench.close()


@pytest.mark.parametrize(("raw", "velocity_rps"), [(2**31 - 1, 2147483.647), (-(2**31), -2147483.648), (-1, -0.001)])
def test_signed_extremes(bench, raw, velocity_rps):
    bench.sync()
    bench.motion(raw, 0)
    bench.receive()
    assert bench.feedback["velocity_rps"] == pytest.approx(velocity_rps, rel=1e-12)


def test_an_inverted_axis_turns_every_sign():
    bench = Bench(inverted=True)
    bench.sync()
    bench.motion(1000, COUNTS)
    bench.status(0x27, 100)
    bench.receive()
    assert (bench.feedback["velocity_rps"], bench.feedback["position_rev"]) == (-1.0, -1.0)
    assert bench.feedback["current_a"] == pytest.approx(-1.0)
    assert port_command(bench.port, 0, 0x0F, 2.0) == pytest.approx(2.0)
    assert bench.heard()[-1].data == struct.pack("<Hh", 0x0F, -200)
    bench.close()


def test_status_between_two_ticks_belongs_to_the_older(bench):
    bench.sync()
    bench.receive()
    bench.say(0x380 + NODE, struct.pack("<H", 0x0218))  # TPDO3, on event
    bench.sync()
    assert bench.count("statusword") == 0x0218
    assert bench.count("status_tick") == 0
    assert bench.count("late_feedback") == 0


def test_emergency_and_its_reset(bench):
    bench.sync()
    bench.say(0x080 + NODE, struct.pack("<HB5s", 0x8130, 0x11, b"abcde"))
    bench.receive()
    assert (bench.count("emergency_code"), bench.count("emergency_count")) == (0x8130, 1)
    bench.say(0x080 + NODE, bytes(8))
    bench.sync()
    assert (bench.count("emergency_code"), bench.count("emergency_count")) == (0, 1)


def test_an_emergency_that_only_warns_is_counted_apart():
    bench = Bench(warning_codes=(0xFF00, 0x8611))
    try:
        bench.sync()
        for code in (0xFF00, 0x8611, 0xFF01, 0xFF00, 0x0000):
            bench.say(0x080 + NODE, struct.pack("<HB5s", code, 0, b""))
            bench.receive()
        assert (bench.count("warning_code"), bench.count("warning_count")) == (0xFF00, 3)
        assert (bench.count("emergency_code"), bench.count("emergency_count")) == (0, 1)  # 0xFF01, and its reset
    finally:
        bench.close()


@pytest.mark.parametrize("code", [0, -1, 0x10000])
def test_a_warning_code_is_an_error_code_of_an_emergency(code):
    with pytest.raises(MappingError, match="warning_codes"):
        CanopenDriveConfig(bus="loopback:1", **FACTS, warning_codes=(code,))


def test_heartbeat_and_boot_up(bench):
    assert bench.count("heartbeat_ns") == -1
    assert bench.count("nmt_state") == -1
    bench.say(0x700 + NODE, b"\x85")  # with the toggle bit of node guarding
    bench.sync()
    assert bench.count("nmt_state") == 5
    assert 0 < bench.count("heartbeat_ns") <= port_now_ns(bench.port)
    bench.say(0x700 + NODE, b"\x00")
    bench.sync()
    assert (bench.count("boot_count"), bench.count("nmt_state")) == (1, 0)


def test_a_heartbeat_that_says_no_longer_operational_is_counted_once(bench):
    """What stays away from operational is one exit, whatever it says then; a boot-up counts as that alone."""
    found = []
    for state in (0x7F, 0x05, 0x05, 0x7F, 0x7F, 0x04, 0x05, 0x84, 0x05, 0x00, 0x7F, 0x05):
        bench.say(0x700 + NODE, bytes([state]))
        bench.sync()
        found.append((bench.count("nmt_exits"), bench.count("boot_count")))
    assert found == [(0, 0)] * 3 + [(1, 0)] * 4 + [(2, 0)] * 2 + [(2, 1)] * 3


def test_a_heartbeat_of_another_node_or_of_another_length_says_nothing(bench):
    bench.say(0x700 + NODE, b"\x05")
    bench.say(0x700 + NODE + 1, b"\x7f")
    bench.say(0x700 + NODE, b"\x7f\x00")
    bench.say(0x700 + NODE, b"")
    bench.say(0x700 + NODE, b"\x7f", remote=True)
    bench.say(0x700 + NODE, b"\x7f", extended=True)
    bench.sync()
    assert (bench.count("nmt_state"), bench.count("nmt_exits"), bench.count("bad_frames")) == (5, 0, 4)


def test_nothing_goes_out_while_the_controller_is_off_the_bus(bench):
    bench.sync()
    bench.say(ERROR_BUS_OFF, bytes(8), error=True)
    bench.receive()
    assert (bench.count("bus_off"), bench.count("error_frames")) == (1, 1)
    bench.queue.put(pack_frame(0x605, bytes(8)))
    bench.heard()
    assert port_command(bench.port, 0, 0x0F, 1.0) == 0.0
    port_housekeeping(bench.port, 0, False)
    assert bench.sync() < 0
    assert bench.heard() == []
    bench.say(ERROR_RESTARTED, bytes(8), error=True)
    assert bench.sync() == 0
    assert bench.count("bus_off") == 0
    port_housekeeping(bench.port, 1, False)
    port_housekeeping(bench.port, 1, False)
    stop, *others = bench.heard()
    assert (stop.can_id, stop.data) == (0x200 + NODE, struct.pack("<Hh", 0x02, 0))  # in front of the first SYNC
    assert [frame.can_id for frame in others] == [0x80, 0x77F]  # the old service frame is gone


def test_a_frame_from_the_bus_shows_that_it_is_back(bench):
    bench.say(ERROR_BUS_OFF, bytes(8), error=True)
    bench.sync()
    assert bench.count("bus_off") == 1
    bench.say(0x700 + NODE, b"\x05")
    assert bench.sync() == 0
    assert bench.count("bus_off") == 0


def test_other_error_frames_only_count(bench):
    bench.say(0x04, bytes(8), error=True)
    assert bench.sync() == 0
    assert (bench.count("error_frames"), bench.count("bus_off")) == (1, 0)


def test_a_failing_send_is_counted(bench):
    bench.link.close()
    assert bench.sync() < 0
    assert port_command(bench.port, 0, 0, 1.0) == 0.0
    assert bench.count("send_errors") == 2


@pytest.mark.parametrize(
    ("current_a", "permille"),
    [(0.0, 0), (1e-9, 0), (0.0051, 1), (-0.0051, -1), (327.67, 32767), (1e9, 32767), (-1e9, -32767),
     (math.inf, 32767), (-math.inf, -32767), (math.nan, 0)],
)  # fmt: skip
def test_commands_are_quantised_and_clamped(bench, current_a, permille):
    sent = port_command(bench.port, 0, 0xABCD, current_a)
    assert sent == pytest.approx(permille / 100.0)
    assert bench.heard()[0].data == struct.pack("<Hh", 0xABCD, permille)


def test_our_heartbeat_and_one_service_frame_a_tick():
    bench = Bench(heartbeat_ms=10_000_000, heartbeat_timeout_ms=20_000_000)
    for n in range(3):
        assert bench.queue.put(pack_frame(0x605, bytes([n])))
    bench.queue.memory.times[:] += 60_000_000_000  # however long this machine takes, they do not get old
    for tick in range(5):
        port_housekeeping(bench.port, tick, False)
        expected = [(0x77F, b"\x05")] if tick == 0 else [(0x605, bytes([tick - 1]))] if tick <= 3 else []
        assert [frame[:2] for frame in bench.heard()] == expected
    bench.close()


def test_stale_service_frames_are_thrown_away(bench):
    bench.queue.put(pack_frame(0x605, b"old"))
    bench.queue.put(pack_frame(0x605, b"new"))
    bench.queue.memory.times[0] -= 2 * MAX_AGE_NS
    port_housekeeping(bench.port, 0, False)
    port_housekeeping(bench.port, 1, False)
    assert [frame.data for frame in bench.heard()] == [b"\x05", b"new"]


def test_the_service_queue_is_bounded_and_goes_round():
    queue = ServiceQueue(10_000_000_000)
    bench = Bench()
    port = bench.port._replace(queue=queue.memory)
    assert not queue.loop_runs
    port_housekeeping(port, 0, False)  # the heartbeat
    assert queue.loop_runs
    for _ in range(3):
        for n in range(SLOTS):
            assert queue.put(pack_frame(n))
        assert not queue.put(pack_frame(0x7FF))
        bench.heard()
        for _ in range(SLOTS):
            port_housekeeping(port, 1, False)
        assert [frame.can_id for frame in bench.heard() if frame.can_id < 0x700] == list(range(SLOTS))
    bench.close()


def test_sends_are_known_so_that_drops_can_be_reported(bench):
    for _ in range(10):
        bench.sync()
        port_command(bench.port, 0, 0, 0.0)
    assert bench.port.memory[SEND_ATTEMPTS] == 20
    assert bench.link.dropped_frames(lambda: 20) == 0


def test_another_mapping_decodes_by_its_own_layout():
    def mapped(*entries):
        return tuple(MappedObject(index, 0, bits) for index, bits in entries)

    motion = PdoMap(1, 0x181, 1, mapped((0x6041, 16), (0x606C, 32), (0x6077, 16)))
    place = PdoMap(2, 0x281, 1, mapped((0x6061, 8), (0x6064, 32)))
    command = PdoMap(1, 0x333, 1, mapped((0x6060, 8), (0x6071, 16), (0x6040, 16)))
    bench = Bench(tpdos=(motion, place), rpdo=command)
    bench.sync()
    bench.say(0x181, struct.pack("<Hih", 0x237, -7000, 50))
    assert bench.receive() == 0  # the other half of the answer is out
    bench.say(0x281, struct.pack("<bi", 10, 3 * COUNTS))
    assert bench.receive() == 1
    assert (bench.feedback["velocity_rps"], bench.feedback["position_rev"]) == (-7.0, 3.0)
    assert (bench.count("statusword"), bench.feedback["current_a"]) == (0x237, pytest.approx(0.5))
    port_command(bench.port, 0, 0x0F, 1.0)
    assert bench.heard()[-1].data == struct.pack("<bhH", 10, 100, 0x0F)  # the mode stays what it is
    bench.close()


def test_sleep_until_a_time_that_has_passed(bench):
    assert port_sleep_until(bench.port, 0) == 0


FRAMES = st.builds(
    lambda word, length, data: np.array([word], np.uint32).tobytes() + bytes([length, 0, 0, 0]) + data,
    st.one_of(
        st.integers(0, 2**32 - 1),
        st.sampled_from([0x185, 0x285, 0x385, 0x085, 0x705, 0x80000185, 0x40000185, 0x20000040, 0x20000100]),
    ),
    st.integers(0, 255),
    st.binary(min_size=8, max_size=8),
)


@given(st.lists(FRAMES, max_size=30))
@settings(max_examples=50)
def test_garbage_never_breaks_the_books(frames):
    bench = Bench()
    try:
        bench.sync()
        for raw in frames:
            bench.peer.send(raw)
        fresh = bench.receive()
        good = [r for r in frames if r[:4] == np.uint32(0x185).tobytes() and r[4] == 8]
        assert fresh == (1 if good else 0)
        if good:
            velocity, _ = struct.unpack("<ii", good[-1][8:])
            assert bench.feedback["velocity_rps"] == pytest.approx(velocity / 1000.0)
            assert bench.count("late_feedback") == len(good) - 1
        errors = [r for r in frames if np.frombuffer(r[:4], np.uint32)[0] & 0x20000000]
        assert bench.count("error_frames") == len(errors)
    finally:
        bench.close()

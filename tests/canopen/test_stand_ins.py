"""Drives without what CiA 402 leaves optional, against a scripted node: other modes, other ways to notice silence."""

import dataclasses
import struct

import numpy as np
import pytest
from scripted_node import ScriptedNode, servo_dictionary

from fffo_drive.can.frame import pack_frame, unpack_frame
from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.drive.canopen.config import CanopenDriveConfig
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.canopen.object_map import MappedObject, PdoSlots
from fffo_drive.drive.canopen.port_memory import HEARTBEAT_FRAME, NO_LINK, make_port
from fffo_drive.drive.canopen.service_queue import ServiceQueue
from fffo_drive.drive.canopen.silence import life_factor
from fffo_drive.drive.port import DriveRefusedError, port_command, port_housekeeping, port_now_ns, port_sync

NODE = 5
U8, U16, U32 = (struct.Struct(code).pack for code in ("<B", "<H", "<I"))
GUARDING = {(0x100C, 0): U16(0), (0x100D, 0): U8(0)}


@pytest.fixture
def config():
    return CanopenDriveConfig(
        bus=f"loopback:{free_loopback_port()}", node_id=NODE, listen_s=0.02, period_ns=1_000_000, counts_per_rev=2000,
        velocity_units_per_rps=60.0, torque_constant_nm_per_a=0.1, rated_torque_nm=1.0, answer_timeout_s=1.0,
        start_timeout_s=0.2,
    )  # fmt: skip


def objects_of(add=None, without=()):
    found = {key: value for key, value in servo_dictionary(NODE).items() if key[0] not in without}
    return found | (add or {})


def refusal(config, objects):
    node = ScriptedNode(config.bus, NODE, objects)
    with node, pytest.raises(DriveRefusedError) as caught:
        CanopenDrive(config).connect()
    assert not [index for index, _, value in node.written if index == 0x6040 and any(value)]
    return str(caught.value)


class GuardedNode(ScriptedNode):
    """Answers guarding requests with its state and the toggle bit, and sends no heartbeat."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.asked = 0

    def send(self, can_id, data=b"", **flags):
        if can_id == 0x700 + self.node_id and data != b"\0":
            return
        super().send(can_id, data, **flags)

    def take(self, frame):
        if frame.remote and frame.can_id == 0x700 + self.node_id:
            state = 5 if 0x01 in self.commands else 0x7F
            super().send(0x700 + self.node_id, bytes([state | (self.asked & 1) << 7]))
            self.asked += 1


def test_life_guarding_stands_in_for_the_heartbeat(config):
    config = dataclasses.replace(config, silence_detection="life_guarding", heartbeat_ms=50, heartbeat_timeout_ms=170)
    with GuardedNode(config.bus, NODE, objects_of(GUARDING, without=(0x1016,))) as node:
        with CanopenDrive(config) as drive:
            assert (node.number(0x100C), node.number(0x100D), node.number(0x1017)) == (50, 4, 0)
            assert node.asked >= 1
            factors = [int.from_bytes(value, "little") for index, _, value in node.written if index == 0x100D]
            assert factors == [0, 4]  # only once it is operational: the loop asks from then on
            port = drive.port
            question = unpack_frame(bytes(port.frames[HEARTBEAT_FRAME]))
            assert (question.can_id, question.remote, len(question.data)) == (0x705, True, 1)
        assert node.number(0x100D) == 0  # leaving in order is no fault
    assert life_factor(config) == 4


def test_the_loop_asks_in_place_of_its_heartbeat(config):
    config = dataclasses.replace(config, silence_detection="life_guarding")
    with open_link(config.bus) as ours, open_link(config.bus) as other:
        port = make_port(config, ours, ServiceQueue(0).memory)
        port_housekeeping(port, 0, False)
        frame = unpack_frame(other.receive(1.0))
    assert (frame.can_id, frame.remote) == (0x700 + NODE, True)


def test_a_guarding_request_of_the_service_is_no_bad_frame(config):
    config = dataclasses.replace(config, silence_detection="life_guarding")
    with open_link(config.bus) as ours, open_link(config.bus) as other:
        port = make_port(config, ours, ServiceQueue(0).memory)
        other.send(pack_frame(0x700 + NODE, bytes(1), remote=True))
        other.send(pack_frame(0x700 + NODE, bytes([0x85])))  # the answer, toggle bit set
        deadline_ns = port_now_ns(port) + 1_000_000_000
        while port.feedback[0]["nmt_state"] < 0 and port_now_ns(port) < deadline_ns:
            port_sync(port, 1)
    assert (port.feedback[0]["bad_frames"], port.feedback[0]["nmt_state"]) == (0, 5)


def test_an_emcy_identifier_in_use_is_switched_off_before_it_changes(config):
    with ScriptedNode(config.bus, NODE, objects_of({(0x1014, 0): U32(0xA0)})) as node, CanopenDrive(config):
        steps = [int.from_bytes(value, "little") for index, _, value in node.written if index == 0x1014]
    assert steps == [0x800000A0, 0x85]


def test_error_behaviour_stands_in_for_6007(config):
    config = dataclasses.replace(config, silence_reaction="error_behaviour")
    objects = objects_of({(0x1029, 0): U8(1), (0x1029, 1): U8(1)}, without=(0x6007,))
    with ScriptedNode(config.bus, NODE, objects) as node, CanopenDrive(config):
        assert node.number(0x1029, 1) == 0


def test_the_rpdo_timer_stands_in_for_the_heartbeat(config):
    config = dataclasses.replace(config, silence_detection="rpdo_timer", command_timeout_ms=20)
    with ScriptedNode(config.bus, NODE, objects_of(without=(0x1016,))) as node, CanopenDrive(config):
        assert node.number(0x1400, 5) == 20
        assert not [index for index, _, _ in node.written if index == 0x1016]


def test_to_go_without_must_be_said(config):
    bare = objects_of(without=(0x1016, 0x6007))
    del bare[0x1400, 5]
    text = refusal(config, bare)
    assert "object 0x1016:01 is missing (the drive notices that the PC is silent)" in text
    assert "; drive.silence_detection: vendor, with the objects of the drive's own watchdog in drive.sdo" in text
    assert "or none, which accepts that it keeps its last command when the PC is silent" in text
    assert "object 0x6007:00 is missing" in text
    accepted = dataclasses.replace(config, silence_detection="none", silence_reaction="none", command_timeout_ms=0)
    with ScriptedNode(config.bus, NODE, bare), CanopenDrive(accepted) as drive:
        assert drive.port is not None


def test_a_refusal_names_what_stands_in(config):
    text = refusal(config, objects_of(GUARDING, without=(0x1016,)))
    assert (
        "the drive watches our guarding requests (0x100C, 0x100D); set drive.silence_detection: life_guarding" in text
    )


def test_a_consumer_entry_of_another_node_is_left_alone(config):
    entries = {(0x1016, 0): U8(2), (0x1016, 1): U32(9 << 16 | 100), (0x1016, 2): U32(0)}
    with ScriptedNode(config.bus, NODE, objects_of(entries)) as node:
        with CanopenDrive(config):
            assert (node.number(0x1016, 1), node.number(0x1016, 2)) == (9 << 16 | 100, 127 << 16 | 150)
        assert node.number(0x1016, 1) == 9 << 16 | 100
    taken = {(0x1016, 0): U8(2), (0x1016, 1): U32(9 << 16 | 100), (0x1016, 2): U32(8 << 16 | 100)}
    assert "every entry of 0x1016 watches another node" in refusal(config, objects_of(taken))


def test_profile_torque_with_its_slope(config):
    config = dataclasses.replace(config, mode=4, torque_slope=1_000_000)
    objects = objects_of({(0x6502, 0): U32(1 << 3), (0x6087, 0): U32(10)})
    with ScriptedNode(config.bus, NODE, objects) as node, CanopenDrive(config):
        assert (node.number(0x6060), node.number(0x6087)) == (4, 1_000_000)


def test_a_vendors_mode_with_a_target_and_feedback_of_its_own(config):
    config = dataclasses.replace(
        config, mode=-5, target=MappedObject(0x201C, 0, 32), target_units_per_a=65536.0 * 3276,
        torque=MappedObject(0x207E, 0, 16), torque_units_per_a=3276.0,
    )  # fmt: skip
    objects = objects_of({(0x6502, 0): U32(1 << 16), (0x201C, 0): U32(7), (0x207E, 0): U16(0)}, without=(0x6071,))
    with ScriptedNode(config.bus, NODE, objects) as node:
        drive = CanopenDrive(config)
        drive.connect()
        assert node.objects[0x6060, 0] == b"\xfb"
        assert [node.number(0x1600, sub) for sub in (1, 2)] == [0x60400010, 0x201C0020]
        assert node.number(0x1A01, 2) == 0x207E0010
        assert node.objects[0x201C, 0] == bytes(4)
        mark = len(node.written)
        drive.close()
    assert node.written[mark] == (0x201C, 0, bytes(4))  # no torque comes first


@pytest.mark.parametrize(
    ("bits", "units_per_a", "current_a", "raw"),
    [(16, 100.0, -1.5, -150), (32, 65536.0 * 3276, 2.0, 2 * 65536 * 3276), (16, 100.0, 1e6, 32767),
     (32, 1e9, -10.0, -(2**31 - 1)), (32, 1.0, float("nan"), 0)],
)  # fmt: skip
def test_a_command_is_scaled_limited_and_laid_out(config, bits, units_per_a, current_a, raw):
    config = dataclasses.replace(config, target=MappedObject(0x201C, 0, bits), target_units_per_a=units_per_a)
    with open_link(config.bus) as ours, open_link(config.bus) as other:
        port = make_port(config, ours, ServiceQueue(0).memory)
        acts_a = port_command(port, 0, 0x0F, current_a)
        data = unpack_frame(other.receive(1.0)).data
    assert data == struct.pack("<H", 0x0F) + raw.to_bytes(bits // 8, "little", signed=True)
    assert acts_a == pytest.approx(raw / units_per_a)


def test_feedback_in_units_of_its_own(config):
    config = dataclasses.replace(config, torque=MappedObject(0x207E, 0, 16), torque_units_per_a=3276.0, inverted=True)
    port = make_port(config, NO_LINK, ServiceQueue(0).memory)
    assert port.scaling.feedback_units_per_a == -3276.0
    torque_row = port.fields[np.flatnonzero(port.fields[:, 4] == 2)[0]]
    assert torque_row.tolist() == [1, 2, 2, 1, 2]


def test_other_pdo_numbers(config):
    config = dataclasses.replace(config, slots=PdoSlots(command=3, motion=4, status=1, event=None))
    with ScriptedNode(config.bus, NODE) as node, CanopenDrive(config):
        assert [node.number(0x1602, sub) for sub in (1, 2)] == [0x60400010, 0x60710010]
        assert node.number(0x1A03, 1) == 0x606C0020
        assert node.number(0x1A00, 1) == 0x60410010
        assert node.number(0x1801, 1) >> 31 == node.number(0x1802, 1) >> 31 == 1  # the others are silent


class LateMode(ScriptedNode):
    """0x6061 shows the mode only once a SYNC was heard."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.shows_mode = False

    def take(self, frame):
        if frame.can_id == 0x80:
            self.objects[0x6061, 0] = self.objects[0x6060, 0]


def test_a_mode_that_shows_with_sync(config):
    with LateMode(config.bus, NODE), pytest.raises(DriveRefusedError, match=r"drive\.mode_display: with_sync"):
        CanopenDrive(config).connect()
    late = dataclasses.replace(config, mode_display="with_sync")
    with LateMode(config.bus, NODE) as node, CanopenDrive(late):
        assert node.objects[0x6061, 0] == b"\x0a"
    with ScriptedNode(config.bus, NODE, keep={(0x6061, 0): b"\x03"}), pytest.raises(DriveRefusedError, match="says 3"):
        CanopenDrive(late).connect()
    unchecked = dataclasses.replace(config, mode_display="not_checked")
    with ScriptedNode(config.bus, NODE, keep={(0x6061, 0): b"\x03"}), CanopenDrive(unchecked) as drive:
        assert drive.port is not None


def test_no_object_where_the_standard_has_a_default(config):
    """0x1005 and 0x1014 may be missing: SYNC is 0x80 and EMCY 0x80 + node id then."""
    with ScriptedNode(config.bus, NODE, objects_of(without=(0x1005, 0x1014))), CanopenDrive(config) as drive:
        assert drive.identity is not None


def test_a_drive_that_does_not_tell_profile_and_modes(config):
    bare = objects_of({(0x1000, 0): U32(0)}, without=(0x6502,))
    text = refusal(config, bare)
    assert "set drive.device_profile: null" in text
    assert "set drive.modes_told: false" in text
    known = dataclasses.replace(config, device_profile=None, modes_listed=False)
    with ScriptedNode(config.bus, NODE, bare), CanopenDrive(known) as drive:
        assert drive.identity is not None

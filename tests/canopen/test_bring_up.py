"""Bring-up against a scripted node: the exact order of what is written, and every refusal with its text."""

import dataclasses
import re
import struct
from pathlib import Path

import pytest
from scripted_node import NO_OBJECT, RANGE, READ_ONLY, ScriptedNode, servo_dictionary

from fffo_drive.can.frame import pack_frame
from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.drive.canopen.config import CanopenDriveConfig
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.canopen.object_map import MappedObject, PdoSlots, feedback_pdos
from fffo_drive.drive.canopen.sdo_writes import SdoWrite
from fffo_drive.drive.canopen.service import Service, service_filters
from fffo_drive.drive.canopen.service_queue import ServiceQueue
from fffo_drive.drive.port import BusUnavailableError, DriveRefusedError

NODE = 5


@pytest.fixture
def config():
    return CanopenDriveConfig(
        bus=f"loopback:{free_loopback_port()}",
        node_id=NODE,
        listen_s=0.02,
        period_ns=500_000,
        counts_per_rev=32768,
        velocity_units_per_rps=1000.0,
        torque_constant_nm_per_a=0.1,
        rated_torque_nm=1.0,
        rated_current_a=10.0,
        answer_timeout_s=1.0,
        start_timeout_s=1.0,
    )


def quick(config):
    """For nodes that stay silent."""
    return dataclasses.replace(config, answer_timeout_s=0.02, start_timeout_s=0.05)


def refusal(config, node):
    """The text with which the drive is refused; nothing may have been enabled."""
    drive = CanopenDrive(config)
    with node, pytest.raises(DriveRefusedError) as caught:
        drive.connect()
    assert all(int.from_bytes(value, "little") == 0 for index, _, value in node.written if index == 0x6040)
    assert not [frame for frame in node.heard if frame.can_id == 0x205 and any(frame.data)]
    return str(caught.value)


def without(*missing):
    objects = servo_dictionary(NODE)
    return {key: value for key, value in objects.items() if key not in missing and key[0] not in missing}


def test_a_plain_servo_drive_comes_up(config):
    with ScriptedNode(config.bus, NODE) as node, CanopenDrive(config) as drive:
        assert drive.identity == (0x11, 0x22, 0x33, 0x44, "a drive with a long name", "v1.2")
        assert node.commands == [0x82, 0x80, 0x01]
        assert node.number(0x6060) == 10
        assert node.number(0x1006) == 500
        assert (node.number(0x60C2, 1), struct.unpack("<b", node.objects[0x60C2, 2])) == (5, (-4,))
        assert node.number(0x1016, 1) == 127 << 16 | 150
        assert node.number(0x1017) == 50
        assert node.number(0x1400, 5) == 20
        assert (node.number(0x6007), node.number(0x605A), node.number(0x605E)) == (3, 2, 2)
        assert node.number(0x1400, 1) == 0x205
        assert (node.number(0x1400, 2), node.number(0x1600, 0)) == (1, 2)
        assert [node.number(0x1600, sub) for sub in (1, 2)] == [0x60400010, 0x60710010]
        assert [node.number(0x1800 + n, 1) for n in range(3)] == [0x40000185, 0x40000285, 0x40000385]
        assert [node.number(0x1800 + n, 2) for n in range(3)] == [1, 10, 255]
        assert [node.number(0x1800 + n, 3) for n in range(3)] == [0, 0, 20]
        assert [node.number(0x1A00, sub) for sub in (0, 1, 2)] == [2, 0x606C0020, 0x60640020]
        assert [node.number(0x1A01, sub) for sub in (0, 1, 2)] == [2, 0x60410010, 0x60770010]
        assert [node.number(0x1A02, sub) for sub in (0, 1)] == [1, 0x60410010]
        assert node.number(0x1803, 1) >> 31 == 1
        assert drive.realtime
        assert drive.feedback["dropped_frames"][0] == 0


def test_the_order_of_a_remapping(config):
    with ScriptedNode(config.bus, NODE) as node, CanopenDrive(config):
        pass
    steps = [(index, sub, int.from_bytes(v, "little")) for index, sub, v in node.written if index in (0x1800, 0x1A00)]
    assert steps == [
        (0x1800, 1, 0xC0000185),
        (0x1800, 2, 1),
        (0x1800, 3, 0),
        (0x1800, 5, 0),
        (0x1A00, 0, 0),
        (0x1A00, 1, 0x606C0020),
        (0x1A00, 2, 0x60640020),
        (0x1A00, 0, 2),
        (0x1800, 1, 0x40000185),
    ]


class StrictAboutIds(ScriptedNode):
    """Refuses another COB-ID for a PDO in use, even if that disables it (CiA 301 7.5.2.35), and one that is none."""

    def check(self, index, sub, value):
        pdo = index & 0xFE00 in (0x1400, 0x1800) and sub == 1
        old, new = (self.number(index, 1), int.from_bytes(value, "little")) if pdo else (1 << 31, 0x181)
        return RANGE if not new & 0x7FF or (not old >> 31 and (old ^ new) & 0x7FF) else 0


def test_a_pdo_in_use_is_disabled_before_it_gets_another_cob_id(config):
    """One that is disabled may have no COB-ID at all: 0x80000000."""
    slots = PdoSlots(command=2, motion=2, status=3, event=1)
    ids = {(first + n, 1): struct.pack("<I", base + 0x100 * n + NODE | no_rtr)
           for first, base, no_rtr in ((0x1400, 0x200, 0), (0x1800, 0x180, 1 << 30)) for n in range(4)}  # fmt: skip
    ids[0x1802, 1] = struct.pack("<I", 0xC0000000)
    config = dataclasses.replace(config, slots=slots)
    with StrictAboutIds(config.bus, NODE, servo_dictionary(NODE) | ids) as node, CanopenDrive(config):
        assert node.number(0x1401, 1) == 0x205
        assert [node.number(0x1800 + n, 1) for n in range(3)] == [0x40000385, 0x40000185, 0x40000285]


def test_leaving_takes_the_torque_away_first(config):
    with ScriptedNode(config.bus, NODE) as node:
        drive = CanopenDrive(config)
        drive.connect()
        mark, seen = len(node.written), len(node.heard)
        drive.close()
        drive.close()
    assert node.written[mark:] == [(0x6071, 0, bytes(2)), (0x6040, 0, bytes(2)), (0x1016, 1, bytes(4))]
    assert [(f.can_id, f.data) for f in node.heard[seen : seen + 2]] == [(0x205, bytes(4)), (0x080, b"")]
    assert node.commands[-1] == 0x80


def test_closing_without_a_drive_or_a_bus_never_raises(config):
    drive = CanopenDrive(quick(config))
    drive.close()
    node = ScriptedNode(config.bus, NODE)
    with node:
        drive.connect()
        node.mute = True
        drive.close()


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ((0x6060, 0), r"refuses mode 10 \(cyclic synchronous torque\).*0x6060:00"),
        ((0x1400, 1), r"refuses 0x1400:01 = .*disabling RPDO1"),
        ((0x1600, 2), r"refuses 0x1600:02 = .*0x6071:00/16 in RPDO1"),
        ((0x1800, 2), r"refuses 0x1800:02 = 1 .*transmission type of TPDO1"),
        ((0x1A01, 2), r"refuses 0x1A01:02 = .*0x6077:00/16 in TPDO2"),
        ((0x1006, 0), r"refuses 0x1006:00 = 500 .*SYNC period of 500 us"),
        ((0x60C2, 1), r"refuses 0x60C2:01 = 5 .*slower rate"),
        ((0x1016, 1), r"refuses 0x1016:01 = .*PC is silent"),
        ((0x1017, 0), r"refuses 0x1017:00 = 50 .*the drive's heartbeat"),
        ((0x1400, 5), r"refuses 0x1400:05 = 20 .*commands stay away"),
        ((0x6007, 0), r"refuses 0x6007:00 = 3 .*stop when the PC is silent"),
        ((0x605A, 0), r"refuses 0x605A:00 = 2 .*defined quick stop"),
        ((0x605E, 0), r"refuses 0x605E:00 = 2 .*fault reaction"),
    ],
)
def test_a_refused_write_names_object_value_and_reason(config, where, message):
    text = refusal(config, ScriptedNode(config.bus, NODE, refuse={where: RANGE}))
    assert re.search(message, text), text
    assert "0x06090030" in text
    assert "node 5" in text


FIXED = {  # to what is needed at 1 kHz
    (0x1600, 0): b"\x02", (0x1600, 1): struct.pack("<I", 0x60400010), (0x1600, 2): struct.pack("<I", 0x60710010),
    (0x1400, 2): b"\x01", (0x60C2, 2): b"\xfd", (0x6007, 0): b"\x03\x00",
}  # fmt: skip


def test_what_is_fixed_to_the_value_that_is_needed_need_not_be_written(config):
    """As drive-info has it, which asks for no more of such a file."""
    config = dataclasses.replace(config, period_ns=1_000_000)
    refuse = dict.fromkeys(FIXED, READ_ONLY)
    with ScriptedNode(config.bus, NODE, servo_dictionary(NODE) | FIXED, refuse=refuse), CanopenDrive(config) as drive:
        assert drive.identity.vendor_id == 0x11


@pytest.mark.parametrize("where", sorted(FIXED.keys() - {(0x1600, 1)}))  # which this node has already
def test_what_is_fixed_to_another_value_is_refused(config, where):
    text = refusal(config, ScriptedNode(config.bus, NODE, refuse={where: READ_ONLY}))
    assert f"0x{where[0]:04X}:{where[1]:02X}" in text
    assert "abort 0x06010002" in text


@pytest.mark.parametrize(
    ("where", "kept"),
    [
        ((0x1A00, 2), struct.pack("<I", 0x60640010)),
        ((0x1800, 2), b"\x02"),
        ((0x6007, 0), b"\x01\x00"),
        ((0x1016, 1), bytes(4)),
        ((0x1006, 0), struct.pack("<I", 1000)),
        ((0x1400, 5), struct.pack("<H", 0)),
    ],
)
def test_what_is_kept_otherwise_is_noticed(config, where, kept):
    text = refusal(config, ScriptedNode(config.bus, NODE, keep={where: kept}))
    assert f"took 0x{where[0]:04X}:{where[1]:02X}" in text
    assert f"reads back {int.from_bytes(kept, 'little')}" in text


@pytest.mark.parametrize("missing", [0x6007, 0x1016, 0x1017, (0x1800, 2)])
def test_a_drive_without_a_reaction_is_refused(config, missing):
    text = refusal(config, ScriptedNode(config.bus, NODE, without(missing)))
    index = missing[0] if isinstance(missing, tuple) else missing
    assert f"0x{index:04X}" in text


@pytest.mark.parametrize("missing", [(0x1400, 5), 0x1006, 0x60C2, 0x6075, 0x6076, 0x1008, 0x100A, 0x1019, 0x1803,
                                     0x605A, 0x605E])  # fmt: skip
def test_what_is_optional_may_be_missing(config, missing):
    with ScriptedNode(config.bus, NODE, without(missing)), CanopenDrive(config) as drive:
        assert drive.identity.vendor_id == 0x11


def test_option_codes_of_none_leave_the_drives_own(config):
    config = dataclasses.replace(config, quick_stop_option=None, fault_reaction_option=None)
    with ScriptedNode(config.bus, NODE, without(0x605A, 0x605E)) as node, CanopenDrive(config):
        assert not [index for index, _, _ in node.written if index in (0x605A, 0x605E)]


def test_a_torque_limit_is_written_when_asked_for(config):
    config = dataclasses.replace(config, max_torque_permille=800)
    with ScriptedNode(config.bus, NODE) as node, CanopenDrive(config):
        assert node.number(0x6072) == 800


@pytest.mark.parametrize("device_type", [0x00030191, 0x00020191, 0])
def test_no_drive(config, device_type):
    objects = servo_dictionary(NODE) | {(0x1000, 0): struct.pack("<I", device_type)}
    assert f"0x{device_type:08X}, which is no CiA 402 drive" in refusal(config, ScriptedNode(config.bus, NODE, objects))


VENDORS = (
    SdoWrite(0x3000, 0, 7, 2, "before_mapping", True, (), "a setting"),
    SdoWrite(0x3000, 0, 9, 2, "after_disable", True, (), "a setting"),
)


@pytest.mark.parametrize("other", ["no drive", "the EDS is of another drive"])
def test_nothing_is_written_to_another_device(config, other):
    objects = servo_dictionary(NODE) | {(0x3000, 0): bytes(2)}
    if other == "no drive":
        objects[0x1000, 0] = struct.pack("<I", 0x00030191)
    else:
        config = dataclasses.replace(config, eds=str(Path(__file__).parent / "eds" / "capitals.eds"))
    node = ScriptedNode(config.bus, NODE, objects)
    text = refusal(dataclasses.replace(config, sdo=VENDORS), node)
    assert "no CiA 402 drive" in text or "is for vendor 0x0000FEED, the drive says 0x00000011" in text
    assert node.written == []
    assert node.commands == [0x82, 0x80]


def test_a_servo_drive_with_further_bits_is_one(config):
    objects = servo_dictionary(NODE) | {(0x1000, 0): struct.pack("<I", 0x00060192)}
    with ScriptedNode(config.bus, NODE, objects), CanopenDrive(config):
        pass


def test_no_cyclic_synchronous_torque(config):
    objects = servo_dictionary(NODE) | {(0x6502, 0): struct.pack("<I", 0xFF)}
    text = refusal(config, ScriptedNode(config.bus, NODE, objects))
    assert (
        "no mode 10 (cyclic synchronous torque): 0x6502:00 says 0x000000FF, bit 9 is needed; set drive.mode: 4" in text
    )
    text = refusal(config, ScriptedNode(config.bus, NODE, without(0x6502)))
    assert "0x6502:00 is missing, bit 9 is needed; set drive.modes_told: false" in text


def test_the_mode_must_be_displayed(config):
    config = dataclasses.replace(config, start_timeout_s=0.05)
    node = ScriptedNode(config.bus, NODE, keep={(0x6061, 0): b"\x03"})
    assert "0x6061:00 says 3" in refusal(config, node)


@pytest.mark.parametrize(
    ("mode", "raw"), [(-5, "fb 00 00 00"), (-5, "fb ff ff ff"), (10, "0a aa aa aa"), (10, "0a 00")]
)
def test_a_mode_display_in_more_bytes_is_the_same_mode(config, mode, raw):
    """An expedited answer that does not tell its size (0x42) has four bytes."""
    config = dataclasses.replace(config, mode=mode, modes_listed=False, start_timeout_s=0.3)
    with ScriptedNode(config.bus, NODE, keep={(0x6061, 0): bytes.fromhex(raw)}), CanopenDrive(config) as drive:
        assert drive.identity.vendor_id == 0x11


def test_what_stands_behind_a_value_whose_size_is_not_told_has_no_meaning(config):
    """CiA 301 7.2.4.3.6: an expedited answer with s = 0 leaves it to the object how many of the four bytes count."""

    class FixedCount(ScriptedNode):
        def keeps_count(self, index):
            return index == 0x1600

    objects = servo_dictionary(NODE) | {(0x2100, 0): bytes(2), (0x1600, 0): b"\x02"}
    config = dataclasses.replace(config, target=MappedObject(0x2100, 0, 16), target_units_per_a=100.0)
    with (
        FixedCount(config.bus, NODE, objects, refuse={(0x1600, 0): READ_ONLY}, filler=b"\xa5") as node,
        CanopenDrive(config) as drive,
    ):
        assert drive.identity == (0x11, 0x22, 0x33, 0x44, "a drive with a long name", "v1.2")
        assert not [value for index, _, value in node.written if index == 0x1019]  # no counter: nothing to switch off


@pytest.mark.parametrize(
    ("index", "raw", "text"),
    [(0x6076, 2000, "0x6076:00 says 2 Nm, the configuration rated_torque_nm: 1.0"),
     (0x6075, 9000, "0x6075:00 says 9 A, the configuration rated_current_a: 10.0")],
)  # fmt: skip
def test_ratings_must_agree(config, index, raw, text):
    objects = servo_dictionary(NODE) | {(index, 0): struct.pack("<I", raw)}
    assert text in refusal(config, ScriptedNode(config.bus, NODE, objects))


def test_a_rating_of_zero_and_one_in_micronewton_metres_have_a_text_of_their_own(config):
    objects = servo_dictionary(NODE)
    zero = refusal(config, ScriptedNode(config.bus, NODE, objects | {(0x6076, 0): bytes(4)}))
    assert "0x6076:00 is 0: the drive does not know the rating of its motor; set it to 1000" in zero
    micro = objects | {(0x6076, 0): struct.pack("<I", 1_000_000)}
    assert "rated_torque_unit: uNm" in refusal(config, ScriptedNode(config.bus, NODE, micro))
    counting = dataclasses.replace(config, rated_torque_unit_nm=1e-6)
    with ScriptedNode(config.bus, NODE, micro), CanopenDrive(counting) as drive:
        assert drive.port is not None


def test_a_rating_in_rms_has_a_text_and_a_unit_of_its_own(config):
    rms = servo_dictionary(NODE) | {(0x6075, 0): struct.pack("<I", 7071)}  # 10 A of amplitude
    assert "rated_current_unit: mA_rms" in refusal(config, ScriptedNode(config.bus, NODE, rms))
    counting = dataclasses.replace(config, rated_current_unit_a=1e-3 * 2**0.5)
    with ScriptedNode(config.bus, NODE, rms), CanopenDrive(counting) as drive:
        assert drive.port is not None


@pytest.mark.parametrize("kind", [0x00000192, 0x00040192, 0xFFFF0192])
def test_the_type_word_of_a_drive_is_the_vendors(config, kind):
    objects = servo_dictionary(NODE) | {(0x1000, 0): struct.pack("<I", kind)}
    with ScriptedNode(config.bus, NODE, objects), CanopenDrive(config) as drive:
        assert drive.identity.vendor_id == 0x11


def test_a_sync_counter_is_switched_off_in_the_right_order(config):
    objects = servo_dictionary(NODE) | {(0x1019, 0): b"\x0a", (0x1006, 0): struct.pack("<I", 1000)}
    with ScriptedNode(config.bus, NODE, objects) as node, CanopenDrive(config):
        assert node.number(0x1019) == 0
    order = [(i, int.from_bytes(v, "little")) for i, _, v in node.written if i in (0x1006, 0x1019)]
    assert order == [(0x1006, 0), (0x1019, 0), (0x1006, 500)]


def test_a_drive_that_sends_sync_is_silenced_before_its_cob_id_changes(config):
    class Producer(ScriptedNode):
        def check(self, index, sub, value):
            producing = self.number(0x1005) >> 30
            changed = (int.from_bytes(value, "little") ^ self.number(0x1005)) & 0x1FFFFFFF
            return RANGE if index == 0x1005 and producing and changed else 0

    objects = servo_dictionary(NODE) | {(0x1005, 0): struct.pack("<I", 0x40000090)}
    with Producer(config.bus, NODE, objects) as node, CanopenDrive(config):
        assert node.number(0x1005) == 0x80
    assert [int.from_bytes(value, "little") for index, _, value in node.written if index == 0x1005] == [0x90, 0x80]


def test_an_inhibit_time_is_needed_for_events_only(config):
    config = dataclasses.replace(config, tpdos=feedback_pdos(NODE, 10, 255))
    text = refusal(config, ScriptedNode(config.bus, NODE, without((0x1802, 3))))
    assert "no inhibit time (0x1802:03)" in text
    config = dataclasses.replace(config, tpdos=None, status_event=0)
    with ScriptedNode(config.bus, NODE, without((0x1802, 3))), CanopenDrive(config):
        pass


def test_nobody_answers(config):
    with pytest.raises(BusUnavailableError, match=f"{config.bus}: node 5 does not answer.*no other node"):
        CanopenDrive(quick(config)).connect()


def test_a_wrong_node_id_is_told_who_is_there(config):
    with ScriptedNode(config.bus, 6, beats=True), pytest.raises(BusUnavailableError) as caught:
        CanopenDrive(quick(config)).connect()
    assert "node 5 does not answer" in str(caught.value)
    assert "Heard of: node 6" in str(caught.value)


def test_a_node_without_boot_up(config):
    config = dataclasses.replace(config, start_timeout_s=0.05)
    assert "sends no boot-up message" in refusal(config, ScriptedNode(config.bus, NODE, boots=0))


def test_two_boot_ups_twice_mean_two_nodes(config):
    text = refusal(config, ScriptedNode(config.bus, NODE, boots=2))
    assert "two nodes have this id" in text


def test_two_answers_mean_two_nodes(config):
    with ScriptedNode(config.bus, NODE, boots=0):
        assert "two nodes have" in refusal(config, ScriptedNode(config.bus, NODE))


def test_a_drive_that_does_not_start(config):
    config = dataclasses.replace(config, start_timeout_s=0.05)
    assert "does not report NMT state operational" in refusal(config, ScriptedNode(config.bus, NODE, starts=False))


def test_a_missing_interface_is_a_bus_that_is_unavailable(config):
    with pytest.raises(BusUnavailableError, match="socketcan:nosuchcan0"):
        CanopenDrive(dataclasses.replace(config, bus="socketcan:nosuchcan0")).connect()


def test_refused_drives_can_be_tried_again(config):
    drive = CanopenDrive(config)
    with ScriptedNode(config.bus, NODE, refuse={(0x6007, 0): NO_OBJECT}), pytest.raises(DriveRefusedError):
        drive.connect()
    with ScriptedNode(config.bus, NODE):
        assert drive.connect().serial_number == 0x44
        drive.close()


def test_late_answers_to_a_former_connection_are_no_second_node(config):
    """A node that starts slowly answers what an earlier attempt asked, in the middle of the next attempt."""
    late = bytes([0x43, 0x00, 0x10, 0x00, 0x92, 0x01, 0x02, 0x00])
    with ScriptedNode(config.bus, NODE) as node:
        link = open_link(config.bus, filters=service_filters(NODE))
        service = Service(link, NODE, ServiceQueue(10_000_000_000), answer_timeout_s=0.5, attempts=3)
        try:
            with open_link(config.bus) as former:
                for _ in range(3):
                    former.send(pack_frame(0x580 + NODE, late))
            service.wait_until(lambda: service._responses == 3, 5.0)
            assert service.read_int(0x1000, 0) == 0x00020192
        finally:
            service.close()
    assert node.number(0x1000) == 0x00020192

"""What a drive says of a fault, in words."""

import struct

import pytest
from scripted_node import ScriptedNode, servo_dictionary
from test_bring_up import NODE, config  # noqa: F401  (a fixture)

from fffo_drive.can.frame import pack_frame
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.canopen.emergency import code_text, emergency_text, register_text, statusword_text
from fffo_drive.drive.canopen.service import Emergency


@pytest.mark.parametrize(
    ("code", "words"),
    [(0x8611, "following error"), (0x3220, "DC link under-voltage"), (0x7399, "sensor"), (0xFF01, "the vendor's own"),
     (0x8130, "heartbeat"), (0xAB00, "in no table")],
)  # fmt: skip
def test_a_code_is_named_by_itself_or_by_its_class(code, words):
    assert code_text(code).startswith(f"0x{code:04X} (")
    assert words in code_text(code)


def test_every_code_has_words():
    assert all(code_text(code).endswith(")") for code in range(0x10000))


def test_a_message_has_its_register_and_what_the_vendor_adds():
    said = emergency_text(Emergency(0, 0x8611, 0x21, bytes([1, 2, 0, 0, 0])))
    assert said == (
        "EMCY 0x8611 (following error), error register 0x21 (generic, device profile), vendor bytes 01 02 00 00 00"
    )
    assert "vendor" not in emergency_text(Emergency(0, 0x8611, 0x21, bytes(5)))
    assert register_text(0) == "0x00 (no error: a warning)"


def test_a_statusword_tells_its_state_and_what_keeps_the_drive_from_being_enabled():
    assert statusword_text(0x0237) == "statusword 0x0237: operation enabled"
    assert "local control" in statusword_text(0x0037)
    assert "no voltage at the power stage" in statusword_text(0x0240)
    assert "no state of CiA 402" in statusword_text(0x020C)


def test_a_drive_says_its_last_emergency_its_error_code_and_its_state(config):  # noqa: F811
    objects = servo_dictionary(NODE) | {
        (0x603F, 0): struct.pack("<H", 0x7305), (0x6041, 0): struct.pack("<H", 0x0218),
    }  # fmt: skip
    drive = CanopenDrive(config)
    assert drive.fault_words() == ""
    with ScriptedNode(config.bus, NODE, objects) as node, drive:
        before = len(drive.emergencies)
        node.link.send(pack_frame(0x080 + NODE, struct.pack("<HB5s", 0x7305, 0x81, b"abcde")))
        node.link.send(pack_frame(0x080 + NODE, bytes(8)))  # the reset of it is no news
        assert drive._service.wait_until(lambda: len(drive.emergencies) == before + 2, 2.0)
        said = drive.fault_words()
    assert said == (
        "EMCY 0x7305 (incremental sensor 1), error register 0x81 (generic, manufacturer), vendor bytes 61 62 63 64 65; "
        "0x603F 0x7305 (incremental sensor 1); statusword 0x0218: fault"
    )

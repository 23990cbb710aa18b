"""What a drive says of a fault, in words."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scripted_node import ScriptedNode, servo_dictionary
from test_bring_up import NODE, config  # noqa: F401  (a fixture)

from fffo_drive.can.frame import pack_frame
from fffo_drive.drive.canopen.drive import CanopenDrive
from fffo_drive.drive.canopen.emergency import (
    WarningNews,
    burst_text,
    code_text,
    emergency_text,
    inputs_text,
    register_text,
    standing,
    statusword_text,
)
from fffo_drive.drive.canopen.service import Emergency
from fffo_drive.units import NS_PER_S


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
    assert statusword_text(0x1237) == "statusword 0x1237: operation enabled"
    assert statusword_text(0x0A37) == "statusword 0x0A37: operation enabled"  # it limits the target
    assert statusword_text(0x0233) == "statusword 0x0233: switched on"
    assert "bit 12 is 0: the drive ignores the target torque" in statusword_text(0x0237)
    assert statusword_text(0x0037, (9, 12)) == "statusword 0x0037: operation enabled"
    assert "bit 7: the drive warns" in statusword_text(0x12B7)
    assert "local control" in statusword_text(0x1037)
    assert "no voltage at the power stage" in statusword_text(0x0240)
    assert "no state of CiA 402" in statusword_text(0x020C)


def test_a_drive_says_its_last_emergency_its_error_code_and_its_state(config):  # noqa: F811
    objects = servo_dictionary(NODE) | {
        (0x603F, 0): struct.pack("<H", 0x7305), (0x6041, 0): struct.pack("<H", 0x0218),
    }  # fmt: skip
    drive = CanopenDrive(config)
    assert drive.fault_words() == ""
    assert drive.warnings() == []
    with ScriptedNode(config.bus, NODE, objects) as node, drive:
        before = len(drive.emergencies)
        node.link.send(pack_frame(0x080 + NODE, struct.pack("<HB5s", 0x7305, 0x81, b"abcde")))
        node.link.send(pack_frame(0x080 + NODE, bytes(8)))  # the reset of it is no news
        assert drive._service.wait_until(lambda: len(drive.emergencies) == before + 2, 2.0)
        said = drive.fault_words()
    assert said == (
        "EMCY 0x7305 (incremental sensor 1), error register 0x81 (generic, manufacturer), vendor bytes 61 62 63 64 65; "
        "statusword 0x0218: fault"
    )


@pytest.mark.parametrize(
    ("inputs", "words"),
    [
        (0, "no limit switch, no interlock"),
        (0x1, "negative limit switch"),
        (0x2, "positive limit switch"),
        (0xC, "home switch, interlock (STO, enable)"),
        (0x00050008, "interlock (STO, enable), the vendor's bits 16, 18"),
        (0x0000FFF0, "no limit switch, no interlock"),  # reserved
    ],
)
def test_digital_inputs_have_the_names_of_cia_402(inputs, words):
    assert inputs_text(inputs) == f"0x60FD 0x{inputs:08X} ({words})"


def test_everything_that_the_drive_has_is_reported_and_a_drive_that_has_nothing_is_no_error(config):  # noqa: F811
    objects = servo_dictionary(NODE) | {
        (0x1003, 0): b"\x04", (0x1003, 1): struct.pack("<I", 0x00127305), (0x1003, 2): struct.pack("<I", 0x3220),
        (0x1003, 3): struct.pack("<I", 0x8611), (0x1003, 4): struct.pack("<I", 0x2310), (0x603F, 0): bytes(2),
        (0x6041, 0): struct.pack("<H", 0x0050),
        (0x60FD, 0): struct.pack("<I", 0x8), (0x6079, 0): struct.pack("<I", 24_130),
    }  # fmt: skip
    drive = CanopenDrive(config)
    with ScriptedNode(config.bus, NODE, objects), drive:
        assert drive.fault_words(0x0250) == (
            "0x603F says no error; statusword 0x0050: switch on disabled; "
            "bit 9 is 0: the drive is in local control and ignores our controlword; "
            "last statusword received 0x0250: switch on disabled; "
            "0x60FD 0x00000008 (interlock (STO, enable)); DC link 24.1 V (0x6079); "
            "earlier, by 0x1003, newest first: 0x7305 (incremental sensor 1) with 0x0012, "
            "0x3220 (DC link under-voltage), 0x8611 (following error)"
        )
        assert drive.fault_words(0x0250, ask=False) == "last statusword received 0x0250: switch on disabled"
        drive.port.feedback["statusword"], drive.port.feedback["status_tick"] = 0x0218, 3
        assert drive.fault_words(ask=False) == "last statusword received 0x0218: fault"
    with ScriptedNode(config.bus, NODE) as node, drive:
        del node.objects[0x6041, 0]
        assert drive.fault_words() == ""
        assert drive.fault_words(0x0250) == "last statusword received 0x0250: switch on disabled"


def test_what_the_drive_says_now_comes_before_what_was_received_last(config):  # noqa: F811
    """A drive that left operational sends no statusword any more: the last one is not its state."""
    drive = CanopenDrive(config)
    with ScriptedNode(config.bus, NODE) as node, drive:
        node.objects[0x6041, 0] = struct.pack("<H", 0x0250)
        assert drive.fault_words(0x0250) == "statusword 0x0250: switch on disabled"
        node.send(0x700 + NODE, b"\x7f")  # its next heartbeat
        assert drive.fault_words(0x1237) == (
            "NMT state pre-operational (its heartbeat); statusword 0x0250: switch on disabled; "
            "last statusword received 0x1237: operation enabled"
        )
        assert drive.warnings() == ["the drive's heartbeat says: pre-operational"]
        assert drive.warnings() == []
        node.mute = True
        assert drive.fault_words(0x1237).endswith("; last statusword received 0x1237: operation enabled")
        node.mute = False


def at(seconds, code, register=0x01, vendor=bytes(5)):
    return Emergency(round(seconds * NS_PER_S), code, register, vendor)


def told(heard, warning_codes=(), now_s=50.5):
    now_ns = round(now_s * NS_PER_S)
    return burst_text(standing(heard, warning_codes, now_ns), now_ns)


def test_of_a_burst_all_are_reported_newest_first_and_what_is_old_has_its_age():
    heard = [at(1.0, 0x2310), at(50.0, 0x3220), at(50.2, 0x8611), at(50.3, 0), at(50.4, 0xFF00)]
    assert [text.split()[1] for text in told(heard, (0xFF00,))] == ["0x8611", "0x3220"]
    assert told(heard[:1], now_s=13.0)[0].endswith("12 s ago")
    assert told([at(1.0, 0)]) == told([]) == []


def test_the_same_emergency_is_told_once_and_the_newest_reason_first():
    heard = [at(50.0 + 0.1 * n, 0x8130) for n in range(3)] + [at(50.4, 0x3220)]
    first, second = told(heard)
    assert first.startswith("EMCY 0x3220")
    assert second.startswith("EMCY 0x8130")
    assert second.endswith(", 3 times")


def test_what_the_drive_has_called_off_is_no_reason_any_more():
    heard = [at(1.0, 0x8130), at(1.1, 0)]
    assert told(heard, now_s=2.0)[0].startswith("EMCY 0x8130")  # a moment ago: it may be the reason
    assert told(heard, now_s=10.0) == []
    assert [text.split()[1] for text in told([*heard, at(9.5, 0x3220)], now_s=10.0)] == ["0x3220"]


def test_what_the_drive_said_before_it_was_connected_is_told_only_while_it_is_in_fault(config):  # noqa: F811
    class Grumbling(ScriptedNode):
        """Sends the error of the run before after each reset."""

        def _nmt(self, command):
            super()._nmt(command)
            if command == 0x82:
                self.send(0x080 + NODE, struct.pack("<HB5s", 0x8130, 0x11, bytes(5)))

    objects = servo_dictionary(NODE) | {
        (0x603F, 0): struct.pack("<H", 0x8130),
        (0x1003, 0): b"\x03",
        **{(0x1003, sub): struct.pack("<I", code) for sub, code in ((1, 0x8130), (2, 0x8130), (3, 0x3220))},
    }
    drive = CanopenDrive(config)
    old, in_fault, enabled = "EMCY 0x8130", 0x0218, 0x1237
    with Grumbling(config.bus, NODE, objects) as node, drive:
        node.objects[0x6041, 0] = struct.pack("<H", enabled)
        assert old not in drive.fault_words(enabled)
        node.objects[0x6041, 0] = struct.pack("<H", in_fault)
        assert old in drive.fault_words(enabled)  # in fault since then
        node.link.send(pack_frame(0x080 + NODE, struct.pack("<HB5s", 0x7305, 0x81, bytes(5))))
        assert drive._service.wait_until(lambda: drive.emergencies[-1].code == 0x7305, 2.0)
        said = drive.fault_words(in_fault)
    assert said.startswith("EMCY 0x7305")
    assert old not in said
    assert said.count("0x8130") == 1  # of 0x603F
    assert said.endswith("earlier, by 0x1003, newest first: 0x3220 (DC link under-voltage)")


def test_an_emergency_without_an_error_in_its_register_names_the_key_for_warnings():
    assert "drive.warning_codes: [0xFF00]" in told([at(1.0, 0xFF00, 0)], now_s=1.0)[0]
    assert "warning_codes" not in told([at(1.0, 0xFF00, 1)], now_s=1.0)[0]


def test_a_warning_is_reported_once_and_the_same_one_several_times_in_one_sentence():
    news = WarningNews((0xFF00,))
    heard = [at(1.0, 0xFF00, 0), at(1.1, 0xFF00, 0), at(1.2, 0x8611)]
    reported = news.look(heard, 0x1237, round(1.3 * NS_PER_S))
    assert len(reported) == 1
    assert "EMCY 0xFF00" in reported[0]
    assert reported[0].endswith("(2 times)")
    assert news.look(heard, 0x1237, round(3.0 * NS_PER_S)) == []
    heard.append(at(3.1, 0xFF00, 0))
    assert len(news.look(heard, 0x1237, round(3.2 * NS_PER_S))) == 1


def test_the_warning_bit_is_reported_when_it_rises_and_a_flood_once_a_second():
    news = WarningNews(())
    reported = [news.look([], 0x12B7 if tick % 2 else 0x1237, round(tick * 0.04 * NS_PER_S)) for tick in range(251)]
    counted = sum(map(len, reported))
    assert reported[1] == ["the drive warns: statusword bit 7"]
    assert 9 <= counted <= 11  # in ten seconds
    steady = WarningNews(())
    assert sum(len(steady.look([], 0x12B7, round(tick * 0.04 * NS_PER_S))) for tick in range(250)) == 1


@given(
    st.lists(st.tuples(st.integers(0, 20_000), st.sampled_from([0, 0xFF00, 0xFF01, 0x8611])), max_size=40),
    st.lists(st.integers(0, 30_000), min_size=1, max_size=40),
)
def test_each_warning_is_reported_exactly_once_whenever_it_is_looked_for(sent, looks):
    warnings = [at(1e-3 * ms + 1e-3, code, 0, bytes([n, 0, 0, 0, 0])) for n, (ms, code) in enumerate(sorted(sent))]
    news, reported = WarningNews((0xFF00, 0xFF01)), []
    for look_ms in [*sorted(looks), 40_000]:
        now_ns = look_ms * 1_000_000
        reported += news.look([one for one in warnings if one.monotonic_ns <= now_ns], 0, now_ns)
    expected = {emergency_text(one) for one in warnings if one.code in (0xFF00, 0xFF01)}
    assert sorted(text.removeprefix("the drive warns: ") for text in reported) == sorted(expected)

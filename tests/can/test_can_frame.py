"""struct can_frame as bytes, and the length of frames on the wire."""

import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.can import frame as can
from fffo_drive.can.frame import (
    Frame,
    exact_bits,
    longest_bits,
    pack_frame,
    typical_bits,
    unpack_frame,
)

PAYLOADS = st.binary(max_size=8)


def shortest_bits(data_bytes, *, extended=False):
    """Bits of a frame without a stuff bit, interframe space included (Bosch CAN 2.0)."""
    return (67 if extended else 47) + 8 * data_bytes


def test_layout_is_that_of_linux_can_h():
    raw = pack_frame(0x185, b"\x01\x02\x03")
    assert raw[4:] == bytes([3, 0, 0, 0, 1, 2, 3, 0, 0, 0, 0, 0])
    assert int.from_bytes(raw[:4], "little") == 0x185 or int.from_bytes(raw[:4], "big") == 0x185


def test_flags_stand_in_the_identifier_word():
    raw = pack_frame(0x1ABCDEF0, bytes(8), extended=True, remote=True)
    assert int.from_bytes(raw[:4], sys.byteorder) == 0x8000_0000 | 0x4000_0000 | 0x1ABCDEF0


@given(st.integers(0, 0x7FF), PAYLOADS, st.booleans())
def test_standard_frames_come_back(can_id, data, remote):
    assert unpack_frame(pack_frame(can_id, data, remote=remote)) == Frame(can_id, data, False, remote, False)


@given(st.integers(0, 0x1FFF_FFFF), PAYLOADS, st.booleans())
def test_extended_frames_come_back(can_id, data, remote):
    raw = pack_frame(can_id, data, extended=True, remote=remote)
    assert unpack_frame(raw) == Frame(can_id, data, True, remote, False)


@given(st.binary(min_size=16, max_size=16))
def test_any_sixteen_bytes_are_a_frame(raw):
    frame = unpack_frame(raw)
    assert len(frame.data) <= 8
    limit = 0x1FFF_FFFF if frame.extended or frame.error else 0x7FF
    assert 0 <= frame.can_id <= limit


@given(st.binary(max_size=40).filter(lambda raw: len(raw) != 16))
def test_other_lengths_are_none(raw):
    with pytest.raises(ValueError, match="16 bytes"):
        unpack_frame(raw)


def test_error_frame_keeps_its_classes():
    frame = unpack_frame(pack_frame(can.ERROR_BUS_OFF | can.ERROR_RESTARTED, bytes(8), error=True))
    assert frame == Frame(0x140, bytes(8), False, False, True)


@pytest.mark.parametrize(("can_id", "data", "extended"), [(0x800, b"", False), (-1, b"", False), (1 << 29, b"", True)])
def test_identifier_out_of_range(can_id, data, extended):
    with pytest.raises(ValueError, match="outside"):
        pack_frame(can_id, data, extended=extended)


def test_too_many_bytes():
    with pytest.raises(ValueError, match="at most 8"):
        pack_frame(1, bytes(9))


def test_worst_case_table_of_davis_et_al():
    assert [longest_bits(n) for n in range(9)] == [55, 65, 75, 85, 95, 105, 115, 125, 135]
    assert [longest_bits(n, extended=True) for n in range(9)] == [80, 90, 100, 110, 120, 130, 140, 150, 160]


def _crc15_by_division(bits):
    """The remainder of bits * x^15 divided by the generator polynomial of Bosch CAN 2.0, as integers."""
    value = int("".join(map(str, bits)), 2) << 15
    generator = 0xC599  # x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1
    while value.bit_length() >= generator.bit_length():
        value ^= generator << (value.bit_length() - generator.bit_length())
    return value


@given(st.integers(0, 0x7FF), PAYLOADS)
def test_exact_length_against_a_second_construction(can_id, data):
    head = "0" + f"{can_id:011b}" + "000" + f"{len(data):04b}" + "".join(f"{byte:08b}" for byte in data)
    bits = head + f"{_crc15_by_division([int(b) for b in head]):015b}"
    sent = ""
    for bit in bits:
        sent += bit
        if len(sent) >= 5 and len(set(sent[-5:])) == 1:
            sent += "1" if bit == "0" else "0"
    assert exact_bits(can_id, data) == len(sent) + 13
    assert shortest_bits(len(data)) <= exact_bits(can_id, data) <= longest_bits(len(data))


@given(st.integers(0, 0x1FFF_FFFF), PAYLOADS)
def test_exact_length_of_extended_frames_is_within_bounds(can_id, data):
    bits = exact_bits(can_id, data, extended=True)
    assert shortest_bits(len(data), extended=True) <= bits <= longest_bits(len(data), extended=True)


def test_sync_always_has_51_bits():
    assert exact_bits(can.SYNC) == 51
    assert typical_bits(can.SYNC, 0) == 51.0


@pytest.mark.parametrize("length", range(9))
def test_typical_lies_between(length):
    assert shortest_bits(length) <= typical_bits(0x185, length) <= longest_bits(length)

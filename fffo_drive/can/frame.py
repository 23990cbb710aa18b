"""Linux `struct can_frame` as bytes, CANopen's predefined identifiers, and the length of frames on the wire.

Sources: linux/can.h (layout and flags), CiA 301 7.3.3 (predefined connection set), Davis, Burns, Bril and
Lukkien 2007 (worst-case length), Bosch CAN 2.0 (CRC and stuffing).
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import NamedTuple

FRAME_SIZE = 16  # u32 id and flags, u8 length, 3 bytes of padding, 8 data bytes
LENGTH_OFFSET, DATA_OFFSET = 4, 8
MAX_DATA = 8
_LAYOUT = struct.Struct("=IB3x8s")

EXTENDED_FLAG = 0x8000_0000
REMOTE_FLAG = 0x4000_0000
ERROR_FLAG = 0x2000_0000
STANDARD_MASK = 0x7FF
EXTENDED_MASK = 0x1FFF_FFFF

# classes of an error frame (linux/can/error.h), in its identifier
ERROR_BUS_OFF = 0x40
ERROR_RESTARTED = 0x100

# CiA 301 predefined connection set; the node id is added to all but NMT and SYNC
NMT = 0x000
SYNC = 0x080
EMERGENCY = 0x080
TPDO1, TPDO2, TPDO3 = 0x180, 0x280, 0x380
RPDO1, RPDO2, RPDO3, RPDO4 = 0x200, 0x300, 0x400, 0x500
SDO_RESPONSE = 0x580  # from the drive
SDO_REQUEST = 0x600  # to the drive
HEARTBEAT = 0x700  # also boot-up

NODE_IDS = range(1, 128)


class Frame(NamedTuple):
    """One classic CAN frame. For a remote frame `data` is as many zero bytes as the frame asks for."""

    can_id: int
    data: bytes
    extended: bool = False
    remote: bool = False
    error: bool = False


def pack_frame(
    can_id: int, data: bytes = b"", *, extended: bool = False, remote: bool = False, error: bool = False
) -> bytes:
    """The 16 bytes of `struct can_frame`.

    Raises ValueError for more than 8 data bytes or an identifier that the frame format cannot hold.
    """
    if len(data) > MAX_DATA:
        raise ValueError(f"a CAN frame carries at most {MAX_DATA} bytes, not {len(data)}")
    limit = EXTENDED_MASK if extended or error else STANDARD_MASK
    if not 0 <= can_id <= limit:
        raise ValueError(f"CAN identifier {can_id:#x} is outside 0..{limit:#x}")
    flags = (EXTENDED_FLAG if extended else 0) | (REMOTE_FLAG if remote else 0) | (ERROR_FLAG if error else 0)
    return _LAYOUT.pack(can_id | flags, len(data), data)


def unpack_frame(raw: bytes) -> Frame:
    """The inverse of `pack_frame`; a length field above 8 is read as 8.

    Raises ValueError unless `raw` has 16 bytes.
    """
    if len(raw) != FRAME_SIZE:
        raise ValueError(f"struct can_frame has {FRAME_SIZE} bytes, not {len(raw)}")
    word, length, data = _LAYOUT.unpack(raw)
    extended, error = bool(word & EXTENDED_FLAG), bool(word & ERROR_FLAG)
    can_id = word & (EXTENDED_MASK if extended or error else STANDARD_MASK)
    return Frame(can_id, data[: min(length, MAX_DATA)], extended, bool(word & REMOTE_FLAG), error)


_UNSTUFFED_TAIL = 13  # CRC delimiter, acknowledge slot and delimiter, end of frame (7), interframe space (3)
_CRC_POLYNOMIAL = 0x4599
_STUFF_RUN = 5
_TYPICAL_PAYLOADS = 64


def _stuffable_bits(data_bytes: int, extended: bool) -> int:
    return (54 if extended else 34) + 8 * data_bytes


def longest_bits(data_bytes: int, *, extended: bool = False) -> int:
    """Worst case of Davis et al. 2007: g + 8 n + 13 + floor((g + 8 n - 1) / 4), with g = 34 or 54."""
    stuffable = _stuffable_bits(data_bytes, extended)
    return stuffable + _UNSTUFFED_TAIL + (stuffable - 1) // 4


def _crc15(bits: list[int]) -> int:
    register = 0
    for bit in bits:
        feedback = bit ^ (register >> 14)
        register = (register << 1) & 0x7FFF
        if feedback:
            register ^= _CRC_POLYNOMIAL
    return register


def _bits(value: int, count: int) -> list[int]:
    return [(value >> shift) & 1 for shift in range(count - 1, -1, -1)]


def exact_bits(can_id: int, data: bytes = b"", *, extended: bool = False) -> int:
    """Exact length in bits of this data frame: CRC computed, stuff bits counted, interframe space included."""
    control = [0, *_bits(len(data), 4)]  # r0 and the length
    if extended:  # start, base id, SRR, IDE, rest of the id, RTR, r1
        header = [0, *_bits(can_id >> 18, 11), 1, 1, *_bits(can_id & 0x3FFFF, 18), 0, 0]
    else:  # start, id, RTR, IDE
        header = [0, *_bits(can_id, 11), 0, 0]
    bits = header + control + [bit for byte in data for bit in _bits(byte, 8)]
    bits += _bits(_crc15(bits), 15)
    stuffed, run, last = 0, 0, -1
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == _STUFF_RUN:  # the inserted bit is the complement and starts a run of its own
            stuffed += 1
            last, run = 1 - bit, 1
    return len(bits) + stuffed + _UNSTUFFED_TAIL


@lru_cache(maxsize=1024)
def typical_bits(can_id: int, data_bytes: int) -> float:
    """Mean of `exact_bits` over random payloads (a fixed sequence, so that the figure never changes)."""
    if data_bytes == 0:
        return float(exact_bits(can_id))
    total, state = 0, 1
    for _ in range(_TYPICAL_PAYLOADS):
        payload = bytearray()
        for _ in range(data_bytes):
            state = (1103515245 * state + 12345) & 0x7FFF_FFFF
            payload.append(state >> 23)
        total += exact_bits(can_id, bytes(payload))
    return total / _TYPICAL_PAYLOADS

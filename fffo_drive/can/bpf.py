"""Kernel filter of the frames for a socket: (id, mask) filters as a classic BPF program.

The same program serves AF_CAN and the loopback bus; only the offset of the frame differs. It needs no
privilege. On AF_CAN it replaces CAN_RAW_FILTER, because that cannot express "these, but not those" and
drops error frames as soon as exclusive filters are joined.
"""

from __future__ import annotations

import ctypes
import socket
import struct
import sys
from collections.abc import Sequence
from typing import NamedTuple

from .frame import ERROR_FLAG, FRAME_SIZE, STANDARD_MASK

UDP_HEADER = 8  # a filter on a UDP socket sees the header before the payload
MAX_FILTERS = 500  # 4096 BPF instructions, four for a filter

_SO_ATTACH_FILTER = 26
_LOAD_WORD, _LOAD_HALF, _LOAD_LENGTH = 0x20, 0x28, 0x80
_AND, _JUMP_EQUAL, _JUMP_ANY_BIT, _RETURN = 0x54, 0x15, 0x45, 0x06
_ACCEPT, _DROP = 0xFFFF_FFFF, 0

Instruction = tuple[int, int, int, int]  # code, jump if true, jump if false, constant


class CanFilter(NamedTuple):
    """Frames with (id & mask) == (can_id & mask); `id` includes the flag bits EXTENDED_FLAG and REMOTE_FLAG.

    With the default mask an extended frame passes when its low 11 bits match: a receiver that wants to count
    such frames sees them. With `exclude` the frames are kept out; a frame passes when no exclusive filter
    matches and, if there are inclusive ones, at least one of these does. Error frames always pass.
    """

    can_id: int
    mask: int = STANDARD_MASK
    exclude: bool = False


def _as_loaded(word: int) -> int:
    """BPF loads big-endian words; `struct can_frame` holds the identifier in the host's order."""
    return int.from_bytes(word.to_bytes(4, sys.byteorder), "big")


def _match(frame_offset: int, item: CanFilter, verdict: int) -> list[Instruction]:
    return [
        (_LOAD_WORD, 0, 0, frame_offset),
        (_AND, 0, 0, _as_loaded(item.mask)),
        (_JUMP_EQUAL, 0, 1, _as_loaded(item.can_id & item.mask)),
        (_RETURN, 0, 0, verdict),
    ]


def program(filters: Sequence[CanFilter], *, frame_offset: int = 0, own_port: int | None = None) -> list[Instruction]:
    """Instructions for `filters`; on a UDP socket also: nothing from `own_port`, nothing that is no frame.

    Raises ValueError for more than MAX_FILTERS.
    """
    if len(filters) > MAX_FILTERS:
        raise ValueError(f"at most {MAX_FILTERS} CAN filters on a link, not {len(filters)}")
    code: list[Instruction] = []
    if own_port is not None:
        code += [(_LOAD_HALF, 0, 0, 0), (_JUMP_EQUAL, 0, 1, own_port), (_RETURN, 0, 0, _DROP)]
    if frame_offset:
        size = frame_offset + FRAME_SIZE
        code += [(_LOAD_LENGTH, 0, 0, 0), (_JUMP_EQUAL, 1, 0, size), (_RETURN, 0, 0, _DROP)]
    code += [(_LOAD_WORD, 0, 0, frame_offset), (_JUMP_ANY_BIT, 0, 1, _as_loaded(ERROR_FLAG))]
    code.append((_RETURN, 0, 0, _ACCEPT))
    for item in filters:
        if item.exclude:
            code += _match(frame_offset, item, _DROP)
    inclusive = [item for item in filters if not item.exclude]
    for item in inclusive:
        code += _match(frame_offset, item, _ACCEPT)
    code.append((_RETURN, 0, 0, _DROP if inclusive else _ACCEPT))
    return code


def attach(sock: socket.socket, code: Sequence[Instruction]) -> None:
    """Give the program to the kernel; it replaces an earlier one at once. Raises OSError."""
    packed = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *item) for item in code))
    sock.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("@HP", len(code), ctypes.addressof(packed)))

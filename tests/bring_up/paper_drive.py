"""Objects of a drive on paper: numbers, absences and refusals, without a bus."""

from __future__ import annotations

import struct

from scripted_node import servo_dictionary

from fffo_drive.drive.canopen.sdo_objects import SdoObjects
from fffo_drive.drive.canopen.service import SdoRefusedError
from fffo_drive.drive.port import BusUnavailableError

NO_OBJECT = 0x06020000
SILENT = object()


def u32(value):
    return struct.pack("<I", value)


class Paper:
    """`read` of a drive: bytes, an abort code (int), or SILENT for each object; all else does not exist."""

    def __init__(self, objects):
        self.objects = objects
        self.asked = []

    def read(self, index, sub):
        self.asked.append((index, sub))
        found = self.objects.get((index, sub), NO_OBJECT)
        if found is SILENT:
            raise BusUnavailableError("no answer")
        if isinstance(found, int):
            raise SdoRefusedError(f"abort 0x{found:08X}", found)
        return found


def plain_drive(changes=None, without=()):
    """A plain servo drive with a supply, ready to be enabled; `changes`: objects with other values."""
    objects = servo_dictionary(1) | {
        (0x1001, 0): b"\0", (0x603F, 0): b"\0\0", (0x6041, 0): struct.pack("<H", 0x0250), (0x6079, 0): u32(48_000),
        (0x608F, 1): u32(4096), (0x608F, 2): u32(1), (0x60A9, 0): u32(0x00B44700), (0x60FD, 0): u32(0),
        (0x6080, 0): u32(3000), (0x6073, 0): struct.pack("<H", 2000),
    }  # fmt: skip
    objects |= changes or {}
    return SdoObjects(Paper({where: value for where, value in objects.items() if where not in without}).read)

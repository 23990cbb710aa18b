"""PDO mappings, their byte layouts as tables for the loop, and the scaling.

A TPDO of CiA 301 has one transmission type, so "every n-th SYNC and on change of state" takes two: TPDO2
carries statusword and torque with every n-th SYNC, TPDO3 the statusword alone on the event (types 254 and 255,
kept apart by an inhibit time; type 0, with the next SYNC after the event, for drives that know it). All
of it is configuration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...can import frame as can
from ..cia402 import MODE_CYCLIC_SYNCHRONOUS_TORQUE

CONTROLWORD, STATUSWORD = 0x6040, 0x6041
MODE, MODE_DISPLAY = 0x6060, 0x6061
POSITION, VELOCITY = 0x6064, 0x606C
TARGET_TORQUE, TORQUE, TORQUE_OFFSET = 0x6071, 0x6077, 0x60B2
CURRENT = 0x6078
FIRST_OBJECT = 0x6000
AXIS_OBJECTS = 0x800  # CiA 402: each further axis of a node has the objects of the first, this much higher
MOST_AXES = 8
VENDOR_OBJECTS = range(0x2000, 0x6000)  # of a meaning that only the vendor's manual gives

# fields of the feedback that a TPDO object fills; the layout table holds these numbers
FIELD_VELOCITY, FIELD_POSITION, FIELD_TORQUE, FIELD_STATUSWORD = range(4)
# object -> (field, bits, signed); torque beside them is the drive's own object
FEEDBACK_OBJECTS = {
    VELOCITY: (FIELD_VELOCITY, 32, True),
    POSITION: (FIELD_POSITION, 32, True),
    STATUSWORD: (FIELD_STATUSWORD, 16, False),
}
# object -> bits; the target beside them is the drive's own object
COMMAND_OBJECTS = {CONTROLWORD: 16, TARGET_TORQUE: 16, TORQUE_OFFSET: 16, MODE: 8}


def object_name(index: int, sub: int) -> str:
    """For instance 0x6040:00, as all messages name an object."""
    return f"0x{index:04X}:{sub:02X}"


def axis_of(index: int) -> tuple[int, int]:
    """Number from 1 of the axis of a node that an object of CiA 402 belongs to, and that object of the first axis."""
    axis = (index - FIRST_OBJECT) // AXIS_OBJECTS
    return (axis + 1, index - axis * AXIS_OBJECTS) if 0 <= axis < MOST_AXES else (1, index)


EVERY_SYNC = 1
ON_EVENT = 255
MAX_SYNC_TYPE = 240
DEFAULT_STATUS_INHIBIT_NS = 2_000_000

Table = np.ndarray[Any, np.dtype[np.int64]]


class MappingError(ValueError):
    """An impossible configuration. The text lists every problem, each with what is allowed."""


@dataclass(frozen=True)
class MappedObject:
    """One entry of a PDO mapping."""

    index: int
    sub: int
    bits: int

    @property
    def word(self) -> int:
        """The entry as in 0x1600 or 0x1A00 (CiA 301 7.5.2.36)."""
        return self.index << 16 | self.sub << 8 | self.bits

    def __str__(self) -> str:
        return f"0x{self.index:04X}:{self.sub:02X}/{self.bits}"


class PdoMap(NamedTuple):
    """One PDO: number from 1, COB-ID, transmission type, mapping, shortest distance of two (TPDO)."""

    number: int
    cob_id: int
    transmission: int
    objects: tuple[MappedObject, ...]
    inhibit_ns: int = 0

    @property
    def data_bytes(self) -> int:
        """Length of its frames."""
        return sum(item.bits for item in self.objects) // 8

    def offset_of(self, index: int) -> int:
        """Byte at which an object begins; -1 when it is not mapped."""
        offset = 0
        for item in self.objects:
            if item.index == index:
                return offset // 8
            offset += item.bits
        return -1


class Scaling(NamedTuple):
    """The only place where a drive's units are converted to revolutions and amperes; negative if inverted."""

    velocity_rps_per_unit: float
    position_rev_per_count: float
    target_units_per_a: float  # of the object that is commanded; of 0x6071 per mille of the rated torque
    feedback_units_per_a: float  # of the torque or current that comes back


STANDARD_TARGET = MappedObject(TARGET_TORQUE, 0, 16)
STANDARD_TORQUE = MappedObject(TORQUE, 0, 16)


class PdoSlots(NamedTuple):
    """Numbers of the PDOs in use. `event` None: no TPDO on a change of the statusword."""

    command: int = 1
    motion: int = 1
    status: int = 2
    event: int | None = 3


STANDARD_SLOTS = PdoSlots()


def command_pdo(node_id: int, target: MappedObject = STANDARD_TARGET, slots: PdoSlots = STANDARD_SLOTS) -> PdoMap:
    """An RPDO with each SYNC: controlword, target torque."""
    objects = (MappedObject(CONTROLWORD, 0, 16), target)
    return PdoMap(slots.command, can.RPDO1 + node_id, EVERY_SYNC, objects)


def feedback_pdos(
    node_id: int,
    status_every: int,
    status_event: int = ON_EVENT,
    torque: MappedObject = STANDARD_TORQUE,
    slots: PdoSlots = STANDARD_SLOTS,
) -> tuple[PdoMap, ...]:
    """Motion with each SYNC, status and torque with every n-th, status on event."""
    status = MappedObject(STATUSWORD, 0, 16)
    motion = (MappedObject(VELOCITY, 0, 32), MappedObject(POSITION, 0, 32))
    inhibit_ns = DEFAULT_STATUS_INHIBIT_NS if status_event > MAX_SYNC_TYPE else 0
    cyclic = (
        PdoMap(slots.motion, can.TPDO1 + node_id, EVERY_SYNC, motion),
        PdoMap(slots.status, can.TPDO2 + node_id, status_every, (status, torque)),
    )
    if slots.event is None:
        return cyclic
    return (*cyclic, PdoMap(slots.event, can.TPDO3 + node_id, status_event, (status,), inhibit_ns))


def field_table(answers: Sequence[PdoMap], torque: MappedObject = STANDARD_TORQUE) -> Table:
    """One row per used object, shape (n, 5): row of its TPDO, byte offset, bytes, signed, FIELD_*."""
    rows = []
    known = {(index, 0): (field, signed) for index, (field, _, signed) in FEEDBACK_OBJECTS.items()}
    known[torque.index, torque.sub] = (FIELD_TORQUE, True)
    for slot, pdo in enumerate(answers):
        offset = 0
        for item in pdo.objects:
            if (item.index, item.sub) in known:
                field, signed = known[item.index, item.sub]
                rows.append((slot, offset // 8, item.bits // 8, int(signed), field))
            offset += item.bits
    return np.array(rows, np.int64)


def command_payload(pdo: PdoMap, mode: int = MODE_CYCLIC_SYNCHRONOUS_TORQUE) -> bytes:
    """The RPDO's data with everything at rest: no voltage, no torque, the mode kept."""
    payload = b""
    for item in pdo.objects:
        payload += (mode if item.index == MODE else 0).to_bytes(item.bits // 8, "little", signed=True)
    return payload


def interpolation_period(period_ns: int) -> tuple[int, int]:
    """0x60C2: value 1 to 255 and exponent, period = value * 10^exponent s. Raises MappingError."""
    for exponent in range(-3, -7, -1):
        unit_ns = 10 ** (9 + exponent)
        if period_ns % unit_ns == 0 and 1 <= period_ns // unit_ns <= 255:
            return period_ns // unit_ns, exponent
    raise MappingError(f"a period of {period_ns} ns does not fit 0x60C2: choose 1 to 255 times 1, 10 or 100 us or 1 ms")

"""What a trace of a CAN bus, and the file of a drive, say of a node: its objects, and what its PDOs carry.

SDO traffic (CiA 301, 7.2.4) of which the trace has the expedited transfers; PDO parameters 0x1400 to 0x1BFF.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from ..can import frame as can
from ..canopen_node.cob_id import INVALID
from ..drive.canopen.object_map import MappedObject, PdoMap
from .can_frames import Frames, Ints

RPDO_PARAMETERS, TPDO_PARAMETERS, TO_MAPPING = 0x1400, 0x1800, 0x200
MOST_PDOS = 64  # of each direction that are looked at
MOST_ENTRIES = 64  # objects in a PDO (CiA 301, 7.5.2.36)
STORE = 0x1010
NODE_MASK = 0x7F
# 3 bits of the command specifier
DOWNLOAD, UPLOAD, DOWNLOADED, UPLOADED, ABORT = 1, 2, 3, 2, 4

Place = tuple[int, int]  # index, sub-index
Value = Callable[[int, int], int | None]


class SdoChange(NamedTuple):
    """A value that a node has from some frame on, or is known to have; None in `place`: it began anew."""

    frame: int
    place: Place | None
    value: int
    written: bool


class Stretch(NamedTuple):
    """The part of a trace in which one set of PDO parameters is in force, and what is known of the node's objects."""

    first: int
    last: int  # the frame behind it
    values: dict[Place, int]

    def value(self, index: int, sub: int = 0) -> int | None:
        """As the trace shows it."""
        return self.values.get((index, sub))

    def has(self, index: int, sub: int = 0) -> bool:
        """Whether the trace shows it."""
        return (index, sub) in self.values


def nodes_of(frames: Frames) -> list[tuple[int, int]]:
    """(channel, node id) of the nodes that send TPDOs, of those that also send a heartbeat or SDO where some do."""
    found: dict[tuple[int, int], set[int]] = {}
    for key in np.unique(frames.channels << 11 | frames.ids).tolist():
        can_id = key & can.STANDARD_MASK
        found.setdefault((key >> 11, can_id & NODE_MASK), set()).add(can_id & ~NODE_MASK)
    tpdos = {can.TPDO1, can.TPDO2, can.TPDO3, can.TPDO3 + 0x100}
    sending = {key for key, functions in found.items() if key[1] and functions & tpdos}
    alive = {key for key in sending if found[key] & {can.HEARTBEAT, can.SDO_RESPONSE}}
    return sorted(alive or sending)


def longest_stretch(frames: Frames, node: int) -> Stretch:
    """The part of a trace with one set of PDO parameters in which the node sends most."""
    changes = list(_changes(frames, node))
    cuts = [0, *(c.frame for c in changes if c.written and _of_a_pdo(c.place)), frames.ids.size]
    own = frames.ids & NODE_MASK == node
    process = np.flatnonzero(own & (frames.ids > can.TPDO1) & (frames.ids < can.SDO_RESPONSE))
    most = int(np.argmax(np.diff(np.searchsorted(process, cuts))))
    values: dict[Place, int] = {}
    for change in changes:
        if _of_a_pdo(change.place) and change.frame >= cuts[most + 1]:
            continue
        if change.place is not None:
            values[change.place] = change.value
        elif (STORE, 1) not in values:
            values = {place: value for place, value in values.items() if not _of_a_pdo(place)}
    return Stretch(cuts[most], cuts[most + 1], values)


def _of_a_pdo(place: Place | None) -> bool:
    """Whether a change is one of the PDOs: a parameter, or all of them."""
    return place is None or RPDO_PARAMETERS <= place[0] < TPDO_PARAMETERS + 2 * TO_MAPPING


def _changes(frames: Frames, node: int) -> Iterator[SdoChange]:
    """What SDO transfers tell, each once; a boot-up message."""
    request, answer, boot = can.SDO_REQUEST + node, can.SDO_RESPONSE + node, can.HEARTBEAT + node
    ids = frames.ids
    answered = bool((ids == answer).any())
    known: dict[Place, int] = {}
    asked: tuple[int, Place, int | None] | None = None
    for k in np.flatnonzero((ids == request) | (ids == answer) | (ids == boot)).tolist():
        data = frames.data[k].tobytes()
        told: tuple[Place, int | None] | None = None
        written = True
        if ids[k] == boot:
            if frames.lengths[k] == 1 and data[0] == 0:
                known = {place: value for place, value in known.items() if not _of_a_pdo(place)}
                yield SdoChange(k, None, 0, True)
            continue
        command, place = data[0] >> 5, (int.from_bytes(data[1:3], "little"), data[3])
        if ids[k] == request:
            asked = (command, place, _expedited(data)) if command in (DOWNLOAD, UPLOAD) else None
            if asked and command == DOWNLOAD and not answered:
                told = place, asked[2]
        elif asked is not None and place == asked[1]:
            if command == DOWNLOADED and asked[0] == DOWNLOAD:
                told = place, asked[2]
            elif command == UPLOADED and asked[0] == UPLOAD:
                told, written = (place, _expedited(data)), False
            asked = None
        if told is not None and told[1] is not None and known.get(told[0]) != told[1]:
            known[told[0]] = told[1]
            yield SdoChange(k, told[0], told[1], written)


def _expedited(data: bytes) -> int | None:
    """The value in an initiate frame, unsigned; None of a transfer in segments."""
    if not data[0] & 0x02:
        return None
    size = 4 - (data[0] >> 2 & 3) if data[0] & 0x01 else 4
    return int.from_bytes(data[4 : 4 + size], "little")


def pdos_of(value: Value) -> tuple[list[PdoMap], list[PdoMap]]:
    """RPDOs and TPDOs that exist by their parameters. `value(index, sub)`: None where it is not known."""
    return _pdos(value, RPDO_PARAMETERS), _pdos(value, TPDO_PARAMETERS)


def _pdos(value: Value, parameters: int) -> list[PdoMap]:
    found = []
    for number in range(1, MOST_PDOS + 1):
        index = parameters + number - 1
        cob_id = value(index, 1)
        objects = _mapped(value, index + TO_MAPPING)
        if cob_id is None or cob_id & INVALID or not objects:
            continue
        kind = value(index, 2)
        found.append(PdoMap(number, cob_id & can.STANDARD_MASK, 255 if kind is None else kind, tuple(objects)))
    return found


def _mapped(value: Value, index: int) -> list[MappedObject]:
    """The entries of a mapping; zeros are places that are not used."""
    count = value(index, 0)
    words = [value(index, sub) for sub in range(1, (MOST_ENTRIES if count is None else min(count, MOST_ENTRIES)) + 1)]
    return [MappedObject(word >> 16, word >> 8 & 0xFF, word & 0xFF) for word in words if word]


def numbers_of(frames: Frames, rows: Ints, pdo: PdoMap, item: int, is_signed: bool) -> Any:
    """Object `item` of a PDO in the frames `rows` (n,), as int64 (n,). Bits of a CAN frame: least significant first."""
    offset = sum(one.bits for one in pdo.objects[:item])
    words = frames.data[rows].copy().view("<u8").ravel()
    bits = pdo.objects[item].bits
    raw = words >> np.uint64(offset) & np.uint64((1 << bits) - 1)
    if not is_signed:
        return raw.astype(np.int64)
    up = np.uint64(64 - bits)
    return (raw << up).view(np.int64) >> np.int64(64 - bits)

"""LSS slave (CiA 305): the node-ID set over the bus, by vendor, product, revision and serial number of the drive.

A configured node-ID acts from the next communication reset on; one that was stored, after a reset of the node too. 255
takes the drive off the bus: it then listens to LSS alone, until it is given a node-ID. The bit timing is that of the
interface and cannot be changed.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from enum import IntEnum

from ..can.frame import DATA_OFFSET, LENGTH_OFFSET, MAX_DATA, NODE_IDS
from .bus import Bus
from .dictionary import ObjectDictionary
from .nmt import UNCONFIGURED, NmtSlave

REQUEST_ID = 0x7E5
RESPONSE_ID = 0x7E4
IDENTITY = 0x1018
ADDRESS_SUBS = range(1, 5)  # of 0x1018: vendor, product, revision, serial number

REFUSED = 1
CONFIRM_ALL = 0x80  # fastscan: "is anybody without a node-ID there?"


class LssCommand(IntEnum):
    """Command specifiers."""

    SWITCH_GLOBAL = 0x04
    CONFIGURE_NODE_ID = 0x11
    CONFIGURE_BIT_TIMING = 0x13
    STORE = 0x17
    SWITCH_SELECTIVE = 0x40  # and the three that follow
    SWITCHED = 0x44
    IDENTIFY = 0x46  # and the five that follow
    IDENTIFY_UNCONFIGURED = 0x4C
    IDENTIFIED = 0x4F
    IDENTIFIED_UNCONFIGURED = 0x50
    FASTSCAN = 0x51
    INQUIRE_ADDRESS = 0x5A  # and the three that follow
    INQUIRE_NODE_ID = 0x5E


SELECTIVE = range(LssCommand.SWITCH_SELECTIVE, LssCommand.SWITCHED)
IDENTIFY = range(LssCommand.IDENTIFY, LssCommand.IDENTIFY_UNCONFIGURED)
INQUIRE = range(LssCommand.INQUIRE_ADDRESS, LssCommand.INQUIRE_NODE_ID)
# part of the address in each identify request, and whether its number is a lower or an upper bound
_BOUNDS = ((1, True, True), (2, True, True), (3, True, False), (3, False, True), (4, True, False), (4, False, True))
_ARGUMENT = struct.Struct("<I")


class LssSlave:
    """Answers on 0x7E4. `on_node_id()` is called when a drive without a node-ID was given one."""

    def __init__(self, bus: Bus, od: ObjectDictionary, nmt: NmtSlave, on_node_id: Callable[[], None]) -> None:
        self.bus, self.od, self.nmt = bus, od, nmt
        self._on_node_id = on_node_id
        self._stored = self._pending = nmt.node_id
        self._configuring = False
        self._matched = 0  # requests in a row that fit, of a switch or of an identification
        self._scanned = 0  # parts of the address that a fastscan has found

    def adopt(self, whole_node: bool) -> int:
        """The node-ID from this reset on: the stored one after a reset of the node, else the configured one."""
        if whole_node:
            self._pending = self._stored
            self._configuring = False
        return self._pending

    def receive(self, frame: bytes) -> None:
        """A request of the LSS master."""
        if frame[LENGTH_OFFSET] != MAX_DATA:
            return
        data = frame[DATA_OFFSET:]
        command = data[0]
        number = _ARGUMENT.unpack_from(data, 1)[0]
        if command == LssCommand.SWITCH_GLOBAL:
            self._switch(data[1] == 1)
        elif command in SELECTIVE:
            self._select(command - LssCommand.SWITCH_SELECTIVE, number)
        elif command in IDENTIFY:
            self._identify(command - LssCommand.IDENTIFY, number)
        elif command == LssCommand.IDENTIFY_UNCONFIGURED:
            if self.nmt.node_id == UNCONFIGURED:
                self._answer(LssCommand.IDENTIFIED_UNCONFIGURED)
        elif command == LssCommand.FASTSCAN:
            self._scan(number, data[5], data[6], data[7])
        elif self._configuring:
            self._configure(command, data[1])

    def _answer(self, command: int, data: bytes = b"") -> None:
        self.bus.send(RESPONSE_ID, (bytes([command]) + data).ljust(MAX_DATA, b"\0"))

    def _address(self, sub: int) -> int:
        return self.od.number(IDENTITY, sub)

    def _switch(self, configuring: bool) -> None:
        """To the configuration state, or back to waiting; a node-ID for a drive without one then acts at once."""
        self._matched = 0
        self._configuring = configuring
        if not configuring and self.nmt.node_id == UNCONFIGURED and self._pending in NODE_IDS:
            self._on_node_id()

    def _select(self, part: int, number: int) -> None:
        if part != 0 and part != self._matched:
            self._matched = 0
            return
        self._matched = part + 1 if number == self._address(part + 1) else 0
        if self._matched == len(ADDRESS_SUBS):
            self._matched = 0
            self._configuring = True
            self._answer(LssCommand.SWITCHED)

    def _identify(self, step: int, number: int) -> None:
        if step != 0 and step != self._matched:
            self._matched = 0
            return
        sub, is_lower, is_upper = _BOUNDS[step]
        mine = self._address(sub)
        fits = (not is_lower or number <= mine) and (not is_upper or mine <= number)
        self._matched = step + 1 if fits else 0
        if self._matched == len(_BOUNDS):
            self._matched = 0
            self._answer(LssCommand.IDENTIFIED)

    def _scan(self, number: int, bit: int, part: int, following: int) -> None:
        """Fastscan: the master guesses the address bit by bit; nodes that match answer."""
        if self.nmt.node_id != UNCONFIGURED or self._configuring:
            return
        if bit == CONFIRM_ALL:
            self._scanned = 0
            self._answer(LssCommand.IDENTIFIED)
        elif bit < 32 and part == self._scanned and part < len(ADDRESS_SUBS):
            if (number ^ self._address(part + 1)) >> bit:
                return
            if bit == 0 and following != part:  # this part is found; the next one, or the end
                self._scanned = following
                self._configuring = following < part
            self._answer(LssCommand.IDENTIFIED)

    def _configure(self, command: int, value: int) -> None:
        """What a drive does in the configuration state."""
        if command == LssCommand.CONFIGURE_NODE_ID:
            allowed = value in NODE_IDS or value == UNCONFIGURED
            if allowed:
                self._pending = value
            self._answer(command, bytes([0 if allowed else REFUSED]))
        elif command == LssCommand.CONFIGURE_BIT_TIMING:
            self._answer(command, bytes([REFUSED]))
        elif command == LssCommand.STORE:
            self._stored = self._pending
            self._answer(command, bytes([0]))
        elif command == LssCommand.INQUIRE_NODE_ID:
            self._answer(command, bytes([self.nmt.node_id]))
        elif command in INQUIRE:
            self._answer(command, _ARGUMENT.pack(self._address(command - LssCommand.INQUIRE_ADDRESS + 1)))

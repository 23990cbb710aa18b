"""The other end of the bus for tests: a node with a dictionary, a script of refusals, and a record.

It is written from CiA 301 alone and shares nothing with the code under test but the frame layout.
"""

from __future__ import annotations

import struct
import threading

from fffo_drive.can.frame import pack_frame, unpack_frame
from fffo_drive.can.link import open_link

NO_OBJECT, NO_SUB, READ_ONLY = 0x06020000, 0x06090011, 0x06010002
STATE_REASON, NOT_MAPPABLE, RANGE = 0x08000022, 0x06040041, 0x06090030


def servo_dictionary(node_id):
    """What a plain CiA 402 servo drive with four TPDOs holds after power-on: (index, sub) -> bytes."""
    u8, u16, u32, i8 = (struct.Struct(code).pack for code in ("<B", "<H", "<I", "<b"))
    objects = {
        (0x1000, 0): u32(0x00020192),
        (0x1005, 0): u32(0x80),
        (0x1006, 0): u32(0),
        (0x1008, 0): b"a drive with a long name",
        (0x100A, 0): b"v1.2",
        (0x1014, 0): u32(0x80 + node_id),
        (0x1016, 0): u8(1),
        (0x1016, 1): u32(0),
        (0x1017, 0): u16(0),
        (0x1018, 0): u8(4),
        (0x1018, 1): u32(0x11),
        (0x1018, 2): u32(0x22),
        (0x1018, 3): u32(0x33),
        (0x1018, 4): u32(0x44),
        (0x1019, 0): u8(0),
        (0x6007, 0): u16(1),
        (0x6040, 0): u16(0),
        (0x6041, 0): u16(0x40),
        (0x605A, 0): u16(1),
        (0x605E, 0): u16(0),
        (0x6060, 0): i8(0),
        (0x6061, 0): i8(0),
        (0x6064, 0): u32(0),
        (0x606C, 0): u32(0),
        (0x6071, 0): u16(0),
        (0x6072, 0): u16(1000),
        (0x6075, 0): u32(10_000),
        (0x6076, 0): u32(1_000),
        (0x6077, 0): u16(0),
        (0x60C2, 1): u8(1),
        (0x60C2, 2): i8(-3),
        (0x6502, 0): u32(1 << 9),
    }
    for first, cob_base, no_rtr in ((0x1400, 0x200, 0), (0x1800, 0x180, 1 << 30)):
        for n in range(4):
            objects[first + n, 1] = u32((cob_base + 0x100 * n + node_id) | no_rtr | (1 << 31 if n else 0))
            objects[first + n, 2] = u8(255)
            objects[first + n, 5] = u16(0)
            if first == 0x1800:
                objects[first + n, 3] = u16(100)
            objects[first + n + 0x200, 0] = u8(1)
            for sub in range(1, 9):
                objects[first + n + 0x200, sub] = u32(0x60400010 if first == 0x1400 else 0x60410010)
    return objects


class ScriptedNode:
    """Answers SDO, NMT and nothing else, in a thread, until `stop`. Use as a context manager.

    refuse: (index, sub) -> abort code of writes; keep: (index, sub) -> bytes read back whatever was written;
    mute: no SDO answers; boots: boot-up messages after a reset; starts: reports operational after NMT start;
    beats: a heartbeat after every frame it hears; filler: the byte behind a value in expedited answers, which then do
    not tell their size.
    """

    def __init__(
        self, bus, node_id, objects=None, *, refuse=None, keep=None, mute=False, boots=1, starts=True, beats=False,
        filler=None,
    ):  # fmt: skip
        self.link = open_link(bus)
        self.node_id = node_id
        self.objects = dict(servo_dictionary(node_id) if objects is None else objects)
        self.power_on = dict(self.objects)
        self.refuse, self.keep = refuse or {}, keep or {}
        self.shows_mode = True  # in 0x6061, at once
        self.mute, self.boots, self.starts, self.beats = mute, boots, starts, beats
        self.filler = filler
        self.written = []  # (index, sub, bytes) in order
        self.commands = []  # NMT
        self.heard = []  # every frame
        self._upload = b""
        self._download = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.stop()

    def stop(self):
        self._stop.set()
        self._thread.join(2.0)
        self.link.close()

    def take(self, frame):
        """For nodes that do something of their own with a frame."""

    def keeps_count(self, index):
        """For nodes whose mappings have a fixed number of entries."""
        return False

    def check(self, index, sub, value):
        """For nodes that refuse a write for a reason of their own: its abort code."""
        return 0

    def number(self, index, sub=0):
        return int.from_bytes(self.objects[index, sub], "little")

    def send(self, can_id, data=b"", **flags):
        self.link.send(pack_frame(can_id, data, **flags))

    def _run(self):
        while not self._stop.is_set():
            raw = self.link.receive(0.02)
            if raw is None:
                continue
            frame = unpack_frame(raw)
            self.heard.append(frame)
            self.take(frame)
            if self.beats:
                self.send(0x700 + self.node_id, b"\x7f")
            if frame.can_id == 0 and frame.data[1:] in (bytes([self.node_id]), b"\0"):
                self._nmt(frame.data[0])
            elif frame.can_id == 0x600 + self.node_id and not self.mute:
                self._sdo(frame.data)

    def _nmt(self, command):
        self.commands.append(command)
        if command == 0x82:
            self.objects = dict(self.power_on)
            for _ in range(self.boots):
                self.send(0x700 + self.node_id, b"\0")
        elif command == 0x01 and self.starts:
            self.send(0x700 + self.node_id, b"\x05")

    def _answer(self, head, data=b""):
        self.send(0x580 + self.node_id, (head + data).ljust(8, b"\0"))

    def _abort(self, where, code):
        self._answer(b"\x80" + where, code.to_bytes(4, "little"))

    def _sdo(self, request):
        command, where = request[0], request[1:4]
        index, sub = int.from_bytes(where[:2], "little"), where[2]
        kind = command >> 5
        if kind == 2:  # initiate upload
            if (index, sub) not in self.objects:
                known = any(i == index for i, _ in self.objects)
                self._abort(where, NO_SUB if known else NO_OBJECT)
                return
            value = self.keep.get((index, sub), self.objects[index, sub])
            if 1 <= len(value) <= 4 and self.filler is not None:
                self._answer(b"\x42" + where, value.ljust(4, self.filler))
            elif 1 <= len(value) <= 4:
                self._answer(bytes([0x43 | (4 - len(value)) << 2]) + where, value)
            else:
                self._upload = value
                self._answer(b"\x41" + where, len(value).to_bytes(4, "little"))
        elif kind == 3:  # upload segment
            part, self._upload = self._upload[:7], self._upload[7:]
            self._answer(bytes([command & 0x10 | (7 - len(part)) << 1 | (not self._upload)]), part)
        elif kind == 1:  # initiate download, expedited
            size = 4 - (command >> 2 & 3)
            code = self._check(index, sub, request[4 : 4 + size])
            if code:
                self._abort(where, code)
            else:
                self._answer(b"\x60" + where)

    def _check(self, index, sub, value):
        self.written.append((index, sub, value))
        if (index, sub) in self.refuse:
            return self.refuse[index, sub]
        if (index, sub) not in self.objects:
            return NO_OBJECT
        if code := self.check(index, sub, value):
            return code
        number = int.from_bytes(value, "little")
        group = index & 0xFE00
        if group in (0x1400, 0x1800) and sub == 1:
            if not self.number(index, 1) >> 31 and not number >> 31:
                return RANGE
            if group == 0x1800 and self.number(index, 1) & 1 << 30 and not number & 1 << 30:
                return RANGE  # this drive insists on "no RTR"
        if group in (0x1600, 0x1A00):
            if not self.number(index - 0x200, 1) >> 31:
                return STATE_REASON
            if sub and self.number(index, 0) and not self.keeps_count(index):
                return NOT_MAPPABLE
        self.objects[index, sub] = value
        if index == 0x6060 and self.shows_mode:
            self.objects[0x6061, 0] = value
        return 0

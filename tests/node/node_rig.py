"""A node on a bench of its own: frames as text, time as a number, a rigid body for a motor."""

from __future__ import annotations

import struct

from fffo_drive.can.frame import pack_frame, unpack_frame
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.drive.simulated.node.core import Node

NS_PER_MS = 1_000_000
SIZES = {1: 0x2F, 2: 0x2B, 4: 0x23}
ENABLE = (0x06, 0x07, 0x0F)
OPERATION_ENABLED = 0x27
STATE_MASK = 0x6F


class RigidBody:
    """J dw/dt = Kt i, without friction: closed forms for what a drive does to it."""

    rps2_per_a = 20.0

    def __init__(self) -> None:
        self.angle_rev, self.velocity_rps, self.current_a = 0.0, 0.0, 0.0
        self.limited, self.dc_link_v, self.temperature_k = False, 48.0, 0.0
        self.torque_seen: list[float] = []
        self._time_ns = 0
        self._lost = False
        self._jump_rev = 0.0
        self._held = 0

    @property
    def counts(self) -> int:
        return self._held if self._lost else int((self.angle_rev + self._jump_rev) * 32768)

    def advance(self, until_ns: int, current_a: float) -> None:
        duration_s = (until_ns - self._time_ns) / 1e9
        assert duration_s >= 0.0
        if duration_s > 0.0:
            self.torque_seen.append(current_a)
        acceleration = self.rps2_per_a * current_a
        self.angle_rev += self.velocity_rps * duration_s + 0.5 * acceleration * duration_s * duration_s
        self.velocity_rps += acceleration * duration_s
        self.current_a = current_a
        self._time_ns = until_ns

    def lose_resolver(self, lost: bool, jump_rev: float) -> None:
        if lost:
            self._jump_rev += jump_rev
            self._held = self.counts
        self._lost = lost

    def lose_dc_link(self, lost: bool) -> None:
        self.dc_link_v = 0.0 if lost else 48.0


class Rig:
    """Node 1 (unless configured otherwise) after power-on, its boot-up message taken."""

    def __init__(self, config: NodeConfig | None = None, plant: RigidBody | None = None) -> None:
        self.config = config or NodeConfig()
        self.plant = plant or RigidBody()
        self.node = Node(self.config, self.plant)
        self.now_ns = 5_000_000_000
        self.boot = [text(frame) for frame in self.node.start(self.now_ns)]

    def send(self, frame: str) -> list[str]:
        """`cansend` notation. Returns what the node sends for it."""
        can_id, _, data = frame.partition("#")
        raw = pack_frame(int(can_id, 16), bytes.fromhex(data.replace(".", "").replace(" ", "")))
        return [text(answer) for answer in self.node.handle(raw, self.now_ns)]

    def wait(self, milliseconds: float) -> list[str]:
        """Let time pass, the node being polled at its deadlines. Returns what it sends."""
        end_ns = self.now_ns + round(milliseconds * NS_PER_MS)
        sent = [text(frame) for frame in self.node.bus.outbox]  # what a test has set off from outside
        self.node.bus.outbox.clear()
        while self.node.deadline_ns <= end_ns:
            self.now_ns = max(self.now_ns, self.node.deadline_ns)
            sent += [text(frame) for frame in self.node.poll(self.now_ns)]
        self.now_ns = end_ns
        return sent

    def script(self, lines: str) -> None:
        """`> frame` to the node, `< frame` from it, `+ ms` waits. Everything that the node sends must be listed."""
        pending: list[str] = []
        for line in filter(None, (line.split(";")[0].strip() for line in lines.splitlines())):
            action, _, rest = line.partition(" ")
            if action == "<":
                assert pending, f"nothing was sent, expected {rest}"
                assert pending.pop(0) == rest.strip().upper().replace(".", "")
                continue
            assert not pending, f"not expected before {line!r}: {pending}"
            pending = self.send(rest.strip()) if action == ">" else self.wait(float(rest))
        assert not pending, f"not expected at the end: {pending}"

    def write(self, index: int, sub: int, value: int, size: int) -> int:
        """Expedited download: 0, or the abort code."""
        command = SIZES[size]
        data = struct.pack("<BHBI", command, index, sub, value & (1 << 8 * size) - 1)
        return self._answer(data)[1]

    def read(self, index: int, sub: int = 0) -> int:
        """Expedited upload as an unsigned number. Fails on an abort."""
        data, abort = self._answer(struct.pack("<BHB4x", 0x40, index, sub))
        assert not abort, f"{index:04X}:{sub:02X} aborted with {abort:08X}"
        length = 4 - (data[0] >> 2 & 3)
        return int.from_bytes(data[4 : 4 + length], "little")

    def read_abort(self, index: int, sub: int = 0) -> int:
        """Abort code of an upload, 0 for none."""
        return self._answer(struct.pack("<BHB4x", 0x40, index, sub))[1]

    def _answer(self, request: bytes) -> tuple[bytes, int]:
        raw = pack_frame(0x600 + self.config.node_id, request)
        frames = [unpack_frame(f) for f in self.node.handle(raw, self.now_ns)]
        mine = [f.data for f in frames if f.can_id == 0x580 + self.config.node_id]
        assert len(mine) == 1, frames
        abort = int.from_bytes(mine[0][4:], "little") if mine[0][0] == 0x80 else 0
        return mine[0], abort

    # short ways to a state

    def operational(self) -> None:
        self.send("000#0100")

    def map_cyclic(self) -> None:
        """RPDO1 {controlword, torque}, TPDO1 {velocity, position}, TPDO2 {statusword, torque}, all with SYNC."""
        steps = [
            (0x1400, 1, 0x80000201, 4), (0x1400, 2, 1, 1), (0x1600, 0, 0, 1), (0x1600, 1, 0x60400010, 4),
            (0x1600, 2, 0x60710010, 4), (0x1600, 0, 2, 1), (0x1400, 1, 0x201, 4), (0x1401, 1, 0x80000301, 4),
            (0x1800, 1, 0xC0000181, 4), (0x1800, 2, 1, 1), (0x1A00, 0, 0, 1), (0x1A00, 1, 0x606C0020, 4),
            (0x1A00, 2, 0x60640020, 4), (0x1A00, 0, 2, 1), (0x1800, 1, 0x40000181, 4),
            (0x1801, 1, 0xC0000281, 4), (0x1801, 2, 1, 1), (0x1A01, 0, 0, 1), (0x1A01, 1, 0x60410010, 4),
            (0x1A01, 2, 0x60770010, 4), (0x1A01, 0, 2, 1), (0x1801, 1, 0x40000281, 4),
        ]  # fmt: skip
        for step in steps:
            assert self.write(*step) == 0, step

    def enable(self, mode: int = 10) -> None:
        """To OPERATION ENABLED by SDO."""
        assert self.write(0x6060, 0, mode, 1) == 0
        for word in ENABLE:
            assert self.write(0x6040, 0, word, 2) == 0
        assert self.state == OPERATION_ENABLED

    def cycle(self, controlword: int, torque: int, milliseconds: float = 0.5) -> list[str]:
        """One RPDO, then one SYNC later."""
        sent = self.send("201#" + struct.pack("<Hh", controlword, torque).hex())
        sent += self.wait(milliseconds)
        return sent + self.send("080#")

    @property
    def statusword(self) -> int:
        return self.node.od.number(0x6041)

    @property
    def state(self) -> int:
        """State bits of the statusword."""
        return self.statusword & (STATE_MASK if self.statusword & 0x20 else 0x4F)


def text(frame: bytes) -> str:
    """A frame in `cansend` notation."""
    f = unpack_frame(frame)
    return f"{f.can_id:08X}#!" if f.error else f"{f.can_id:03X}#{f.data.hex().upper()}"

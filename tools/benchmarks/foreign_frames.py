"""Frames that somebody else sends in our name, or in the drive's: when they are named, how far the shaft is driven."""

from __future__ import annotations

import contextlib
import struct
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import Report, finish, main, parser, shown
from daemon import DRIVE, PATIENCE_S, Daemon, until

from fffo_drive.can.bpf import CanFilter
from fffo_drive.can.frame import NMT, SDO_REQUEST, SYNC, TPDO1, pack_frame, unpack_frame
from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.control.envelope import TRIP_NAMES
from fffo_drive.daemon.client import DaemonClient
from fffo_drive.drive.simulated.node.config import NodeConfig
from fffo_drive.recording.reader import read_run
from fffo_drive.workflows.simulated_process import SimulatedProcess

NAME = "foreign_frames"
NODE, MASTER = 1, 127
RATES_HZ, SAMPLE_RATES_HZ = (1, 100, 1000), (100,)
STATES = ("at rest", "following", "stopping")
SPEED_RPS, STANDSTILL_RPS = 3.0, 0.05
ATTACK_S, SETTLE_S = 1.0, 0.3
NAMED_TICKS = 2
TORQUE_PERMILLE = 300
FRAMES = {
    "SYNC": pack_frame(SYNC),
    "NMT pre-operational": pack_frame(NMT, bytes([0x80, NODE])),
    "SDO, 0x6060 = 8": pack_frame(SDO_REQUEST + NODE, struct.pack("<BHBbxxx", 0x2F, 0x6060, 0, 8)),
    "SDO, 0x1016 = 0": pack_frame(SDO_REQUEST + NODE, struct.pack("<BHBI", 0x23, 0x1016, 1, 0)),
    "heartbeat of ours": pack_frame(0x700 + MASTER, b"\x05"),
    "RPDO1, +30 % torque": pack_frame(0x200 + NODE, struct.pack("<Hh", 0x0F, TORQUE_PERMILLE)),
    "TPDO1, v = 0": pack_frame(TPDO1 + NODE, bytes(8)),
}
_UNIT = NodeConfig().ratings  # counts of 0x606C and 0x6064


class Attack(NamedTuple):
    """What came of one attack."""

    named_ticks: int  # from the first frame to the row that names it; -1: never
    stopped_ticks: int  # ... to the trip; -1: none
    fault: str
    driven_ms: float  # until the shaft stood, or turned as before
    beyond_rps: float  # largest difference from the velocity at the first frame, in the direction of the torque
    beyond_rev: float  # how far the shaft went until it stood


class Shaft:
    """Hears the drive's own feedback; sends the foreign frames on the same link, which does not hear itself."""

    def __init__(self, bus: str) -> None:
        self.link = open_link(bus, filters=[CanFilter(TPDO1 + NODE)])
        self.samples: list[tuple[int, float, float]] = []  # (monotonic ns, rps, rev)
        self._offset_ns = time.time_ns() - time.monotonic_ns()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        while not self._end.is_set():
            heard = self.link.receive_stamped(0.1)
            data = b"" if heard is None else unpack_frame(heard.raw).data
            if heard is not None and len(data) == struct.calcsize("<ii"):  # as mapped by the bring-up
                velocity, position = struct.unpack("<ii", data)
                at_ns = round(heard.time_s * 1e9) - self._offset_ns
                self.samples.append((at_ns, velocity / _UNIT.velocity_counts_per_rps, position / _UNIT.counts_per_rev))

    def send(self, raw: bytes, rate_hz: int, seconds: float) -> int:
        """Frames at a rate; at least one. Returns when the first was on the bus, CLOCK_MONOTONIC."""
        begun_ns, sent_ns = time.monotonic_ns(), 0
        for number in range(max(1, round(rate_hz * seconds))):
            wait_s = number / rate_hz - 1e-9 * (time.monotonic_ns() - begun_ns)
            if wait_s > 0.0:
                time.sleep(wait_s)
            self.link.send(raw)
            sent_ns = sent_ns or time.monotonic_ns()
        return sent_ns

    def close(self) -> None:
        """Hear no more."""
        self._end.set()
        self._thread.join()
        self.link.close()


def bring_into(client: DaemonClient, state: str) -> None:
    """From whatever the axis is in; every request names the epoch that the status before it shows."""

    def ask(method: str, **values: Any) -> None:
        client.call(method, epoch=client.call("status")["epoch"], **values)

    if client.call("status")["state"] == "fault":
        client.call("reset_fault")
    with contextlib.suppress(Exception):
        client.call("disable")
    until(client, "ready")
    client.call("record", to="on")
    if state == "at rest":
        return
    ask("enable")
    ask("velocity", to_rps=SPEED_RPS, for_s=60)
    deadline_s = time.monotonic() + PATIENCE_S
    while client.call("status")["motion"]["velocity_rps"] < 0.9 * SPEED_RPS:
        if time.monotonic() > deadline_s:
            raise RuntimeError("the axis does not turn")
        time.sleep(0.02)
    if state == "stopping":
        client.call("disable", wait_s=0)


def recorded(client: DaemonClient, directory: Path, at_ns: int) -> np.ndarray[Any, Any]:
    """The rows around a time; a connection that ended with the attack has ended its recording."""
    client.call("record", to="off")
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        for path in sorted(directory.rglob("*.mcap"), key=lambda path: path.stat().st_mtime, reverse=True):
            rows = read_run(path).rows
            if rows.size and rows["deadline_ns"][0] <= at_ns <= rows["deadline_ns"][-1] + round(ATTACK_S * 1e9):
                return rows
        time.sleep(0.1)
    raise RuntimeError("nothing was recorded")


def attack(client: DaemonClient, directory: Path, shaft: Shaft, raw: bytes, state: str, rate_hz: int) -> Attack:
    """One attack, from the axis in a state to a shaft that stands."""
    bring_into(client, state)
    shaft.samples.clear()
    begun_ns = shaft.send(raw, rate_hz, ATTACK_S)
    time.sleep(SETTLE_S)
    fault = client.call("status")["fault"]
    rows = recorded(client, directory, begun_ns)
    first = int(np.searchsorted(rows["deadline_ns"] + rows["lateness_ns"], begun_ns))  # its SYNC came after the frame

    def until_row(where: np.ndarray[Any, Any]) -> int:
        found = np.flatnonzero(where)
        return max(0, int(found[0]) - first) + 1 if found.size else -1

    tripped = rows["trip"] != 0
    name = TRIP_NAMES.get(int(rows["trip"][-1]), "none") if fault is None else fault["name"]
    samples = np.array([sample for sample in shaft.samples if sample[0] >= begun_ns])
    driven_ms = beyond_rps = beyond_rev = 0.0
    if samples.size:
        at_s, velocity, position = (samples[:, 0] - begun_ns) * 1e-9, samples[:, 1], samples[:, 2]
        moving = np.abs(velocity) > STANDSTILL_RPS
        driven_ms = 1e3 * float(at_s[moving][-1]) if moving.any() else 0.0
        beyond_rps, beyond_rev = float(velocity.max() - velocity[0]), float(position.max() - position[0])
    return Attack(until_row(rows["foreign_id"] >= 0), until_row(tripped), name, driven_ms, beyond_rps, beyond_rev)


def rows_of(rates_hz: Sequence[int] = RATES_HZ) -> list[tuple[str, str, int, Attack]]:
    """All attacks on one service: what is sent, the state of the axis, the rate, and what came of it."""
    bus = f"loopback:{free_loopback_port()}"
    cases = [(what, state, rate) for what in FRAMES for state in STATES for rate in rates_hz]
    found = []
    with (
        tempfile.TemporaryDirectory(prefix="fffo_drive_benchmark_") as name,
        SimulatedProcess(DRIVE, bus),
        Daemon(Path(name), bus) as daemon,
        daemon.client() as client,
        shown("foreign frames") as progress,
    ):
        shaft = Shaft(bus)
        try:
            for number, (what, state, rate) in enumerate(cases):
                found.append((what, state, rate, attack(client, Path(name), shaft, FRAMES[what], state, rate)))
                if progress is not None:
                    progress((number + 1) / len(cases))
        finally:
            shaft.close()
    return found


HEADER = (
    "frames of somebody else", "axis", "1/s", "named, ticks", "trip, ticks", "as", "turned for, ms", "faster by, rps",
    "went, rev",
)  # fmt: skip


def cells(what: str, state: str, rate: int, seen: Attack) -> list[str]:
    """One line of the table."""
    ticks = [str(value) if value >= 0 else "-" for value in (seen.named_ticks, seen.stopped_ticks)]
    shaft = [f"{seen.driven_ms:.0f}", f"{seen.beyond_rps:.2f}", f"{seen.beyond_rev:.2f}"]
    return [what, state, str(rate), *ticks, seen.fault, *shaft]


def run() -> int:
    """The command."""
    options = parser(NAME, __doc__ or "", 1, 1).parse_args()
    report = Report(NAME, "Frames of somebody else on the loopback bus of `serve` at 2 kHz, with the simulated drive.")
    found = rows_of(SAMPLE_RATES_HZ if options.sample else RATES_HZ)
    late = [
        f"{what}, {state}, {rate}/s" for what, state, rate, seen in found if not 0 < seen.named_ticks <= NAMED_TICKS
    ]
    text = f"{len(found) - len(late)} of {len(found)}" + (f"; not: {'; '.join(late)}" if late else "")
    report.bounded(f"named within {NAMED_TICKS} ticks of the first frame", text, not late, "all")
    report.table(HEADER, [cells(*one) for one in found])
    report.notes.append(
        "Ticks that ran, from the first whose SYNC came after the frame, that one included. The shaft by the drive's "
        "own feedback; a drive that is put into pre-operational sends none any more. It turned at 3 rps before."
    )
    report.facts["attacks"] = [[what, state, rate, seen._asdict()] for what, state, rate, seen in found]
    return finish(report, options)


if __name__ == "__main__":
    main(run)

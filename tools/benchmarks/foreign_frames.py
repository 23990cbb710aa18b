"""Frames that somebody else sends in our name, or in the drive's: when they are named, how far the shaft is driven."""

from __future__ import annotations

import contextlib
import struct
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import Section, shown
from daemon import AXIS, DRIVE, PATIENCE_S, Daemon, until
from shaft_on_bus import MOVES_RPS, SPEED_S, ShaftOnBus

from fffo_drive.can.frame import NMT, SDO_REQUEST, SYNC, TPDO1, pack_frame
from fffo_drive.can.link import free_loopback_port
from fffo_drive.control.envelope import TRIP_NAMES
from fffo_drive.daemon.client import DaemonClient
from fffo_drive.recording.reader import read_run
from fffo_drive.workflows.plan import make_plan
from fffo_drive.workflows.simulated_process import SimulatedProcess

NODE, MASTER = 1, 127
RATES_HZ, SAMPLE_RATES_HZ = (1, 100, 1000), (100,)
STATES = ("at rest", "following", "stopping")
SPEED_RPS, RATE_HZ, BEFORE_S = 3.0, 2000, 0.05
MANY = 100  # races asked for, from which on all rates are tried
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


class Attack(NamedTuple):
    """What came of one attack."""

    named_ticks: int  # from the first frame to the row that names it; -1: never
    stopped_ticks: int  # ... to the trip; -1: none
    fault: str
    driven_ms: float  # until the shaft stood, or turned as before
    beyond_rps: float  # largest difference from the velocity at the first frame, in the direction of the torque
    beyond_rev: float  # how far the shaft went until it stood


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
    time.sleep(SETTLE_S)
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


def send_for(shaft: ShaftOnBus, raw: bytes, rate_hz: int, seconds: float) -> tuple[int, int]:
    """Frames at a rate; at least one. Returns when the first was on the bus: CLOCK_MONOTONIC, CLOCK_REALTIME."""
    begun_ns, sent_ns = time.monotonic_ns(), (0, 0)
    for number in range(max(1, round(rate_hz * seconds))):
        time.sleep(max(0.0, number / rate_hz - 1e-9 * (time.monotonic_ns() - begun_ns)))
        shaft.send(raw)
        sent_ns = sent_ns if number else (time.monotonic_ns(), time.time_ns())
    return sent_ns


def attack(client: DaemonClient, directory: Path, shaft: ShaftOnBus, raw: bytes, state: str, rate_hz: int) -> Attack:
    """One attack, from the axis in a state to a shaft that stands."""
    bring_into(client, state)
    sent_ns, real_ns = send_for(shaft, raw, rate_hz, ATTACK_S)
    time.sleep(SETTLE_S)
    heard = shaft.heard_between(real_ns - round(BEFORE_S * 1e9), time.time_ns())
    fault = client.call("status")["fault"]
    rows = recorded(client, directory, sent_ns)
    first = int(np.searchsorted(rows["deadline_ns"] + rows["lateness_ns"], sent_ns))  # its SYNC came after the frame

    def until_row(where: np.ndarray[Any, Any]) -> int:
        found = np.flatnonzero(where)
        return max(0, int(found[0]) - first) + 1 if found.size else -1

    name = TRIP_NAMES.get(int(rows["trip"][-1]), "none") if fault is None else fault["name"]
    # the drive's own velocity; what somebody else sends in its name is 0, and makes no gain
    speeds_rps = np.abs(rows["velocity_rps"])
    before_rps = float(np.median(speeds_rps[max(0, first - round(BEFORE_S * RATE_HZ)) : first + 1]))
    gain_rps = max(0.0, float(speeds_rps[first:].max(initial=0.0)) - before_rps)
    named, stopped = until_row(rows["foreign_id"] >= 0), until_row(rows["trip"] != 0)
    return Attack(named, stopped, name, moved_ms(*heard, real_ns), gain_rps, went_rev(*heard, real_ns))


def moved_ms(times_ns: np.ndarray[Any, Any], positions: np.ndarray[Any, Any], begun_ns: int) -> float:
    """Until when the shaft moved, from a time on."""
    lag = round(SPEED_S * RATE_HZ)
    passed_s = 1e-9 * (times_ns[lag:] - times_ns[:-lag])
    moving_ns = times_ns[lag:][np.abs(positions[lag:] - positions[:-lag]) > MOVES_RPS * passed_s]
    return max(0.0, float(moving_ns[-1] - begun_ns) * 1e-6) if moving_ns.size else 0.0


def went_rev(times_ns: np.ndarray[Any, Any], positions: np.ndarray[Any, Any], begun_ns: int) -> float:
    """How far it went from a time on."""
    after = positions[times_ns > begun_ns]
    return float(np.ptp(after)) if after.size else 0.0


def attacks_at(rates_hz: Sequence[int]) -> list[tuple[str, str, int, Attack]]:
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
        contextlib.closing(ShaftOnBus(bus, make_plan(AXIS))) as shaft,
    ):
        for number, (what, state, rate) in enumerate(cases):
            found.append((what, state, rate, attack(client, Path(name), shaft, FRAMES[what], state, rate)))
            if progress is not None:
                progress((number + 1) / len(cases))
    return found


HEADER = (
    "frames of somebody else",
    "axis",
    "1/s",
    "named, ticks",
    "trip, ticks",
    "as",
    "turned for, ms",
    "faster by, rps",
    "went, rev",
)


def cells(what: str, state: str, rate: int, seen: Attack) -> list[str]:
    """One line of the table."""
    ticks = [str(value) if value >= 0 else "-" for value in (seen.named_ticks, seen.stopped_ticks)]
    shaft = [f"{seen.driven_ms:.0f}", f"{seen.beyond_rps:.2f}", f"{seen.beyond_rev:.2f}"]
    return [what, state, str(rate), *ticks, seen.fault, *shaft]


def foreign_frames(count: int, _: int) -> Section:
    """Each frame in each state of the axis at each rate, once; at one rate alone where few races are asked for."""
    found = attacks_at(RATES_HZ if count >= MANY else SAMPLE_RATES_HZ)
    late = sum(not 0 < seen.named_ticks <= NAMED_TICKS for *_, seen in found)
    commands = [seen for what, _, _, seen in found if not what.startswith("TPDO")]
    notes = [
        "Named: the row's `foreign_id`. Ticks that ran, from the first whose SYNC came after the first frame, that one "
        "included. Feedback that comes twice is an event; it trips above one in 100 SYNCs, which takes more than ten.",
        f"The shaft by what the drive sends: until its speed over {1e3 * SPEED_S:g} ms was last above {MOVES_RPS:g} "
        f"rps, how much faster it became than in the {1e3 * BEFORE_S:g} ms before, and how far it went. It turned at "
        f"{SPEED_RPS:g} rps. A drive that is put into pre-operational sends nothing any more.",
        "Torque that a drive keeps when it leaves operational, on the drive's own clock: `tools/tables/faults.md`.",
    ]
    return Section(
        "frames of somebody else",
        [
            ("attacks", float(len(found)), "", None),
            (f"not named within {NAMED_TICKS} ticks", float(late), "", 0.0),
            ("most ticks to the trip, commands", float(max(seen.stopped_ticks for seen in commands)), "", 2.0),
            ("largest gain of speed", max(seen.beyond_rps for *_, seen in found), "rps", None),
        ],
        HEADER,
        [cells(*one) for one in found],
        notes,
    )

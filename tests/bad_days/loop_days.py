"""The bad days of the loop, each a script for `world.World`, and what is reported. `run_all` runs interpreted."""

from __future__ import annotations

import hashlib
import struct
import time
from collections.abc import Callable

import numpy as np
from bad_days.world import NODE, NS_PER_MS, PERIOD_NS, RPDO1, SYNC, TPDO1, Day, World, live

from fffo_drive.can.frame import ERROR_BUS_OFF, ERROR_RESTARTED, NMT, Frame, pack_frame
from fffo_drive.drive.simulated.node.faults import Fault, FaultKind

US = 1_000
BEGIN, BACK, TICKS = 200, 260, 480  # by BEGIN the drive is enabled and the profile runs
ENOBUFS, ENETDOWN = 105, 100
HEARTBEAT_MS = 50  # world.SET_UP

Effect = Callable[[bytes, int], list[tuple[int, bytes]]]


def on(world: World, can_id: int, first: int, ticks: int, effect: Effect) -> None:
    """Let something happen to frames of one identifier during some ticks, in either direction."""

    def wire(frame: Frame, raw: bytes, flight_ns: int) -> list[tuple[int, bytes]]:
        if frame.can_id == can_id and first <= world.tick < first + ticks:
            return effect(raw, flight_ns)
        return [(flight_ns, raw)]

    if can_id in (RPDO1, SYNC):
        world.to_drive = wire
    else:
        world.to_host = wire


def delayed(extra_us: int) -> Effect:
    return lambda raw, flight_ns: [(flight_ns + extra_us * US, raw)]


def lost(raw: bytes, flight_ns: int) -> list[tuple[int, bytes]]:
    return []


def instead(frame: bytes) -> Effect:
    return lambda raw, flight_ns: [(flight_ns, frame)]


def quiet(world: World) -> None:
    """Nothing happens."""


def late(world: World) -> None:
    """An answer comes after the cut-off, before the next SYNC."""
    on(world, TPDO1, BEGIN, 1, delayed(300))  # beyond the cut-off, before the next SYNC


def a_period_late(world: World) -> None:
    """An answer comes after the next SYNC, in front of the next answer."""
    extra_us = {BEGIN: 600, BEGIN + 1: 110}
    on(world, TPDO1, BEGIN, 2, lambda raw, flight_ns: [(flight_ns + extra_us[world.tick] * US, raw)])


def duplicate(world: World) -> None:
    """An answer comes twice."""
    on(world, TPDO1, BEGIN, 1, lambda raw, flight_ns: [(flight_ns, raw), (flight_ns + 10 * US, raw)])


def reordered(world: World) -> None:
    """An answer comes after the next SYNC and behind the next answer, which it replaces for one tick."""
    on(world, TPDO1, BEGIN, 1, delayed(600))  # behind the answer to the next SYNC


def missing_once(world: World) -> None:
    """An answer is lost."""
    on(world, TPDO1, BEGIN, 1, lost)


def missing_for_good(world: World) -> None:
    """All answers are lost."""
    on(world, TPDO1, BEGIN, 10_000, lost)


def short(world: World) -> None:
    """An answer has seven bytes in place of eight."""
    on(world, TPDO1, BEGIN, 1, instead(pack_frame(TPDO1, bytes(7))))


def extended(world: World) -> None:
    """An answer has an extended identifier."""
    on(world, TPDO1, BEGIN, 1, instead(pack_frame(TPDO1, struct.pack("<ii", 2**30, 2**30), extended=True)))


def remote(world: World) -> None:
    """An answer is a remote frame."""
    on(world, TPDO1, BEGIN, 1, instead(pack_frame(TPDO1, bytes(8), remote=True)))


def sync_lost_once(world: World) -> None:
    """A SYNC is lost on the wire."""
    on(world, SYNC, BEGIN, 1, lost)


def sync_lost_for_good(world: World) -> None:
    """SYNC no longer reaches the drive."""
    on(world, SYNC, BEGIN, 10_000, lost)


def commands_lost(world: World) -> None:
    """Commands no longer reach the drive."""
    on(world, RPDO1, BEGIN, 10_000, lost)


def send_queue_full(world: World) -> None:
    """The kernel takes no frame for three ticks (ENOBUFS)."""
    world.at = [(BEGIN, _refuse(ENOBUFS)), (BEGIN + 3, _refuse(0))]


def interface_gone(world: World) -> None:
    """The interface is gone for 30 ms (ENETDOWN)."""
    world.at = [(BEGIN, _refuse(ENETDOWN)), (BACK, _refuse(0))]


def _refuse(error: int) -> Callable[[World], None]:
    return lambda world: setattr(world, "refusal", error)


def bus_off(world: World) -> None:
    """The CAN controller is off the bus for 30 ms."""
    world.at = [
        (BEGIN, lambda w: w.say(ERROR_BUS_OFF, error=True)),
        (BACK, lambda w: w.say(ERROR_RESTARTED, error=True)),
    ]
    world.to_host = lambda frame, raw, flight_ns: [] if BEGIN <= world.tick < BACK else [(flight_ns, raw)]


def bus_off_within_a_tick(world: World) -> None:
    """The CAN controller is off the bus and on it again between two ticks."""

    def off_and_on(w: World) -> None:
        w.say(ERROR_BUS_OFF, error=True)
        w.say(ERROR_RESTARTED, error=True)

    world.at = [(BEGIN, off_and_on)]


def foreign_sync(world: World) -> None:
    """Another master sends SYNC, once."""

    def heard_by_both(w: World) -> None:
        w.say(SYNC, b"")
        w.tell(pack_frame(SYNC))

    world.at = [(BEGIN, heard_by_both)]


def put_into(command: int, begin: int = BEGIN) -> Callable[[World], None]:
    """Somebody commands the drive's NMT state; its next heartbeat is due one millisecond later."""
    heartbeat = pack_frame(0x600 + NODE, struct.pack("<BHBHxx", 0x2B, 0x1017, 0, HEARTBEAT_MS))

    def prepare(world: World) -> None:
        world.at = [
            (begin + 2 - HEARTBEAT_MS * NS_PER_MS // PERIOD_NS, lambda w: w.tell(heartbeat)),
            (begin, lambda w: w.tell(pack_frame(NMT, bytes([command, NODE])))),
        ]

    return prepare


def pre_operational(world: World) -> None:
    """Somebody puts the drive into NMT pre-operational; its heartbeat says so a millisecond later."""
    put_into(0x80)(world)


def stopped_by_nmt(world: World) -> None:
    """Somebody puts the drive into NMT stopped; its heartbeat says so a millisecond later."""
    put_into(0x02)(world)


def stopped_shortly(world: World) -> None:
    """The process is stopped for 5 ms."""
    world.stalls = {BEGIN: 10 * PERIOD_NS + 150 * US}


def stopped_long(world: World) -> None:
    """The process is stopped for 400 ms."""
    world.stalls = {BEGIN: 400 * NS_PER_MS}


def rebooted(world: World) -> None:
    """The drive restarts."""
    world.at = [(BEGIN, lambda w: w.node.faults.inject(Fault(FaultKind.REBOOT, duration_s=0.002)))]


def clock_stepped(world: World) -> None:
    """The wall clock is stepped."""

    def read() -> int:
        raise AssertionError("the loop read the wall clock")

    time.time = time.time_ns = read  # type: ignore[assignment]


DAYS = (
    quiet, late, a_period_late, duplicate, reordered, missing_once, missing_for_good, short, extended, remote,
    sync_lost_once, sync_lost_for_good, commands_lost, send_queue_full, interface_gone, bus_off, bus_off_within_a_tick,
    foreign_sync, stopped_shortly, stopped_long, rebooted, pre_operational, stopped_by_nmt, clock_stepped,
)  # fmt: skip


def reported(day: Day) -> dict[str, object]:
    """What the tests want to know."""
    world, rows = day.world, day.rows
    ages = rows["velocity_age"].astype(int)
    held = ages[1:] > 0
    commands = [(tick, *struct.unpack("<Hh", frame.data)) for tick, frame in world.sent if frame.can_id == RPDO1]
    trip_tick = int(rows["tick"][np.argmax(rows["trip"] != 0)]) if day.trip else -1
    woke_ns = rows["deadline_ns"] + rows["lateness_ns"]
    return {
        "counts": {k: v for k, v in day.statistics.items() if isinstance(v, int) and v and k != "ticks"},
        "trip": day.trip,
        "trip_tick": trip_tick,
        "oldest": int(ages.max()),
        "held_but_changed": int(np.count_nonzero(rows["velocity_rps"][1:][held] != rows["velocity_rps"][:-1][held])),
        "torque_after_trip": sum(torque != 0 for tick, _, torque in commands if day.trip and tick >= trip_tick),
        "away": [tick for tick, _ in world.sent if BEGIN <= tick < BACK],
        "first_command": next(((word, torque) for tick, word, torque in commands if tick >= BEGIN), None),
        "first_back": next(((word, torque) for tick, word, torque in commands if tick >= BACK), None),
        "applied_back": sum(torque != 0 for tick, torque in world.torques if tick >= BACK),
        "smallest_gap": float(np.diff(woke_ns).min() / PERIOD_NS),
        "profile_shift": len(np.unique((rows["tick"].astype(int) - rows["profile_sample"])[BEGIN - 50 :])) - 1,
        "drive_state": world.node.drive.state,
        "rows": hashlib.sha256(rows.tobytes()).hexdigest(),
        "rows_without_sender": hashlib.sha256(_without_sender(rows).tobytes()).hexdigest(),
    }


def _without_sender(rows: np.ndarray) -> np.ndarray:
    """The same rows, as if nobody else had sent anything."""
    same = rows.copy()
    same["foreign_id"] = -1
    return same


def run_all() -> list[dict[str, object]]:
    """All days."""
    clocks = time.time, time.time_ns
    found = []
    for day in DAYS:
        world = World()
        day(world)
        try:
            found.append({"day": day.__name__, "happened": day.__doc__, **reported(live(world, ticks=TICKS))})
        finally:
            time.time, time.time_ns = clocks
    return found

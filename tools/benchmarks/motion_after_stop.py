"""Does anything move after a stop? Streams of set points, frozen and killed clients; the shaft is heard on the bus."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

from common import Section, shown
from daemon import AXIS, DRIVE, PATIENCE_S, until
from live import Streaming
from shaft_on_bus import ShaftError, ShaftOnBus
from start_races import LONGEST_DELAY_S, STANDSTILL_RPS, WATCHED_S, races
from stops import faults_of
from turning_clients import EPOCH, REFUSED, RPS, SENT, Shared

from fffo_drive.can.link import free_loopback_port
from fffo_drive.daemon.client import CallError, DaemonClient
from fffo_drive.daemon.places import CONTROL
from fffo_drive.daemon.set_points import longest_stop_s
from fffo_drive.daemon.states import State
from fffo_drive.workflows.plan import Plan, make_plan
from fffo_drive.workflows.simulated_process import SimulatedProcess

MANY = 8
HOLDERS_SHARE = 10  # one race with a frozen holder for so many of the others: it takes the longest
MOVING = (State.FOLLOWING, State.STOPPING)
SETTLES_S = 0.1  # from the end of the braking ramp to standstill of the shaft


class Tally(NamedTuple):
    """What came of the races of one kind."""

    attack: str
    races: int
    refused: int  # requests after a stop that were refused
    moved: int
    beyond_s: float  # the longest motion beyond lease and braking ramp
    wrong: list[str]


class Clients:
    """Clients in processes of their own, for as long as the block lasts (turning_clients.py)."""

    def __init__(self, daemon: Streaming, directory: Path) -> None:
        directory.mkdir()
        command = [sys.executable, str(Path(__file__).with_name("turning_clients.py"))]
        self._process = subprocess.Popen(
            [*command, str(daemon.sockets / CONTROL), str(directory)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __enter__(self) -> Clients:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    @contextlib.contextmanager
    def born(self, what: str) -> Iterator[Client]:
        """One that lives as long as the block."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(what, file=self._process.stdin, flush=True)
        pid, file = self._process.stdout.readline().split()
        client = Client(int(pid), Shared(Path(file)))
        try:
            yield client
        finally:
            client.signal(signal.SIGKILL)


class Client(NamedTuple):
    """A process, and what it tells."""

    pid: int
    shared: Shared

    def signal(self, number: int) -> None:
        """Freeze, continue or kill it."""
        os.kill(self.pid, number)

    def until_sent(self, count: int) -> None:
        """Wait until it has sent so many more requests. Raises ShaftError."""
        last, deadline_s = self.shared[SENT] + count, time.monotonic() + PATIENCE_S
        while self.shared[SENT] < last:
            if time.monotonic() > deadline_s:
                raise ShaftError("a client sends nothing")
            time.sleep(0.002)


# -- races -------------------------------------------------------------------------------------------------------------


class World:
    """A daemon on a simulated drive, its control socket, and the shaft on the bus."""

    def __init__(self, daemon: Streaming, client: DaemonClient, shaft: ShaftOnBus, plan: Plan) -> None:
        self.daemon, self.client, self.shaft = daemon, client, shaft
        self.draw, self.seen = random.Random(15), ""
        section = plan.axis.daemon
        self.lease_s, self.silence_s = section.set_points.jog_timeout_s, section.client_silence_s
        self.stop_s = longest_stop_s(plan, RPS) + SETTLES_S

    def enabled(self) -> None:
        """The axis can be moved, whatever it was before."""
        state = self.client.call("status")["state"]
        if state == "fault":
            state = self.client.call("reset_fault")["state"]
        elif state not in ("ready", "enabled"):
            state = self.client.call("stop", wait_s=PATIENCE_S)["state"]
        if state != "enabled":
            self.client.call("enable")

    def stop(self, number: int) -> int:
        """One of the ways to stop. Returns from when on nothing may move: its acknowledgement, or with `wait_s: 0`,
        which does not wait for standstill, SETTLES_S after the end of the braking ramp.
        """
        time.sleep(self.draw.uniform(0.0, LONGEST_DELAY_S))
        method = ("stop", "stop", "disable", "quick_stop")[number % 4]
        at_once = number % 4 == 1
        self.client.call(method, wait_s=0 if at_once else PATIENCE_S)
        if at_once:
            # on a busy machine the loop may take the stop after the answer
            while self.client.call("status")["state"] in MOVING:
                time.sleep(0.002)
            time.sleep(SETTLES_S)
        acknowledged_ns = time.time_ns()
        if method != "stop":
            self.client.call("enable")
        return acknowledged_ns

    def moved(self, since_ns: int) -> bool:
        """Whether the shaft moved in the time that it is watched from then on; `seen` says how."""
        travel_rev = self.shaft.moved_rev(since_ns, WATCHED_S)
        status = self.client.call("status")
        self.seen = f"{travel_rev:.4f} rev, then {status['state']}: {status['last_stop']}"
        return travel_rev > STANDSTILL_RPS * WATCHED_S

    def beyond_s(self, last_ns: int, limit_s: float) -> float:
        """Motion beyond this limit and the braking ramp, counted from the last sign of a client's life."""
        return max(0.0, (self.shaft.until_rests(last_ns) - last_ns) / 1e9 - limit_s - self.stop_s)

    def run(self, attack: str, count: int, race: Callable[[int], tuple[int, bool, float]]) -> Tally:
        """`race` returns what was refused, whether the axis moved, and seconds of motion beyond the bound."""
        refused = moved = done = 0
        beyond_s, wrong = 0.0, []
        with shown(attack) as progress:
            for number in range(count):
                try:
                    self.enabled()
                    found = race(number)
                except (CallError, ShaftError) as error:
                    stop = (self.client.call("status")["last_stop"] or {"text": "no stop"})["text"]
                    wrong.append(f"{attack}, race {number}: not counted: {error} ({stop})")
                    continue
                done, refused, moved = done + 1, refused + found[0], moved + found[1]
                beyond_s = max(beyond_s, found[2])
                if found[1]:
                    wrong.append(f"{attack}, race {number}: moved after the stop by {self.seen}")
                if progress is not None:
                    progress((number + 1) / count)
        return Tally(attack, done, refused, moved, beyond_s, wrong)


def of_streams(world: World, clients: Clients, count: int, several: int, named: bool) -> Tally:
    """Set points at 50 Hz go on through stops; with an epoch the clients take the new one when a race begins."""
    with clients.born(f"stream {several}") as stream:
        stream.until_sent(several)

        def race(number: int) -> tuple[int, bool, float]:
            epoch = world.client.call("status")["epoch"]
            if named:
                stream.shared[EPOCH] = epoch
            else:
                world.client.call("velocity", to_rps=RPS, run_on=True, epoch=epoch)
            world.shaft.until_turns(0.5 * RPS)
            since_ns, before = world.stop(number), stream.shared[REFUSED]
            moved = world.moved(since_ns)
            stream.until_sent(several)
            return stream.shared[REFUSED] - before, moved, 0.0

        which = "the epoch from before the stop" if named else "no epoch"
        return world.run(f"set points at 50 Hz, {several} client{'s' * (several > 1)}, {which}", count, race)


def of_frozen(world: World, clients: Clients, count: int, method: str, text: str, share: int = 1) -> Tally:
    """A client freezes, in every second race somebody stops the axis, and the client goes on; one race of `share`."""

    def race(number: int) -> tuple[int, bool, float]:
        with clients.born(method) as client:
            world.shaft.until_turns(0.9 * RPS)
            client.signal(signal.SIGSTOP)
            frozen_ns, beyond_s = time.time_ns(), 0.0
            if method != "hold" and number % 2:
                since_ns = world.stop(number // 2)
            else:
                limit_s = world.silence_s if method == "hold" else world.lease_s
                beyond_s = world.beyond_s(frozen_ns, limit_s)
                since_ns = time.time_ns()
            client.signal(signal.SIGCONT)
            moved = world.moved(since_ns)
            client.until_sent(2)
            return client.shared[REFUSED], moved, beyond_s

    return world.run(text, max(1, count // share), race)


def of_killed(world: World, clients: Clients, count: int) -> Tally:
    """A client is killed; the axis stops by itself."""

    def race(_: int) -> tuple[int, bool, float]:
        with clients.born("velocity"):
            world.shaft.until_turns(0.9 * RPS)
        return 0, False, world.beyond_s(time.time_ns(), world.lease_s)

    return world.run("velocity on a lease, its client killed", count, race)


def of_starts(world: World, _: Clients, count: int) -> Tally:
    """A start and a stop a moment later, on every way on which somebody can ask for them."""
    table, wrong = races(world.daemon, count, world.shaft)
    done, refused, moved = (sum(row[place] for row in table) for place in (2, 3, 4))
    return Tally("start against stop", done, refused, moved, 0.0, wrong)


class Raced(NamedTuple):
    """One kind of race on a world of its own."""

    tally: Tally
    faults: dict[str, int]  # by load: names and how often
    stop_s: float  # bounds of that world, for the notes
    lease_s: float
    silence_s: float


Race = Callable[[World, Clients, int], Tally]
KINDS: tuple[Race, ...] = (  # the longest first
    partial(of_frozen, method="jog", text="jog, its client frozen and continued"),
    partial(of_frozen, method="velocity", text="velocity on a lease, frozen and continued"),
    of_killed,
    *(partial(of_streams, several=several, named=named) for several in (1, MANY) for named in (False, True)),
    of_starts,
    partial(of_frozen, method="hold", text="`enable --hold`, its client frozen and continued", share=HOLDERS_SHARE),
)


def raced(race: Race, count: int) -> Raced:
    """So many races of a kind, on a service and a bus of their own."""
    bus, plan = f"loopback:{free_loopback_port()}", make_plan(AXIS)
    with contextlib.ExitStack() as held:
        directory = Path(held.enter_context(tempfile.TemporaryDirectory(prefix="fffo_drive_benchmark_")))
        held.enter_context(SimulatedProcess(DRIVE, bus))
        daemon = Streaming(directory, bus)
        held.enter_context(daemon)
        client = held.enter_context(daemon.client())
        until(client, "ready")
        shaft = held.enter_context(contextlib.closing(ShaftOnBus(bus, plan)))
        world = World(daemon, client, shaft, plan)
        clients = held.enter_context(Clients(daemon, directory / "clients"))
        tally = race(world, clients, count)
        print(f"{tally.attack}: {tally.races} races, {tally.moved} moved", file=sys.stderr)
        return Raced(tally, faults_of(daemon), world.stop_s, world.lease_s, world.silence_s)


def motion_after_stop(count: int, side_by_side: int) -> Section:
    """So many races of each kind, so many kinds at a time."""
    with ProcessPoolExecutor(side_by_side) as pool:
        done = list(pool.map(raced, KINDS, [count] * len(KINDS)))
    found, world = [one.tally for one in done], done[0]
    faults = sum((Counter(one.faults) for one in done), Counter[str]())
    notes = [
        f"Each stop by `stop`, `stop` with `wait_s: 0`, `disable` and `quick_stop` in turn, the last two with an "
        f"`enable` behind them, a random 0 to {1e3 * LONGEST_DELAY_S:g} ms after the axis turns. Moved: the position "
        f"that the drive sends on the bus changes by more than {STANDSTILL_RPS * WATCHED_S:g} rev within {WATCHED_S:g} "
        f"s of the acknowledgement; with `wait_s: 0`, not waiting, from {SETTLES_S:g} s after the braking ramp. "
        "Every second client of a stream opens a connection for each set point. A start races a stop over the control "
        "socket, `ctl`, the page and the viewers' services in turn.",
        f"Beyond the lease: from the freezing or the end of the client to the last motion of the shaft, less the lease "
        f"({world.lease_s:g} s; {world.silence_s:g} s of silence for `--hold`) and the longest braking ramp. A "
        "client that is continued first renews, then insists with new requests, of its epoch and of none.",
        f"Faults by load: {dict(faults) or 'none'}.",
        *(text for tally in found for text in tally.wrong),
    ]
    moved, beyond_s = sum(tally.moved for tally in found), max(tally.beyond_s for tally in found)
    return Section(
        "motion after a stop",
        [
            ("races", float(sum(tally.races for tally in found)), "", None),
            ("motions after an acknowledged stop", float(moved), "", 0.0),
            ("longest motion of a dead or frozen client beyond its lease", beyond_s, "s", 0.0),
        ],
        ("attack", "races", "requests refused", "moved after the stop", "longest motion beyond the lease, s"),
        [(t.attack, *map(str, (t.races, t.refused, t.moved)), f"{t.beyond_s:.3g}") for t in found],
        notes,
    )

"""Stops: from the byte to no torque, also beside hostile clients; the service's end."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from common import Report, finish, main, parser, shown
from daemon import DRIVE, PATIENCE_S, Daemon, nice_of_unit, until
from hostile_clients import COUNT, VIEWERS, described, hostile
from live import Streaming
from shaft_on_bus import FUNCTION_MASK, BusListener

from fffo_drive.can.frame import RPDO1, TPDO2, Frame
from fffo_drive.can.link import free_loopback_port
from fffo_drive.daemon.client import CallError, ClientError, DaemonClient
from fffo_drive.drive.cia402 import is_operation_enabled
from fffo_drive.live.places import VIEWERS_FILE
from fffo_drive.workflows.simulated_process import SimulatedProcess

NAME = "stops"
ENABLE_OPERATION = 0x0F
ROUNDS, SAMPLE_ROUNDS = 100, 3
BEYOND_QUIET_MS, LONGEST_END_S = 100.0, 5.0
INLINE = {"kind": "sine", "duration_s": 20, "amplitude": 2, "frequency_hz": 0.5}


class Witness(BusListener):
    """When the command to the drive stopped asking for torque, and when the drive said it was gone."""

    def __init__(self, bus: str) -> None:
        self.commanded_ns = self.confirmed_ns = self._begun_ns = 0
        super().__init__(bus, RPDO1, TPDO2)

    def hear(self, at_ns: int, frame: Frame) -> None:
        """Controlword and statusword are the first two bytes (drive/canopen/object_map)."""
        if at_ns < self._begun_ns:
            return
        word, kind = int.from_bytes(frame.data[:2], "little"), frame.can_id & FUNCTION_MASK
        if kind == RPDO1 and not self.commanded_ns and word & ENABLE_OPERATION != ENABLE_OPERATION:
            self.commanded_ns = at_ns
        elif kind == TPDO2 and not self.confirmed_ns and not is_operation_enabled(word):
            self.confirmed_ns = at_ns

    def begin(self) -> None:
        """What came before does not count."""
        self._begun_ns = time.time_ns()
        self.confirmed_ns = self.commanded_ns = 0

    def wait(self) -> None:
        """Until both were heard. Raises RuntimeError when they are not."""
        deadline_s = time.monotonic() + PATIENCE_S
        while not (self.commanded_ns and self.confirmed_ns):
            if time.monotonic() > deadline_s:
                raise RuntimeError("a stop was answered, and the bus did not show it")
            time.sleep(0.001)


def patiently(call: Callable[[], Any]) -> Any:
    """A call beside hostile clients: a connection may be refused, an answer may take its time."""
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return call()
        except (ClientError, CallError):
            if time.monotonic() > deadline_s:
                raise
            time.sleep(0.2)


def moving(client: DaemonClient) -> None:
    """The axis turns, whatever it was before."""

    def begin() -> None:
        if client.call("status")["state"] == "fault":
            client.call("reset_fault")
        client.call("enable")
        client.act("start", profile=INLINE)

    if client.call("status")["state"] != "running":
        patiently(begin)
    deadline_s = time.monotonic() + PATIENCE_S
    while abs((client.call("status")["motion"] or {"velocity_rps": 0.0})["velocity_rps"]) < 0.2:
        if time.monotonic() > deadline_s:
            raise RuntimeError("the axis does not move")
        time.sleep(0.02)


def quick_stops(daemon: Daemon, witness: Witness, rounds: int, fresh: bool) -> dict[str, list[float]]:
    """Milliseconds from the byte of a quick stop to three events, round by round."""
    found: dict[str, list[float]] = {"commanded": [], "confirmed": [], "answered": []}
    with daemon.client() as client:
        for _ in range(rounds):
            moving(client)
            witness.begin()
            with contextlib.ExitStack() as held:
                stopper = held.enter_context(daemon.client()) if fresh else client
                line = {"jsonrpc": "2.0", "id": "stop", "method": "quick_stop", "params": {"wait_s": 30}}
                sent_ns = time.time_ns()
                stopper.send_line(json.dumps(line).encode())
                while (answer := stopper.read()).get("id") != "stop":
                    pass
                answered_ns = time.time_ns()
            if "error" in answer:
                raise RuntimeError(f"a stop failed: {answer}")
            witness.wait()
            for name, then_ns in (
                ("commanded", witness.commanded_ns), ("confirmed", witness.confirmed_ns), ("answered", answered_ns),
            ):  # fmt: skip
                found[name].append((then_ns - sent_ns) / 1e6)
    return found


# -- the end of the service ----------------------------------------------------------------------------------------


def ends(directory: Path, bus: str) -> list[tuple[str, float]]:
    """Seconds from SIGTERM to the end of the process, by what the axis did."""

    def ended_s(daemon: Daemon) -> float:
        begin_s = time.monotonic()
        daemon.process.send_signal(signal.SIGTERM)
        daemon.process.wait()
        return time.monotonic() - begin_s

    def in_state(prepare: Callable[[DaemonClient], None]) -> float:
        with SimulatedProcess(DRIVE, bus), Daemon(directory, bus) as daemon, daemon.client() as client:
            until(client, "ready")
            prepare(client)
            return ended_s(daemon)

    def start(client: DaemonClient, profile: Any = INLINE) -> None:
        client.call("enable")
        client.act("start", profile=profile)

    def while_preparing(client: DaemonClient) -> None:
        client.call("enable")
        points = [[t, (t % 2) * 0.1] for t in range(500)]
        line = {
            "jsonrpc": "2.0",
            "id": 1,
            "method": "start",
            "params": {"profile": {"kind": "points", "points": points}},
        }
        client.send_line(json.dumps(line).encode())

    def stopping(client: DaemonClient) -> None:
        start(client, {"kind": "sine", "duration_s": 20, "amplitude": 10, "frequency_hz": 0.2})
        time.sleep(1.2)
        client.call("disable", wait_s=0)

    found = [
        ("ready", in_state(lambda client: None)),
        ("enabled", in_state(lambda client: client.call("enable"))),
        ("preparing", in_state(while_preparing)),
        ("running", in_state(start)),
        ("stopping", in_state(stopping)),
        ("recording, running", in_state(lambda client: (client.call("record", to="on"), start(client)))),  # type: ignore[arg-type, func-returns-value]
    ]
    with Unconnected(directory, f"loopback:{free_loopback_port()}") as daemon:
        time.sleep(1.0)
        with daemon.client() as client:
            client.call("status")  # it lives
        found.append(("connecting, no drive", ended_s(daemon)))
    with SimulatedProcess(DRIVE, bus) as node, Daemon(directory, bus) as daemon, daemon.client() as client:
        until(client, "ready")
        start(client)
        assert node._process is not None
        node._process.kill()
        time.sleep(1.0)
        found.append(("fault, drive gone", ended_s(daemon)))
    with (
        SimulatedProcess(DRIVE, bus),
        Unconnected(directory, bus, {"NUMBA_CACHE_DIR": str(directory / "cold")}) as daemon,
    ):
        time.sleep(5.0)
        found.append(("bringing up, compiling", ended_s(daemon)))
    return found


class Unconnected(Daemon):
    """A daemon that is not waited for."""

    def __init__(self, directory: Path, bus: str, environment: dict[str, str] | None = None) -> None:
        super().__init__(directory, bus)
        self._more = environment or {}

    def __enter__(self) -> Daemon:
        import subprocess

        self._log = (self._directory / "log").open("a")
        environment = {**os.environ, "STATE_DIRECTORY": str(self._directory), **self._more}
        command = ["nice", "-n", str(nice_of_unit()), *self._command]
        self.process = subprocess.Popen(command, stderr=self._log, env=environment)
        deadline_s = time.monotonic() + PATIENCE_S
        while not (self.sockets / "control.sock").exists() and time.monotonic() < deadline_s:
            time.sleep(0.02)
        return self


# -- the command ---------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def beside(variant: str, daemon: Streaming) -> Iterator[None]:
    """Hostile clients, or none."""
    if variant == "quiet":
        yield
        return
    with hostile(daemon.sockets, daemon.published(VIEWERS_FILE)):
        yield


def run() -> int:
    """The command."""
    chosen = parser(NAME, __doc__ or "", 4, 1).parse_args()
    passes = chosen.passes or chosen.default_passes[1 if chosen.sample else 0]
    rounds = SAMPLE_ROUNDS if chosen.sample else max(1, ROUNDS // (2 * passes))
    report = Report(NAME, "A stop at 2 kHz on the loopback bus, the simulated drive in a process of its own.")
    bus = f"loopback:{free_loopback_port()}"
    latency: dict[tuple[str, str], dict[str, list[float]]] = {}
    with tempfile.TemporaryDirectory(prefix="fffo_drive_benchmark_") as name:
        directory = Path(name)
        directory.chmod(0o755)
        with SimulatedProcess(DRIVE, bus), Streaming(directory, bus) as daemon:
            with daemon.client() as client:
                until(client, "ready")
            witness = Witness(bus)
            quick_stops(daemon, witness, 1, fresh=False)  # frames from before time stamps were asked for are gone then
            with shown("quick stops") as progress:
                for number in range(passes):
                    for variant in ("quiet", "hostile") if number % 2 == 0 else ("hostile", "quiet"):
                        with beside(variant, daemon):
                            for way in ("open", "new"):
                                found = quick_stops(daemon, witness, rounds, way == "new")
                                kept = latency.setdefault((variant, way), {key: [] for key in found})
                                for key, values in found.items():
                                    kept[key] += values
                    if progress is not None:
                        progress((number + 1) / passes)
            witness.close()
            faults = faults_of(daemon)
        last = [] if chosen.sample else ends(directory, bus)
    for way, words in (("open", "on an open connection"), ("new", "on a new connection")):
        quiet, busy = (np.array(latency[variant, way]["commanded"]) for variant in ("quiet", "hostile"))
        text = f"quick stop {words}: worst of {busy.size} beside {COUNT} hostile clients, over the quiet median"
        report.figure(text, float(busy.max() - np.median(quiet)), "ms", BEYOND_QUIET_MS)
    if last:
        report.figure("SIGTERM to the end of the process, slowest state", max(s for _, s in last), "s", LONGEST_END_S)
    report.table(
        ("quick stop", "to", "median ms", "95 %", "worst"),
        [
            (f"{variant}, {way} connection", what, *(f"{np.quantile(v, q):.1f}" for q in (0.5, 0.95, 1.0)))
            for (variant, way), found in latency.items() for what, v in found.items()
        ],
    )  # fmt: skip
    if last:
        report.table(("SIGTERM while", "s"), [(state, f"{seconds:.2f}") for state, seconds in last])
    report.table(("hostile clients", "socket", "what they do"), described())
    report.facts["faults"] = faults
    report.notes += [
        f"Hostile: {COUNT} clients, some on the read-only socket without any right, and {VIEWERS} viewers without the "
        "key that request stops without a pause, which are refused; all on the same cores. The daemon has the nice "
        "value of its unit.",
        "Commanded: the first frame on the bus that no longer requests Operation Enabled; confirmed: the first "
        "statusword that says so. Both by the kernel's time stamps of the frames. The axis was turning.",
        f"Faults by load: {faults or 'none'}.",
    ]
    return finish(report, chosen)


def faults_of(daemon: Daemon) -> dict[str, int]:
    """Names of the axis' faults so far, and how often."""
    with daemon.client() as client:
        events = client.call("events", limit=1000)["events"]
    return dict(Counter(event["data"]["name"] for event in events if event["kind"] == "fault"))


if __name__ == "__main__":
    main(run, RuntimeError, ClientError)

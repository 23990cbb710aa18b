"""The daemon at 2 kHz on the loopback bus: start to first tick, CPU in all, and twenty busy clients beside the loop."""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import ROOT, Figures, Report, finish, interleaved, main, paired_ratio, parser, passes_of, shown
from running_axis import Axis

from fffo_drive.can.frame import SYNC, unpack_frame
from fffo_drive.can.link import free_loopback_port, open_link
from fffo_drive.daemon.client import ClientError, DaemonClient
from fffo_drive.daemon.places import CONTROL, WATCH
from fffo_drive.recording.reader import read_run
from fffo_drive.workflows.simulated_process import SimulatedProcess

NAME = "daemon"
AXIS = ROOT / "configs" / "axis_bench.yaml"
DRIVE = ROOT / "configs" / "simulated_drive.yaml"
CLIENTS = 20
LONGEST_START_S, LARGEST_SHARE, TARGET = 2.0, 25.0, 1.3
PATIENCE_S = 180.0
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class Start(NamedTuple):
    """From the command to the first SYNC."""

    wall_s: float
    cpu_s: float


def cpu_s(pid: int) -> float:
    """CPU time of a process, all threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def loop_s(pid: int) -> tuple[float, float]:
    """CPU time of the loop's thread, the only one under SCHED_FIFO: in user space, and in the kernel."""
    user = kernel = 0.0
    for path in Path(f"/proc/{pid}/task").glob("*/stat"):
        fields = path.read_text().rpartition(")")[2].split()
        if int(fields[38]) == os.SCHED_FIFO:
            user, kernel = user + int(fields[11]) / TICKS_PER_S, kernel + int(fields[12]) / TICKS_PER_S
    return user, kernel


def nice_of_unit() -> int:
    """Nice value that the service's unit gives it, where this user may have it; 0 where not."""
    unit = (ROOT / "systemd" / "fffo-drive@.service").read_text()
    return int(re.search(r"^Nice=(-?\d+)$", unit, re.MULTILINE)[1]) if os.geteuid() == 0 else 0  # type: ignore[index]


class Daemon:
    """`fffo-drive serve` on a bus, nice as its unit has it; recordings go to a directory of its own."""

    def __init__(self, directory: Path, bus: str) -> None:
        self.sockets = directory / "sockets"
        self._command = [
            sys.executable, "-m", "fffo_drive", "serve", str(AXIS), "--bus", bus, "--sockets", str(self.sockets),
            "--uncommissioned",
        ]  # fmt: skip
        self._directory, self._bus = directory, bus

    def __enter__(self) -> Daemon:
        with open_link(self._bus) as witness:
            begin_s = time.monotonic()
            environment = {**os.environ, "STATE_DIRECTORY": str(self._directory)}
            self._log = (self._directory / "log").open("a")
            self.process = subprocess.Popen(
                ["nice", "-n", str(nice_of_unit()), *self._command], stderr=self._log, env=environment
            )
            while time.monotonic() - begin_s < PATIENCE_S:
                raw = witness.receive(1.0)
                if raw is not None and unpack_frame(raw).can_id == SYNC:
                    self.start = Start(time.monotonic() - begin_s, cpu_s(self.process.pid))
                    return self
                if self.process.poll() is not None:
                    break
        self.__exit__()
        raise RuntimeError(f"the daemon did not start: {(self._directory / 'log').read_text()}")

    def __exit__(self, *_: object) -> None:
        self.process.send_signal(signal.SIGTERM)
        self.process.wait()
        self._log.close()

    def client(self) -> DaemonClient:
        """A connection to the control socket."""
        return DaemonClient(self.sockets / CONTROL, PATIENCE_S)


def until(client: DaemonClient, state: str) -> dict[str, Any]:
    """Wait for a state."""
    deadline_s = time.monotonic() + PATIENCE_S
    while (status := client.call("status"))["state"] != state:
        if status["fault"] is not None or time.monotonic() > deadline_s:
            raise RuntimeError(f"the axis is {status['state']}, not {state}: {status['fault'] or status['obstacles']}")
        time.sleep(0.05)
    result: dict[str, Any] = status
    return result


def _hammer(sockets: str, stop: Event, counted: Any) -> None:
    """Twenty connections that ask without a pause: a process of its own."""
    line = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "status"}).encode() + b"\n"

    def one() -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock, contextlib.suppress(OSError):
            sock.connect(f"{sockets}/{WATCH}")
            file = sock.makefile("rb")
            while not stop.is_set():
                sock.sendall(line)
                file.readline()
                with counted.get_lock():
                    counted.value += 1

    threads = [threading.Thread(target=one) for _ in range(CLIENTS)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


@contextlib.contextmanager
def busy_clients(daemon: Daemon) -> Iterator[Any]:
    """Twenty of them for as long as the block lasts; yields the counter of their requests."""
    context = multiprocessing.get_context("spawn")
    stop, counted = context.Event(), context.Value("q", 0)
    process = context.Process(target=_hammer, args=(str(daemon.sockets), stop, counted))
    process.start()
    try:
        begin_s = time.monotonic()
        while counted.value < CLIENTS and time.monotonic() - begin_s < PATIENCE_S:
            time.sleep(0.05)
        yield counted
    finally:
        stop.set()
        process.join()


def measure(daemon: Daemon, client: DaemonClient, seconds: float) -> Figures:
    """Late and skipped ticks, and CPU, of so many seconds of a running axis."""
    pid = daemon.process.pid
    before, spent_s, of_loop_s, begin_s = client.call("status")["loop"], cpu_s(pid), loop_s(pid), time.monotonic()
    time.sleep(seconds)
    after = client.call("status")["loop"]
    took_s, now_s = time.monotonic() - begin_s, loop_s(pid)
    share = 100.0 * (cpu_s(pid) - spent_s) / took_s
    user, kernel = (100.0 * (now - then) / took_s for now, then in zip(now_s, of_loop_s, strict=True))
    rows = after["rows"] - before["rows"]
    late, skipped = (after[name] - before[name] for name in ("late", "skipped"))
    return {"cpu": share, "rows": rows, "late": (late + 0.5) / rows, "share": 100.0 * late / rows,
            "lost": (late + skipped + 0.5) / rows, "user": user, "kernel": kernel}  # fmt: skip


def run_passes(daemon: Daemon, axis: Axis, seconds: float, passes: int) -> tuple[dict[str, Any], float]:
    """Interleaved passes with and without clients; figures, and requests a second that were answered."""
    rates: list[float] = []

    def measured() -> Figures:
        return measure(daemon, axis.client, seconds)

    def quiet() -> Figures:
        return axis.undisturbed("quiet", measured)

    def busy() -> Figures:
        with busy_clients(daemon) as counted:
            begin, begin_s = counted.value, time.monotonic()
            figures = axis.undisturbed("busy", measured)
            rates.append((counted.value - begin) / (time.monotonic() - begin_s))
        return figures

    with shown("with and without clients") as progress:
        found = interleaved({"quiet": quiet, "busy": busy}, passes, progress)
    return found, float(np.median(rates))


def timed_passes(name: str, purpose: str, seconds: float) -> tuple[argparse.Namespace, int, float]:
    """What was asked for: options, passes, and seconds of a pass and variant."""
    options = parser(name, purpose, 10, 2)
    options.add_argument("--seconds", type=float, help=f"of a pass and variant (default {seconds:g}; 2 with --sample)")
    chosen = options.parse_args()
    return chosen, passes_of(chosen), chosen.seconds or (2.0 if chosen.sample else seconds)


def run() -> int:
    """The command."""
    chosen, passes, seconds = timed_passes(NAME, __doc__ or "", 30.0)
    report = Report(NAME, "The daemon at 2 kHz on the loopback bus, the simulated drive in a process of its own.")
    bus = f"loopback:{free_loopback_port()}"
    starts: list[Start] = []
    with tempfile.TemporaryDirectory(prefix="fffo_drive_benchmark_") as name, SimulatedProcess(DRIVE, bus):
        directory = Path(name)
        for _ in range(1 if chosen.sample else 6):  # the first one may have to compile
            with Daemon(directory, bus) as daemon:
                starts.append(daemon.start)
        with Daemon(directory, bus) as daemon, daemon.client() as client:
            until(client, "ready")
            client.call("record", to="on")
            axis = Axis(client)
            found, rate_hz = run_passes(daemon, axis, seconds, passes)
            recording = client.call("status")["recording"]
            client.call("disable")
            files = client.call("record", to="off")["files"]
            skipped = client.call("status")["loop"]["skipped"]
        _add(report, starts[1:] or starts, found)
        _add_recording(report, files, recording)
    report.facts["requests a second"] = rate_hz
    report.facts["ticks skipped by the loop"] = skipped
    report.facts["passes"] = passes
    report.notes += [
        f"{passes} passes of {seconds:g} s each, with {CLIENTS} clients that request the status without a pause and "
        f"without them; {rate_hz:.0f} requests a second were answered (read-only clients share a budget).",
        f"First tick: the first SYNC on the bus after the command, bring-up included. {len(starts)} starts.",
        "CPU: of the whole process (loop, recorder, supervisor, API) while the axis runs and is recorded. The simulated"
        " drive and the clients are other processes on the same cores.",
        "The loop's thread in the kernel: two waits and two frames a period, the calls that a program in C would make"
        " (loop_cycle).",
        "In ratios of late ticks, half a tick is added on both sides, so that none over none is one.",
        axis.note,
    ]
    return finish(report, chosen)


def _add(report: Report, starts: list[Start], found: dict[str, Any]) -> None:
    report.figure("start to first tick, warm cache (best)", min(s.wall_s for s in starts), "s", LONGEST_START_S)
    report.figure("start to first tick, warm cache (median)", float(np.median([s.wall_s for s in starts])), "s")
    report.figure("CPU time until the first tick (median)", float(np.median([s.cpu_s for s in starts])), "s")
    quiet, busy = found["quiet"], found["busy"]
    report.figure(
        "CPU of the daemon, no clients (median)", float(np.median(quiet["cpu"])), "% of a core", LARGEST_SHARE
    )
    for part, name in (("user", "in user space"), ("kernel", "in the kernel")):
        report.figure(f"of that the loop's thread {name} (median)", float(np.median(quiet[part])), "% of a core")
    report.figure(f"CPU of the daemon, {CLIENTS} busy clients (median)", float(np.median(busy["cpu"])), "% of a core")
    ratio = paired_ratio(busy["late"], quiet["late"])
    report.ratio(f"share of late ticks, {CLIENTS} busy clients over none", ratio, TARGET)
    lost = paired_ratio(busy["lost"], quiet["lost"])
    report.ratio(f"share of late and skipped ticks, {CLIENTS} busy clients over none", lost)
    report.table(
        ("variant", "late ticks", "CPU"),
        [
            (name, f"{found[name]['share'].mean():.2f} %", f"{np.median(found[name]['cpu']):.1f} %")
            for name in ("quiet", "busy")
        ],
    )


def _add_recording(report: Report, files: list[str], recording: dict[str, Any]) -> None:
    """No row is missing between the first and the last one of a file, apart from ticks that the loop skipped."""
    runs = [read_run(Path(file)) for file in files]  # more than one where the drive was lost in between
    gaps = np.concatenate([np.diff(run.rows["tick"].astype(np.int64)) for run in runs])
    report.figure("rows lost in the ring or on the disk", recording["rows_lost"] + recording["rows_dropped"], "", 0.0)
    report.facts["complete"] = all(run.complete for run in runs)
    report.facts["recorded"] = sum(len(run.rows) for run in runs)
    report.facts["ticks absent from the file"] = int((gaps - 1).sum())
    report.facts["disordered"] = int((gaps <= 0).sum())


if __name__ == "__main__":
    main(run, RuntimeError, ClientError)

"""Memory of the daemon over an hour of reconnects, faults, clients, live changes and new recording files."""

from __future__ import annotations

import contextlib
import random
import socket
import tempfile
import time
from pathlib import Path

import numpy as np
import yaml
from common import Report, finish, main, parser, shown
from daemon import AXIS, DRIVE, Daemon, until
from hostile import resident_mb

from fffo_drive.can.link import free_loopback_port
from fffo_drive.daemon.client import CallError, ClientError, DaemonClient
from fffo_drive.daemon.places import WATCH
from fffo_drive.workflows.simulated_process import SimulatedProcess

NAME = "memory"
HOUR_S, SAMPLE_S = 3600.0, 30.0
SETTLED = 0.25  # share of the time after which the slope is taken: first reconnects, caches and arenas
LARGEST_SLOPE_MB_PER_H = 5.0
LOOK_S = 1.0
KEY = "controller.proportional_a_per_rps"


class Rotating(Daemon):
    """A daemon on an axis whose recordings begin a new file every ten seconds, and keep few."""

    def __init__(self, directory: Path, bus: str) -> None:
        super().__init__(directory, bus)
        axis = yaml.safe_load(AXIS.read_text())
        axis["model"] = str(AXIS.parent / axis["model"])
        axis.setdefault("recording", {}).update(rotate_s=10, rotate_bytes=20_000_000, quota_bytes=50_000_000)
        file = directory / "axis.yaml"
        file.write_text(yaml.safe_dump(axis, sort_keys=False))
        self._command[self._command.index(str(AXIS))] = str(file)


def one_thing(daemon: Daemon, client: DaemonClient, draw: random.Random) -> str:
    """One of the things that happen to a service."""
    what = draw.choice(["connections", "run", "set", "fault", "recording", "subscribe"])
    if what == "connections":
        for _ in range(10):
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock, contextlib.suppress(OSError):
                sock.connect(str(daemon.sockets / WATCH))
                sock.sendall(b'{"jsonrpc": "2.0", "id": 1, "method": "status"}\n')
    elif what == "run":
        client.call("enable")
        client.act("start", profile={"kind": "sine", "duration_s": 2, "amplitude": 1, "frequency_hz": 1})
    elif what == "set":
        client.call("set", key=KEY, value=round(draw.uniform(0.8, 1.0), 3))
    elif what == "fault":
        client.call("quick_stop")
        with contextlib.suppress(CallError):
            client.call("reset_fault")
    elif what == "recording":
        client.call("record", to="off")
        client.call("record", to="on")
    else:
        with daemon.client() as other:
            other.call("subscribe", status_hz=20)
            other.next_notification(5.0)
    return what


def run() -> int:
    """The command."""
    options = parser(NAME, __doc__ or "", 1, 1)
    options.add_argument("--seconds", type=float, help=f"(default {HOUR_S:g}; {SAMPLE_S:g} with --sample)")
    chosen = options.parse_args()
    seconds = chosen.seconds or (SAMPLE_S if chosen.sample else HOUR_S)
    report = Report(NAME, "The daemon at 2 kHz on the loopback bus; the simulated drive is ended and started again.")
    bus, draw = f"loopback:{free_loopback_port()}", random.Random(4)
    found: list[tuple[float, float]] = []
    done: dict[str, int] = {}
    with tempfile.TemporaryDirectory(prefix="fffo_drive_benchmark_") as name, contextlib.ExitStack() as held:
        drive = held.enter_context(SimulatedProcess(DRIVE, bus))
        daemon = held.enter_context(Rotating(Path(name), bus))
        client = held.enter_context(daemon.client())
        until(client, "ready")
        client.call("record", to="on")
        begin_s = time.monotonic()
        next_loss_s = begin_s + 60.0
        with shown("an hour of a service's life") as progress:
            while (now_s := time.monotonic()) - begin_s < seconds:
                with contextlib.suppress(CallError):
                    what = one_thing(daemon, client, draw)
                    done[what] = done.get(what, 0) + 1
                if now_s > next_loss_s:  # the drive is gone for a moment: a reconnect
                    next_loss_s = now_s + 60.0
                    drive.__exit__(None, None, None)
                    time.sleep(1.0)
                    drive.__enter__()
                    with contextlib.suppress(CallError):
                        client.call("reset_fault", wait_s=30)
                    done["drive gone and back"] = done.get("drive gone and back", 0) + 1
                found.append((now_s - begin_s, resident_mb(daemon.process.pid)))
                time.sleep(LOOK_S)
                if progress is not None:
                    progress(min(1.0, (now_s - begin_s) / seconds))
        status = client.call("status")
        descriptors = len(list(Path(f"/proc/{daemon.process.pid}/fd").iterdir()))
        threads = len(list(Path(f"/proc/{daemon.process.pid}/task").iterdir()))
    times_s, mb = np.array(found).T
    late = times_s > SETTLED * times_s[-1]
    slope = float(np.polyfit(times_s[late] / 3600.0, mb[late], 1)[0])
    report.figure("slope of the resident memory after the first quarter", slope, "MB an hour", LARGEST_SLOPE_MB_PER_H)
    report.figure("memory at the beginning", float(mb[0]), "MB")
    report.table(
        ("share of the time", "memory"),
        [(f"{100 * q:.0f} %", f"{mb[min(mb.size - 1, int(q * mb.size))]:.1f} MB") for q in (0.0, 0.25, 0.5, 0.75, 1.0)],
    )
    report.figure("open files at the end", descriptors, "")
    report.figure("threads at the end", threads, "")
    report.table(("what happened", "times"), [(what, str(count)) for what, count in sorted(done.items())])
    report.notes.append(f"{seconds:g} s. Connection {status['loop'] and status['loop']['connection']} at the end.")
    return finish(report, chosen)


if __name__ == "__main__":
    main(run, RuntimeError, ClientError)

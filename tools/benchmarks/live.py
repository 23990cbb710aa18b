"""The live stream at 2 kHz: CPU with three clients, late ticks with and without them, pictures in a browser."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import numpy as np
from common import Figures, Report, finish, interleaved, main, paired_ratio, shown
from daemon import DRIVE, PATIENCE_S, TICKS_PER_S, Daemon, measure, timed_passes, until
from running_axis import Axis

from fffo_drive.can.link import free_loopback_port
from fffo_drive.daemon.client import ClientError, DaemonClient
from fffo_drive.live.places import TOKEN_FILE, URL_FILE, VIEWERS_FILE
from fffo_drive.live.server import THREAD_NAME
from fffo_drive.workflows.simulated_process import SimulatedProcess

NAME = "live"
LARGEST_SHARE, SLOWEST_MS, TARGET = 10.0, 1000.0 / 30.0, 1.3  # 30 pictures a second are smooth
PAGES, VIEWERS = 2, 1


class Streaming(Daemon):
    """A daemon that serves the scope and the viewers' WebSocket on free ports."""

    def __init__(self, directory: Path, bus: str) -> None:
        super().__init__(directory, bus)
        self._command += ["--scope", "0", "--foxglove", "0"]

    def published(self, name: str) -> str:
        """What it left beside its sockets."""
        deadline_s = time.monotonic() + PATIENCE_S
        while not (path := self.sockets / name).exists():
            if time.monotonic() > deadline_s:
                raise RuntimeError(f"the daemon serves no {name}")
            time.sleep(0.05)
        return path.read_text().strip()

    def stream_cpu_s(self) -> float:
        """CPU time of the thread that does nothing but stream."""
        spent = 0
        for task in Path(f"/proc/{self.process.pid}/task").iterdir():
            with contextlib.suppress(OSError):  # it has just ended
                if (task / "comm").read_text().startswith(THREAD_NAME):
                    fields = (task / "stat").read_text().rpartition(")")[2].split()
                    spent += int(fields[11]) + int(fields[12])
        return spent / TICKS_PER_S


def _look(url: str, viewers_url: str, counts: tuple[int, int], stop: Event, seen: Any) -> None:
    """Pages and viewers that read all that is sent: a process of its own."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import ClientConnection, connect

    def read(socket: ClientConnection) -> None:
        with contextlib.suppress(ConnectionClosed):
            while not stop.is_set():
                with contextlib.suppress(TimeoutError):
                    message = socket.recv(timeout=0.5)
                    with seen.get_lock():
                        seen.value += isinstance(message, bytes)

    def view(socket: ClientConnection) -> None:
        for _ in range(2):  # server info, channels
            content = json.loads(socket.recv(timeout=PATIENCE_S))
            if content["op"] == "advertise":
                wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in content["channels"]]
                socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        read(socket)

    options: dict[str, Any] = {"compression": None, "max_size": None}
    page_url, origin = f"{url.replace('http', 'ws')}live", url.rstrip("/")
    with contextlib.ExitStack() as held:
        connections = [
            (read, held.enter_context(connect(page_url, origin=origin, **options))) for _ in range(counts[0])
        ]
        for _ in range(counts[1]):
            viewer = connect(viewers_url, subprotocols=["foxglove.sdk.v1"], **options)
            connections.append((view, held.enter_context(viewer)))
        threads = [threading.Thread(target=target, args=(socket,)) for target, socket in connections]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


@contextlib.contextmanager
def clients(daemon: Streaming, pages: int, viewers: int) -> Iterator[Any]:
    """So many for as long as the block lasts; yields the counter of the frames that they got."""
    context = multiprocessing.get_context("spawn")
    stop, seen = context.Event(), context.Value("q", 0)
    arguments = (daemon.published(URL_FILE), daemon.published(VIEWERS_FILE), (pages, viewers), stop, seen)
    process = context.Process(target=_look, args=arguments)
    process.start()
    try:
        begin_s = time.monotonic()
        while seen.value < 10 * (pages + viewers) and time.monotonic() - begin_s < PATIENCE_S:
            time.sleep(0.05)
        yield seen
    finally:
        stop.set()
        process.join()


def run_passes(daemon: Streaming, axis: Axis, seconds: float, passes: int) -> tuple[dict[str, Any], list[float]]:
    """Interleaved passes with and without clients; figures, and frames a second that the clients got."""
    rates: list[float] = []

    def measured() -> Figures:
        begin_s, spent_s = time.monotonic(), daemon.stream_cpu_s()
        figures = measure(daemon, axis.client, seconds)
        return {**figures, "stream": 100.0 * (daemon.stream_cpu_s() - spent_s) / (time.monotonic() - begin_s)}

    def quiet() -> Figures:
        return axis.undisturbed("quiet", measured)

    def looked_at() -> Figures:
        with clients(daemon, PAGES, VIEWERS) as seen:
            begin, begin_s = seen.value, time.monotonic()
            figures = axis.undisturbed("clients", measured)
            rates.append((seen.value - begin) / (time.monotonic() - begin_s))
        return figures

    with shown("with and without clients") as progress:
        return interleaved({"quiet": quiet, "clients": looked_at}, passes, progress), rates


def pictures_hz(daemon: Streaming, axis: Axis, seconds: float) -> float | None:
    """What a browser draws beside two other clients; None without one."""
    import headless

    if headless.program() is None:
        return None
    with clients(daemon, PAGES - 1, VIEWERS), headless.chromium() as browser:
        page = browser.new_page(viewport={"width": 1366, "height": 768})
        page.goto(f"{daemon.published(URL_FILE)}#{daemon.published(TOKEN_FILE)}")
        axis.keep_running("browser")
        time.sleep(10.0 if seconds > 5.0 else 2.0)  # a window full of curves
        now = "[fffoScope.pictures, performance.now() / 1000]"
        begin, begin_s = page.evaluate(now)
        time.sleep(seconds)
        end, end_s = page.evaluate(now)
        axis.keep_running("browser")
    return float((end - begin) / (end_s - begin_s))


@contextlib.contextmanager
def recorded_axis() -> Iterator[tuple[Streaming, DaemonClient, str]]:
    """A daemon that streams, ready and recording, on a simulated drive; its client, and the bus."""
    bus = f"loopback:{free_loopback_port()}"
    with (
        tempfile.TemporaryDirectory(prefix="fffo_drive_live_") as name,
        SimulatedProcess(DRIVE, bus),
        Streaming(Path(name), bus) as daemon,
        daemon.client() as client,
    ):
        until(client, "ready")
        client.call("record", to="on")
        yield daemon, client, bus


def run() -> int:
    """The command."""
    chosen, passes, seconds = timed_passes(NAME, __doc__ or "", 20.0)
    report = Report(NAME, "The scope and the viewers' WebSocket beside a loop at 2 kHz that is recorded.")
    load = os.getloadavg()[0]
    with recorded_axis() as (daemon, client, _):
        axis = Axis(client)
        axis.keep_running("quiet")
        found, rates = run_passes(daemon, axis, seconds, passes)
        drawn_hz = pictures_hz(daemon, axis, seconds)
        recording = client.call("status")["recording"]
    _add(report, found, drawn_hz)
    report.figure("rows lost by the recorder", recording["rows_lost"] + recording["rows_dropped"], "", 0.0)
    report.facts |= {"frames a second": float(np.median(rates)), "faults": axis.faults, "passes": passes}
    report.notes += [
        f"{passes} passes of {seconds:g} s each, with {PAGES} pages and {VIEWERS} viewer that read everything and "
        f"without them; they got {np.median(rates):.0f} binary frames a second in all. Initial load: {load:.1f}.",
        "CPU of the stream: the live server's thread in the daemon's process.",
        "The browser (headless Chromium, drawing in software), the clients and the simulated drive are other processes"
        " on the same cores; the browser runs after the passes, beside two of the clients.",
        "In ratios of late ticks, half a tick is added on both sides, so that none over none is one.",
        axis.note,
    ]
    return finish(report, chosen)


def _add(report: Report, found: dict[str, Any], drawn_hz: float | None) -> None:
    quiet, looked = found["quiet"], found["clients"]
    three = f"{PAGES + VIEWERS} clients"
    report.figure(
        f"CPU of the stream, {three} (median)", float(np.median(looked["stream"])), "% of a core", LARGEST_SHARE
    )
    report.figure("CPU of the stream, no client (median)", float(np.median(quiet["stream"])), "% of a core")
    report.figure(
        f"CPU of the daemon, {three} less none (median)", float(np.median(looked["cpu"] - quiet["cpu"])), "% of a core"
    )
    report.ratio(f"share of late ticks, {three} over none", paired_ratio(looked["late"], quiet["late"]), TARGET)
    report.ratio(f"share of late and skipped ticks, {three} over none", paired_ratio(looked["lost"], quiet["lost"]))
    if drawn_hz is None:
        report.notes.append("No Chromium on this machine: pictures were not counted.")
    else:
        report.figure("time between two pictures in the browser (mean)", 1000.0 / drawn_hz, "ms", SLOWEST_MS)
        report.figure("pictures a second in the browser", drawn_hz, "")
    report.table(
        ("variant", "late ticks", "CPU of the daemon"),
        [(n, f"{found[n]['share'].mean():.2f} %", f"{np.median(found[n]['cpu']):.1f} %") for n in ("quiet", "clients")],
    )


if __name__ == "__main__":
    main(run, RuntimeError, ClientError)

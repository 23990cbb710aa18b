"""Hostile clients beside a running axis at 2 kHz: faults, late ticks, CPU, memory and displaced events."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from common import Figures, Report, finish, interleaved, main, paired_ratio, shown
from daemon import DRIVE, measure, timed_passes, until
from hostile_clients import COUNT, VIEWERS, described, hostile
from live import Streaming
from running_axis import Axis

from fffo_drive.can.link import free_loopback_port
from fffo_drive.daemon.client import ClientError
from fffo_drive.live.places import VIEWERS_FILE
from fffo_drive.workflows.simulated_process import SimulatedProcess

NAME = "hostile"
TARGET = 1.3
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


def resident_mb(pid: int) -> float:
    """Memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE_BYTES / 1e6


def run_passes(daemon: Streaming, axis: Axis, seconds: float, passes: int) -> tuple[dict[str, Any], list[float]]:
    """Interleaved passes with and without; figures, and what the hostile clients did a second."""
    rates: list[float] = []

    def measured(length_s: float = seconds) -> Figures:
        return {**measure(daemon, axis.client, length_s), "mb": resident_mb(daemon.process.pid)}

    def quiet() -> Figures:
        return axis.undisturbed("quiet", lambda: measured(0.5 * seconds))

    def attacked() -> Figures:
        with hostile(daemon.sockets, daemon.published(VIEWERS_FILE)) as counters:
            begin = sum(counter.value for counter in counters)
            figures = axis.undisturbed("hostile", measured)
            rates.append((sum(counter.value for counter in counters) - begin) / seconds)
        return figures

    with shown("with and without hostile clients") as progress:
        return interleaved({"quiet": quiet, "hostile": attacked}, passes, progress), rates


def run() -> int:
    """The command."""
    chosen, passes, seconds = timed_passes(NAME, __doc__ or "", 60.0)
    report = Report(NAME, "The daemon at 2 kHz on the loopback bus beside clients that mean harm; one machine for all.")
    bus = f"loopback:{free_loopback_port()}"
    with tempfile.TemporaryDirectory(prefix="fffo_drive_benchmark_") as name:
        directory = Path(name)
        directory.chmod(0o755)
        with SimulatedProcess(DRIVE, bus), Streaming(directory, bus) as daemon, daemon.client() as client:
            until(client, "ready")
            client.call("record", to="on")
            axis = Axis(client)
            found, rates = run_passes(daemon, axis, seconds, passes)
            events = client.call("events", limit=1000)["events"]
            status = client.call("status")
            with contextlib.suppress(Exception):
                client.call("disable")
            journal = (directory / "log").stat().st_size
    quiet, busy = found["quiet"], found["hostile"]
    names = [name for phase in axis.faults.values() for name in phase]
    report.figure("faults `abandoned`", names.count("abandoned"), "", 0.0)
    report.figure("other faults of the axis, quiet", len(axis.faults["quiet"]), "")
    report.figure("other faults of the axis, hostile", len(axis.faults["hostile"]), "")
    report.ratio("share of late ticks, hostile clients over none", paired_ratio(busy["late"], quiet["late"]), TARGET)
    report.ratio("share of late and skipped ticks, hostile over none", paired_ratio(busy["lost"], quiet["lost"]))
    report.figure("CPU of the daemon, none (median)", float(np.median(quiet["cpu"])), "% of a core")
    report.figure("CPU of the daemon, hostile clients (median)", float(np.median(busy["cpu"])), "% of a core")
    report.figure("memory of the daemon, first pass to last", float(found["quiet"]["mb"][-1] - quiet["mb"][0]), "MB")
    report.figure("rows lost in the ring or on the disk", _lost(status), "", 0.0)
    report.figure("what the hostile clients did a second (median)", float(np.median(rates)), "")
    first = next((event for event in events if event["kind"] == "started"), None)
    report.figure("earlier events that were displaced", float(first is None), "", 0.0)
    report.figure("journal", journal / 1e3, "kB")
    report.table(
        ("variant", "late ticks", "CPU", "memory"),
        [
            (name, f"{found[name]['share'].mean():.2f} %", f"{np.median(found[name]['cpu']):.1f} %",
             f"{found[name]['mb'].max():.0f} MB")
            for name in ("quiet", "hostile")
        ],
    )  # fmt: skip
    report.table(("hostile clients", "socket", "what they do"), described())
    report.notes += [
        f"{passes} passes of {seconds:g} s with {COUNT} hostile clients and {VIEWERS} viewers without the key, and of "
        "half that time without them; they use the same cores as the daemon and the simulated drive.",
        axis.note,
    ]
    return finish(report, chosen)


def _lost(status: dict[str, Any]) -> int:
    recording = status["recording"]
    return int(recording.get("rows_lost", 0) + recording.get("rows_dropped", 0))


if __name__ == "__main__":
    main(run, RuntimeError, ClientError)

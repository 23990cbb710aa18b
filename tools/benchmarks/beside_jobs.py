"""Late ticks of a daemon's loop at 2 kHz beside a low-priority `diagnose` job of the workbench, and without a job."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from common import ROOT, Figures, Report, finish, interleaved, main, paired_ratio, shown
from daemon import DRIVE, Daemon, measure, timed_passes, until
from running_axis import Axis

from fffo_drive.can.link import free_loopback_port
from fffo_drive.daemon.client import ClientError
from fffo_drive.workbench.jobs import Job, Jobs
from fffo_drive.workflows.simulated_process import SimulatedProcess

NAME = "beside_jobs"
RECORDED = ROOT / "configs" / "axis_undeclared.yaml"  # what the job works on
PROFILES = ("identify", "recipe")
IMPORTS_S = 4.0  # until a job computes
TARGET = 1.3
QUIET, GIVES_WAY, AS_USUAL = "no job", "diagnose, gives way", "diagnose, ordinary priority"


def recordings(directory: Path) -> list[str]:
    """Runs in process, as the workbench records them."""
    files = []
    for profile in PROFILES:
        out = directory / f"{profile}.mcap"
        chosen = ["--profile", str(ROOT / "configs" / "profiles" / f"{profile}.yaml")]
        command = [sys.executable, "-m", "fffo_drive", "run", str(RECORDED), *chosen, "--out", str(out)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        files.append(str(out))
    return files


def _set(ended: threading.Event, _: Job) -> None:
    ended.set()


@contextlib.contextmanager
def job(directory: Path, files: list[str], gives_way: bool) -> Iterator[None]:
    """A diagnosis that is begun again when it ends, for as long as the block lasts."""
    jobs, stop = Jobs(), threading.Event()

    def work() -> None:
        while not stop.is_set():
            ended = threading.Event()
            words = ["diagnose", "--out", str(directory / f"out_{time.monotonic_ns()}"), "--fit", *files]
            jobs.start("diagnose", "diagnose", words, None, partial(_set, ended), gives_way)
            ended.wait()

    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    time.sleep(IMPORTS_S)
    try:
        yield
    finally:
        stop.set()
        jobs.close()
        worker.join()


def run() -> int:
    """The command."""
    chosen, passes, seconds = timed_passes(NAME, __doc__ or "", 10.0)
    report = Report(NAME, "A loop at 2 kHz in the daemon, the simulated drive beside it, and a diagnosis as a job.")
    bus = f"loopback:{free_loopback_port()}"
    with tempfile.TemporaryDirectory(prefix="fffo_drive_benchmark_") as name, SimulatedProcess(DRIVE, bus):
        directory = Path(name)
        files = recordings(directory)
        with Daemon(directory, bus) as daemon, daemon.client() as client:
            until(client, "ready")
            axis = Axis(client)

            def quiet() -> Figures:
                return axis.undisturbed(QUIET, lambda: measure(daemon, client, seconds))

            def beside(kind: str) -> Figures:
                with job(directory, files, kind == GIVES_WAY):
                    return axis.undisturbed(kind, lambda: measure(daemon, client, seconds))

            variants = {QUIET: quiet} | {kind: (lambda k=kind: beside(k)) for kind in (GIVES_WAY, AS_USUAL)}
            with shown("with and without a job") as progress:
                found = interleaved(variants, passes, progress)
            realtime = client.call("info")["realtime"]
    for figure, text in (("late", "share of late ticks"), ("lost", "share of late and skipped ticks")):
        for kind in (GIVES_WAY, AS_USUAL):
            ratio = paired_ratio(found[kind][figure], found[QUIET][figure])
            report.ratio(f"{text}, {kind} over no job", ratio, TARGET if kind == GIVES_WAY else None)
        ratio = paired_ratio(found[GIVES_WAY][figure], found[AS_USUAL][figure])
        report.ratio(f"{text}, gives way over ordinary priority", ratio)
    rows = [(kind, f"{found[kind]['share'].mean():.2f} %", f"{np.median(found[kind]['cpu']):.1f} %") for kind in found]
    report.table(("variant", "late ticks, mean", "CPU of the daemon, median"), rows)
    report.notes += [
        f"{passes} passes of {seconds:g} s per variant, in rotating order; a job that ends is started again.",
        "The simulated drive is a separate process on the same cores, and other programs run on this machine: late"
        " answers of the drive count too.",
        f"The loop's own thread: {', '.join(realtime['refusals']) or 'FIFO, pinned, memory locked'}.",
        "In ratios of late ticks, half a tick is added on both sides, so that none over none is one.",
        axis.note,
    ]
    return finish(report, chosen)


if __name__ == "__main__":
    main(run, RuntimeError, ClientError)

"""One simulated node on a loopback bus at 2 kHz: CPU time of its process, and missing or late answers."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from common import ROOT, Report, finish, main, parser, shown

from fffo_drive.can.link import free_loopback_port
from fffo_drive.config.commissioning import permission
from fffo_drive.control.reference import Profile
from fffo_drive.evaluation.metrics import TickStatistics, tick_statistics
from fffo_drive.runtime.runs import record_live
from fffo_drive.runtime.session import Session
from fffo_drive.units import NS_PER_S
from fffo_drive.workflows.plan import Plan, connect, make_plan, open_drive, plan_session, run_header
from fffo_drive.workflows.recordings import recorded_rows

NAME = "node"
AXIS = ROOT / "configs" / "axis_canopen.yaml"
DRIVE = ROOT / "configs" / "simulated_drive.yaml"
TARGET_SHARE = 1.0 / 3.0  # of a core
DURATION_S, SAMPLE_S = 60.0, 3.0
MARGIN_S = 0.5  # at both ends of the run: enabling and disabling are not measured
SAMPLE_EVERY_S = 0.1
READY_TIMEOUT_S = 180.0
END_TIMEOUT_S = 60.0
PATIENCE_TICKS = 1000


class Sample(NamedTuple):
    """CPU time of the node's process at a time."""

    time_ns: int
    cpu_ns: int


class Run(NamedTuple):
    """Results of a run."""

    share: float  # of a core
    cpu_us_per_sync: float
    ticks: TickStatistics
    node_line: str  # what the node says of itself


def cpu_ns(pid: int) -> int:
    """Time on a CPU of all threads of a process (ns), as the scheduler counts it."""
    total = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        total += int((task / "schedstat").read_text().split()[0])
    return total


@contextmanager
def node_process(bus: str) -> Iterator[subprocess.Popen[str]]:
    """`fffo-drive sim`, ready; its last line is left on its stdout."""
    words = [sys.executable, "-m", "fffo_drive", "sim", str(DRIVE), "--bus", bus]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    killer = threading.Timer(READY_TIMEOUT_S, process.kill)
    killer.start()
    try:
        assert process.stdout is not None
        if not any("ready" in line for line in iter(process.stdout.readline, "")):
            raise RuntimeError("the simulated drive was not ready")
        killer.cancel()
        yield process
    finally:
        killer.cancel()
        if process.poll() is None:
            process.terminate()
            process.wait(END_TIMEOUT_S)


@contextmanager
def sampled(pid: int, samples: list[Sample]) -> Iterator[None]:
    """Samples of the process's CPU time while the block lasts."""
    stop = threading.Event()

    def sample() -> None:
        while not stop.wait(SAMPLE_EVERY_S):
            samples.append(Sample(time.monotonic_ns(), cpu_ns(pid)))

    thread = threading.Thread(target=sample, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def patient(plan: Plan, duration_s: float) -> Plan:
    """The plan with the beginning of its profile, and with limits that let a stalled machine go on: it is counted."""
    drive = plan.axis.drive.model_copy(update={"command_timeout_ms": 2000, "heartbeat_timeout_ms": 5000})
    envelope = plan.axis.envelope.model_copy(
        update={"feedback_missing_ticks": PATIENCE_TICKS, "status_missing_ticks": PATIENCE_TICKS}
    )
    axis = plan.axis.model_copy(update={"drive": drive, "envelope": envelope})
    profile: Profile = plan.profile
    count = min(profile.values.size, round(duration_s / profile.period_s))
    return plan._replace(
        axis=axis, profile=profile._replace(values=profile.values[:count], derivatives=profile.derivatives[:count])
    )


def run_once(duration_s: float, directory: Path) -> Run:
    """One closed-loop run of the controller against the node, both as processes of this machine."""
    bus = f"loopback:{free_loopback_port()}"
    plan = patient(make_plan(AXIS), duration_s)
    given = permission(plan.path, plan.axis, plan.model, uncommissioned=True)
    samples: list[Sample] = []
    with node_process(bus) as process:
        drive = open_drive(plan, bus)
        identity = connect(drive, given)
        header = run_header(plan, identity, plan.toggle, given)
        with (
            Session(drive, plan_session(plan)) as session,
            sampled(process.pid, samples),
            shown(NAME) as progress,
        ):
            session.start()
            outcome = record_live(session, plan.profile, plan.toggle, directory / "run.mcap", header, progress=progress)
        process.terminate()
        rest, _ = process.communicate(timeout=END_TIMEOUT_S)
    if outcome.fault_text is not None:
        raise RuntimeError(f"the run ended with a fault: {outcome.fault_text}")
    rows = recorded_rows(outcome.files)
    first_ns = int(rows["deadline_ns"][0]) + round(MARGIN_S * NS_PER_S)
    last_ns = first_ns + round((plan.profile.duration_s - 2.0 * MARGIN_S) * NS_PER_S)
    times, cpu = (np.array([getattr(sample, name) for sample in samples], float) for name in Sample._fields)
    spent_ns = float(np.diff(np.interp([first_ns, last_ns], times, cpu))[0])
    measured = rows[(rows["deadline_ns"] >= first_ns) & (rows["deadline_ns"] < last_ns)]
    return Run(
        share=spent_ns / (last_ns - first_ns),
        cpu_us_per_sync=spent_ns / 1e3 / max(1, measured.size),
        ticks=tick_statistics(rows, outcome.exchange),
        node_line=re.sub(r"^simulated drive: node \d+ on \S+: ", "", rest.strip()),
    )


def run() -> int:
    """The command."""
    options = parser(NAME, __doc__ or "", 1, 1)
    options.add_argument(
        "--duration", type=float, help=f"seconds of a run (default {DURATION_S:g}; {SAMPLE_S:g} with --sample)"
    )
    chosen = options.parse_args()
    duration_s = chosen.duration or (SAMPLE_S if chosen.sample else DURATION_S)
    before = os.getloadavg()[0]
    report = Report(
        NAME, "One simulated drive as a process on a loopback bus, in closed loop with the controller at 2 kHz."
    )
    with tempfile.TemporaryDirectory() as directory:
        found = run_once(duration_s, Path(directory))
    ticks = found.ticks
    report.figure("CPU time of the node, share of a core", found.share, "", TARGET_SHARE)
    report.figure("CPU time of the node for a SYNC", found.cpu_us_per_sync, "us")
    report.figure("SYNCs sent", ticks.ticks, "", digits=6)
    report.figure("answers missing at the cut-off", ticks.missing_feedback, "", digits=6)
    report.figure("answers after the cut-off or after the next SYNC", ticks.late_feedback, "", digits=6)
    report.figure("frames lost by the controller's receive queue", ticks.dropped_frames, "", digits=6)
    report.figure("deadlines that the controller itself missed", ticks.skipped, "", digits=6)
    report.figure("median time from SYNC to the answer", ticks.turnaround_us_p50, "us")
    report.facts["node"] = found.node_line
    report.notes += [
        f"{duration_s:g} s of {AXIS.name} against {DRIVE.name}: five frictional surfaces, sub-steps at 22 kHz.",
        "CPU time is what the scheduler counts for all threads of the node's process (schedstat), without the first "
        f"and last {MARGIN_S:g} s. Beside busy processes it is higher, because caches are cold at each wake-up; "
        "missing and late answers include stalls of the machine.",
        f"Report of the node: {found.node_line}.",
        f"Initial load of the machine: {before:.1f}.",
    ]
    return finish(report, chosen)


if __name__ == "__main__":
    main(run)

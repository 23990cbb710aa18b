"""Lateness of the loop at 2 kHz with busy Python threads beside it, without them, and of a bare C timer loop."""

from __future__ import annotations

import ctypes
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from common import ROOT, Figures, Report, finish, interleaved, main, paired_ratio, parser, passes_of, shown
from cycle_port import socket_pair
from in_c import compile_c, compiler_version
from loop_cycle import Cycles

from fffo_drive.runtime.realtime import RealtimeReport, RealtimeRequest, enter_realtime, unlock_memory
from fffo_drive.runtime.tick import LoopConfig
from fffo_drive.units import NS_PER_S
from fffo_drive.workflows.plan import make_plan

NAME = "lateness"
AXIS = ROOT / "configs" / "axis_canopen.yaml"
TARGET = 1.3
PRIORITY = 60
LAST_CPU = -1
BUSY_THREADS = 4
ORDINARY_SHARE = 3
AHEAD_NS = 100_000_000  # a thread may wait that long for the interpreter before its loop begins
LATE_SHARE = 0.2  # of the period, as loop.late_share

Lateness = np.ndarray[tuple[int], np.dtype[np.int64]]


class Setting(NamedTuple):
    """One variant: whose loop, with which scheduling, beside how many busy Python threads."""

    loop: str  # "compiled" or "C timer"
    fifo: bool
    busy: int

    def __str__(self) -> str:
        return f"{self.loop}, {'FIFO' if self.fifo else 'ordinary'}, {self.busy} busy threads"


@contextmanager
def busy_threads(count: int) -> Iterator[None]:
    """So many threads that do what Python programs do, without a pause, for as long as the block lasts."""
    stop = threading.Event()
    document = {"rows": [{"tick": tick, "velocity_rps": tick * 0.1, "name": "axis"} for tick in range(50)]}

    def work() -> None:
        while not stop.is_set():
            json.loads(json.dumps(document))

    threads = [threading.Thread(target=work, daemon=True) for _ in range(count)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stop.set()
        for thread in threads:
            thread.join()


class Latenesses:
    """The loops whose lateness is compared."""

    def __init__(self, ticks: int) -> None:
        plan = make_plan(AXIS)
        self.ticks = ticks
        self.period_ns = NS_PER_S // plan.axis.loop.rate_hz
        self._cycles = Cycles(plan)
        self._timer = compile_c("timer.c")
        self.refusals: tuple[str, ...] = ()

    def run(self, setting: Setting) -> Lateness:
        """Lateness of each tick (ns), on a thread of its own with the scheduling of the loop's."""
        call = self._timer_loop if setting.loop == "C timer" else self._compiled_loop
        with busy_threads(setting.busy):
            lateness_ns, realtime = _on_thread(call, setting.fifo)
        unlock_memory()
        if realtime.refusals:
            self.refusals = realtime.refusals
        return lateness_ns

    def _compiled_loop(self) -> Lateness:
        rows = self._cycles.run("numba", socket_pair, self.ticks, paced=True, ahead_ns=AHEAD_NS).rows
        return wake_lateness_ns(rows["deadline_ns"], rows["lateness_ns"], self._cycles.loop)

    def _timer_loop(self) -> Lateness:
        lateness_ns = np.zeros(self.ticks, np.int64)
        first_ns = time.monotonic_ns() + AHEAD_NS
        counts = [ctypes.c_int64(value) for value in (first_ns, self.period_ns)]
        self._timer.run_timer(*counts, ctypes.c_void_p(lateness_ns.ctypes.data), ctypes.c_int64(self.ticks))
        return lateness_ns

    def figures(self, setting: Setting) -> Figures:
        """Median, 99th percentile, worst (ns); shares of late and of skipped ticks; counts plus a half, for ratios."""
        lateness_ns = self.run(setting)
        late = int((lateness_ns > LATE_SHARE * self.period_ns).sum())
        skipped = int((lateness_ns // self.period_ns).sum())
        median, high = np.quantile(lateness_ns, [0.5, 0.99])
        return {
            "median": float(median),
            "p99": float(high),
            "worst": float(lateness_ns.max()),
            "share": late / self.ticks,
            "late": late + 0.5,
            "skipped": skipped / self.ticks,
            "lost": late + skipped + 0.5,
        }


def wake_lateness_ns(deadline_ns: Lateness, lateness_ns: Lateness, config: LoopConfig) -> Lateness:
    """Time from when the loop asked to be woken until it was, shape (ticks,), from the fields of its rows.

    A row counts from the deadline that is left after those that were missed, and after a late SYNC the loop keeps a
    smallest distance by intent: neither is what the system did to it.
    """
    woke_ns = deadline_ns + lateness_ns
    asked_ns = deadline_ns.copy()
    asked_ns[1:] = np.maximum(deadline_ns[:-1] + config.period_ns, woke_ns[:-1] + config.minimum_gap_ns)
    return np.asarray(woke_ns - asked_ns)


def _on_thread(call: Callable[[], Lateness], fifo: bool) -> tuple[Lateness, RealtimeReport]:
    """Run on a new thread that has entered real time (its end is bounded by the ticks that it runs)."""
    found: list[tuple[Lateness, RealtimeReport]] = []
    errors: list[BaseException] = []

    def target() -> None:
        try:
            report = enter_realtime(RealtimeRequest(PRIORITY if fifo else 0, LAST_CPU, lock_memory=True))
            found.append((call(), report))
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=target)
    thread.start()
    thread.join()
    if errors:
        raise errors[0]
    return found[0]


def _add_ratios(report: Report, found: dict[str, dict[str, np.ndarray]]) -> None:
    quiet, loud = Setting("compiled", True, 0), Setting("compiled", True, BUSY_THREADS)
    timer = Setting("C timer", True, 0)
    texts = {
        "median": "median lateness",
        "late": "share of late ticks",
        "lost": "share of late and skipped ticks",
        "p99": "99th percentile",
    }
    for figure, text in texts.items():
        target = TARGET if figure in ("median", "late") else None
        for base, name in ((quiet, "without them"), (timer, "C timer loop")):
            ratio = paired_ratio(found[str(loud)][figure], found[str(base)][figure])
            report.ratio(f"FIFO: {text}, {BUSY_THREADS} busy Python threads over {name}", ratio, target)
        ratio = paired_ratio(found[str(quiet)][figure], found[str(timer)][figure])
        report.ratio(f"FIFO: {text}, without busy threads over C timer loop", ratio)
    ordinary = [found[str(Setting("compiled", False, busy))] for busy in (BUSY_THREADS, 0)]
    for figure, text in texts.items():
        ratio = paired_ratio(ordinary[0][figure], ordinary[1][figure])
        report.ratio(f"ordinary scheduling: {text}, {BUSY_THREADS} busy Python threads over without them", ratio)


def run() -> int:
    """The command."""
    options = parser(NAME, __doc__ or "", 24, 2)
    options.add_argument("--ticks", type=int, help="ticks of a pass and variant (default 4000; 300 with --sample)")
    chosen = options.parse_args()
    ticks = chosen.ticks or (300 if chosen.sample else 4000)
    report = Report(NAME, "How late the loop wakes at 2 kHz on its own thread, pinned, its memory locked.")
    loops = Latenesses(ticks)
    passes = passes_of(chosen)
    found: dict[str, dict[str, np.ndarray]] = {}
    # ordinary scheduling has no target: fewer passes, and apart, so that those under FIFO are closer together
    for fifo, count in ((True, passes), (False, max(2, passes // ORDINARY_SHARE))):
        settings = [Setting(loop, fifo, busy) for busy in (0, BUSY_THREADS) for loop in ("compiled", "C timer")]
        variants = {str(setting): (lambda setting=setting: loops.figures(setting)) for setting in settings}
        with shown("FIFO" if fifo else "ordinary scheduling") as progress:
            found |= interleaved(variants, count, progress)
    _add_ratios(report, found)
    report.facts["refusals"] = list(loops.refusals)
    report.facts["ticks"] = ticks
    report.table(
        ("variant", "median, us", "99 %, us", "worst, us", "late ticks", "skipped ticks"),
        [
            (
                name,
                *(f"{np.median(figures[key]) / 1e3:.1f}" for key in ("median", "p99")),
                f"{figures['worst'].max() / 1e3:.0f}",
                *(f"{100 * figures[key].mean():.2f} %" for key in ("share", "skipped")),
            )
            for name, figures in found.items()
        ],
    )
    report.notes += [
        f"{passes} passes (a third as many without FIFO) of {ticks} ticks; late: beyond {LATE_SHARE:g} of the period.",
        "Lateness counts from the requested wake-up time. Medians of the passes, the worst of all, mean shares.",
        "Both loops skip deadlines that pass while they are stalled. These are counted apart: one stall of a virtual"
        " machine skips dozens.",
        "In ratios of late ticks, half a tick is added on both sides, so that none over none is one.",
        f"The loop does all of its work, with a drive that answers in the same thread. C by {compiler_version()}, -O2.",
    ]
    report.notes += [f"The system refused: {refusal}" for refusal in loops.refusals]
    return finish(report, chosen)


if __name__ == "__main__":
    main(run)

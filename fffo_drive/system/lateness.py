"""How late a thread with the loop's real-time properties wakes on this machine: a compiled timer, for a few seconds."""

from __future__ import annotations

import threading
from typing import Any, NamedTuple

import numpy as np

from ..jit import njit
from ..jit.libc import monotonic_ns, sleep_until
from ..runtime.realtime import RealtimeReport, RealtimeRequest, enter_realtime, unlock_memory
from ..units import NS_PER_S
from .findings import HostFinding, Wanted, failure, ok, warning

MOST_LATE = 0.01  # share of late ticks from which it will not do

Words = np.ndarray[Any, np.dtype[np.int64]]


class Lateness(NamedTuple):
    """Of `ticks` deadlines: lateness (ns) of each, shape (ticks,), and what the system gave the thread."""

    lateness_ns: Words
    realtime: RealtimeReport


@njit
def wake_often(scratch: Words, lateness_ns: Words, first_ns: int, period_ns: int) -> None:
    """Sleep to deadline after deadline, absolute, and note how late each wake-up was. `scratch`: 2 int64."""
    deadline_ns = first_ns
    for tick in range(len(lateness_ns)):
        sleep_until(scratch, deadline_ns)
        late_ns = monotonic_ns(scratch) - deadline_ns
        lateness_ns[tick] = late_ns
        # missed deadlines are skipped, as in the loop
        deadline_ns += period_ns * (1 + max(0, late_ns // period_ns))


def measure_lateness(wanted: Wanted, seconds: float) -> Lateness:
    """Measure on a thread of its own, which gets what the loop's would get."""
    period_ns = NS_PER_S // wanted.rate_hz
    ticks = max(1, round(seconds * wanted.rate_hz))
    found: list[Lateness] = []
    scratch = np.zeros(2, np.int64)
    wake_often(scratch, np.zeros(1, np.int64), 0, period_ns)  # compiled before it counts

    def target() -> None:
        report = enter_realtime(RealtimeRequest(wanted.priority, wanted.cpu, wanted.lock_memory))
        lateness_ns = np.zeros(ticks, np.int64)
        wake_often(scratch, lateness_ns, monotonic_ns(scratch) + 2 * period_ns, period_ns)
        found.append(Lateness(lateness_ns, report))

    thread = threading.Thread(target=target)
    thread.start()
    thread.join()
    unlock_memory()
    return found[0]


def lateness_findings(measured: Lateness, wanted: Wanted) -> list[HostFinding]:
    """What the measurement says, and what the system refused."""
    subject = "lateness"
    late_us = measured.lateness_ns / 1e3
    median, high = np.quantile(late_us, [0.5, 0.99])
    bound_us = wanted.late_share * wanted.period_us
    late = float(np.mean(late_us > bound_us))
    properties = "SCHED_FIFO" if measured.realtime.fifo else "ordinary scheduling"
    text = (
        f"median {median:.0f}, 99 % {high:.0f}, worst {late_us.max():.0f} us in {late_us.size} periods of "
        f"{wanted.period_us:g} us ({properties}); {100 * late:.2g} % later than {bound_us:g} us"
    )
    remedy = "fix what is listed above; then measure for longer, under the usual load: fffo-drive doctor --seconds 600"
    findings = [warning("real time", refusal, "see the limits above") for refusal in measured.realtime.refusals]
    if late == 0.0:
        return [*findings, ok(subject, text)]
    return [*findings, (failure if late > MOST_LATE else warning)(subject, text, remedy)]

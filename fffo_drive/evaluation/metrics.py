"""The paper's metrics of a velocity error (Table II), and the statistics of the ticks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..drive.port import ExchangeCounts

Rows = np.ndarray[Any, np.dtype[np.void]]

# Table II, in per cent of PI+FFFO; shown next to the measured values
PAPER_TABLE_2 = {
    "PI": {"ise": 442.0, "mae": 222.0, "max": 159.0, "std": 210.0},
    "PI+FBFO": {"ise": 146.0, "mae": 122.0, "max": 114.0, "std": 120.0},
    "PI+FFFO": {"ise": 100.0, "mae": 100.0, "max": 100.0, "std": 100.0},
}
TABLE_2_BASE = "PI+FFFO"


class ErrorMetrics(NamedTuple):
    """ISE is the integral of the squared error: the paper's e'e times the period, so that rates compare."""

    ise: float
    mae: float
    max: float
    std: float


METRIC_UNITS = {"ise": "rps² s", "mae": "rps", "max": "rps", "std": "rps"}


class TickStatistics(NamedTuple):
    """Timing of the loop and disturbances by the bus, over the rows of a run."""

    ticks: int
    late: int  # woke later than loop.late_share of the period
    skipped: int  # deadlines missed while the loop could not run
    missing_feedback: (
        int  # no answer to SYNC before the cut-off: due to the drive, the bus, or a SYNC that was not sent
    )
    late_feedback: int  # from here on: drive.port.ExchangeCounts
    duplicate_feedback: int
    bad_frames: int
    error_frames: int
    bus_losses: int
    send_errors: int
    dropped_frames: int
    emergency_count: int
    boot_count: int
    nmt_exits: int
    foreign_frames: int
    warning_count: int
    lateness_us_p50: float
    lateness_us_p99: float
    lateness_us_max: float
    turnaround_us_p50: float

    @property
    def wire_errors(self) -> int:
        """Bad, dropped and error frames, losses of the bus and frames that could not be sent."""
        dropped = max(self.dropped_frames, 0)  # -1: unknown
        return self.bad_frames + dropped + self.error_frames + self.bus_losses + self.send_errors


def error_metrics(error_rps: Floats, period_s: float) -> ErrorMetrics:
    """Metrics of an error record (n,). Raises ValueError for an empty or non-finite one."""
    if error_rps.size == 0:
        raise ValueError("no sample to evaluate: the profile did not run")
    if not np.isfinite(error_rps).all():
        raise ValueError("the error holds values that are not finite")
    return ErrorMetrics(
        float(np.dot(error_rps, error_rps) * period_s),
        float(np.abs(error_rps).mean()),
        float(np.abs(error_rps).max()),
        float(error_rps.std()),
    )


def rms(values: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values * values)))


def profile_rows(rows: Rows, samples: int | None = None) -> Rows:
    """The rows in which the profile ran; `samples` cuts off the standstill after it."""
    inside: Rows = rows[_ran(rows, samples)]
    return inside


def _ran(rows: Rows, samples: int | None) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Which rows (n,) those are."""
    index = rows["profile_sample"]
    inside = index >= 0
    if samples is not None:
        inside &= index < samples
    return inside


def run_metrics(rows: Rows, period_s: float, samples: int | None = None, column: str = "velocity_rps") -> ErrorMetrics:
    """Metrics against a velocity, over the rows in which the profile ran.

    `column`: true_velocity_rps is the shaft's, known only for a simulated drive in process.
    """
    inside = _ran(rows, samples)  # of two columns: a copy of all of them takes a tenth of a simulated run
    return error_metrics(rows["reference_rps"][inside] - rows[column][inside], period_s)


def tick_statistics(rows: Rows, exchange: ExchangeCounts | None = None) -> TickStatistics:
    """Timing over rows. `exchange`: the port's counts during the run, which are not in the rows."""
    if rows.size == 0:
        raise ValueError("no row to evaluate: the loop did not run")
    lateness_us = rows["lateness_ns"] / 1e3
    answered = rows["turnaround_ns"][rows["turnaround_ns"] >= 0]
    p50, p99 = np.percentile(lateness_us, [50, 99])
    return TickStatistics(
        int(rows.size),
        int(rows["late"].sum()),
        int(rows["tick"][-1] - rows["tick"][0] + 1 - rows.size),
        int(np.count_nonzero(rows["turnaround_ns"] < 0)),
        *(exchange or ExchangeCounts()),
        float(p50),
        float(p99),
        float(lateness_us.max()),
        float(np.median(answered) / 1e3) if answered.size else float("nan"),
    )


def bases_of(metrics: Mapping[str, ErrorMetrics]) -> dict[str, str]:
    """The controller that is 100 % of each metric: PI+FFFO as in Table II, the smallest where it was not run."""
    return {
        key: TABLE_2_BASE if TABLE_2_BASE in metrics else min(metrics, key=lambda name: getattr(metrics[name], key))
        for key in ErrorMetrics._fields
    }


def percent_of_bases(metrics: Mapping[str, ErrorMetrics]) -> dict[str, dict[str, float]]:
    """Each metric in per cent of that of its base (`bases_of`)."""
    bases = {key: getattr(metrics[name], key) for key, name in bases_of(metrics).items()}
    return {
        name: {
            key: 100.0 * value / bases[key] if bases[key] > 0 else float("nan") for key, value in own._asdict().items()
        }
        for name, own in metrics.items()
    }

"""The paper's metrics of a velocity error (Table II), and the statistics of the ticks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Integers
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


class ErrorSums:
    """What the metrics of an error need, taken part by part; in another division only the sums' last digits differ."""

    def __init__(self) -> None:
        self.samples = 0
        self._squares = self._magnitudes = self._largest = self._mean = self._spread = 0.0

    def take(self, error_rps: Floats) -> None:
        """More samples (n,). Raises ValueError where they are not finite."""
        if error_rps.size == 0:
            return
        if not np.isfinite(error_rps).all():
            raise ValueError("the error holds values that are not finite")
        magnitude, mean = np.abs(error_rps), float(error_rps.mean())
        before, shift = self.samples, mean - self._mean
        self.samples += error_rps.size
        self._squares += float(np.dot(error_rps, error_rps))
        self._magnitudes += float(magnitude.sum())
        self._largest = max(self._largest, float(magnitude.max()))
        # the deviations from two means, about the mean of both (Chan, Golub and LeVeque)
        self._spread += float(np.sum((error_rps - mean) ** 2)) + shift**2 * (before * error_rps.size / self.samples)
        self._mean += shift * (error_rps.size / self.samples)

    def metrics(self, period_s: float) -> ErrorMetrics:
        """Of all samples. Raises ValueError where there is none."""
        if self.samples == 0:
            raise ValueError("no sample to evaluate: the profile did not run")
        return ErrorMetrics(
            self._squares * period_s,
            self._magnitudes / self.samples,
            self._largest,
            math.sqrt(self._spread / self.samples),
        )


def error_metrics(error_rps: Floats, period_s: float) -> ErrorMetrics:
    """Metrics of an error record (n,). Raises ValueError for an empty or non-finite one."""
    sums = ErrorSums()
    sums.take(error_rps)
    return sums.metrics(period_s)


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


class _Counted:
    """Whole numbers by value and count: exact quantiles in the memory of the values that differ."""

    def __init__(self) -> None:
        self.values: Integers = np.zeros(0, np.int64)
        self._counts: Integers = np.zeros(0, np.int64)

    def take(self, values: Integers) -> None:
        """More of them (n,)."""
        own, counts = np.unique(values, return_counts=True)
        self.values, place = np.unique(np.concatenate([self.values, own]), return_inverse=True)
        self._counts = np.bincount(place, np.concatenate([self._counts, counts])).astype(np.int64)

    def quantile(self, share: float) -> float:
        """As numpy.quantile of all of them; NaN of none."""
        ends = np.cumsum(self._counts)
        if not ends.size:
            return float("nan")
        place = share * (int(ends[-1]) - 1)
        ranks = (math.floor(place), math.ceil(place))
        low, high = (float(self.values[np.searchsorted(ends, rank, side="right")]) for rank in ranks)
        return low + (place - math.floor(place)) * (high - low)


class TickSums:
    """Timing over rows, taken block by block."""

    def __init__(self) -> None:
        self.rows = self._late = self._missing = 0
        self._first = self._last = 0  # ticks
        self._lateness_ns, self._turnaround_ns = _Counted(), _Counted()

    def take(self, rows: Rows) -> None:
        """The next rows."""
        if not rows.size:
            return
        self._first = self._first if self.rows else int(rows["tick"][0])
        self._last = int(rows["tick"][-1])
        self.rows += rows.size
        self._late += int(rows["late"].sum())
        answered = rows["turnaround_ns"] >= 0
        self._missing += int(np.count_nonzero(~answered))
        self._lateness_ns.take(rows["lateness_ns"])
        self._turnaround_ns.take(rows["turnaround_ns"][answered])

    def statistics(self, exchange: ExchangeCounts | None = None) -> TickStatistics:
        """Of all rows; `exchange`: the port's counts during the run, which are not in them. Raises ValueError."""
        if not self.rows:
            raise ValueError("no row to evaluate: the loop did not run")
        return TickStatistics(
            self.rows,
            self._late,
            self._last - self._first + 1 - self.rows,
            self._missing,
            *(exchange or ExchangeCounts()),
            self._lateness_ns.quantile(0.5) / 1e3,
            self._lateness_ns.quantile(0.99) / 1e3,
            float(self._lateness_ns.values[-1]) / 1e3,
            self._turnaround_ns.quantile(0.5) / 1e3,
        )


def tick_statistics(rows: Rows, exchange: ExchangeCounts | None = None) -> TickStatistics:
    """Timing over rows. `exchange`: the port's counts during the run, which are not in the rows."""
    sums = TickSums()
    sums.take(rows)
    return sums.statistics(exchange)


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

"""The figures of a bench: profile (Fig. 7), cut-outs (Fig. 8), error histograms (Fig. 9), friction and the ticks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..evaluation.metrics import PAPER_TABLE_2, ErrorMetrics, Rows, bases_of, percent_of_bases, profile_rows
from ..units import NS_PER_S
from .document import significant
from .figures import (
    TIME,
    VELOCITY,
    Dash,
    Figure,
    Group,
    LevelLine,
    PlotAxis,
    Series,
    Span,
    Uniform,
    grouped_bars,
    histogram,
    normal_curve,
)
from .intervals import ShownInterval

COLOURS = {
    "PI": "orange",
    "PI+FBFO": "green",
    "PI+FFFO": "blue",
    "PI+FFFO+": "purple",
    "before": "orange",
    "after": "blue",
}
DASHES: dict[str, Dash] = {"PI+FBFO": "dashdot", "PI+FFFO+": "dotted"}
WEIGHTS = {"PI": 1.3, "PI+FFFO": 2.1, "PI+FFFO+": 1.7, "before": 1.3, "after": 2.1}
SPARE_COLOURS = ("grey", "purple")
SHOWN = ("PI", "PI+FFFO", "PI+FFFO+")  # Fig. 8 compares the first two
METRIC_NAMES = ("ISE", "MAE", "MAX", "STD")
LOW_CUTOUT_S = 1.0
HIGH_CUTOUT_S = 2.0
LOW_SHARE = 0.02  # of the largest speed: 0.3 of 15 rps, near the paper's lowest peaks
TINY = 1e-4
HISTOGRAM_BINS = 81
FULL_RATE = 1 << 20


class BenchData(NamedTuple):
    """Runs on the profile's grid: (n,) arrays by controller, NaN where a tick or its answer was missing."""

    period_s: float
    reference_rps: Floats
    velocity_rps: dict[str, Floats]
    friction_nm: dict[str, Floats]
    lateness_us: dict[str, Floats]
    turnaround_us: dict[str, Floats]

    @property
    def duration_s(self) -> float:
        """Of the profile."""
        return self.reference_rps.size * self.period_s

    def error_rps(self, name: str) -> Floats:
        """Reference minus velocity."""
        return self.reference_rps - self.velocity_rps[name]


class ShownPart(NamedTuple):
    """A part of the profile that is shown large: samples [begin, end)."""

    label: str
    begin: int
    end: int
    speed: str


def bench_data(rows: Mapping[str, Rows], period_s: float, samples: int) -> BenchData:
    """Columns of the runs, each on the profile's grid of `samples`."""
    reference = np.full(samples, np.nan)
    columns: dict[str, dict[str, Floats]] = {
        "velocity_rps": {},
        "friction_nm": {},
        "lateness_ns": {},
        "turnaround_ns": {},
    }
    for name, run in rows.items():
        inside = profile_rows(run, samples)
        index = inside["profile_sample"]
        reference[index] = inside["reference_rps"]
        for column, by_name in columns.items():
            grid = np.full(samples, np.nan)
            grid[index] = inside[column]
            by_name[name] = grid
    known = np.flatnonzero(np.isfinite(reference))  # a sample that every run skipped
    reference = np.interp(np.arange(samples), known, reference[known])
    us = 1e6 / NS_PER_S
    lateness = {name: values * us for name, values in columns["lateness_ns"].items()}
    turnaround = {name: np.where(values >= 0, values * us, np.nan) for name, values in columns["turnaround_ns"].items()}
    return BenchData(period_s, reference, columns["velocity_rps"], columns["friction_nm"], lateness, turnaround)


def colour_of(name: str, names: list[str]) -> str:
    """The bench's controllers, before and after have fixed colours; others take the remaining ones."""
    others = [other for other in names if other not in COLOURS]
    return COLOURS.get(name) or SPARE_COLOURS[others.index(name) % len(SPARE_COLOURS)]


def choose_cutouts(reference_rps: Floats, period_s: float) -> list[ShownPart]:
    """Cut-outs around changes of direction: (a), (b) among gentle peaks, (c), (d) among the fastest."""
    most = float(np.abs(reference_rps).max())
    chosen: list[tuple[str, int, int]] = []
    for speed, length_s in (("low", LOW_CUTOUT_S), ("high", HIGH_CUTOUT_S)):
        length = min(round(length_s / period_s), reference_rps.size)
        begins = np.arange(0, reference_rps.size - length + 1, max(1, length // 8))
        windows = [reference_rps[begin : begin + length] for begin in begins]
        peaks = np.array([np.abs(window).max() for window in windows]) / most
        # how far the reference goes in its less used direction; 0 where it never reverses
        swings = np.array([max(0.0, min(window.max(), -window.min())) for window in windows]) / most
        gentle = np.abs(np.log((peaks + TINY) / LOW_SHARE)) + np.abs(np.log((swings + TINY) / LOW_SHARE))
        order = np.argsort(gentle if speed == "low" else -peaks * swings, kind="stable")
        chosen += [(speed, begin, begin + length) for begin in _apart(begins[order], length, chosen)]
    return [ShownPart(chr(ord("a") + number), begin, end, speed) for number, (speed, begin, end) in enumerate(chosen)]


def _apart(begins: np.ndarray, length: int, taken: list[tuple[str, int, int]]) -> list[int]:
    """The first two of `begins` whose windows overlap neither each other nor those taken, by time."""
    found: list[int] = []
    for begin in begins.tolist():
        others = [(other, other + length) for other in found] + [(start, end) for _, start, end in taken]
        if all(begin >= end or begin + length <= start for start, end in others):
            found.append(begin)
        if len(found) == 2:
            break
    return sorted(found)


def profile_figure(data: BenchData, cutouts: list[ShownPart]) -> Figure:
    """Fig. 7: the reference, with the places of the cut-outs."""
    return Figure(
        "profile", "time", "Reference velocity profile",
        "Multi-sine under a biased sigmoid envelope, as in Fig. 7 of the paper. Grey bands: the details shown below.",
        TIME, VELOCITY, (Series("reference", Uniform(0.0, data.period_s), data.reference_rps, "ink", weight=1.0),),
        height_px=210, group="run", spans=tuple(_span(data, cutout) for cutout in cutouts),
    )  # fmt: skip


def _span(data: BenchData, cutout: ShownPart) -> Span:
    return Span(cutout.begin * data.period_s, cutout.end * data.period_s, cutout.label)


def cutout_figures(data: BenchData, cutouts: list[ShownPart]) -> list[Figure]:
    """Fig. 8: reference, PI, PI+FFFO and PI+FFFO+ in each cut-out, every sample."""
    shown = [name for name in data.velocity_rps if name in SHOWN] or list(data.velocity_rps)
    figures = []
    for cutout in cutouts:
        part = slice(cutout.begin, cutout.end)
        x = Uniform(cutout.begin * data.period_s, data.period_s)
        series = [
            Series(
                name,
                x,
                data.velocity_rps[name][part],
                colour_of(name, shown),
                dash=DASHES.get(name, "solid"),
                weight=WEIGHTS.get(name, 1.7),
            )
            for name in shown
        ]
        series.append(Series("reference", x, data.reference_rps[part], "ink", dash="dashed", weight=1.4))
        peak = np.abs(data.reference_rps[part]).max()
        figures.append(
            Figure(
                f"cutout-{cutout.label}",
                "time",
                f"({cutout.label}) {cutout.speed} speed",
                f"Velocity where the reference peaks at {significant(float(peak), 2)} rps.",
                TIME,
                VELOCITY,
                tuple(series),
                width="half",
                height_px=250,
            )
        )
    return figures


def velocity_figure(data: BenchData) -> Figure:
    """Everything, to zoom into."""
    x = Uniform(0.0, data.period_s)
    names = list(data.velocity_rps)
    series = [
        Series(name, x, data.velocity_rps[name], colour_of(name, names), weight=1.4,
               dash=DASHES.get(name, "solid"), finest=FULL_RATE)
        for name in names
    ]  # fmt: skip
    series.append(Series("reference", x, data.reference_rps, "ink", dash="dashed", weight=1.3, finest=FULL_RATE))
    return Figure(
        "velocity", "time", "All velocities", "Reference and measured velocities over the whole profile; zoom in.",
        TIME, VELOCITY, tuple(series), group="run", height_px=300,
    )  # fmt: skip


def error_figures(data: BenchData) -> list[Figure]:
    """The error of each run over time, one below the other on the same scale."""
    names = list(data.velocity_rps)
    x = Uniform(0.0, data.period_s)
    return [
        Figure(
            f"error-{number}", "time", f"Error, {name}", "Reference minus measured velocity; same scale for all runs.",
            TIME, PlotAxis("error", "rps"),
            (Series(name, x, data.error_rps(name), colour_of(name, names), weight=1.0, finest=40_000),),
            height_px=150, group="run", share_y=True,
        )
        for number, name in enumerate(names)
    ]  # fmt: skip


def histogram_figures(data: BenchData) -> list[Figure]:
    """Fig. 9: one histogram a run, same bins and same scale, and the normal curve of the same spread."""
    names = list(data.velocity_rps)
    errors = {name: data.error_rps(name)[np.isfinite(data.velocity_rps[name])] for name in names}
    reach = max(1e-9, *(float(np.quantile(np.abs(error), 0.998)) for error in errors.values()))
    edges = np.linspace(-reach, reach, HISTOGRAM_BINS + 1)
    bars = {name: histogram(name, error, edges, colour_of(name, names)) for name, error in errors.items()}
    curves = {name: normal_curve("normal, same STD", error, edges) for name, error in errors.items()}
    top = 1.35 * max(float(max(bars[name].y.max(), curves[name].y.max())) for name in names)
    figures = []
    for letter, name in zip("abcdefgh", names, strict=False):
        beyond = 100.0 * float(np.mean(np.abs(errors[name]) > reach))
        figures.append(
            Figure(
                f"histogram-{letter}",
                "histogram",
                f"({letter}) {name}",
                f"STD {significant(float(errors[name].std()))} rps; {significant(beyond, 2)} % lie outside.",
                PlotAxis("error", "rps", limits=(-reach, reach)),
                PlotAxis("samples", "%", limits=(0.0, top)),
                (bars[name], curves[name]),
                width="third",
                height_px=230,
            )
        )
    return figures


def metrics_figure(
    metrics: Mapping[str, ErrorMetrics], intervals: Mapping[str, Mapping[str, ShownInterval]]
) -> Figure:  # fmt: skip
    """The metrics in per cent of PI+FFFO, beside the paper's."""
    percent, bases = percent_of_bases(metrics), set(bases_of(metrics).values())
    base = bases.pop() if len(bases) == 1 else "the smallest"
    names = list(metrics)
    groups = {}
    for name in names:
        ends = [intervals.get(name, {}).get(key) for key in ErrorMetrics._fields]
        values = [percent[name][key] for key in ErrorMetrics._fields]
        low = [100.0 * end.low if end and end.high > end.low else float("nan") for end in ends]
        high = [100.0 * end.high if end and end.high > end.low else float("nan") for end in ends]
        groups[name] = Group(values, colour_of(name, names), low, high)
    paper = {
        name: [PAPER_TABLE_2[name][key] for key in ErrorMetrics._fields] for name in names if name in PAPER_TABLE_2
    }
    return Figure(
        "metrics", "bars", "Error metrics and those of the paper",
        f"Per cent of {base}. Whiskers: 95 % interval of the ratio. Markers: Table II of the paper.",
        PlotAxis("metric", "-", categories=METRIC_NAMES), PlotAxis(f"of {base}", "%"),
        tuple(grouped_bars(groups, paper, "paper, Table II")), width="half", height_px=280,
    )  # fmt: skip


def exceedance_figure(data: BenchData) -> Figure:
    """How often the error exceeds a value: the tails that a histogram hides."""
    names = list(data.velocity_rps)
    series = []
    for name in names:
        error = np.abs(data.error_rps(name))
        ordered = np.sort(error[np.isfinite(error)])
        picked = np.unique(np.geomspace(1, ordered.size, 400).astype(np.int64))  # so many are at least as large
        x, y = ordered[ordered.size - picked][::-1], (100.0 * picked / ordered.size)[::-1]
        series.append(Series(name, x, y, colour_of(name, names), dash=DASHES.get(name, "solid"), weight=1.7))
    return Figure(
        "exceedance", "xy", "How often the error exceeds a value",
        "Share of samples with an error larger in magnitude than the abscissa, logarithmic.",
        PlotAxis("magnitude of the error", "rps"), PlotAxis("samples beyond", "%", log=True), tuple(series),
        width="half", height_px=280,
    )  # fmt: skip


def lateness_figure(data: BenchData, late_us: float) -> Figure:
    """How late the loop woke."""
    return Figure(
        "lateness", "histogram", "Lateness of the ticks",
        "Share of ticks by lateness, logarithmic. A tick beyond the dashed line counts as late.",
        PlotAxis("lateness", "µs"), PlotAxis("ticks", "%", log=True), _outlines(data.lateness_us),
        width="half", height_px=280,
        levels=(LevelLine(late_us, _late_text(late_us), upright=True),),
    )  # fmt: skip


def turnaround_figure(data: BenchData) -> Figure:
    """How long the drive's answer took."""
    return Figure(
        "turnaround", "histogram", "Response time of the drive",
        "Share of ticks with feedback by the time from SYNC sent to feedback received, logarithmic; up to the "
        "99.95th percentile.",
        PlotAxis("turnaround", "µs"), PlotAxis("ticks", "%", log=True), _outlines(data.turnaround_us, 0.9995),
        width="half", height_px=280,
    )  # fmt: skip


def lateness_courses(data: BenchData, late_us: float) -> list[Figure]:
    """Lateness over time, one run below the other on the same scale."""
    names = list(data.lateness_us)
    x = Uniform(0.0, data.period_s)
    return [
        Figure(
            f"lateness-{number}", "time", f"Lateness, {name}", "Earliest and latest tick of each interval.",
            TIME, PlotAxis("lateness", "µs"),
            (Series(name, x, data.lateness_us[name], colour_of(name, names), weight=1.0),),
            height_px=130, group="run", share_y=True, levels=(LevelLine(late_us, _late_text(late_us)),),
        )
        for number, name in enumerate(names)
    ]  # fmt: skip


def _late_text(late_us: float) -> str:
    return f"late: {significant(late_us)} µs"


def _outlines(values_us: Mapping[str, Floats], share: float = 1.0) -> tuple[Series, ...]:
    """Histograms of several runs over each other, as outlines, up to where `share` of every run's values lie.

    Empty bins are gaps on a logarithmic ordinate.
    """
    names = list(values_us)
    present = {name: values[np.isfinite(values)] for name, values in values_us.items()}
    reach = max((float(np.quantile(values, share)) for values in present.values() if values.size), default=1.0)
    edges = np.linspace(0.0, max(1.0, 1.001 * reach), 101)
    outlines = []
    for name in names:
        shares = histogram(name, present[name], edges, colour_of(name, names)).y
        shares = np.where(shares > 0, shares, np.nan)
        outlines.append(Series(name, edges, shares, colour_of(name, names), "steps", DASHES.get(name, "solid")))
    return tuple(outlines)


def friction_figures(data: BenchData, cutouts: list[ShownPart]) -> list[Figure]:
    """The observer's estimate over the reference at low and high speed, of the runs that have one."""
    names = [name for name, values in data.friction_nm.items() if np.nanmax(np.abs(values)) > 0.0]
    figures = []
    for speed in ("low", "high"):
        part = next((slice(c.begin, c.end) for c in cutouts if c.speed == speed), None)
        if part is None or not names:
            continue
        series = []
        for name in reversed(names):
            usable = np.isfinite(data.friction_nm[name][part])
            x, y = data.reference_rps[part][usable], 1000.0 * data.friction_nm[name][part][usable]
            dash = DASHES.get(name, "solid")
            series.append(Series(name, x, y, colour_of(name, names), dash=dash, weight=1.7))
        label = next(c.label for c in cutouts if c.speed == speed)
        figures.append(
            Figure(
                f"friction-{speed}",
                "xy",
                f"Friction estimate, {speed} speed",
                f"Torque of the observer over the reference in cut-out ({label}).",
                PlotAxis("reference velocity", "rps"),
                PlotAxis("friction estimate", "mNm"),
                tuple(series),
                width="half",
                height_px=280,
            )
        )
    return figures

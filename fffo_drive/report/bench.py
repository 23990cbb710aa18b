"""The report of a bench: controllers with and without friction observer against PI, and the timing of the loop."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..drive.port import ExchangeCounts
from ..evaluation.metrics import (
    METRIC_UNITS,
    PAPER_TABLE_2,
    ErrorMetrics,
    Rows,
    TickStatistics,
    bases_of,
    percent_of_bases,
    run_metrics,
    tick_statistics,
)
from ..recording.reader import Run
from . import bench_figures as draw
from .document import (
    Cell,
    Confidence,
    Heading,
    Line,
    Report,
    ReportProvenance,
    Row,
    Section,
    Table,
    Verdict,
    count,
    number,
    provenance,
    significant,
    source_file,
    source_log,
)
from .figures import Figure
from .intervals import ShownInterval, ratio_intervals
from .page import ReportPaths, write_report

Intervals = dict[str, dict[str, ShownInterval]]

PICTURE_NAMES = ("bench.svg", "bench.png")
STRETCH_S = 1.0
COMPARABLE_S = 60.0  # shorter references have too few reversals for a comparison with Table II
SOUND_LATE_SHARE = 0.01
SOUND_MISSING_SHARE = 0.01
LATE_SHARE_OF_PERIOD = 0.2


class BenchRecord(NamedTuple):
    """One controller's run as read back from its files, in their order."""

    parts: tuple[Run, ...]
    exchange: ExchangeCounts = ExchangeCounts()  # the port's counts, which are not in the rows
    rows_lost: int = 0
    late_share: float = LATE_SHARE_OF_PERIOD  # lateness of a late tick, of the period

    @property
    def rows(self) -> Rows:
        """All rows of the run."""
        return self.parts[0].rows if len(self.parts) == 1 else np.concatenate([part.rows for part in self.parts])

    @property
    def metadata(self) -> Mapping[str, str]:
        """Metadata of the first file."""
        return self.parts[0].metadata


class BenchResult(NamedTuple):
    """What the records say."""

    data: draw.BenchData
    metrics: dict[str, ErrorMetrics]
    ticks: dict[str, TickStatistics]
    rows_lost: dict[str, int]
    intervals: Intervals  # of the ratios to what is 100 %
    margins: Intervals  # of the ratios to the best
    late_us: float
    label: str  # what sets the axis apart from that of the paper; empty: nothing


def evaluate(records: Mapping[str, BenchRecord], label: str = "") -> BenchResult:
    """Metrics, ticks and intervals of the runs. Raises ValueError when the runs do not share one profile.

    `label`: what sets the axis apart from that of the paper; it is shown with the result.
    """
    profiles = {(r.metadata.get("period_s", "?"), r.metadata.get("profile_samples", "?")) for r in records.values()}
    if len(profiles) != 1 or "?" in next(iter(profiles)):
        raise ValueError(f"a bench compares runs of one profile; these have (period, samples) {sorted(profiles)}")
    period_text, samples_text = next(iter(profiles))
    period_s, samples = float(period_text), int(samples_text)
    rows = {name: record.rows for name, record in records.items()}
    data = draw.bench_data(rows, period_s, samples)
    metrics = {name: run_metrics(run, period_s, samples) for name, run in rows.items()}
    errors = {name: data.error_rps(name) for name in rows}
    best = {key: min(metrics, key=lambda name: getattr(metrics[name], key)) for key in ErrorMetrics._fields}
    stretch = max(1, round(STRETCH_S / period_s))
    return BenchResult(
        data,
        metrics,
        {name: tick_statistics(run, records[name].exchange) for name, run in rows.items()},
        {name: record.rows_lost for name, record in records.items()},
        ratio_intervals(errors, bases_of(metrics), stretch),
        ratio_intervals(errors, best, stretch),
        1e6 * period_s * next(iter(records.values())).late_share,
        label,
    )


def bench_report(records: Mapping[str, BenchRecord], result: BenchResult | None = None) -> Report:
    """The report of the runs by controller; those of the paper are called PI, PI+FBFO and PI+FFFO, ours PI+FFFO+.

    `result`: of `evaluate`, where it is known.
    """
    result = result or evaluate(records)
    cutouts = draw.choose_cutouts(result.data.reference_rps, result.data.period_s)
    head = next(iter(records.values())).metadata
    sections = _sections(result, cutouts)
    return Report(
        kind="bench",
        title=f"Bench of {', '.join(records)}",
        subtitle=(
            f"Axis {head.get('axis', 'unnamed')}, {head.get('drive', 'drive not named')}: the same "
            f"{result.data.duration_s:g} s of reference velocity under each controller, at "
            f"{1.0 / result.data.period_s:g} Hz." + (f" {result.label}" if result.label else "")
        ),
        verdict=_verdict(result),
        tables=(_metrics_table(result), _ticks_table(result)),
        sections=sections,
        provenance=_provenance(records),
        results=_results(result),
        opening=next((figure.name for figure in sections[0].figures if figure.name.startswith("cutout-")), ""),
    )


def write_bench_report(records: Mapping[str, BenchRecord], result: BenchResult, directory: Path) -> ReportPaths:
    """Write report.html, report.json, bench.svg and bench.png into the directory of the runs."""
    from .static import write_overview

    report = bench_report(records, result)
    paths = write_report(report, directory)
    write_overview(overview_rows(report), [directory / name for name in PICTURE_NAMES])
    return paths


def overview_rows(report: Report) -> list[list[Figure]]:
    """The figures of the one-page picture, row by row."""
    by_name = {figure.name: figure for figure in report.figures}
    cutouts = [figure for name, figure in by_name.items() if name.startswith("cutout-")]
    histograms = [figure for name, figure in by_name.items() if name.startswith("histogram-")]
    rows = [[by_name["profile"]], cutouts[:2], cutouts[2:], histograms]
    return [row for row in [*rows, [by_name["metrics"], by_name["lateness"]]] if row]


def _sections(result: BenchResult, cutouts: list[draw.ShownPart]) -> tuple[Section, ...]:
    data = result.data
    friction = draw.friction_figures(data, cutouts)
    sections = [
        Section("Tracking", "At a reversal, PI alone sticks until its integral overcomes the friction.",
                (draw.profile_figure(data, cutouts), *draw.cutout_figures(data, cutouts))),
        Section("Error", "Distribution and metrics of the velocity error.",
                (*draw.histogram_figures(data), draw.metrics_figure(result.metrics, result.intervals),
                 draw.exceedance_figure(data))),
        Section("Whole run", "These figures zoom together.", (draw.velocity_figure(data), *draw.error_figures(data))),
        Section("Friction estimate", "Torque that the observer adds to the command.", tuple(friction)),
        Section("Ticks", "Timing of the loop.",
                (draw.lateness_figure(data, result.late_us), draw.turnaround_figure(data),
                 *draw.lateness_courses(data, result.late_us))),
    ]  # fmt: skip
    return tuple(section for section in sections if section.figures)


def _verdict(result: BenchResult) -> Verdict:
    cautions = timing_cautions(result)
    names = list(result.metrics)
    timing = Line(label="Timing", text=_timing(result))
    if result.data.duration_s < COMPARABLE_S:
        step, command = "run longer", ""
        text = f"{result.data.duration_s:g} s are too short to compare with the paper: run {COMPARABLE_S:g} s."
    else:
        step, command = "try your own axis", "fffo-drive init DIR"
        text = "Write the example files, and make your own axis file from one of them."
    last = Line(label="Next", text=text, command=command)
    if "PI" not in names or len(names) < 2:
        best = min(names, key=lambda name: result.metrics[name].mae)
        return Verdict(
            headline=f"{best} has the smallest mean error.",
            finding=best,
            confidence="probable",
            next_step=step,
            lines=[timing, last],
            cautions=cautions,
        )
    best = min((name for name in names if name != "PI"), key=lambda name: result.metrics[name].ise)
    own, base = result.metrics[best], result.metrics["PI"]
    if own.ise >= base.ise:
        headline = f"PI alone is best: {best} brings the ISE to {own.ise / base.ise:.2f} times that of PI."
        return Verdict(
            headline=headline,
            finding="PI alone is best",
            confidence=_confidence(result, "PI", best),
            next_step="check gains and model",
            lines=[_sizes(result, "PI"), timing, last],
            reasons=_reasons(result, names),
            cautions=cautions,
        )
    headline = (
        f"{best} takes the squared error (ISE) of PI down to {_percent(own.ise, base.ise)} "
        f"and the mean error (MAE) to {_percent(own.mae, base.mae)}."
    )
    return Verdict(
        headline=headline,
        finding=f"{best} is best",
        confidence=_confidence(result, best, "PI"),
        next_step=step,
        lines=[_sizes(result, best), _surety(result), timing, last],
        reasons=_reasons(result, names),
        cautions=cautions,
    )


def _sizes(result: BenchResult, best: str) -> Line:
    own, base = result.metrics[best], result.metrics["PI"]
    text = (
        f"Mean error {significant(own.mae)} rps (PI {significant(base.mae)} rps), largest {significant(own.max)} rps "
    )
    return Line(label="How big", text=text + f"(PI {significant(base.max)} rps), over {result.data.duration_s:g} s.")


def _surety(result: BenchResult) -> Line:
    ends = result.margins.get("PI", {}).get("ise")
    if ends is None:
        return Line(label="How sure", text="The run is too short for an interval.")
    text = f"The squared error of PI is {significant(ends.low, 2)} to {significant(ends.high, 2)} times the smallest"
    return Line(label="How sure", text=f"{text}, over parts of the profile (95 %).")


def _confidence(result: BenchResult, better: str, worse: str) -> Confidence:
    """Certain where the interval of the ISE ratio excludes 1 and the machine kept time."""
    ends = result.margins.get(worse, {}).get("ise")
    if ends is None or better != min(result.metrics, key=lambda name: result.metrics[name].ise):
        return "probable"
    if ends.low <= 1.0:
        return "cannot tell"
    return "probable" if timing_cautions(result) else "certain"


def _timing(result: BenchResult) -> str:
    untimely = _untimely(result)
    worst = max(untimely, key=lambda name: untimely[name])
    return f"Up to {100.0 * untimely[worst]:.2g} % of the ticks were late or skipped ({worst})."


def _reasons(result: BenchResult, names: list[str]) -> list[str]:
    """Whether the controllers come in the paper's order, one sentence for all metrics that agree."""
    paper = [name for name in PAPER_TABLE_2 if name in names]
    if len(paper) < 3:
        return []
    by_order: dict[str, list[str]] = {}
    for key in ErrorMetrics._fields:
        ranking = sorted(paper, key=lambda name: getattr(result.metrics[name], key))
        published = sorted(paper, key=lambda name: PAPER_TABLE_2[name][key])
        order = f"{' < '.join(ranking)}, {'as' if ranking == published else 'unlike'} in the paper"
        by_order.setdefault(order, []).append(key.upper())
    return [f"{', '.join(keys)}: {order}." for order, keys in by_order.items()]


def timing_cautions(result: BenchResult) -> list[str]:
    """What makes the comparison doubtful: a machine that was too busy, feedback or rows that are missing."""
    due = {name: ticks.ticks + ticks.skipped for name, ticks in result.ticks.items()}
    untimely = _untimely(result)
    unanswered = {name: ticks.missing_feedback / due[name] for name, ticks in result.ticks.items()}
    cautions = []
    if max(untimely.values()) > SOUND_LATE_SHARE:
        cautions.append(f"Ticks late or skipped: {_shares(untimely)}.")
        if max(untimely.values()) > 2.0 * min(untimely.values()):
            cautions.append(
                "The runs did not have the same timing; repeat them on a less busy machine for a better comparison."
            )
    if max(unanswered.values()) > SOUND_MISSING_SHARE:
        cautions.append(f"SYNCs without feedback before the cut-off: {_shares(unanswered)}.")
    if any(result.rows_lost.values()):
        lost = ", ".join(f"{name} {rows}" for name, rows in result.rows_lost.items())
        cautions.append(f"Rows lost by the recorder: {lost}.")
    return cautions


def _untimely(result: BenchResult) -> dict[str, float]:
    """Share of the ticks that were late or skipped, by controller."""
    return {name: (t.late + t.skipped) / (t.ticks + t.skipped) for name, t in result.ticks.items()}


def _shares(shares: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {100.0 * share:.1f} %" for name, share in shares.items())


def _percent(value: float, of: float) -> str:
    return f"{significant(100.0 * value / of, 2)} %" if of > 0 else "–"


def _metrics_table(result: BenchResult) -> Table:
    percent, bases = percent_of_bases(result.metrics), bases_of(result.metrics)
    one_base = next(iter(bases.values())) if len(set(bases.values())) == 1 else "the best"
    columns: list[Heading] = []
    for name in result.metrics:
        columns += [Heading(label=label, group=name) for label in ("value", f"% of {one_base}", "paper")]
    rows = []
    for key in ErrorMetrics._fields:
        cells: list[Cell] = []
        for name, metrics in result.metrics.items():
            share = percent[name][key]
            best = getattr(metrics, key) == min(getattr(other, key) for other in result.metrics.values())
            end = result.intervals.get(name, {}).get(key)
            interval = None if end is None or name == bases[key] else (100.0 * end.low, 100.0 * end.high)
            paper = PAPER_TABLE_2.get(name, {}).get(key, float("nan"))
            cells += [
                number(getattr(metrics, key), best=best),
                _share(share, interval),
                number(paper),
            ]
        rows.append(Row(label=key.upper(), unit=METRIC_UNITS[key], cells=cells))
    return Table(
        name="metrics", title="Velocity error",
        note=f"Reference minus measured velocity over the profile. Per cent of {one_base}, as in Table II of the "
             "paper; below it the 95 % interval over the choice of parts of the profile (bootstrap of "
             f"{STRETCH_S:g} s stretches, the same for every run). MAX is one sample and has none. "
             "▸ marks the smallest.",
        corner="metric", columns=columns, rows=rows,
    )  # fmt: skip


def _share(share: float, interval: tuple[float, float] | None) -> Cell:
    if not np.isfinite(share):
        return Cell(text="–")
    low, high = interval or (None, None)
    return Cell(text=f"{share:.0f}", value=share, low=low, high=high)


def _ticks_table(result: BenchResult) -> Table:
    columns = [
        Heading(label="ticks"), Heading(label="late"), Heading(label="skipped"), Heading(label="no answer"),
        Heading(label="late answer"), Heading(label="wire errors"),
        Heading(label="median", unit="µs", group="lateness"),
        Heading(label="99 %", unit="µs", group="lateness"), Heading(label="largest", unit="µs", group="lateness"),
        Heading(label="turnaround", unit="µs, median"), Heading(label="rows lost"),
    ]  # fmt: skip
    rows = []
    for name, t in result.ticks.items():
        counts = [count(v) for v in (t.ticks, t.late, t.skipped, t.missing_feedback, t.late_feedback, t.wire_errors)]
        times = [number(v) for v in (t.lateness_us_p50, t.lateness_us_p99, t.lateness_us_max, t.turnaround_us_p50)]
        rows.append(Row(label=name, cells=[*counts, *times, count(result.rows_lost[name])]))
    return Table(
        name="ticks", title="Ticks",
        note=f"A tick is late from {result.late_us:g} µs after its deadline. A missed tick is skipped and never made "
             "up for. Wire errors: bad, dropped and error frames, losses of the bus and frames that could not be sent.",
        corner="controller", columns=columns, rows=rows,
    )  # fmt: skip


def _provenance(records: Mapping[str, BenchRecord]) -> ReportProvenance:
    parts = [part for record in records.values() for part in record.parts]
    first = parts[0]
    files = [source_log(part.path) for part in parts]
    files += [source_file(entry.name, entry.data, text=True) for entry in first.attachments.values()]
    wanted = {
        "begun": "recorded", "drive": "drive", "drive_serial": "serial", "kernels": "compiled code", "system": "system",
        "tool": "recorder",
    }  # fmt: skip
    facts = {label: first.metadata[key] for key, label in wanted.items() if key in first.metadata}
    torn = [part.reason for part in parts if not part.complete]
    return provenance(files, facts | ({"torn": "; ".join(torn)} if torn else {}))


def _results(result: BenchResult) -> dict[str, Any]:
    return {
        "metrics": {name: metrics._asdict() for name, metrics in result.metrics.items()},
        "label": result.label,
        "percent_of": bases_of(result.metrics),
        "percent": percent_of_bases(result.metrics),
        "paper_percent": PAPER_TABLE_2,
        "ratio_intervals": {
            name: {key: end._asdict() for key, end in ends.items()} for name, ends in result.intervals.items()
        },
        "ticks": {
            name: {**ticks._asdict(), "rows_lost": result.rows_lost[name]} for name, ticks in result.ticks.items()
        },
    }

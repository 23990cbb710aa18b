"""The report of an evaluation: controllers over seeds, Table II beside ours, speeds, lags, effort."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..evaluation.campaign import Cutout, Evaluation
from ..evaluation.compare import SeedInterval, ratio_interval
from ..evaluation.measures import Yardstick
from ..evaluation.metrics import METRIC_UNITS, PAPER_TABLE_2
from ..evaluation.summary import Summary, as_object
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
    number,
    significant,
)
from .figures import TIME, VELOCITY, Dash, Figure, Group, PlotAxis, Series, Uniform, grouped_bars

METRICS = {"ise": "ISE", "mae": "MAE", "max": "MAX", "std": "STD"}
KINDS = {"measured": "measured velocity", "true": "the shaft's velocity"}
PAPER_NAMES = {name.lower(): name for name in PAPER_TABLE_2}
COLOURS = ("orange", "green", "blue", "purple", "grey", "ink")
DASHES: tuple[Dash, ...] = ("solid", "dashdot", "solid", "dashed", "dotted", "solid")
LARGEST_SKIPPED_SHARE = 0.001  # of a run's samples; above this its figures depend on the machine too


class EvaluationSource(NamedTuple):
    """What is evaluated, and where it comes from."""

    title: str
    subtitle: str
    yardstick: Yardstick
    cautions: Sequence[str]
    provenance: ReportProvenance
    published: frozenset[str] = frozenset()  # laws that are run for comparison only: no controllers of the scenario


def evaluation_report(source: EvaluationSource, summary: Summary, evaluations: Sequence[Evaluation]) -> Report:
    """The report of a comparison."""
    kinds = [kind for kind in KINDS if f"{kind}.ise" in summary.figures]
    tables = [_table_2(summary)] if set(PAPER_NAMES) & set(summary.controllers) else []
    tables += [_metrics_table(summary, kind) for kind in kinds]
    tables += [_bands_table(summary, source.yardstick, kinds[-1]), _lag_table(summary, kinds), _effort_table(summary)]
    sections = [
        Section(
            "Metrics", "Means over seeds; whiskers are 95 % intervals.", tuple(_bars(summary, kind) for kind in kinds)
        ),
        Section("Cut-outs", "The first seed.", tuple(_cutouts(evaluations))),
        Section("Error histograms", "All seeds together.", tuple(_histograms(summary, source.yardstick, kinds))),
    ]
    return Report(
        kind="evaluate",
        title=source.title,
        subtitle=source.subtitle,
        verdict=_verdict(source, summary, evaluations, kinds),
        tables=tuple(tables),
        sections=tuple(section for section in sections if section.figures),
        provenance=source.provenance,
        results=as_object(summary),
    )


def _verdict(
    source: EvaluationSource, summary: Summary, evaluations: Sequence[Evaluation], kinds: Sequence[str]
) -> Verdict:
    """By the measured velocity, which a real axis has too."""
    kind = kinds[0]
    comparison = summary.figures[f"{kind}.ise"]
    ranking = sorted(summary.controllers, key=lambda name: comparison.absolute[name].value)
    cautions = [*source.cautions, *summary.failures]
    cautions += [
        f"{run.candidate}, seed {run.seed}: the loop skipped {100.0 * run.skipped_share:.2g} % of the ticks."
        for run in evaluations
        if run.skipped_share > LARGEST_SKIPPED_SHARE
    ]
    if len(summary.seeds) < 2:
        cautions.append("Only one seed: there are no intervals.")
    if len(ranking) < 2:
        headline = f"{ranking[0]} is the only controller."
    else:
        share = comparison.absolute[ranking[0]].value / comparison.absolute[ranking[-1]].value
        headline = (
            f"{ranking[0]} has the smallest squared error against {KINDS[kind]}: {significant(100.0 * share)} % of "
            f"that of {ranking[-1]}."
        )
    orders = [_order(summary, one) for one in kinds]
    best = ranking[0]
    lines = [_size(summary, kind, best)]
    if len(ranking) > 1:
        lines.append(_surety(summary, kind, best, ranking[1]))
    confidence = _confidence(summary, kind, ranking)
    if len(summary.seeds) < 2:
        step, text = (
            "run more seeds",
            "Run several seeds, or record several runs of each: a single one shows no scatter.",
        )
    elif confidence == "cannot tell":
        step = "run more seeds"
        text = f"Run more seeds, or record more runs: these do not decide between {best} and {ranking[1]}."
    elif best in source.published:
        step = "compare"
        own = next((name for name in ranking if name not in source.published), "none")
        text = f"{best} is run for comparison only. The best of the scenario's own controllers is {own}."
    else:
        step, text = "use it", f"Put toggle and gains of {best} into the axis file, and try it with fffo-drive run."
    return Verdict(
        headline=headline, finding=f"{best} is best" if len(ranking) > 1 else best,
        confidence=confidence, next_step=step,
        lines=[*lines, Line(label="Next", text=text)], reasons=orders, cautions=cautions,
    )  # fmt: skip


def _order(summary: Summary, kind: str) -> str:
    values = summary.figures[f"{kind}.ise"].absolute
    return f"ISE against {KINDS[kind]}: {' < '.join(sorted(summary.controllers, key=lambda name: values[name].value))}."


def _size(summary: Summary, kind: str, best: str) -> Line:
    mean, largest = (summary.figures[f"{kind}.{key}"].absolute[best].value for key in ("mae", "max"))
    text = f"Mean error {significant(mean)} rps, largest {significant(largest)} rps, over {len(summary.seeds)} seed"
    return Line(label="How big", text=text + ("." if len(summary.seeds) == 1 else "s."))


def _surety(summary: Summary, kind: str, best: str, second: str) -> Line:
    ratio = _ratio_of(summary, kind, second, best)
    if not math.isfinite(ratio.low):
        return Line(label="How sure", text="Only one seed: there is no interval.")
    text = f"The squared error of {second}, the next best, is {significant(100.0 * ratio.low)} to "
    return Line(label="How sure", text=f"{text}{significant(100.0 * ratio.high)} % of it, over seeds (95 %).")


def _ratio_of(summary: Summary, kind: str, one: str, other: str) -> SeedInterval:
    """ISE of one controller over that of another, in runs with the same noise; with a single seed the ends are NaN."""
    values = summary.figures[f"{kind}.ise"].values
    return ratio_interval(values[one], values[other])


def _confidence(summary: Summary, kind: str, ranking: Sequence[str]) -> Confidence:
    """Certain where the interval of the ratio to the next best excludes 1."""
    if len(ranking) < 2 or len(summary.seeds) < 2:
        return "probable"
    return "certain" if _ratio_of(summary, kind, ranking[1], ranking[0]).low > 1.0 else "cannot tell"


def _cell(interval: SeedInterval, best: bool = False) -> Cell:
    if not np.isfinite(interval.low):
        return number(interval.value, best=best)
    return number(interval.value, low=interval.low, high=interval.high, best=best)


def _table_2(summary: Summary) -> Table:
    """Table II: per cent of one controller, beside the paper's."""
    base = summary.figures["measured.ise"].base
    columns = []
    for title in METRICS.values():
        columns += [Heading(label="here", unit="%", group=title), Heading(label="paper", unit="%", group=title)]
    rows = []
    for controller in summary.controllers:
        published = PAPER_TABLE_2.get(PAPER_NAMES.get(controller, ""))
        cells = []
        for key in METRICS:
            comparison = summary.figures[f"measured.{key}"]
            best = min(c.value for c in comparison.absolute.values()) == comparison.absolute[controller].value
            cells.append(_cell(comparison.percent[controller], best))
            cells.append(number(published[key]) if published else Cell(text="–"))
        rows.append(Row(label=controller, cells=cells))
    note = (
        _interval_note(summary, f"Percentage of {base} over seeds")
        + " MAX is one sample of a run: its order may change from seed to seed."
    )
    return Table(
        name="table-2", title="Beside the paper's Table II", note=note, corner="Control", columns=columns, rows=rows
    )


def _metrics_table(summary: Summary, kind: str) -> Table:
    columns = [Heading(label=title, unit=METRIC_UNITS[key]) for key, title in METRICS.items()]
    return Table(
        name=f"metrics-{kind}", title=f"Error against {KINDS[kind]}", corner="Control", columns=columns,
        note=_interval_note(summary, "Mean over seeds, which differ in noise and, for a multi-sine, in the reference"),
        rows=_rows(summary, [f"{kind}.{key}" for key in METRICS]),
    )  # fmt: skip


def _rows(summary: Summary, names: Sequence[str]) -> list[Row]:
    return [
        Row(label=controller, cells=[_interval_cell(summary, name, controller) for name in names])
        for controller in summary.controllers
    ]


def _interval_cell(summary: Summary, name: str, controller: str) -> Cell:
    missing = missing_text(summary, name, controller)
    return Cell(text=missing) if missing else _cell(summary.figures[name].absolute[controller])


def missing_text(summary: Summary, name: str, controller: str) -> str:
    """Why a controller has no such figure, in a few words; empty if it has one.

    A figure is compared only if every run of every controller has it.
    """
    kind, part, key = (*name.split("."), "")[:3]
    absent = name not in summary.figures
    if part in ("reversals", "lag") and key != "missed":
        count, missed = (
            summary.figures[f"{kind}.lag.{one}"].absolute[controller].value for one in ("reversals", "missed")
        )
        if count == 0.0:
            return "no reversal"
        if count == 1.0 and key.startswith("p95"):
            return "1 reversal"
        if absent and part == "lag" and missed == count:
            return "all missed"
    if not absent:
        return ""
    if kind == "effort":
        return "run too short, or rate too low"
    return "not reached" if part.startswith("band") and len(summary.seeds) == 1 else "not in every run"


def _interval_note(summary: Summary, text: str) -> str:
    """Note under a table: what its numbers are, and whether they have intervals."""
    return f"{text}; one seed: no intervals." if len(summary.seeds) == 1 else f"{text}, below it its 95 % interval."


def _bands_table(summary: Summary, yardstick: Yardstick, kind: str) -> Table:
    edges = yardstick.band_edges_rps
    columns = [Heading(label="near reversals", unit="rps")]
    for low, high in itertools.pairwise(edges):
        label = f"above {low:g}" if high == edges[-1] else f"{low:g} to {high:g}"
        columns.append(Heading(label=label, unit="rps", group="by the reference's speed"))
    names = [f"{kind}.reversals.mae", *(f"{kind}.band{n}.mae" for n in range(len(edges) - 1))]
    return Table(
        name="bands", title=f"MAE by speed, against {KINDS[kind]}", corner="Control", columns=columns,
        note="Near reversals: within 25 ms of a change of direction of the reference. "
        + _interval_note(summary, "Mean over seeds"),
        rows=_rows(summary, names),
    )  # fmt: skip


def _lag_table(summary: Summary, kinds: Sequence[str]) -> Table:
    parts = {
        "mean_absolute_ms": ("mean |lag|", "ms"),
        "p95_absolute_ms": ("95 % of |lag|", "ms"),
        "missed": ("missed", ""),
    }
    columns = [Heading(label=a, unit=b, group=KINDS[kind]) for kind in kinds for a, b in parts.values()]
    names = [f"{kind}.lag.{part}" for kind in kinds for part in parts]
    total = summary.figures.get("measured.lag.reversals")
    mean = next(iter(total.absolute.values())).value if total else math.nan
    count = f"{mean:.0f} reversal{'' if mean == 1.0 else 's'} a run. " if total else ""
    note = (
        f"{count}Delay of the axis's reversal after that of the reference; missed: later than 0.1 s or half way to "
        f"the next reversal, or never. {_interval_note(summary, 'Mean over seeds')}"
    )
    return Table(
        name="lag", title="Lag at reversals", note=note, corner="Control", columns=columns, rows=_rows(summary, names)
    )


def _effort_table(summary: Summary) -> Table:
    parts = {
        "rms_a": ("rms", "A"), "high_rms_a": ("above 100 Hz", "A"), "noise_rms_a": ("above 200 Hz", "A"),
        "variation_a_per_s": ("mean variation", "A/s"),
    }  # fmt: skip
    return Table(
        name="effort", title="Control effort", corner="Control", note="Command on the bus.",
        columns=[Heading(label=a, unit=b) for a, b in parts.values()],
        rows=_rows(summary, [f"effort.{part}" for part in parts]),
    )  # fmt: skip


def _bars(summary: Summary, kind: str) -> Figure:
    groups = {}
    marks: dict[str, list[float]] = {}
    for number_, controller in enumerate(summary.controllers):
        intervals = [summary.figures[f"{kind}.{key}"].percent[controller] for key in METRICS]
        groups[controller] = Group(
            [i.value for i in intervals], COLOURS[number_ % len(COLOURS)], [i.low for i in intervals],
            [i.high for i in intervals],
        )  # fmt: skip
        if kind == "measured" and controller in PAPER_NAMES:
            marks[controller] = [PAPER_TABLE_2[PAPER_NAMES[controller]][key] for key in METRICS]
    base = summary.figures[f"{kind}.ise"].base
    return Figure(
        name=f"bars-{kind}", kind="bars", title=f"Error against {KINDS[kind]}",
        caption=f"Per cent of {base}" + ("; markers: the paper's Table II." if marks else "."),
        x=PlotAxis("error", "-", categories=tuple(METRICS.values())), y=PlotAxis(f"share of {base}", "%"),
        series=tuple(grouped_bars(groups, marks, "paper")), width="half" if kind == "true" else "full",
    )  # fmt: skip


def _cutouts(evaluations: Sequence[Evaluation]) -> list[Figure]:
    places: dict[float, list[tuple[str, Cutout]]] = {}
    for run in evaluations:
        for cutout in run.cutouts:
            places.setdefault(cutout.start_s, []).append((run.candidate, cutout))
    figures: list[Figure] = []
    for start_s, shown in places.items():
        longest = max((cutout for _, cutout in shown), key=lambda cutout: cutout.reference_rps.size)
        grid = Uniform(start_s, longest.period_s)
        series = [Series("reference", grid, longest.reference_rps, "ink", dash="dashed")]
        for number_, (candidate, cutout) in enumerate(shown):
            look = number_ % len(COLOURS)
            series.append(Series(candidate, grid, cutout.velocity_rps, COLOURS[look], dash=DASHES[look]))
        figures.append(
            Figure(
                name=f"cutout-{len(figures) + 1}",
                kind="time",
                title=f"From {start_s:g} s",
                caption="Reference and velocity; of the shaft, if it is known.",
                x=TIME,
                y=VELOCITY,
                series=tuple(series),
                width="half",
            )
        )
    return figures


def _histograms(summary: Summary, yardstick: Yardstick, kinds: Sequence[str]) -> list[Figure]:
    figures = []
    for kind in kinds:
        series = []
        for number_, (controller, counts) in enumerate(summary.histograms[kind].items()):
            look = number_ % len(COLOURS)
            shares = 100.0 * counts / max(1, int(counts.sum()))
            series.append(
                Series(controller, yardstick.histogram_edges_rps, shares, COLOURS[look], "steps", dash=DASHES[look])
            )
        figures.append(
            Figure(
                name=f"histogram-{kind}",
                kind="histogram",
                title=f"Error against {KINDS[kind]}",
                caption="Share of all samples in each bin; the outermost bins include everything beyond.",
                x=PlotAxis("velocity error", "rps"),
                y=PlotAxis("share of samples", "%"),
                series=tuple(series),
                width="half",
            )
        )
    return figures

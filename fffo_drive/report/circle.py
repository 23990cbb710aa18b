"""The report of a circle: what was found and adopted, and the tracking error before and after.

report.json is the usual one; its `results` are `as_object`, of the format `circle`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .. import formats
from ..arrays import Floats
from ..evaluation.metrics import METRIC_UNITS, ErrorMetrics, Rows, error_metrics, profile_rows
from . import bench_figures as draw
from .bench import STRETCH_S
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
    significant,
)
from .intervals import ShownInterval, ratio_intervals

KIND = "close-the-loop"
COLUMNS = {"measured": "velocity_rps", "true": "true_velocity_rps"}
KINDS = {"measured": "measured velocity", "true": "shaft's velocity"}
SOUND_SHARE = 0.01


class CircleRun(NamedTuple):
    """How one run of the circle went."""

    name: str
    rate_hz: int
    ticks: int
    lost_share: float  # skipped, or without an answer
    longest_s: float  # between two answers


class BeforeAfter(NamedTuple):
    """Metrics of the run before the adoption and of the one with it (None: there was none)."""

    before: ErrorMetrics
    after: ErrorMetrics | None


class Tracking(NamedTuple):
    """The error before and after."""

    metrics: dict[str, BeforeAfter]  # by kind: measured, and true where the drive knows the shaft
    intervals: dict[str, dict[str, ShownInterval]]  # of after over before, by kind and metric
    data: draw.BenchData


class CircleSource(NamedTuple):
    """Everything that the report is made of."""

    axis: str
    verdict: str  # of the diagnosis
    effects: tuple[str, ...]
    unexplained_rest: str  # of the diagnosis: residual that could still be explained; empty: none
    not_compensated: dict[str, str]  # of these: the reason
    gates: tuple[dict[str, Any], ...]
    model_error: dict[str, Any]  # before, after: held-out figures of the diagnosis
    tracking: Tracking
    runs: tuple[CircleRun, ...]
    provenance: ReportProvenance

    @property
    def adopted(self) -> bool:
        """The model with the effects is in service."""
        return bool(self.gates) and all(gate["passed"] for gate in self.gates)


def tracking_of(before: Rows, after: Rows | None, period_s: float, samples: int) -> Tracking:
    """Metrics of the runs over one profile of `samples`.

    The ISE is scaled to the whole profile, so that runs with different skipped ticks can be compared.
    """
    rows = {"before": before} | ({"after": after} if after is not None else {})
    metrics: dict[str, BeforeAfter] = {}
    intervals: dict[str, dict[str, ShownInterval]] = {}
    for kind, column in COLUMNS.items():
        errors = {name: _error(run, column, samples) for name, run in rows.items()}
        if any(not np.isfinite(error).any() for error in errors.values()):
            continue
        found = [_metrics(error, period_s) for error in errors.values()]
        metrics[kind] = BeforeAfter(found[0], found[1] if after is not None else None)
        if after is not None:
            against = dict.fromkeys(ErrorMetrics._fields, "before")
            stretch = max(1, round(STRETCH_S / period_s))
            intervals[kind] = ratio_intervals(errors, against, stretch).get("after", {})
    return Tracking(metrics, intervals, draw.bench_data(rows, period_s, samples))


def _error(rows: Rows, column: str, samples: int) -> Floats:
    """Reference minus velocity on the profile's grid, NaN where a tick was skipped. (samples,)"""
    inside = profile_rows(rows, samples)
    grid = np.full(samples, np.nan)
    grid[inside["profile_sample"]] = inside["reference_rps"] - inside[column]
    return grid


def _metrics(error_rps: Floats, period_s: float) -> ErrorMetrics:
    known = error_rps[np.isfinite(error_rps)]
    found = error_metrics(known, period_s)
    return found._replace(ise=found.ise * error_rps.size / known.size)


def as_object(source: CircleSource) -> dict[str, Any]:
    """The circle for programs."""
    tracking: dict[str, Any] = {}
    for name in ("before", "after"):
        pairs = {kind: getattr(pair, name) for kind, pair in source.tracking.metrics.items()}
        if all(found is not None for found in pairs.values()):
            tracking[name] = {kind: found._asdict() for kind, found in pairs.items()}
    if "after" in tracking:
        tracking["ratio"] = {
            kind: {
                key: {
                    "value": _ratio(pair, key),
                    "interval_95": list(ends) if (ends := source.tracking.intervals[kind].get(key)) else None,
                }
                for key in ErrorMetrics._fields
            }
            for kind, pair in source.tracking.metrics.items()
        }
    return {
        "format": formats.CIRCLE.word,
        "axis": source.axis,
        "verdict": source.verdict,
        "effects": list(source.effects),
        "unexplained_rest": source.unexplained_rest or None,
        "not_compensated": source.not_compensated,
        "adopted": source.adopted,
        "gates": list(source.gates),
        "tracking": tracking,
        "model_error": source.model_error,
        "runs": [run._asdict() for run in source.runs],
    }


def _ratio(pair: BeforeAfter, key: str) -> float | None:
    before = float(getattr(pair.before, key))
    return None if pair.after is None or before == 0.0 else float(getattr(pair.after, key)) / before


def circle_report(source: CircleSource) -> Report:
    """The report of a circle."""
    data = source.tracking.data
    cutouts = draw.choose_cutouts(data.reference_rps, data.period_s)
    sections = (
        Section("Tracking", "At reversals.", tuple(draw.cutout_figures(data, cutouts))),
        Section(
            "Error", "Reference minus measured velocity.",
            (*draw.error_figures(data), *draw.histogram_figures(data), draw.exceedance_figure(data)),
        ),
    )  # fmt: skip
    tables = [_tracking_table(source.tracking), _runs_table(source.runs)]
    if source.gates:
        tables.insert(1, _gates_table(source.gates))
    return Report(
        kind=KIND,
        title=f"{source.axis}: find, adopt, run again",
        subtitle="Run, record, diagnose, adopt, run again. The page of the diagnosis is diagnosis/report.html.",
        verdict=_verdict(source),
        opening="exceedance",
        tables=tuple(tables),
        sections=sections,
        provenance=source.provenance,
        results=as_object(source),
    )


def _verdict(source: CircleSource) -> Verdict:
    pair = source.tracking.metrics["measured"]  # all that a real axis has
    served = [name for name in source.effects if name not in source.not_compensated]
    names = ", ".join(served if source.adopted else source.effects)
    confidence: Confidence = "certain"
    finding, step = "nothing missing", "nothing to do"
    if source.verdict == "nothing_carries_over":
        finding, step = "nothing confirmed", "keep the model"
        headline = "Nothing that was found lowers the error of the held-out run: the model is unchanged."
    elif not source.effects:
        headline = "The diagnosis found nothing that the model lacks: the model is unchanged."
    elif not source.adopted:
        finding, step = "found, not adopted", "see the gates"
        refused = ", ".join(gate["name"] for gate in source.gates if not gate["passed"])
        headline = f"Found: {names}. Not adopted: {refused}."
    elif pair.after is None:
        confidence = "cannot tell"
        finding, step = "adopted", "run again"
        headline = f"Found and adopted: {names}. No run was made with it."
    else:
        change = 100.0 * (pair.after.ise / pair.before.ise - 1.0)
        confidence = _confidence(source.tracking)
        if confidence == "cannot tell":
            finding, step = "adopted, no clear change", "run longer"
        else:
            finding, step = ("adopted, better", "run with it") if change < 0.0 else ("adopted, worse", "roll back")
        word = "falls" if change < 0.0 else "rises"
        headline = f"Found and adopted: {names}. The squared tracking error {word} by {abs(change):.0f} %."
    lines = [Line(label="How big", text=_size(source.tracking))] if pair.after is not None else []
    reasons = []
    held_out = [(source.model_error.get(key) or {}).get("held_out") for key in ("before", "after")]
    errors = [figures["torque_relative_percent"] for figures in held_out if figures]
    if source.effects and len(errors) == len(held_out):
        old, new = ("not finite" if error is None else f"{error:.2f}" for error in errors)  # JSON has no NaN
        reasons.append(
            f"Torque error of the model on the held-out run: {old} to {new} % of the torque that the axis needs."
        )
    reasons += [f"Not compensated: {name}: {reason}." for name, reason in source.not_compensated.items()]
    cautions = _cautions(source.runs)
    if source.unexplained_rest:
        cautions.append(f"Not explained: {source.unexplained_rest}.")
    lines += [Line(label="Model", text=text) for text in reasons[:1]]
    lines.append(_next(step))
    return Verdict(
        headline=headline, finding=finding, confidence=confidence, next_step=step, alarm=step == "roll back",
        lines=lines, reasons=reasons[1:], cautions=cautions,
    )  # fmt: skip


def _confidence(tracking: Tracking) -> Confidence:
    """Certain where the interval of the ISE ratio excludes 1."""
    ends = tracking.intervals["measured"].get("ise")
    if ends is None:
        return "probable"
    return "cannot tell" if ends.low <= 1.0 <= ends.high else "certain"


def _size(tracking: Tracking) -> str:
    """Mean and largest error before and after, as measured; of the shaft where the drive is simulated."""
    texts = []
    for kind, pair in tracking.metrics.items():
        if pair.after is not None:
            old, new = pair.before, pair.after
            texts.append(
                f"{KINDS[kind]}: mean error {significant(old.mae)} to {significant(new.mae)} rps, largest "
                f"{significant(old.max)} to {significant(new.max)} rps"
            )
    return f"{'; '.join(texts)}.".capitalize()


def _next(step: str) -> Line:
    if step == "roll back":
        command = "fffo-drive adopt --rollback --axis axis.yaml"
        return Line(label="Next", text="The axis is worse with it: take it out of service.", command=command)
    if step == "run with it":
        command = "fffo-drive adopt diagnosis/model.yaml --axis AXIS.yaml"
        return Line(label="Next", text="The new axis file in this directory uses it. To adopt it in your axis "
                                       "file, through the same gates:",
                    command=command)  # fmt: skip
    texts = {
        "see the gates": "The table of gates gives the reason; the page of the diagnosis is diagnosis/report.html.",
        "run longer": "A longer profile shows whether it helps.",
        "run again": "Run the new axis file in this directory again, on a less busy machine.",
        "keep the model": "The model in service stays.",
        "nothing to do": "Nothing to do: the model in service stays.",
    }
    return Line(label="Next", text=texts[step])


def _cautions(runs: Sequence[CircleRun]) -> list[str]:
    lost = [f"{run.name} {100.0 * run.lost_share:.1f} %" for run in runs if run.lost_share > SOUND_SHARE]
    return [f"Ticks skipped or without feedback: {', '.join(lost)}."] if lost else []


def _tracking_table(tracking: Tracking) -> Table:
    columns = [
        Heading(label=label, unit=unit, group=KINDS[kind])
        for kind in tracking.metrics
        for label, unit in (("before", ""), ("after", ""), ("after over before", ""))
    ]
    rows = []
    for key, unit in METRIC_UNITS.items():
        cells: list[Cell] = []
        for kind, pair in tracking.metrics.items():
            cells.append(number(getattr(pair.before, key)))
            ratio = _ratio(pair, key)
            if pair.after is None or ratio is None:
                cells += [Cell(text="–")] * 2
                continue
            ends = tracking.intervals[kind].get(key)
            cells.append(number(getattr(pair.after, key)))
            cells.append(number(ratio, low=ends.low if ends else None, high=ends.high if ends else None))
        rows.append(Row(label=key.upper(), unit=unit, cells=cells))
    note = (
        "Reference minus velocity over the file's profile, without and with the adopted model. Below the ratio its "
        f"95 % interval over the choice of parts of the profile ({STRETCH_S:g} s stretches, the same for both runs)."
    )
    return Table(name="tracking", title="Tracking error", note=note, corner="metric", columns=columns, rows=rows)


def _gates_table(gates: Sequence[dict[str, Any]]) -> Table:
    columns = [Heading(label="", words=True), Heading(label="found", words=True)]
    rows = [
        Row(label=gate["name"], cells=[Cell(text="passed" if gate["passed"] else "refused"), Cell(text=gate["text"])])
        for gate in gates
    ]
    note = "Conditions that a model must meet before it goes into service."
    return Table(name="gates", title="Gates", note=note, corner="gate", columns=columns, rows=rows)


def _runs_table(runs: Sequence[CircleRun]) -> Table:
    columns = [
        Heading(label="rate", unit="Hz"), Heading(label="ticks"), Heading(label="skipped or no feedback", unit="%"),
        Heading(label="longest silence", unit="ms"),
    ]  # fmt: skip
    rows = [
        Row(
            label=run.name,
            cells=[
                count(run.rate_hz), count(run.ticks), number(100.0 * run.lost_share), number(1e3 * run.longest_s)
            ],
        )
        for run in runs
    ]  # fmt: skip
    return Table(name="runs", title="Runs", note="The recordings are in this directory.", corner="run",
                 columns=columns, rows=rows)  # fmt: skip

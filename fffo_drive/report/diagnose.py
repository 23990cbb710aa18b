"""The report of a diagnosis: what the model lacks, the confidence, possible confusions, and the error removed.

The page comes from a `Diagnosis`; report.json beside it is the stable schema of `diagnosis.results.report`, with `kind`
added, so that programs read one file and people the other.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ..diagnosis.gates import NEGLIGIBLE
from ..diagnosis.results import Diagnosis, ErrorFigures, Finding, Interval, report
from ..documents import as_json
from ..identification.runs import Estimate, RunsLook
from ..model.parameters import ModelFile
from ..symbols import FRICTION, SYMBOLS
from ..units import NORMAL_95, inertia_kg_m2
from .diagnose_figures import PAIR, DiagnosisWords, channel_figure, effect_figures, run_figures, words_of
from .diagnose_verdict import diagnosis_verdict, lead_first, names_of
from .document import (
    Cell,
    Heading,
    Listing,
    Report,
    ReportProvenance,
    Row,
    Section,
    Table,
    count,
    number,
    significant,
)
from .page import JSON_NAME, PAGE_NAME, ReportPaths, render_page
from .population import DASH, population_table

KIND = "diagnose"
WIDEST = 1e3  # half an interval over its value; beyond this the data do not determine the parameter
SHOWN_RIVALS = 4
SHOWN_PAIRS = 6
SHOWN_REJECTED = 15
LISTING_WIDTH = 110
NOT_FINITE = Cell(text="not finite")
NOT_DETERMINED = Cell(text="not determined")
GAINS = (
    "Explains: share of the squared residual of the fit runs that the other effects leave, outliers counted "
    "linearly. Gain: log-likelihood given the other effects, on rows that were not fitted (blocks of the fit runs in "
    "turn), and on the held-out runs; 95 % intervals. p, over the entire search: the probability that noise "
    f"and an effect of {100.0 * NEGLIGIBLE:g} % of the torque look like this."
)
FROM_PRIOR = (
    " Inertia, viscous and Coulomb friction have the population as prior: it "
    "supplies what the runs determine poorly. It decides no finding: the base model is projected out of the evidence "
    "of every effect. The intervals are those of the runs alone."
)
FORM = (
    "How the friction differs from that of a single 2SEP surface. This is part of the model, not an additional effect."
)


class DiagnosisSource(NamedTuple):
    """What is diagnosed, and where it comes from."""

    name: str
    provenance: ReportProvenance
    model_path: str = ""  # of the updated model file; empty where none was written
    data: Section | None = None  # what the fitted runs can show, of report.coverage


def write_diagnosis_report(source: DiagnosisSource, diagnosis: Diagnosis, directory: Path) -> ReportPaths:
    """Write report.html and report.json into a directory that exists."""
    paths = ReportPaths(directory / PAGE_NAME, directory / JSON_NAME)
    page = diagnosis_report(source, diagnosis)
    paths.page.write_text(render_page(page), encoding="utf-8")
    content = {
        "kind": KIND,
        **report(diagnosis),
        "opening": page.verdict.model_dump(mode="json"),
        "provenance": source.provenance.model_dump(mode="json"),
    }
    paths.json.write_text(json.dumps(as_json(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n", "utf-8")
    return paths


def diagnosis_report(source: DiagnosisSource, diagnosis: Diagnosis) -> Report:
    """The report of a diagnosis."""
    words = words_of(diagnosis)
    accepted = [finding for finding in diagnosis.findings if finding.accepted]
    rejected = [finding for finding in diagnosis.findings if not finding.accepted]
    effects, forms = ([f for f in accepted if f.is_form is form] for form in (False, True))
    tables = [_found("found", "What the model lacks", words.text(GAINS), effects, words)] if effects else []
    tables += [_found("form", "Form of the friction", FORM, forms, words)] if forms else []
    tables += [_before_after(diagnosis, accepted, words)]
    parameters = _parameters(accepted, words)
    tables += [parameters] if parameters.rows else []
    tables += [_rivals(accepted)] if any(finding.rivals for finding in accepted) else []
    tables += [_channels(diagnosis, words)] if diagnosis.channels else []
    tables += [_rejected(rejected)] if rejected else []
    tables += [_runs(diagnosis.runs_look, words)] if diagnosis.runs_look is not None else []
    tables += [_base(diagnosis, words)]
    tables += [] if diagnosis.prior is None else [population_table(diagnosis.prior)]
    channels = channel_figure(diagnosis.channels, words)
    sections: tuple[Section, ...] = (
        Section(
            "Evidence",
            "Each effect over the quantity that it depends on.",
            effect_figures(lead_first(accepted), words),
        ),
        Section(
            "Before and after",
            f"Residual {words.torque} of each run: of the base model, and with everything that was added.",
            run_figures(diagnosis.runs, words),
        ),
        Section(
            "What the residual depends on",
            "Before and after, by the quantity that the residual depends on.",
            (channels,) if channels else (),
        ),
    )
    if source.data is not None:
        sections = (*sections, source.data)
    runs = f"fitted on {names_of(diagnosis.fit_names)}" + (
        f", held out {names_of(diagnosis.held_out_names)}" if diagnosis.held_out_names else ", no run held out"
    )
    return Report(
        kind=KIND,
        title=f"Diagnosis of {source.name}",
        subtitle=f"{runs}; {diagnosis.seconds:.0f} s of computing.",
        verdict=diagnosis_verdict(diagnosis, source.model_path),
        tables=tuple(tables),
        sections=tuple(section for section in sections if section.figures),
        provenance=source.provenance,
        listings=(*_reasons(accepted), *_experiments(accepted)),
    )


def _found(name: str, title: str, note: str, accepted: Sequence[Finding], words: DiagnosisWords) -> Table:
    columns = [
        Heading(label="explains", unit="%"),
        Heading(label="fitted runs", unit="nats", group="gain"),
        Heading(label="held out", unit="nats", group="gain"),
        Heading(label="size", unit="% of friction"),
        Heading(label="false alarm", unit="p"),
        Heading(label="not distinguishable from", words=True),
        Heading(label="axis", words=True),
        Heading(label="feed-forward", words=True),
    ]
    rows = [
        Row(
            label=finding.name,
            cells=[
                number(100.0 * finding.explained_fraction),
                _gain(finding.gain),
                _gain(finding.held_out_gain),
                number(finding.strength_percent),
                number(finding.false_alarm_probability, 2),
                Cell(text=", ".join(finding.alternatives) or ("its name is in doubt" if finding.doubt else "–")),
                Cell(text=words.axis(_axes(finding))),
                Cell(text="compensates it" if finding.compensable else "cannot"),
            ],
        )
        for finding in accepted
    ]
    return Table(name=name, title=title, note=note, corner="Effect", columns=columns, rows=rows)


def _gain(found: tuple[float, float] | None) -> Cell:
    if found is None:
        return DASH
    value, sd = found
    if not (math.isfinite(value) and math.isfinite(sd)):
        return NOT_FINITE
    return number(value, 3, value - NORMAL_95 * sd, value + NORMAL_95 * sd)


def _interval(found: Interval | None) -> Cell:
    if found is None:
        return DASH
    if not math.isfinite(found.value):
        return NOT_FINITE
    if not (math.isfinite(found.low) and math.isfinite(found.high)):
        return number(found.value)
    return number(found.value, low=found.low, high=found.high)


def _scaled(found: Interval, factor: float) -> Interval:
    return Interval(found.value * factor, found.low * factor, found.high * factor)


def _errors(figures: ErrorFigures | None, words: DiagnosisWords) -> list[Cell]:
    if figures is None:
        return [DASH] * 3
    torque = _scaled(figures.torque_rms_nm, words.torque_scale)
    velocity = _scaled(figures.velocity_rms_rps, words.speed_scale)
    simulated = velocity.value != 0.0  # of whole runs, and no part of them
    return [_interval(figures.torque_relative_percent), _interval(torque), _interval(velocity) if simulated else DASH]


def _before_after(diagnosis: Diagnosis, accepted: Sequence[Finding], words: DiagnosisWords) -> Table:
    labels = [(words.torque, "%"), (words.torque, words.small_torque), ("velocity", words.small_speed)]
    columns = [Heading(label=a, unit=b, group=group) for group in ("before", "after") for a, b in labels]
    names = {finding.name for finding in accepted}
    pairs = [("held out", diagnosis.before, diagnosis.after)]
    pairs += [(f.name, f.regime_before, f.regime_after) for f in accepted]
    pairs.append(("fitted runs", diagnosis.fit_before, diagnosis.fit_after))
    rows = [
        Row(
            label=label,
            unit=f"{before.seconds:.3g} s" if before else "hardly acts in it",
            cells=_errors(before, words) + _errors(after, words),
        )
        for label, before, after in pairs
        if before is not None or label in names
    ]
    ceiling = diagnosis.ceiling
    floor = ""
    if ceiling.noise_rms_nm is not None:
        rms = significant(ceiling.noise_rms_nm * words.torque_scale)
        floor = f" Part that does not repeat: {rms} {words.small_torque} rms."
    note = (
        f"Residual {words.torque}, of the {words.torque} that the axis needs and as rms. Velocity error over windows "
        f"of 0.25 and 0.5 s: the {words.torque} residual, integrated with the model's {words.text('inertia')} "
        f"along the measured motion, without the mean {words.torque} of each window. 95 % intervals from resampled "
        "blocks. "
        "Below the held-out runs: those parts in which each effect acts, without and with it. "
        f"{ceiling.note.capitalize()}.{floor}"
    )
    return Table(name="errors", title="Error before and after", note=note, corner="Where", columns=columns, rows=rows)


def _axes(finding: Finding) -> str:
    """The axis of a finding, or both axes of a table."""
    across = finding.curve.across if finding.curve is not None else None
    return finding.axis if across is None else f"{finding.axis} x {across}"


def _parameters(accepted: Sequence[Finding], words: DiagnosisWords) -> Table:
    rows = []
    for finding in accepted:
        for one in finding.parameters if finding.curve is None else ():
            reach = None if one.sd is None else NORMAL_95 * one.sd
            low, high = (None, None) if reach is None else (one.value - reach, one.value + reach)
            name = f"{finding.name}: {words.name(one.name, one.unit)}" + (f", {one.per_run}" if one.per_run else "")
            rows.append(Row(label=name, unit=words.unit(one.unit), cells=[number(one.value, 4, low, high)]))
    return Table(
        name="parameters", title="Parameters of the effects", corner="Parameter", rows=rows,
        columns=[Heading(label="value")],
        note="Refitted together with everything else; 95 % intervals where a parameter was fitted and not searched. "
        "The knots of a free curve are in the model file; its picture shows them.",
    )  # fmt: skip


def _rivals(accepted: Sequence[Finding]) -> Table:
    columns = [Heading(label="gain in its place", unit="% of its"), Heading(label="distinguished", words=True)]
    rows = [
        Row(
            label=f"{rival.name} for {finding.name}",
            cells=[
                number(100.0 / rival.loss_ratio if rival.loss_ratio > 0.0 else math.nan),
                Cell(text="no: one family" if rival.same_family else "yes"),
            ],
        )
        for finding in accepted
        for rival in finding.rivals[:SHOWN_RIVALS]
    ]
    note = (
        "Each was fitted instead of the finding, all parameters free, and compared on rows that were not "
        "fitted. One family: the gains differ by less than two standard deviations."
    )
    return Table(
        name="rivals", title="Effects that were compared with it", note=note, corner="Rival", columns=columns, rows=rows
    )


def _channels(diagnosis: Diagnosis, words: DiagnosisWords) -> Table:
    single = [channel for channel in diagnosis.channels if PAIR not in channel.name]
    pairs = [channel for channel in diagnosis.channels if PAIR in channel.name]
    pairs.sort(key=lambda channel: -max(channel.explained_before, channel.explained_after))
    columns = [
        Heading(label="explained", unit="%", group="before"),
        Heading(label="beyond chance", words=True, group="before"),
        Heading(label="explained", unit="%", group="after"),
        Heading(label="beyond chance", words=True, group="after"),
        Heading(label="samples"),
    ]  # fmt: skip
    rows = [
        Row(
            label=words.axis(channel.name),
            cells=[
                number(100.0 * channel.explained_before),
                Cell(text="yes" if channel.significant_before else "no"),
                number(100.0 * channel.explained_after),
                Cell(text="yes" if channel.significant_after else "no"),
                count(channel.samples),
            ],
        )
        for channel in [*single, *pairs[:SHOWN_PAIRS]]
    ]
    note = "Share of the squared residual that a free curve over one axis, or the mean after an event, explains."
    if pairs:
        note += (
            f" Of {len(pairs)} pairs of axes, the strongest, in addition to their single curves; report.json has all."
        )
    return Table(
        name="channels", title="What the residual depends on", note=note, corner="Axis", columns=columns, rows=rows
    )


def _rejected(rejected: Sequence[Finding]) -> Table:
    columns = [
        Heading(label="would explain", unit="%"),
        Heading(label="false alarm", unit="p"),
        Heading(label="why not", words=True),
    ]
    rows = [
        Row(
            label=finding.name,
            cells=[
                number(100.0 * finding.explained_fraction, 2),
                number(finding.false_alarm_probability, 2),
                Cell(text=finding.reason),
            ],
        )
        for finding in rejected[:SHOWN_REJECTED]
    ]
    return Table(
        name="rejected",
        title="Tried and not accepted",
        note="Candidates that were fitted and rejected: physically implausible, contradicted by the measured "
        "current, or "
        "not confirmed by other runs.",
        corner="Effect",
        columns=columns,
        rows=rows,
    )


def _runs(look: RunsLook, words: DiagnosisWords) -> Table:
    inertia = 1.0 if words.linear else inertia_kg_m2(1.0)
    columns = [
        Heading(label="M, mass" if words.linear else "J, inertia", unit="kg" if words.linear else "kg m²"),
        Heading(label="viscous", unit=words.unit("Nm/rps")), Heading(label="Coulomb", unit=words.unit("Nm")),
        Heading(label="offset", unit=words.unit("Nm")), Heading(label="moves" if words.linear else "turns", words=True),
    ]  # fmt: skip
    scales = {"inertia_nm_s2_per_rev": inertia, "viscous_nm_per_rps": 1.0, "coulomb_nm": 1.0, "offset_nm": 1.0}
    rows = [
        Row(
            label=run.name,
            cells=[
                *(_estimate(run.estimates.get(name), scale) for name, scale in scales.items()),
                Cell(text="one way" if run.turns_one_way else "both ways"),
            ],
        )
        for run in look.runs
    ]
    remarks = "".join(f" {remark.text[:1].upper()}{remark.text[1:]}." for remark in look.remarks)
    note = (
        "A rigid-body regression of each fitted run alone; runs of one axis should agree. 95 % intervals from "
        "resampled "
        f"blocks; not determined: this run alone does not determine it.{remarks}"
    )
    return Table(name="runs", title="Each run alone", note=note, corner="Run", columns=columns, rows=rows)


def _estimate(one: Estimate | None, scale: float) -> Cell:
    if one is None or not one.determined or not math.isfinite(one.value):
        return NOT_DETERMINED
    value, reach = scale * one.value, NORMAL_95 * scale * one.sd
    return number(value, 4, value - reach, value + reach)


def _base(diagnosis: Diagnosis, words: DiagnosisWords) -> Table:
    return Table(
        name="base", title="Base model", corner="Parameter",
        rows=base_rows((diagnosis.model_before, diagnosis.model_after), words),
        columns=[Heading(label="before"), Heading(label="with the effects")],
        note="All are refitted with each effect; 95 % intervals where a parameter was fitted."
        + (FROM_PRIOR if diagnosis.prior is not None and not diagnosis.prior.other_population else ""),
    )  # fmt: skip


def base_rows(models: Sequence[ModelFile | None], words: DiagnosisWords) -> list[Row]:
    """Parameters of base models side by side; a dash where there is no model."""

    def row(label: str, unit: str, name: str, factor: float = 1.0) -> Row:
        cells = [DASH if model is None else _quantity(model, name, factor) for model in models]
        return Row(label=label, unit=unit, cells=cells)

    if words.linear:  # the file keeps kg m² at 2 pi; the mass is what people know
        inertia = row("M, mass", "kg", "inertia_kg_m2", 2.0 * math.pi)
    else:
        inertia = row(SYMBOLS["inertia_nm_s2_per_rev"].label, "kg m²", "inertia_kg_m2")
    delay = row(SYMBOLS["delay_s"].label, "ms", "delay_s", 1e3)
    return [inertia, delay, *(row(one.label, words.unit(one.unit), name) for name, one in FRICTION.items())]


def _quantity(model: ModelFile, name: str, factor: float) -> Cell:
    quantity = getattr(model, name) if hasattr(model, name) else getattr(model.friction, name)
    value = quantity.value * factor
    if quantity.sd is None:
        return number(value, 4)
    reach = NORMAL_95 * quantity.sd * factor
    if not reach <= WIDEST * abs(value) and value != 0.0:
        return NOT_DETERMINED
    return number(value, 4, low=value - reach, high=value + reach)


def _wrapped(text: str) -> str:
    return textwrap.fill(text, LISTING_WIDTH, subsequent_indent="    ")


def _reasons(accepted: Sequence[Finding]) -> tuple[Listing, ...]:
    if not accepted:
        return ()
    text = "\n".join(_wrapped(f"{finding.name}: {finding.reason}") for finding in accepted)
    note = "Effects are chosen on the fitted runs only; the held-out runs can only reject them."
    return (Listing(name="reasons", title="Why each was accepted", note=note, text=text),)


def _experiments(accepted: Sequence[Finding]) -> tuple[Listing, ...]:
    open_ = [finding for finding in accepted if finding.alternatives]
    if not open_:
        return ()
    text = "\n".join(_wrapped(f"{names_of([f.name, *f.alternatives])}: {f.experiment}") for f in open_)
    note = "The motion that separates the members of a family; `fffo-drive run AXIS --decide EFFECT` records it."
    return (Listing(name="experiments", title="Deciding experiments", note=note, text=text),)

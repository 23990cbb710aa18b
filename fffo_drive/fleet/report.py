"""The page of a fleet: the population of each model, who stands outside, each drive's history, and what moved."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .. import formats
from ..arrays import Floats
from ..documents import counted
from ..least_squares import spectrum
from ..report.document import (
    MOST_LINES,
    Cell,
    Heading,
    Line,
    Report,
    Row,
    Section,
    Table,
    Verdict,
    count,
    number,
    of_linear_axis,
    provenance,
    significant,
)
from ..report.figures import Figure, PlotAxis, Series
from ..units import NORMAL_95
from .detector import BURN_IN
from .history import RunHistory
from .regress import PARAMETERS, SINGULAR
from .spread import LEAST_DRIVES, OUTSIDE_P, ModelSpread, Outsider, QuantitySpread
from .store import StoreStatus
from .watch import Watched, alarm_text, unwatched_text
from .words import day_of, short_of, word_of

KIND = "fleet"
SHOWN_DRIVES = 6  # of a model, whose histories are drawn: those outside first, then those with most runs
SHOWN_OUTSIDERS = 50
SHOWN_POINTS = 2000  # drives in a figure, drawn evenly from all
SHOWN_RUNS = 2000  # of a history: the last ones
LISTED_DRIVES = 100
DAY_S = 86_400.0
DRAWN = PARAMETERS[:3]  # whose histories are drawn of every drive; of one that stands outside that number, too
SMALL = 0.05  # of the largest of its unit: a median that is smaller makes no percentage


class FleetSource(NamedTuple):
    """Everything that the page is made of."""

    store: str
    status: StoreStatus
    spreads: Sequence[ModelSpread]
    histories: Mapping[str, Mapping[str, RunHistory]]  # by model and drive, of those that are drawn
    moved: Mapping[str, Watched]  # by model, of those that were watched


def shown_drives(spread: ModelSpread) -> list[str]:
    """Drives of a model whose history the page shows."""
    outside = list(dict.fromkeys(one.drive for one in spread.outsiders))
    most = [spread.drives[k] for k in np.argsort(-spread.runs, kind="stable")[:SHOWN_DRIVES]]
    return list(dict.fromkeys([*outside, *most]))[:SHOWN_DRIVES]


def fleet_report(source: FleetSource) -> Report:
    """The report of a fleet."""
    tables: list[Table] = []
    sections: list[Section] = []
    for place, spread in enumerate(source.spreads, 1):
        tables.append(_population(place, spread))
        sections.append(_population_section(place, spread))
        histories = source.histories.get(spread.model, {})
        if histories:
            sections.append(_history_section(place, spread, histories))
    tables[:0] = [*_moved(source.moved), *_outsiders(source.spreads)]
    tables.append(_drives(source.spreads))
    report = Report(
        kind=KIND,
        title=f"Fleet of {source.store.rstrip('/').rsplit('/', 1)[-1]}",
        subtitle="What the records of many runs say of drives, type by type.",
        verdict=_verdict(source),
        tables=tuple(tables),
        sections=tuple(section for section in sections if section.figures),
        provenance=provenance([], {"store": source.store}),
        results=as_object(source),
    )
    linear = bool(source.spreads) and all(spread.units == "linear" for spread in source.spreads)
    return of_linear_axis(report) if linear else report


def as_object(source: FleetSource) -> dict[str, Any]:
    """The fleet for programs."""
    return {
        "format": formats.FLEET_REPORT.word,
        "status": source.status._asdict() | {"waiting": source.status.waiting},
        "models": [spread.as_plain() for spread in source.spreads],
        "drives": [_drive_object(spread, k) for spread in source.spreads for k in _listed(spread)],
        "moved": {model: watched.as_plain() for model, watched in source.moved.items()},
    }


def _drive_object(spread: ModelSpread, k: int) -> dict[str, Any]:
    values = zip(spread.quantities, spread.values[k].tolist(), spread.sds[k].tolist(), strict=True)
    return {
        "model": spread.model, "drive": spread.drives[k], "runs": int(spread.runs[k]),
        "first": day_of(spread.first_s[k]), "last": day_of(spread.last_s[k]),
        "quantities": {name: {"value": value, "sd": sd} for name, value, sd in values if np.isfinite(value)},
    }  # fmt: skip


def _verdict(source: FleetSource) -> Verdict:
    status, spreads = source.status, source.spreads
    outsiders = sorted((one for s in spreads for one in s.outsiders), key=lambda one: -abs(one.distance))
    outside = {(spread.model, one.drive) for spread in spreads for one in spread.outsiders}
    alarms = [alarm for watched in source.moved.values() for alarm in watched.alarms]
    changed = {(model, alarm.drive) for model, watched in source.moved.items() for alarm in watched.alarms}
    doubted = {(model, doubt.drive) for model, watched in source.moved.items() for doubt in watched.doubts}
    small = [spread.model for spread in spreads if len(spread.drives) < LEAST_DRIVES]
    short = [spread.model for spread in spreads if int(spread.runs.max(initial=0)) <= BURN_IN]
    judged = len(small) < len(spreads) or len(short) < len(spreads)
    said = f"{counted(sum(len(s.drives) for s in spreads), 'drive')} of {counted(len(spreads), 'type')} in "
    said += counted(sum(int(s.runs.sum()) for s in spreads), "run")
    found = [f"{len(outside)} outside"] * bool(outside) + [f"{len(changed)} changed"] * bool(changed)
    headline = f"{said}: " + (
        f"{len(outside) or 'none'} outside of the population, {len(changed) or 'none'} changed in its own history"
        if judged
        else "too few drives and runs to judge any"
    )
    lines = [Line(label="changed", text=alarm_text(alarm)) for alarm in alarms]
    lines += [Line(label=one.drive, text=outsider_text(one)) for one in outsiders]
    if len(lines) > MOST_LINES:
        rest = len(lines) - (MOST_LINES - 1)
        lines = [*lines[: MOST_LINES - 1], Line(label="and", text=f"{rest} more, in the tables below")]
    cautions = []
    if small:
        cautions.append(f"fewer than {LEAST_DRIVES} drives make no population: {', '.join(small[:5])}")
    if short:
        cautions.append(f"no drive has more than {BURN_IN} runs, so no change can be found: {', '.join(short[:5])}")
    blind = {model: text for model, watched in source.moved.items() if (text := unwatched_text(watched))}
    cautions += [f"{text}: {', '.join(m for m in blind if blind[m] == text)}" for text in dict.fromkeys(blind.values())]
    if doubted:
        drives = counted(len(doubted), "drive")
        cautions.append(f"the records of {drives} cannot decide whether something changed: `fleet watch` says why")
    if status.waiting or status.failed:
        cautions.append(f"{status.waiting} runs have no record yet, {status.failed} make none")
    if found:
        step = f"diagnose the runs of those {' and '.join(word.split()[1] for word in found)}"
    elif status.waiting:
        step = "make the missing records (`fleet work`)"
    elif status.failed:
        step = "see why runs make no record (`fleet status`)"
    else:
        step = "nothing to do" if judged else "add drives and runs"
    rates = sorted({watched.alarms_per_drive_year for watched in source.moved.values()})
    reasons = [f"outside: further out than {100 * OUTSIDE_P:g} % of populations have any drive, in one number"]
    reasons += [f"changed: at most {rate:g} false alarms per drive and year" for rate in rates]
    return Verdict(
        headline=headline,
        finding=" and ".join(found) or ("none outside, none changed" if judged else "too little data"),
        # that nothing was found says that nothing large is there, and nothing of runs without a record
        confidence="probable" if found or (judged and not cautions) else "cannot tell",
        next_step=step,
        alarm=bool(alarms),
        lines=lines,
        reasons=reasons,
        cautions=cautions,
    )


def outsider_text(one: Outsider) -> str:
    """One number of a drive against its model's."""
    share = f" ({100.0 * (one.value / one.median - 1.0):+.0f} %)" if one.median else ""
    return f"{word_of(one.quantity)} {significant(one.value)}, the type's median {significant(one.median)}{share}"


def _population(place: int, spread: ModelSpread) -> Table:
    rows = []
    for one in spread.spreads:
        share = 100.0 * one.spread / abs(one.median) if one.median else float("nan")
        rows.append(
            Row(label=word_of(one.name), unit=one.unit, cells=[
                number(one.median, low=one.low, high=one.high), number(one.spread, 2),
                number(share, 2) if share < 1e3 else Cell(text="–"), count(one.drives),
                count(sum(out.quantity == one.name for out in spread.outsiders)),
            ])
        )  # fmt: skip
    return Table(
        name=f"population-{place}", title=f"Population of {spread.model}", corner="quantity", rows=rows,
        columns=[Heading(label="median"), Heading(label="spread"), Heading(label="spread", unit="%"),
                 Heading(label="drives"), Heading(label="outside")],
        note=f"{counted(len(spread.drives), 'drive')}, {counted(int(spread.runs.sum()), 'run')}. Below the median 5 "
        "and 95 % of the drives; the spread is between drives, robust, their own uncertainty taken out.",
    )  # fmt: skip


def _outsiders(spreads: Sequence[ModelSpread]) -> list[Table]:
    found = sorted(((s.model, one) for s in spreads for one in s.outsiders), key=lambda pair: -abs(pair[1].distance))
    if not found:
        return []
    rows = [
        Row(label=one.drive, cells=[
            Cell(text=model), Cell(text=word_of(one.quantity)),
            number(one.value, low=one.value - NORMAL_95 * one.sd, high=one.value + NORMAL_95 * one.sd),
            number(one.median), number(one.distance, 2),
        ])
        for model, one in found[:SHOWN_OUTSIDERS]
    ]  # fmt: skip
    more = f" The furthest {SHOWN_OUTSIDERS} of {len(found)}." if len(found) > SHOWN_OUTSIDERS else ""
    return [
        Table(
            name="outside", title="Who stands outside", corner="drive", rows=rows,
            columns=[Heading(label="type", words=True), Heading(label="quantity", words=True), Heading(label="value"),
                     Heading(label="median"), Heading(label="distance")],
            note=f"Distance in standard deviations of the population and the drive's own uncertainty.{more}",
        )
    ]  # fmt: skip


def _moved(moved: Mapping[str, Watched]) -> list[Table]:
    """What moved and since when, as the watch over each drive's own history has it."""
    rows = [
        Row(label=alarm.drive, cells=[Cell(text=model), Cell(text=alarm_text(alarm))])
        for model, watched in moved.items()
        for alarm in watched.alarms
    ]
    if not rows:
        return []
    return [
        Table(
            name="moved", title="What moved, and since when", corner="drive", rows=rows,
            columns=[Heading(label="type", words=True), Heading(label="change", words=True)],
            note=f"{counted(len(rows), 'alarm')}; `fffo-drive fleet watch` sets how many false ones there may be.",
        )
    ]  # fmt: skip


def _listed(spread: ModelSpread) -> Iterable[int]:
    """Drives that are listed one by one: those outside, then those with most runs."""
    outside = {one.drive for one in spread.outsiders}
    order = sorted(range(len(spread.drives)), key=lambda k: (spread.drives[k] not in outside, -spread.runs[k], k))
    return order[:LISTED_DRIVES]


def _drives(spreads: Sequence[ModelSpread]) -> Table:
    names = DRAWN
    rows = []
    for spread in spreads:
        for k in _listed(spread):
            at = [spread.quantities.index(name) for name in names]
            ends = [(spread.values[k, i], NORMAL_95 * spread.sds[k, i]) for i in at]
            cells = [number(value, low=value - reach, high=value + reach) for value, reach in ends]
            rows.append(
                Row(label=spread.drives[k], cells=[
                    Cell(text=spread.model), count(int(spread.runs[k])), Cell(text=day_of(spread.first_s[k])),
                    Cell(text=day_of(spread.last_s[k])), *cells,
                ])
            )  # fmt: skip
    units = ("Nm s²/rev", "Nm/rps", "Nm")
    return Table(
        name="drives", title="Drives", corner="drive", rows=rows,
        columns=[Heading(label="type", words=True), Heading(label="runs"), Heading(label="first", words=True),
                 Heading(label="last", words=True),
                 *(Heading(label=word_of(name), unit=unit) for name, unit in zip(names, units, strict=True))],
        note=f"All runs of a drive together, with 95 % intervals; at most {LISTED_DRIVES} drives of each type.",
    )  # fmt: skip


# ---- figures


def _population_section(place: int, spread: ModelSpread) -> Section:
    shown = [one for one in spread.spreads if one.name in PARAMETERS and _has_share(one, spread.spreads)]
    outside = {(one.drive, one.quantity) for one in spread.outsiders}
    groups: dict[str, tuple[list[float], list[float]]] = {"drives": ([], []), "outside": ([], [])}
    for place_x, one in enumerate(shown):
        column = spread.quantities.index(one.name)
        order = np.argsort(spread.values[:, column], kind="stable")
        order = order[np.isfinite(spread.values[order, column])]
        kept = set(np.linspace(0, order.size - 1, min(order.size, SHOWN_POINTS)).astype(int).tolist())
        for rank, k in enumerate(order.tolist()):
            far = (spread.drives[k], one.name) in outside
            if rank in kept or far:
                x, y = groups["outside" if far else "drives"]
                x.append(place_x + 0.7 * (rank / max(1, order.size - 1) - 0.5) if order.size > 1 else float(place_x))
                y.append(100.0 * float(spread.values[k, column]) / one.median)
    series = [
        Series(name, np.array(x), np.array(y), "orange" if name == "outside" else "blue", "points")
        for name, (x, y) in groups.items()
        if x
    ]
    if not series:
        return Section(spread.model, "", ())
    figure = Figure(
        f"population-{place}", "bars", f"Drives of {spread.model}",
        "Each drive by all of its runs, over the type's median; sorted within each quantity.",
        PlotAxis("quantity", "-", categories=tuple(short_of(one.name) for one in shown)),
        PlotAxis("of the median", "%"), tuple(series),
    )  # fmt: skip
    return Section(f"Population of {spread.model}", "Every drive against its type.", (figure,))


def _has_share(one: QuantitySpread, all_of_them: Sequence[QuantitySpread]) -> bool:
    """Whether per cent of the median mean something: it is not next to nothing beside others of its unit."""
    largest = max(abs(other.median) for other in all_of_them if other.unit == one.unit)
    return abs(one.median) > SMALL * largest


def _history_section(place: int, spread: ModelSpread, histories: Mapping[str, RunHistory]) -> Section:
    figures = []
    for drive_place, (drive, history) in enumerate(histories.items(), 1):
        name = f"history-{place}-{drive_place}"
        figures += [
            *_parameter_figures(name, drive, history, spread),
            _residual_figure(name, drive, history),
        ]
    text = "Each point is one run by itself, with its 95 % interval; the line is the type's median."
    return Section(f"Histories, {spread.model}", text, tuple(figures))


def _days(history: RunHistory) -> Floats:
    days: Floats = (history.time_s - history.time_s[0]) / DAY_S
    return days


def _parameter_figures(name: str, drive: str, history: RunHistory, spread: ModelSpread) -> list[Figure]:
    figures = []
    medians = {one.name: one for one in spread.spreads}
    outside = {one.quantity for one in spread.outsiders if one.drive == drive}
    sds = sds_of(history)
    for k, parameter in enumerate(history.names):
        if parameter not in (*DRAWN, *outside):
            continue
        sd = sds[:, k]
        known = np.flatnonzero(np.isfinite(sd))[-SHOWN_RUNS:]
        if not known.size or parameter not in medians:
            continue
        days, value, reach = _days(history)[known], history.theta[known, k], NORMAL_95 * sd[known]
        typical = np.full(2, medians[parameter].median)
        span = np.array([days[0], max(days[-1], days[0] + 1e-3)])
        figures.append(
            Figure(
                f"{name}-{k}", "xy", f"{drive}: {word_of(parameter)}", f"Run by run since {day_of(history.time_s[0])}.",
                PlotAxis("time", "days"), PlotAxis(word_of(parameter), medians[parameter].unit),
                (Series("runs", days, value, "blue", "points", low=value - reach, high=value + reach),
                 Series("median of the type", span, typical, "ink", dash="dashed")),
                width="half",
            )
        )  # fmt: skip
    return figures


def sds_of(history: RunHistory) -> Floats:
    """Standard deviations (n, p) of single runs; nan where a run does not determine a parameter."""
    found = spectrum(history.information)
    curvature = np.where(found.known(SINGULAR), found.curvature, np.inf)
    variance = np.einsum("nij,nj->ni", found.directions**2, 1.0 / curvature)
    return np.asarray(np.where(found.determined(SINGULAR), np.sqrt(variance) / found.lengths, np.nan))


def _residual_figure(name: str, drive: str, history: RunHistory) -> Figure:
    days, rms = _days(history)[-SHOWN_RUNS:], history.rms_nm[-SHOWN_RUNS:]
    return Figure(
        f"{name}-rms", "xy", f"{drive}: residual", "rms of what each run's regression leaves.",
        PlotAxis("time", "days"), PlotAxis("rms of the residual", "Nm"), (Series("runs", days, rms, "grey", "points"),),
        width="half",
    )  # fmt: skip

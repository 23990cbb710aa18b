"""Two sets of runs on one page: what differs, by how much, beyond chance or not (`difference`), and their spectra."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from .. import formats
from ..arrays import Floats
from ..documents import DocumentError, counted
from ..identification.facts import DriveFacts
from ..report.document import (
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
)
from ..report.figures import Dash, Figure, PlotAxis, Series
from ..units import NORMAL_95
from .adding import Given, entry_of
from .difference import CONFIDENCE, LARGEST_P, Difference, difference
from .history import (
    RunHistory,
    balance_of_rows,
    column_of,
    gap_of_rows,
    histories,
    history_of,
    matrix_of,
    records_of_drive,
)
from .regress import PARAMETERS, solve
from .schema import BAND_EDGES_HZ, ORDERS, table_of, unit_of
from .store import FleetStore
from .words import day_of, word_of
from .work import record_row

KIND = "fleet-compare"
RANGE = ".."
LEAST_HASH = 6  # characters of a content hash that name a run
COLOURS = ("grey", "blue")
DASHES: tuple[Dash, Dash] = ("dashed", "solid")
LONGEST_LABEL = 15  # characters below a bar


class Side(NamedTuple):
    """One of the two."""

    label: str
    records: pa.Table

    @property
    def history(self) -> RunHistory:
        """Its runs as arrays."""
        return history_of(self.records, self.label)


def side_of_file(place: str, facts: DriveFacts | None) -> Side:
    """A run's file, with its record made now. Raises DocumentError, RecordingError, OSError."""
    return Side(place, table_of([record_row(entry_of(place, Given("run", None, facts)))]))


def side_of_store(store: FleetStore, text: str, drive: str | None, model: str | None = None) -> Side:
    """Runs of a store: FROM..TO of a drive, or one by its content hash or path. Raises DocumentError."""
    if RANGE in text and drive is not None:
        begin, end = (_day(part, text) for part in text.split(RANGE, 1))
        where = pc.scalar(True) if begin is None else pc.field("start") >= begin
        where = where if end is None else where & (pc.field("start") < end)
        found = records_of_drive(store, drive, model, where=where)
        if not found.num_rows:
            raise DocumentError(f"{text}: no record of drive {drive!r} in it")
        return Side(text, found)
    if drive is not None:
        raise DocumentError(f"{text}: with --serial both are times, FROM..TO such as 2026-01-01..2026-02-01")
    known = store.records(["run", "path"]).to_pylist()
    path = str(Path(text).resolve())
    runs = {one["run"] for one in known if one["path"] in (text, path)}
    if not runs and len(text) >= LEAST_HASH:
        runs = {one["run"] for one in known if one["run"].startswith(text)}
    if len(runs) != 1:
        raise DocumentError(f"{text}: {len(runs)} runs of the store have this path, or a content hash that begins so")
    return Side(text, store.records(where=pc.field("run") == runs.pop()))


def _day(text: str, whole: str) -> datetime | None:
    if not text:
        return None
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise DocumentError(f"{whole}: {text!r} is no time: 2026-01-31, or 2026-01-31T08:00") from None
    return time if time.tzinfo is not None else time.replace(tzinfo=UTC)


def compared(first: Side, second: Side, store: FleetStore | None) -> Difference:
    """What differs, against the scatter of the model's drives in the store, else of these runs themselves.

    Raises DocumentError for sides that cannot be compared.
    """
    units = {unit for side in (first, second) for unit in side.records.column("units").to_pylist()}
    if len(units) > 1:
        raise DocumentError(f"{first.label} and {second.label}: a rotary and a linear axis have nothing to compare")
    fleet: Mapping[str, RunHistory] | None = None
    if store is not None:
        models = {model for side in (first, second) for model in side.records.column("model").to_pylist()}
        fleet = {
            f"{model} {drive}": own for model in sorted(models) for drive, own in histories(store, model).items()
        }  # fmt: skip
    return difference(first.history, second.history, fleet)


def comparison_report(first: Side, second: Side, found: Difference) -> Report:
    """The page of a comparison."""
    report = Report(
        kind=KIND, title=f"{_short(first)} and {_short(second)}",
        subtitle="Two sets of runs: what differs, by how much, beyond chance or not.",
        verdict=_verdict(found), tables=(_laws(found), _numbers(first, second), _conditions(first, second)),
        sections=(
            Section("What differs", "Each law with its interval; all of them hold together.", (_changes(found),)),
            Section("What is left", "Spectra of the residual, the mean over the runs.",
                    (_orders(first, second), _bands(first, second))),
        ),
        provenance=provenance([], {"first": first.label, "second": second.label}),
        results={"format": formats.FLEET_COMPARISON.word, "first": first.records.column("run").to_pylist(),
                 "second": second.records.column("run").to_pylist(), **found.as_plain()},
    )  # fmt: skip
    return of_linear_axis(report) if first.records.column("units")[0].as_py() == "linear" else report


def _short(side: Side) -> str:
    return side.label.rstrip("/").rsplit("/", 1)[-1]


def _verdict(found: Difference) -> Verdict:
    different = [law for law in found.laws if law.differs]
    said = f"{len(different)} of {len(found.laws)} laws differ beyond chance"
    return Verdict(
        headline=said if different else "Nothing differs beyond chance",
        finding=", ".join(law.law for law in different) or "no difference",
        confidence="probable" if different else "certain" if found.laws else "cannot tell",
        next_step="look at the runs" if different else "nothing to do",
        lines=[Line(label=law.law, text=law.text) for law in different[:3]],
        reasons=[
            f"p below {LARGEST_P:g} after a correction for the number of laws",
            f"{counted(found.runs[0], 'run')} against {found.runs[1]}",
        ],
        cautions=list(found.remarks),
    )


def _laws(found: Difference) -> Table:
    rows = [
        Row(label=law.law, cells=[
            number(100.0 * law.change, low=100.0 * law.interval[0], high=100.0 * law.interval[1]),
            Cell(text=law.scale), number(law.p, 2), Cell(text="beyond chance" if law.differs else "may be chance"),
        ])
        for law in found.laws
    ]  # fmt: skip
    return Table(
        name="laws", title="What differs", corner="law", rows=rows,
        columns=[Heading(label="change", unit="%"), Heading(label="of", words=True), Heading(label="p"),
                 Heading(label="verdict", words=True)],
        note=f"Of the second against the first; intervals hold together with {100 * CONFIDENCE:g} %.",
    )  # fmt: skip


def _numbers(first: Side, second: Side) -> Table:
    sides_of = (first, second)
    sides = [solve(balance_of_rows(side.records)) for side in sides_of]
    rows = []
    for k, name in enumerate(PARAMETERS):
        cells = [
            _with_interval(float(one.theta[k]), NORMAL_95 * float(one.sd[k]))
            if np.isfinite(one.sd[k])
            else Cell(text="–")
            for one in sides
        ]
        if any(cell.value is not None for cell in cells):
            rows.append(Row(label=word_of(name), unit=unit_of(name), cells=cells))
    gaps = [gap_of_rows(side.records) for side in sides_of]
    if any(np.isfinite(gap.gap_rev) for gap in gaps):
        cells = [_with_interval(gap.gap_rev, NORMAL_95 * gap.log_sd * gap.gap_rev) for gap in gaps]
        rows.append(Row(label="backlash", unit="rev", cells=cells))
    rows.append(Row(label="rms of the residual", unit="Nm", cells=[number(float(one.rms_nm)) for one in sides]))
    return Table(
        name="numbers", title="Both in numbers", corner="quantity", rows=rows,
        columns=[Heading(label=_short(first)), Heading(label=_short(second))],
        note="By all runs of each side together; 95 % intervals of the fit alone, without the scatter between runs.",
    )  # fmt: skip


def _with_interval(value: float, reach: float) -> Cell:
    return number(value, low=value - reach, high=value + reach) if np.isfinite(reach) else Cell(text="–")


def _conditions(first: Side, second: Side) -> Table:
    sides = (first, second)
    starts = [column_of(side.records, "duration_s") for side in sides]
    days = [side.history.time_s for side in sides]
    rows = [
        Row(label="runs", cells=[count(side.records.num_rows) for side in sides]),
        Row(label="time", unit="s", cells=[number(float(values.sum())) for values in starts]),
        Row(label="from", cells=[Cell(text=day_of(float(values.min()))) for values in days]),
        Row(label="to", cells=[Cell(text=day_of(float(values.max()))) for values in days]),
        Row(label="speed, rms", unit="rps", cells=[_mean(side, "speed_rms_rps") for side in sides]),
        Row(label="torque, rms", unit="Nm", cells=[_mean(side, "torque_rms_nm") for side in sides]),
        Row(label="temperature", unit="degC", cells=[_mean(side, "temperature_degc") for side in sides]),
    ]
    return Table(
        name="conditions", title="Under which conditions", corner="", rows=rows,
        columns=[Heading(label=_short(first)), Heading(label=_short(second))],
        note="What differs here may be why the rest does.",
    )  # fmt: skip


def _mean(side: Side, column: str) -> Cell:
    values = column_of(side.records, column)
    known = values[np.isfinite(values)]
    return number(float(known.mean())) if known.size else Cell(text="not logged")


def _brief(law: str) -> str:
    return law if len(law) <= LONGEST_LABEL else f"{law[: LONGEST_LABEL - 1].rstrip()}…"


def _changes(found: Difference) -> Figure:
    names = tuple(_brief(law.law) for law in found.laws) or ("nothing",)
    values = np.array([100.0 * law.change for law in found.laws] or [0.0])
    low, high = (np.array([100.0 * law.interval[end] for law in found.laws] or [0.0]) for end in (0, 1))
    place = np.arange(values.size, dtype=np.float64)
    series = Series("change", place, values, "blue", "bars", low=low, high=high, bar_width=0.6)
    return Figure(
        "changes", "bars", "Change of each law", "Bars are changes, lines their intervals.",
        PlotAxis("law", "-", categories=names), PlotAxis("change", "%"), (series,),
    )  # fmt: skip


def _orders(first: Side, second: Side) -> Figure:
    series = [
        Series(name, ORDERS, _mean_square(side, "order_amplitude_nm"), colour, dash=dash)
        for (name, side), colour, dash in zip(_named(first, second), COLOURS, DASHES, strict=True)
    ]
    return Figure(
        "orders", "xy", "Orders of the motor angle", "Amplitude of the residual at each order.",
        PlotAxis("order", "1/rev"), PlotAxis("amplitude", "Nm"), tuple(series), width="half",
    )  # fmt: skip


def _bands(first: Side, second: Side) -> Figure:
    centres = np.sqrt(BAND_EDGES_HZ[1:] * BAND_EDGES_HZ[:-1])
    series = [
        Series(name, centres, _mean_square(side, "band_rms_nm"), colour, dash=dash)
        for (name, side), colour, dash in zip(_named(first, second), COLOURS, DASHES, strict=True)
    ]
    return Figure(
        "bands", "xy", "Frequencies", "rms of the residual in each third of an octave.",
        PlotAxis("frequency", "Hz", log=True), PlotAxis("rms", "Nm"), tuple(series), width="half",
    )  # fmt: skip


def _named(first: Side, second: Side) -> list[tuple[str, Side]]:
    return [(f"first: {_short(first)}", first), (f"second: {_short(second)}", second)]


def _mean_square(side: Side, column: str) -> Floats:
    values = matrix_of(side.records, column)
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0) ** 2
    return np.asarray(np.where(count > 0, np.sqrt(total.sum(axis=0) / np.maximum(count, 1)), np.nan))

"""Contents of a report: verdict, tables of numbers with intervals, figures, provenance.

The page and report.json are made from the same records, so they always agree.
"""

from __future__ import annotations

import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from hashlib import file_digest, sha256
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from .. import __version__, formats
from ..documents import Confidence as Confidence
from ..documents import StrictRecord
from ..units import text_on
from .figures import Figure

VERSIONED = ("numpy", "numba", "scipy")

MOST_LINES = 6  # below the headline


class Line(StrictRecord):
    """One of the lines that a page opens with."""

    label: str
    text: str
    command: Annotated[str, Field(description="to be typed; empty: nothing")] = ""


class Verdict(StrictRecord):
    """The opening of a page: a headline, three short answers, a few lines. The evidence is folded."""

    headline: str
    finding: Annotated[str, Field(description="what was found, in a few words")]
    confidence: Confidence
    next_step: Annotated[str, Field(description="what to do, in a few words")]
    alarm: Annotated[bool, Field(description="the result must not be used as it is")] = False
    lines: list[Line] = Field(default_factory=list, max_length=MOST_LINES)
    reasons: list[str] = Field(default_factory=list)
    cautions: Annotated[list[str], Field(description="reasons not to trust the headline")] = Field(default_factory=list)


class Heading(StrictRecord):
    """A column of a table; neighbours of one `group` share a heading."""

    label: str
    unit: str = ""
    group: str = ""
    words: Annotated[bool, Field(description="texts, not numbers")] = False


class Cell(StrictRecord):
    """One number, its printed form and its interval; or text alone."""

    text: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
    best: Annotated[bool, Field(description="the smallest, or best, of its row")] = False


class Row(StrictRecord):
    """A line of a table."""

    label: str
    cells: list[Cell]
    unit: str = ""


class Table(StrictRecord):
    """A table of numbers."""

    name: str
    title: str
    note: str
    corner: Annotated[str, Field(description="heading of the column of labels")] = ""
    columns: list[Heading]
    rows: list[Row]


class Listing(StrictRecord):
    """Text to copy: a file that was written, or commands."""

    name: str
    title: str
    note: str
    text: str


class SourceFile(StrictRecord):
    """An input file of the report."""

    name: str
    bytes: int
    sha256: str
    text: Annotated[str | None, Field(description="content, of a short text")] = None


class ReportProvenance(StrictRecord):
    """Where the numbers come from."""

    date: str
    versions: dict[str, str]
    files: list[SourceFile]
    facts: dict[str, str] = Field(default_factory=dict)


class FigureEntry(StrictRecord):
    """A figure of the page, without its points."""

    name: str
    kind: str
    title: str
    caption: str
    x: str
    y: str
    series: list[str]


class ReportFile(StrictRecord):
    """report.json."""

    format: Annotated[str, formats.REPORT.key] = formats.REPORT.word
    kind: str
    title: str
    verdict: Verdict
    tables: list[Table]
    listings: list[Listing] = Field(default_factory=list)
    figures: list[FigureEntry]
    provenance: ReportProvenance
    results: Annotated[dict[str, Any], Field(description="results for programs, by kind of report")] = Field(
        default_factory=dict
    )


@dataclass(frozen=True)
class Section:
    """A heading of the page with its figures."""

    title: str
    text: str
    figures: tuple[Figure, ...]


@dataclass(frozen=True)
class Report:
    """The whole contents of a page."""

    kind: str  # bench, identify, evaluate, diagnose
    title: str
    subtitle: str
    verdict: Verdict
    tables: tuple[Table, ...]
    sections: tuple[Section, ...]
    provenance: ReportProvenance
    results: dict[str, Any] = field(default_factory=dict)
    listings: tuple[Listing, ...] = ()
    opening: str = ""  # name of the figure that the page opens with; empty: the first

    @property
    def opening_figure(self) -> Figure | None:
        """The figure that the page opens with. Raises ValueError where none is called `opening`."""
        return next((figure for figure in self.figures if figure.name == self._first), None)

    @property
    def _first(self) -> str:
        names = [figure.name for section in self.sections for figure in section.figures]
        if self.opening and names and self.opening not in names:
            raise ValueError(f"the report opens with a figure {self.opening!r}, which it does not have")
        return self.opening or next(iter(names), "")

    @property
    def folded_sections(self) -> tuple[Section, ...]:
        """The sections without the figure that the page opens with; none that is empty."""
        rest = (replace(s, figures=tuple(f for f in s.figures if f.name != self._first)) for s in self.sections)
        return tuple(section for section in rest if section.figures)

    @property
    def figures(self) -> tuple[Figure, ...]:
        """Every figure in its order, the opening one over the whole width. Raises ValueError when two have one name."""
        parts = (figure for section in self.sections for figure in section.figures)
        found = tuple(replace(one, width="full") if one.name == self._first else one for one in parts)
        names = [figure.name for figure in found]
        if len(set(names)) != len(names):
            raise ValueError(f"figures of one name in a report: {', '.join(sorted(names))}")
        return found

    def file(self) -> ReportFile:
        """The report for programs."""
        entries = [
            FigureEntry(
                name=f.name, kind=f.kind, title=f.title, caption=f.caption, x=f.x.text, y=f.y.text,
                series=[series.name for series in f.series],
            )
            for f in self.figures
        ]  # fmt: skip
        return ReportFile(
            kind=self.kind, title=self.title, verdict=self.verdict, tables=list(self.tables),
            listings=list(self.listings), figures=entries, provenance=self.provenance, results=self.results,
        )  # fmt: skip


def of_linear_axis(report: Report) -> Report:
    """The page of a rotary axis in units and words of a linear one; listings and results, which have keys, stay."""

    def said(text: str) -> str:
        return text_on(text, linear=True)

    def row_of(row: Row) -> Row:
        cells = [cell.model_copy(update={"text": said(cell.text)}) for cell in row.cells]
        return row.model_copy(update={"label": said(row.label), "unit": said(row.unit), "cells": cells})

    def column_of(column: Heading) -> Heading:
        return column.model_copy(update={"label": said(column.label), "unit": said(column.unit)})

    def table_of(table: Table) -> Table:
        parts = {"columns": [column_of(one) for one in table.columns], "rows": [row_of(one) for one in table.rows]}
        return table.model_copy(update={"title": said(table.title), "note": said(table.note), **parts})

    def figure_of(figure: Figure) -> Figure:
        x, y = (axis._replace(label=said(axis.label), unit=said(axis.unit)) for axis in (figure.x, figure.y))
        series = tuple(replace(one, name=said(one.name)) for one in figure.series)
        return replace(figure, title=said(figure.title), caption=said(figure.caption), x=x, y=y, series=series)

    verdict = report.verdict
    sentences: dict[str, Any] = {key: said(getattr(verdict, key)) for key in ("headline", "finding", "next_step")}
    sentences |= {key: [said(one) for one in getattr(verdict, key)] for key in ("reasons", "cautions")}
    sentences["lines"] = [line.model_copy(update={"text": said(line.text)}) for line in verdict.lines]
    return replace(
        report,
        subtitle=said(report.subtitle),
        verdict=verdict.model_copy(update=sentences),
        tables=tuple(table_of(table) for table in report.tables),
        sections=tuple(
            Section(said(section.title), said(section.text), tuple(figure_of(one) for one in section.figures))
            for section in report.sections
        ),
    )


def number(
    value: float, digits: int = 3, low: float | None = None, high: float | None = None, best: bool = False
) -> Cell:
    """A cell with a number to so many significant digits; a dash for one that is not finite."""
    if not math.isfinite(value):
        return Cell(text="–")
    return Cell(text=significant(value, digits), value=value, low=low, high=high, best=best)


def count(value: int) -> Cell:
    """A cell with a whole number, thousands apart."""
    return Cell(text=f"{value:,}".replace(",", "\u202f"), value=float(value))


def significant(value: float, digits: int = 3) -> str:
    """A number to so many significant digits, in plain notation between 1e-4 and 1e6; a dash where it is not finite."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -5 < exponent < 6:
        return f"{value:.{max(0, digits - 1 - exponent)}f}".replace("-", "\u2212")
    return f"{value:.{digits - 1}e}".replace("-", "\u2212")


def interval_text(low: float, high: float) -> str:
    """Ends of an interval with so many digits that they differ by about ten in the last place, at least three."""
    width, size = abs(high - low), max(abs(low), abs(high))
    digits = 3 if width == 0.0 or size == 0.0 else max(3, math.ceil(math.log10(size / width)) + 1)
    return f"{low:.{digits}g} to {high:.{digits}g}".replace("-", "\u2212")


def source_file(name: str, data: bytes, text: bool = False) -> SourceFile:
    """A file by its content; `text` keeps a UTF-8 text with it."""
    content = data.decode("utf-8", "replace") if text else None
    return SourceFile(name=name, bytes=len(data), sha256=sha256(data).hexdigest(), text=content)


def source_log(path: Path) -> SourceFile:
    """A file that may be longer than the memory, by its content. Raises OSError."""
    with path.open("rb") as file:
        digest = file_digest(file, "sha256")
        return SourceFile(name=path.name, bytes=file.tell(), sha256=digest.hexdigest(), text=None)


def provenance(files: list[SourceFile], facts: Mapping[str, str], now: datetime | None = None) -> ReportProvenance:
    """Provenance with the versions of the software."""
    versions = {"fffo-drive": __version__, "Python": platform.python_version()}
    versions |= {name: version(name) for name in VERSIONED}
    date = (now or datetime.now(UTC)).isoformat(timespec="seconds")
    return ReportProvenance(date=date, versions=versions, files=files, facts=dict(facts))

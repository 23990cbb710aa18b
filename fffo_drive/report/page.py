"""A report as one self-contained HTML page, and as JSON beside it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ..documents import DocumentError
from . import palette
from .document import Heading, Report, interval_text
from .encoding import encode_figures

PAGE_NAME = "report.html"
JSON_NAME = "report.json"
ASSETS = Path(__file__).parent / "assets"
SCRIPTS = ("uplot/uPlot.iife.min.js", "decode.js", "paint.js", "plot.js", "keys.js")
STYLES = ("uplot/uPlot.min.css", "report.css")
LICENCE = "uplot/LICENSE"


class ReportPaths(NamedTuple):
    """Where a report was written."""

    page: Path
    json: Path


def write_report(report: Report, directory: Path) -> ReportPaths:
    """Write report.html and report.json. Raises DocumentError where the directory holds a report of another kind."""
    refuse_other_report(directory, report.kind)
    directory.mkdir(parents=True, exist_ok=True)
    paths = ReportPaths(directory / PAGE_NAME, directory / JSON_NAME)
    paths.page.write_text(render_page(report), encoding="utf-8")
    content = report.file().model_dump(mode="json", exclude_none=True)
    paths.json.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return paths


def refuse_other_report(directory: Path, kind: str, *names: str) -> None:
    """Raises DocumentError where a directory holds a report of another kind, which would be overwritten.

    Also where it holds one of the files `names` and no report: somebody else wrote it.
    """
    path = directory / JSON_NAME
    foreign = next((directory / name for name in names if (directory / name).exists()), None)
    if foreign is not None and not path.exists():
        raise DocumentError(
            f"{foreign}: not from `{kind}` (no {JSON_NAME} next to it), not overwritten: give another --out"
        )
    try:
        found = json.loads(path.read_text(encoding="utf-8")).get("kind")
    except (FileNotFoundError, ValueError, AttributeError):
        return
    if found not in (None, kind):
        raise DocumentError(
            f"{directory}: holds the report of `{found}`, which would be overwritten; give `{kind}` another --out"
        )


def render_page(report: Report) -> str:
    """The page as text."""
    return (
        _environment()
        .get_template("report.html.j2")
        .render(
            report=report,
            numbers=_numbers(report),
            data=script_json(encode_figures(report.figures)),
            styles=[_asset(name) for name in STYLES],
            scripts=[_asset(name) for name in SCRIPTS],
            licence=_asset(LICENCE),
            light=palette.variables(dark=False),
            dark=palette.variables(dark=True),
        )
    )


def _numbers(report: Report) -> dict[str, int]:
    """Numbers of the figures by name, from 1 in the order of the page."""
    first = report.opening_figure
    shown = [first, *(f for section in report.folded_sections for f in section.figures)] if first else []
    return {figure.name: index for index, figure in enumerate(shown, 1)}


def script_json(content: object) -> Markup:
    """JSON that may stand inside a script element: nothing in it can end the element or open a comment."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def column_groups(columns: Iterable[Heading]) -> list[tuple[str, int]]:
    """Headings over neighbouring columns of one group, and their spans; none when no group has a name."""
    groups = [(name, len(list(members))) for name, members in groupby(columns, key=lambda column: column.group)]
    return groups if any(name for name, _ in groups) else []


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("fffo_drive.report", "assets"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["column_groups"] = column_groups
    environment.globals["interval_text"] = interval_text
    return environment


@cache
def _asset(name: str) -> Markup:
    return Markup((ASSETS / name).read_text(encoding="utf-8"))

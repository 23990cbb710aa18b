"""The scope page: one self-contained HTML text, and what it may do."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

from ..report import palette
from ..report.page import ASSETS as REPORT_ASSETS
from .http_rules import own_page

ASSETS = Path(__file__).parent / "assets"
SCRIPTS = (
    "wire.js", "store.js", "captures.js", "trigger.js", "dsp.js", "chart.js", "charts.js", "analysis.js", "views.js",
    "controls.js", "scope.js",
)  # fmt: skip


class WebPage(NamedTuple):
    """A self-contained HTML text, and the style sheet and script in it."""

    text: str
    style: str
    script: str


@cache
def read_page(assets: Path, name: str, scripts: tuple[str, ...]) -> WebPage:
    """A page from NAME.html, NAME.css and scripts of a directory, with the charts and colours of reports."""
    light, dark = palette.variables(dark=False), palette.variables(dark=True)
    colours = (
        f":root {{ color-scheme: light dark; {light} }}\n@media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}"
    )
    style = "\n".join((colours, _text(REPORT_ASSETS / "uplot/uPlot.min.css"), _text(assets / f"{name}.css")))
    script = "\n".join((_text(REPORT_ASSETS / "uplot/uPlot.iife.min.js"), *(_text(assets / own) for own in scripts)))
    licence = _text(REPORT_ASSETS / "uplot/LICENSE").replace("--", "- -")
    text = _text(assets / f"{name}.html")
    text = text.replace("{{style}}", style).replace("{{script}}", script).replace("{{licence}}", licence)
    return WebPage(text, style, script)


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def page() -> str:
    """The page."""
    return read_page(ASSETS, "scope", SCRIPTS).text


@cache
def allowed() -> str:
    """What it may do (`http_rules`)."""
    _, style, script = read_page(ASSETS, "scope", SCRIPTS)
    return own_page(style, script)

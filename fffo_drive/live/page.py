"""The scope page: one self-contained HTML text, and the headers that enforce it."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from pathlib import Path

from ..report import palette
from ..report.page import ASSETS as REPORT_ASSETS

ASSETS = Path(__file__).parent / "assets"
SCRIPTS = (
    "wire.js", "store.js", "captures.js", "trigger.js", "dsp.js", "chart.js", "charts.js", "analysis.js", "views.js",
    "controls.js", "scope.js",
)  # fmt: skip


@cache
def page() -> str:
    """The page."""
    style, script = _style(), _script()
    text = (ASSETS / "scope.html").read_text(encoding="utf-8")
    return text.replace("{{style}}", style).replace("{{script}}", script).replace("{{licence}}", uplot_licence())


@cache
def headers() -> dict[str, str]:
    """Only scripts and styles of the page itself run, no other page may frame it, and it connects to this server
    only.
    """
    policy = (
        f"default-src 'none'; script-src {source_hash(_script())}; style-src {source_hash(_style())}; "
        "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return {
        "Content-Type": "text/html; charset=utf-8",
        "Content-Security-Policy": policy,
        "Cross-Origin-Opener-Policy": "same-origin",
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
        "Cache-Control": "no-store",
    }


@cache
def _style() -> str:
    light, dark = palette.variables(dark=False), palette.variables(dark=True)
    colours = (
        f":root {{ color-scheme: light dark; {light} }}\n@media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}"
    )
    uplot = (REPORT_ASSETS / "uplot/uPlot.min.css").read_text(encoding="utf-8")
    return "\n".join((colours, uplot, (ASSETS / "scope.css").read_text(encoding="utf-8")))


@cache
def _script() -> str:
    uplot = (REPORT_ASSETS / "uplot/uPlot.iife.min.js").read_text(encoding="utf-8")
    own = [(ASSETS / name).read_text(encoding="utf-8") for name in SCRIPTS]
    return "\n".join((uplot, *own))


def uplot_licence() -> str:
    """As included in every page with charts."""
    return (REPORT_ASSETS / "uplot/LICENSE").read_text(encoding="utf-8").replace("--", "- -")


def source_hash(text: str) -> str:
    """The hash by which a Content-Security-Policy allows a script or style."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"

"""The page of the workbench: one HTML text that asks nobody else for anything, and the headers that keep it so."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from ..live.page import source_hash, uplot_licence
from ..report import palette
from ..report.page import ASSETS as REPORT_ASSETS

ASSETS = Path(__file__).parent / "assets"
SCRIPTS = ("plots.js", "workbench.js", "axis.js", "checks.js", "fleet.js")


@cache
def page() -> str:
    """The page."""
    text = (ASSETS / "workbench.html").read_text(encoding="utf-8")
    return text.replace("{{style}}", _style()).replace("{{script}}", _script()).replace("{{licence}}", uplot_licence())


@cache
def headers() -> dict[str, str]:
    """Nothing but what is in the page may run in it; frames show our own pages."""
    policy = (
        f"default-src 'none'; script-src {source_hash(_script())}; style-src {source_hash(_style())}; "
        "connect-src 'self'; frame-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )
    return {
        "Content-Type": "text/html; charset=utf-8", "Content-Security-Policy": policy,
        "X-Content-Type-Options": "nosniff", "Cross-Origin-Opener-Policy": "same-origin",
    }  # fmt: skip


@cache
def _style() -> str:
    light, dark = palette.variables(dark=False), palette.variables(dark=True)
    colours = (
        f":root {{ color-scheme: light dark; {light} }}\n@media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}"
    )
    uplot = (REPORT_ASSETS / "uplot/uPlot.min.css").read_text(encoding="utf-8")
    return "\n".join((colours, uplot, (ASSETS / "workbench.css").read_text(encoding="utf-8")))


@cache
def _script() -> str:
    uplot = (REPORT_ASSETS / "uplot/uPlot.iife.min.js").read_text(encoding="utf-8")
    return "\n".join((uplot, *((ASSETS / name).read_text(encoding="utf-8") for name in SCRIPTS)))

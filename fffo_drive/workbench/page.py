"""The page of the workbench: one HTML text that asks nobody else for anything, and the headers that keep it so."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from ..live.page import read_page, source_hash

ASSETS = Path(__file__).parent / "assets"
SCRIPTS = ("plots.js", "workbench.js", "axis.js", "checks.js", "fleet.js")


def page() -> str:
    """The page."""
    return read_page(ASSETS, "workbench", SCRIPTS).text


@cache
def headers() -> dict[str, str]:
    """Nothing but what is in the page may run in it; frames show our own pages."""
    _, style, script = read_page(ASSETS, "workbench", SCRIPTS)
    policy = (
        f"default-src 'none'; script-src {source_hash(script)}; style-src {source_hash(style)}; "
        "connect-src 'self'; frame-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )
    return {
        "Content-Type": "text/html; charset=utf-8", "Content-Security-Policy": policy,
        "X-Content-Type-Options": "nosniff", "Cross-Origin-Opener-Policy": "same-origin",
    }  # fmt: skip

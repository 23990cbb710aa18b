"""The page of the workbench: one HTML text that asks nobody else for anything, and what it may do."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from ..live.http_rules import own_page
from ..live.page import read_page

ASSETS = Path(__file__).parent / "assets"
SCRIPTS = ("plots.js", "workbench.js", "axis.js", "checks.js", "fleet.js")


def page() -> str:
    """The page."""
    return read_page(ASSETS, "workbench", SCRIPTS).text


@cache
def allowed() -> str:
    """What it may do (`http_rules`); frames show our own pages."""
    _, style, script = read_page(ASSETS, "workbench", SCRIPTS)
    return own_page(style, script, "frame-src 'self'")

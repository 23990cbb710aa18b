"""Colours of the reports, for light and dark paper; page and static figures take them from here.

Orange, green and blue differ under the common colour vision deficiencies and, by lightness, in grey prints. No figure
relies on colour alone: series also differ in dash, weight or marker and are named.
"""

from __future__ import annotations

from typing import NamedTuple


class Colour(NamedTuple):
    """One role on light and on dark paper, as #rrggbb."""

    light: str
    dark: str


PAPER = Colour("#ffffff", "#15171a")

# roles of text and furniture
FURNITURE = {
    "paper": PAPER,
    "raised": Colour("#f6f7f8", "#1d2024"),
    "text": Colour("#16181b", "#e9ebee"),
    "quiet": Colour("#5a626c", "#a3abb5"),
    "rule": Colour("#d9dde2", "#343a41"),
    "grid": Colour("#e8ebee", "#272c31"),
    "good": Colour("#1a7a3c", "#58c27d"),
    "caution": Colour("#9a5b00", "#e0a030"),
    "bad": Colour("#b3261e", "#ff8078"),
    "focus": Colour("#1f5fbf", "#7fb2ff"),
}

# colours of series
SERIES = {
    "ink": Colour("#16181b", "#e9ebee"),
    "orange": Colour("#dd5d10", "#ff9a66"),
    "green": Colour("#0b8264", "#43c79f"),
    "blue": Colour("#1a54b0", "#5b96f5"),
    "purple": Colour("#8546b5", "#c493f0"),
    "grey": Colour("#747c86", "#8f98a3"),
}


def variables(dark: bool) -> str:
    """All colours as CSS custom properties: furniture as --NAME, series as --series-NAME."""
    named = {f"--{name}": colour for name, colour in FURNITURE.items()}
    named.update({f"--series-{name}": colour for name, colour in SERIES.items()})
    return " ".join(f"{name}: {colour.dark if dark else colour.light};" for name, colour in named.items())

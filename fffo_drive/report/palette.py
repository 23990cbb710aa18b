"""Colours of the reports, for light and dark paper; page and static figures take them from here.

Orange, green and blue differ under the common colour vision deficiencies, and by LEAST_LIGHTNESS in greyscale. No
figure relies on colour alone: its series also differ in lightness, dash, marker or hatch, and are named.
"""

from __future__ import annotations

from typing import NamedTuple

LEAST_LIGHTNESS = 12.0  # difference in CIE L* (0 to 100) between lines that differ in nothing else


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
    "orange": Colour("#e26219", "#feba99"),
    "green": Colour("#01795d", "#36bd95"),
    "blue": Colour("#0a47a1", "#4e88e6"),
    "purple": Colour("#7a3ba9", "#b484e0"),
    "grey": Colour("#838b95", "#606973"),
}


def variables(dark: bool) -> str:
    """All colours as CSS custom properties: furniture as --NAME, series as --series-NAME."""
    named = {f"--{name}": colour for name, colour in FURNITURE.items()}
    named.update({f"--series-{name}": colour for name, colour in SERIES.items()})
    return " ".join(f"{name}: {colour.dark if dark else colour.light};" for name, colour in named.items())

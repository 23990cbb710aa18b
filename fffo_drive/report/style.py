"""How each series is drawn, in px of the page. The page's script and the exported figures only apply it."""

from __future__ import annotations

import math
from typing import NamedTuple

from .figures import Series

Outline = tuple[tuple[float, float], ...]

WIDTHS_PX = {"full": 1072.0, "half": 523.0, "third": 340.0}  # of a figure on a wide screen
DASHES: dict[str, tuple[float, ...]] = {
    "solid": (), "dashed": (6.0, 4.0), "dotted": (1.5, 3.0), "dashdot": (8.0, 3.0, 2.0, 3.0),
}  # fmt: skip
LEVEL_DASH = (4.0, 3.0)
_CIRCLE: Outline = tuple((math.cos(0.1 * math.pi * k), math.sin(0.1 * math.pi * k)) for k in range(20))
MARKERS: tuple[Outline, ...] = (  # in radii, upwards
    _CIRCLE,
    ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)),
    ((0.0, 1.3), (1.3, 0.0), (0.0, -1.3), (-1.3, 0.0)),
    ((0.0, 1.2), (1.1, -1.0), (-1.1, -1.0)),
)
HATCHES: tuple[tuple[int, ...], ...] = ((), (1,), (-1,), (1, -1))  # slopes of the lines across a bar, upwards
RADIUS_PX, DOT_PX = 4.0, 1.2
EDGE_PX = 1.0  # around a filled area
FILLED = 0.35  # opacity of the area


class Style(NamedTuple):
    """The look of one series. Hue is never the only difference: dash, marker or hatch come with it."""

    colour: str  # of palette.SERIES
    width: float  # of its line, px
    dash: tuple[float, ...]  # px on, px off, ...
    marker: Outline  # px around the point, upwards; empty: none
    hollow: bool  # the marker shows the paper
    hatch: tuple[int, ...]
    opacity: float  # of the area between its steps and zero; 0: none
    ends: str  # of palette.FURNITURE: colour of its intervals; empty: its own


def style_of(series: Series, number: int) -> Style:
    """The look of a series that is the `number`-th of its figure, from 0."""
    shape, radius = (_CIRCLE, DOT_PX) if series.dots else (MARKERS[number % len(MARKERS)], RADIUS_PX)
    return Style(
        colour=series.colour,
        width=EDGE_PX if series.draw == "filled" else series.weight,
        dash=DASHES[series.dash],
        marker=tuple((radius * x, radius * y) for x, y in shape) if series.draw == "points" else (),
        hollow=not series.dots,
        hatch=HATCHES[number % len(HATCHES)] if series.draw == "bars" else (),
        opacity={"filled": FILLED, "bars": 1.0}.get(series.draw, 0.0),
        ends="text" if series.draw == "bars" else "",
    )

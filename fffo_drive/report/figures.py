"""Contents of a figure: axes with units, series, marks. Page and static drawing share them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ..arrays import Floats
from .palette import SERIES

Kind = Literal["time", "histogram", "xy", "bars"]
Draw = Literal["line", "steps", "filled", "points", "bars"]
Dash = Literal["solid", "dashed", "dotted", "dashdot"]
Width = Literal["full", "half", "third"]

MARKED = 200  # points of a series that are drawn with markers; more of them are dots


class Uniform(NamedTuple):
    """Equidistant abscissae: `start + i * step`."""

    start: float
    step: float

    def values(self, n: int) -> Floats:
        """The first n of them, shape (n,)."""
        return self.start + self.step * np.arange(n, dtype=np.float64)


class PlotAxis(NamedTuple):
    """An axis. `unit` is never empty: '-' stands for a number, '%' for a share. Categories stand at 0, 1, 2, ..."""

    label: str
    unit: str
    log: bool = False
    limits: tuple[float, float] | None = None
    categories: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Label with unit, as it is printed along the axis."""
        return self.label if self.unit == "-" else f"{self.label}, {self.unit}"


TIME, VELOCITY = PlotAxis("time", "s"), PlotAxis("velocity", "rps")
FREQUENCY = PlotAxis("frequency", "Hz", log=True)


class Span(NamedTuple):
    """A part of the abscissa that is marked behind the series."""

    start: float
    end: float
    label: str


class LevelLine(NamedTuple):
    """A line across the figure: at `value` of the ordinate, or of the abscissa when `upright`."""

    value: float
    label: str
    upright: bool = False


@dataclass(frozen=True)
class Series:
    """One curve.

    `y` (n,); `x` is Uniform or (n,), and (n + 1,) edges for the steps of a histogram. NaN is a gap. `low` and `high`
    (n,) are the ends of an interval around y. `finest` is how many points the page keeps at most.
    """

    name: str
    x: Floats | Uniform
    y: Floats
    colour: str
    draw: Draw = "line"
    dash: Dash = "solid"
    weight: float = 1.5
    low: Floats | None = None
    high: Floats | None = None
    bar_width: float = 0.8
    finest: int = 6000

    def __post_init__(self) -> None:
        if not self.name:
            raise ValueError("a series needs a name")
        if self.colour not in SERIES:
            raise ValueError(f"series {self.name!r}: no colour {self.colour!r}; there are {', '.join(SERIES)}")
        if not isinstance(self.x, Uniform):
            wanted = self.y.size + (1 if self.draw in ("steps", "filled") else 0)
            if self.x.size != wanted:
                raise ValueError(f"series {self.name!r}: {self.x.size} abscissae, {wanted} are needed")

    @property
    def dots(self) -> bool:
        """Too many points for markers."""
        return self.draw == "points" and self.y.size > MARKED

    @property
    def abscissae(self) -> Floats:
        """The abscissae as an array."""
        return self.x.values(self.y.size) if isinstance(self.x, Uniform) else self.x


@dataclass(frozen=True)
class Figure:
    """One figure. Those of one `group` share the abscissa while zooming, and with `share_y` the ordinate too."""

    name: str  # letters, digits and dashes: its address in the page
    kind: Kind
    title: str
    caption: str
    x: PlotAxis
    y: PlotAxis
    series: tuple[Series, ...]
    width: Width = "full"
    height_px: int = 260
    group: str = ""
    share_y: bool = False
    spans: tuple[Span, ...] = ()
    levels: tuple[LevelLine, ...] = ()

    def __post_init__(self) -> None:
        said = {"title": self.title, "caption": self.caption, "x label": self.x.label, "x unit": self.x.unit}
        said |= {"y label": self.y.label, "y unit": self.y.unit}
        missing = [what for what, text in said.items() if not text.strip()]
        if missing:
            raise ValueError(f"figure {self.name!r} lacks its {', '.join(missing)}")
        if not self.series:
            raise ValueError(f"figure {self.name!r} has no series")
        names = [series.name for series in self.series]
        if len(set(names)) != len(names):
            raise ValueError(f"figure {self.name!r} has two series of one name: {', '.join(names)}")
        if self.kind == "time" and not all(isinstance(series.x, Uniform) for series in self.series):
            raise ValueError(f"figure {self.name!r}: time series are equidistant, with NaN for what is missing")


def histogram(name: str, values: Floats, edges: Floats, colour: str, draw: Draw = "filled") -> Series:
    """Share of the values in each bin, in per cent of all values. `edges` (n + 1,); values outside still count."""
    counts, _ = np.histogram(values, edges)
    return Series(name, edges, 100.0 * counts / max(values.size, 1), colour, draw)


def normal_curve(name: str, values: Floats, edges: Floats) -> Series:
    """`histogram` of a normal distribution with the same mean and deviation (NaN where it is 0)."""
    centres = 0.5 * (edges[1:] + edges[:-1])
    deviation = float(values.std()) or math.nan
    distance = (centres - float(values.mean())) / deviation
    scale = 100.0 / (deviation * math.sqrt(2.0 * math.pi))
    share: Floats = np.asarray(scale * np.exp(-0.5 * distance * distance) * np.diff(edges), dtype=np.float64)
    return Series(name, centres, share, "ink", dash="dashed", weight=1.2)


class Group(NamedTuple):
    """Bars of one colour, one for each category; `low` and `high` where the value has an interval, else NaN."""

    values: Sequence[float]
    colour: str
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None


def grouped_bars(groups: Mapping[str, Group], marks: Mapping[str, Sequence[float]], mark_name: str) -> list[Series]:
    """Bars side by side at categories 0, 1, 2, ..., and one series of markers over the bars that `marks` names."""
    pitch = 0.8 / len(groups)
    series: list[Series] = []
    places: list[float] = []
    heights: list[float] = []
    for number, (name, group) in enumerate(groups.items()):
        offset = (number - 0.5 * (len(groups) - 1)) * pitch
        x = np.arange(len(group.values), dtype=np.float64) + offset
        low, high = (None if end is None else np.asarray(end, dtype=np.float64) for end in (group.low, group.high))
        y = np.asarray(group.values, dtype=np.float64)
        series.append(Series(name, x, y, group.colour, "bars", low=low, high=high, bar_width=0.9 * pitch))
        if name in marks:
            places += x.tolist()
            heights += marks[name]
    if places:
        order = np.argsort(places)
        series.append(Series(mark_name, np.asarray(places)[order], np.asarray(heights)[order], "ink", "points"))
    return series

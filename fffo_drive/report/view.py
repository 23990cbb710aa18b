"""What a figure shows when nothing is zoomed: limits, ticks and their texts; page and exported figures use the same."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from .figures import Figure, PlotAxis, Series, Uniform
from .style import WIDTHS_PX

PAD = 0.06  # of the range of the ordinates, above and below
SIDE = 0.03  # of the range of the abscissae of a curve in the plane, on either side
ASIDE_PX, BELOW_PX = 90.0, 60.0  # what the axes take of width and height
ACROSS_PX, UP_PX = 60.0, 34.0  # least distance of two ticks
ROUND = (1.0, 2.0, 5.0)
SAME = 1e-9  # of a step: rounding


class AxisView(NamedTuple):
    """One axis: its ends, and the ticks with what is printed beside them."""

    low: float
    high: float
    ticks: tuple[float, ...]
    texts: tuple[str, ...]
    log: bool

    def share(self, value: float) -> float:
        """Where a value stands between the ends: 0 to 1."""
        low, high, at = (math.log10(one) if self.log else one for one in (self.low, self.high, value))
        return (at - low) / (high - low)


class FigureView(NamedTuple):
    """Both axes of a figure."""

    x: AxisView
    y: AxisView


def views(figures: Sequence[Figure]) -> list[FigureView]:
    """The view of each figure: of one group with one abscissa, and with `share_y` one ordinate if it is the same."""
    return [
        _view_of(figure, [one for one in figures if figure.group and one.group == figure.group]) for figure in figures
    ]


def _view_of(figure: Figure, group: Sequence[Figure]) -> FigureView:
    sharing = [one for one in group if figure.share_y and one.share_y and one.y.text == figure.y.text]
    abscissa = _abscissa(figure, [series for one in group or [figure] for series in one.series])
    return FigureView(abscissa, _ordinate(figure, [series for one in sharing or [figure] for series in one.series]))


def _abscissa(figure: Figure, shown: Iterable[Series]) -> AxisView:
    axis = figure.x
    if axis.categories:
        places = tuple(float(k) for k in range(len(axis.categories)))
        return AxisView(-0.6, len(places) - 0.4, places, axis.categories, log=False)
    low, high = axis.limits or _range(_kept(axis, (_ends(series) for series in shown)), axis)
    if figure.kind == "xy" and not axis.log and axis.limits is None:
        side = SIDE * (high - low)
        low, high = low - side, high + side
    return _view(axis, low, high, WIDTHS_PX[figure.width] - ASIDE_PX, ACROSS_PX)


def _ordinate(figure: Figure, shown: Iterable[Series]) -> AxisView:
    axis = figure.y
    if axis.limits is None:
        ends = (end for one in shown for end in (one.y, one.low, one.high) if end is not None)
        values = _kept(axis, ends)
        levels = np.array([level.value for level in figure.levels if not level.upright])
        low, high = _range(np.concatenate([values, levels]), axis)
        if axis.log:
            low, high = _outwards(low, -1), _outwards(high, 1)
        else:
            grounded = figure.kind in ("histogram", "bars")  # they stand on zero, or hang from it
            if grounded:
                low, high = min(0.0, low), max(0.0, high)
            pad = PAD * (high - low or abs(high) or 1.0)
            below, above = not (grounded and low == 0.0), not (grounded and high == 0.0 > low)
            low, high = low - pad * below, high + pad * above
    else:
        low, high = axis.limits
    return _view(axis, low, high, figure.height_px - BELOW_PX, UP_PX)


def _ends(series: Series) -> Floats:
    """Abscissae among which are the smallest and the largest; of a long record these alone."""
    if not isinstance(series.x, Uniform):
        return series.x
    return np.array([series.x.start, series.x.start + (series.y.size - 1) * series.x.step])


def _kept(axis: PlotAxis, parts: Iterable[Floats]) -> Floats:
    """What can be drawn on this axis."""
    values: Floats = np.concatenate([np.zeros(0), *parts])
    kept: Floats = values[np.isfinite(values) & ((values > 0.0) | (not axis.log))]
    return kept


def _range(values: Floats, axis: PlotAxis) -> tuple[float, float]:
    if not values.size:
        return (0.1, 1.0) if axis.log else (0.0, 1.0)
    low, high = float(values.min()), float(values.max())
    if low == high and axis.log:
        return 0.5 * low, 2.0 * high
    return low, high


def _outwards(value: float, way: int) -> float:
    """The next 1, 2 or 5 of a decade at or above (way 1), at or below (way -1)."""
    decade = 10.0 ** math.floor(math.log10(value))
    steps = [decade * step for step in (*ROUND, 10.0)]
    if way > 0:
        return next((step for step in steps if step >= value * (1.0 - SAME)), steps[-1])
    return next((step for step in reversed(steps) if step <= value * (1.0 + SAME)), steps[0])


def _view(axis: PlotAxis, low: float, high: float, room_px: float, apart_px: float) -> AxisView:
    if not high > low:  # a single abscissa
        low, high = low - 0.5, high + 0.5
    ticks = _decades(low, high, room_px, apart_px) if axis.log else _even(low, high, room_px / apart_px)
    return AxisView(low, high, tuple(ticks), tuple(tick_text(tick) for tick in ticks), axis.log)


def _even(low: float, high: float, most: float) -> list[float]:
    """Multiples of the least 1, 2 or 5 times a power of ten that gives at most so many intervals."""
    least = (high - low) / max(most, 1.0)
    step = _outwards(least, 1)
    first, last = math.ceil(low / step - SAME), math.floor(high / step + SAME)
    return [float(f"{k * step:.12g}") for k in range(first, last + 1)]


def _decades(low: float, high: float, room_px: float, apart_px: float) -> list[float]:
    """1, 2, 5 of each decade; powers of ten alone, then every second of them and so on, where these are too close."""
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    fine = [float(f"{step}e{k}") for k in exponents for step in (1, 2, 5)]
    choices = [fine, *([float(f"1e{k}") for k in exponents if k % every == 0] for every in (1, 2, 3, 5, 10))]
    px_per_decade = room_px / math.log10(high / low)
    for choice in choices:
        ticks = [tick for tick in choice if low * (1.0 - SAME) <= tick <= high * (1.0 + SAME)]
        if all(px_per_decade * math.log10(b / a) >= apart_px for a, b in pairwise(ticks)):
            break
    return ticks


def tick_text(value: float) -> str:
    """A number beside its tick: plain from 0.001 to 100,000, else with a power of ten."""
    plain = value == 0.0 or 1e-3 * (1.0 - SAME) <= abs(value) < 1e5
    mantissa, _, exponent = f"{value:.8e}".partition("e")
    text = f"{value:.8g}" if plain else f"{float(mantissa):g}e{int(exponent)}"
    return text.replace("-", "\u2212")

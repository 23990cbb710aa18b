"""Figures as JSON for the page: numbers as base64 of little-endian float32, long records as 16 bits of their range.

16 bits halve a page, so that a minute of a few signals at 2 kHz keeps every sample. A step is 1/65534 of the record's
range: below a pixel until the ordinate is zoomed a hundredfold, and below the resolution of a resolver.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..arrays import Floats
from .decimation import most_bridged, thinned
from .figures import Figure, PlotAxis, Series, Uniform
from .style import style_of
from .view import AxisView, FigureView, views

SHORT = 4096  # up to here float32 costs nothing
LEVELS = 32767
MISSING = -32768
LARGEST_DATA_BYTES = 2_300_000  # base64 of all figures of a page; the page stays below 3 MB with its text and code

Encoded = dict[str, Any]


def encode(values: Floats) -> Encoded:
    """Numbers (n,) for the page, NaN kept: {"f4": base64} or {"i2": base64, "scale", "offset"}."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    if values.size <= SHORT or not high > low:
        return {"f4": _base64(values.astype("<f4"))}
    scale, offset = (high - low) / (2 * LEVELS), 0.5 * (high + low)
    with np.errstate(invalid="ignore"):
        steps = np.where(np.isfinite(values), np.rint((values - offset) / scale), MISSING)
    return {"i2": _base64(steps.astype("<i2")), "scale": scale, "offset": offset}


def encode_figures(figures: Sequence[Figure], largest_bytes: int = LARGEST_DATA_BYTES) -> list[dict[str, Any]]:
    """All figures of a page within `largest_bytes` of data: the longest records are decimated first."""
    most = max((series.finest for figure in figures for series in figure.series), default=0)
    seen = views(figures)
    while True:
        encoded = [_figure(figure, view, most) for figure, view in zip(figures, seen, strict=True)]
        if most <= 500 or _data_bytes(encoded) <= largest_bytes:
            return encoded
        most = int(most * 0.8)


def _data_bytes(encoded: list[dict[str, Any]]) -> int:
    return sum(
        len(part.get("f4", "")) + len(part.get("i2", ""))
        for figure in encoded
        for series in figure["series"]
        for part in series.values()
        if isinstance(part, dict)
    )


def _figure(figure: Figure, view: FigureView, most: int) -> dict[str, Any]:
    return {
        "name": figure.name,
        "kind": figure.kind,
        "x": _axis(figure.x, view.x),
        "y": _axis(figure.y, view.y),
        "height": figure.height_px,
        "group": figure.group,
        "shareY": figure.share_y,
        "spans": [span._asdict() for span in figure.spans],
        "levels": [level._asdict() for level in figure.levels],
        "series": [_series(series, number, most) for number, series in enumerate(figure.series)],
    }


def _axis(axis: PlotAxis, view: AxisView) -> dict[str, Any]:
    named = {"text": axis.text, "unit": axis.unit, "named": bool(axis.categories)}
    return {**view._asdict(), **named}


def _series(series: Series, number: int, most: int) -> dict[str, Any]:
    x, y, bucket = thinned(series, min(series.finest, most))
    described: dict[str, Any] = {
        "name": series.name,
        "draw": series.draw,
        "style": style_of(series, number)._asdict(),
        "bucket": bucket,
        "bridged": most_bridged(bucket),
        "y": encode(y),
        "x": {"start": x.start, "step": x.step} if isinstance(x, Uniform) else encode(x),
    }
    if series.draw == "bars":
        described["barWidth"] = series.bar_width
    if series.low is not None and series.high is not None:
        described |= {"low": encode(series.low), "high": encode(series.high)}
    return described


def _base64(values: np.ndarray[Any, np.dtype[Any]]) -> str:
    return base64.b64encode(values.tobytes()).decode("ascii")

"""The figures as SVG, PNG or PDF. Import it only where it is used: matplotlib loads slowly."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import font_manager, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Sheet
from matplotlib.layout_engine import ConstrainedLayoutEngine
from PIL import Image

from .decimation import thinned
from .figures import Figure, Series
from .palette import FURNITURE, SERIES, Colour

POINTS = 2400  # per series: two a pixel over the sheet's width
WIDTH_INCH = 9.6
PX_PER_INCH = 110.0
DOTS_PER_INCH = 130
PNG_COLOURS = 64
FONTS = ("Liberation Sans", "Arial", "Helvetica", "DejaVu Sans")  # the last comes with matplotlib
DASHES: dict[str, Any] = {"solid": "-", "dashed": (0, (4, 2.2)), "dotted": (0, (1, 1.5)), "dashdot": "-."}
MARKERS = ("o", "s", "D", "^")
HATCHES = ("", "//", "\\\\", "xx")


def write_figure(figure: Figure, path: Path, dark: bool = False) -> None:
    """One figure as the suffix of `path` says (.svg, .png, .pdf)."""
    write_overview([[figure]], [path], dark)


def write_figures(figures: Sequence[Figure], directory: Path) -> list[Path]:
    """Each figure as an SVG file of its name, in a directory that is made."""
    directory.mkdir(parents=True, exist_ok=True)
    paths = [directory / f"{figure.name}.svg" for figure in figures]
    for figure, path in zip(figures, paths, strict=True):
        write_figure(figure, path)
    return paths


def write_overview(rows: Sequence[Sequence[Figure]], paths: Sequence[Path], dark: bool = False) -> None:
    """Rows of figures on one sheet, of the same look as the page, in each format that a path asks for."""
    with _look(dark):
        heights = [max(figure.height_px for figure in row) / PX_PER_INCH + 0.42 for row in rows]
        layout = ConstrainedLayoutEngine(h_pad=0.06, w_pad=0.06, hspace=0.02)
        sheet = Sheet(figsize=(WIDTH_INCH, sum(heights)), layout=layout)
        strips: Any = sheet.subfigures(len(rows), 1, height_ratios=heights, squeeze=False)
        for row, strip in zip(rows, strips[:, 0], strict=True):
            for figure, axes in zip(row, strip.subplots(1, len(row), squeeze=False)[0], strict=True):
                paint(figure, axes, dark)
        for path in paths:
            _save(sheet, path)


def _save(sheet: Sheet, path: Path) -> None:
    """Without dates, so that the same data give the same file; PNG in few colours, a third of the size."""
    if path.suffix == ".png":
        content = BytesIO()
        sheet.savefig(content, format="png", dpi=DOTS_PER_INCH)
        Image.open(content).convert("RGB").quantize(PNG_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    else:
        dated = {".svg": "Date", ".pdf": "CreationDate"}.get(path.suffix)
        sheet.savefig(path, metadata={dated: None, "Creator": "fffo-drive"} if dated else None)


def paint(figure: Figure, axes: Axes, dark: bool = False) -> None:
    """One figure on matplotlib's axes."""
    for span in figure.spans:
        axes.axvspan(span.start, span.end, color=_shade(FURNITURE["grid"], dark), lw=0, zorder=0)
        middle = 0.5 * (span.start + span.end)
        axes.annotate(
            span.label,
            (middle, 1.0),
            (0, 2),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="center",
            color=_shade(FURNITURE["quiet"], dark),
            fontsize=8,
        )
    for number, series in enumerate(figure.series):
        _series(series, number, axes, dark)
    for level in figure.levels:
        line = axes.axvline if level.upright else axes.axhline
        line(level.value, color=_shade(FURNITURE["quiet"], dark), lw=0.8, ls=(0, (4, 3)), label=level.label)
    _axes(figure, axes)
    axes.set_title(figure.title, loc="left", fontsize=9.5, fontweight="bold", pad=12 if figure.spans else 5)
    if len(figure.series) + len(figure.levels) > 1:
        axes.legend(loc="best", fontsize=7.5, handlelength=2.6, borderaxespad=0.3, labelspacing=0.25)


def _series(series: Series, number: int, axes: Axes, dark: bool) -> None:
    colour = _shade(SERIES[series.colour], dark)
    x, y, _ = thinned(series, POINTS)
    x = series.abscissae if series.draw in ("steps", "filled", "bars") else _array(x, y.size)
    common: dict[str, Any] = {"color": colour, "label": series.name}
    if series.draw in ("steps", "filled"):
        if series.draw == "filled":
            axes.stairs(y, x, fill=True, alpha=0.35, lw=0, color=colour)
        axes.stairs(y, x, lw=0.9 if series.draw == "filled" else 1.2, ls=DASHES[series.dash], **common)
    elif series.draw == "bars":
        hatch, paper = HATCHES[number % len(HATCHES)], _shade(FURNITURE["paper"], dark)
        axes.bar(x, y, series.bar_width, hatch=hatch, edgecolor=paper, lw=0.0, **common)
    elif series.draw == "points":
        marker = MARKERS[number % len(MARKERS)]
        paper = _shade(FURNITURE["paper"], dark)
        axes.plot(x, y, marker, ms=5, mfc=paper, mew=1.2, zorder=4, **common)
    else:
        present = np.isfinite(y) if series.y.size == y.size else np.ones(y.size, dtype=bool)
        axes.plot(x[present], y[present], lw=0.8 * series.weight, ls=DASHES[series.dash], **common)
    if series.low is not None and series.high is not None:
        spread = np.abs(np.stack([y - series.low, series.high - y]))
        ink = _shade(FURNITURE["text"], dark) if series.draw == "bars" else colour
        axes.errorbar(x, y, spread, fmt="none", ecolor=ink, elinewidth=0.9, capsize=2.2, zorder=3)


def _array(x: Any, n: int) -> Any:
    return x if isinstance(x, np.ndarray) else x.values(n)


def _axes(figure: Figure, axes: Axes) -> None:
    axes.set_xlabel(figure.x.text)
    axes.set_ylabel(figure.y.text)
    if figure.x.log:
        axes.set_xscale("log")
    if figure.y.log:
        axes.set_yscale("log")
    if figure.x.categories:
        axes.set_xticks(range(len(figure.x.categories)), figure.x.categories)
        axes.tick_params(axis="x", length=0)
        axes.set_xlabel("")
        axes.grid(visible=False, axis="x")
    elif figure.kind in ("time", "histogram"):
        ends = [series.abscissae[[0, -1]] for series in figure.series]
        axes.set_xlim(min(first for first, _ in ends), max(last for _, last in ends))
    if figure.x.limits:
        axes.set_xlim(*figure.x.limits)
    if figure.y.limits:
        axes.set_ylim(*figure.y.limits)


def _shade(colour: Colour, dark: bool) -> str:
    return colour.dark if dark else colour.light


@contextmanager
def _look(dark: bool) -> Iterator[None]:
    paper, text, quiet, rule, grid = (
        _shade(FURNITURE[name], dark) for name in ("paper", "text", "quiet", "rule", "grid")
    )
    settings: Any = {
        "font.family": next(font for font in FONTS if font in font_manager.get_font_names()),
        "font.size": 8.5,
        "axes.titlecolor": text,
        "axes.labelcolor": quiet,
        "axes.edgecolor": rule,
        "axes.facecolor": paper,
        "axes.axisbelow": True,
        "axes.grid": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "grid.color": grid,
        "grid.linewidth": 0.7,
        "figure.facecolor": paper,
        "savefig.facecolor": paper,
        "text.color": text,
        "xtick.color": quiet,
        "ytick.color": quiet,
        "legend.frameon": True,
        "legend.framealpha": 0.85,
        "legend.edgecolor": "none",
        "legend.facecolor": paper,
        "svg.fonttype": "path",
        "svg.hashsalt": "fffo-drive",
        "path.simplify": True,
    }
    with rc_context(settings):
        yield

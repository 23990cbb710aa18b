"""The figures of the page as SVG, PNG or PDF. Import it only where it is used: matplotlib loads slowly.

View and style come with the figure. What is decided here is where title, legend, plot and caption stand on a sheet, in
px of the page.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import font_manager, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Sheet
from matplotlib.ticker import NullLocator
from PIL import Image

from .decimation import bridged, thinned
from .figures import Figure, LevelLine, Series, Uniform
from .palette import FURNITURE, SERIES, Colour
from .style import LEVEL_DASH, WIDTHS_PX, Style, style_of
from .view import FigureView, views

PX_PER_INCH = 110.0
PT = 72.0 / PX_PER_INCH  # points of a px
POINTS = 2400  # of a time series: two a px over the widest sheet
DOTS_PER_INCH = 130
PNG_COLOURS = 256
FONTS = ("Liberation Sans", "Arial", "Helvetica", "DejaVu Sans")  # the last comes with matplotlib
TEXT_PX, TITLE_PX, LINE_PX = 12.0, 14.0, 18.0
EDGE_PX, GAP_PX, RIGHT_PX, BELOW_PX = 8.0, 26.0, 12.0, 48.0
SAMPLE_PX, SPACE_PX = 26.0, 6.0  # in the legend
WHISKER_PX, CAP_PX = 1.2, 3.0
HATCHES = {1: "///", -1: "\\\\\\"}  # lines 6 px apart
TURNS = 0.6  # of the width: beyond, the label of an upright line stands on its left


def write_figure(figure: Figure, path: Path, dark: bool = False) -> None:
    """One figure, as wide as in the page, in the format that the suffix of `path` names (.svg, .png, .pdf)."""
    _write([[(figure, views([figure])[0])]], [path], WIDTHS_PX[figure.width], dark)


def write_figures(figures: Sequence[Figure], directory: Path) -> list[Path]:
    """Each figure of a report as an SVG file with its name, in a directory that is created."""
    directory.mkdir(parents=True, exist_ok=True)
    paths = [directory / f"{figure.name}.svg" for figure in figures]
    for figure, view, path in zip(figures, views(figures), paths, strict=True):
        _write([[(figure, view)]], [path], WIDTHS_PX[figure.width], dark=False)
    return paths


def write_overview(rows: Sequence[Sequence[Figure]], paths: Sequence[Path], dark: bool = False) -> None:
    """Rows of figures on one sheet as wide as the page, in each format that a path asks for."""
    widths: Any = list(WIDTHS_PX)
    fitted = [[replace(one, width=widths[min(len(row), len(widths)) - 1]) for one in row] for row in rows]
    seen = iter(views([figure for row in fitted for figure in row]))
    _write([[(figure, next(seen)) for figure in row] for row in fitted], paths, WIDTHS_PX["full"], dark)


class _Box(NamedTuple):
    """A figure with the lines of text above and below its plot."""

    figure: Figure
    view: FigureView
    width: float  # px
    title: list[str]
    legend: list[list[int]]  # rows of numbers of series
    caption: list[str]

    @property
    def above(self) -> float:
        """Height of title and legend."""
        return LINE_PX * (len(self.title) + len(self.legend))

    @property
    def height(self) -> float:
        """Of the whole."""
        return self.above + self.figure.height_px + LINE_PX * len(self.caption) + 2.0 * EDGE_PX


Shown = tuple[Figure, FigureView]


def _write(rows: Sequence[Sequence[Shown]], paths: Sequence[Path], width: float, dark: bool) -> None:
    with look(dark):
        boxes = [[_box(*one, (width - GAP_PX * (len(row) - 1)) / len(row)) for one in row] for row in rows]
        heights = [max(box.height for box in row) for row in boxes]
        size = width + 2.0 * EDGE_PX, sum(heights) + EDGE_PX
        sheet = Sheet(figsize=(size[0] / PX_PER_INCH, size[1] / PX_PER_INCH))
        page = sheet.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, size[0]), ylim=(size[1], 0.0))
        page.axis("off")
        top = EDGE_PX
        for row, height in zip(boxes, heights, strict=True):
            left = EDGE_PX
            for box in row:
                _place(box, page, left, top, dark)
                left += box.width + GAP_PX
            top += height
        for path in paths:
            _save(sheet, path)


def _box(figure: Figure, view: FigureView, width: float) -> _Box:
    legend: list[list[int]] = [[]]
    used = 0.0
    for number, series in enumerate(figure.series):
        wide = _entry_px(series)
        if legend[-1] and used + wide > width:
            legend.append([])
            used = 0.0
        legend[-1].append(number)
        used += wide
    title, caption = _lines(figure.title, width, TITLE_PX, "bold"), _lines(figure.caption, width, TEXT_PX)
    return _Box(figure, view, width, title, legend, caption)


def _entry_px(series: Series) -> float:
    return SAMPLE_PX + 3.0 * SPACE_PX + _text_px(series.name, TEXT_PX)


def _text_px(text: str, size_px: float, weight: str = "normal") -> float:
    font = font_manager.get_font(font_manager.findfont(font_manager.FontProperties(weight=weight)))
    font.set_size(size_px, 72.0)
    font.set_text(text)
    return float(font.get_width_height()[0]) / 64.0


def _lines(text: str, width: float, size_px: float, weight: str = "normal") -> list[str]:
    """A text in lines of at most this width."""
    found = [""]
    for word in text.split():
        longer = f"{found[-1]} {word}".strip()
        if found[-1] and _text_px(longer, size_px, weight) > width:
            found.append(word)
        else:
            found[-1] = longer
    return found


def _place(box: _Box, page: Axes, left: float, top: float, dark: bool) -> None:
    """Title, legend, plot and caption, one below the other; `page` has px, downwards."""
    figure, quiet = box.figure, _shade(FURNITURE["quiet"], dark)
    for number, line in enumerate(box.title):
        height = top + LINE_PX * (number + 0.5)
        page.text(left, height, line, va="center", fontsize=TITLE_PX * PT, fontweight="bold")
    for number, row in enumerate(box.legend):
        start, height = left, top + LINE_PX * (len(box.title) + number + 0.5)
        for index in row:
            series = figure.series[index]
            _sample(style_of(series, index), page, start, height, dark)
            page.text(start + SAMPLE_PX + SPACE_PX, height, series.name, va="center")
            start += _entry_px(series)
    longest = max(_text_px(text, TEXT_PX) for text in ("0", *box.view.y.texts))
    aside, head = 38.0 + longest, (20.0 if figure.spans else 10.0)
    middle_x, middle_y = (
        left + 0.5 * (box.width + aside - RIGHT_PX),
        top + box.above + 0.5 * (figure.height_px + head - BELOW_PX),
    )
    bottom = top + box.above + figure.height_px
    to_sheet = (page.transData + page.figure.transSubfigure.inverted()).transform
    (x0, y0), (x1, y1) = to_sheet(
        [(left + aside, bottom - BELOW_PX), (left + box.width - RIGHT_PX, top + box.above + head)]
    )
    paint(figure, box.view, page.figure.add_axes((x0, y0, x1 - x0, y1 - y0)), dark)
    page.text(middle_x, bottom - 10.0, figure.x.text, ha="center", va="center", color=quiet)
    page.text(left + 9.0, middle_y, figure.y.text, ha="center", va="center", rotation=90.0, color=quiet)
    for number, line in enumerate(box.caption):
        page.text(left, bottom + LINE_PX * (number + 0.6), line, va="center", color=quiet)


def _sample(style: Style, page: Axes, start: float, height: float, dark: bool) -> None:
    """A series in the legend."""
    if style.opacity:
        page.bar(start + 0.5 * SAMPLE_PX, 10.0, 12.0, height - 5.0, **_area(style, dark))
    elif style.marker:
        page.plot(start + 0.5 * SAMPLE_PX, height, **_marks(style, dark))
    else:
        page.plot((start, start + SAMPLE_PX), (height, height), **_stroke(style, dark))


def paint(figure: Figure, view: FigureView, axes: Axes, dark: bool = False) -> None:
    """Everything inside the plot, and the ticks, on matplotlib's axes."""
    x, y = view
    axes.set(xscale="log" if figure.x.log else "linear", yscale="log" if figure.y.log else "linear")
    axes.set(xlim=(x.low, x.high), ylim=(y.low, y.high))
    axes.set_xticks(x.ticks, x.texts)
    axes.set_yticks(y.ticks, y.texts)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(NullLocator())
    if figure.x.categories:
        axes.tick_params(axis="x", length=0)
        axes.grid(visible=False, axis="x")
    for span in figure.spans:
        axes.axvspan(span.start, span.end, color=_shade(FURNITURE["grid"], dark), lw=0, zorder=0)
        start, end = (min(1.0, max(0.0, x.share(place))) for place in (span.start, span.end))
        axes.annotate(
            span.label, (0.5 * (start + end), 1.0), (0.0, 4.0 * PT), xycoords="axes fraction",
            textcoords="offset points", ha="center", color=_shade(FURNITURE["quiet"], dark),
        )  # fmt: skip
    for number, series in enumerate(figure.series):
        _series(series, style_of(series, number), axes, dark, 3.0 + 0.01 * number)
    for level in figure.levels:
        _level(level, view, axes, dark)


def _series(series: Series, style: Style, axes: Axes, dark: bool, order: float) -> None:
    """One series; `order`: above those before it."""
    x, y, bucket = thinned(series, POINTS if isinstance(series.x, Uniform) else series.finest)
    x = x.values(y.size) if isinstance(x, Uniform) else x
    if series.draw in ("steps", "filled"):
        if style.opacity:
            axes.stairs(
                y, x, fill=True, alpha=style.opacity, lw=0, color=_shade(SERIES[style.colour], dark), zorder=order
            )
        axes.stairs(y, x, zorder=order, **_stroke(style, dark))
    elif series.draw == "bars":
        axes.bar(x, y, series.bar_width, zorder=order, **_area(style, dark))
    elif series.draw == "points":
        axes.plot(x, y, zorder=order, **_marks(style, dark))
    else:
        axes.plot(*bridged(x, y, bucket), zorder=order, **_stroke(style, dark))
    if series.low is not None and series.high is not None:
        colour = _shade(FURNITURE[style.ends] if style.ends else SERIES[style.colour], dark)
        ends = np.stack([y - series.low, series.high - y])
        there = (ends >= 0.0).all(axis=0)
        axes.errorbar(
            x[there], y[there], ends[:, there], fmt="none", ecolor=colour, elinewidth=WHISKER_PX * PT,
            capthick=WHISKER_PX * PT, capsize=CAP_PX * PT, zorder=order,
        )  # fmt: skip


def _stroke(style: Style, dark: bool) -> dict[str, Any]:
    dash: Any = (0.0, [PT * part for part in style.dash]) if style.dash else "-"
    return {"color": _shade(SERIES[style.colour], dark), "lw": PT * style.width, "ls": dash}


def _area(style: Style, dark: bool) -> dict[str, Any]:
    hatch = "".join(HATCHES[slope] for slope in style.hatch)
    colour, paper = _shade(SERIES[style.colour], dark), _shade(FURNITURE["paper"], dark)
    if style.opacity < 1.0:
        return {"facecolor": (colour, style.opacity), "edgecolor": colour, "lw": PT * style.width}
    return {"facecolor": colour, "hatch": hatch, "edgecolor": paper, "lw": 0.0}


def _marks(style: Style, dark: bool) -> dict[str, Any]:
    colour, paper = _shade(SERIES[style.colour], dark), _shade(FURNITURE["paper"], dark)
    reach = max(max(abs(x), abs(y)) for x, y in style.marker)  # matplotlib scales the outline by it
    outline = [*style.marker, style.marker[0]]
    fill, line = (paper, PT * style.width) if style.hollow else (colour, 0.0)
    return {"ls": "", "marker": outline, "ms": 2.0 * reach * PT, "mfc": fill, "mec": colour, "mew": line}


def _level(level: LevelLine, view: FigureView, axes: Axes, dark: bool) -> None:
    """The line, and its label at its end, on a patch of paper."""
    text, paper = _shade(FURNITURE["text"], dark), _shade(FURNITURE["paper"], dark)
    line = axes.axvline if level.upright else axes.axhline
    line(level.value, color=text, lw=PT, ls=(0.0, [PT * part for part in LEVEL_DASH]), zorder=4.0)
    if not level.label:
        return
    place = view.x.share(level.value) if level.upright else view.y.share(level.value)
    left = level.upright and place <= TURNS
    at, aside, up = ((place, 1.0), 5.0 if left else -5.0, -12.0) if level.upright else ((1.0, place), -5.0, 9.0)
    axes.annotate(
        level.label, at, (PT * aside, PT * up), xycoords="axes fraction", textcoords="offset points", va="center",
        ha="left" if left else "right",
        bbox={"fc": paper, "ec": "none", "alpha": 0.85, "pad": 1.5}, zorder=5.0,
    )  # fmt: skip


def _save(sheet: Sheet, path: Path) -> None:
    """Without dates, so that the same data give the same file; PNG in few colours, a third of the size."""
    if path.suffix == ".png":
        content = BytesIO()
        sheet.savefig(content, format="png", dpi=DOTS_PER_INCH)
        Image.open(content).convert("RGB").quantize(PNG_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    else:
        dated = {".svg": "Date", ".pdf": "CreationDate"}.get(path.suffix)
        sheet.savefig(path, metadata={dated: None, "Creator": "fffo-drive"} if dated else None)


def _shade(colour: Colour, dark: bool) -> str:
    return colour.dark if dark else colour.light


@contextmanager
def look(dark: bool = False) -> Iterator[None]:
    """matplotlib's settings for everything that is drawn."""
    paper, text, quiet, rule, grid = (
        _shade(FURNITURE[name], dark) for name in ("paper", "text", "quiet", "rule", "grid")
    )
    settings: Any = {
        "font.family": next(font for font in FONTS if font in font_manager.get_font_names()),
        "font.size": TEXT_PX * PT,
        "axes.titlecolor": text,
        "axes.labelcolor": quiet,
        "axes.edgecolor": rule,
        "axes.facecolor": paper,
        "axes.axisbelow": True,
        "axes.grid": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "grid.color": grid,
        "grid.linewidth": PT,
        "hatch.linewidth": PT,
        "lines.scale_dashes": False,
        "figure.facecolor": paper,
        "savefig.facecolor": paper,
        "text.color": text,
        "xtick.color": quiet,
        "ytick.color": quiet,
        "svg.fonttype": "path",
        "svg.hashsalt": "fffo-drive",
        "path.simplify": True,
    }
    with rc_context(settings):
        yield

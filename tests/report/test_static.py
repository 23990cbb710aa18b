"""A picture draws every part of a figure in the colours of the palette, with the limits and ticks of the page."""

from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure as Sheet
from PIL import Image

from fffo_drive.report.figures import MARKED, Figure, LevelLine, PlotAxis, Series, Span, Uniform
from fffo_drive.report.palette import SERIES
from fffo_drive.report.static import DOTS_PER_INCH, PX_PER_INCH, paint, write_figure, write_figures
from fffo_drive.report.style import style_of
from fffo_drive.report.view import views

PLACES = np.arange(5.0)
HEIGHTS = np.array([1.0, 3.0, 2.0, 5.0, 4.0])
EVERYTHING = Figure(
    "everything", "xy", "Title of the figure", "Caption of the figure.", PlotAxis("angle", "deg"),
    PlotAxis("torque", "Nm"),
    series=(
        Series("line", PLACES, HEIGHTS, "blue", dash="dashdot"),
        Series("points", PLACES, HEIGHTS + 3.0, "orange", "points", low=HEIGHTS + 2.0, high=HEIGHTS + 4.0),
        Series("dots", np.linspace(0.0, 4.0, MARKED + 1), np.full(MARKED + 1, 9.0), "purple", "points"),
        Series("steps", np.arange(6.0) - 0.5, HEIGHTS + 6.0, "ink", "steps"),
        Series("area", np.arange(6.0) - 0.5, HEIGHTS - 4.0, "grey", "filled"),
        Series("bars", PLACES, HEIGHTS - 6.0, "green", "bars", low=HEIGHTS - 7.0, high=HEIGHTS - 5.0),
    ),
    spans=(Span(1.0, 2.0, "stretch"),), levels=(LevelLine(6.0, "limit"), LevelLine(3.9, "edge", upright=True)),
)  # fmt: skip


def drawn(figure):
    axes = Sheet().add_subplot()
    view = views([figure])[0]
    paint(figure, view, axes)
    return axes, view


def test_limits_and_ticks_are_those_of_the_view():
    axes, (x, y) = drawn(EVERYTHING)
    assert axes.get_xlim() == (x.low, x.high)
    assert axes.get_ylim() == (y.low, y.high)
    for axis, view in ((axes.xaxis, x), (axes.yaxis, y)):
        assert tuple(axis.get_ticklocs()) == view.ticks
        assert tuple(one.get_text() for one in axis.get_ticklabels()) == view.texts
        assert not list(axis.get_minorticklocs())


def test_every_series_is_drawn_in_its_style_and_above_those_before_it():
    axes, _ = drawn(EVERYTHING)
    lines = [line for line in axes.lines if line.get_zorder() < 4.0 and line.get_color() != "none"]
    colours = {to_hex(line.get_markeredgecolor() if line.get_marker() else line.get_color()) for line in lines}
    colours |= {to_hex(one) for patch in axes.patches for one in (patch.get_edgecolor(), patch.get_facecolor())}
    assert {SERIES[series.colour].light for series in EVERYTHING.series} <= colours
    first, points, dots = lines[0], *(line for line in lines if line.get_marker() not in ("None", "|", "_"))
    assert first.get_zorder() < points.get_zorder() < dots.get_zorder()
    assert points.get_markersize() > 3.0 * dots.get_markersize()
    assert len(dots.get_xdata()) == MARKED + 1
    assert [bar.get_hatch() for bar in axes.patches if bar.get_hatch()] == ["///"] * 5
    assert len(axes.containers) == 3  # the bars, and two series with intervals


def test_a_picture_says_what_the_page_says(monkeypatch, tmp_path):
    said = []
    kept = Sheet.savefig

    def save(sheet, *where, **how):
        said.extend(text.get_text() for axes in sheet.axes for text in axes.texts)
        kept(sheet, *where, **how)

    monkeypatch.setattr(Sheet, "savefig", save)
    write_figure(EVERYTHING, tmp_path / "f.svg")
    names = [series.name for series in EVERYTHING.series]
    assert {"Title of the figure", "Caption of the figure.", "angle, deg", "torque, Nm", *names} <= set(said)
    assert {"stretch", "limit", "edge"} <= set(said)
    assert ElementTree.parse(tmp_path / "f.svg").getroot().tag.endswith("svg")


def test_a_long_legend_and_a_long_caption_stay_on_the_sheet(tmp_path):
    many = tuple(Series(f"series number {k}", Uniform(0.0, 0.1), PLACES + k, "blue") for k in range(12))
    words = " ".join(["word"] * 100)
    figure = Figure("f", "time", "t", words, PlotAxis("time", "s"), PlotAxis("v", "rps"), many, width="half")
    write_figure(figure, tmp_path / "f.png")
    with Image.open(tmp_path / "f.png") as picture:
        pixels = np.asarray(picture.convert("L"))
    assert pixels.shape[0] > 1.3 * figure.height_px * DOTS_PER_INCH / PX_PER_INCH  # lines below each other
    assert pixels[:, :8].min() == pixels[:, -8:].min() == 255


@pytest.mark.parametrize("dark", [False, True])
def test_a_png_has_the_colours_of_the_palette(tmp_path, dark):
    bands = tuple(
        Series(name, np.array([0.0, 1.0]), np.array([k + 1.0]), name, "filled") for k, name in enumerate(SERIES)
    )
    path = tmp_path / "f.png"
    write_figure(Figure("f", "histogram", "t", "c", PlotAxis("x", "s"), PlotAxis("y", "s"), bands), path, dark)
    with Image.open(path) as picture:
        found = {to_hex(np.array(colour) / 255.0) for _, colour in picture.convert("RGB").getcolors(1 << 16)}
    assert {colour.dark if dark else colour.light for colour in SERIES.values()} <= found


def test_a_line_bridges_a_few_missing_samples_and_breaks_at_a_stretch_of_them():
    y = np.sin(np.linspace(0.0, 9.0, 200))
    y[20:25] = np.nan
    y[100:150] = np.nan
    axes, _ = drawn(Figure("f", "time", "t", "c", PlotAxis("time", "s"), PlotAxis("v", "rps"),
                           (Series("a", Uniform(0.0, 0.1), y, "blue"),)))  # fmt: skip
    x, kept = axes.lines[0].get_data()
    missing = x[np.isnan(kept)]
    assert (missing.min(), missing.max()) == pytest.approx((10.0, 14.9))


def test_figures_that_share_their_ordinate_share_it_as_pictures(monkeypatch, tmp_path):
    seen = []
    monkeypatch.setattr(Sheet, "savefig", lambda sheet, *_where, **_how: seen.append(sheet.axes[-1].get_ylim()))
    pair = [
        Figure(name, "time", "t", "c", PlotAxis("time", "s"), PlotAxis("v", "rps"),
               (Series("a", Uniform(0.0, 0.1), scale * HEIGHTS, "blue"),), group="g", share_y=True)
        for name, scale in (("small", 1.0), ("large", 100.0))
    ]  # fmt: skip
    write_figures(pair, tmp_path)
    assert seen[0] == seen[1]


def test_series_of_one_kind_differ_without_their_colours():
    dots = [style_of(Series("a", PLACES, HEIGHTS, "blue", "points"), k).marker for k in range(4)]
    hatches = [style_of(Series("a", PLACES, HEIGHTS, "blue", "bars"), k).hatch for k in range(4)]
    assert len(set(dots)) == len(set(hatches)) == 4

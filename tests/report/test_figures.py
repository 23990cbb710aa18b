"""Figures say what they show, statistics in them are right, and both drawings come from the same data."""

import numpy as np
import pytest

from fffo_drive.report import palette
from fffo_drive.report.figures import Figure, Group, PlotAxis, Series, Uniform, grouped_bars, histogram, normal_curve

LINE = Series("a", Uniform(0.0, 0.1), np.arange(5.0), "blue")
TIME, SPEED = PlotAxis("time", "s"), PlotAxis("velocity", "rps")


def contrast(first, second):
    """Contrast ratio of two colours #rrggbb after WCAG 2: 1 (equal) to 21 (black on white)."""
    high, low = sorted((_luminance(first), _luminance(second)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def lightness(colour):
    """L* of CIE 1976 of a colour #rrggbb: 0 black, 100 white."""
    return 116.0 * _luminance(colour) ** (1.0 / 3.0) - 16.0


def _luminance(colour):
    channels = [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize(
    ("change", "missing"),
    [({"title": ""}, "title"), ({"caption": " "}, "caption"), ({"x": PlotAxis("time", "")}, "x unit"),
     ({"y": PlotAxis("", "rps")}, "y label")],
)  # fmt: skip
def test_a_figure_without_title_caption_or_unit_is_refused(change, missing):
    whole = {"title": "t", "caption": "c", "x": TIME, "y": SPEED, **change}
    with pytest.raises(ValueError, match=f"'f' lacks its {missing}"):
        Figure("f", "time", series=(LINE,), **whole)


def test_series_that_cannot_be_drawn_are_refused():
    with pytest.raises(ValueError, match="6 are needed"):
        Series("h", np.arange(5.0), np.arange(5.0), "blue", "steps")
    with pytest.raises(ValueError, match="no colour 'pink'"):
        Series("h", np.arange(5.0), np.arange(5.0), "pink")
    with pytest.raises(ValueError, match="two series of one name"):
        Figure("f", "time", "t", "c", TIME, SPEED, (LINE, LINE))
    with pytest.raises(ValueError, match="equidistant"):
        Figure("f", "time", "t", "c", TIME, SPEED, (Series("a", np.arange(5.0), np.arange(5.0), "blue"),))


def test_a_histogram_is_a_share_of_all_values_and_matches_its_normal_curve():
    values = np.random.default_rng(0).normal(0.3, 2.0, 400_000)
    edges = np.linspace(-8.0, 8.0, 81)
    bars = histogram("h", values, edges, "blue")
    inside = np.count_nonzero((values >= -8) & (values <= 8)) / values.size
    assert bars.y.sum() == pytest.approx(100.0 * inside)
    np.testing.assert_allclose(normal_curve("n", values, edges).y, bars.y, atol=0.15)


def test_the_normal_curve_of_a_constant_is_a_gap():
    assert np.isnan(normal_curve("n", np.ones(10), np.linspace(0.0, 2.0, 5)).y).all()


def test_grouped_bars_stand_side_by_side_and_marks_over_their_own_bar():
    groups = {name: Group([1.0, 2.0], "blue") for name in "abc"}
    series = grouped_bars(groups, {"a": [5.0, 6.0], "c": [7.0, 8.0]}, "marks")
    a, b, c, marks = series
    for category in (0, 1):
        gap = b.x[category] - a.x[category]
        assert a.bar_width < gap
        assert c.x[category] + 0.5 * c.bar_width < category + 0.5
    np.testing.assert_allclose(np.sort(marks.x), np.sort([*a.x, *c.x]))
    assert dict(zip(marks.x.tolist(), marks.y.tolist(), strict=True))[float(c.x[1])] == 8.0


@pytest.mark.parametrize("dark", [False, True])
def test_colours_stand_out_from_their_paper(dark):
    paper = palette.PAPER.dark if dark else palette.PAPER.light
    for name, colour in palette.SERIES.items():
        assert contrast(colour.dark if dark else colour.light, paper) >= 3.0, name
    for name in ("text", "quiet", "good", "caution", "bad"):
        colour = palette.FURNITURE[name]
        assert contrast(colour.dark if dark else colour.light, paper) >= 4.5, name


@pytest.mark.parametrize("dark", [False, True])
def test_the_three_controllers_differ_in_grey(dark):
    shades = [palette.SERIES[name].dark if dark else palette.SERIES[name].light for name in ("orange", "blue")]
    assert contrast(*shades) >= 1.3


def test_contrast_is_that_of_the_web_guidelines():
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)

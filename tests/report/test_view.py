"""Limits and ticks of a figure: everything is in view, ticks are round numbers apart, and figures that share agree."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.report.figures import Figure, Group, LevelLine, PlotAxis, Series, Uniform, grouped_bars
from fffo_drive.report.style import RADIUS_PX, WIDTHS_PX
from fffo_drive.report.view import ACROSS_PX, UP_PX, tick_text, views

TIME, SPEED = PlotAxis("time", "s"), PlotAxis("velocity", "rps")


def course(low, high, **changes):
    y = np.linspace(low, high, 101)
    content = {"name": "f", "kind": "time", "title": "t", "caption": "c", "x": TIME, "y": SPEED,
               "series": (Series("a", Uniform(0.0, 0.01), y, "blue"),)}  # fmt: skip
    return Figure(**{**content, **changes})


def view_of(figure):
    return views([figure])[0]


@given(st.floats(-1e4, 1e4), st.floats(1e-6, 1e6))
def test_the_whole_course_is_in_view_with_round_ticks_that_are_apart(offset, span):
    low = offset * span
    figure = course(low, low + span)
    x, y = view_of(figure)
    assert (x.low, x.high) == pytest.approx((0.0, 1.0))
    assert y.low < low
    assert y.high > low + span
    for view, room, apart in ((x, WIDTHS_PX["full"], ACROSS_PX), (y, figure.height_px, UP_PX)):
        steps = {round(b / (view.high - view.low), 6) for b in np.diff(view.ticks)}
        assert len(steps) == 1
        assert room * steps.pop() >= apart
        step = view.ticks[1] - view.ticks[0]
        digit = step / 10.0 ** math.floor(math.log10(step) + 1e-6)
        assert min(abs(digit - one) for one in (1.0, 2.0, 5.0)) < 1e-3
        assert view.low - 1e-9 <= view.ticks[0] <= view.ticks[-1] <= view.high + 1e-9


@given(st.floats(1e-9, 1e9), st.floats(1.5, 1e12))
def test_a_logarithmic_axis_ends_at_a_round_number_and_its_ticks_are_apart(low, ratio):
    figure = course(low, low * ratio, y=PlotAxis("gain", "-", log=True))
    y = view_of(figure).y
    assert 0.39 * low <= y.low <= low * (1 + 1e-6)
    assert low * ratio * (1 - 1e-6) <= y.high <= 2.51 * low * ratio
    shares = [y.share(tick) for tick in y.ticks]
    assert shares
    assert all((b - a) * figure.height_px >= UP_PX for a, b in pairwise(shares))


def test_what_is_not_positive_has_no_place_on_a_logarithmic_axis():
    y = view_of(course(-1.0, 100.0, y=PlotAxis("gain", "-", log=True))).y
    assert y.low > 0.0
    assert y.high == 100.0


def test_intervals_and_level_lines_are_in_view():
    y = np.array([1.0, 2.0])
    bars = Series("a", np.arange(2.0), y, "blue", "points", low=y - 5.0, high=y + 7.0)
    view = view_of(course(0.0, 1.0, kind="xy", series=(bars,), levels=(LevelLine(20.0, "limit"),)))
    assert view.y.low < -4.0
    assert view.y.high > 20.0
    assert view.x.low < 0.0 < 1.0 < view.x.high


def test_markers_above_bars_have_room_at_the_top():
    marks = Series("a", np.arange(3.0), np.array([95.0, 100.0, 146.0]), "blue", "points")
    y = view_of(course(0.0, 1.0, kind="bars", series=(marks,), x=PlotAxis("law", "-", categories=("a", "b", "c")))).y
    assert y.low == 0.0
    assert (1.0 - y.share(146.0)) * 200.0 > RADIUS_PX


def test_bars_below_zero_have_room_and_zero_in_view():
    bars = tuple(grouped_bars({"a": Group([-3.0, 4.0], "blue")}, {}, ""))
    y = view_of(course(0.0, 1.0, kind="bars", series=bars, x=PlotAxis("law", "-", categories=("one", "two")))).y
    assert y.low < -3.0
    assert y.high > 4.0
    only = tuple(grouped_bars({"a": Group([-3.0, -4.0], "blue")}, {}, ""))
    y = view_of(course(0.0, 1.0, kind="bars", series=only, x=PlotAxis("law", "-", categories=("one", "two")))).y
    assert y.low < -4.0 < 0.0 <= y.high


def test_bars_stand_on_zero_and_keep_their_names():
    bars = tuple(grouped_bars({"a": Group([3.0, 4.0], "blue")}, {}, ""))
    x, y = view_of(course(0.0, 1.0, kind="bars", series=bars, x=PlotAxis("law", "-", categories=("one", "two"))))
    assert y.low == 0.0
    assert (x.ticks, x.texts) == ((0.0, 1.0), ("one", "two"))


def test_figures_of_a_group_that_share_the_ordinate_have_the_same():
    small = course(-1.0, 1.0, name="small", group="g", share_y=True)
    large = course(-50.0, 50.0, name="large", group="g", share_y=True)
    other = course(-9.0, 9.0, name="other", group="g", share_y=True, y=PlotAxis("error", "rps"))
    first, second, third = views([small, large, other])
    assert first.y == second.y
    assert first.y.high > 50.0
    assert third.y.high < 11.0


def test_figures_of_a_group_have_one_abscissa_of_its_longest():
    longer = course(0.0, 1.0, name="longer", group="g", series=(Series("a", Uniform(0.0, 0.01), np.ones(301), "blue"),))
    first, second = views([course(0.0, 1.0, group="g"), longer])
    assert first.x == second.x
    assert first.x.high == pytest.approx(3.0)


def test_limits_of_the_figure_are_its_view():
    x, y = view_of(
        course(-1.0, 1.0, x=PlotAxis("time", "s", limits=(0.2, 0.4)), y=PlotAxis("v", "rps", limits=(0.0, 9.0)))
    )
    assert (x.low, x.high, y.low, y.high) == (0.2, 0.4, 0.0, 9.0)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.25, "0.25"), (-400.0, "−400"), (1e-3, "0.001"), (1e-4, "1e−4"), (2.5e-4, "2.5e−4"), (1e5, "1e5"),
     (50000.0, "50000")],
)  # fmt: skip
def test_ticks_are_plain_numbers_where_these_are_short(value, text):
    assert tick_text(value) == text

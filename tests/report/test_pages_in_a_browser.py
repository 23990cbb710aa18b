"""Every page in a real browser: machine and figure in the first screen, narrow, folded, on paper, accessible."""

from __future__ import annotations

import re
from itertools import combinations

import numpy as np
import pytest
from report.bench_runs import bench_records
from report.test_circle_report import circle
from report.test_diagnose_report import REST, SOURCE, diagnosis, finding
from report.test_evaluate_report import SAMPLES, report_of, run
from report.test_figures import lightness
from report.test_identify_report import chirp_report
from report.test_tune_report import made as tune_report

from fffo_drive.report.bench import bench_report
from fffo_drive.report.circle import circle_report
from fffo_drive.report.diagnose import diagnosis_report
from fffo_drive.report.page import render_page
from fffo_drive.report.palette import LEAST_LIGHTNESS, SERIES
from fffo_drive.report.view import views

pytestmark = [pytest.mark.slow, pytest.mark.browser, pytest.mark.timeout(200)]
SCREEN = {"width": 1280, "height": 800}
PHONE = {"width": 420, "height": 800}
SERIOUS = ("serious", "critical")
LARGEST_BYTES = 1_500_000
EFFECT = finding(alternatives=())

MAKERS = {
    "bench": lambda directory: bench_report(bench_records(directory, 12.0)),
    "circle": lambda _: circle_report(circle()),
    "evaluate": lambda _: report_of(
        run("pi", list(range(SAMPLES)), 0.02), run("pi+fffo", list(range(SAMPLES)), 0.01)
    ),
    "identify": lambda directory: chirp_report(directory)[2],
    "tune": lambda directory: tune_report(directory)[1],
    "effect": lambda _: diagnosis_report(SOURCE, diagnosis(findings=(EFFECT,), unexplained_rest=REST)),
    "family": lambda _: diagnosis_report(SOURCE, diagnosis()),
    "nothing": lambda _: diagnosis_report(
        SOURCE, diagnosis(verdict="no_effect_found", headline="No effect found.", findings=())
    ),
    "unexplained": lambda _: diagnosis_report(
        SOURCE, diagnosis(verdict="unexplained", headline="Something is left.", findings=(), unexplained_rest=REST)
    ),
    "nothing carries over": lambda _: diagnosis_report(
        SOURCE._replace(model_path=""),
        diagnosis(verdict="nothing_carries_over", headline="Nothing carries over.", model_after=None,
                  findings=(finding(accepted=False),)),
    ),
}  # fmt: skip

# of each figure: limits and ticks of both axes
AXES = """Plots.made.map(({ u }) => ["x", "y"].map((scale, k) => {
  const { min, max } = u.scales[scale], { _splits, _values } = u.axes[k];
  return { low: min, high: max, ticks: _splits, texts: _values };
}))"""
# of each figure: every text inside it, and how many pixels have the colour of each series when it stands there alone
PAINTED = """Plots.made.map(({ figure, u }) => {
  const said = [], fill = u.ctx.fillText, levels = figure.levels, painted = {}, { width, height } = u.ctx.canvas;
  u.ctx.fillText = (text, ...place) => { said.push(text); fill.call(u.ctx, text, ...place); };
  Paint.spans(u, figure);
  Paint.all(u, figure);
  delete u.ctx.fillText;
  figure.levels = [];
  const copy = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  for (const s of figure.series) {
    for (const one of figure.series) one.shown = one === s;
    u.ctx.clearRect(0, 0, width, height);
    copy.clearRect(0, 0, width, height);
    Paint.all(u, figure);
    copy.drawImage(u.ctx.canvas, 0, 0);
    const hue = Paint.variable("series-" + s.style.colour), { data } = copy.getImageData(0, 0, width, height);
    const [r, g, b] = [1, 3, 5].map((k) => parseInt(hue.slice(k, k + 2), 16));
    painted[s.name] = 0;
    for (let k = 0; k < data.length; k += 4)
      if (data[k + 3] > 128 && Math.hypot(data[k] - r, data[k + 1] - g, data[k + 2] - b) < 80) painted[s.name] += 1;
  }
  for (const one of figure.series) one.shown = true;
  figure.levels = levels;
  u.redraw();
  return { said, painted };
})"""


@pytest.fixture(scope="module", params=MAKERS, ids=[name.replace(" ", "_") for name in MAKERS])
def report(request, tmp_path_factory):
    return MAKERS[request.param](tmp_path_factory.mktemp("inputs"))


@pytest.fixture(scope="module")
def page(report, tmp_path_factory, chromium):
    """A page from its file, with everything that it complained of or asked for."""
    file = tmp_path_factory.mktemp("page") / "report.html"
    file.write_text(render_page(report), encoding="utf-8")
    assert file.stat().st_size < LARGEST_BYTES
    context = chromium.new_context(viewport=SCREEN)
    page = context.new_page()
    complaints = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text))
    page.on("request", lambda asked: complaints.append(asked.url) if not asked.url.startswith("file:") else None)
    page.goto(file.as_uri())
    page.wait_for_selector("figure canvas")
    yield page
    assert complaints == []
    context.close()


def test_the_first_figure_is_in_the_first_screen_below_at_most_five_lines(page):
    page.set_viewport_size(SCREEN)
    box = page.locator("figure .plot").first.bounding_box()
    assert box["y"] + box["height"] <= SCREEN["height"]
    assert page.locator(".words dd").count() == 3
    assert 1 + page.locator(".lines dd").count() <= 5
    heights = page.locator(".lines dd").evaluate_all("all => all.map(one => one.offsetHeight)")
    assert max(heights) <= 4 * 22  # a line that is no novel


def test_what_is_folded_opens_with_its_figures_drawn_over_the_whole_width(page):
    folds = page.locator("details.fold")
    assert not any(folds.evaluate_all("all => all.map(one => one.open)"))
    page.click("#unfold")
    page.wait_for_function("[...document.querySelectorAll('figure .plot')].every(one => "
                           "Math.abs(one.clientWidth - one.querySelector('.uplot').clientWidth) <= 1)")  # fmt: skip
    assert all(folds.evaluate_all("all => all.map(one => one.open)"))
    page.click("#unfold")
    assert not any(folds.evaluate_all("all => all.map(one => one.open)"))


def test_it_can_be_read_on_a_phone_and_on_paper(page):
    page.set_viewport_size(PHONE)
    page.click("#unfold")
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    page.click("#unfold")
    page.set_viewport_size(SCREEN)
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert all(page.locator("details.fold").evaluate_all("all => all.map(one => one.open)"))
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert not any(page.locator("details.fold").evaluate_all("all => all.map(one => one.open)"))


def test_in_greyscale_the_series_of_a_figure_differ_in_lightness_dash_marker_or_hatch(page):
    legends = page.locator("figure .legend").evaluate_all(
        "all => all.map(one => [...one.querySelectorAll('button')].map(entry => [entry.innerText.trim(), "
        "entry.querySelector('svg').outerHTML]))"
    )
    assert any(len(entries) > 1 for entries in legends)
    for entries in legends:
        for first, second in combinations(entries, 2):
            assert _in_grey(first[1]) != _in_grey(second[1]) or _apart(first[1], second[1]) >= LEAST_LIGHTNESS, (
                first[0], second[0])  # fmt: skip


def _in_grey(sample):
    """The sample of a line in the legend without its colour, and without a weight that no eye measures."""
    return re.sub(r"--series-\w+|stroke-width=\"[^\"]*\"", "", sample)


def _apart(*samples):
    """Difference in lightness of two samples, on light or dark paper, whichever is less."""
    first, second = (SERIES[re.search(r"--series-(\w+)", sample).group(1)] for sample in samples)
    return min(abs(lightness(a) - lightness(b)) for a, b in zip(first, second, strict=True))


def test_a_screen_reader_and_the_keyboard_find_everything(page):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page.set_viewport_size(SCREEN)
    page.click("#unfold")
    found = axe.run(page).response["violations"]
    page.click("#unfold")
    assert [(one["id"], one["nodes"][0]["html"][:120]) for one in found if one["impact"] in SERIOUS] == []


def test_the_page_shows_each_figure_with_the_limits_and_ticks_of_its_picture(page, report):
    page.set_viewport_size(SCREEN)
    page.click("#unfold")
    page.wait_for_function("Plots.made.every(one => one.u.width === one.host.clientWidth)")
    shown = page.evaluate(AXES)
    page.click("#unfold")
    for figure, view, axes in zip(report.figures, views(report.figures), shown, strict=True):
        for wanted, found in zip(view, axes, strict=True):
            assert (found["low"], found["high"]) == (wanted.low, wanted.high), figure.name
            assert (tuple(found["ticks"]), tuple(found["texts"])) == (wanted.ticks, wanted.texts), figure.name


def test_the_page_draws_every_series_band_mark_and_label(page, report):
    """Each series alone on its figure leaves its colour there; each label is written where it stands in a picture."""
    found = page.evaluate(PAINTED)
    for figure, drawn in zip(report.figures, found, strict=True):
        empty = {one.name for one in figure.series if not np.isfinite(one.y).any() or not np.any(one.y)}
        assert {name for name, pixels in drawn["painted"].items() if pixels == 0} <= empty, figure.name
        for part in (*figure.spans, *figure.levels):
            assert part.label in drawn["said"], figure.name
        box = page.locator(f"#figure-{figure.name}")
        entries = box.locator(".legend button").evaluate_all("all => all.map(one => one.textContent.trim())")
        assert [" ".join(entry.split()) for entry in entries] == [" ".join(s.name.split()) for s in figure.series]
        for text in (figure.title, figure.caption):
            assert " ".join(text.split()) in " ".join(box.text_content().split())


def test_the_values_of_bars_can_be_read_off(page, report):
    page.set_viewport_size(SCREEN)
    page.click("#unfold")
    for figure in (one for one in report.figures if one.kind == "bars"):
        plot = page.locator(f"#figure-{figure.name} .u-over")
        plot.scroll_into_view_if_needed()
        box = plot.bounding_box()
        plot.hover(position={"x": box["width"] * 0.6 / len(figure.x.categories), "y": 20})  # the first category
        said = page.locator(f"#figure-{figure.name} .legend").inner_text()
        assert f"at {figure.x.categories[0]}" in said
        for series in (one for one in figure.series if one.draw == "bars"):
            assert f"{series.y[0]:.4g}"[:4] in said
    page.click("#unfold")


def test_zoomed_and_back_a_figure_is_as_before(page):
    def look():
        return page.evaluate(
            "Plots.made.map(({ u }) => [u.scales.x.min, u.scales.x.max, u.scales.y.min, u.scales.y.max])"
        )

    before = look()
    page.evaluate("Plots.made.forEach((plot) => Plots.zoom(plot, 0.25))")
    page.wait_for_timeout(0)
    assert all(a[0] < b[0] and b[1] < a[1] for a, b in zip(before, look(), strict=True))
    page.evaluate("Plots.made.forEach(Plots.showAll)")
    page.wait_for_timeout(0)
    assert look() == before

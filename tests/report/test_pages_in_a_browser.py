"""Every page in a real browser: machine and figure in the first screen, narrow, folded, on paper, accessible."""

from __future__ import annotations

import re
from itertools import combinations

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


@pytest.fixture(scope="module", params=MAKERS, ids=[name.replace(" ", "_") for name in MAKERS])
def page(request, tmp_path_factory, chromium):
    """A page from its file, with everything that it complained of or asked for."""
    directory = tmp_path_factory.mktemp("page")
    file = directory / "report.html"
    file.write_text(render_page(MAKERS[request.param](directory)), encoding="utf-8")
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

"""The page: whole in itself, small, well-formed, safe against what stands in the data."""

import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from pydantic import ValidationError
from report.bench_runs import bench_records

from fffo_drive.documents import DocumentError
from fffo_drive.report.bench import bench_report
from fffo_drive.report.document import (
    Cell,
    Heading,
    Line,
    Report,
    ReportFile,
    Row,
    Section,
    Table,
    Verdict,
    number,
    provenance,
    significant,
    source_file,
)
from fffo_drive.report.encoding import LARGEST_DATA_BYTES, encode_figures
from fffo_drive.report.figures import Figure, PlotAxis, Series, Uniform
from fffo_drive.report.page import column_groups, render_page, script_json, write_report

VOID = {"meta", "link", "br", "img", "input", "hr", "line", "path", "rect"}
LARGEST_PAGE_BYTES = 3_000_000


class Outline(HTMLParser):
    """Elements with their attributes, and what is left open or closed in the wrong order."""

    def __init__(self):
        super().__init__()
        self.open, self.wrong, self.elements, self.texts = [], [], [], {}

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)

    def handle_data(self, data):
        if self.open:
            self.texts.setdefault(self.open[-1], []).append(data)


def outline(page):
    parser = Outline()
    parser.feed(page)
    parser.close()
    return parser


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    return bench_report(bench_records(tmp_path_factory.mktemp("runs"), 12.0, skipped=50))


@pytest.fixture(scope="module")
def page(report):
    return render_page(report)


def test_the_page_is_well_formed(page):
    found = outline(page)
    assert found.open == []
    assert found.wrong == []
    ids = [attrs["id"] for _, attrs in found.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    for _, attrs in found.elements:
        for name in ("aria-labelledby", "aria-describedby"):
            assert set((attrs.get(name) or "").split()) <= set(ids)


def test_the_page_loads_nothing(page):
    found = outline(page)
    for tag, attrs in found.elements:
        assert tag not in ("link", "iframe", "object", "embed", "base")
        assert not {"src", "href", "srcset", "action"} & set(attrs)
    styles = "".join(found.texts["style"])
    assert "@import" not in styles
    assert not re.search(r"url\((?!#)", styles)
    scripts = "".join(found.texts["script"])
    assert not re.search(r"\b(fetch|XMLHttpRequest|WebSocket|EventSource|importScripts|sendBeacon)\b", scripts)
    policy = next(attrs["content"] for tag, attrs in found.elements if attrs.get("http-equiv"))
    assert policy.startswith("default-src 'none'")


def test_every_figure_says_what_it_shows(page, report):
    assert len(report.figures) > 10
    found = outline(page)
    identities = {attrs.get("id") for _, attrs in found.elements}
    for figure in report.figures:
        assert {f"figure-{figure.name}", f"title-{figure.name}", f"caption-{figure.name}"} <= identities
    plots = [attrs for _, attrs in found.elements if attrs.get("class") == "plot"]
    assert len(plots) == len(report.figures)
    assert all(plot["tabindex"] == "0" and plot["aria-label"] for plot in plots)


def test_verdict_comes_first_and_provenance_last(page):
    order = [page.index(mark) for mark in ('class="verdict', "<figure", "<table", "<footer", "SHA-256")]
    assert order == sorted(order)


def test_text_from_files_stays_text(page):
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)" in page
    assert "<b>bold" not in page


def test_script_json_cannot_leave_its_element():
    hostile = {"name": "</script><!-- & \u2028"}
    text = str(script_json(hostile))
    assert not set("<>&") & set(text)
    assert json.loads(text) == hostile


def test_figures_in_the_page_can_be_read_back(page, report):
    text = re.search(r'<script type="application/json" id="figure-data">(.*?)</script>', page, re.S).group(1)
    figures = json.loads(text)
    assert [figure["name"] for figure in figures] == [figure.name for figure in report.figures]
    velocity = next(figure for figure in figures if figure["name"] == "velocity")
    assert all(series["bucket"] == 1 for series in velocity["series"])  # every sample is there to zoom into


@pytest.mark.slow
def test_a_bench_of_a_minute_at_2_khz_stays_below_3_mb(tmp_path):
    page = render_page(bench_report(bench_records(tmp_path, 60.0)))
    assert len(page.encode()) < LARGEST_PAGE_BYTES


def long_figure(name, samples):
    y = np.random.default_rng(0).normal(size=samples)
    series = tuple(Series(letter, Uniform(0.0, 5e-4), y, "blue", finest=1 << 20) for letter in "abcd")
    return Figure(name, "time", "t", "c", PlotAxis("time", "s"), PlotAxis("velocity", "rps"), series)


def test_longer_records_give_way_to_the_limit():
    encoded = encode_figures([long_figure("f", 600_000)])
    size = len(json.dumps(encoded))
    assert 0.6 * LARGEST_DATA_BYTES < size < 1.01 * LARGEST_DATA_BYTES
    assert all(series["bucket"] > 1 for series in encoded[0]["series"])


def small_report(**changes):
    verdict = Verdict(headline="It is good.", finding="good", confidence="certain", next_step="nothing to do")
    content = {
        "kind": "identify", "title": "A report", "subtitle": "of something", "verdict": verdict, "tables": (),
        "sections": (Section("s", "text", (long_figure("f", 100),)),),
        "provenance": provenance([source_file("log.mcap", b"abc")], {}),
    }  # fmt: skip
    return Report(**{**content, **changes})


def test_a_report_of_another_kind_needs_no_more(tmp_path):
    table = Table(
        name="parameters", title="Parameters", note="with 95 % intervals",
        columns=[Heading(label="value"), Heading(label="source")],
        rows=[Row(label="J", unit="kg m²", cells=[number(1.5e-4, low=1.4e-4, high=1.6e-4), Cell(text="fitted")])],
    )  # fmt: skip
    paths = write_report(small_report(tables=(table,)), tmp_path)
    page = paths.page.read_text()
    assert outline(page).wrong == []
    assert "0.00014 to 0.00016" in page
    content = ReportFile.model_validate_json(paths.json.read_text())
    assert content.tables[0].rows[0].cells[0].value == 1.5e-4
    assert content.provenance.files[0].sha256.startswith("ba7816bf")


def test_a_report_of_another_kind_is_not_overwritten(tmp_path):
    directory = tmp_path / "made" / "here"
    paths = write_report(small_report(kind="fleet"), directory)
    before = paths.json.read_text()
    with pytest.raises(DocumentError, match=r"here: holds the report of `fleet`.*give `tune` another --out"):
        write_report(small_report(kind="tune"), directory)
    assert paths.json.read_text() == before


def test_the_opening_figure_stands_first_and_once():
    sections = (Section("s", "text", (long_figure("f", 10), long_figure("g", 10))),)
    report = small_report(sections=sections, opening="g")
    page = render_page(report)
    assert [f.name for s in report.folded_sections for f in s.figures] == ["f"]
    assert page.index('id="figure-g"') < page.index('id="figure-f"')
    assert "<b>Figure 1.</b>" in page[page.index('id="caption-g"') :][:60]
    with pytest.raises(ValueError, match="does not have"):
        _ = small_report(sections=sections, opening="h").opening_figure


def test_a_page_opens_with_at_most_seven_lines():
    def opening(below):
        line = Line(label="a", text="b")
        return Verdict(headline="h", finding="f", confidence="certain", next_step="n", lines=[line] * below)

    assert len(opening(6).lines) == 6
    with pytest.raises(ValidationError):
        opening(7)


def test_two_figures_of_one_name_are_refused():
    with pytest.raises(ValueError, match="one name"):
        _ = small_report(sections=(Section("s", "", (long_figure("f", 10), long_figure("f", 10))),)).figures


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.0343, "0.0343"), (123456.0, "123456"), (-2.5, "−2.50"), (1.5e-7, "1.50e−07"), (9.999, "10.00")],
)
def test_numbers_are_printed_to_their_significant_digits(value, text):
    assert significant(value) == text


def test_column_groups_span_neighbours():
    columns = [Heading(label="a", group="x"), Heading(label="b", group="x"), Heading(label="c")]
    assert column_groups(columns) == [("x", 2), ("", 1)]
    assert column_groups([Heading(label="a")]) == []

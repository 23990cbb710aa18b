"""The page of a circle states the result of the diagnosis: adopted, refused, nothing confirmed, a residual."""

from __future__ import annotations

import numpy as np
import pytest
from report.bench_runs import PERIOD_NS, STICTION_RPS, bench_rows, reference

from fffo_drive.report.circle import CircleRun, CircleSource, as_object, circle_report, tracking_of
from fffo_drive.report.document import provenance
from fffo_drive.report.page import render_page

PROFILE = reference(20.0)
HEADLINE = "No finding carries over: on the held-out runs the torque error is not smaller."
REST = "75 % of the remaining squared residual has an unknown cause"


def circle(**changes):
    before, after = (bench_rows(PROFILE, STICTION_RPS[name], seed) for seed, name in enumerate(("PI", "PI+FFFO")))
    for rows in (before, after):
        rows["true_velocity_rps"] = np.nan  # the drive does not know its shaft
    after = after if changes.pop("again", True) else None
    figures = {"held_out": {"torque_relative_percent": 5.0}}
    content = {
        "axis": "bench", "verdict": "effects_found", "effects": ("cogging",), "unexplained_rest": "",
        "not_compensated": {}, "gates": ({"name": "held-out error", "passed": True, "text": "fell"},),
        "model_error": {"before": figures, "after": {"held_out": {"torque_relative_percent": 2.0}}},
        "tracking": tracking_of(before, after, PERIOD_NS / 1e9, PROFILE.values.size),
        "runs": (CircleRun("before", 2000, 40_000, 0.0, 0.0005),), "provenance": provenance([], {}),
    }  # fmt: skip
    return CircleSource(**{**content, **changes})


@pytest.fixture(scope="module")
def refused():
    gate = {"name": "held-out error", "passed": False, "text": HEADLINE}
    return circle(verdict="nothing_carries_over", effects=(), gates=(gate,), again=False)


def test_what_does_not_carry_over_is_not_adopted_and_the_page_says_so(refused):
    report = circle_report(refused)
    assert not refused.adopted
    assert report.verdict.finding == "nothing confirmed"
    assert "lowers the error of the held-out run" in report.verdict.headline
    assert HEADLINE in render_page(report)
    assert as_object(refused)["verdict"] == "nothing_carries_over"


def test_an_adoption_that_helps_is_good_unless_something_is_left():
    report = circle_report(circle())
    assert (report.verdict.finding, report.verdict.confidence) == ("adopted, better", "certain")
    lines = {line.label: line.text for line in report.verdict.lines}
    assert "5.00 to 2.00 % of the torque that the axis needs" in lines["Model"]
    left = circle(unexplained_rest=REST)
    report = circle_report(left)
    assert f"Not explained: {REST}." in report.verdict.cautions
    assert as_object(left)["unexplained_rest"] == REST


def test_an_error_that_is_no_number_does_not_stop_the_page():
    none = {"held_out": {"torque_relative_percent": None}}
    report = circle_report(circle(model_error={"before": none, "after": none}))
    assert any("not finite to not finite %" in line.text for line in report.verdict.lines)


def test_the_headline_is_of_what_a_real_axis_measures():
    source = circle()
    metrics = source.tracking.metrics
    shaft = source.tracking._replace(
        metrics={**metrics, "true": metrics["measured"]._replace(after=metrics["measured"].before)}
    )
    intervals = {**source.tracking.intervals, "true": source.tracking.intervals["measured"]}
    report = circle_report(source._replace(tracking=shaft._replace(intervals=intervals)))
    assert report.verdict.headline == circle_report(source).verdict.headline


def test_what_was_found_and_is_not_in_service_is_no_headline():
    report = circle_report(
        circle(effects=("cogging", "backlash"), not_compensated={"backlash": "not known in advance"})
    )
    assert report.verdict.headline.startswith("Found and adopted: cogging. ")

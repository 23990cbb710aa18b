"""The page of a diagnosis: verdict first, the family named, intervals shown, nothing invented, the schema beside it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fffo_drive.cli.diagnose import curve_words
from fffo_drive.diagnosis.results import (
    Ceiling,
    Diagnosis,
    ErrorFigures,
    Finding,
    FoundCurve,
    Interval,
    Number,
    Picture,
    PictureMark,
    ResidualChannel,
    Rest,
    Rival,
    RunFigure,
    in_words_of_axis,
)
from fffo_drive.diagnosis.results import report as report_object
from fffo_drive.identification.runs import PARAMETERS, Estimate, Remark, RunLook, RunsLook
from fffo_drive.model.effects.registry import LAWS, law_of
from fffo_drive.model.parameters import read_model
from fffo_drive.report.diagnose import DiagnosisSource, diagnosis_report, write_diagnosis_report
from fffo_drive.report.diagnose_verdict import doubts
from fffo_drive.report.document import provenance, source_file
from fffo_drive.report.page import render_page

TABLE_1 = Path(__file__).resolve().parents[2] / "configs" / "models" / "table1.yaml"
SOURCE = DiagnosisSource("<axis>", provenance([source_file("log.mcap", b"abc")], {}), "model_after.yaml")
LARGEST_PAGE_BYTES = 3_000_000


def errors(torque_nm, seconds=60.0):
    def interval(value):
        return Interval(value, 0.9 * value, 1.1 * value)

    return ErrorFigures(interval(torque_nm), interval(1000.0 * torque_nm), interval(3.0 * torque_nm), seconds)


def picture():
    x = np.linspace(0.0, 1.0, 25)
    wave = 0.008 * np.sin(2 * np.pi * x)
    curves = (
        FoundCurve("without", x, wave, wave - 0.001, wave + 0.001),
        FoundCurve("with", x, 0.1 * wave, 0.1 * wave - 0.001, 0.1 * wave + 0.001),
        FoundCurve("law", x, wave, kind="line"),
    )
    return Picture("cogging over the motor angle", "motor angle", "rev", "residual torque", "Nm", curves)


def law_picture():
    order = np.linspace(0.1, 24.0, 240)
    peak = 0.008 / (1.0 + (4.0 * (order - 12.0)) ** 2)
    curves = (FoundCurve("without", order, peak, kind="line"), FoundCurve("with", order, 0.05 * peak, kind="line"))
    marks = (PictureMark(12.0, "cogging, 12"),)
    return Picture(
        "Cogging: spectrum", "order", "", "amplitude", "Nm", curves, marks=marks, says="Amplitude of a wave."
    )


def finding(**changes):
    content = {
        "name": "cogging", "alternatives": ("torque_ripple",), "axis": "motor_angle", "explained_fraction": 0.62,
        "parameters": (Number("cos_nm", 0.008, 0.0002, "Nm", "track"), Number("order", 12.0, None, "1/rev")),
        "false_alarm_probability": 0.002, "accepted": True, "reason": "beyond chance", "regime": "everywhere",
        "experiment": "turn slowly at two loads", "compensable": True, "strength_percent": 17.0,
        "torque_rms_nm": 0.008,
        "rivals": (Rival("torque_ripple", 1.01, 0.98, True), Rival("unbalance", 3.0, 0.1, False)),
        "picture": picture(), "law_picture": law_picture(), "gain": (200.0, 10.0), "held_out_gain": (50.0, 5.0),
        "regime_before": errors(0.01, 20.0), "regime_after": errors(0.003, 20.0),
    }  # fmt: skip
    return Finding(**{**content, **changes})


def diagnosis(**changes):
    time_s = np.arange(0.0, 60.0, 0.25)
    band = 0.004 + 0.001 * np.sin(time_s)
    run = RunFigure("check", "held_out", time_s, -band, band, -0.3 * band, 0.3 * band)
    content = {
        "verdict": "effects_found", "headline": "Cogging is missing in the model.",
        "findings": (
            finding(),
            finding(name="unbalance", accepted=False, reason="within chance", picture=None, law_picture=None),
        ),
        "before": errors(0.0052), "after": errors(0.0021), "fit_before": errors(0.005), "fit_after": errors(0.002),
        "ceiling": Ceiling(0.9, None, 0.001, 0.95, "2 repeats of the staircase"),
        "channels": (ResidualChannel("motor_angle", 0.6, 0.02, True, False, 100_000),),
        "runs": (run, replace(run, name="track", role="fit")),
        "model_before": read_model(TABLE_1), "model_after": read_model(TABLE_1), "false_alarm_rate": 0.01,
        "units": "rotary", "fit_names": ("track",), "held_out_names": ("check",), "seconds": 31.0,
    }  # fmt: skip
    return Diagnosis(**{**content, **changes})


def test_verdict_comes_first_and_says_how_sure_and_what_it_may_be_instead():
    report = diagnosis_report(SOURCE, diagnosis())
    assert report.verdict.headline == "The model lacks: cogging or torque ripple."
    assert (report.verdict.finding, report.verdict.confidence) == ("cogging or torque ripple", "cannot tell")
    lines = {line.label: line for line in report.verdict.lines}
    assert list(lines) == ["Explained", "Cause", "Next"]
    explained = "The model's error on the held-out runs falls from 5.2 to 2.1 % of the torque that the axis needs."
    assert lines["Explained"].text == explained
    assert lines["Cause"].text.startswith(
        "8.0 mNm rms, torque that varies with the motor angle and keeps its sign. There "
    )
    assert lines["Cause"].text.endswith("(p = 0.0020), but these runs do not separate cogging and torque ripple.")
    assert lines["Next"].command == "fffo-drive run AXIS.yaml --decide cogging"
    first = report.verdict.reasons[0]
    assert "cogging, or torque_ripple" in first
    assert "62 % of the squared residual that the other effects leave" in first
    assert "p = 0.0020" in first
    page = render_page(report)
    marks = [page.index(mark) for mark in ('class="verdict', "<figure", 'id="table-found"', 'id="table-errors"')]
    assert marks == sorted(marks)
    assert "&lt;axis&gt;" in page
    assert len(page.encode()) < LARGEST_PAGE_BYTES


def test_a_certain_finding_is_reported_with_cause_place_size_and_the_command_that_adopts_it():
    sure = finding(alternatives=())
    verdict = diagnosis_report(SOURCE, diagnosis(findings=(sure, finding(name="backlash", alternatives=())))).verdict
    assert verdict.headline == (
        "The model lacks: cogging, and backlash. Usually: the motor's magnets against the teeth of its stator."
    )
    assert (verdict.finding, verdict.confidence, verdict.next_step) == ("2 effects", "certain", "adopt it")
    assert verdict.lines[-1].command == "fffo-drive adopt model_after.yaml --axis AXIS.yaml"
    blank = diagnosis_report(SOURCE._replace(model_path="my fit/model.yaml"), diagnosis(findings=(sure,))).verdict
    assert blank.lines[-1].command == "fffo-drive adopt 'my fit/model.yaml' --axis AXIS.yaml"
    mended = diagnosis_report(SOURCE, diagnosis(findings=(replace(sure, name="backlash", compensable=False),))).verdict
    assert (mended.next_step, mended.lines[-1].command) == ("fix it on the machine", "")
    assert "coupling" in mended.lines[-1].text
    alone = diagnosis_report(SOURCE, diagnosis(findings=(sure,), before=None, after=None)).verdict
    assert (alone.next_step, alone.lines[-1].command) == ("hold a run out", "")  # `adopt` would refuse the model
    assert "--held-out" in alone.lines[-1].text


@pytest.mark.parametrize(
    ("changes", "confidence"),
    [
        ({}, "certain"),
        ({"held_out_gain": (50.0, 40.0)}, "certain"),  # by the error where it acts: 10 before, 3 after
        ({"held_out_gain": (50.0, 40.0), "regime_after": errors(0.0095)}, "probable"),
        ({"held_out_gain": None, "regime_before": None, "regime_after": None}, "probable"),
        ({"alternatives": ("unbalance",)}, "cannot tell"),
        ({"doubt": "it does not stand out"}, "cannot tell"),
    ],
)
def test_a_finding_is_certain_where_held_out_runs_show_it_beyond_their_intervals(changes, confidence):
    assert finding(**{"alternatives": (), **changes}).confidence == confidence


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
def test_every_law_has_a_plain_name_a_cause_a_remedy_and_a_place(law):
    assert "_" not in law.plain_name
    assert law.cause
    assert law.remedy
    assert law.place_of({p.name: p.typical for p in law.parameters})


def test_errors_stand_before_and_after_with_intervals_on_all_of_it_and_where_the_effect_acts():
    tables = {table.name: table for table in diagnosis_report(SOURCE, diagnosis()).tables}
    rows = {row.label: row for row in tables["errors"].rows}
    assert list(rows) == ["held out", "cogging", "fitted runs"]
    cells = rows["held out"].cells
    assert [cells[0].value, cells[3].value] == [5.2, 2.1]
    assert cells[0].low == pytest.approx(4.68)
    assert [column.unit for column in tables["errors"].columns[:3]] == ["%", "mNm", "mrps"]
    assert cells[1].value == pytest.approx(5.2)
    assert cells[5].value == pytest.approx(6.3)
    assert [column.group for column in tables["errors"].columns] == ["before"] * 3 + ["after"] * 3
    assert rows["cogging"].unit == "20 s"
    assert "that the axis needs" in tables["errors"].note


def test_a_gain_stands_with_its_interval_on_fitted_and_on_held_out_runs():
    tables = {table.name: table for table in diagnosis_report(SOURCE, diagnosis()).tables}
    columns = [(column.group, column.label) for column in tables["found"].columns]
    fitted, held_out = (columns.index(("gain", label)) for label in ("fitted runs", "held out"))
    cells = tables["found"].rows[0].cells
    assert (cells[fitted].value, cells[held_out].value) == (200.0, 50.0)
    assert cells[fitted].low == pytest.approx(200.0 - 1.96 * 10.0)
    unproven = diagnosis(findings=(finding(held_out_gain=None),))
    tables = {table.name: table for table in diagnosis_report(SOURCE, unproven).tables}
    assert tables["found"].rows[0].cells[held_out].text == "–"


def test_a_refused_effect_stands_with_the_reason():
    reason = "it lowers the error by shrinking the axis: only 31 % of the torque would be needed"
    report = diagnosis_report(SOURCE, diagnosis(findings=(finding(accepted=False, reason=reason),)))
    table = next(table for table in report.tables if table.name == "rejected")
    assert [(row.label, row.cells[-1].text) for row in table.rows] == [("cogging", reason)]


def test_a_family_comes_with_the_experiment_that_decides_and_a_sure_one_without():
    listings = {listing.name: listing.text for listing in diagnosis_report(SOURCE, diagnosis()).listings}
    assert listings["experiments"] == "cogging and torque_ripple: turn slowly at two loads"
    sure = diagnosis(findings=(finding(alternatives=()),))
    assert "experiments" not in {listing.name for listing in diagnosis_report(SOURCE, sure).listings}


def test_each_finding_has_its_picture_and_each_run_its_residual():
    figures = {figure.name: figure for figure in diagnosis_report(SOURCE, diagnosis()).figures}
    assert set(figures) == {"effect-1", "effect-1-own", "run-1", "run-2", "channels"}
    own = figures["effect-1-own"]  # what its law asks for, with the orders that were found
    assert next(iter(figures)) == "effect-1-own"
    assert [(level.value, level.label, level.upright) for level in own.levels] == [(12.0, "cogging, 12", True)]
    assert [series.dash for series in own.series] == ["solid", "dashed"]
    assert own.caption == "Amplitude of a wave."
    effect = figures["effect-1"]
    assert [series.draw for series in effect.series] == ["points", "points", "line"]
    assert effect.series[0].low is not None
    assert "held out" in figures["run-1"].title  # first what the fit has not seen
    envelope = figures["run-1"].series[0]
    assert envelope.y.size == 2 * 240
    assert envelope.y[0] == -envelope.y[1]


def test_nothing_found_is_a_page_too():
    nothing = diagnosis(verdict="no_effect_found", headline="Nothing is missing.", findings=())
    report = diagnosis_report(SOURCE, nothing)
    assert (report.verdict.finding, report.verdict.confidence) == ("nothing missing", "certain")
    assert not any("of what any model could explain" in text for text in report.verdict.reasons)  # nothing was
    assert {table.name for table in report.tables} == {"errors", "channels", "base"}
    assert "Nothing is missing." in render_page(report)


def test_of_the_pairs_of_axes_the_strongest_are_shown():
    one = ResidualChannel("velocity", 0.6, 0.02, True, False, 1000)
    pairs = tuple(ResidualChannel(f"time x axis {k}", 0.01 * k, 0.0, False, False, 1000) for k in range(20))
    report = diagnosis_report(SOURCE, diagnosis(channels=(one, *pairs)))
    table = next(table for table in report.tables if table.name == "channels")
    assert [row.label for row in table.rows] == ["velocity", *(f"time x axis {k}" for k in range(19, 13, -1))]
    assert "Of 20 pairs" in table.note


def test_without_held_out_runs_and_with_something_unexplained_it_is_said():
    open_ = diagnosis(verdict="unexplained", before=None, after=None, held_out_names=(), findings=())
    report = diagnosis_report(SOURCE, open_)
    assert (report.verdict.finding, report.verdict.confidence) == ("not explained", "cannot tell")
    assert any("No run was held out" in text for text in report.verdict.cautions)
    assert "no run held out" in report.subtitle


def test_a_free_curve_is_reported_by_its_range_and_not_knot_by_knot():
    knots = {"kind": 2.0, "count": 2.0, "x00": -2.0, "x01": 3.0, "y00": -0.001, "y01": 0.004}
    curve = finding(name="unknown:current", parameters=tuple(Number(k, v, None, "") for k, v in knots.items()))
    assert curve_words(curve) == "a curve of 2 knots over -2 to 3: from -0.001 to 0.004 Nm/rps"
    assert curve_words(finding()) == ""
    springs = {"kind": 4.0, "count": 2.0, "x00": 0.1, "x01": 2.5, "y00": -0.001, "y01": 0.004}
    memory = finding(name="unknown:memory", parameters=tuple(Number(k, v, None, "") for k, v in springs.items()))
    words = "springs along the travel that slip and then pull with -0.001 to 0.004 Nm, after 0.1 to 2.5 rev"
    assert curve_words(memory) == f"{words}; strongest after 2.5 rev"
    more = {"across": 11.0, "across_scale": 0.0, "levels": 2.0, "z00": 0.1, "z01": 4.0, "y02": 0.0, "y03": 0.002}
    numbers = tuple(Number(k, v, None, "") for k, v in {**knots, **more, "kind": 1.0}.items())
    table = finding(name="unknown:motor_angle", parameters=numbers)
    words = "a table over -2 to 3 and the speed, 0.1 to 4: friction from -0.001 to 0.004 Nm"
    assert curve_words(table) == words
    curve = report_object(diagnosis(findings=(table,)))["effects"][0]
    assert (curve["parameters"], curve["sd"]) == ({}, {})
    assert (curve["curve"]["across"], curve["curve"]["levels"]) == ("speed", [0.1, 4.0])
    assert curve["curve"]["values"] == [[-0.001, 0.004], [0.0, 0.002]]
    page = render_page(diagnosis_report(SOURCE, diagnosis(findings=(table,))))
    assert "motor angle x speed" in page


REST = Rest(0.004, 0.002, 0.4, ("travel_since_reversal", "time"), "75 % could be explained and is not")


def test_a_rest_is_never_silent():
    for verdict in ("effects_found", "unexplained", "nothing_carries_over"):
        found = diagnosis(verdict=verdict, unexplained_rest=REST)
        report = diagnosis_report(SOURCE, found)
        assert report.verdict.alarm == (verdict == "nothing_carries_over")
        if verdict != "nothing_carries_over":
            (left,) = (line.text for line in report.verdict.lines if line.label == "Unexplained")
            assert left.startswith("4.0 mNm rms, which a better model could reduce to 2.0 mNm; it depends on travel")
        (said,) = (text for text in report.verdict.cautions if text.startswith("Not explained: 4 mNm rms"))
        assert "a black-box model of the same rows would leave 2" in said
        assert "40 % of the squared residual repeats" in said
        assert "travel since reversal and time" in said
    assert report_object(found)["unexplained_rest"]["floor_nm"] == 0.002


def test_where_nothing_carries_over_there_is_no_model_and_nothing_is_good():
    refused = finding(accepted=False, reason="does not carry over: the torque error is not smaller")
    found = diagnosis(verdict="nothing_carries_over", findings=(refused,), model_after=None)
    report = diagnosis_report(SOURCE._replace(model_path=""), found)
    assert report.verdict.alarm
    assert any("No model was written" in reason for reason in report.verdict.reasons)
    base = next(table for table in report.tables if table.name == "base")
    assert {row.cells[1].text for row in base.rows} == {"–"}
    assert "found" not in {table.name for table in report.tables}
    render_page(report)


@pytest.mark.parametrize("field", ["torque_rms_nm", "velocity_rms_rps"])
def test_a_held_out_error_that_rose_or_is_not_finite_is_never_good(field):
    risen = replace(errors(0.002), **{field: Interval(1.0, 0.9, 1.1)})
    sure = finding(alternatives=())
    assert diagnosis_report(SOURCE, diagnosis(findings=(sure,))).verdict.confidence == "certain"
    report = diagnosis_report(SOURCE, diagnosis(after=risen, findings=(sure,)))
    assert report.verdict.confidence == "probable"
    assert any("rose from" in text for text in report.verdict.cautions)
    for value in (float("nan"), float("inf")):
        broken = diagnosis(after=replace(errors(0.002), **{field: Interval(value, value, value)}))
        report = diagnosis_report(SOURCE, broken)
        assert report.verdict.alarm
        assert any("not finite" in text for text in report.verdict.cautions)
        cells = next(table for table in report.tables if table.name == "errors").rows[0].cells
        assert "not finite" in {cell.text for cell in cells}
        render_page(report)
    assert doubts(diagnosis()) == []


def test_numbers_of_a_finding_that_are_not_finite_do_not_stop_the_page(tmp_path):
    nan = float("nan")
    wrong = finding(
        explained_fraction=nan, false_alarm_probability=nan, gain=(nan, nan), held_out_gain=(nan, nan),
        strength_percent=nan, parameters=(Number("cos_nm", nan, nan, "Nm"),),
        rivals=(Rival("unbalance", float("inf"), 0.0, False),),
    )  # fmt: skip
    paths = write_diagnosis_report(SOURCE, diagnosis(findings=(wrong,)), tmp_path)
    assert json.loads(paths.json.read_text())["effects"][0]["gain"] == [None, None]


def test_each_run_stands_by_itself_and_what_it_does_not_say_is_not_a_number():
    def look(name, inertia, one_way):
        sure = Estimate(0.003, 0.0001, True, 1.0)
        estimates = dict.fromkeys(PARAMETERS, sure) | {"inertia_nm_s2_per_rev": Estimate(inertia, 2e-5, True, 1.0)}
        estimates["offset_nm"] = sure._replace(determined=not one_way)
        return RunLook(name, 0.0, estimates, one_way, 4000, 3.0)

    remark = Remark("contradiction", ("inertia_nm_s2_per_rev",), ("a", "b"), "a and b contradict each other")
    looks = RunsLook((look("a", 1e-3, False), look("b", 2e-3, True), RunLook("c", 0.0, {}, True, 3, 1e9)),
                     (remark,), 0.001)  # fmt: skip
    tables = {t.name: t for t in diagnosis_report(SOURCE, diagnosis(runs_look=looks)).tables}
    a, b, c = tables["runs"].rows
    assert a.cells[0].value == pytest.approx(1e-3 / (2.0 * np.pi))  # kg m2
    assert a.cells[0].high == pytest.approx((1e-3 + 1.96 * 2e-5) / (2.0 * np.pi))
    assert [cell.text for cell in b.cells[3:]] == ["not determined", "one way"]
    assert {cell.text for cell in c.cells[:4]} == {"not determined"}
    assert "A and b contradict each other." in tables["runs"].note
    tables = {t.name: t for t in diagnosis_report(SOURCE, diagnosis(runs_look=looks, units="linear")).tables}
    assert tables["runs"].rows[0].cells[0].value == pytest.approx(1e-3)  # kg
    assert [column.unit for column in tables["runs"].columns[:4]] == ["kg", "N s/m", "N", "N"]


@pytest.mark.parametrize("sd", [1e290, float("inf")])
def test_a_parameter_that_the_data_do_not_determine_has_no_interval_that_looks_like_one(sd):
    model = read_model(TABLE_1)
    exponent = model.friction.stribeck_exponent.model_copy(update={"sd": sd})
    loose = model.model_copy(update={"friction": model.friction.model_copy(update={"stribeck_exponent": exponent})})
    base = next(t for t in diagnosis_report(SOURCE, diagnosis(model_after=loose)).tables if t.name == "base")
    cells = {row.label: row.cells for row in base.rows}["δ, Stribeck exponent"]
    assert cells[0].value == pytest.approx(model.friction.stribeck_exponent.value)
    assert cells[1].text == "not determined"


def test_what_is_left_and_repeats_is_said():
    reasons = diagnosis_report(SOURCE, diagnosis(ceiling=Ceiling(0.9, 0.25, 0.001, 0.95, "2 repeats"))).verdict.reasons
    assert "25 % of the remaining squared residual repeats with the reference." in reasons


def test_nothing_of_a_linear_axis_speaks_of_a_shaft():
    """Page, summary and report.json: sentences, units, names of parameters, axes."""
    viscous = finding(
        name="asymmetric_viscous", axis="velocity", alternatives=("torque_offset",), picture=None, law_picture=None,
        parameters=(Number("excess_nm_per_rps", -39.0, 1.0, "Nm/rps"),), regime="high torque, at every angle",
        reason="it lowers the error by changing the axis: the inertia would be 2 times as large",
        experiment=law_of("cogging").experiment,
    )  # fmt: skip
    curve = finding(name="unknown:output_angle", axis="output_angle", alternatives=(), picture=None,
                    law_picture=None, parameters=tuple(
        Number(key, value, None, "") for key, value in {
            "kind": 2.0, "count": 2.0, "x00": 0.0, "x01": 0.2, "y00": 1.0, "y01": 2.0}.items()))  # fmt: skip
    remark = Remark("drift", (), ("track",), "the inertia drifts over the angle")
    reason = "implausible for a machine: second_surface with memory_rev 1e-06 rev is outside 1e-06 to 10000"
    refused = finding(name="second_surface", accepted=False, reason=reason, picture=None, law_picture=None)
    found = in_words_of_axis(diagnosis(
        units="linear", findings=(finding(), viscous, curve, refused), headline="A torque is missing.",
        cautions=("it cannot be compensated without a homed angle",), runs_look=RunsLook([], (remark,), 0.0),
        channels=tuple(ResidualChannel(word, 0.6, 0.02, True, False, 10) for word in ("motor_angle", "output_angle")),
        unexplained_rest=Rest(2.0, 1.0, None, ("torque", "output_angle"), "it goes with the torque"),
    ))  # fmt: skip
    report = diagnosis_report(SOURCE, found)
    page = render_page(report).split("<script")[0]
    shown = re.sub(r"<style.*?</style>|<[^>]+>", " ", page, flags=re.DOTALL)
    of_a_shaft = re.compile(r"(?<![\w:])(torques?|inertia|angle|Nm|rps|rev)(?![\w:])|\w+_(nm|rps|rev)\b")
    assert not of_a_shaft.findall(shown)
    assert "excess_n_s_per_m" in shown
    assert "second_surface with memory_m 1e-06 m" in shown
    channels = next(figure for figure in report.figures if figure.name == "channels")
    assert len(set(channels.x.categories)) == 2
    effects = {one["name"]: one for one in report_object(found)["effects"]}
    written = effects["asymmetric_viscous"]
    assert written["parameters"] == {"excess_nm_per_rps": -39.0}  # the key of the model file
    assert written["symbols"] == {"excess_nm_per_rps": "excess_n_s_per_m"}
    assert written["units"] == {"excess_nm_per_rps": "N s/m"}
    assert effects["unknown:output_angle"]["curve"]["unit"] == "N s/m"
    rotary = report_object(diagnosis(findings=(viscous,)))["effects"][0]
    assert rotary["symbols"] == {"excess_nm_per_rps": "excess_nm_per_rps"}
    assert rotary["units"] == {"excess_nm_per_rps": "Nm/rps"}


def test_a_linear_axis_is_reported_in_its_own_units():
    report = diagnosis_report(SOURCE, diagnosis(units="linear"))
    tables = {table.name: table for table in report.tables}
    assert [column.unit for column in tables["errors"].columns[:3]] == ["%", "N", "mm/s"]
    base = {row.label: row for row in tables["base"].rows}
    mass = base["M, mass"].cells[0].value
    assert mass == pytest.approx(2 * np.pi * read_model(TABLE_1).inertia_kg_m2.value)
    assert [row.unit for row in tables["parameters"].rows] == ["N", "1/m"]
    effect = {figure.name: figure for figure in report.figures}["effect-1"]
    assert (effect.x.unit, effect.y.label, effect.y.unit) == ("m", "residual force", "N")


def test_what_the_held_out_runs_do_not_show_is_said_beside_the_effect():
    shown, hidden = finding(), finding(name="unbalance", held_out_gain=(-3.0, 5.0))
    reasons = diagnosis_report(SOURCE, diagnosis(findings=(shown, hidden))).verdict.reasons
    said = "It does not lower the error on the held-out runs."
    assert [said in reason for reason in reasons[:2]] == [False, True]


DOUBT = "it does not stand out from what no law explains, and may be part of that"


def test_what_is_in_doubt_is_said_beside_the_effect_and_leads_no_page():
    doubtful = finding(alternatives=(), doubt=DOUBT)
    page = diagnosis_report(SOURCE, diagnosis(findings=(doubtful, finding(name="unbalance", alternatives=()))))
    assert page.verdict.headline.startswith("The model lacks: weight of an unbalanced load")
    assert [DOUBT in reason for reason in page.verdict.reasons[:2]] == [True, False]
    table = {table.name: table for table in page.tables}["found"]
    assert ["its name is in doubt" in str(row) for row in table.rows] == [True, False]
    hidden = finding(name="unbalance", alternatives=(), held_out_gain=(-3.0, 5.0))
    weak = diagnosis_report(SOURCE, diagnosis(findings=(replace(doubtful, law_picture=None), hidden)))
    assert weak.verdict.headline.startswith("The model lacks: weight of an unbalanced load")
    assert weak.figures[0].name == "effect-1-own"  # the headline's
    alone = diagnosis_report(
        SOURCE, diagnosis(findings=(doubtful,), verdict="unexplained", headline="Something is there.")
    ).verdict
    assert (alone.finding, alone.confidence) == ("not explained", "cannot tell")


def test_the_json_is_the_stable_schema(tmp_path):
    after = errors(0.002)
    broken = replace(after, velocity_rms_rps=Interval(float("nan"), float("nan"), float("nan")))
    paths = write_diagnosis_report(SOURCE, diagnosis(after=broken), tmp_path)
    content = json.loads(paths.json.read_text())
    assert content["kind"] == "diagnose"
    assert content["verdict"] == "effects_found"
    first = content["effects"][0]
    assert {
        "name",
        "alternatives",
        "axis",
        "parameters",
        "explained_fraction",
        "false_alarm_probability",
        "accepted",
    } <= (set(first))
    assert first["parameters"] == {"cos_nm": {"track": 0.008}, "order": 12.0}
    held_out = content["before"]["held_out"]
    assert {"torque_rms_nm", "torque_relative_percent", "velocity_rms_rps"} <= set(held_out)
    assert content["after"]["held_out"]["velocity_rms_rps"] is None  # JSON has no nan
    assert content["ceiling"]["repeatable_fraction"] == 0.9

"""The page of a tuning: gains, margins and files as they were made, and figures that agree with the closed forms."""

import json
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import yaml
from identification.rig import TABLE_1
from report.test_page import LARGEST_PAGE_BYTES, outline

import fffo_drive as fd
from fffo_drive.cli import main
from fffo_drive.commissioning.record import ContactRecord, ElasticRecord, ResponseRecord, RestRecord, SwingRecord
from fffo_drive.control.notch import Notch
from fffo_drive.control.stability import RIGID, linear_axis, loop_margins
from fffo_drive.control.velocity_estimator import estimator_config
from fffo_drive.documents import DocumentError
from fffo_drive.identification.tuning import Wish, design, judge
from fffo_drive.model.parameters import effect_model, read_model, write_model
from fffo_drive.report.document import ReportFile
from fffo_drive.report.page import render_page, write_report
from fffo_drive.report.static import write_figures
from fffo_drive.report.tune import TuneSource, tune_report
from fffo_drive.report.tune_figures import Tuning, measured_figures, open_loop
from fffo_drive.workflows.tune import Tuned, summarise

PERIOD_S = 0.0005


def made(directory, wish=None, change=None, estimator_hz=None, **gains):
    """Report of a design, or of given gains, for Table I."""
    wish = wish or Wish()
    model = change(read_model(TABLE_1)) if change else read_model(TABLE_1)
    axis = linear_axis(model, PERIOD_S)
    if estimator_hz is not None:
        delay_s, kt = model.delay_s.value - model.sensor_delay_s.value, axis.torque_constant_nm_per_a
        estimator = estimator_config(estimator_hz, axis.inertia_nm_s2_per_rev, kt, delay_s, PERIOD_S, 25.0, 8.0)
        axis = linear_axis(model, PERIOD_S, estimator)
    attraction = model.friction.attraction_nm_per_rev.value
    found = design(axis, attraction, wish)
    if gains:
        found = judge(axis, attraction, found.gains._replace(**gains), wish)
    text = yaml.safe_dump({"controller": Tuned(axis, found).section(10.0)})
    path = directory / "controller.yaml"
    path.write_text(text)
    source = TuneSource(TABLE_1, model, 0.5 * PERIOD_S, text, [path], ["fffo-drive config check AXIS.yaml"])
    tuning = Tuning(axis, found, wish, model.friction_config())
    return tuning, tune_report(source, tuning, summarise(found, axis))


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    return made(tmp_path_factory.mktemp("tune"))


@pytest.mark.parametrize(
    ("key", "name", "reason"),
    [
        ("coulomb_nm", "Coulomb friction Fc", "too little sliding"),
        ("viscous_nm_per_rps", "viscous friction sigma", "too narrow a range of speeds"),
    ],
)
def test_a_model_whose_data_hardly_moved_the_axis_is_tuned_with_a_warning(key, name, reason):
    """Fc 0.014 +- 0.0052 Nm was fitted to a chirp that moved the axis for 4 % of the time; sigma 3 +- 150 once."""
    table_1 = read_model(TABLE_1)
    for sd, warned in ((None, False), (0.2, False), (0.38, True), (50.0, True)):
        level = getattr(table_1.friction, key)
        level = level.model_copy(update={"sd": None if sd is None else sd * level.value})
        model = table_1.model_copy(update={"friction": table_1.friction.model_copy(update={key: level})})
        said = [text for text in fd.tune(model).design.warnings if name in text]
        assert bool(said) == warned
        assert all("with more current" in text and reason in text for text in said)


def test_the_page_carries_the_numbers_of_the_json_and_nothing_from_outside(report, tmp_path):
    tuning, document = report
    paths = write_report(document, tmp_path)
    page = paths.page.read_text()
    assert page == render_page(document)
    assert len(page.encode()) < LARGEST_PAGE_BYTES
    found = outline(page)
    assert found.open == []
    assert found.wrong == []
    assert not any({"src", "href", "srcset"} & set(attrs) for _, attrs in found.elements)
    content = ReportFile.model_validate_json(paths.json.read_text())
    assert content.results["gains"] == pytest.approx(tuning.gains._asdict())
    margins = {row.label: row.cells for row in next(t for t in content.tables if t.name == "margins").rows}
    assert margins["PI"][0].value == content.results["margins_pi"]["phase_deg"]
    assert margins["PI and observer"][1].value == content.results["margins_observer"]["gain"]
    spare = next(row for t in content.tables if t.name == "checks" for row in t.rows if row.label == "excess")
    assert spare.cells[0].value == content.results["condition_14_nm_per_rev"]
    for cells in margins.values():
        assert f">{cells[0].text}</td>" in page
    assert yaml.safe_load(content.listings[0].text)["controller"]["observer"]["toggle"] == "ff"
    assert "fffo-drive config check" in content.listings[1].text


def test_a_design_that_keeps_its_wishes_is_good(report):
    verdict = report[1].verdict
    assert (verdict.finding, verdict.confidence) == ("gains that keep the margins", "certain")
    assert verdict.lines[0].text.startswith("Phase 45°")


def test_what_is_missed_is_a_caution_and_an_unstable_loop_is_bad(tmp_path):
    missed = made(tmp_path, Wish(bandwidth_hz=45.0))[1].verdict
    assert missed.confidence == "probable"
    assert any("phase margin" in text for text in missed.cautions)
    less = made(tmp_path, observer_nm_per_rev=0.0)[1].verdict
    assert less.confidence == "probable"
    assert any("(14)" in text for text in less.cautions)
    broken = made(tmp_path, observer_nm_per_rev=200.0)[1].verdict
    assert broken.alarm
    assert broken.next_step == "do not run it"
    assert any("Do not run the loop" in text for text in broken.reasons)


def test_the_locus_goes_through_the_chosen_poles_and_meets_at_the_bound(report):
    tuning, document = report
    locus = next(figure for figure in document.figures if figure.name == "root-locus")
    series = {name.split(",")[0].split(" from")[0]: s for name, s in ((s.name, s) for s in locus.series)}
    chosen = series["chosen"].x + 1j * series["chosen"].y
    axis, gains = tuning.axis, tuning.gains
    stiffness = axis.torque_constant_nm_per_a * np.array([gains.proportional_a_per_rps, gains.integral_a_per_rev])
    wanted = np.roots([axis.inertia_nm_s2_per_rev, axis.damping_nm_per_rps + stiffness[0], stiffness[1]])
    np.testing.assert_allclose(np.sort_complex(chosen), np.sort_complex(wanted), rtol=1e-6)
    bound = series["real"]
    assert np.ptp(bound.x) < 1e-2 * abs(bound.x[0])
    assert np.abs(bound.y).max() < 1e-2 * abs(bound.x[0])


def test_the_bode_figure_has_the_margins_of_the_table(report):
    tuning, _ = report
    hz = np.geomspace(0.1, 300.0, 40_000)
    for observer in (0.0, tuning.gains.observer_nm_per_rev):
        loop = open_loop(tuning.axis, tuning.gains, observer, hz)
        gains = (tuning.gains.proportional_a_per_rps, tuning.gains.integral_a_per_rev, observer)
        margins = loop_margins(tuning.axis, *gains)
        at = np.flatnonzero(np.abs(loop) >= 1.0)[-1]
        assert hz[at] == pytest.approx(margins.crossover_hz, rel=1e-2)
        assert 180.0 + np.degrees(np.unwrap(np.angle(loop)))[at] == pytest.approx(margins.phase_deg, abs=0.5)


def read_off(document, name):
    """Crossover in Hz and phase margin in degrees, as the Bode figures draw them: the last and the worst crossing."""
    figures = {figure.name: {one.name: one for one in figure.series} for figure in document.figures}
    gain, phase = figures["bode-gain"][name], figures["bode-phase"][name]
    log_hz, log_gain = np.log(gain.x), np.log(gain.y)
    below = np.flatnonzero((log_gain[:-1] >= 0.0) & (log_gain[1:] < 0.0))
    at = [float(np.interp(0.0, -log_gain[k : k + 2], log_hz[k : k + 2])) for k in below]
    return np.exp(at[-1]), 180.0 + min(np.interp(at, log_hz, phase.y))


def elastic(model):
    """A third of the inertia on a spring."""
    values = {"share": 0.33, "frequency_hz": 40.0, "damping": 0.1}
    return model.model_copy(update={"effects": [effect_model("elasticity", values, {})]})


def test_the_bode_figure_of_an_elastic_axis_has_the_margins_of_its_caption(tmp_path):
    tuning, document = made(tmp_path, change=elastic)
    rigid = tuning.axis._replace(elastic=RIGID)
    kp, ki, observer_gain = tuning.gains.in_motion
    for name, observer in (("PI", 0.0), ("PI and L", observer_gain)):
        drawn_at = tuning.axis._replace(resonance_spread=0.0)
        own, other = (loop_margins(axis, kp, ki, observer) for axis in (drawn_at, rigid))
        drawn = read_off(document, name)
        assert drawn == pytest.approx((own.crossover_hz, own.phase_deg), rel=5e-3)
        assert drawn != pytest.approx((other.crossover_hz, other.phase_deg), rel=5e-2)


def test_the_bode_figure_of_an_estimated_velocity_has_the_crossover_of_its_caption(tmp_path):
    tuning, document = made(tmp_path, estimator_hz=200.0)
    for name, observer in (("PI", 0.0), ("PI and L", tuning.gains.in_motion[2])):
        margins = loop_margins(tuning.axis, *tuning.gains.in_motion[:2], observer)
        crossover_hz, phase_deg = read_off(document, name)
        assert crossover_hz == pytest.approx(margins.crossover_hz, rel=5e-3)
        assert phase_deg > margins.phase_deg - 0.2  # the margin is the smaller one of two cuts
    captions = {figure.name: figure.caption for figure in document.figures}
    assert "cut at the current" in captions["bode-phase"]


def test_captions_have_numbers(report):
    assert all("{" not in figure.caption for figure in report[1].figures)


def test_a_spread_of_the_model_gives_the_worst_corner(tmp_path):
    def spread(model):
        inertia = model.inertia_kg_m2.model_copy(update={"sd": 0.05 * model.inertia_kg_m2.value})
        delay = model.delay_s.model_copy(update={"sd": 2e-4})
        return model.model_copy(update={"inertia_kg_m2": inertia, "delay_s": delay})

    tuning, document = made(tmp_path, change=spread)
    rows = next(table for table in document.tables if table.name == "margins").rows
    assert len(rows) == 4
    assert rows[3].cells[0].value < tuning.design.margins_observer.phase_deg


@pytest.mark.slow
def test_every_figure_is_a_valid_picture(report, tmp_path):
    figures = {figure.name: figure for figure in report[1].figures}
    assert len(figures) == 8
    shown = [figures[name] for name in ("root-locus-near", "step", "bode-phase", "margin-over-damping")]
    for path in write_figures(shown, tmp_path / "figures"):
        assert ElementTree.parse(path).getroot().tag.endswith("svg")


def test_the_command_writes_page_and_json(tmp_path, capsys):
    assert main(["tune", str(TABLE_1), "--out", str(tmp_path), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["report"] == str(tmp_path / "report.html")
    assert {path.name for path in tmp_path.iterdir()} == {"controller.yaml", "report.html", "report.json"}
    content = json.loads((tmp_path / "report.json").read_text())
    assert content["kind"] == "tune"
    assert content["results"]["gains"] == printed["gains"]


def test_a_linear_axis_is_tuned_in_its_own_units(tmp_path, report):
    """Same numbers, other units and words; the section that a controller reads keeps its keys."""
    _, linear = made(tmp_path, change=lambda model: model.model_copy(update={"units": "linear"}))
    _, rotary = report
    tables = {table.name: table for table in linear.tables}
    assert {row.label: row.unit for row in tables["gains"].rows} == {
        "Kp": "A s/m", "Ki": "A/m", "Ti": "s", "L": "N/m", "at rest": "-", "hold": "A/m/s",
    }  # fmt: skip
    inertia, mass = (next(t for t in one.tables if t.name == "axis").rows[0] for one in (rotary, linear))
    assert (inertia.label, inertia.unit, mass.label, mass.unit) == ("J", "kg m²", "M", "kg")
    assert mass.cells[0].value == pytest.approx(2.0 * np.pi * inertia.cells[0].value)  # force = M m/s2, torque = 2 pi J
    words = [linear.verdict.headline, *linear.verdict.reasons]
    for figure in linear.figures:
        words += [figure.title, figure.caption, figure.x.unit, figure.y.unit]
    for table in linear.tables:
        words += [table.note, *(f"{row.label} {row.unit} {row.cells[-1].text}" for row in table.rows)]
    assert not [text for text in words if re.search(r"\b(Nm|rps|rev|torque|inertia)\b", text)]
    before, after = (next(one for one in r.listings if one.name == "controller") for r in (rotary, linear))
    assert before.text == after.text
    assert linear.results["gains"] == rotary.results["gains"]


def test_the_terminal_speaks_of_a_linear_axis_too(tmp_path, capsys):
    model = read_model(TABLE_1).model_copy(update={"units": "linear"})
    write_model(tmp_path / "model.yaml", model)
    assert main(["tune", str(tmp_path / "model.yaml"), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out.splitlines()
    assert "A s/m" in said[0]
    assert not [line for line in said[:6] if "Nm" in line or "rps" in line]


@pytest.mark.parametrize("value", ["-3", "0", "nan"])
@pytest.mark.parametrize("key", ["bandwidth_hz", "damping_ratio", "rate_hz", "current_limit_a"])
def test_a_wish_that_is_no_number_above_zero_makes_no_gains(key, value, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["tune", str(TABLE_1), "--out", str(out), f"--{key.replace('_', '-')}={value}"]) == 78
    assert f"{key}: {value}: a number above 0 is needed" in capsys.readouterr().err
    assert not out.exists()
    if key in ("bandwidth_hz", "rate_hz"):
        with pytest.raises(DocumentError, match=f"{key}: {value}"):
            fd.tune(read_model(TABLE_1), **{key: float(value)})


def test_the_measured_response_is_on_the_page_with_its_points_its_fits_and_what_the_notches_leave(report):
    tuning, page = report
    assert not any(figure.name.startswith("response") for figure in page.figures)  # it was not measured
    hz = np.geomspace(10.0, 400.0, 60)
    load = ElasticRecord(
        share=0.35, share_sd=0.01, frequency_hz=110.0, frequency_sd_hz=0.1, damping=0.03, damping_sd=0.001
    )
    contact = ContactRecord(
        current_a=0.02, travel_rev=1e-3, contact_per_s2=2.5e4, contact_sd_per_s2=1e2, damping_per_s=30.0
    )
    points = {
        "frequency_hz": hz.tolist(),
        "gain_rps_per_a": (25.0 / hz).tolist(),
        "phase_deg": (-90.0 - hz).tolist(),
        "coherence": np.where(hz < 300.0, 0.99, 0.5).tolist(),
    }
    swing = dict.fromkeys(SwingRecord.model_fields, 1.0)
    response = ResponseRecord(
        swing=SwingRecord(**swing), **points, gain_rps2_per_a=157.0, delay_s=0.0027, hold_s=0.00025, damping_per_s=1.0,
        contact_per_s2=0.0, evidence=100.0, elastic=load,
        at_rest=RestRecord(**points, contacts=[contact, contact.model_copy(update={"current_a": 0.14})]),
    )  # fmt: skip
    axis = tuning.axis._replace(notches=(Notch(95.0, 1.0, 0.2),))
    gain, phase = measured_figures(tuning._replace(axis=axis, response=response))
    by_name = {series.name: series for series in gain.series}
    assert set(by_name) == {"in motion", "at rest", "fit", "fit at rest", "behind the notches"}
    assert [series.name for series in phase.series] == list(by_name)
    assert by_name["in motion"].y.size == np.sum(hz < 300.0)  # what repeats
    fit, behind = by_name["fit"], by_name["behind the notches"]
    assert np.array(fit.x)[np.argmin(fit.y)] == pytest.approx(load.antiresonance_hz, rel=0.02)
    assert float(np.min(behind.y / fit.y)) == pytest.approx(0.2, abs=0.02)
    held = by_name["fit at rest"]
    assert np.array(held.x)[np.argmax(held.y)] == pytest.approx(np.sqrt(2.5e4) / (2.0 * np.pi), rel=0.1)
    assert {level.label for level in gain.levels} == {"notch", "resonance"}
    assert "35 % of the inertia on a spring at 110 Hz" in gain.caption
    assert "phase margin" in phase.caption

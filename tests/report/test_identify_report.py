"""The page of an identification: the numbers of the fit, what it could not tell, figures that draw, one file alone."""

import json
import math
import re
import shlex
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from identification.synthetic import PERIOD_S, TRUTH, chirp_record, record_of
from report.test_page import LARGEST_PAGE_BYTES, outline

from fffo_drive.identification import residuals
from fffo_drive.identification.coverage import coverage_of
from fffo_drive.identification.facts import ColumnFact, DriveFacts
from fffo_drive.identification.fit import FitSettings, fit_records
from fffo_drive.identification.residuals import run_residuals
from fffo_drive.identification.results import model_file, report
from fffo_drive.model.friction import steady_friction_nm
from fffo_drive.model.parameters import write_model
from fffo_drive.report.document import ReportFile, interval_text
from fffo_drive.report.identify import IdentifySource, identify_report, tune_command, words_of
from fffo_drive.report.identify_figures import IdentifyWords, free_velocities, friction_band, over_speed_figure
from fffo_drive.report.page import render_page, write_report
from fffo_drive.report.response_figures import harmonic_damping
from fffo_drive.report.static import write_figures

FACTS = DriveFacts(torque_constant_nm_per_a=0.148, resolver_bits=15)
QUICK = FitSettings(compare_literal=False, starts=1)


def on_disk(record, directory, name):
    """The record with a file behind it: the report names bytes and hash."""
    path = directory / f"{name.replace('/', '-')}.csv.gz"
    path.write_bytes(name.encode())
    return replace(record, name=name, path=path, digest="ab" * 32)


def reported(records, directory, facts=FACTS):
    """Report of a fit of these records, with the files that it names."""
    fit = fit_records(records, QUICK)
    runs = run_residuals(records, fit.physical)
    (directory / "drive.yaml").write_text("torque_constant_nm_per_a: 0.148\n")
    write_model(directory / "model.yaml", model_file(fit, records, "made up <b>"))
    source = IdentifySource("made up <b>", facts, directory / "drive.yaml", directory / "model.yaml")
    results = report(fit, records, facts)
    return fit, runs, identify_report(source, fit, records, runs, results, coverage_of(records))


def chirp_report(directory):
    """Report of a fit of one chirp."""
    chirp = chirp_record(12.0, lsb_rev=2.0**-15, noise_rev=1e-5)
    late = np.concatenate([np.zeros(2), np.gradient(chirp.position_rev, PERIOD_S)[:-2]])
    return reported([on_disk(replace(chirp, velocity_rps=late), directory, "chirp/1")], directory)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return chirp_report(tmp_path_factory.mktemp("identify"))


@pytest.fixture(scope="module")
def page(made):
    return render_page(made[2])


@pytest.mark.slow
def test_the_page_is_well_formed_small_and_loads_nothing(page):
    found = outline(page)
    assert found.open == []
    assert found.wrong == []
    assert len(page.encode()) < LARGEST_PAGE_BYTES
    ids = [attrs["id"] for _, attrs in found.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    for tag, attrs in found.elements:
        assert tag not in ("link", "iframe", "object", "embed", "base")
        assert not {"src", "href", "srcset", "action"} & set(attrs)
    assert "<b>" not in re.sub(r"<caption><b>|</b>", "", page.split("<script")[0]).replace("<b>Figure", "")


@pytest.mark.slow
def test_page_and_json_tell_the_same_numbers(made, page, tmp_path):
    fit, _, document = made
    content = ReportFile.model_validate_json(write_report(document, tmp_path).json.read_text())
    assert content.kind == "identify"
    assert content.results["format"] == "fffo_drive/identification/1"
    rows = {
        row.label: row for row in next(t for t in content.tables if t.name == "parameters").rows if row.unit != "kg m²"
    }
    for entry in content.results["parameters"]:
        if not entry["fitted"]:
            continue
        value = rows[entry["symbol"]].cells[0]
        assert value.value == entry["value"] == fit.value(entry["name"])
        assert [value.low, value.high] == entry["interval_95"]
        assert f">{value.text}<small>{interval_text(value.low, value.high)}</small>" in page
    assert all(figure.title and figure.caption for figure in content.figures)
    assert "NaN" not in json.dumps(content.results)


@pytest.mark.slow
def test_a_residual_without_variation_is_said_to_tell_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(residuals, "whiteness", lambda values: {})
    _, _, document = chirp_report(tmp_path)
    table = next(table for table in document.tables if table.name == "dependence")
    cells = {row.label: [cell.text for cell in row.cells] for row in table.rows}
    assert cells["Ljung-Box, 20 lags"] == ["–", "cannot tell"]
    assert cells["samples"] == ["–", ""]
    assert not {"nan", "NaN"} & {text for row in cells.values() for text in row}


def test_the_next_command_can_be_typed_though_the_directory_has_a_blank():
    command = tune_command(IdentifySource("a", FACTS, None, Path("my fit/model.yaml")))
    assert shlex.split(command) == ["fffo-drive", "tune", "my fit/model.yaml", "--out", "my fit/tune"]


@pytest.mark.slow
def test_a_good_fit_is_called_good_with_its_quality(made):
    _, _, document = made
    assert (document.verdict.confidence, document.verdict.next_step) == ("certain", "tune"), document.verdict
    assert "all 9 parameters" in document.verdict.headline
    lines = {line.label: line for line in document.verdict.lines}
    assert lines["How good"].text.startswith("torque residual ")
    assert lines["Next"].command.startswith("fffo-drive tune ")


@pytest.mark.slow
def test_the_page_is_the_same_each_time(made, page):
    assert render_page(made[2]) == page


@pytest.mark.slow
def test_every_figure_is_a_valid_picture_on_demand(made, tmp_path):
    figures = made[2].figures
    names = {figure.name for figure in figures}
    assert {"friction", "damping", "by-frequency", "by-speed", "autocorrelation"} <= names
    assert {f"{kind}-chirp-1" for kind in ("gain", "coherence", "histogram", "speed", "velocity", "cutout-2")} <= names
    kinds = ("gain", "speed", "friction", "residual", "histogram")  # one of each way to draw
    for path in write_figures([figure for figure in figures if figure.name.startswith(kinds)], tmp_path / "figures"):
        assert ElementTree.parse(path).getroot().tag.endswith("svg")


@pytest.mark.slow
def test_the_sensors_lag_has_a_spread(made):
    fit, _, document = made
    assert fit.sensor_delay_s == pytest.approx(2 * PERIOD_S, rel=0.02)
    assert 0.0 < fit.sensor_delay_sd_s < 0.1 * PERIOD_S
    row = next(row for row in document.tables[0].rows if row.label == "velocity lag")
    assert row.cells[0].low < 2 * PERIOD_S + 5e-6
    assert row.cells[0].high > 2 * PERIOD_S - 5e-6


@pytest.mark.slow
def test_simulated_velocities_start_on_the_measured_ones_and_stay_near(made):
    _, runs, _ = made
    grid, measured, simulated = free_velocities(runs[0])
    assert grid.step == pytest.approx(0.005)
    present = np.isfinite(measured)
    np.testing.assert_array_equal(present, np.isfinite(simulated))
    assert present.mean() > 0.5
    assert np.median(np.abs(measured - simulated)[present]) < 0.05


@pytest.mark.slow
def test_the_friction_band_holds_the_true_curve(made):
    fit = made[0]
    speeds = np.geomspace(0.5, 20.0, 12)
    curve, low, high = friction_band(fit, speeds)
    assert (low <= curve).all()
    assert (curve <= high).all()
    from identification.synthetic import FRICTION

    truth = np.array([steady_friction_nm(FRICTION, float(speed)) for speed in speeds])
    assert np.abs(curve / truth - 1.0).max() < 0.03
    assert (high - low).max() < 0.2 * curve.max()


@pytest.mark.slow
def test_what_is_not_determined_stands_first_and_in_a_table(tmp_path):
    time = np.arange(16_000) * PERIOD_S
    current = 1.0 + 0.4 * np.sin(2 * np.pi * time) + 0.3 * np.sin(2 * np.pi * 7.0 * time)
    fast = on_disk(record_of(current, lsb_rev=2.0**-15, noise_rev=1e-5), tmp_path, "fast")
    _, _, document = reported([fast], tmp_path)
    assert document.verdict.confidence != "certain"
    assert "do not determine" in document.verdict.headline
    table = next(table for table in document.tables if table.name == "doubts")
    row = next(row for row in table.rows if row.label == "K")
    assert "reversals" in row.cells[0].text
    assert row.cells[2].text
    assert all(column.words for column in table.columns)
    assert outline(render_page(document)).wrong == []


def test_a_linear_axis_has_its_own_units():
    columns = {"current_command_a": ColumnFact(column="vir", unit="V")}
    words = words_of(FACTS.model_copy(update={"units": "linear", "columns": columns}))
    assert (words.torque, words.torque_unit, words.velocity_unit, words.command_unit) == ("force", "N", "m/s", "V")
    assert words_of(FACTS) == IdentifyWords()


def test_presliding_and_sliding_are_apart():
    runs = run_residuals([chirp_record(6.0, lsb_rev=2.0**-15)], TRUTH)
    sliding, presliding = runs[0].sliding, runs[0].presliding
    assert not (sliding & presliding).any()
    np.testing.assert_array_equal(sliding | presliding, runs[0].torque.kept)
    assert presliding.sum() > 20
    figure = over_speed_figure(runs[0], IdentifyWords())
    assert [series.name for series in figure.series][:2] == ["sliding", "presliding"]


def test_harmonic_damping_of_coulomb_friction_is_the_textbooks():
    from identification.synthetic import FRICTION

    coulomb = FRICTION._replace(static_nm=FRICTION.coulomb_nm, viscous_nm_per_rps=0.003)
    for amplitude in (0.5, 8.0):
        expected = 0.003 + 4.0 * FRICTION.coulomb_nm / (math.pi * amplitude)
        assert harmonic_damping(coulomb, amplitude) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (1.4e-4, 1.6e-4, "0.00014 to 0.00016"),
        (782.1, 783.9, "782.1 to 783.9"),
        (-0.5, 0.25, "−0.5 to 0.25"),
        (2, 2, "2 to 2"),
    ],
)
def test_ends_of_an_interval_can_be_told_apart(low, high, text):
    assert interval_text(low, high) == text

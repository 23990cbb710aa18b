"""The measured LAAS motor, files as published: read, and its cogging found on the first rungs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shared_data import shared_files

from fffo_drive.cli import main
from fffo_drive.identification.dataset import load_records
from fffo_drive.identification.facts import read_facts
from fffo_drive.identification.fit import FitSettings, fit_records
from fffo_drive.identification.ladder import climb
from fffo_drive.identification.regression import regression_start
from fffo_drive.model.parameters import read_model

FACTS = Path(__file__).parent / "laas.yaml"


def test_the_files_are_read_as_they_are():
    records = load_records(shared_files("measured/laas/*.txt"), read_facts(FACTS))
    for record in records:
        assert record.period_s == pytest.approx(1e-3, rel=1e-4)
        assert record.breaks == ()
        assert record.good is not None
        assert np.mean(~record.good) < 0.005
        assert any("time stamps scatter" in text for text in record.warnings)


@pytest.mark.parametrize("name", ["speed_test", "speed_test1"])
def test_cogging_of_slots_and_poles_leads(name):
    facts = read_facts(FACTS)
    records = load_records(shared_files(f"measured/laas/{name}.txt"), facts)
    accepted = climb(records, regression_start(records), facts).accepted
    assert {one.candidate.name for one in accepted} == {"cogging"}
    amplitude_a = {one.candidate.order: float(np.hypot(*one.coefficients)) / 0.025 for one in accepted}
    assert max(amplitude_a, key=lambda order: amplitude_a[order]) == 72.0
    assert 0.14 < amplitude_a[72.0] < 0.26
    assert {12.0, 18.0, 24.0} <= set(amplitude_a)


def half(name, second):
    """Half of a file: with the authors' anti-cogging, or without."""
    (record,) = load_records(shared_files(f"measured/laas/{name}.txt"), read_facts(FACTS))
    middle = round(8.002 / record.period_s)
    part = slice(middle, None) if second else slice(0, middle)
    columns = ("current_a", "position_rev", "velocity_rps", "reference_rps", "good")
    return replace(record, **{column: getattr(record, column)[part] for column in columns})


def test_waves_that_look_like_a_noisy_sensor_are_found():
    """Below the cut-off that is lowered for the noise, 10 Hz, order 72 is 72 Hz."""
    facts, record = read_facts(FACTS), half("speed_test_old", second=False)
    start = regression_start([record])
    assert start.is_noisy
    assert {72.0, 18.0, 12.0} <= {one.candidate.order for one in climb([record], start, facts).accepted}


def test_an_inertia_below_zero_without_the_waves_is_found_beside_them():
    """The waves' torque opposes the acceleration that they cause: without them the inertia is below zero."""
    facts, record = read_facts(FACTS), half("speed_test", second=True)
    start = regression_start([record])
    assert start.inertia_nm_s2_per_rev < 0.0
    climbed = climb([record], start, facts)
    assert climbed.accepted[0].candidate.order == 72.0
    assert climbed.start.inertia_nm_s2_per_rev == pytest.approx(2.1e-5, rel=0.1)


@pytest.mark.parametrize("name", ["speed_test1", "speed_test"])
def test_the_waves_of_the_rows_stay_in_the_fit(name):
    """In eight seconds the strength of a true wave has few windows: tested over all orders again, true ones went.

    Without the waves the inertia of the second is below zero: there is no such fit to compare with.
    """
    fit = fit_records([half(name, second=True)], FitSettings(compare_literal=False), read_facts(FACTS))
    assert {72, 18, 12} <= {round(effect.values["order"]) for effect in fit.effects}


@pytest.mark.slow
def test_identify_runs_through_and_its_model_is_read(tmp_path):
    (log,) = shared_files("measured/laas/speed_test_old.txt")
    assert main(["identify", str(log), "--drive", str(FACTS), "--out", str(tmp_path / "out")]) == 0
    model = read_model(tmp_path / "out" / "model.yaml")
    assert {effect.name for effect in model.effects} == {"cogging"}
    results = json.loads((tmp_path / "out" / "report.json").read_text())["results"]
    assert len(results["effects"]) == len(model.effects)
    assert [remark["kind"] for remark in results["remarks"]].count("confounded") >= 1
    assert "Beside friction" in (tmp_path / "out" / "report.html").read_text()

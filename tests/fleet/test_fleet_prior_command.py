"""`--prior` as a user meets it: five seconds of a drive beside a store of others, and what it says of mistakes."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fleet.fleet_rig import TRUTH, write_run

import fffo_drive as fd
from fffo_drive.cli import main
from fffo_drive.diagnosis.base import BASE, NAMES, BasePrior, population_prior, wide_prior
from fffo_drive.documents import DocumentError
from fffo_drive.fleet.history import histories
from fffo_drive.fleet.prior import population_of
from fffo_drive.fleet.store import FleetStore
from fffo_drive.identification.coordinates import PARAMETERS
from fffo_drive.identification.population import AgainstPopulation, PopulationRow, with_population
from fffo_drive.model.parameters import read_model

ROOT = Path(__file__).parents[2]
DRIVES, SPREAD = 12, 0.08
COULOMB = TRUTH["coulomb_nm"]


def truth_of(drive, **more):
    """A drive of the population."""
    draw = np.random.default_rng([5, drive])
    return {name: value * (1.0 + SPREAD * draw.standard_normal()) for name, value in TRUTH.items()} | more


@pytest.fixture(scope="module")
def store(facts_file, tmp_path_factory):
    """Twelve drives with two runs each, made by the command."""
    directory = tmp_path_factory.mktemp("population")
    address = directory / "store"
    for drive in range(DRIVES):
        runs = [str(write_run(directory / f"{drive}_{k}.csv", 100 * drive + k, truth_of(drive))) for k in range(2)]
        words = ["--drive", str(facts_file), "--serial", f"SN{drive}", "--model", "M1"]
        assert main(["fleet", "add", str(address), *runs, *words]) == 0
    assert main(["fleet", "work", str(address), "--workers", "1"]) == 0
    return address


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Five seconds of a fresh drive of the population."""
    return write_run(tmp_path_factory.mktemp("short") / "short.csv", 9001, truth_of(90), duration_s=5.0)


@pytest.fixture(scope="module")
def unlike(tmp_path_factory):
    """Five seconds of a drive with twice the Coulomb friction."""
    own = truth_of(91, coulomb_nm=2.0 * COULOMB)
    return write_run(tmp_path_factory.mktemp("unlike") / "unlike.csv", 9002, own, duration_s=5.0)


def identified(short, facts_file, out, *words):
    return main(["identify", str(short), "--drive", str(facts_file), "--out", str(out), *words])


def test_identify_has_prior_own_data_and_posterior_side_by_side(store, short, facts_file, tmp_path, capsys):
    out = tmp_path / "model"
    assert identified(short, facts_file, out, "--prior", str(store), "--prior-model", "M1") == 0
    assert f"prior: {DRIVES} drives of M1" in capsys.readouterr().out
    prior = json.loads((out / "report.json").read_text())["results"]["prior"]
    assert not prior["other_population"]
    rows = {row["name"]: row for row in prior["parameters"]}
    for name, value in truth_of(90).items():
        assert abs(rows[name]["posterior"] - value) < 4.0 * rows[name]["posterior_sd"], name
        assert rows[name]["posterior_sd"] < rows[name]["prior_sd"] * 1.0001
    assert "these runs alone" in (out / "report.html").read_text()
    model = read_model(out / "model.yaml")
    assert model.friction.coulomb_nm.source == "fitted, with the population as prior"
    assert model.friction.coulomb_nm.value == pytest.approx(truth_of(90)["coulomb_nm"], rel=0.15)
    assert model.friction.viscous_nm_per_rps.value == pytest.approx(truth_of(90)["viscous_nm_per_rps"], rel=0.2)


def test_a_drive_of_another_population_is_reported_and_gets_its_own_fit(store, unlike, facts_file, tmp_path, capsys):
    with_prior, without = tmp_path / "with", tmp_path / "without"
    assert identified(unlike, facts_file, with_prior, "--prior", str(store), "--prior-model", "M1") == 0
    said = capsys.readouterr().out
    assert "this drive is not one of the population" in said
    assert "Coulomb friction +" in said
    assert "Check the drive's type" in said
    assert identified(unlike, facts_file, without) == 0
    models = [read_model(place / "model.yaml") for place in (with_prior, without)]
    assert models[0].friction == models[1].friction
    results = json.loads((with_prior / "report.json").read_text())["results"]
    assert results["prior"]["other_population"]
    assert any("not one of the population" in text for text in results["warnings"])
    assert "not one of the population" in (with_prior / "report.html").read_text()


def test_a_population_s_file_and_the_library_say_the_same(store, short, facts_file, tmp_path, capsys):
    population = population_of(histories(FleetStore(str(store)), "M1"), "M1")
    path = tmp_path / "population.json"
    path.write_text(json.dumps(population.as_plain()))
    assert identified(short, facts_file, tmp_path / "a", "--prior", str(path), "--prior-model", "M1", "--json") == 0
    by_file = json.loads(capsys.readouterr().out)["prior"]
    found = fd.identify(fd.read_run(short, facts=facts_file), prior=store, prior_model="M1")
    pairs = zip(by_file["parameters"], found.result["prior"]["parameters"], strict=True)
    for one, other in pairs:
        assert one["posterior"] == pytest.approx(other["posterior"], rel=1e-9)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--prior", "nowhere"], "nowhere: no store here"),
        (["--prior", "STORE", "--prior-model", "M2"], "no record of type 'M2'"),
        (["--prior", "STORE"], "give --prior-model"),
        (["--prior-model", "M1"], "give the store with --prior"),
        (["--prior", "missing.json"], "missing.json"),
    ],
)
def test_what_is_wrong_is_named(words, said, store, short, facts_file, tmp_path, capsys):
    given = [str(store) if word == "STORE" else word for word in words]
    assert identified(short, facts_file, tmp_path / "out", *given) == 78
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out" / "model.yaml").exists()


def test_too_few_drives_make_no_prior_and_a_drive_is_not_its_own(store, short, facts_file, tmp_path, capsys):
    few = tmp_path / "few"
    runs = [str(path) for path in sorted(store.parent.glob("[0-8]_0.csv"))]
    for number, run in enumerate(runs):
        words = ["--drive", str(facts_file), "--serial", f"SN{number}", "--model", "M1"]
        assert main(["fleet", "add", str(few), run, *words, "--work", "--workers", "1"]) == 0
    assert identified(short, facts_file, tmp_path / "out", "--prior", str(few), "--prior-model", "M1") == 78
    said = capsys.readouterr().err
    assert f"{len(runs)} drives of type M1" in said
    assert "two more drives than parameters (here 10, so 1 more)" in said
    with pytest.raises(DocumentError, match="give one of them"):
        fd.diagnose(fd.read_run(short, facts=facts_file), model=read_any_model(), prior=store)


def read_any_model():
    return read_model(ROOT / "configs" / "models" / "table1.yaml")


# -- the prior in a fit and in a diagnosis


def against(prior, sd, other=False, rows=1e3):
    """A population of one parameter, Coulomb friction."""
    row = PopulationRow("coulomb_nm", "Coulomb friction", "Nm", prior, sd, None, None, prior, sd, (0.0, 1.0), None)
    return AgainstPopulation("M1", "store", 20, None, 0.5, other, (row,), np.array([[sd * sd]]), rows)


class FitOf:
    """What `with_population` takes of a fit: Coulomb friction 0.02 Nm with an sd."""

    def __init__(self, sd):
        sds = np.zeros(len(PARAMETERS))
        sds[PARAMETERS.index("coulomb_nm")] = sd
        self.uncertainty = SimpleNamespace(sd=sds, correlation=np.eye(len(PARAMETERS)))

    def value(self, name):
        assert name == "coulomb_nm"
        return 0.02


@pytest.mark.parametrize(("sd", "expected"), [(1e-7, 0.02), (0.002, np.sqrt(0.02 * 0.03)), (1.0, 0.03)])
def test_a_model_is_its_own_fit_or_the_population_s_by_how_much_the_runs_say(sd, expected):
    model = read_any_model()
    found = with_population(model, FitOf(sd), against(0.03, 0.003))  # 10 % each in the middle
    assert found.friction.coulomb_nm.value == pytest.approx(expected, rel=0.01)
    assert found.friction.viscous_nm_per_rps == model.friction.viscous_nm_per_rps
    assert with_population(model, FitOf(sd), against(0.03, 0.003, other=True)) is model


def test_the_base_of_a_diagnosis_has_the_population_where_it_is_one_of_it():
    start = np.full(len(NAMES), 0.02)
    place = BASE.index("coulomb_nm")
    prior = population_prior(against(0.03, 0.003), start)
    assert prior.centre[NAMES.index("coulomb_nm")] == 0.03
    assert prior.precision[place, place] == pytest.approx(100.0)
    # rows that repeat each other ten times over count as one, and the prior with them
    assert prior.weighed(10_000)[place, place] == pytest.approx(1000.0)
    for none in (None, against(0.03, 0.003, other=True)):
        wide = population_prior(none, start)
        assert np.array_equal(wide.precision, wide_prior(start).precision)
        assert np.array_equal(wide.centre, start)
    assert BasePrior(start, prior.precision).weighed(10_000)[place, place] == pytest.approx(100.0)

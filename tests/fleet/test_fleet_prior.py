"""The population as a prior, in closed form and by coverage; and two sets of runs compared."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fffo_drive.fleet.difference import difference, difference_lines
from fffo_drive.fleet.history import RunHistory
from fffo_drive.fleet.prior import Population, population_from_plain, population_of, posterior, random_effects
from fffo_drive.fleet.regress import COULOMB, PARAMETERS, STRIBECK

from .test_fleet_watch import LEVEL, drawn, fleet

NAMES = ("a", "b")


def test_the_posterior_is_the_mean_weighted_by_information() -> None:
    population = Population(NAMES, np.array([1.0, 2.0]), np.diag([4.0, 1.0]), np.diag([1.0, 1e-9]), 1000)
    found = posterior(population, np.array([3.0, 2.5]), np.diag([1.0 / 3.0, 1.0]))
    # a: variance 3 + 1 beside 4; b: 1 beside 1
    assert found.theta == pytest.approx([2.0, 2.25])
    assert np.diag(found.covariance) == pytest.approx([2.0, 0.5])


def test_what_the_motion_does_not_determine_is_the_population_s() -> None:
    population = Population(NAMES, np.array([1.0, 2.0]), np.diag([4.0, 1.0]), np.diag([1e-9, 1e-9]), 1000)
    found = posterior(population, np.array([1.5, np.nan]), np.diag([100.0, 0.0]))
    assert found.theta[1] == pytest.approx(2.0)
    assert found.covariance[1, 1] == pytest.approx(1.0)
    assert not found.other_population


def test_a_drive_of_another_population_is_told() -> None:
    population = Population(NAMES, np.zeros(2), np.eye(2), 1e-9 * np.eye(2), 60)
    assert posterior(population, np.array([5.0, 0.0]), 100.0 * np.eye(2)).other_population
    assert not posterior(population, np.array([1.5, 0.0]), 100.0 * np.eye(2)).other_population


def test_intervals_cover_as_they_say_and_a_few_outliers_change_little() -> None:
    rng = np.random.default_rng(1)
    true = np.array([[0.02, 0.01], [0.01, 0.03]])
    covered, far = [], []
    for _ in range(30):
        information = np.array([np.diag(rng.uniform(0.03, 0.2, 2) ** -2.0) for _ in range(60)])
        drives = rng.multivariate_normal([1.0, 1.0], true, 60)
        drives[:2] += 3.0
        own = drives + np.array([rng.multivariate_normal([0.0, 0.0], np.linalg.inv(i)) for i in information])
        mean, covariance = random_effects(information, np.einsum("dij,dj->di", information, own))
        population = Population(NAMES, mean, covariance, 1e-9 * np.eye(2), 60)
        for _ in range(20):
            drive = rng.multivariate_normal([1.0, 1.0], true)
            one = np.diag(rng.uniform(0.05, 0.4, 2) ** -2.0)
            found = posterior(population, rng.multivariate_normal(drive, np.linalg.inv(one)), one)
            ends = found.interval()
            covered.append((ends[:, 0] < drive) & (drive < ends[:, 1]))
            far.append(found.other_population)
    assert 0.93 < np.mean(covered) < 0.98
    assert np.mean(far) < 0.02


def test_a_population_of_histories_goes_to_json_and_back() -> None:
    population = population_of(fleet())
    again = population_from_plain(json.loads(json.dumps(population.as_plain())))
    assert again.names == population.names
    assert again.covariance == pytest.approx(population.covariance)
    assert population.mean[population.names.index("coulomb_nm")] == pytest.approx(LEVEL[COULOMB], rel=0.05)
    own = drawn(90)
    assert not posterior(population, own.theta[3], own.information[3], PARAMETERS).other_population
    with pytest.raises(ValueError, match="lacks scatter"):
        population_from_plain({k: v for k, v in population.as_plain().items() if k != "scatter"})
    with pytest.raises(ValueError, match="3 at least"):
        population_of({"0": own})
    with pytest.raises(ValueError, match="the estimates do not"):
        posterior(population, own.theta[3], own.information[3], ("x",) * 8)


# -- two sets of runs


def runs_of(history: RunHistory, first: int, last: int) -> RunHistory:
    """Some runs of a history."""
    cut = {name: getattr(history, name)[first:last] for name in RunHistory._fields if name not in ("names", "orders")}
    return history._replace(**cut)


def test_a_difference_beyond_chance_is_named_and_sized() -> None:
    drives = fleet(change={COULOMB: 0.10, STRIBECK: 0.10})
    found = difference(runs_of(drives["0"], 10, 18), runs_of(drives["0"], 40, 48), drives)
    assert found.laws[0].law == "Coulomb friction"
    assert found.laws[0].differs
    assert found.laws[0].interval[0] < 0.10 < found.laws[0].interval[1]
    assert "beyond chance" in found.laws[0].text
    json.dumps(found.as_plain())


def test_no_difference_says_what_it_could_have_missed() -> None:
    drives = fleet()
    found = difference(runs_of(drives["0"], 10, 18), runs_of(drives["0"], 40, 48), drives)
    assert not any(law.differs for law in found.laws)
    assert difference_lines(found)[1] == "nothing differs beyond chance"


def test_one_of_many_comparisons_is_wrong_as_seldom_as_it_says() -> None:
    drives = fleet(12)
    wrong = [
        any(law.differs for law in difference(runs_of(one, 5, 9), runs_of(one, 25, 29), drives).laws)
        for one in list(drives.values())[:10]
    ]
    assert sum(wrong) <= 2


def test_an_empty_set_is_refused() -> None:
    one = drawn(1)
    with pytest.raises(ValueError, match="second set has no runs"):
        difference(one, runs_of(one, 0, 0))

"""The population as a prior, in closed form and by coverage; and two sets of runs compared."""

from __future__ import annotations

import json

import numpy as np
import numpy.typing as npt
import pytest

from fffo_drive.fleet.difference import difference, difference_lines
from fffo_drive.fleet.history import RunHistory
from fffo_drive.fleet.prior import (
    Population,
    Posterior,
    RunEstimate,
    population_from_plain,
    population_of,
    posterior,
    random_effects,
)
from fffo_drive.fleet.regress import COULOMB, PARAMETERS, STRIBECK, VISCOUS

from .test_fleet_watch import COULOMB_PER_K, LEVEL, SCALE, SCATTER, VISCOUS_PER_K, drawn, fleet

NAMES = ("a", "b")
Floats = npt.NDArray[np.float64]


def of_one(population: Population, theta: Floats, information: Floats, degc: float | None = None) -> Posterior:
    """By one run with the population's own columns."""
    return posterior(population, [RunEstimate(population.names, theta, information, degc)])


def test_the_posterior_is_the_mean_weighted_by_information() -> None:
    population = Population(NAMES, np.array([1.0, 2.0]), np.diag([4.0, 1.0]), np.diag([1.0, 1e-9]), 1000)
    found = of_one(population, np.array([3.0, 2.5]), np.diag([1.0 / 3.0, 1.0]))
    # a: variance 3 + 1 beside 4; b: 1 beside 1
    assert found.theta == pytest.approx([2.0, 2.25])
    assert np.diag(found.covariance) == pytest.approx([2.0, 0.5])


def test_what_the_motion_does_not_determine_is_the_population_s() -> None:
    population = Population(NAMES, np.array([1.0, 2.0]), np.diag([4.0, 1.0]), np.diag([1e-9, 1e-9]), 1000)
    found = of_one(population, np.array([1.5, np.nan]), np.diag([100.0, 0.0]))
    assert found.theta[1] == pytest.approx(2.0)
    assert found.covariance[1, 1] == pytest.approx(1.0)
    assert not found.other_population


def test_a_drive_of_another_population_is_reported() -> None:
    population = Population(NAMES, np.zeros(2), np.eye(2), 1e-9 * np.eye(2), 60)
    assert of_one(population, np.array([5.0, 0.0]), 100.0 * np.eye(2)).other_population
    assert not of_one(population, np.array([1.5, 0.0]), 100.0 * np.eye(2)).other_population


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
            found = of_one(population, rng.multivariate_normal(drive, np.linalg.inv(one)), one)
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
    assert again.warming is not None
    assert population.warming is not None
    for one, other in zip(again.warming, population.warming, strict=True):
        assert one == pytest.approx(other)
    assert population.mean[population.names.index("coulomb_nm")] == pytest.approx(LEVEL[COULOMB], rel=0.05)
    own = drawn(90)
    assert not posterior(population, [RunEstimate(PARAMETERS, own.theta[3], own.information[3])]).other_population
    with pytest.raises(ValueError, match="lacks scatter"):
        population_from_plain({k: v for k, v in population.as_plain().items() if k != "scatter"})
    with pytest.raises(ValueError, match="3 at least"):
        population_of({"0": own})
    with pytest.raises(ValueError, match="the estimates do not"):
        posterior(population, [RunEstimate(("x",) * 8, own.theta[3], own.information[3])])


def test_much_information_is_the_own_fit_and_none_is_the_population() -> None:
    population = Population(NAMES, np.array([1.0, 2.0]), np.array([[0.04, 0.01], [0.01, 0.09]]), 1e-12 * np.eye(2), 60)
    own = np.array([1.3, 1.7])
    assert of_one(population, own, 1e9 * np.eye(2)).theta == pytest.approx(own, abs=1e-6)
    nothing = of_one(population, own, np.zeros((2, 2)))
    assert nothing.theta == pytest.approx(population.mean)
    assert nothing.covariance == pytest.approx(population.covariance)
    assert np.isnan(nothing.own).all()
    assert nothing.p == 1.0


def test_two_runs_say_what_one_of_both_would() -> None:
    population = Population(NAMES, np.array([1.0, 2.0]), np.eye(2), 1e-12 * np.eye(2), 60)
    halves = [RunEstimate(NAMES, np.array([1.2, 2.1]), np.diag([3.0, 5.0])) for _ in range(2)]
    whole = of_one(population, np.array([1.2, 2.1]), np.diag([6.0, 10.0]))
    assert posterior(population, halves).theta == pytest.approx(whole.theta)
    with pytest.raises(ValueError, match="no run"):
        posterior(population, [])


def test_one_parameter_far_out_is_reported_by_few_drives_of_many_parameters() -> None:
    names = tuple("abcdefgh")
    population = Population(names, np.zeros(8), np.eye(8), 1e-9 * np.eye(8), 12)
    far = np.zeros(8)
    far[2] = 12.0
    assert of_one(population, far, 1e6 * np.eye(8)).other_population  # Hotelling's p is 0.04
    rng = np.random.default_rng(3)
    flagged = []
    for _ in range(400):  # the population is estimated from twelve drives each time
        drives = rng.standard_normal((13, 8))
        own = Population(names, drives[:12].mean(0), np.cov(drives[:12].T), 1e-9 * np.eye(8), 12)
        flagged.append(of_one(own, drives[12], 1e9 * np.eye(8)).other_population)
    assert np.mean(flagged) < 0.02


def test_the_prior_follows_the_temperature_of_the_run() -> None:
    population = population_of(fleet())
    assert population.warming is not None
    viscous = population.names.index("viscous_nm_per_rps")
    slope = population.warming.slope_per_k[viscous]
    assert slope == pytest.approx(VISCOUS_PER_K * LEVEL[VISCOUS], rel=0.1)
    cold, warm, unknown = (of_one(population, population.mean, np.zeros((8, 8)), t) for t in (15.0, 35.0, None))
    assert warm.prior[viscous] - cold.prior[viscous] == pytest.approx(20.0 * slope, rel=1e-6)
    assert unknown.prior_sd[viscous] > 1.5 * warm.prior_sd[viscous]


def test_intervals_cover_drives_at_the_temperature_of_their_run() -> None:
    rng = np.random.default_rng(4)
    population = population_of(fleet(40))
    scale, covered, error = SCALE, [], []
    for _ in range(300):
        level = LEVEL * np.exp(0.05 * rng.standard_normal(LEVEL.size))
        warmer_k = rng.uniform(-12.0, 12.0)
        true = level.copy()
        true[VISCOUS] += LEVEL[VISCOUS] * VISCOUS_PER_K * warmer_k
        true[[COULOMB, STRIBECK]] += LEVEL[COULOMB] * COULOMB_PER_K * warmer_k
        theta = true + scale * SCATTER * rng.standard_t(4, 8) / 1.4
        found = posterior(
            population, [RunEstimate(PARAMETERS, theta, np.diag((0.01 * scale) ** -2.0), 25.0 + warmer_k)]
        )
        ends = found.interval()
        kept = [k for k in range(8) if LEVEL[k] > 0.0]
        covered.append(((ends[:, 0] < true) & (true < ends[:, 1]))[kept])
        error.append([(found.theta - true)[VISCOUS], (theta - true)[VISCOUS]])
    assert 0.93 < np.mean(covered) < 0.99
    with_prior, alone = np.sqrt(np.mean(np.square(error), axis=0))
    assert with_prior < 0.8 * alone


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

"""Spreads against closed forms, and the refinement of a solution."""

from __future__ import annotations

import math

import numpy as np
import pytest
from identification.synthetic import PERIOD_S, TRUTH, chirp_record

from fffo_drive.identification.coordinates import (
    MODEL_PARAMETERS,
    NUISANCES,
    coordinates,
    physical_slope,
    to_coordinates,
)
from fffo_drive.identification.fit import mean_of_fits
from fffo_drive.identification.noise_bias import noise_shift, sensor_noise_rev
from fffo_drive.identification.prediction import make_problem, residual
from fffo_drive.identification.results import ends_of_interval
from fffo_drive.identification.solver import Solution, huber_cost, refine, robust_scale
from fffo_drive.identification.uncertainty import Disagreement, ratio_sd, uncertainty_of


@pytest.fixture(scope="module")
def problem():
    return make_problem([chirp_record(8.0, lsb_rev=2.0**-15, noise_rev=1e-5)], 40.0)


@pytest.fixture(scope="module")
def space():
    return coordinates(TRUTH, PERIOD_S, (*MODEL_PARAMETERS, NUISANCES[0]))


def solution_at(problem, values):
    errors = residual(problem, values)
    scale = robust_scale(errors)
    return scale, huber_cost(errors, scale)


def test_the_spread_of_a_ratio_is_that_of_its_blocks():
    draw = np.random.default_rng(2)
    squares = draw.uniform(0.5, 1.5, 400)
    products = 3.0 * squares + draw.normal(0.0, 0.2, 400)
    assert ratio_sd(products, squares) == pytest.approx(0.2 * math.sqrt(400) / squares.sum(), rel=0.15)
    assert ratio_sd(products, squares) == ratio_sd(products, squares)
    assert ratio_sd(products[:4], squares[:4]) is None


def test_intervals_of_positive_parameters_stay_positive():
    low, high = ends_of_interval("coulomb_nm", 2.0, 3.0)
    assert 0.0 < low < 2.0 < high
    assert low * high == pytest.approx(4.0)
    assert ends_of_interval("coulomb_nm", 2.0, 0.002) == pytest.approx([1.998, 2.002], rel=1e-5)
    assert ends_of_interval("offset_nm", 2.0, 3.0) == [-1.0, 5.0]


def test_refining_never_raises_the_loss_and_comes_home(problem, space):
    aside = to_coordinates(TRUTH, space.scale)
    aside[[0, 2, 3]] += [0.002, -0.01, 0.005]
    values = np.array(TRUTH)
    scale, cost = solution_at(problem, values * np.exp(aside - to_coordinates(TRUTH, space.scale)))
    found = refine(problem, space, Solution(aside, cost, 1, True, scale))
    assert found.cost <= cost * (1.0 + 1e-4)
    for k in (0, 2, 3):
        assert abs(found.values[k] - math.log(TRUTH[k])) < 0.5 * abs(aside[k] - math.log(TRUTH[k])), k


def test_the_mean_of_fits_is_taken_where_the_loss_bears_it(problem, space):
    values = to_coordinates(TRUTH, space.scale)
    scale, cost = solution_at(problem, TRUTH)
    solution = Solution(values, cost, 1, True, scale)
    near = np.zeros(values.size)
    near[0] = 1e-4
    mean, disagreement = mean_of_fits(problem, space, solution, [values + near, values - near])
    assert mean.values == pytest.approx(values)
    assert disagreement.fits == 3
    assert disagreement.sd[0] == pytest.approx(1e-4)
    far = np.zeros(values.size)
    far[0] = 0.3
    kept, disagreement = mean_of_fits(problem, space, solution, [values + far, values + 0.5 * far])
    assert kept.values is solution.values
    assert disagreement.fits == 1
    assert disagreement.sd[0] == pytest.approx(0.3)


def test_fits_that_disagree_no_more_than_noise_add_nothing(problem, space):
    values = to_coordinates(TRUTH, space.scale)
    scale, cost = solution_at(problem, TRUTH)
    solution = Solution(values, cost, 1, True, scale)
    none = np.zeros(values.size)
    alone = uncertainty_of(problem, space, solution, none)
    coordinate_sd = alone.statistical_sd / physical_slope(values, space.scale)
    quiet = uncertainty_of(problem, space, solution, none, Disagreement(0.8 * coordinate_sd, 3))
    assert quiet.specification_sd == pytest.approx(none)
    loud = uncertainty_of(problem, space, solution, none, Disagreement(5.0 * coordinate_sd, 3))
    free = alone.statistical_sd > 0.0
    wanted = math.sqrt((25.0 - 0.83) / 3.0) * alone.statistical_sd
    assert loud.specification_sd[free] == pytest.approx(wanted[free])
    biased = uncertainty_of(problem, space, solution, -2.0 * coordinate_sd)
    assert biased.sd[free] == pytest.approx(math.sqrt(5.0) * alone.statistical_sd[free])


def test_the_noise_of_the_position_is_found_and_bends_presliding_one_way(space):
    lsb_rev, noise_rev = 2.0**-15, 3e-5
    noisy = make_problem([chirp_record(8.0, lsb_rev=lsb_rev, noise_rev=noise_rev)], 40.0)
    wanted = math.hypot(noise_rev, lsb_rev / math.sqrt(12.0))
    assert sensor_noise_rev(noisy) == pytest.approx(wanted, rel=0.05)
    scale, cost = solution_at(noisy, TRUTH)
    solution = refine(noisy, space, Solution(to_coordinates(TRUTH, space.scale), cost, 1, True, scale))
    shift = noise_shift(noisy, space, solution.values)
    assert shift[MODEL_PARAMETERS.index("stiffness_per_rev")] < 0.0
    assert abs(shift[MODEL_PARAMETERS.index("inertia_nm_s2_per_rev")]) < 1e-3

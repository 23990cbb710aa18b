"""Least squares against NumPy, SciPy and closed forms: linear, collinear, weighted, damped, robust and bounded."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize

from fffo_drive.least_squares import (
    HUBER,
    Rule,
    huber,
    huber_weights,
    least_squares,
    minimise,
    normal_equations,
    robust_least_squares,
    spectrum,
    sums_by,
)

RULE = Rule(1e-3, 0.2, 1e-8, 8.0, 0.0, 8, 1e-10, 0.0, 0.0)
TIME_S = np.linspace(0.0, 3.0, 200)
NOISE = np.random.default_rng(5).normal(0.0, 0.01, TIME_S.size)


def columns_and_target(columns=5, rows=300, seed=1):
    draw = np.random.default_rng(seed)
    matrix = draw.standard_normal((rows, columns)) * np.geomspace(1e-4, 1e4, columns)
    return matrix, matrix @ (1.0 / np.geomspace(1e-4, 1e4, columns)) + draw.standard_normal(rows)


def test_values_residual_and_covariance_are_those_of_numpy_whatever_the_units_of_the_columns():
    matrix, target = columns_and_target()
    wanted = np.linalg.lstsq(matrix / np.linalg.norm(matrix, axis=0), target, rcond=None)[0]
    found = least_squares(matrix, target)
    lengths = np.linalg.norm(matrix, axis=0)
    assert found.values * lengths == pytest.approx(wanted, rel=1e-10)
    assert found.cost == pytest.approx(float(np.sum((target - matrix / lengths @ wanted) ** 2)), rel=1e-12)
    covariance = found.spectrum.inverse() / np.outer(lengths, lengths)
    assert covariance @ (matrix.T @ matrix) == pytest.approx(np.eye(5), abs=1e-6)
    both = least_squares(matrix, np.column_stack([target, 2.0 * target]))
    assert both.residual[:, 1] == pytest.approx(2.0 * found.residual, abs=1e-10)


def test_a_weight_is_a_row_that_many_times():
    matrix, target = columns_and_target()
    times = np.arange(target.size) % 3
    wanted = least_squares(np.repeat(matrix, times, axis=0), np.repeat(target, times))
    assert least_squares(matrix, target, times.astype(float)).values == pytest.approx(wanted.values, rel=1e-10)


def test_of_columns_that_are_alike_each_takes_half_and_neither_is_determined():
    column = np.random.default_rng(2).standard_normal((100, 1))
    other = np.random.default_rng(3).standard_normal((100, 1))
    found = least_squares(np.hstack([column, other, column, 0.0 * column]), 3.0 * column[:, 0] + other[:, 0])
    assert found.values == pytest.approx([1.5, 1.0, 1.5, 0.0])
    assert found.spectrum.determined().tolist() == [False, True, False, False]
    assert found.spectrum.basis().shape == (4, 2)
    assert np.diag(found.spectrum.inverse())[[0, 2, 3]].min() > 1e11
    several = spectrum(np.stack([np.eye(2), np.ones((2, 2)), np.zeros((2, 2))]))
    assert several.determined().tolist() == [[True, True], [False, False], [False, False]]


def test_the_basis_makes_columns_orthonormal():
    matrix, _ = columns_and_target()
    axes = matrix @ spectrum(matrix.T @ matrix).basis()
    assert axes.T @ axes == pytest.approx(np.eye(5), abs=1e-9)


def test_a_ridge_is_a_prior_at_zero_in_shares_of_the_columns():
    matrix, target = columns_and_target()
    normal = normal_equations(matrix, target)
    ridge = np.diag(0.3 * np.diag(normal.matrix))
    wanted = np.linalg.solve(normal.matrix + ridge, normal.moment)
    assert spectrum(normal.matrix).solution(normal.moment, 0.3) == pytest.approx(wanted, rel=1e-9)


def test_sums_of_rows_are_by_number_and_no_number_is_no_row():
    rows = np.array([[1.0, 10.0], [2.0, 20.0], [4.0, 40.0]])
    assert sums_by(np.array([7, 0, 7]), rows).tolist() == [[2.0, 20.0], [5.0, 50.0]]


def test_the_weight_is_the_slope_of_the_loss_over_the_error():
    errors = np.array([-9.0, -1.0, 0.5, 4.0])
    slope = (huber(errors + 1e-6) - huber(errors - 1e-6)) / 2e-6
    assert huber_weights(errors) * errors == pytest.approx(slope, rel=1e-6)
    assert slope[0] == pytest.approx(-HUBER)


def decay(parameters):
    """Amplitude and rate of an exponential decay, with its derivatives."""
    shape = np.exp(-parameters[1] * TIME_S)
    return parameters[0] * shape, np.column_stack([shape, -parameters[0] * TIME_S * shape])


def fitted(target, low=-np.inf, limit=np.inf, start=(0.5, 0.2), iterations=60, rule=RULE):
    """Amplitude and rate (at least `low`) by `minimise`."""

    def about(point, anew):
        model, slopes = decay(point)
        weight = huber_weights(target - model, limit)
        normal = normal_equations(slopes, target - model, weight)
        if point[1] <= low and normal.moment[1] < 0.0:
            normal.matrix[1] = normal.matrix[:, 1] = 0.0
        return float(huber(target - model, limit).sum()), normal

    def moved(point, step):
        trial = np.array([point[0] + step[0], max(point[1] + step[1], low)])
        return trial, float(huber(target - decay(trial)[0], limit).sum())

    return minimise(np.array(start), about, moved, rule, iterations)


@pytest.mark.parametrize(("low", "limit"), [(-np.inf, np.inf), (2.0, np.inf), (-np.inf, 0.02)])
def test_the_minimum_is_that_of_scipy_free_at_a_bound_and_with_outliers(low, limit):
    target = decay([2.0, 1.5])[0] + NOISE
    if np.isfinite(limit):
        target[::20] += 1.0
    point, loss, _, settled = fitted(target, low, limit)
    robust = {"loss": "huber", "f_scale": limit} if np.isfinite(limit) else {}
    wanted = optimize.least_squares(
        lambda x: target - decay(x)[0], [0.5, max(0.2, low + 0.1)], bounds=([-np.inf, low], np.inf), xtol=1e-12,
        ftol=1e-12, **robust,
    )  # fmt: skip
    assert settled
    assert point == pytest.approx(wanted.x, rel=1e-4)
    assert loss == pytest.approx(wanted.cost, rel=1e-6)


def test_steps_end_where_no_more_are_allowed_and_where_the_next_is_not_worthwhile():
    target = decay([2.0, 1.5])[0] + NOISE
    assert fitted(target, iterations=2)[2:] == (2, False)
    _, least, steps, _ = fitted(target)
    _, loss, fewer, settled = fitted(target, rule=RULE._replace(worthwhile=0.5))
    assert settled
    assert fewer < steps
    assert loss > least


def test_the_regression_is_not_pulled_by_outliers():
    draw = np.random.default_rng(1)
    column = draw.normal(size=2000)
    target = 2.0 * column + 0.1 * draw.normal(size=2000)
    target[::20] += 50.0 * column[::20]
    assert robust_least_squares(column[:, None], target)[0].values[0] == pytest.approx(2.0, rel=0.05)
    alone = robust_least_squares(np.column_stack([column, 1e-9 * column]), target)[0]
    assert np.isfinite(alone.values).all()

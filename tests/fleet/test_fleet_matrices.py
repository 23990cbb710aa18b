"""Small matrices, many at once: against numpy, one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fffo_drive.fleet.matrices import inverses, medians_of_known


@pytest.fixture
def information():
    """Of three runs with five columns."""
    halves = np.random.default_rng(4).standard_normal((3, 5, 5))
    return np.swapaxes(halves, 1, 2) @ halves


def test_an_inverse_is_numpy_s_and_an_absent_column_stays_absent(information):
    information[2, 1] = information[2, :, 1] = 0.0
    kept = [0, 2, 3, 4]
    found, determinant = inverses(information)
    assert np.allclose(found[:2], np.linalg.inv(information[:2]), rtol=1e-9)
    assert np.allclose(determinant[:2], np.linalg.det(information[:2]), rtol=1e-9)
    assert np.allclose(found[2][np.ix_(kept, kept)], np.linalg.inv(information[2][np.ix_(kept, kept)]), rtol=1e-9)
    assert not found[2, 1].any()
    assert not found[2, :, 1].any()


def test_the_determinant_bounds_the_smallest_eigenvalue():
    """Ones on the diagonal: eigenvalues have a mean of one, so those beside the smallest multiply to less than e."""
    draw = np.random.default_rng(5)
    vectors = draw.standard_normal((500, 8, 8)) + 3.0 * draw.standard_normal((500, 8, 1))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    matrices = np.swapaxes(vectors, 1, 2) @ vectors
    _, determinant = inverses(matrices)
    assert np.all(np.linalg.eigvalsh(matrices)[:, 0] * math.e >= determinant)


@pytest.mark.parametrize("axis", [0, 1])
def test_medians_are_numpy_s_of_what_is_known(axis):
    values = np.random.default_rng(6).standard_normal((9, 8))
    values[np.random.default_rng(7).random((9, 8)) < 0.4] = np.nan
    assert np.array_equal(medians_of_known(values, axis), np.nanmedian(values, axis=axis))


def test_the_median_of_nothing_known_is_nan():
    assert np.array_equal(medians_of_known(np.full((2, 3), np.nan), 1), [np.nan, np.nan], equal_nan=True)

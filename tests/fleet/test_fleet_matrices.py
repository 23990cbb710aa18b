"""Small matrices, many at once: against numpy, one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fffo_drive.fleet.matrices import inverse_total, inverses


@pytest.fixture
def information():
    """Of six runs with five columns: positive, and of a rank of 5, 5, 5, 3, 1 and 0."""
    draw = np.random.default_rng(4)
    halves = [draw.standard_normal((rank, 5)) for rank in (5, 5, 5, 3, 1, 0)]
    return np.array([half.T @ half for half in halves])


def test_an_inverse_is_numpy_s_and_an_absent_column_stays_absent(information):
    information[2, 1] = information[2, :, 1] = 0.0
    kept = [0, 2, 3, 4]
    found, determinant = inverses(information[:3])
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


def test_information_and_scatter_add_as_variances_also_where_there_is_none(information):
    scatter = 0.3 * np.eye(5) + 0.1
    found = inverse_total(information, scatter)
    assert np.allclose(found[:3], np.linalg.inv(np.linalg.inv(information[:3]) + scatter), rtol=1e-9)
    assert np.array_equal(found, np.swapaxes(found, 1, 2))
    assert [np.linalg.matrix_rank(one, tol=1e-9) for one in found] == [5, 5, 5, 3, 1, 0]
    assert not found[5].any()
    assert np.array_equal(inverse_total(information[0], scatter), found[0])

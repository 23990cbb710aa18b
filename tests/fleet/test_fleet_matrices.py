"""Small matrices, many at once: against numpy, one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fffo_drive.fleet.matrices import inverses


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

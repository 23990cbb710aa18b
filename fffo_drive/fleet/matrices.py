"""Many small arrays: for these, numpy's overhead per array exceeds the arithmetic."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Floats
from ..jit import njit


@njit
def factor(matrix: Floats, lower: Floats) -> float:
    """Cholesky factor of (p, p), and its determinant; 0 where it is not positive. A zero row and column is left out."""
    size = matrix.shape[0]
    determinant = 1.0
    for j in range(size):
        pivot = matrix[j, j]
        absent = pivot == 0.0
        for k in range(j):
            pivot -= lower[j, k] * lower[j, k]
        if not absent and not pivot > 0.0:
            return 0.0
        determinant *= 1.0 if absent else pivot
        lower[j, j] = 1.0 if absent else math.sqrt(pivot)
        for i in range(j + 1, size):
            value = matrix[i, j]
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            lower[i, j] = value / lower[j, j]
    return determinant


@njit
def solve_in_place(lower: Floats, right: Floats) -> None:
    """Of the system that has this factor, in place, for all columns of (p, p) at once: along a row nothing waits."""
    size = right.shape[0]
    for i in range(size):
        for k in range(i):
            for j in range(size):
                right[i, j] -= lower[i, k] * right[k, j]
        for j in range(size):
            right[i, j] /= lower[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            for j in range(size):
                right[i, j] -= lower[k, i] * right[k, j]
        for j in range(size):
            right[i, j] /= lower[i, i]


@njit
def _invert_each(matrices: Floats, lower: Floats, inverse: Floats, determinant: Floats) -> None:
    size = matrices.shape[1]
    for n in range(matrices.shape[0]):
        determinant[n] = factor(matrices[n], lower)
        if determinant[n] == 0.0:
            continue
        for j in range(size):
            inverse[n, j, j] = 1.0
        solve_in_place(lower, inverse[n])
        for j in range(size):
            if matrices[n, j, j] == 0.0:
                inverse[n, j, j] = 0.0


def inverses(matrices: Floats) -> tuple[Floats, Floats]:
    """Inverses (n, p, p) of positive matrices whose zero rows and columns stay zero, and their determinants (n,).

    Determinant 0: the matrix is not positive definite, and its inverse is meaningless.
    """
    inverse, determinant = np.zeros_like(matrices), np.empty(matrices.shape[0])
    _invert_each(np.ascontiguousarray(matrices), np.zeros(matrices.shape[1:]), inverse, determinant)
    return inverse, determinant


@njit
def _add_in_parallel(information: Floats, precision: Floats, both: Floats, lower: Floats, total: Floats) -> None:
    size = precision.shape[0]
    for n in range(information.shape[0]):
        for i in range(size):
            for j in range(size):
                both[i, j] = information[n, i, j] + precision[i, j]
        factor(both, lower)
        for i in range(size):
            for j in range(size):
                both[i, j] = information[n, i, j]
                total[n, i, j] = 0.0
        solve_in_place(lower, both)  # (I + S^-1)^-1 I
        for i in range(size):
            for k in range(size):
                for j in range(size):
                    total[n, i, j] += precision[i, k] * both[k, j]
            for j in range(i):
                total[n, i, j] = total[n, j, i] = 0.5 * (total[n, i, j] + total[n, j, i])


def inverse_total(information: Floats, covariance: Floats) -> Floats:
    """(I^-1 + S)^-1 of one run or many (..., p, p), also where I is singular."""
    precision = np.linalg.inv(covariance)
    own = np.ascontiguousarray(information).reshape(-1, *covariance.shape)
    total = np.empty_like(own)
    scratch = np.empty(covariance.shape), np.zeros(covariance.shape)
    _add_in_parallel(own, 0.5 * (precision + precision.T), *scratch, total)
    return total.reshape(information.shape)


def medians_of_known(values: Floats, axis: int) -> Floats:
    """Medians along an axis of what is not nan; nan where all is. numpy's nanmedian takes ten times as long."""
    ordered = np.sort(values, axis=axis)  # nan comes last
    count = np.sum(~np.isnan(values), axis=axis, keepdims=True)
    low, high = (np.take_along_axis(ordered, place, axis) for place in (np.maximum(count - 1, 0) // 2, count // 2))
    return np.asarray(np.where(count > 0, 0.5 * (low + high), np.nan).squeeze(axis))

"""Least squares, linear and nonlinear, for identification, diagnosis and fleet.

Linear by the normal equations of columns scaled to length one, whose eigenvalues show what the columns determine.
Nonlinear by damped Gauss-Newton steps (Levenberg, 1944; Marquardt, 1963). scipy.optimize.least_squares allows no
change of the scale of Huber's loss and of the kind of step; it needs 1.6 times as many Jacobians to the same minimum.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np

from .arrays import Floats, Integers, Mask
from .units import MAD_TO_SD

Point = TypeVar("Point")

SINGULAR = 1e-12  # share of the largest eigenvalue or squared length, below which nothing is determined
REWEIGHTED = 3  # rounds of robust least squares
HUBER = 3.0  # standard deviations beyond which Huber's loss grows linearly


class Normal(NamedTuple):
    """Normal equations."""

    matrix: Floats  # (p, p) X' W X
    moment: Floats  # (p,) or (p, k) X' W y


class Spectrum(NamedTuple):
    """Eigenvalues of one or several normal matrices of columns of length one: what the columns determine."""

    lengths: Floats  # (..., p) of the columns; inf for one that is left out
    curvature: Floats  # (..., p) eigenvalues, ascending
    directions: Floats  # (..., p, p) eigenvectors, in columns

    def known(self, share: float = SINGULAR) -> Mask:
        """Directions that are determined. (..., p)"""
        return np.asarray(self.curvature > share * self.curvature[..., -1:])

    def determined(self, share: float = SINGULAR) -> Mask:
        """Parameters that have no component in an undetermined direction. (..., p)"""
        part = np.einsum("...ij,...j->...i", self.directions**2, self.known(share).astype(np.float64))
        return np.asarray(np.abs(part - 1.0) < share**0.5)

    def basis(self, share: float = SINGULAR) -> Floats:
        """Map (p, rank) of the columns to orthonormal ones; times its transpose it is the pseudo-inverse."""
        good = self.known(share)
        return np.asarray(self.directions[:, good] / np.sqrt(self.curvature[good]) / self.lengths[:, None])

    def inverse(self) -> Floats:
        """Of the scaled normal matrix (p, p), with a huge variance of what is not determined."""
        return np.asarray((self.directions / np.maximum(self.curvature, SINGULAR)) @ self.directions.T)

    def solution(self, moment: Floats, ridge: float = 0.0) -> Floats:
        """Of the normal equations with this `moment` (p,) or (p, k): the minimum-norm solution of scaled columns.

        `ridge`: a prior at zero, or the damping of a step, as a share of each column's squared length.
        """
        basis = self._replace(curvature=np.maximum(self.curvature, 0.0) + ridge).basis()
        return np.asarray(basis @ (basis.T @ moment))


class LinearFit(NamedTuple):
    """Linear least squares."""

    values: Floats  # (p,) or (p, k)
    residual: Floats  # (m,) or (m, k)
    spectrum: Spectrum

    @property
    def cost(self) -> float:
        """Squared residual."""
        return float(np.vdot(self.residual, self.residual))


def normal_equations(columns: Floats, target: Floats, weight: Floats | None = None) -> Normal:
    """Of `columns` (m, p) for `target` (m,) or (m, k); `weight` (m,) of the squared residuals."""
    weighted = columns if weight is None else weight[:, None] * columns
    return Normal(weighted.T @ columns, weighted.T @ target)


def spectrum(matrix: Floats, dead: float = 0.0) -> Spectrum:
    """Of normal matrices (..., p, p), without columns whose squared length is at most a share `dead` of the largest."""
    square = np.diagonal(matrix, axis1=-2, axis2=-1)
    there = square > dead * square.max(axis=-1, keepdims=True, initial=0.0)
    lengths = np.where(there, np.sqrt(np.where(there, square, 1.0)), np.inf)
    return Spectrum(lengths, *np.linalg.eigh(matrix / (lengths[..., :, None] * lengths[..., None, :])))


def least_squares(columns: Floats, target: Floats, weight: Floats | None = None) -> LinearFit:
    """`columns` (m, p) fitted to `target` (m,) or (m, k); `weight` (m,) of the squared residuals."""
    normal = normal_equations(columns, target, weight)
    found = spectrum(normal.matrix)
    values = found.solution(normal.moment)
    return LinearFit(values, target - columns @ values, found)


def robust_least_squares(columns: Floats, target: Floats) -> tuple[LinearFit, float, float]:
    """`columns` (m, p) fitted to `target` (m,) with Huber's loss: the last fit, its mean loss, and the scale of it.

    The scale is the standard deviation of the middle of the residuals. `cost` of the fit is without the weights.
    """
    weight = np.ones(target.size)
    for _ in range(REWEIGHTED):
        fit = least_squares(columns, target, weight)
        scale = max(MAD_TO_SD * float(np.median(np.abs(fit.residual))), 1e-300)
        weight = huber_weights(fit.residual, HUBER * scale)
    return fit, float(np.mean(weight * fit.residual**2)), scale


def sums_by(group: Integers, rows: Floats) -> Floats:
    """Sums of the rows (m, k) of each group, in ascending order of its number. (groups, k)"""
    sums = np.stack([np.bincount(group, column) for column in rows.T], axis=1)
    return np.asarray(sums[np.bincount(group) > 0])


def huber(errors: Floats, limit: float = HUBER) -> Floats:
    """Huber's loss (m,): half the square, linear beyond `limit`; of errors of unit variance in nats."""
    size = np.abs(errors)
    inner = np.minimum(size, limit)
    return np.asarray(inner * (size - 0.5 * inner))


def huber_weights(errors: Floats, limit: float = HUBER) -> Floats:
    """Weights (m,) of squared errors that give this loss its gradient: 1 up to `limit`, falling beyond."""
    return np.asarray(np.minimum(1.0, limit / np.maximum(np.abs(errors), 1e-300)))


class Rule(NamedTuple):
    """Damping of the steps, as a share of the curvature, and when they end."""

    first: float  # damping of the first step
    eased: float  # its factor after a step that lowers the loss ...
    least: float  # ... and where that ends
    raised: float  # its factor after one that does not ...
    again: float  # ... with at least this much
    trials: int  # of a step
    settled: float  # share of the loss by which the last step lowers it
    worthwhile: float  # share of the loss that a step must promise to be tried
    steady: float  # after a step that lowers the loss by a smaller share the sensitivities serve again


def minimise(
    point: Point, about: Callable[[Point, bool], tuple[float, Normal]],
    moved: Callable[[Point, Floats], tuple[Point, float]], rule: Rule, iterations: int,
    progress: Callable[[int], None] | None = None,
) -> tuple[Point, float, int, bool]:  # fmt: skip
    """The point that damped Gauss-Newton steps reach, its loss, the number of steps, and whether they converged.

    `about` gives the loss at a point and the normal equations of a step, with a zero row and column for a coordinate
    that may not move; it is told whether to compute the sensitivities anew. `moved` makes a step, within its bounds,
    and gives the loss there.
    """
    damping, loss, fall = rule.first, np.inf, 1.0
    for count in range(1, iterations + 1):
        anew = fall >= rule.steady or fall <= 0.0  # a step that fails may be one of old sensitivities
        loss, normal = about(point, anew)
        found, fall = spectrum(normal.matrix, SINGULAR), 0.0
        for _ in range(rule.trials):
            step = found.solution(normal.moment, damping)
            if 0.5 * float(normal.moment @ step) < rule.worthwhile * loss:
                break
            trial, trial_loss = moved(point, step)
            if trial_loss < loss:
                fall, point, loss = 1.0 - trial_loss / loss, trial, trial_loss
                break
            damping = max(rule.again, rule.raised * damping)
        if progress is not None:
            progress(count)
        if fall < rule.settled and (anew or fall > 0.0):
            return point, loss, count, True
        damping = max(rule.least, rule.eased * damping)
    return point, loss, iterations, False

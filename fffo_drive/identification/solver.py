"""Levenberg-Marquardt with bounds and Huber weights on a finite-difference Jacobian."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats
from ..units import MAD_TO_SD
from .coordinates import Coordinates, to_physical
from .prediction import Problem, jacobian, residual

HUBER = 4.0  # residuals beyond this many robust standard deviations lose weight: break-aways that no model predicts
LARGEST_STEP = 0.7  # of a coordinate in one iteration
REFINING = 1e-6  # damping of a refining step, for directions that the data do not determine
CONVERGED = 2e-5  # relative fall of the cost
SAMPLE = 50_000  # residuals are decimated to about this many for the robust scale


class Solution(NamedTuple):
    """Result of the solver."""

    values: Floats  # coordinates
    cost: float  # mean Huber loss, in squared counts
    iterations: int
    converged: bool
    scale: float  # robust standard deviation of the residuals, counts


def robust_scale(errors: Floats) -> float:
    """Standard deviation of the middle of the residuals, from their median magnitude."""
    thinned = errors[:: max(1, errors.size // SAMPLE)]
    return max(MAD_TO_SD * float(np.median(np.abs(thinned))), 1e-6)


def huber_weights(errors: Floats, scale: float) -> Floats:
    """Weights of an iteratively reweighted least squares: 1 inside, falling outside."""
    magnitude = np.abs(errors)
    return np.asarray(np.minimum(1.0, HUBER * scale / np.maximum(magnitude, 1e-300)))


def huber_cost(errors: Floats, scale: float) -> float:
    """Mean Huber loss, scaled as a mean square."""
    limit = HUBER * scale
    magnitude = np.abs(errors)
    inner = np.minimum(magnitude, limit)
    return float(np.mean(inner * (2.0 * magnitude - inner)))


def solve(
    problem: Problem, space: Coordinates, start: Floats, iterations: int = 25,
    progress: Callable[[int], None] | None = None,
) -> Solution:  # fmt: skip
    """Minimise the Huber loss of the prediction errors from a start, within the bounds."""
    values = np.clip(start, space.low, space.high)
    movable = np.flatnonzero(space.high > space.low)
    damping, converged, count = 1e-3, False, 0
    errors = residual(problem, to_physical(values, space.scale))
    scale = robust_scale(errors)
    cost = huber_cost(errors, scale)
    for count in range(1, iterations + 1):
        errors, matrix = jacobian(problem, space, values, movable, central=False)
        scale = robust_scale(errors)
        cost = huber_cost(errors, scale)
        weights = huber_weights(errors, scale)
        gradient = matrix.T @ (weights * errors)
        hessian = matrix.T @ (weights[:, None] * matrix)
        stuck = (values[movable] <= space.low[movable]) & (gradient > 0.0)
        stuck |= (values[movable] >= space.high[movable]) & (gradient < 0.0)
        accepted = False
        for _ in range(8):
            step = _step(hessian, gradient, damping, ~stuck)
            trial = values.copy()
            trial[movable] = np.clip(trial[movable] + step, space.low[movable], space.high[movable])
            trial_cost = huber_cost(residual(problem, to_physical(trial, space.scale)), scale)
            if np.isfinite(trial_cost) and trial_cost < cost:
                accepted = True
                break
            damping = min(1e6, 8.0 * damping)
        if progress is not None:
            progress(count)
        if not accepted:
            converged = True
            break
        fall = (cost - trial_cost) / cost
        values, cost = trial, trial_cost
        damping = max(1e-8, 0.2 * damping)
        if fall < CONVERGED:
            converged = True
            break
    return Solution(values, cost, count, converged, scale)


def refine(problem: Problem, space: Coordinates, solution: Solution, steps: int = 2) -> Solution:
    """Gauss-Newton steps with central differences from a solution, as long as the cost does not rise.

    Where a reversal appears or disappears with a parameter, one-sided differences take the jump for a slope, and the
    solver stops a standard deviation away from the minimum.
    """
    for _ in range(steps):
        trial, cost = central_step(problem, space, solution)
        if not trial.cost <= cost * (1.0 + CONVERGED):
            break
        solution = trial
    return solution


def central_step(problem: Problem, space: Coordinates, solution: Solution) -> tuple[Solution, float]:
    """One Gauss-Newton step with central differences, accepted unconditionally; and the cost before it.

    Coordinates at a bound stay there.
    """
    values = solution.values
    free = np.flatnonzero((values > space.low) & (values < space.high))
    errors, matrix = jacobian(problem, space, values, free, central=True)
    scale = robust_scale(errors)
    weights = huber_weights(errors, scale)
    gradient = matrix.T @ (weights * errors)
    step = _step(matrix.T @ (weights[:, None] * matrix), gradient, REFINING, np.ones(free.size, dtype=np.bool_))
    trial = values.copy()
    trial[free] = np.clip(trial[free] + step, space.low[free], space.high[free])
    cost = huber_cost(residual(problem, to_physical(trial, space.scale)), scale)
    return solution._replace(values=trial, cost=cost, scale=scale), huber_cost(errors, scale)


def _step(hessian: Floats, gradient: Floats, damping: float, free: npt.NDArray[np.bool_]) -> Floats:
    diagonal = np.maximum(np.diag(hessian), 1e-12 * float(np.diag(hessian).max(initial=1e-300)))
    step = np.zeros(gradient.size)
    part = np.ix_(free, free)
    step[free] = -np.linalg.solve(hessian[part] + damping * np.diag(diagonal[free]), gradient[free])
    largest = float(np.abs(step).max(initial=0.0))
    return step if largest <= LARGEST_STEP else step * (LARGEST_STEP / largest)

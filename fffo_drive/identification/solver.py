"""The minimum of the prediction errors, with Huber's loss, within bounds, by finite differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..least_squares import SINGULAR, Normal, Rule, huber, huber_weights, minimise, normal_equations, spectrum
from ..units import MAD_TO_SD
from .coordinates import Coordinates, to_physical
from .prediction import Problem, jacobian, residual

HUBER = 4.0  # residuals beyond this many robust standard deviations lose weight: break-aways that no model predicts
LARGEST_STEP = 0.7  # of a coordinate in one iteration
REFINING = 1e-6  # damping of a refining step, for directions that the data do not determine
CONVERGED = 2e-5  # relative fall of the cost that ends a fit
STEADY = 0.002  # ... and below which the sensitivities serve again
RULE = Rule(1e-3, 0.2, 1e-8, 8.0, 0.0, 8, CONVERGED, 0.0, STEADY)
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


def huber_cost(errors: Floats, scale: float) -> float:
    """Mean Huber loss, scaled as a mean square."""
    return 2.0 * float(np.mean(huber(errors, HUBER * scale)))


class Point(NamedTuple):
    """Coordinates, and the prediction errors there."""

    values: Floats
    errors: Floats


def solve(
    problem: Problem, space: Coordinates, start: Floats, iterations: int = 40,
    progress: Callable[[int], None] | None = None,
) -> Solution:  # fmt: skip
    """Minimise the Huber loss of the prediction errors from a start, within the bounds.

    The scale of the loss is that of the errors at the beginning of each step.
    """
    movable = np.flatnonzero(space.high > space.low)
    scale, matrix = 1.0, np.empty((0, 0))

    def about(point: Point, anew: bool) -> tuple[float, Normal]:
        nonlocal scale, matrix
        values, errors = point
        if anew:
            matrix = jacobian(problem, space, values, errors, movable, central=False)
        scale = robust_scale(errors)
        normal = normal_equations(matrix, -errors, huber_weights(errors, HUBER * scale))
        stuck = (values <= space.low)[movable] & (normal.moment < 0.0)
        stuck |= (values >= space.high)[movable] & (normal.moment > 0.0)
        normal.matrix[stuck] = normal.matrix[:, stuck] = 0.0
        return huber_cost(errors, scale), normal

    def moved(point: Point, step: Floats) -> tuple[Point, float]:
        trial = point_at(problem, space, _moved(space, point.values, movable, step))
        return trial, huber_cost(trial.errors, scale)

    first = point_at(problem, space, np.clip(start, space.low, space.high))
    found, cost, taken, converged = minimise(first, about, moved, RULE, iterations, progress)
    return Solution(found.values, cost, taken, converged, scale)


def point_at(problem: Problem, space: Coordinates, values: Floats) -> Point:
    """The prediction errors at coordinates."""
    return Point(values, residual(problem, to_physical(values, space.scale)))


def refine(problem: Problem, space: Coordinates, solution: Solution, steps: int = 4) -> Solution:
    """Gauss-Newton steps with central differences at a solution, as long as the cost falls.

    Where a reversal appears or disappears with a parameter, one-sided differences take the jump for a slope, and the
    solver stops a standard deviation away from the minimum. Coordinates at a bound stay there.
    """
    point = point_at(problem, space, solution.values)
    free, matrix = slopes_at(problem, space, point)
    for _ in range(steps):
        scale = robust_scale(point.errors)
        trial = point_at(problem, space, _step(space, point, free, matrix, scale))
        cost, before = huber_cost(trial.errors, scale), huber_cost(point.errors, scale)
        if not cost <= before * (1.0 + CONVERGED):
            break
        point, solution = trial, solution._replace(values=trial.values, cost=cost, scale=scale)
        if cost >= before * (1.0 - CONVERGED):
            break
    return solution


def central_step(problem: Problem, space: Coordinates, values: Floats) -> Floats:
    """Coordinates after one Gauss-Newton step with central differences."""
    point = point_at(problem, space, values)
    return _step(space, point, *slopes_at(problem, space, point), robust_scale(point.errors))


def slopes_at(problem: Problem, space: Coordinates, point: Point) -> tuple[Integers, Floats]:
    """Free coordinates that are not at a bound (k,), and the central differences by them (rows, k)."""
    free = np.flatnonzero((point.values > space.low) & (point.values < space.high))
    return free, jacobian(problem, space, point.values, point.errors, free, central=True)


def _step(space: Coordinates, point: Point, free: Integers, matrix: Floats, scale: float) -> Floats:
    normal = normal_equations(matrix, -point.errors, huber_weights(point.errors, HUBER * scale))
    return _moved(space, point.values, free, spectrum(normal.matrix, SINGULAR).solution(normal.moment, REFINING))


def _moved(space: Coordinates, values: Floats, free: Integers, step: Floats) -> Floats:
    """Coordinates after a step of the free ones, of limited length and within the bounds."""
    trial = values.copy()
    trial[free] += step * min(1.0, LARGEST_STEP / max(float(np.abs(step).max(initial=0.0)), 1e-300))
    return np.clip(trial, space.low, space.high)

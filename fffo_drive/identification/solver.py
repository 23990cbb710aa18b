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
CONVERGED = 2e-5  # relative fall of the cost
RULE = Rule(1e-3, 0.2, 1e-8, 8.0, 0.0, 8, CONVERGED, 0.0)
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


def solve(
    problem: Problem, space: Coordinates, start: Floats, iterations: int = 25,
    progress: Callable[[int], None] | None = None,
) -> Solution:  # fmt: skip
    """Minimise the Huber loss of the prediction errors from a start, within the bounds.

    The scale of the loss is that of the errors at the beginning of each step.
    """
    movable = np.flatnonzero(space.high > space.low)
    scale = 1.0

    def about(values: Floats) -> tuple[float, Normal]:
        nonlocal scale
        errors, matrix = jacobian(problem, space, values, movable, central=False)
        scale = robust_scale(errors)
        normal = normal_equations(matrix, -errors, huber_weights(errors, HUBER * scale))
        stuck = (values <= space.low)[movable] & (normal.moment < 0.0)
        stuck |= (values >= space.high)[movable] & (normal.moment > 0.0)
        normal.matrix[stuck] = normal.matrix[:, stuck] = 0.0
        return huber_cost(errors, scale), normal

    def moved(values: Floats, step: Floats) -> tuple[Floats, float]:
        trial = _moved(space, values, movable, step)
        return trial, huber_cost(residual(problem, to_physical(trial, space.scale)), scale)

    return Solution(*minimise(np.clip(start, space.low, space.high), about, moved, RULE, iterations, progress), scale)


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
    normal = normal_equations(matrix, -errors, huber_weights(errors, HUBER * scale))
    trial = _moved(space, values, free, spectrum(normal.matrix, SINGULAR).solution(normal.moment, REFINING))
    cost = huber_cost(residual(problem, to_physical(trial, space.scale)), scale)
    return solution._replace(values=trial, cost=cost, scale=scale), huber_cost(errors, scale)


def _moved(space: Coordinates, values: Floats, free: Integers, step: Floats) -> Floats:
    """Coordinates after a step of the free ones, of limited length and within the bounds."""
    trial = values.copy()
    trial[free] += step * min(1.0, LARGEST_STEP / max(float(np.abs(step).max(initial=0.0)), 1e-300))
    return np.clip(trial, space.low, space.high)

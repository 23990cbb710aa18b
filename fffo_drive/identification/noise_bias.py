"""Bias of a fit by the sensor's noise: simulation-extrapolation after Cook and Stefanski (1994).

The observer lets some of the position's noise into its velocity. Friction takes the speed as it is, without its sign,
so noise around a reversal counts as motion and biases the parameters of presliding one way. Doubling the noise variance
doubles the bias, to first order: the shift, which can be computed without true values, is the size of the bias.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Floats
from .coordinates import Coordinates
from .prediction import Problem
from .solver import central_step

THIRD_DIFFERENCE_POWER = 20.0  # of white noise: 1 + 9 + 9 + 1
SEED = 1


def sensor_noise_rev(problem: Problem) -> float:
    """Standard deviation of the position's noise, quantisation included, from its third differences while it moves."""
    squares, samples = 0.0, 0
    for stretch in problem.stretches:
        moving = np.repeat(stretch.kept, problem.shooting.block)
        third = np.diff(stretch.position_rev[: moving.size], 3)[moving[3:]]
        squares += float(third @ third)
        samples += third.size
    return float(np.sqrt(squares / (THIRD_DIFFERENCE_POWER * max(1, samples))))


def noise_shift(problem: Problem, space: Coordinates, values: Floats) -> Floats:
    """Shift of the coordinates (p,) of a minimum when the position has twice the noise's variance.

    Mean over the same noise with both signs: the linear part cancels.
    """
    noise_rev = sensor_noise_rev(problem)
    draw = np.random.default_rng(SEED)
    noise = [noise_rev * draw.standard_normal(stretch.position_rev.size) for stretch in problem.stretches]
    shift = np.zeros(values.size)
    for sign in (1.0, -1.0):
        stretches = tuple(
            stretch._replace(position_rev=stretch.position_rev + sign * added)
            for stretch, added in zip(problem.stretches, noise, strict=True)
        )
        shift += 0.5 * (central_step(problem._replace(stretches=stretches), space, values) - values)
    return shift

"""A change of one channel, beside a level and slopes that the fleet's prior bounds: robust least squares."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..least_squares import huber_weights, normal_equations
from .channels import Channels
from .detector import CLIP, ChannelPrior

ROUNDS = 4  # of the weights after Huber


class ChangeFit(NamedTuple):
    """The change that fits."""

    size: float
    sd: float
    misfit: float  # squared, in variances; a run counts for CLIP at most


def fit_change(channels: Channels, prior: ChannelPrior, c: int, runs: Integers, shape: Floats) -> ChangeFit:
    """Channel `c` of these runs, which all have it. `shape` (n,): of the change. `sd` is by the fleet's scatter."""
    white = 1.0 / np.sqrt(channels.variance[runs, c] * prior.variance[c])
    design = np.column_stack([np.ones(runs.size), channels.covariates[runs], shape]) * white[:, None]
    target = channels.y[runs, c] * white
    slope_sd = np.sqrt(np.diag(prior.covariance[c])[1:] * prior.variance[c])
    ridge = np.diag([0.0, *(slope_sd**-2.0), 0.0])
    pull = ridge @ np.concatenate([prior.mean[c], [0.0]])
    weight = np.ones(runs.size)
    for _ in range(ROUNDS):
        normal, moment = normal_equations(design, target, weight)
        normal += ridge
        solution = np.linalg.solve(normal, moment + pull)
        residual = target - design @ solution
        weight = huber_weights(residual, CLIP)
    clipped = np.clip(residual, -CLIP, CLIP)
    sd = math.sqrt(float(np.linalg.inv(normal)[3, 3]))
    return ChangeFit(float(solution[3]), sd, float(clipped @ clipped))

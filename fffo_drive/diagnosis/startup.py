"""The base model from nothing: a rigid regression, a grid for what it does not have, then a fit in torque.

A constant torque and a wave of the angle stand beside the axis in the regression, or would be taken for inertia.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..identification.coordinates import start_vector
from ..identification.criterion import HUBER, huber, levels
from ..identification.dataset import DataError
from ..identification.facts import DriveFacts
from ..identification.fit import LAG_RATIOS, PRESLIDING_LSB
from ..identification.prediction import THREADS
from ..identification.ranking import first_best
from ..identification.regression import TorqueStart, start_problems
from .base import balanced, delayed, residual_rows
from .fitting import Data, Fitted, evaluate, fit, with_levels
from .rows import Rows, Stretch

Floats = npt.NDArray[np.float64]

DELAYS_S = tuple(0.001 * k for k in range(13))
BUMPS = (0.03, 0.06, 0.12, 0.25)  # Stribeck speeds that are tried, in shares of the top speed
ROUNDS = 4
SETTLED = 0.005  # relative change of every parameter at which the base is not fitted again
REWEIGHTED = 3  # rounds of the robust regression
LEAST_LEVEL = 0.01  # of the rms torque, that friction is at least: a run that turns one way may give it to a constant


class Regression(NamedTuple):
    """Least squares on rows: coefficients, and the mean loss."""

    values: Floats
    cost: float


def regressed(columns: Sequence[Floats], torque: Floats) -> Regression:
    """Robust least squares of `torque` (m,) on columns (m,) each."""
    matrix = np.column_stack(columns)
    scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    weight = np.ones(torque.size)
    values = np.zeros(matrix.shape[1])
    left = torque
    for _ in range(REWEIGHTED):
        root = np.sqrt(weight)
        values = np.linalg.lstsq(root[:, None] * matrix / scale, root * torque, rcond=1e-8)[0] / scale
        left = torque - matrix @ values
        level = max(1.4826 * float(np.median(np.abs(left))), 1e-300)
        weight = np.minimum(1.0, HUBER * level / np.maximum(np.abs(left), 1e-300))
    return Regression(values, float(np.mean(weight * left * left)))


def rigid_start(stretches: Sequence[Stretch], rows: Rows) -> TorqueStart:
    """J, viscous and Coulomb friction, delay, and a falling Stribeck curve where there is one."""
    used = np.flatnonzero(rows.kept)
    if used.size < 2 * len(DELAYS_S):
        raise DataError("hardly anything moves in these runs: raise the excitation, or add a run at higher speed")
    velocity, top = rows.velocity_rps[used], float(np.quantile(np.abs(rows.velocity_rps[used]), 0.95))
    angle = 2.0 * np.pi * rows.position_rev[used]
    sign = np.tanh(velocity / (0.02 * top))
    known = [rows.acceleration_rps2[used], velocity, sign, np.ones(used.size), np.cos(angle), np.sin(angle)]

    def torque(delay_s: float) -> Floats:
        parts = [
            rows.filter.rows(s.torque_constant_nm_per_a * delayed(s.current_a, delay_s / s.period_s)) for s in stretches
        ]
        return np.concatenate(parts)[used]

    costs = [regressed(known, torque(delay_s)).cost for delay_s in DELAYS_S]
    delay_s = DELAYS_S[int(np.argmin(costs))]
    target = torque(delay_s)
    best, speed, excess = regressed(known, target), 0.1 * top, 0.0
    for share in BUMPS:
        bump = sign * np.exp(-np.abs(velocity) / (share * top))
        found = regressed([*known, bump], target)
        if found.values[-1] > 0.0 and found.values[2] > 0.0 and found.cost < best.cost:
            best, speed, excess = found, share * top, float(found.values[-1])
    inertia, viscous, coulomb = (float(x) for x in best.values[:3])
    size = float(np.sqrt(np.mean(target**2)))
    coulomb = max(coulomb, LEAST_LEVEL * size)
    return TorqueStart(
        inertia, max(viscous, 1e-3 * coulomb / top), coulomb, coulomb + min(max(excess, 0.02 * coulomb), 4.0 * coulomb),
        speed, 1.0, delay_s, float(np.sqrt(best.cost)) / size, used.size, 0.0, float(best.values[3]),
    )  # fmt: skip


def start_physical(facts: DriveFacts, stretches: Sequence[Stretch], rows: Rows) -> Floats:
    """Parameters to begin with. Raises DataError where the data cannot carry a fit."""
    start = rigid_start(stretches, rows)
    problems = start_problems(start, facts.torque_constant_nm_per_a, facts.rated_current_a)
    if problems:
        raise DataError("\n".join(problems))
    lsb_rev = max(stretch.lsb_rev for stretch in stretches)
    candidates = [
        start_vector(start, 1.0 / (counts * lsb_rev), start.static_nm / (ratio * counts * lsb_rev))
        for counts in PRESLIDING_LSB
        for ratio in LAG_RATIOS
    ]
    ready = balanced(stretches, candidates[0])

    def loss(physical: Floats) -> float:
        residual = residual_rows(ready, physical, rows)[rows.kept]
        scale = max(1.4826 * float(np.median(np.abs(residual))), 1e-12)
        return float(huber(residual / scale).mean()) * scale * scale

    with ThreadPoolExecutor(THREADS) as pool:
        losses = list(pool.map(loss, candidates))
    return candidates[first_best(range(len(losses)), losses.__getitem__)]


def fit_base(stretches: Sequence[Stretch], rows: Rows, start: Floats, runs: int) -> tuple[Data, Fitted]:
    """Data with its levels of noise, and the base fit in torque."""
    data = Data(stretches, rows, rows.kept.astype(np.float64), runs, start)
    fitted = Fitted(start, (), np.inf, np.zeros(0), np.zeros(0))
    for _ in range(ROUNDS):
        data = data._replace(stretches=balanced(stretches, fitted.physical))
        begin = evaluate(data, fitted.physical, ())[0]
        flat = levels(begin.residual_nm, rows.kept, np.zeros(rows.time_s.size, np.int64))
        data = with_levels(data._replace(weight=flat), begin)
        before, fitted = fitted, fit(data, fitted.physical, ())
        if np.allclose(fitted.physical[:9], before.physical[:9], rtol=SETTLED, atol=0.0):
            break
    return data, fitted

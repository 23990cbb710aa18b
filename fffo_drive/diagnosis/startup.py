"""Start values of the fits: a regression for a rigid axis, and a grid for the remaining parameters.

The regression includes a constant torque, where the runs turn both ways, and a wave in the angle: both would otherwise
bias the inertia.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..arrays import Floats
from ..identification.coordinates import start_vector
from ..identification.dataset import DataError
from ..identification.facts import DriveFacts
from ..identification.fit import LAG_RATIOS, PRESLIDING_LSB
from ..identification.ranking import first_best
from ..identification.regression import TorqueStart, start_problems
from ..identification.rows import turns_one_way
from ..identification.threads import in_threads
from ..least_squares import huber, robust_least_squares
from ..units import MAD_TO_SD
from .base import balanced, delayed, residual_rows
from .fitting import Data
from .rows import DiagnosisRows, DiagnosisStretch

DELAYS_S = tuple(0.001 * k for k in range(13))
BUMPS = (0.03, 0.06, 0.12, 0.25)  # Stribeck speeds that are tried, in shares of the top speed
LEAST_LEVEL = 0.01  # smallest friction, of the rms torque


def rigid_start(stretches: Sequence[DiagnosisStretch], rows: DiagnosisRows) -> tuple[TorqueStart, float]:
    """J, friction, delay, a falling Stribeck curve where there is one; and the residual level, Nm."""
    used = np.flatnonzero(rows.kept)
    if used.size < 2 * len(DELAYS_S):
        raise DataError("hardly anything moves in these runs: raise the excitation, or add a run at higher speed")
    velocity, top = rows.velocity_rps[used], float(np.quantile(np.abs(rows.velocity_rps[used]), 0.95))
    angle = 2.0 * np.pi * rows.position_rev[used]
    sign = np.tanh(velocity / (0.02 * top))
    # where all runs turn one way, a constant torque is part of the friction
    constant = np.full(used.size, 0.0 if turns_one_way(sign) else 1.0)
    known = [rows.acceleration_rps2[used], velocity, sign, constant, np.cos(angle), np.sin(angle)]

    def torque(delay_s: float) -> Floats:
        parts = [
            rows.filter.rows(s.torque_constant_nm_per_a * delayed(s.current_a, delay_s / s.period_s)) for s in stretches
        ]
        return np.concatenate(parts)[used]

    matrix = np.column_stack(known)
    costs = [robust_least_squares(matrix, torque(delay_s))[1] for delay_s in DELAYS_S]
    delay_s = DELAYS_S[int(np.argmin(costs))]
    target = torque(delay_s)
    (best, loss, level), speed, excess = robust_least_squares(matrix, target), 0.1 * top, 0.0
    for share in BUMPS:
        bump = sign * np.exp(-np.abs(velocity) / (share * top))
        found, its_loss, its_level = robust_least_squares(np.column_stack([matrix, bump]), target)
        if found.values[-1] > 0.0 and found.values[2] > 0.0 and its_loss < loss:
            best, loss, level, speed, excess = found, its_loss, its_level, share * top, float(found.values[-1])
    inertia, viscous, coulomb = (float(x) for x in best.values[:3])
    size = float(np.sqrt(np.mean(target**2)))
    coulomb = max(coulomb, LEAST_LEVEL * size)
    start = TorqueStart(
        inertia, max(viscous, 1e-3 * coulomb / top), coulomb, coulomb + min(max(excess, 0.02 * coulomb), 4.0 * coulomb),
        speed, 1.0, delay_s, 0.0, float(best.values[3]),
    )  # fmt: skip
    return start, level


def starting_data(
    facts: DriveFacts, stretches: Sequence[DiagnosisStretch], rows: DiagnosisRows, runs: int,
    physical: Floats | None = None,
) -> Data:  # fmt: skip
    """Data with start values and a uniform noise level from the regression with its wave.

    `physical`: the start values, where known. Raises DataError where the data cannot carry a fit.
    """
    start, level = rigid_start(stretches, rows)
    if physical is None:
        problems = start_problems(start, facts.torque_constant_nm_per_a, facts.rated_current_a)
        if problems:
            raise DataError("\n".join(problems))
        physical = _physical(start, stretches, rows)
    weight = np.where(rows.kept, 1.0 / max(level, 1e-300), 0.0)
    return Data(balanced(stretches, physical), rows, weight, runs, physical)


def _physical(start: TorqueStart, stretches: Sequence[DiagnosisStretch], rows: DiagnosisRows) -> Floats:
    """Parameters that the regression lacks (presliding and its lag), from a grid."""
    lsb_rev = max(stretch.lsb_rev for stretch in stretches)
    candidates = [
        start_vector(start, 1.0 / (counts * lsb_rev), start.static_nm / (ratio * counts * lsb_rev))
        for counts in PRESLIDING_LSB
        for ratio in LAG_RATIOS
    ]
    ready = balanced(stretches, candidates[0])

    def loss(physical: Floats) -> float:
        residual = residual_rows(ready, physical, rows)[rows.kept]
        scale = max(MAD_TO_SD * float(np.median(np.abs(residual))), 1e-12)
        return float(huber(residual / scale).mean()) * scale * scale

    losses = list(in_threads(loss, candidates))
    return candidates[first_best(range(len(losses)), losses.__getitem__)]

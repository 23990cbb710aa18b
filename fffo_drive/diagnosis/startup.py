"""The base model from nothing: a regression for what it gives, a grid for presliding, then a fit in torque."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from ..identification.coordinates import start_vector
from ..identification.dataset import DataError, Record
from ..identification.facts import DriveFacts
from ..identification.fit import LAG_RATIOS, PRESLIDING_LSB
from ..identification.prediction import THREADS
from ..identification.ranking import first_best
from ..identification.regression import regression_start, start_problems
from .base import NAMES, along, balanced, residual_rows, sensitivities
from .evidence import estimate_whitening, noise_classes
from .fitting import Data, Fitted, huber_loss, refit
from .paths import Rows, Stretch

Floats = npt.NDArray[np.float64]

PRESLIDING_LENGTHS = 4.0  # presliding is over after so many 1/K of travel
ROUNDS = 3
SETTLED = 0.005  # relative change of every parameter at which the base is not fitted again


def start_physical(records: Sequence[Record], facts: DriveFacts, stretches: Sequence[Stretch], rows: Rows) -> Floats:
    """Parameters to begin with. Raises DataError where the data cannot carry a fit."""
    start = regression_start(records)
    problems = start_problems(start, facts.torque_constant_nm_per_a, facts.rated_current_a)
    if problems:
        raise DataError("\n".join(problems))
    lsb_rev = max(record.lsb_rev for record in records)
    candidates = [
        start_vector(start, 1.0 / (counts * lsb_rev), start.static_nm / (ratio * counts * lsb_rev))
        for counts in PRESLIDING_LSB
        for ratio in LAG_RATIOS
    ]
    ready = balanced(stretches, candidates[0])

    def loss(physical: Floats) -> float:
        residual = residual_rows(ready, physical, rows)[rows.kept]
        scale = max(1.4826 * float(np.median(np.abs(residual))), 1e-12)
        return huber_loss(residual / scale) * scale * scale

    with ThreadPoolExecutor(THREADS) as pool:
        losses = list(pool.map(loss, candidates))
    return candidates[first_best(range(len(losses)), losses.__getitem__)]


def presliding_rev(physical: Floats) -> float:
    """Travel after a reversal up to which it is presliding."""
    return PRESLIDING_LENGTHS / float(physical[NAMES.index("stiffness_per_rev")])


def noise_model(data: Data, physical: Floats, residual_nm: Floats) -> Data:
    """The same data with the whitening of this residual."""
    step = data.rows.laws.step
    travel = np.concatenate([along(s, physical).travel_rev[::step] for s in data.stretches])
    classes = noise_classes(data.rows, travel, presliding_rev(physical))
    return data._replace(whitening=estimate_whitening(data.rows, residual_nm, classes))


def fit_base(
    stretches: Sequence[Stretch], rows: Rows, start: Floats, runs: int, rounds: int = ROUNDS
) -> tuple[Data, Fitted, Floats]:
    """Data with its noise model, the base fit in torque, and the sensitivities there."""
    physical = start
    fitted: Fitted | None = None
    for _ in range(rounds):
        ready = balanced(stretches, physical)
        residual = residual_rows(ready, physical, rows)
        white = estimate_whitening(rows, residual, np.zeros(rows.time_s.size, np.int64))
        data = Data(ready, rows, white, runs, start)
        data = noise_model(data, physical, residual)
        matrix = sensitivities(ready, physical, rows)
        before = fitted
        fitted = refit(data, matrix, physical, (), iterations=4)
        physical = fitted.physical
        if before is not None and np.allclose(physical[:9], before.physical[:9], rtol=SETTLED, atol=0.0):
            break
    assert fitted is not None
    data = data._replace(stretches=balanced(stretches, physical))
    matrix = sensitivities(data.stretches, physical, rows)
    residual = residual_rows(data.stretches, physical, rows)
    data = noise_model(data, physical, residual)
    return data, refit(data, matrix, physical, (), iterations=2), matrix

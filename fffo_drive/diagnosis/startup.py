"""Start values of the fits: those of the first rungs, and a grid for the parameters that a force balance lacks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..arrays import Floats
from ..identification.coordinates import start_vector
from ..identification.dataset import DataError
from ..identification.facts import DriveFacts
from ..identification.fit import LAG_RATIOS, MOST_ACTED, PRESLIDING_LSB
from ..identification.ranking import first_best
from ..identification.regression import LEAST_ROWS, TorqueStart, start_problems
from ..identification.threads import in_threads
from ..least_squares import huber
from ..units import MAD_TO_SD
from .base import balanced, residual_rows
from .fitting import Data
from .rows import DiagnosisRows, DiagnosisStretch


def starting_data(
    facts: DriveFacts,
    stretches: Sequence[DiagnosisStretch],
    rows: DiagnosisRows,
    runs: int,
    start: TorqueStart,
    physical: Floats | None = None,
) -> Data:
    """Data with start values and a uniform noise level.

    `physical`: the start values, where known. Raises DataError where the data cannot carry a fit.
    """
    used = int(np.count_nonzero(rows.kept))
    if used < LEAST_ROWS:
        raise DataError("hardly anything moves in these runs: raise the excitation, or add a run at higher speed")
    if physical is None:
        problems = start_problems(start, facts.torque_constant_nm_per_a, facts.rated_current_a)
        if problems and start.has_inertia:
            raise DataError("\n".join(problems))
        physical = _physical(start, stretches, rows)
    ready = balanced(stretches, physical)
    left = residual_rows(ready, physical, rows)[rows.kept] - start.constant_nm
    level = MAD_TO_SD * float(np.median(np.abs(left)))
    most_viscous = MOST_ACTED * start.most_viscous_nm_per_rps
    weight = np.where(rows.kept, 1.0 / max(level, 1e-300), 0.0)
    return Data(ready, rows, weight, runs, physical, most_viscous_nm_per_rps=most_viscous)


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

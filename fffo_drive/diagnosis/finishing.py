"""After the selection: one datum for all runs where that will do, and how sure each number is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..identification.ranking import lower
from .evidence import whiten
from .fitting import Data, Fitted, consistent_scenes, cost, effect_jacobian, refit, slots_of

Floats = npt.NDArray[np.float64]


def merged_datum(data: Data, matrix: Floats, fitted: Fitted) -> Fitted:
    """One datum for all runs where that costs no more than its numbers save."""
    for number, effect in enumerate(fitted.effects):
        if not effect.per_run:
            continue
        common = {
            name: np.array([float(values.mean())]) if name in effect.per_run else values
            for name, values in effect.strengths.items()
        }
        effects = list(fitted.effects)
        effects[number] = replace(effect, strengths=common, per_run=frozenset())
        trial = refit(data, matrix, fitted.physical, effects)
        if lower(cost(trial, data), cost(fitted, data)) or trial.loss < 1.02 * fitted.loss:
            fitted = trial
    return fitted


def standard_deviations(data: Data, matrix: Floats, fitted: Fitted) -> tuple[Floats, dict[tuple[int, str, int], float]]:
    """Standard deviations by windows (sandwich): of the base coordinates, and of every number of the effects."""
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    slots = slots_of(fitted.effects, True, float(np.ptp(data.rows.position_rev)))
    columns = np.concatenate([matrix, effect_jacobian(data, fitted.effects, slots, scenes)], axis=1)
    white = whiten(data.rows, data.whitening, columns)
    norms = np.maximum(np.sqrt(np.einsum("ij,ij->j", white, white)), 1e-300)
    white = white / norms
    inverse = np.linalg.pinv(white.T @ white, rcond=1e-10)
    window = data.rows.window[data.whitening.kept]
    products = white * np.clip(fitted.white, -6.0, 6.0)[:, None]
    counts = [np.bincount(window, products[:, k]) for k in range(products.shape[1])]
    scores = np.stack(counts, axis=1).astype(np.float64)
    meat = scores.T @ scores
    for lag, weight in ((1, 2.0 / 3.0), (2, 1.0 / 3.0)):
        cross = scores[:-lag].T @ scores[lag:]
        meat = meat + weight * (cross + cross.T)
    sd = np.sqrt(np.maximum(np.diag(inverse @ meat @ inverse), 0.0)) / norms
    base_count = matrix.shape[1]
    found = {(s.effect, s.name, s.run): float(v) for s, v in zip(slots, sd[base_count:], strict=True)}
    return sd[:base_count], found

"""Does an effect carry over to a run that it was not fitted on?

The fit runs ask for different things: a chirp, a reference, a recipe. What is real explains a run whose rows took no
part in the fit; what only fills a gap of the model on the other runs does harm there. Held-out runs are not touched.

A wave with a datum per run has a phase of its own in each, and one size in all: without the second it is three curves
that fill three gaps.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..identification.prediction import THREADS
from .fitting import Data, Fitted, consistent_scenes, evaluate, huber_terms, refit
from .proof import with_own_datum
from .visited import taught

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

TAUGHT_SHARE = 0.25  # of an effect's gain, in the other runs, for them to teach it
LEAST_ROWS = 400
LEAST_TRANSFER = 0.25  # of the gain on a run that it has when fitted on it


class Transfer(NamedTuple):
    """Gains (fall of the white loss) of an effect on runs, each left out in turn."""

    left_out: float  # on runs left out of the fit
    fitted: float  # on the same runs with all runs fitted
    folds: int  # runs that could be left out

    @property
    def holds(self) -> bool:
        """Whether the effect carries over; with a single run nothing speaks against it."""
        return self.carries(LEAST_TRANSFER)

    def carries(self, least: float) -> bool:
        """Whether so much of the gain is there on runs that were left out; with a single run nothing speaks against."""
        return self.folds == 0 or self.left_out >= least * max(self.fitted, 0.0)


def transfer(data: Data, matrix: Floats, fitted: Fitted, without: Fitted) -> Transfer:
    """Leave each run out in turn, fit with an effect and `without` it, and compare on the run left out.

    A datum per run of a run that is left out stays as the fit of all runs has it: it says nothing about the form. What
    a free curve says where no other run was is not asked.
    """
    kept = data.whitening.kept
    run = data.rows.run
    gain = huber_terms(without.white) - huber_terms(fitted.white)
    total = float(gain.sum())
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)

    def fold(number: int) -> tuple[float, float] | None:
        """What is gained on one run by the fit of the others, and by that of all; None where it can tell nothing."""
        others = (run != number) & data.rows.kept
        inside = (run == number) & taught(fitted.effects, scenes, data.rows.laws.step, others)
        rows = int(inside[kept].sum())
        if rows < LEAST_ROWS or total - float(gain[run[kept] == number].sum()) < TAUGHT_SHARE * total:
            return None
        teaching, asked = _part(data, run != number), _part(data, inside)
        losses = []
        for model in (without, fitted):
            learnt = refit(teaching, matrix, model.physical, model.effects, iterations=2, shapes=False)
            losses.append(evaluate(asked, learnt.physical, learnt.effects)[0].loss)
        return rows * (losses[0] - losses[1]), float(gain[inside[kept]].sum())

    with ThreadPoolExecutor(THREADS) as pool:
        folds = [found for found in pool.map(fold, range(data.runs)) if found is not None]
    return Transfer(sum(left_out for left_out, _ in folds), sum(whole for _, whole in folds), len(folds))


def of_one_size(data: Data, fitted: Fitted, number: int) -> Fitted:
    """The model with the waves of one effect as large in every run, the phases left; one datum in all: as it is."""
    effect = fitted.effects[number]
    if not effect.per_run:
        return fitted
    effects = list(fitted.effects)
    effects[number] = effect.of_sizes(effect.sizes())
    return evaluate(data, fitted.physical, effects)[0]


def datum_holds(data: Data, fitted: Fitted, without: Fitted) -> bool:
    """Whether a datum per run that the first part of each run gives is of use on the rest of it."""
    if not any(effect.per_run for effect in fitted.effects):
        return True
    found, scored = with_own_datum(data, fitted)
    plain, _ = with_own_datum(data, without)
    later = scored[data.whitening.kept]
    return float(huber_terms(found.white[later]).sum()) < float(huber_terms(plain.white[later]).sum())


def _part(data: Data, mask: Mask) -> Data:
    """The same data where only the rows of the mask count."""
    kept = data.whitening.kept
    return data._replace(whitening=data.whitening._replace(kept=kept[mask[kept]]))

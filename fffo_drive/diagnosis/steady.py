"""Whether a finding is what its name says: then it is as strong in one part of the data as in another.

What stands in for something else takes away what it can, and is strong where the two are alike: its strength differs
from slow to fast motion, from one half of a run to the next, or from run to run. What else is left beside a true effect
does not change that, however much it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..identification.criterion import HUBER, Folds, gain, unseen_loss
from .fitting import Data, Fitted, consistent_scenes
from .propose import orthonormal
from .scenes import load_rows

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

STEADY = 0.4  # rms change of an effect's strength over parts of the data, as a share of it, at most
LEAST_ENERGY = 0.02  # of an effect's square beside all else, in a part that is asked how strong it is there


class Split(NamedTuple):
    """How an effect's strength changes over the parts of the data."""

    parts: str  # in words
    spread: float  # rms change, as a share of the strength
    is_uneven: bool  # by more than STEADY, and rows that were not used in the fit show it


def parts_of(data: Data) -> dict[str, Integers]:
    """Ways to cut the rows that count into parts, (q,) each, with the words for them."""
    rows, used = data.rows, data.used
    run, time_s = rows.run[used], rows.time_s[used]
    speed, acceleration = (np.abs(of[used]) for of in (rows.velocity_rps, rows.acceleration_rps2))
    middle = np.array([np.median(time_s[run == k]) if (run == k).any() else 0.0 for k in range(data.runs)])
    return {
        "from run to run": np.unique(run, return_inverse=True)[1],
        "from one direction to the other": (rows.velocity_rps[used] > 0.0).astype(np.int64),
        "from slow to fast motion": (speed > np.median(speed)).astype(np.int64),
        "from steady to accelerated motion": (acceleration > np.median(acceleration)).astype(np.int64),
        "from the first to the second half of the runs": (time_s > middle[run]).astype(np.int64),
    }


def least_steady(data: Data, fitted: Fitted, matrix: Floats, number: int, own: slice) -> Split:
    """Over which parts of the data the strength of an effect changes most.

    `matrix` (q, p): white sensitivities of everything that is fitted; `own`: the effect's columns of it. All else is
    fitted beside the strengths of the parts.
    """
    weight = np.sqrt(np.minimum(1.0, HUBER / np.maximum(np.abs(fitted.white), HUBER)))
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    load = data.white(load_rows(data.rows, scenes, fitted.effects[number]))
    others = orthonormal(weight[:, None] * np.delete(matrix, np.arange(own.start, own.stop), axis=1))
    splits = []
    for words, part in parts_of(data).items():
        columns = load[:, None] * (part[:, None] == np.arange(part.max(initial=0) + 1))
        left = weight[:, None] * columns
        left = left - others @ (others.T @ left)
        energy = np.einsum("ij,ij->j", left, left)
        shown = energy > LEAST_ENERGY * energy.sum()
        if shown.sum() < 2:
            continue
        columns, left, energy = columns[:, shown], left[:, shown], energy[shown] / energy.sum()
        target = weight * (fitted.white + load)
        strengths = np.linalg.lstsq(left, target - others @ (others.T @ target), rcond=None)[0]
        change = strengths - energy @ strengths / energy.sum()
        splits.append((words, float(np.sqrt(energy @ change**2)), columns))
    words, spread, columns = max(splits, key=lambda one: one[1], default=("", 0.0, load[:, None]))
    if spread <= STEADY:
        return Split(words, spread, False)
    folds = Folds(*(part[data.used] for part in data.rows.folds))
    beside, split = (
        unseen_loss(fitted.white, known, folds) for known in (matrix, np.concatenate([matrix, columns], axis=1))
    )
    return Split(words, spread, gain(beside, split, folds).holds)

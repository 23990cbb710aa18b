"""Check a finding's identity: a true effect has the same strength in every part of the data.

An effect that stands in for another explains what it can, and is strong where the two are alike: its strength differs
between slow and fast motion, between the halves of a run, or from run to run. Other missing effects, however large, do
not change the strength of a true effect.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..identification.criterion import HUBER, gain, unseen_loss
from .fitting import Data, Fitted, consistent_scenes
from .propose import orthonormal
from .scenes import load_rows

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# largest rms change of an effect's strength between two parts of the data, as a share of it: 22 right findings on
# measured machines and drives d02 to d08 change by 0.26 at most
STEADY = 0.3
DETERMINED = 0.1  # share of such a change's square that the rest of the fit must not be able to represent


class Split(NamedTuple):
    """Change of an effect's strength from one part of the data to the rest."""

    parts: str  # in words
    spread: float  # rms change, as a share of the strength
    is_uneven: bool  # by more than STEADY, confirmed by rows that were not fitted


def parts_of(data: Data) -> Iterator[tuple[str, Mask]]:
    """Parts of the rows that count, (q,) each, with a description of the comparison."""
    rows, used = data.rows, data.used
    run, time_s = rows.run[used], rows.time_s[used]
    speed, acceleration = (np.abs(of[used]) for of in (rows.velocity_rps, rows.acceleration_rps2))
    middle = np.array([np.median(time_s[run == k]) if (run == k).any() else 0.0 for k in range(data.runs)])
    for k in range(data.runs):
        yield "from run to run", run == k
    yield "from one direction to the other", rows.velocity_rps[used] > 0.0
    yield "from slow to fast motion", speed > np.median(speed)
    yield "from steady to accelerated motion", acceleration > np.median(acceleration)
    yield "from the first to the second half of the runs", time_s > middle[run]


def least_steady(data: Data, fitted: Fitted, matrix: Floats, number: int) -> Split:
    """The partition of the data over which the strength of an effect changes most.

    `matrix` (q, p): white sensitivities of everything that is fitted. The effect's torque in the part alone is added to
    them: the excess there over the rest.
    """
    weight = np.sqrt(np.minimum(1.0, HUBER / np.maximum(np.abs(fitted.white), HUBER)))
    known = orthonormal(weight[:, None] * matrix)
    scenes = consistent_scenes(data, fitted.physical, fitted.effects)
    load = data.white(load_rows(data.rows, scenes, fitted.effects[number]))
    found, most = Split("", 0.0, False), load
    for words, part in parts_of(data):
        own = weight * load
        inside = float(np.sum(own[part] ** 2) / max(float(own @ own), 1e-300))
        own = np.where(part, own, 0.0)
        own = own - known @ (known.T @ own)
        square, whole = float(own @ own), float(load @ load) * inside * (1.0 - inside)
        if square > DETERMINED * whole > 0.0:
            spread = abs(float(own @ (weight * fitted.white))) / square * float(np.sqrt(inside * (1.0 - inside)))
            if spread > found.spread:
                found, most = Split(words, spread, spread > STEADY), np.where(part, load, 0.0)
    if not found.is_uneven:
        return found
    beside, split = (unseen_loss(fitted.white, one, data.folds) for one in (matrix, np.column_stack([matrix, most])))
    return found._replace(is_uneven=gain(beside, split, data.folds).holds)

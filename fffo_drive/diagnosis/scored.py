"""A fit with what its comparison needs: sensitivities and the loss of unseen rows; and the ways to another such fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..identification.criterion import clipped, robust_residual, sandwich_p, unseen_loss
from ..least_squares import huber
from .fitting import (
    Data,
    Fitted,
    at_rest,
    consistent_scenes,
    evaluate,
    fit,
    jacobian,
    slots_of,
    torque_of,
    with_levels,
)

LADDER_ITERATIONS = 8  # of a fit of the first rungs
ROUNDS = 8  # largest number of refits until noise levels and model agree ...
SETTLED = 0.1  # ... which they do when the model moves by less than this, in noise levels


class ScoredFit(NamedTuple):
    """A hypothesis with the figures for its comparison."""

    fitted: Fitted
    matrix: Floats  # (q, p) white sensitivities of everything that is fitted
    unseen: Floats  # (q,) loss of each row under a fit of the other folds


def scored_fit(data: Data, fitted: Fitted) -> ScoredFit:
    """A fit with its sensitivities and unseen losses."""
    matrix = jacobian(data, fitted)
    return ScoredFit(fitted, matrix, unseen_loss(fitted.white, matrix, data.folds))


def chance(data: Data, alone: Fitted, beside: Fitted, numbers: int, negligible_nm: float = 0.0) -> float:
    """p-value of the effect by which `beside` differs from `alone`: a P test (Davidson and MacKinnon, 1981).

    The regressor is the torque by which the two fits differ, whichever parameters carry it. A test of the effect's own
    numbers in `beside` may say nothing, however large the effect (Hauck and Donner, 1977): a full lag's strength is
    then that of the delay. `numbers`: of the effect, over which the fit has chosen the best direction.
    """
    more = alone.white - beside.white
    window = data.folds.window

    def in_windows(values: Floats) -> Floats:
        return np.bincount(window, values * more).astype(np.float64)

    own_nm = more / data.weight[data.used]
    negligible = negligible_nm**2 / max(float(np.mean(own_nm**2)), 1e-300)
    with_it, left = in_windows(clipped(alone.white)), in_windows(clipped(beside.white))
    return sandwich_p(with_it[:, None], left[:, None], in_windows(more), negligible, numbers)


def without(data: Data, scored: ScoredFit, numbers: Sequence[int], refit: bool) -> ScoredFit:
    """The hypothesis without some effects: the others refitted, or moved by one robust least-squares step."""
    if not numbers:
        return scored
    fitted = scored.fitted
    effects = [e for k, e in enumerate(fitted.effects) if k not in numbers]
    if refit:
        return scored_fit(data, fit(data, fitted.physical, effects))
    gone = [fitted.effects[k] for k in numbers]
    load = torque_of(data, consistent_scenes(data, fitted.physical, fitted.effects), gone)
    own = np.concatenate([np.r_[columns_of(data, scored, k)] for k in numbers])
    others = np.delete(scored.matrix, own, axis=1)
    target = fitted.white + data.white(load)
    left = robust_residual(target, others)
    residual_nm = fitted.residual_nm.copy()
    residual_nm[data.used] = left / data.weight[data.used]
    moved = Fitted(fitted.physical, tuple(effects), float(huber(left).mean()), residual_nm, left)
    return ScoredFit(moved, others, unseen_loss(target, others, data.folds))


def columns_of(data: Data, scored: ScoredFit, number: int) -> slice:
    """The effect's columns in the matrix of everything that is fitted."""
    slots = slots_of(scored.fitted.effects, data.rows.turns)
    own = [k for k, slot in enumerate(slots) if slot.effect == number]
    first = scored.matrix.shape[1] - len(slots)
    return slice(first + own[0], first + own[-1] + 1)


def base_of(data: Data) -> Fitted:
    """The base model alone, fitted from the start at the present noise levels."""
    found = fit(data, data.start, (), LADDER_ITERATIONS)
    for _ in range(ROUNDS):
        before, found = found, fit(at_rest(data, found.physical, ()), found.physical, ())
        if _moved(data, before, found) < SETTLED:
            break
    return found


def settled(data: Data, fitted: Fitted) -> tuple[Data, ScoredFit]:
    """Repeat `renewed` until noise levels and model agree."""
    for _ in range(ROUNDS):
        data, scored = renewed(data, fitted)
        change, fitted = _moved(data, fitted, scored.fitted), scored.fitted
        if change < SETTLED:
            break
    return data, scored


def _moved(data: Data, before: Fitted, after: Fitted) -> float:
    """How far a model moved: rms over the rows, in noise levels, outliers clipped."""
    return float(np.sqrt(np.mean(clipped(data.white(after.residual_nm - before.residual_nm)) ** 2)))


def renewed(data: Data, fitted: Fitted) -> tuple[Data, ScoredFit]:
    """Noise levels and balance at rest of the new model, then a refit."""
    data = at_rest(data, fitted.physical, fitted.effects)
    begin = evaluate(data, fitted.physical, fitted.effects)[0]
    data = with_levels(data, begin)
    return data, scored_fit(data, fit(data, fitted.physical, fitted.effects))

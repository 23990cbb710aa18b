"""Which of the chosen effects go again: what noise made, what is worth nothing, what does not carry over."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..identification.ranking import ranked
from .fitting import Data, Fitted, best_gain, raw_share, refit
from .transfer import LEAST_TRANSFER, datum_holds, of_one_size, transfer

Floats = npt.NDArray[np.float64]

COMPANION_SHARE = 0.5  # of the gain of the strongest: below, a datum that does not hold is one too many
MATERIAL_SHARE = 0.03  # of the white sum of squares that an effect has to take away


def backward(
    data: Data, matrix: Floats, fitted: Fitted, probabilities: Sequence[float], rate: float
) -> tuple[Fitted, list[int]]:
    """Remove what noise might have made, what is no longer worth its numbers, and what does not carry over.

    One at a time, the weakest first: it may be what spoils a stronger one. Returns the numbers of those that stay, too.
    """
    left = list(range(len(fitted.effects)))
    while fitted.effects:
        without = [_without(data, matrix, fitted, number) for number in range(len(fitted.effects))]
        gains = [best_gain(one, fitted) for one in without]
        order = ranked(range(len(gains)), key=gains.__getitem__)
        significant = [probabilities[number] <= rate for number in left]
        companions = [gain < COMPANION_SHARE * max(gains) for gain in gains]
        failed = next(
            (n for n in order if not _stays(data, matrix, fitted, without[n], n, significant[n], companions[n])), None
        )
        if failed is None:
            break
        if failed != order[0] and significant[failed] and _stands_alone(data, matrix, fitted, failed):
            failed = order[0]
        fitted = without[failed]
        del left[failed]
    return fitted, left


def _without(data: Data, matrix: Floats, fitted: Fitted, number: int) -> Fitted:
    others = [e for k, e in enumerate(fitted.effects) if k != number]
    return refit(data, matrix, fitted.physical, others, iterations=3)


def _stays(
    data: Data, matrix: Floats, fitted: Fitted, without: Fitted, number: int, significant: bool, companion: bool
) -> bool:
    share = max(1.0 - fitted.loss / without.loss, raw_share(data, without, fitted))
    if not significant or (share < MATERIAL_SHARE and without.effects):
        return False
    equal = of_one_size(data, fitted, number)
    if best_gain(without, equal) < LEAST_TRANSFER * best_gain(without, fitted):
        return False
    if companion and fitted.effects[number].per_run and not datum_holds(data, fitted, without):
        return False
    return transfer(data, matrix, fitted, without).holds


def _stands_alone(data: Data, matrix: Floats, fitted: Fitted, number: int) -> bool:
    """Whether an effect carries over where it is the only one."""
    alone = refit(data, matrix, fitted.physical, [fitted.effects[number]], iterations=3)
    nothing = refit(data, matrix, fitted.physical, [], iterations=3)
    return _stays(data, matrix, alone, nothing, 0, True, False)

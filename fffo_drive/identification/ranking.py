"""The best of several, the same on every processor: among equals the first.

Vector instructions, fused multiply-add and the kernels of the linear algebra change the last digits of a score.
Candidates that say the same thing in other words (a wave by its order or by its period, torque or friction on a motion
of one direction, a start that the data do not notice) have scores that differ in nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import TypeVar

T = TypeVar("T")

EQUAL = 1e-6  # relative: in tools/numerics scores change by 1e-10, and no data distinguish scores closer than this


def lower(one: float, other: float) -> bool:
    """Whether a score is lower than another by more than rounding."""
    return other - one > EQUAL * abs(one)


def ranked(items: Iterable[T], key: Callable[[T], float]) -> list[T]:
    """The items from the lowest score to the highest: `sorted`, but equals (by `lower`) stay in their order.

    NaN comes last.
    """
    candidates = list(items)
    scores = [math.inf if math.isnan(score) else score for score in map(key, candidates)]
    groups: list[list[int]] = []
    for k in sorted(range(len(scores)), key=scores.__getitem__):
        if groups and not lower(scores[groups[-1][0]], scores[k]):
            groups[-1].append(k)
        else:
            groups.append([k])
    return [candidates[k] for group in groups for k in sorted(group)]


def first_best(items: Iterable[T], key: Callable[[T], float]) -> T:
    """The first of the items (at least one) that have the lowest score: `min`, but rounding does not choose."""
    return ranked(items, key)[0]

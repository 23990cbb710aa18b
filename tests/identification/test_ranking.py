"""Of equals the first, however rounding fell; and what differs is ranked as ever."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fffo_drive.identification.ranking import EQUAL, first_best, lower, ranked

SCORES = st.lists(st.floats(0.01, 100.0), min_size=1, max_size=12)
ROUNDING = st.integers(0, 1000)


def places(scores):
    return ranked(range(len(scores)), key=scores.__getitem__)


def rounded_otherwise(scores, seed):
    """The same scores with last digits of another processor."""
    draw = np.random.default_rng(seed)
    return [score * (1.0 + 1e-3 * EQUAL * draw.uniform(-1.0, 1.0)) for score in scores]


@given(st.integers(1, 6), st.integers(1, 4), ROUNDING)
def test_equals_keep_their_order_whatever_their_last_digits_are(distinct, copies, seed):
    scores = [1.0 + k for k in range(distinct)] * copies
    expected = [k + distinct * copy for k in range(distinct) for copy in range(copies)]
    assert places(rounded_otherwise(scores, seed)) == expected


@given(SCORES)
def test_what_comes_later_is_never_lower(scores):
    order = places(scores)
    assert sorted(order) == list(range(len(scores)))
    assert not any(lower(scores[b], scores[a]) for k, a in enumerate(order) for b in order[k + 1 :])


@given(st.lists(st.integers(-50, 50), min_size=1, max_size=12))
def test_whole_numbers_are_sorted_as_python_sorts_them(scores):
    assert ranked(scores, key=float) == sorted(scores)
    assert first_best(scores, key=float) == min(scores)


def test_what_is_not_finite_comes_last_in_its_order():
    assert places([math.nan, 2.0, math.inf, 1.0]) == [3, 1, 0, 2]
    assert lower(1.0, math.inf)
    assert not lower(math.inf, math.inf)
    assert not lower(math.nan, 1.0)

"""`njit(inline="always")` and `generic`: what is handed on is not copied, since there is no call."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from fffo_drive import jit


class Pair(NamedTuple):
    """Two arrays, as a port has a dozen."""

    one: np.ndarray[Any, np.dtype[np.float64]]
    other: np.ndarray[Any, np.dtype[np.float64]]


@jit.generic
def long_product(pair: Any, times: int) -> float:
    """Chosen by the type of the record."""
    raise NotImplementedError


@long_product.register(Pair)
@jit.njit(inline="always")
def _long_product(pair: Pair, times: int) -> float:
    """Long enough that LLVM would leave it a function of its own."""
    total = 0.0
    for k in range(times):
        for i in range(pair.one.size):
            if pair.one[i] > pair.other[i]:
                total += np.sin(pair.one[i]) * np.cos(pair.other[i]) + k
            elif pair.one[i] < pair.other[i] - 1.0:
                total -= np.exp(pair.one[i]) / (1.0 + pair.other[i] * pair.other[i])
            else:
                total += np.sqrt(abs(pair.one[i] - pair.other[i]))
    return total


@jit.njit
def twice(pair: Pair) -> float:
    """Two places from which it is called."""
    return long_product(pair, 2) + long_product(pair, 3)


PAIR = Pair(np.arange(5.0), np.ones(5))


@pytest.mark.skipif(jit.INTERPRETED, reason="nothing is compiled")
def test_a_kernel_that_is_always_inlined_is_nowhere_called():
    assert twice(PAIR) == pytest.approx(twice.py_func(PAIR), rel=1e-12)
    twice.recompile()  # code that comes from the cache on disk, of an earlier run, cannot be inspected
    code = twice.inspect_llvm(twice.signatures[0])
    bodies = [line for line in code.splitlines() if "call" in line and "long_product" in line]
    assert bodies == []
    assert "@sin" in code or "llvm.sin" in code


def test_the_choice_by_type_is_the_same_in_plain_python():
    assert long_product(PAIR, 2) == pytest.approx(_long_product(PAIR, 2), rel=1e-15)

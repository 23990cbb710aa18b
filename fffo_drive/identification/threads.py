"""Work on all available threads: the kernels and the linear algebra do not hold the GIL."""

from __future__ import annotations

import ctypes
import itertools
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

THREADS = min(2, os.cpu_count() or 1)
AHEAD = 2 * THREADS  # items drawn ahead: each may take megabytes
M_ARENA_MAX = -8  # of mallopt(3)


@cache
def one_heap() -> None:
    """One heap for all threads of the process, where the C library has more: each keeps what it freed for itself."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_ARENA_MAX, 1)


def in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Results in the order of the items, which are drawn as they are needed."""
    one_heap()
    left = iter(items)
    with ThreadPoolExecutor(THREADS) as pool:
        waiting = deque(pool.submit(function, item) for item in itertools.islice(left, AHEAD))
        while waiting:
            yield waiting.popleft().result()
            waiting.extend(pool.submit(function, item) for item in itertools.islice(left, 1))

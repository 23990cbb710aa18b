"""A function over many items in processes of their own, taken from an iterable as processes become free."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def over_cores(
    function: Callable[[T], R],
    items: Iterable[T],
    workers: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[R]:
    """Results in the order of the items; `progress` gets how many are done. `workers`: None for all cores.

    One worker is this process itself. The first exception of a worker is raised here, and waiting items are not begun.
    """
    workers = workers or len(os.sched_getaffinity(0))
    results: dict[int, R] = {}
    if workers == 1:
        for number, item in enumerate(items):
            results[number] = function(item)
            if progress is not None:
                progress(len(results))
        return list(results.values())
    # spawned, not forked: a forked process would inherit the locks of threads that it does not have
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        pending: dict[Future[R], int] = {}
        try:
            for number, item in enumerate(items):
                pending[pool.submit(function, item)] = number
                while len(pending) >= 2 * workers:  # one for each to go on with while the next item is made
                    _collect(pending, results, progress)
            while pending:
                _collect(pending, results, progress)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [results[number] for number in sorted(results)]


def _collect(pending: dict[Future[R], int], results: dict[int, R], progress: Callable[[int], None] | None) -> None:
    for future in wait(pending, return_when=FIRST_COMPLETED).done:
        results[pending.pop(future)] = future.result()
    if progress is not None:
        progress(len(results))

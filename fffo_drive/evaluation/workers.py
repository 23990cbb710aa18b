"""A function over many items in processes of their own, taken from an iterable as processes become free."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from multiprocessing.context import ForkServerContext
from typing import TypeVar

# what their work loads at its first use: each process would take a second of its own for it
LOADED_LATE = ("fffo_drive.jit.compiler", "scipy.signal")

T = TypeVar("T")
R = TypeVar("R")


def prepared_processes(module: str) -> ForkServerContext:
    """A context whose processes are forked from a server that has already imported all they need, which takes seconds.

    The server is a process of its own: one that is forked from this process would inherit locks held by threads that it
    does not have. The server keeps the environment in which it started; `take_environment` passes on later changes.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([module, *LOADED_LATE])  # without effect once the server runs
    return context


def take_environment(variables: Mapping[str, str]) -> None:
    """In a worker: the environment of the one who asked."""
    os.environ.clear()
    os.environ.update(variables)


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
    context = prepared_processes(function.__module__)
    with ProcessPoolExecutor(workers, context, take_environment, (dict(os.environ),)) as pool:
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

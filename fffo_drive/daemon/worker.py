"""A thread for what waits (bus, disk) or computes, awaited by the supervisor.

One for each kind of work, so that none stands behind another's; never joined at the end, so that a disk that hangs or a
compiler at work does not keep the process alive.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

T = TypeVar("T")


class _Job(NamedTuple):
    loop: asyncio.AbstractEventLoop
    outcome: asyncio.Future[Any]
    work: Callable[[], Any]


class Worker:
    """Runs one thing after the other on a thread of its own, which begins with the first of them."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._jobs: queue.SimpleQueue[_Job] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._waiting = 0

    @property
    def busy(self) -> bool:
        """Something is under way, or waits."""
        return self._waiting > 0

    async def run(self, function: Callable[..., T], *arguments: Any) -> T:
        """What `function(*arguments)` returns or raises, there."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            self._thread.start()
        loop = asyncio.get_running_loop()
        job = _Job(loop, loop.create_future(), lambda: function(*arguments))
        self._waiting += 1
        self._jobs.put(job)
        result: T = await job.outcome
        return result

    def _work(self) -> None:
        while True:
            job = self._jobs.get()
            try:
                result, error = job.work(), None
            except BaseException as raised:
                result, error = None, raised
            self._waiting -= 1
            with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits any more
                job.loop.call_soon_threadsafe(_settle, job.outcome, result, error)


def _settle(outcome: asyncio.Future[Any], result: Any, error: BaseException | None) -> None:
    if outcome.done():  # who waited has been cancelled
        return
    if error is None:
        outcome.set_result(result)
    else:
        outcome.set_exception(error)

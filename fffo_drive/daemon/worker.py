"""A thread for work that waits (bus, disk) or computes, awaited by the supervisor.

One thread for each kind of work, so that kinds do not block each other; never joined at the end, so that a hanging disk
or a busy compiler does not keep the process alive.
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
    """Runs functions one after the other on its own thread, which starts with the first one."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._jobs: queue.SimpleQueue[_Job] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._waiting = 0

    @property
    def busy(self) -> bool:
        """Whether work is in progress or queued."""
        return self._waiting > 0

    async def run(self, function: Callable[..., T], *arguments: Any) -> T:
        """Result or exception of `function(*arguments)` on the thread."""
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
            with contextlib.suppress(RuntimeError):  # the loop is closed: no one is waiting any more
                job.loop.call_soon_threadsafe(_settle, job.outcome, result, error)


def _settle(outcome: asyncio.Future[Any], result: Any, error: BaseException | None) -> None:
    if outcome.done():  # the waiting task was cancelled
        return
    if error is None:
        outcome.set_result(result)
    else:
        outcome.set_exception(error)

"""Threads for work that waits (bus, disk) or computes, awaited by the supervisor.

One thread for each kind of work, so that kinds do not block each other; never joined at the end, so that a hanging disk
or a busy compiler does not keep the process alive.

A thread that hangs in a file can neither be ended nor interrupted. A worker with a patience abandons such a thread:
its callers get `DiskSilentError`, its late result is dropped, and the next job gets a fresh thread. A thread hangs if
its job has used no processor time for that long: the disk does not answer. Long arithmetic does not count.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path, PurePath
from typing import Any, TypeVar

T = TypeVar("T")

DISK_PATIENCE_S = 5.0  # of all that touches a disk: then the request is answered without it
MOST_HUNG = 16  # threads of a worker that hang at once; then work is refused until one of them comes back
LOOKS = 10  # within the patience


class DiskSilentError(OSError):
    """The disk does not answer; the text says what was asked of it."""


def silence(doing: str) -> str:
    """The sentence about a disk that does not answer."""
    return f"the disk does not answer: {doing} takes longer than {DISK_PATIENCE_S:g} s"


class Stillness:
    """For how long a value has not changed, by looks at it.

    A longer time between two looks counts as `longest_look_s`: the whole process may have been stopped.
    """

    def __init__(self, longest_look_s: float) -> None:
        self._longest_look_s = longest_look_s
        self._seen: object = self
        self._still_s, self._looked_s = 0.0, 0.0

    def look(self, value: object, now_s: float) -> float:
        """Seconds for which it has been this value."""
        step_s = min(now_s - self._looked_s, self._longest_look_s)
        self._still_s = self._still_s + step_s if value == self._seen else 0.0
        self._seen, self._looked_s = value, now_s
        return self._still_s


class Worker:
    """Runs functions one after the other on its own thread, which starts with the first one."""

    def __init__(self, name: str, tell: Callable[[str, bool], None] | None = None) -> None:
        """With `tell` it has a patience; that hears, on the loop's thread, that the disk does not answer (True), and
        that it does again (False).
        """
        self._name, self._tell = name, tell
        self._thread: _Thread | None = None
        self._hung: list[_Thread] = []
        self.silent = ""  # what the disk does not answer to; empty where it answers
        self._said = ""

    @property
    def busy(self) -> bool:
        """Whether somebody waits for work."""
        return self._thread is not None and bool(self._thread.jobs)

    @property
    def hangs(self) -> bool:
        """Whether work that nobody waits for any more is still in progress."""
        return bool(self._hung)

    async def run(
        self,
        function: Callable[..., T],
        *arguments: Any,
        doing: str = "",
        at: Path | None = None,
        late: Callable[[T], object] | None = None,
    ) -> T:
        """Result or exception of `function(*arguments)` on the thread.

        Raises DiskSilentError, with `doing` (reading, writing) and the file where it hangs, or `at`. A result that
        nobody waits for any more goes to `late`, on a thread of its own.
        """
        if len(self._hung) >= MOST_HUNG:
            raise DiskSilentError(f"{self._said}, and {MOST_HUNG} threads wait for it: mend it, or restart the service")
        if self._thread is None:
            self._thread = _Thread(self._name, self._came_back)
        thread = self._thread
        job = _Job(lambda: function(*arguments), doing, at, late)
        thread.take(job)
        look_s = None if self._tell is None else DISK_PATIENCE_S / LOOKS
        try:
            while not job.outcome.done():
                await asyncio.wait({job.outcome}, timeout=look_s)
                if look_s is not None and not job.outcome.done() and thread.stood_still_s() >= DISK_PATIENCE_S:
                    self._leave(thread)
        finally:
            job.outcome.cancel()  # no effect on one that has its result
        result: T = job.outcome.result()
        return result

    def _leave(self, thread: _Thread) -> None:
        """Abandon a thread that hangs, and answer all its callers."""
        self._thread = None
        self._hung.append(thread)
        self.silent = self._said = silence(thread.doing())
        thread.leave(DiskSilentError(self.silent))
        if self._tell is not None:
            self._tell(self.silent, True)

    def _came_back(self, thread: _Thread) -> None:
        """Work has ended on this thread: the disk answers, be it with an error."""
        if thread in self._hung:
            self._hung.remove(thread)
        if self.silent and self._tell is not None:
            self.silent = ""
            self._tell("the disk answers again", False)


class _Job:
    """One piece of work and its caller."""

    def __init__(
        self, work: Callable[[], Any], doing: str, at: Path | None, late: Callable[[Any], object] | None
    ) -> None:
        self.work, self.doing, self.at, self.late = work, doing, at, late
        self.loop = asyncio.get_running_loop()
        self.outcome: asyncio.Future[Any] = self.loop.create_future()
        self.outcome.add_done_callback(lambda outcome: outcome.cancelled() or outcome.exception())


class _Thread:
    """A thread and its jobs, the first of which is in progress."""

    def __init__(self, name: str, came_back: Callable[[_Thread], None]) -> None:
        self.jobs: list[_Job] = []
        self._came_back = came_back
        self._queue: queue.SimpleQueue[_Job] = queue.SimpleQueue()
        self._left = False
        self._stillness = Stillness(DISK_PATIENCE_S / LOOKS)
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()
        self._cpu_clock = time.pthread_getcpuclockid(self._thread.ident or 0)

    def take(self, job: _Job) -> None:
        """Put a job behind the others."""
        self.jobs.append(job)
        self._queue.put(job)

    def stood_still_s(self) -> float:
        """For how long the job in progress has used no processor time."""
        job, used_s = self.jobs[0], time.clock_gettime(self._cpu_clock)
        return self._stillness.look((id(job), used_s), time.monotonic())

    def doing(self) -> str:
        """What the job in progress does, and in which file: the innermost path that its functions have at hand."""
        job = self.jobs[0]
        frame = sys._current_frames().get(self._thread.ident or 0)
        while frame is not None:
            for value in list(frame.f_locals.values()):
                if isinstance(value, PurePath):
                    return f"{job.doing} {value}"
            frame = frame.f_back
        return f"{job.doing} {job.at or ''}".strip()

    def leave(self, error: Exception) -> None:
        """Answer all jobs with this error; the thread ends when it comes back."""
        self._left = True
        for job in self.jobs:
            if not job.outcome.done():
                job.outcome.set_exception(error)

    def _work(self) -> None:
        while not self._left:
            job = self._queue.get()
            try:
                result, error = job.work(), None
            except BaseException as raised:
                result, error = None, raised
            with contextlib.suppress(RuntimeError):  # the loop is closed: no one is waiting any more
                job.loop.call_soon_threadsafe(self._done, job, result, error)

    def _done(self, job: _Job, result: Any, error: BaseException | None) -> None:
        self.jobs.remove(job)
        self._came_back(self)
        if not job.outcome.done():
            if error is None:
                job.outcome.set_result(result)
            else:
                job.outcome.set_exception(error)
        elif error is None and job.late is not None:
            threading.Thread(target=job.late, args=(result,), name="fffo-late", daemon=True).start()

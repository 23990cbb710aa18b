"""Work that takes long, in a process of its own: the commands of the command line, with progress and cancel.

What a page asks for is what somebody would type. A job tells the line, its output as it comes, how far it is, and how
it ended; one job runs at a time, because all of them want both the drive and the processor.
"""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any, Literal

from ..directories import as_typed
from ..documents import DocumentError
from ..workflows.progress import ANSWERS, CHECK_MARK, LINE_MARK, LINES_ENVIRONMENT, QUESTION_MARK

State = Literal["running", "done", "failed", "cancelled"]
KEPT_LINES = 200
COLUMNS = 110  # of the output, as the page shows it
NICE = 10  # as `nice` has it: a loop without real-time priority has nine times the weight (1024 to 110)
GRACE_S = 20.0  # from the interrupt, on which a run brakes to standstill, to the end of the process


class BusyError(Exception):
    """Another job runs."""


class Job:
    """One command, from its start to its end."""

    def __init__(
        self, number: int, action: str, title: str, words: Sequence[str], out: Path | None, gives_way: bool = False
    ) -> None:
        """`words`: what is typed after `fffo-drive`. `out`: where its page is written, or the file that it writes.

        `gives_way`: it only computes, and is to disturb no loop on this machine.
        """
        self.number, self.action, self.title = number, action, title
        self.words, self.out = tuple(words), out
        self.state: State = "running"
        self.share: float | None = None
        self.step = ""
        self.lines: deque[str] = deque(maxlen=KEPT_LINES)
        self.checks: list[dict[str, Any]] = []  # of a commissioning, as they come, each with its picture's columns
        self.question: dict[str, Any] | None = None  # before a motion: {number, checks, text}, until it is answered
        self._questions = 0
        self.began_s = time.time()
        self.ended_s: float | None = None
        self.exit_code: int | None = None
        self._cancelled = False
        self._answering = threading.Lock()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "fffo_drive", *self.words], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True, errors="replace", start_new_session=True,
            env=os.environ | {LINES_ENVIRONMENT: "1", "COLUMNS": str(COLUMNS)},
        )  # fmt: skip
        if gives_way:
            give_way(self.process.pid)

    def follow(self, ended: Callable[[Job], None]) -> None:
        """Read until the process ends; on a thread of its own."""
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        assert self.process.stdin is not None
        streams = (self.process.stdout, self.process.stderr)
        readers = [threading.Thread(target=self._read, args=(stream,), daemon=True) for stream in streams]
        for reader in readers:
            reader.start()
        for reader in readers:
            reader.join()
        self.exit_code = self.process.wait()
        self.question = None
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        self.ended_s = time.time()
        self.state = "cancelled" if self._cancelled else "done" if self.exit_code == 0 else "failed"
        ended(self)

    def _read(self, stream: IO[str]) -> None:
        with stream:
            for line in stream:
                if line.startswith(CHECK_MARK):
                    self.checks.append(json.loads(line[len(CHECK_MARK) :]))
                elif line.startswith(QUESTION_MARK):
                    self._questions += 1
                    self.question = {"number": self._questions, **json.loads(line[len(QUESTION_MARK) :])}
                elif line.startswith(LINE_MARK):
                    progress = json.loads(line[len(LINE_MARK) :])
                    self.share, self.step = progress["share"], progress["text"]
                else:
                    self.lines.append(line.rstrip("\n"))

    def answer(self, number: Any, answer: Any) -> dict[str, Any]:
        """Answer the question of this number, which is returned. Raises DocumentError for one that is not open."""
        with self._answering:
            question = self.question
            if question is None or question["number"] != number:
                raise DocumentError("this question is not open any more: nothing was answered")
            if answer not in ANSWERS:
                raise DocumentError(f"an answer is one of {', '.join(ANSWERS)}")
            assert self.process.stdin is not None
            self.question = None
            with contextlib.suppress(OSError):  # it has just ended
                self.process.stdin.write(f"{answer}\n")
                self.process.stdin.flush()
        return question

    def cancel(self) -> None:
        """Interrupt it as Ctrl-C does: a run brakes to standstill first. What does not end in GRACE_S is terminated."""
        if self.state != "running":
            return
        self._cancelled = True
        self.process.send_signal(signal.SIGINT)
        late = threading.Timer(GRACE_S, self._terminate)
        late.daemon = True
        late.start()

    def _terminate(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()

    def as_object(self) -> dict[str, Any]:
        """For the page."""
        return {
            "number": self.number, "action": self.action, "title": self.title, "state": self.state,
            "line": shlex.join(["fffo-drive", *map(as_typed, self.words)]), "share": self.share, "step": self.step,
            "output": list(self.lines), "seconds": round((self.ended_s or time.time()) - self.began_s, 1),
            "exit_code": self.exit_code, "checks": len(self.checks), "question": self.question,
        }  # fmt: skip


class Jobs:
    """All jobs of a workbench; one runs at a time."""

    def __init__(self) -> None:
        self._jobs: list[Job] = []
        self._lock = threading.Lock()

    def start(
        self, action: str, title: str, words: Sequence[str], out: Path | None, ended: Callable[[Job], None],
        gives_way: bool = False,
    ) -> Job:  # fmt: skip
        """Start a command. `ended` is called on the job's thread. Raises BusyError while another one runs."""
        with self._lock:
            running = self.running
            if running is not None:
                raise BusyError(f"{running.title} is running: wait for it, or cancel it")
            job = Job(len(self._jobs) + 1, action, title, words, out, gives_way)
            self._jobs.append(job)
        threading.Thread(target=job.follow, args=(ended,), daemon=True).start()
        return job

    @property
    def running(self) -> Job | None:
        """The job that runs."""
        return next((job for job in self._jobs if job.state == "running"), None)

    def all(self) -> list[Job]:
        """The newest first."""
        return list(reversed(self._jobs))

    def checks(self, wanted: str) -> list[dict[str, Any]]:
        """Of JOB/FROM, the checks from that one on. Raises DocumentError for no such job."""
        number, _, first = wanted.partition("/")
        job = next((job for job in self._jobs if str(job.number) == number), None)
        if job is None or not first.isdecimal():
            raise DocumentError(f"no checks of job {wanted}")
        return job.checks[int(first) :]

    def close(self) -> None:
        """Cancel what runs, and wait for it."""
        job = self.running
        if job is not None:
            job.cancel()
            job.process.wait(GRACE_S + 5.0)


def give_way(pid: int) -> None:
    """A small share of the processors, no preemption of others; the disk's scheduler follows the nice value.

    For a process that has just begun: the threads that it starts from now on have it from it.
    """
    with contextlib.suppress(ProcessLookupError):  # it has ended already
        os.setpriority(os.PRIO_PROCESS, pid, NICE)
        os.sched_setscheduler(pid, os.SCHED_BATCH, os.sched_param(0))

"""Progress of a workflow: the caller supplies a bar, or nothing."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

LINES_ENVIRONMENT = "FFFO_DRIVE_PROGRESS_LINES"  # set: progress goes to stderr as lines, for a program that reads it
LINE_MARK = "::progress "  # before a JSON object {share, text}
QUESTION_MARK = "::question "  # before a JSON object {checks, text} of a motion; a line of ANSWERS is read from stdin
ANSWERS = ("yes", "all", "no")  # all: this one, and the rest without asking
CHECK_MARK = "::check "  # before a JSON object: a check of commissioning, with columns of the motion before it


class Share(Protocol):
    """Gets the share done, 0 to 1, and what is being done."""

    def __call__(self, share: float, step: str = "", /) -> None: ...


Bar = Callable[[str], AbstractContextManager[Share | None]]  # of the text beside it


def no_bar(_text: str) -> AbstractContextManager[Share | None]:
    """No progress is shown."""
    return nullcontext(None)

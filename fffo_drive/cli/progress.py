"""A progress bar on stderr, or nothing."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Iterator

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from ..workflows.progress import LINE_MARK, LINES_ENVIRONMENT, Share

QUIET_S = 10.0  # between two lines where there is no terminal
UNBOUNDED_COLUMNS = 10_000  # of a pipe or a file: no cell of a table is cut there, and no line is broken


def table_console(stderr: bool = False) -> Console:
    """A console for tables, which keep all their digits where it is no terminal and COLUMNS sets no width."""
    console = Console(stderr=stderr)
    bounded = console.is_terminal or "COLUMNS" in os.environ
    return console if bounded else Console(stderr=stderr, width=UNBOUNDED_COLUMNS)


@contextlib.contextmanager
def progress_bar(text: str, quiet: bool = False) -> Iterator[Share | None]:
    """Gives a function that takes the share done (0 to 1) and what is being done; None when `quiet`."""
    if os.environ.get(LINES_ENVIRONMENT):
        _line(text, 0.0)
        yield lambda share, step="": _line(_with_step(text, step), share)
        _line(text, 1.0)
        return
    if quiet:
        yield None
        return
    console = Console(stderr=True)
    if not console.is_terminal:  # a log file, say: rich would print nothing before the end
        yield _Spoken(text).tell
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=False) as progress:
        task = progress.add_task(text, total=1.0)
        yield lambda share, step="": progress.update(task, completed=share, description=_with_step(text, step))
        progress.update(task, completed=1.0, description=text)


def _with_step(text: str, step: str) -> str:
    return f"{text}: {step}" if step else text


class _Spoken:
    """Progress as lines on stderr, at least `QUIET_S` apart."""

    def __init__(self, text: str) -> None:
        self.text, self.next_s = text, time.monotonic() + QUIET_S

    def tell(self, share: float, step: str = "", /) -> None:
        """Print the share done, unless a line was printed less than `QUIET_S` ago."""
        if time.monotonic() >= self.next_s:
            self.next_s = time.monotonic() + QUIET_S
            print(f"{_with_step(self.text, step)}: {100.0 * share:.0f} % done", file=sys.stderr, flush=True)


def _line(text: str, share: float) -> None:
    """For a program that started this one: a line that it takes out of what is said."""
    print(LINE_MARK + json.dumps({"share": round(share, 3), "text": text}), file=sys.stderr, flush=True)

"""A progress bar on stderr, or nothing."""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterator
from functools import partial

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from ..workflows.progress import LINE_MARK, LINES_ENVIRONMENT


@contextlib.contextmanager
def progress_bar(text: str, quiet: bool = False) -> Iterator[Callable[[float], None] | None]:
    """Gives a function that takes the share done (0 to 1); None when `quiet`."""
    if os.environ.get(LINES_ENVIRONMENT):
        _line(text, 0.0)
        yield partial(_line, text)
        _line(text, 1.0)
        return
    if quiet:
        yield None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=False) as progress:
        task = progress.add_task(text, total=1.0)
        yield lambda share: progress.update(task, completed=share)
        progress.update(task, completed=1.0)


def _line(text: str, share: float) -> None:
    """For a program that started this one: a line that it takes out of what is said."""
    print(LINE_MARK + json.dumps({"share": round(share, 3), "text": text}), file=sys.stderr, flush=True)

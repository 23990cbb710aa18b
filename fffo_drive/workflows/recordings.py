"""Shared by the subcommands that record: recorder errors at once on stderr, and the rows of a run's files."""

from __future__ import annotations

import errno
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ..recording.events import Event, Level
from ..recording.reader import read_run
from ..recording.rotation import is_taken
from ..recording.settings import RecorderHooks, Rows
from ..signals import ROW


def claim(out: Path) -> None:
    """Make the directory of a recording and check that its name is free, before anything else. Raises OSError."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(error.errno, f"no directory for recordings: {error.strerror}", str(out.parent)) from error
    if is_taken(out):
        raise FileExistsError(
            errno.EEXIST, "a recording of this name exists and is not overwritten: give another name", str(out)
        )


def recorder_hooks() -> RecorderHooks:
    """Hooks of a recorder that print errors on stderr when they happen, not only at the end."""
    return RecorderHooks(on_event=_tell)


def _tell(event: Event) -> None:
    if event.level >= Level.WARNING:
        print(f"recorder: {event.text}", file=sys.stderr, flush=True)


def recorded_rows(files: Iterable[Path]) -> Rows:
    """Rows of the files of one run, incomplete ones included; files that a quota has deleted are skipped."""
    parts = [read_run(file).rows for file in files if file.exists()]
    return np.concatenate(parts) if parts else np.zeros(0, ROW)

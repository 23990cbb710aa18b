"""Shared by the subcommands that record: recorder errors at once on stderr, and the rows of a run's files."""

from __future__ import annotations

import errno
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ..config.axis import AxisFile
from ..recording.disk import DiskLife, disk_life, row_bytes
from ..recording.events import Event, Level
from ..recording.reader import RowBlocks, groups
from ..recording.rotation import SERVICE, OfOneWriter, disk_use, is_taken
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


def expected_disk_life(axis: AxisFile, directory: Path) -> DiskLife:
    """How long the disk of a directory lasts if the service records there all day. Raises OSError."""
    section = axis.recording
    written = OfOneWriter({"axis": axis.name, "source": SERVICE}).in_directory(directory)
    use = disk_use(directory, sum(one.size_bytes for one in written))
    bytes_per_s = row_bytes(section.compression) * axis.loop.rate_hz
    return disk_life(bytes_per_s, use, section.quota_bytes)


def recorded_blocks(files: Iterable[Path]) -> Iterator[Rows]:
    """Rows of the files of one run, incomplete ones included, block by block; files that a quota has deleted are
    skipped.
    """
    for file in files:
        if file.exists():
            for rows, _ in groups(RowBlocks(file)):
                yield rows


def recorded_rows(files: Iterable[Path]) -> Rows:
    """All of them together."""
    blocks = list(recorded_blocks(files))
    return np.concatenate(blocks) if blocks else np.zeros(0, ROW)

"""Long runs: names of a run's files, and room for new ones made by deleting the oldest.

What a recorder may delete is what a recorder like it wrote: recordings of the same axis and the same kind of program
(`source` in their metadata: a service's, not those of single runs), finished, and under one name only. A recording that
somebody gave a second name (a hard link, as `run --served` does) is kept and not counted.
"""

from __future__ import annotations

import contextlib
import glob
import shutil
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import NamedTuple

from .container import MAGIC
from .disk import DiskUse
from .errors import RecordingError
from .reader import read_metadata
from .writer import PART_SUFFIX

SUFFIX = ".mcap"
CONTINUES = "continues"  # in the metadata of a rotated file: the first file of its run
FINISHED = f"*{SUFFIX}"
UNFINISHED = FINISHED + PART_SUFFIX
_OWN_LIBRARY = b"fffo-drive/"
SERVICE = "daemon"  # `source` in the metadata of what a service records
OF_ONE_WRITER = ("axis", "source")  # metadata that recordings of one service share


class QuotaReport(NamedTuple):
    """Result of `enforce_quota`."""

    deleted: tuple[Path, ...]
    total_bytes: int  # of what is left
    within: bool


def segment_path(path: Path, number: int) -> Path:
    """File `number` of a run: NAME.mcap, NAME_002.mcap, ...; `segment_order` puts them in this order."""
    return path if number <= 1 else path.with_name(f"{path.stem}_{number:03d}{path.suffix}")


def run_name(path: Path) -> str:
    """NAME of NAME.mcap and NAME.mcap.part."""
    return path.name.removesuffix(PART_SUFFIX).removesuffix(SUFFIX)


def segment_order(path: Path) -> tuple[str, int]:
    """Sort key of recordings, finished or not: name of the run, number of the file in it."""
    name = run_name(path)
    run, _, number = name.rpartition("_")
    return (run, int(number)) if run and number.isdecimal() else (name, 1)


def later_segments(path: Path) -> list[Path]:
    """Files beside a recording with the names of its continuations, finished or being written, in their order."""
    name = run_name(path)
    found = (other for other in path.parent.glob(f"{glob.escape(name)}_[0-9]*{SUFFIX}*") if other.is_file())
    named = (other for other in found if other.name.endswith((SUFFIX, SUFFIX + PART_SUFFIX)))
    return sorted((other for other in named if segment_order(other)[0] == name), key=segment_order)


def is_taken(path: Path) -> bool:
    """True when a recording of this name is there, finished or not."""
    return path.exists() or path.with_name(path.name + PART_SUFFIX).exists()


class Written(NamedTuple):
    """A recording in a directory."""

    path: Path
    size_bytes: int
    written_ns: int  # when it was changed last
    finished: bool


class OfOneWriter:
    """The recordings of one writer in a directory, by their metadata; each file's is read once."""

    def __init__(self, metadata: Mapping[str, str]) -> None:
        """`metadata`: of a recording of this writer."""
        self._wanted = [metadata.get(name) for name in OF_ONE_WRITER]
        self._known: dict[tuple[str, int], bool] = {}  # by name and inode

    def in_directory(self, directory: Path) -> list[Written]:
        """What it wrote there, oldest first. Raises OSError when the directory cannot be read."""
        found = []
        for path in (*directory.glob(FINISHED), *directory.glob(UNFINISHED)):
            with contextlib.suppress(OSError, RecordingError):
                status = path.stat()
                if path.is_file() and status.st_nlink == 1 and self._is_of(path, status.st_ino):
                    found.append(Written(path, status.st_size, status.st_mtime_ns, path.match(FINISHED)))
        return sorted(found, key=lambda one: (one.written_ns, segment_order(one.path)))

    def _is_of(self, path: Path, inode: int) -> bool:
        key = (path.name, inode)
        if key not in self._known:
            found = is_own(path) and read_metadata(path)
            self._known[key] = found is not False and [found.get(name) for name in OF_ONE_WRITER] == self._wanted
        return self._known[key]


def enforce_quota(directory: Path, quota_bytes: float, writer: OfOneWriter, keep: Collection[Path] = ()) -> QuotaReport:
    """Delete the oldest finished recordings of a writer until those in the directory have at most `quota_bytes`.

    Unfinished files and those in `keep` are counted and never deleted, others are neither. Raises OSError when the
    directory cannot be read. A file that cannot be deleted is left and counted.
    """
    kept = {path.name for path in keep}
    written = writer.in_directory(directory)
    total = sum(one.size_bytes for one in written)
    deleted = []
    for one in written:
        if total <= quota_bytes:
            break
        if one.finished and one.path.name not in kept:
            with contextlib.suppress(OSError):
                one.path.unlink()
                total -= one.size_bytes
                deleted.append(one.path)
    return QuotaReport(tuple(deleted), total, total <= quota_bytes)


def disk_use(directory: Path, own_bytes: int) -> DiskUse:
    """Free space of the disk of a directory, which need not exist yet. Raises OSError."""
    there = next(place for place in (directory, *directory.absolute().parents) if place.exists())
    return DiskUse(shutil.disk_usage(there).free, own_bytes)


def is_own(path: Path) -> bool:
    """True for a recording that this program wrote (the library field of the MCAP header)."""
    with path.open("rb") as file:
        head = file.read(64)
    return head.startswith(MAGIC) and _OWN_LIBRARY in head

"""Long runs: names of a run's files, and room for new ones made by deleting the oldest."""

from __future__ import annotations

import contextlib
import glob
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from .container import MAGIC
from .writer import PART_SUFFIX

SUFFIX = ".mcap"
FINISHED = f"*{SUFFIX}"
UNFINISHED = FINISHED + PART_SUFFIX
_OWN_LIBRARY = b"fffo-drive/"


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


def enforce_quota(directory: Path, quota_bytes: int, keep: Collection[Path] = ()) -> QuotaReport:
    """Delete the oldest finished recordings until the directory's recordings have at most `quota_bytes`.

    Files that another program wrote, unfinished files and those in `keep` are never deleted; unfinished ones
    are counted. Raises OSError when the directory cannot be read. A file that cannot be deleted is left and
    counted.
    """
    kept = {path.name for path in keep}
    finished: list[tuple[int, tuple[str, int], int, Path]] = []
    total = 0
    for path in (*directory.glob(FINISHED), *directory.glob(UNFINISHED)):
        with contextlib.suppress(OSError):
            status = path.stat()
            if not path.is_file() or not is_own(path):
                continue
            total += status.st_size
            if path.match(FINISHED) and path.name not in kept:
                finished.append((status.st_mtime_ns, segment_order(path), status.st_size, path))
    deleted = []
    for _, _, size, path in sorted(finished):
        if total <= quota_bytes:
            break
        with contextlib.suppress(OSError):
            path.unlink()
            total -= size
            deleted.append(path)
    return QuotaReport(tuple(deleted), total, total <= quota_bytes)


def is_own(path: Path) -> bool:
    """True for a recording that this program wrote (the library field of the MCAP header)."""
    with path.open("rb") as file:
        head = file.read(64)
    return head.startswith(MAGIC) and _OWN_LIBRARY in head

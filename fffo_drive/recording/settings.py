"""Settings of a recording: file headers, rotation, and the recorder's interface to its environment."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from .events import Event

CHUNK_SIZE = 256 * 1024  # bytes

Rows = np.ndarray[Any, np.dtype[np.void]]
Attachments = Sequence[tuple[str, str, bytes]]  # name, media type, content
Compression = Literal["zstd", "none"]


class BinaryFile(Protocol):
    """Required interface of a file: unbuffered, so that `write` may write less than it was given."""

    def write(self, data: Any, /) -> int | None: ...
    def seek(self, offset: int, /) -> int: ...
    def truncate(self, size: int, /) -> int: ...
    def fileno(self) -> int: ...
    def close(self) -> None: ...


Opener = Callable[[Path], BinaryFile]


def open_new(path: Path) -> BinaryFile:
    """Create a file that must not be there yet, unbuffered."""
    return io.FileIO(path, "xb")


@dataclass(frozen=True)
class RunHeader:
    """Header of every file of a run."""

    metadata: Mapping[str, str] = field(default_factory=dict)
    attachments: Attachments = ()
    time_offset_ns: int = 0  # wall clock minus the clock of deadline_ns


@dataclass(frozen=True)
class RotationPolicy:
    """When to begin a new file, and how much a directory may hold. None: no limit.

    A file may exceed `max_bytes` by `recorder.WRITE_ROWS` rows and its index. `quota_bytes` counts the recordings of
    this writer in the directory (rotation.OfOneWriter), the one being written included; the oldest finished ones are
    deleted.
    """

    max_bytes: int | None = None
    max_duration_s: float | None = None
    quota_bytes: int | None = None

    def __post_init__(self) -> None:
        for name in ("max_bytes", "max_duration_s", "quota_bytes"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ValueError(f"{name} = {value}: a positive number, or nothing for no limit")


@dataclass(frozen=True)
class RecorderSettings:
    """Settings of the recorder."""

    drain_interval_s: float = 0.05
    flush_interval_s: float = 1.0
    retry_interval_s: float = 5.0  # between attempts to open a file after an error
    quota_interval_s: float = 30.0  # between looks at the directory's size and the disk's free space
    fsync_interval_s: float | None = None  # bounds what a power loss costs; None leaves it to the kernel
    chunk_size: int = CHUNK_SIZE
    compression: Compression = "zstd"
    rotation: RotationPolicy = field(default_factory=RotationPolicy)
    cpus: frozenset[int] | None = None  # where the thread may run; None: where its starter may


@dataclass(frozen=True)
class RecorderHooks:
    """Environment of the recorder. The `on_` hooks run on its thread; exceptions in them are only counted."""

    clock_ns: Callable[[], int] = time.monotonic_ns  # the clock of deadline_ns
    opener: Opener = open_new
    on_event: Callable[[Event], None] | None = None  # the recorder's own events
    on_rows: Callable[[Rows], None] | None = None  # every batch, for the live view


class RecorderStatistics(NamedTuple):
    """Counts since the recorder was made. Rows in all = written + pending + dropped + lost + undrained."""

    rows_written: int  # in files
    rows_pending: int  # in the chunk that is being filled
    rows_dropped: int  # drained, but the disk did not take them
    rows_lost: int  # overwritten in the ring before they were drained
    events_written: int
    events_lost: int
    write_errors: int
    hook_errors: int
    last_error: str
    files: tuple[Path, ...]  # finished, and left behind as .part
    bytes_written: int

"""Where a store and the runs are: a directory, or a bucket of an object store, behind one small interface (fsspec)."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import time
import uuid
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import fsspec

from ..documents import DocumentError
from ..extras import needs_extra

UNFINISHED = ".tmp"  # end of the name of a file that is being written
FORGOTTEN_S = 86_400.0  # an unfinished file that is older belongs to nobody


def is_url(place: str) -> bool:
    """Whether it names a place behind a protocol, `s3://bucket/prefix`; else it is a path."""
    return "://" in place


def open_filesystem(place: str) -> tuple[Any, str]:
    """The file system of a place, and its path there. Raises DocumentError for a protocol that is not installed."""
    if not is_url(place):
        return fsspec.filesystem("file"), str(Path(place).resolve())
    options = {} if place.startswith("file:") else {"use_listings_cache": False}  # others write there, too
    try:
        filesystem, path = fsspec.core.url_to_fs(place, **options)
    except (ImportError, ValueError) as error:
        raise DocumentError(f"{place}: {error}; {needs_extra('S3', 'fleet')}") from None
    return filesystem, path


class StorePlace:
    """A directory or a prefix with files by their names relative to it. Files appear whole, or not at all."""

    def __init__(self, place: str) -> None:
        """Nothing is touched."""
        self.filesystem, self._root = open_filesystem(place)
        self.address = place if is_url(place) else self._root
        self.is_local = "file" in _protocols(self.filesystem)

    def full(self, name: str) -> str:
        """The path of a file as the file system has it."""
        return f"{self._root}/{name}"

    def write(self, name: str, data: bytes) -> None:
        """A file, whole, over one that is there. Raises OSError, and then leaves nothing of it."""
        if not self.is_local:
            self.filesystem.pipe_file(self.full(name), data)  # an object store shows an object when it has all of it
            return
        path = Path(self.full(name))
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_name(f".{path.name}.{uuid.uuid4().hex}{UNFINISHED}")
        try:
            with unfinished.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            unfinished.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                unfinished.unlink(missing_ok=True)
            raise

    def read(self, name: str) -> bytes:
        """A file. Raises FileNotFoundError, OSError."""
        return bytes(self.filesystem.cat_file(self.full(name)))

    def exists(self, name: str) -> bool:
        """Whether there is such a file."""
        return bool(self.filesystem.exists(self.full(name)))

    def files(self, folder: str, suffix: str) -> dict[str, int]:
        """Files in a folder and below, by name, with their sizes; in order."""
        root = self._root.rstrip("/") + "/"
        try:
            found = self.filesystem.find(self.full(folder), detail=True)
        except FileNotFoundError:
            return {}
        names = {path.removeprefix(root): int(info.get("size") or 0) for path, info in found.items()}
        return {name: names[name] for name in sorted(names) if name.endswith(suffix)}

    def delete(self, names: Iterable[str]) -> None:
        """Files; one that is gone already is no error."""
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                self.filesystem.rm_file(self.full(name))

    def sweep(self) -> None:
        """Remove what writers that died left unfinished."""
        if not self.is_local:
            return
        for path in Path(self._root).rglob(f".*{UNFINISHED}"):
            with contextlib.suppress(FileNotFoundError):
                if time.time() - path.stat().st_mtime > FORGOTTEN_S:
                    path.unlink()


def _protocols(filesystem: Any) -> tuple[str, ...]:
    protocols = filesystem.protocol
    return (protocols,) if isinstance(protocols, str) else tuple(protocols)


@contextlib.contextmanager
def local_copy(place: str) -> Iterator[Path]:
    """The file as one on this machine: itself, or a copy that is removed. Raises OSError."""
    if not is_url(place):
        yield Path(place)
        return
    filesystem, path = open_filesystem(place)
    with tempfile.TemporaryDirectory(prefix="fffo_drive_fleet_") as directory:
        copy = Path(directory) / Path(path).name
        filesystem.get_file(path, str(copy))
        yield copy


def digest_of(path: Path) -> str:
    """SHA-256 of a file, hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

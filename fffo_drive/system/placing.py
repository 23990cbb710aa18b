"""Put files in place under a root directory and take them away again; what somebody has edited is left alone.

A manifest beside the configuration says which files were put there, with their digests, and which directories made.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from .service_files import MANIFEST, UNIT, UNITS, ServiceFile, digest_of

INSTALLED, UPDATED, UNCHANGED, KEPT, REMOVED = "installed", "updated", "unchanged", "kept", "removed"


class PlacedFiles(NamedTuple):
    """What became of one file or link. `path` is relative to the root directory."""

    path: str
    action: str  # INSTALLED, UPDATED, UNCHANGED, KEPT or REMOVED


class Manifest(NamedTuple):
    """What an earlier installation left."""

    files: dict[str, str]  # path -> SHA-256
    directories: list[str]


def read_manifest(root: Path) -> Manifest:
    """The manifest; an empty one when nothing is installed. Raises ValueError for one that is broken."""
    path = root / MANIFEST
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return Manifest(dict(found["files"]), list(found["directories"]))
    except FileNotFoundError:
        return Manifest({}, [])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: not a manifest of fffo-drive install ({error}); delete it to start anew") from error


def place_files(root: Path, files: Sequence[ServiceFile]) -> list[PlacedFiles]:
    """Write all files. One that is there and is not what an earlier installation wrote is kept as it is.

    Files of an earlier installation that are no longer among these are removed.
    """
    before = read_manifest(root)
    directories = list(before.directories)
    outcomes, digests = [], {}
    for file in files:
        action = _action(root / file.path, file, before.files.get(file.path))
        if action in (INSTALLED, UPDATED):
            _write(root, file.path, file.content, directories)
        if action != KEPT:
            digests[file.path] = file.digest
        elif file.path in before.files:
            digests[file.path] = before.files[file.path]  # edited: still known as ours, so that it is named again
        outcomes.append(PlacedFiles(file.path, action))
    gone = {path: digest for path, digest in before.files.items() if path not in {file.path for file in files}}
    outcomes += [_remove(root, path, digest) for path, digest in gone.items()]
    text = json.dumps({"files": digests, "directories": directories}, indent=2) + "\n"
    _write(root, MANIFEST, text.encode(), directories)
    return outcomes


def remove_files(root: Path) -> list[PlacedFiles]:
    """Take away what was put in place and not edited since, links that enable the service, and empty directories."""
    manifest = read_manifest(root)
    outcomes = [PlacedFiles(path, REMOVED) for path in enabling_links(root)]
    for outcome in outcomes:
        (root / outcome.path).unlink()
        _remove_if_empty((root / outcome.path).parent)
    outcomes += [_remove(root, path, digest) for path, digest in manifest.files.items()]
    (root / MANIFEST).unlink(missing_ok=True)
    for directory in reversed(manifest.directories):
        _remove_if_empty(root / directory)
    return outcomes


def enabling_links(root: Path) -> list[str]:
    """Links that `systemctl enable` made for instances of the service."""
    name, suffix = UNIT.split("@")
    found = (root / UNITS).glob(f"*.wants/{name}@*{suffix}")
    return sorted(str(path.relative_to(root)) for path in found if path.is_symlink())


def _action(path: Path, file: ServiceFile, installed: str | None) -> str:
    try:
        present = digest_of(path.read_bytes())
    except FileNotFoundError:
        return INSTALLED
    if present == file.digest:
        return UNCHANGED
    return UPDATED if present == installed else KEPT


def _write(root: Path, path: str, content: bytes, directories: list[str]) -> None:
    """Whole or not at all; directories that have to be made are added to `directories`."""
    target = root / path
    for directory in reversed(Path(path).parents):
        if not (root / directory).is_dir():
            (root / directory).mkdir()
            directories.append(str(directory))
    temporary = target.with_name(target.name + ".part")
    temporary.write_bytes(content)
    temporary.chmod(0o644)
    os.replace(temporary, target)


def _remove(root: Path, path: str, digest: str) -> PlacedFiles:
    target = root / path
    try:
        if digest_of(target.read_bytes()) != digest:
            return PlacedFiles(path, KEPT)
        target.unlink()
    except FileNotFoundError:
        pass
    return PlacedFiles(path, REMOVED)


def _remove_if_empty(directory: Path) -> None:
    try:
        directory.rmdir()
    except OSError:
        return

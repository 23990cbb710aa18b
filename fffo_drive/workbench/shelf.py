"""What stands in the directory of a workbench: recordings, pages with their three words, models, axis files."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ..report.page import JSON_NAME, PAGE_NAME

RUNS = "runs"
FLEET = "fleet"  # directories of a fleet's reports, and ...
FLEET_DRIVES = "fleet_drives"  # ... of its drives, with a page of each beneath
RECORDINGS = (".mcap", ".csv", ".csv.gz", ".tsv", ".txt", ".mat")


def is_recording(path: Path) -> bool:
    """Whether a name is one that `identify` and `diagnose` take."""
    return path.name.endswith(RECORDINGS)


def recordings(directory: Path, given: tuple[Path, ...]) -> list[dict[str, Any]]:
    """Recordings given, and those under DIR/runs; the newest last."""
    here = _there(path for path in (directory / RUNS).glob("*") if is_recording(path))
    return [
        {"name": path.name, "path": str(path), "megabytes": round(status.st_size / 1e6, 2),
         "time": time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(status.st_mtime))}
        for path, status in (*_there(given), *sorted(here, key=lambda found: found[1].st_mtime))
    ]  # fmt: skip


def _there(paths: Iterable[Path]) -> list[tuple[Path, os.stat_result]]:
    """Files with their state, without those that are gone: what writes them renames and removes them meanwhile."""
    found = []
    for path in paths:
        with contextlib.suppress(OSError):
            found.append((path, path.stat()))
    return found


def pages(directory: Path) -> list[dict[str, Any]]:
    """Every report under the directory, the newest first: what it found, how sure, what to do, and where it is.

    Without those of a fleet's drives, whose models are not for this axis: the fleet's page has links to them.
    """
    own = (path for path in directory.glob(f"**/{JSON_NAME}") if not _is_of_a_drive(path.relative_to(directory)))
    found = sorted(((status.st_mtime_ns, path) for path, status in _there(own)), reverse=True)
    shown = []
    for time_ns, path in found:
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # being written, or none of ours
            shown.append(_page(directory, path, time_ns))
    return shown


def _is_of_a_drive(report: Path) -> bool:
    return report.parts[0].startswith(f"{FLEET_DRIVES}_") and len(report.parts) > 2


@lru_cache(maxsize=1000)
def _page(directory: Path, path: Path, time_ns: int) -> dict[str, Any]:
    """Read once for each time at which it was written. Raises OSError, ValueError, KeyError, TypeError."""
    content = json.loads(path.read_text(encoding="utf-8"))
    verdict = content["opening" if "opening" in content else "verdict"]
    page = path.with_name(PAGE_NAME)
    page.stat()
    model = path.with_name("model.yaml")
    return {
        "kind": content.get("kind", ""), "name": path.parent.relative_to(directory).as_posix(),
        "page": quote(page.relative_to(directory).as_posix(), errors="surrogateescape"),
        "model": str(model) if model.exists() else "",
        **{key: verdict[key] for key in ("headline", "finding", "confidence", "next_step", "alarm")},
        "time": time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(time_ns / 1e9)),
    }  # fmt: skip


def axis_files(directory: Path, first: Path | None) -> Iterator[Path]:
    """The axis file of the start, then those that `tune` and the circle wrote here."""
    if first is not None:
        yield first
        yield from sorted(directory.glob(f"tune_*/{first.name}"))
    yield from sorted(directory.glob("circle_*/axis.yaml"))


def next_free(directory: Path, stem: str) -> Path:
    """DIR/STEM_N with the first N that is not there yet."""
    number = 1
    while (directory / f"{stem}_{number}").exists():
        number += 1
    return directory / f"{stem}_{number}"

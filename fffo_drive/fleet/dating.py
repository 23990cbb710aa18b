"""When a run was, by its name or a manifest; of its own clock, `importing.times` tells whether it says a date.

After a copy all files are of today.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from ..documents import DocumentError, did_you_mean

CROWD_RUNS, CROWD_S = 8, 600.0  # so many runs of a drive that began within ten minutes: more likely copied than run
KNOWN = ("path", "serial", "model", "time", "temperature_degc")
_DATE = r"(?P<year>(?:19|20)\d\d)[-_.]?(?P<month>[01]\d)[-_.]?(?P<day>[0-3]\d)"
_TIME = r"(?:[T_ -]*(?P<hour>[0-2]\d)[-_:.hH]?(?P<minute>[0-5]\d)(?:[-_:.mM]?(?P<second>[0-5]\d))?)?"
_IN_NAME = re.compile(rf"(?<!\d){_DATE}{_TIME}(?!\d)")


class ManifestLine(NamedTuple):
    """What a manifest says of a run; None: nothing."""

    serial: str | None
    model: str | None
    start: datetime | None
    temperature_degc: float | None = None


def time_in_name(path: str) -> datetime:
    """The date, and the time of day if there is one, in a file's name (UTC). Raises DocumentError."""
    name = PurePosixPath(path).name
    found = _IN_NAME.search(name)
    try:
        if found is not None:
            return datetime(*(int(part or 0) for part in found.groups()), tzinfo=UTC)  # type: ignore[arg-type,misc]
    except ValueError:
        pass
    raise DocumentError(
        f"{path}: its name says no date (2026-01-31, 20260131, 2026-01-31_10h28m10 ...): without --time-from name, or "
        "with --manifest"
    )


def read_manifest(path: Path) -> dict[str, ManifestLine]:
    """Runs of a manifest by their path (relative to the manifest's directory) or URL: a CSV file with a heading of
    `path` and any of `serial`, `model`, `time` (ISO 8601; UTC where it says no zone) and `temperature_degc`.

    Raises DocumentError naming the line, OSError.
    """
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = csv.DictReader(file)
        names = [name.strip() for name in rows.fieldnames or ()]
        rows.fieldnames = names
        for name in names:
            if name not in KNOWN:
                raise DocumentError(f"{path}: line 1, column {name!r}: {did_you_mean(name, KNOWN)}")
        if "path" not in names:
            raise DocumentError(f"{path}: line 1: no column `path`; known are {', '.join(KNOWN)}")
        found: dict[str, ManifestLine] = {}
        for row in rows:
            place, said = _row(path, rows.line_num, row)
            if place in found:
                raise DocumentError(f"{path}: line {rows.line_num}: {place} stands in it twice")
            found[place] = said
    if not found:
        raise DocumentError(f"{path}: no run in it")
    return found


def _row(path: Path, line: int, row: Mapping[str, Any]) -> tuple[str, ManifestLine]:
    values = {name: (row.get(name) or "").strip() for name in KNOWN}
    if None in row:
        raise DocumentError(f"{path}: line {line}: more values than the heading has")
    if not values["path"]:
        raise DocumentError(f"{path}: line {line}: no path")
    place = values["path"] if "://" in values["path"] else str(path.parent / values["path"])
    start = None
    if values["time"]:
        try:
            start = datetime.fromisoformat(values["time"])
        except ValueError:
            raise DocumentError(
                f"{path}: line {line}, time {values['time']!r}: a date such as 2026-01-31T10:28:10 is needed"
            ) from None
        start = start if start.tzinfo else start.replace(tzinfo=UTC)
    degc = None
    if values["temperature_degc"]:
        try:
            degc = float(values["temperature_degc"])
        except ValueError:
            degc = math.nan
        if not math.isfinite(degc):
            said = values["temperature_degc"]
            raise DocumentError(f"{path}: line {line}, temperature_degc {said!r}: a number in degC is needed")
    return place, ManifestLine(values["serial"] or None, values["model"] or None, start, degc)


def crowds(starts: Iterable[tuple[str, datetime]]) -> list[str]:
    """Drives of which too many runs begin at about one time, one sentence each: (drive, start) of dated files."""
    by_drive: dict[str, list[datetime]] = {}
    for drive, start in starts:
        by_drive.setdefault(drive, []).append(start)
    spans = {drive: (max(times) - min(times)).total_seconds() for drive, times in by_drive.items()}
    return [
        f"{drive}: {len(times)} runs within {spans[drive]:.0f} s by the dates of their files; if these were copied, "
        "the history is wrong: give --time-from name or --manifest"
        for drive, times in sorted(by_drive.items())
        if len(times) >= CROWD_RUNS and spans[drive] < CROWD_S
    ]

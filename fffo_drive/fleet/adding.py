"""Runs on the index of a store: which drive they are of, when they ran, their content hash. Nothing is copied."""

from __future__ import annotations

import json
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from ..documents import DocumentError, check, parse
from ..identification.facts import DriveFacts
from ..importing.candidates import TIME_S
from ..importing.convert import DATE_FROM, DATE_OF_FILE, FACTS_NAME
from ..importing.log import read_log
from ..importing.read import RECORDINGS, SUFFIXES, read_source
from ..importing.times import clock_time
from ..recording.errors import RecordingError
from ..recording.reader import RunHead, read_head
from ..recording.writer import PART_SUFFIX
from .dating import ManifestLine, crowds, time_in_name
from .place import digest_of, is_url, local_copy, open_filesystem
from .store import FleetStore

FINISHED = RECORDINGS[0]  # what --from takes: others are being written, or torn
NAME, COLUMN = "name", "column"  # where a date is taken from
NO_NUMBER = ("", "0x00000000")


class NoLogError(RecordingError):
    """A file that holds no columns of numbers."""


class Given(NamedTuple):
    """What is said of runs beside what they say themselves; None: nothing."""

    drive: str | None = None
    model: str | None = None
    facts: DriveFacts | None = None
    start: datetime | None = None
    time_from: str | None = None  # NAME or COLUMN; None: the clock, else the file
    temperature_degc: float | None = None


class Added(NamedTuple):
    """What `add_runs` did."""

    found: int
    new: int
    runs: tuple[str, ...]  # content hashes of all that were named, known ones too
    problems: tuple[str, ...]  # one sentence a run that could not be added
    skipped: tuple[str, ...] = ()  # one sentence a file beside the runs that is no log
    cautions: tuple[str, ...] = ()  # one sentence a drive whose runs have the dates of a copy
    changed: int = 0  # runs that the index had with another drive, type, date or temperature


def runs_below(place: str, tables: bool) -> list[str]:
    """Finished recordings in a directory or below a URL's prefix, and with `tables` CSV and MAT files; sorted.

    Raises DocumentError where there are none.
    """
    suffixes = (FINISHED, *SUFFIXES) if tables else (FINISHED,)
    filesystem, root = open_filesystem(place)
    try:
        paths = filesystem.find(root)
    except FileNotFoundError:
        paths = []
    found = sorted(path for path in paths if path.lower().endswith(suffixes))
    if not found and not filesystem.exists(root):
        raise DocumentError(f"--from {place}: there is no such directory: check the path")
    if not found:
        raise DocumentError(f"--from {place}: no run there ({', '.join(suffixes)})")
    return [filesystem.unstrip_protocol(path) if is_url(place) else path for path in found]


def add_runs(
    store: FleetStore,
    places: Sequence[str],
    given: Given,
    progress: Callable[[float], None] | None = None,
    named: Container[str] | None = None,
    manifest: Mapping[str, ManifestLine] | None = None,
) -> Added:
    """Put runs (paths, URLs) on the index. A file that is on it already and has not changed is not read; what is now
    said of it (drive, type, date, temperature) replaces what the index and its record have.

    `manifest`: what is said of single runs, by their places. `named`: those that somebody named, None for all; a file
    beside them that is no log is skipped, and no problem.

    A recording that ended badly (`NAME.mcap.part`) and the finished file made of it (`NAME.mcap`) are one run: the
    finished one is taken, and what the index has of the other is dropped.
    What speaks against a run is reported and stops no other. Raises OSError where the store cannot be written.
    """
    known = {(entry["path"], entry["stamp"]): entry for entry in store.index().to_pylist()}
    changed_entries: list[dict[str, Any]] = []
    entries: list[dict[str, Any]] = []
    runs: list[str] = []
    problems: list[str] = []
    skipped: list[str] = []
    dated_by_file: list[tuple[str, datetime]] = []
    for number, place in enumerate(places):
        try:
            if _is_finished_beside(place):
                continue
            path, size, stamp, changed = _state_of(place)
            own = given if manifest is None or place not in manifest else _with(given, manifest[place])
            if (path, stamp) in known:
                entry = known[path, stamp]
                runs.append(entry["run"])
                said = _said_of(path, own)
                if any(entry[name] != value for name, value in said.items()):
                    changed_entries.append(entry | said)
                continue
            entry, by_file = _entry(path, own, changed)
            entries.append(entry | {"bytes": size, "stamp": stamp})
            if by_file:
                dated_by_file.append((entry["drive"], entry["start"]))
            runs.append(entry["run"])
        except NoLogError as error:
            (problems if named is None or place in named else skipped).append(str(error))
        except (RecordingError, DocumentError) as error:
            problems.append(str(error))
        except OSError as error:
            problems.append(f"{place}: {error.strerror or error}")
        finally:
            if progress is not None:
                progress((number + 1) / len(places))
    if changed_entries:
        store.change(changed_entries)
    fresh = store.add(entries)
    parts = {entry["path"]: entry["run"] for entry in store.index().to_pylist() if entry["path"].endswith(PART_SUFFIX)}
    torn = [parts[f"{entry['path']}{PART_SUFFIX}"] for entry in entries if f"{entry['path']}{PART_SUFFIX}" in parts]
    if torn:
        store.drop(torn)
    return Added(
        len(places),
        fresh,
        tuple(runs),
        tuple(problems),
        tuple(skipped),
        tuple(crowds(dated_by_file)),
        len(changed_entries),
    )


def _with(given: Given, said: ManifestLine) -> Given:
    degc = given.temperature_degc if said.temperature_degc is None else said.temperature_degc
    return given._replace(
        drive=said.serial or given.drive,
        model=said.model or given.model,
        start=said.start or given.start,
        temperature_degc=degc,
    )


def _said_of(path: str, given: Given) -> dict[str, Any]:
    """What is said of a run from outside. Raises DocumentError for a name without a date."""
    start = given.start or (time_in_name(path) if given.time_from == NAME else None)
    said = {"drive": given.drive, "model": given.model, "start": start, "temperature_degc": given.temperature_degc}
    return {name: value for name, value in said.items() if value is not None}


def entry_of(place: str, given: Given) -> dict[str, Any]:
    """One run as the index has it (`schema.INDEX_SCHEMA`). Raises DocumentError, RecordingError, OSError."""
    path, size, stamp, changed = _state_of(place)
    return _entry(path, given, changed)[0] | {"bytes": size, "stamp": stamp}


def _is_finished_beside(place: str) -> bool:
    """Whether a file is what was left of a recording of which there is a finished file."""
    if not place.endswith(PART_SUFFIX):
        return False
    filesystem, path = open_filesystem(place)
    return bool(filesystem.exists(path.removesuffix(PART_SUFFIX)))


def _state_of(place: str) -> tuple[str, int, str, datetime]:
    """Where a file is, its size, what changes when the file does, and when it was written."""
    path = place if is_url(place) else str(Path(place).resolve())
    filesystem, inner = open_filesystem(path)
    info = filesystem.info(inner)
    modified = info.get("LastModified") or info.get("mtime") or 0.0
    changed = modified if isinstance(modified, datetime) else datetime.fromtimestamp(float(modified), UTC)
    size = int(info.get("size") or 0)
    return path, size, f"{size} {changed.isoformat()} {info.get('ETag', '')}".strip(), changed


def _entry(path: str, given: Given, changed: datetime) -> tuple[dict[str, Any], bool]:
    """A run as the index has it, and whether its date is only that of a file."""
    facts = None if given.facts is None else json.dumps(given.facts.model_dump(exclude_defaults=True), sort_keys=True)
    said = _said_of(path, given)
    with local_copy(path) as copy:
        if copy.name.lower().endswith(RECORDINGS):
            head = read_head(copy)
            drive, model = _who(path, head, given)
            clock = None if head.start_ns is None else clock_time(head.start_ns // 1_000 / 1e6)
            by_file = clock is None or head.metadata.get(DATE_FROM) == DATE_OF_FILE
        else:
            if given.facts is None:
                raise DocumentError(f"{path}: a table carries no facts about its drive: give them with --drive FILE")
            try:
                read_source(copy, rows=False)
            except RecordingError as error:
                raise NoLogError(str(error).replace(str(copy), path)) from error
            drive, model = _of_facts(path, given.facts, given), given.model or given.facts.name
            clock = None if "start" in said else _clock_of(copy, given.facts)
            by_file = clock is None
        if given.time_from == COLUMN and by_file and "start" not in said:
            raise DocumentError(
                f"{path}: its time counts from a zero of its own, which says no date: use --time-from name, or "
                "--manifest"
            )
        entry = {
            "run": digest_of(copy), "drive": drive, "model": model or drive, "path": path, "start": clock or changed,
            "facts": facts, **said,
        }  # fmt: skip
        return entry, by_file and "start" not in said


def _clock_of(table: Path, facts: DriveFacts) -> datetime | None:
    """The start of a table whose clock is one of a calendar; one that cannot be read is told by who reads all of it."""
    try:
        return clock_time(float(read_log(table, facts.hints()).columns[TIME_S][0]))
    except RecordingError:
        return None


def _who(path: str, head: RunHead, given: Given) -> tuple[str, str]:
    """Drive and model of a recording, by what stands in front of its rows."""
    metadata = head.metadata
    attached = head.attachments.get(FACTS_NAME)
    if attached is not None and "axis" not in metadata:
        name = f"{path}, {FACTS_NAME}"
        data, lines = parse(attached.data.decode("utf-8", "replace"), name)
        declared = check(data, DriveFacts, name, lines)
        return _of_facts(path, declared, given), given.model or declared.name
    serial = metadata.get("drive_serial", "")
    # a simulated drive in process has neither maker nor number of its own: its axis is what is one and the same
    numbered = serial not in NO_NUMBER and metadata.get("drive_vendor", "") not in NO_NUMBER
    drive = given.drive or (serial if numbered else metadata.get("axis", ""))
    if not drive:
        raise DocumentError(f"{path}: does not say of which drive it is: give --serial NAME")
    words = metadata.get("drive", "")
    model = words.removesuffix(metadata.get("drive_software", "")).strip() or words
    return drive, given.model or model


def _of_facts(path: str, facts: DriveFacts, given: Given) -> str:
    drive = given.drive or facts.name
    if not drive:
        raise DocumentError(f"{path}: nothing says of which drive it is: give --serial NAME, or `name` in the facts")
    return drive


def facts_of(entry: dict[str, Any]) -> DriveFacts | None:
    """The facts that an entry of the index carries."""
    facts = entry.get("facts")
    return None if facts is None else DriveFacts.model_validate(json.loads(facts))


def all_places(named: Iterable[str], source: str | None, tables: bool) -> list[str]:
    """Runs that were named, and those of --from."""
    places = [*named, *(runs_below(source, tables) if source else [])]
    if not places:
        raise DocumentError("no run: name recordings, or a directory or bucket with --from")
    return places

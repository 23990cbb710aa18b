"""Drives that changed, by their raw files: a diagnosis of the runs before the change beside one of the runs since.

A record says that Coulomb friction or a ripple of order 12 grew. The raw files of the few drives that changed say what
the axis has now that its model lacks, and whether it had it before.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .. import formats
from ..diagnosis.results import Diagnosis, Finding
from ..documents import DocumentError, counted, did_you_mean
from ..identification.dataset import DataError
from ..identification.facts import DriveFacts
from ..identification.stretches import MOST_DIAGNOSED, load_logs
from ..recording.errors import RecordingError
from ..report.diagnose import base_rows
from ..report.diagnose_figures import words_of
from ..report.document import Cell, Heading, Line, Report, Row, Table, Verdict, number, of_linear_axis, provenance
from ..report.page import refuse_other_report
from ..workflows.diagnose import Diagnosed, diagnose, require_place, write_diagnosis
from ..workflows.progress import Bar, Share, no_bar
from ..workflows.recorded_facts import facts_for
from .adding import facts_of
from .history import history, models_of
from .store import FleetStore
from .watch import Alarm, Watched, alarm_text
from .work import UnreachedError, reached_file

KIND = "fleet-diagnosis"
HELD_OUT_EVERY = 4  # one run in so many proves what the others show
BEFORE, NOW = "before", "now"  # sides of a change


class Subject(NamedTuple):
    """A drive that is diagnosed, and the content hashes of the runs on each side of its change, oldest first."""

    model: str
    drive: str
    alarms: tuple[Alarm, ...]
    sides: Mapping[str, tuple[str, ...]]  # by BEFORE, NOW; a drive without a change has only NOW


class DiagnosedDrive(NamedTuple):
    """A drive with the diagnosis of each side that could be made."""

    subject: Subject
    found: Mapping[str, Diagnosed]


class FleetDiagnosis(NamedTuple):
    """All drives, and what could not be diagnosed, one sentence each."""

    drives: tuple[DiagnosedDrive, ...]
    problems: tuple[str, ...]


def subjects_of(
    store: FleetStore, changed: Mapping[str, Watched], serials: Sequence[str], most_runs: int
) -> list[Subject]:
    """The drives that changed (`changed`: by model), or those of these serial numbers, changed or not.

    Before: the last runs before the first of its changes may have begun. Now: the last runs of all, none of them from
    before the last change was complete. Raises DocumentError for a serial number without a record.
    """
    known = {(row["model"], row["drive"]) for row in store.drives().to_pylist()}
    names = sorted({drive for _, drive in known})
    for name in serials:
        if name not in names:
            raise DocumentError(f"--serial {name}: no record of it: {did_you_mean(name, names)}")
    found = []
    for model in models_of(store):
        alarms: dict[str, list[Alarm]] = {}
        for alarm in changed[model].alarms if model in changed else ():
            alarms.setdefault(alarm.drive, []).append(alarm)
        wanted = [name for name in serials if (model, name) in known] if serials else sorted(alarms)
        for drive in wanted:
            runs = [str(run) for run in history(store, drive, model).run]
            own = tuple(alarms.get(drive, ()))
            found.append(Subject(model, drive, own, _sides(runs, own, most_runs)))
    return found


def _sides(runs: Sequence[str], alarms: Sequence[Alarm], most_runs: int) -> dict[str, tuple[str, ...]]:
    if not alarms:
        return {NOW: tuple(runs[-most_runs:])}
    begin = min(runs.index(alarm.first_within[0]) for alarm in alarms)
    whole = max(runs.index(alarm.first_run) + max(alarm.ramp_runs, 1) - 1 for alarm in alarms)
    whole = min(whole, len(runs) - 2)  # a change that still grows: the last two runs show most of it
    return {BEFORE: tuple(runs[:begin][-most_runs:]), NOW: tuple(runs[max(whole, begin):][-most_runs:])}  # fmt: skip


def require_places(subjects: Sequence[Subject], out: Path) -> None:
    """Refuse to overwrite what is not from here, before anything is computed. Raises DocumentError."""
    refuse_other_report(out, KIND)
    for subject in subjects:
        for side in subject.sides:
            require_place(_place(subject, side, out))


def _place(subject: Subject, side: str, out: Path) -> Path:
    return out / file_name(subject.model) / file_name(subject.drive) / side


def diagnose_drives(store: FleetStore, subjects: Sequence[Subject], out: Path, bar: Bar = no_bar) -> FleetDiagnosis:
    """Diagnose each side of each drive into OUT/MODEL/DRIVE/SIDE. A file or a side with a problem stops no other."""
    entries = {entry["run"]: entry for entry in store.index().to_pylist()}
    drives, problems = [], []
    for subject in subjects:
        found = {}
        for side, runs in subject.sides.items():
            label = f"{subject.drive}, {side}"
            with contextlib.ExitStack() as kept:
                paths, facts = [], None
                for entry in (entries[run] for run in runs if run in entries):
                    try:
                        paths.append(reached_file(entry, kept))
                        facts = facts or facts_of(entry)
                    except (DataError, DocumentError, UnreachedError) as error:
                        problems.append(f"{label}: {error}")
                try:
                    with bar(label) as progress:
                        found[side] = _diagnosed(paths, facts, _place(subject, side, out), label, progress)
                except (DataError, DocumentError, RecordingError) as error:
                    problems.append(f"{label}: {error}")
        drives.append(DiagnosedDrive(subject, found))
    return FleetDiagnosis(tuple(drives), tuple(problems))


def file_name(text: str) -> str:
    """A serial number or model as the name of a directory."""
    return re.sub(r"[^\w.-]+", "_", text).strip(".") or "_"


def _diagnosed(
    paths: Sequence[Path], facts: DriveFacts | None, out: Path, label: str, progress: Share | None
) -> Diagnosed:
    """Diagnosis of some runs, oldest first, written to `out`. The newest is held out, and every fourth before it."""
    if not paths:
        raise DataError("there is no run to diagnose")
    facts = facts or facts_for(None, paths)
    records = load_logs(paths, facts, most=MOST_DIAGNOSED)
    held = set(range(len(records) - 1, 0, -HELD_OUT_EVERY))
    fit, held_out = ([one for k, one in enumerate(records) if (k in held) is part] for part in (False, True))
    found = diagnose(fit, held_out, facts, progress=progress)
    return write_diagnosis(found, fit, facts, paths, out, label)


# ---- the page


def fleet_diagnosis_report(found: FleetDiagnosis, store: str, directory: Path) -> Report:
    """The page: each drive's numbers and findings before and now."""
    report = Report(
        kind=KIND,
        title=f"Drives of {store.rstrip('/').rsplit('/', 1)[-1]}, before and now",
        subtitle="The raw runs before each change and those since, each diagnosed by itself.",
        verdict=_verdict(found),
        tables=tuple(_table(place, drive, directory) for place, drive in enumerate(found.drives, 1)),
        sections=(),
        provenance=provenance([], {"store": store}),
        results=as_object(found, directory),
    )
    units = {one.diagnosis.units for drive in found.drives for one in drive.found.values()}
    return of_linear_axis(report) if units == {"linear"} else report


def as_object(found: FleetDiagnosis, directory: Path) -> dict[str, Any]:
    """For programs."""
    return {
        "format": formats.FLEET_DIAGNOSIS.word,
        "drives": [
            {
                "model": subject.model, "drive": subject.drive,
                "alarms": [alarm._asdict() | {"text": alarm_text(alarm)} for alarm in subject.alarms],
                "sides": {
                    side: {
                        "runs": list(subject.sides[side]), "verdict": one.diagnosis.verdict,
                        "headline": one.diagnosis.headline, "report": str(one.report.relative_to(directory)),
                        "effects": [
                            {"name": f.name, "place": f.place, "strength_percent": f.strength_percent, "doubt": f.doubt}
                            for f in _accepted(one.diagnosis)
                        ],
                    }
                    for side, one in sides.items()
                },
            }
            for subject, sides in found.drives
        ],
        "problems": list(found.problems),
    }  # fmt: skip


def diagnosis_lines(found: FleetDiagnosis) -> Iterator[str]:
    """What `fleet diagnose` prints."""
    for subject, sides in found.drives:
        yield from (alarm_text(alarm) for alarm in subject.alarms)
        if not subject.alarms:
            yield f"{subject.drive}: no change in its own history"
        for side, one in sides.items():
            runs = len(one.diagnosis.fit_names) + len(one.diagnosis.held_out_names)
            yield f"  {side} ({counted(runs, 'run')}): {one.diagnosis.headline}"
            yield f"    {one.page}"


def _verdict(found: FleetDiagnosis) -> Verdict:
    alarms = [alarm for drive in found.drives for alarm in drive.subject.alarms]
    changed = sum(bool(drive.subject.alarms) for drive in found.drives)
    return Verdict(
        headline=f"{counted(len(found.drives), 'drive')} diagnosed, {changed} of them changed"
        if found.drives
        else "No drive changed: there is nothing to diagnose",
        finding=f"{counted(len(alarms), 'change')} in drives' own histories",
        confidence="probable" if changed else "cannot tell",
        next_step="compare before and now"
        if changed
        else "read the drive's pages"
        if found.drives
        else "nothing to do",
        lines=[Line(label="changed", text=alarm_text(alarm)) for alarm in alarms[:3]],
        cautions=list(found.problems),
    )


def _accepted(diagnosis: Diagnosis) -> list[Finding]:
    return [one for one in diagnosis.findings if one.accepted]


def _label(finding: Finding) -> str:
    wave = any(parameter.name == "order" for parameter in finding.parameters)
    return f"{finding.name} ({finding.place})" if wave else finding.name


def _table(place: int, drive: DiagnosedDrive, directory: Path) -> Table:
    subject, sides = drive
    found = [one.diagnosis for one in sides.values()]
    rows = base_rows([one.model_after or one.model_before for one in found], words_of(found[0])) if found else []
    strengths = {side: {_label(f): f for f in _accepted(one.diagnosis)} for side, one in sides.items()}
    for label in dict.fromkeys(label for own in strengths.values() for label in own):
        cells = [_strength(strengths[side].get(label)) for side in sides]
        rows.append(Row(label=label, unit="% of friction", cells=cells))
    said = " ".join(f"{alarm_text(alarm)}." for alarm in subject.alarms) or "No change in its own history."
    pages = ", ".join(str(one.page.relative_to(directory)) for one in sides.values())
    return Table(
        name=f"drive-{place}", title=f"{subject.drive} of {subject.model}", corner="quantity", rows=rows,
        columns=[Heading(label=side) for side in sides],
        note=f"{said} Base model beside the effects, with 95 % intervals; effects by rms of their torque over that of "
        "friction. An effect on one side only may have another name on the other: the pages of both have what else "
        f"would explain it. Pages: {pages or 'none'}.",
    )  # fmt: skip


def _strength(finding: Finding | None) -> Cell:
    if finding is None:
        return Cell(text="not found")
    cell = number(finding.strength_percent, 2)
    return cell.model_copy(update={"text": f"{cell.text} (in doubt)"}) if finding.doubt else cell

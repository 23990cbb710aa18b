"""The diagnosis with one of its mechanisms switched off at a time, on drives whose truth is known."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from blind_drives.run import diagnose_folder
from blind_drives.score import Scored, score_drive, summarise
from common import Report, finish, main, parser, shown
from drive_folders import DriveFolder, drive_folders
from engine import Call, in_parallel, mechanisms

NAME = "ablation_diagnosis"
PURPOSE = (
    "The same drives, diagnosed with one mechanism of the search switched off at a time. A mechanism without influence "
    "has no place in it."
)
ALL_ON = "all on"


def run() -> int:
    """All drives under every ablation."""
    made = parser(NAME, PURPOSE, 1, 1)
    made.add_argument("folders", type=Path, nargs="+", help="what --out of `tools/benchmarks/blind generate` was")
    made.add_argument("--mechanisms", nargs="+", help="only these (default: all of diagnose.MECHANISMS)")
    made.add_argument("--answers", type=Path, help="a folder that keeps the answers, for interrupted runs")
    made.add_argument("--jobs", type=int, default=2, help="processes")
    options = made.parse_args()
    drives = [drive for drive in drive_folders(options.folders) if drive.truth is not None]
    names = [ALL_ON, *(options.mechanisms or mechanisms())]
    if options.sample:
        drives, names = drives[:1], names[:2]
    with tempfile.TemporaryDirectory() as folder, shown("ablation") as progress:
        answers = options.answers or Path(folder)
        paths = {name: [_path(answers, name, drive) for drive in drives] for name in names}
        calls: list[Call] = [
            (diagnose_folder, (drive.logs, path, (), () if name == ALL_ON else (name,)))
            for name in names
            for drive, path in zip(drives, paths[name], strict=True)
        ]
        in_parallel(calls, options.jobs, progress, fresh=True)
        said = {name: [json.loads(path.read_text()) for path in paths[name]] for name in names}
    return finish(ablation_report(drives, said), options)


def _path(answers: Path, name: str, drive: DriveFolder) -> Path:
    return answers / name.replace(" ", "_") / f"{drive.name.replace('/', '_')}.json"


def ablation_report(drives: Sequence[DriveFolder], said: dict[str, list[dict[str, Any]]]) -> Report:
    """A line a mechanism. `said`: reports of all drives, in their order, by what was off."""
    report = Report(NAME, PURPOSE)
    everything: list[Scored] = []
    rows = []
    for name, reports in said.items():
        scored = [score_drive(drive.truth or {}, one, None) for drive, one in zip(drives, reports, strict=True)]
        if name == ALL_ON:
            everything = scored
        summary = summarise(scored)
        errors = np.array([one.torque_percent[1] for one in scored])
        changed = sum(_answer(one) != _answer(other) for one, other in zip(scored, everything, strict=True))
        cells = [
            name, f"{changed}", str(summary.named), str(summary.in_family), str(summary.unknown),
            f"{summary.false_drives.found}/{summary.false_drives.total}",
            f"{summary.extra_drives.found}/{summary.extra_drives.total}",
            f"{summary.silent.found}/{summary.silent.total}",
            f"{np.mean(errors):.2f}, {np.median(errors):.2f} %", f"{summary.median_s:.1f}, {summary.slowest_s:.1f} s",
        ]  # fmt: skip
        rows.append(cells)
        report.facts[name] = {
            "changed": changed, "in_family": summary.in_family.value, "false": summary.false_drives.found,
            "held_out_percent": float(np.mean(errors)), "median_s": summary.median_s,
        }  # fmt: skip
    report.table(
        [
            "off", "drives with a different answer", "named first", "first or in the family",
            "outside the library: right axis", "drives without effects with a finding",
            "drives with a finding besides the true effect", "unreported residuals",
            "held-out torque error: mean, median", "time: median, slowest",
        ],
        rows,
    )  # fmt: skip
    ignored = sorted({name for reports in said.values() for one in reports for name in one["ignored"]})
    if ignored:
        report.notes.append(f"**Not switched off**, as this version of the search cannot: {', '.join(ignored)}.")
    surfaces = sorted({drive.truth["plant"]["friction"]["kind"] for drive in drives if drive.truth})
    report.notes.append(f"{len(drives)} drives on {' and '.join(surfaces)}.")
    return report


def _answer(one: Scored) -> tuple[object, ...]:
    return (tuple(guess.said for guess in one.guesses), one.false_findings, one.verdict)


if __name__ == "__main__":
    main(run)

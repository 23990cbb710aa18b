"""`tools/benchmarks/blind`: generate blind drives, and later hand them to the diagnosis and score what it says."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from common import finish

from .generate import make_drive, write_drive, write_truth
from .run import diagnose_folder, floor_of
from .score import Scored, score_drive
from .tables import blind_report, drives_report

PURPOSE = (
    "Drives drawn from a seed, simulated by the plant alone, with none, one or two effects that the diagnosis is not "
    "told and whose torque is 5 to 30 % of the friction torque once a base model is refitted; the diagnosis sees logs."
)
NOTES = [
    "Only as many of the first accepted findings of a drive count as it has effects. Of an effect of the library the "
    "name is asked for; one of no library is right as `unknown:` on an axis on which it lives.",
    "Removed: (before2 - after2)/(before2 - floor2) of the held-out torque error; the floor is what the base model "
    "leaves on the twin of the drive, simulated without the effects under the same noise: an oracle that is told the "
    "truth leaves no less. Drives whose held-out run hardly shows the effect (removable part below a tenth of floor2) "
    "are left out.",
    "Changes of delay, Stribeck, presliding and lag parameters are not drawn: on one surface a refit takes them in.",
]
DRIVES_PURPOSE = "The eight drives of shared/data/blind, whose effects nobody has told: what is found in them."
FRICTIONS = ("single_2sep", "five_surfaces")
Progress = Callable[[float], None] | None


def seeds_of(text: str) -> list[int]:
    """ "1000:1060" (the end left out), "7" or "1,5,9"."""
    found: list[int] = []
    for part in text.split(","):
        begin, colon, end = part.partition(":")
        found += range(int(begin), int(end)) if colon else [int(begin)]
    if not found or min(found) < 0:
        raise argparse.ArgumentTypeError(f"{text!r} holds no seeds; write 1000:1060, 7 or 1,5,9")
    return found


def parser() -> argparse.ArgumentParser:
    """The options of all subcommands."""
    made = argparse.ArgumentParser(prog="tools/benchmarks/blind", description=__doc__)
    commands = made.add_subparsers(dest="command", required=True, metavar="COMMAND")
    generate = commands.add_parser(
        "generate",
        help="write drives as logs, and the truth beside them",
        description="A folder a drive (drive.yaml, identify, track, recipe and check as csv.gz) in OUT/logs, and what "
        "it has in it in OUT/truth/SEED.json, which is not for the diagnosis. Drives that exist are kept.",
    )
    generate.add_argument("--seeds", type=seeds_of, required=True, help="1000:1060 (end left out), 7 or 1,5,9")
    generate.add_argument("--out", type=Path, required=True)
    generate.add_argument("--friction", choices=FRICTIONS, default=FRICTIONS[0], help="base friction of the plant")
    generate.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes")
    generate.set_defaults(execute=_generate)
    run = commands.add_parser(
        "run",
        help="diagnose generated drives, score them, write results/blind.md",
        description="Diagnoses every drive of the folders that `generate` made, two at a time; reports are kept beside "
        "the logs, so that a run that was interrupted goes on. Then scores them against the truth.",
    )
    run.add_argument("folders", type=Path, nargs="+", help="what --out of generate was")
    run.add_argument("--seeds", type=seeds_of, help="only these")
    run.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes")
    run.add_argument("--score-only", action="store_true", help="diagnose nothing, score the reports that are there")
    run.add_argument("--out", type=Path, help="the Markdown file (default tools/benchmarks/results/blind.md)")
    run.add_argument("--json", action="store_true", help="one JSON object on stdout in place of the table")
    run.add_argument("--sample", action="store_true", help="targets that are missed are no failure; no result file")
    run.set_defaults(execute=_run)
    drives = commands.add_parser("drives", help="diagnose drives without a truth, write results/blind_drives.md")
    drives.add_argument("folder", type=Path, help="holds a folder a drive, as shared/data/blind")
    drives.add_argument("--answers", type=Path, required=True, help="where reports are kept")
    drives.add_argument("--out", type=Path, help="the Markdown file (default tools/benchmarks/results/blind_drives.md)")
    drives.add_argument("--json", action="store_true", help="one JSON object on stdout in place of the table")
    drives.add_argument("--sample", action="store_true", help="no result file")
    drives.set_defaults(execute=_drives)
    return made


def _one(seed: int, friction: str, out: Path) -> int:
    folder, truth = out / "logs" / f"{seed:04d}", out / "truth" / f"{seed:04d}.json"
    if not truth.exists():
        drive = make_drive(seed, friction)
        write_drive(drive, folder)
        write_truth(drive, truth)  # last: a drive that has its truth is whole
    return seed


def _generate(options: argparse.Namespace, progress: Progress) -> int:
    in_parallel([(_one, (seed, options.friction, options.out)) for seed in options.seeds], options.jobs, progress)
    print(f"{len(options.seeds)} drives in {options.out}")
    return 0


def _run(options: argparse.Namespace, progress: Progress) -> int:
    calls: list[tuple[Callable[..., object], tuple[object, ...]]] = []
    floors: list[tuple[Callable[..., object], tuple[object, ...]]] = []
    for folder in options.folders:
        for truth in _truths(folder, options.seeds):
            calls.append((diagnose_folder, (folder / "logs" / truth.stem, folder / "reports" / truth.name)))
            if json.loads(truth.read_text())["effects"]:
                floors.append((floor_of, (truth, folder / "floors" / truth.name)))
    if not options.score_only:
        in_parallel([*calls, *floors], options.jobs, progress)
    sets: dict[str, list[Scored]] = {}
    missing = 0
    for folder in options.folders:
        for path in _truths(folder, options.seeds):
            truth = json.loads(path.read_text())
            floor, answer = folder / "floors" / path.name, folder / "reports" / path.name
            if not answer.exists():
                missing += 1
                continue
            floor_nm = json.loads(floor.read_text())["torque_rms_nm"] if floor.exists() else None
            scored = score_drive(truth, json.loads(answer.read_text()), floor_nm)
            sets.setdefault(truth["plant"]["friction"]["kind"], []).append(scored)
    report = blind_report("blind", PURPOSE, sets)
    seeds = sorted(one.seed for scored in sets.values() for one in scored)
    report.notes.append(f"Seeds {seeds[0]} to {seeds[-1]}: {len(seeds)} drives.")
    report.notes += NOTES
    if missing:
        report.notes.append(
            f"{missing} drives of the set were not diagnosed in the time there was; they are in no figure."
        )
    return finish(report, options)


def _truths(folder: Path, seeds: list[int] | None) -> list[Path]:
    found = sorted((folder / "truth").glob("*.json"))
    return [path for path in found if seeds is None or int(path.stem) in seeds]


def _drives(options: argparse.Namespace, progress: Progress) -> int:
    folders = sorted(path.parent for path in options.folder.glob("*/drive.yaml"))
    answers = {path.name: options.answers / f"{path.name}.json" for path in folders}
    calls = [(diagnose_folder, (path, answers[path.name])) for path in folders]
    in_parallel(calls, 1, progress)  # one at a time: the time of each counts
    reports = {name: json.loads(path.read_text()) for name, path in answers.items()}
    return finish(drives_report("blind_drives", DRIVES_PURPOSE, reports), options)


def in_parallel(
    calls: Sequence[tuple[Callable[..., object], tuple[object, ...]]], jobs: int, progress: Progress
) -> None:
    """Run calls in processes of their own; the first error is raised."""
    with ProcessPoolExecutor(max(1, jobs)) as pool:
        waiting = [pool.submit(function, *arguments) for function, arguments in calls]
        for number, done in enumerate(as_completed(waiting), 1):
            done.result()
            if progress is not None:
                progress(number / len(waiting))

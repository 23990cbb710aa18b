"""`tools/benchmarks/blind`: generate blind drives, and later hand them to the diagnosis and score what it says."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from pathlib import Path

from common import finish
from engine import Call, in_parallel

from .draw import MIXED, ODD, STRONG_WAVES
from .generate import make_drive, write_drive, write_truth
from .left_out import SERVED_BY, judge, left_out_report
from .run import diagnose_folder, floor_of
from .score import Scored, score_drive
from .tables import blind_report, drives_report

PURPOSE = (
    "Drives drawn from a seed, simulated by the plant alone, with none, one or two effects whose torque is 5 to 30 % "
    "of the friction torque after a refit of the base model. The diagnosis sees only the logs."
)
NOTES = [
    "Of the accepted findings of a drive only the first count, as many as it has effects. An effect of the library "
    "must be named; one outside it is right as `unknown:` on an axis on which it depends.",
    "Removed: (before2 - after2)/(before2 - floor2) of the held-out torque error; the floor is what the base model "
    "leaves on the twin of the drive, simulated without the effects under the same noise: an oracle that knows the "
    "truth leaves no less. Drives whose held-out run hardly shows the effect (removable part below a tenth of floor2) "
    "are omitted.",
    "The strength of a wave of more than 8 periods per turn is its rms over Coulomb friction, because a refit absorbs "
    "none of it; its name counts with its order (to 1 %). If a drive cannot have an effect, another drive is drawn, "
    "so that the effects keep their frequencies.",
    "Changes of delay, Stribeck, presliding and lag parameters are not drawn: on one surface a refit absorbs them.",
]
DRIVES_PURPOSE = "Findings on the eight drives of shared/data/blind, whose effects are unknown."
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
    generate.add_argument(
        "--kinds", choices=(MIXED, ODD, STRONG_WAVES), default=MIXED,
        help="odd: only effects of no library, each once in ten seeds; waves: only waves of 12 to 72 periods a turn "
        "and at least 15 %% of Coulomb friction",
    )  # fmt: skip
    generate.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes")
    generate.set_defaults(execute=_generate)
    run = commands.add_parser(
        "run",
        help="diagnose generated drives, score them, write results/blind.md",
        description="Diagnoses every drive of the folders that `generate` made, two at a time; reports are kept beside "
        "the logs, so that a run that was interrupted goes on. Then scores them against the truth.",
    )
    _scored(run, "blind")
    run.set_defaults(execute=_run)
    left_out = commands.add_parser(
        "leave-out",
        help="diagnose drives of `generate --kinds odd` without their own curves, write results/blind_left_out.md",
        description="As `run`, but each drive is searched without the curves that were made for its kind.",
    )
    _scored(left_out, "blind_left_out")
    left_out.set_defaults(execute=_leave_out)
    drives = commands.add_parser("drives", help="diagnose drives without a truth, write results/blind_drives.md")
    drives.add_argument("folder", type=Path, help="holds a folder a drive, as shared/data/blind")
    drives.add_argument("--answers", type=Path, required=True, help="where reports are kept")
    drives.add_argument("--out", type=Path, help="the Markdown file (default tools/benchmarks/results/blind_drives.md)")
    drives.add_argument("--json", action="store_true", help="one JSON object on stdout in place of the table")
    drives.add_argument("--sample", action="store_true", help="no result file")
    drives.set_defaults(execute=_drives)
    return made


def _scored(command: argparse.ArgumentParser, name: str) -> None:
    command.add_argument("folders", type=Path, nargs="+", help="what --out of generate was")
    command.add_argument("--seeds", type=seeds_of, help="only these")
    command.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes")
    command.add_argument("--score-only", action="store_true", help="diagnose nothing, score the reports that are there")
    command.add_argument("--out", type=Path, help=f"the Markdown file (default tools/benchmarks/results/{name}.md)")
    command.add_argument("--json", action="store_true", help="one JSON object on stdout in place of the table")
    command.add_argument("--sample", action="store_true", help="targets that are missed are no failure; no result file")


def _one(seed: int, friction: str, kinds: str, out: Path) -> int:
    folder, truth = out / "logs" / f"{seed:04d}", out / "truth" / f"{seed:04d}.json"
    if not truth.exists():
        drive = make_drive(seed, friction, kinds)
        write_drive(drive, folder)
        write_truth(drive, truth)  # last: a drive that has its truth is whole
    return seed


def _generate(options: argparse.Namespace, progress: Progress) -> int:
    calls: list[Call] = [(_one, (seed, options.friction, options.kinds, options.out)) for seed in options.seeds]
    in_parallel(calls, options.jobs, progress)
    print(f"{len(options.seeds)} drives in {options.out}")
    return 0


def _run(options: argparse.Namespace, progress: Progress) -> int:
    calls: list[Call] = []
    floors: list[Call] = []
    for folder in options.folders:
        for truth in _truths(folder, options.seeds):
            calls.append((diagnose_folder, (folder / "logs" / truth.stem, folder / "reports" / truth.name)))
            if json.loads(truth.read_text())["effects"]:
                floors.append((floor_of, (truth, folder / "floors" / truth.name)))
    if not options.score_only:
        in_parallel([*calls, *floors], options.jobs, progress, fresh=True)
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
            f"{missing} drives of the set were not diagnosed in the available time; no figure includes them."
        )
    return finish(report, options)


def _leave_out(options: argparse.Namespace, progress: Progress) -> int:
    drives = [(folder, json.loads(path.read_text()), path) for folder in options.folders
              for path in _truths(folder, options.seeds)]  # fmt: skip
    calls: list[Call] = [
        (diagnose_folder, (
            folder / "logs" / path.stem, folder / "left_out" / path.name, SERVED_BY[truth["effects"][0]["name"]],
        ))
        for folder, truth, path in drives
    ]  # fmt: skip
    if not options.score_only:
        in_parallel(calls, options.jobs, progress, fresh=True)
    answers = [(truth, folder / "left_out" / path.name) for folder, truth, path in drives]
    reports = [(truth, json.loads(answer.read_text())) for truth, answer in answers if answer.exists()]
    report = left_out_report(
        [judge(truth, said) for truth, said in reports], [name for _, said in reports for name in said["ignored"]]
    )
    surfaces = sorted({truth["plant"]["friction"]["kind"] for truth, _ in reports})
    report.notes.append(
        f"{len(reports)} drives on {' and '.join(surfaces)}; {len(answers) - len(reports)} not diagnosed."
    )
    return finish(report, options)


def _truths(folder: Path, seeds: list[int] | None) -> list[Path]:
    found = sorted((folder / "truth").glob("*.json"))
    return [path for path in found if seeds is None or int(path.stem) in seeds]


def _drives(options: argparse.Namespace, progress: Progress) -> int:
    folders = sorted(path.parent for path in options.folder.glob("*/drive.yaml"))
    answers = {path.name: options.answers / f"{path.name}.json" for path in folders}
    calls: list[Call] = [(diagnose_folder, (path, answers[path.name])) for path in folders]
    in_parallel(calls, 1, progress, fresh=True)  # one at a time: the time of each counts
    reports = {name: json.loads(path.read_text()) for name, path in answers.items()}
    return finish(drives_report("blind_drives", DRIVES_PURPOSE, reports), options)

"""Twenty axes over 44 weeks on a plant that no fit shares, watched by commands as typed, with four thermometers."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from common import Report, finish, main, parser, shown
from weekly_plant import (
    COUNTS,
    KT,
    NONE,
    SIZE,
    WARMED,
    WARMER_K,
    WEEK_S,
    Axis,
    Week,
    axes,
    weeks,
    write_run,
)

from fffo_drive.fleet.store import FleetStore

NAME = "fleet_weekly"
PURPOSE = (
    "`fleet add --manifest`, `work`, `watch --json` and `report` as typed, at the default rate of false alarms, on "
    "tables of runs of 8 s at 500 Hz. Plant: LuGre friction, viscosity by Vogel's law, Coulomb friction -0.4 % a "
    "kelvin, a drive's loop of its own (tools/benchmarks/weekly_plant.py). Ten axes change one of Coulomb friction, "
    f"viscous friction, inertia and constant torque by {100.0 * SIZE:g} % (the last of Coulomb friction) at some week; "
    f"{len(WARMED)} others are warmed by {WARMER_K:g} K for good, one gets another programme."
)
SEED = 1  # nothing was chosen on it
THERMOMETERS = {
    "at the drive": lambda week, noise: week.degc + 0.3 * noise,
    "of the room alone": lambda week, noise: week.room_degc + 0.3 * noise,
    "in the cabinet": lambda week, noise: 25.0 + 0.3 * noise,
    "none": lambda week, noise: None,
}


class Told(NamedTuple):
    """What `watch` said of a fleet."""

    found: list[int]  # weeks from the change to the alarm, of axes whose own law was named
    other_law: list[str]  # alarms of axes that changed, where another law was named
    missed: list[str]  # laws of axes that changed without an alarm
    false: list[str]  # alarms
    judged: dict[str, int]  # words on thermometers


def typed(*words: str, expected: tuple[int, ...] = (0,)) -> subprocess.CompletedProcess[str]:
    """A command of the program."""
    done = subprocess.run([sys.executable, "-m", "fffo_drive", *words], capture_output=True, text=True, check=False)
    if done.returncode not in expected:
        raise RuntimeError(f"{' '.join(words)}: exit code {done.returncode}: {done.stderr[-500:]}")
    return done


def write_manifest(path: Path, fleet: Mapping[int, list[Week]], thermometer: str, dated: bool) -> None:
    """Path, serial number, model, time and temperature of every run."""
    with path.open("w", encoding="utf-8", newline="") as file:
        lines = csv.writer(file)
        lines.writerow(["path", "serial", "model", "time", "temperature_degc"])
        for number, runs in fleet.items():
            noise = np.random.default_rng([SEED, number, 5]).standard_normal(len(runs))
            for week, own in zip(runs, noise, strict=True):
                degc = THERMOMETERS[thermometer](week, own)
                start = str(np.datetime64(int(week.time_s), "s")) if dated else ""
                lines.writerow([week.name, f"axis{number:02d}", "M1", start, "" if degc is None else f"{degc:.2f}"])


def told(said: dict[str, Any], fleet: Mapping[str, Axis], begins_s: Mapping[str, float]) -> Told:
    """What `watch --json` said, against the truth. `begins_s`: when each axis changed."""
    (watched,) = said.values() if "alarms" not in said else (said,)
    alarms: dict[str, list[dict[str, Any]]] = {}
    false = []
    for alarm in watched["alarms"]:
        name = alarm["drive"]
        if fleet[name].change == NONE or alarm["raised_time_s"] < begins_s[name]:
            false.append(alarm["text"].split(". Look")[0])
        else:
            alarms.setdefault(name, []).append(alarm)
    found, other, missed = [], [], []
    for name, axis in fleet.items():
        if axis.change == NONE:
            continue
        own = [one for one in alarms.get(name, []) if axis.change in (one["law"], *one["others"])]
        if own:
            found.append(round((own[0]["raised_time_s"] - begins_s[name]) / WEEK_S))
        elif name in alarms:
            other.append(f"{axis.change} changed: {alarms[name][0]['text'].split('. Look')[0]}")
        else:
            missed.append(axis.change)
    texts = [doubt["text"] for doubt in watched["doubts"]]
    judged = {
        "not used": sum("explains nothing" in text for text in texts),
        "used in part": sum("is used that far" in text for text in texts),
    }
    return Told(found, other, missed, false, judged)


def starts(store: Path) -> dict[str, float]:
    """Start of each run by its file's name."""
    entries = FleetStore(str(store)).index().to_pylist()
    return {Path(entry["path"]).name: entry["start"].timestamp() for entry in entries}


def written(directory: Path, fleet: Mapping[int, list[Week]], every: Mapping[str, Axis]) -> Iterator[float]:
    """Writes the tables of all runs; the share done."""
    directory.mkdir()
    for number, runs in fleet.items():
        for week, one in enumerate(runs):
            write_run(directory / one.name, every[f"axis{number:02d}"], week, one, SEED)
        yield (number + 1) / len(fleet)


def run() -> int:
    """Everything."""
    options = parser(NAME, PURPOSE, 1, 1).parse_args()
    report = Report(NAME, PURPOSE)
    count = 6 if options.sample else None
    every = {f"axis{axis.number:02d}": axis for axis in axes(SEED)[:count]}
    fleet = {axis.number: weeks(axis, SEED) for axis in every.values()}
    begins_s = {name: fleet[axis.number][axis.week].time_s for name, axis in every.items()}
    with tempfile.TemporaryDirectory() as name, shown("fleet of weeks") as progress:
        place = Path(name)
        for share in written(place / "runs", fleet, every):
            if progress is not None:
                progress(0.3 * share)
        facts = place / "facts.yaml"
        facts.write_text(yaml.safe_dump({"torque_constant_nm_per_a": KT, "position_lsb_rev": 1.0 / COUNTS}))
        rows = []
        for number, kind in enumerate(THERMOMETERS):
            manifest = place / "runs" / "manifest.csv"
            write_manifest(manifest, fleet, kind, dated=True)
            store = place / f"store{number}"
            if number in (0, list(THERMOMETERS).index("none")):
                typed("fleet", "add", str(store), "--manifest", str(manifest), "--drive", str(facts), "--work")
            else:  # the same runs with another temperature: the records follow
                shutil.copytree(place / "store0", store)
                typed("fleet", "add", str(store), "--manifest", str(manifest), "--drive", str(facts))
            said = json.loads(typed("fleet", "watch", str(store), "--json").stdout)
            found = told(said, every, begins_s)
            page = json.loads(
                typed("fleet", "report", str(store), "--out", str(place / f"page{number}"), "--json").stdout
            )
            rows.append(row_of(kind, found, sum(axis.change != NONE for axis in every.values())))
            report.notes += [f"Thermometer {kind}, false: {text}" for text in found.false]
            report.notes += [f"Thermometer {kind}, {text}" for text in found.other_law]
            said_first = headline(page, place / f"page{number}")
            report.notes.append(f"Thermometer {kind}: the page says: {said_first}")
            if kind == "at the drive":
                report.bounded(
                    "changes found by their own law",
                    f"{len(found.found)}",
                    not found.missed and not found.other_law,
                    "all",
                )
            report.bounded(f"thermometer {kind}: false alarms", f"{len(found.false)}", not found.false, "none")
            if progress is not None:
                progress(0.3 + 0.6 * (number + 1) / len(THERMOMETERS))
        report.table(
            (
                "thermometer",
                "found, by their own law",
                "weeks to the alarm",
                "named as another law",
                "missed",
                "false alarms",
                "not used",
                "used in part",
            ),
            rows,
        )
        dates(report, place, fleet, facts)
    return finish(report, options)


def row_of(kind: str, found: Told, changed: int) -> tuple[str, ...]:
    """A row of the table."""
    weeks_to = f"{np.median(found.found):.0f} (at most {max(found.found)})" if found.found else "-"
    return (
        kind,
        f"{len(found.found)} of {changed}",
        weeks_to,
        str(len(found.other_law)),
        ", ".join(found.missed) or "none",
        str(len(found.false)),
        str(found.judged["not used"]),
        str(found.judged["used in part"]),
    )


def headline(page: dict[str, Any], out: Path) -> str:
    """What stands first on the page."""
    verdict = page.get("verdict") or json.loads((out / "report.json").read_text())["verdict"]
    return f"{verdict['headline']} ({verdict['confidence']}; {verdict['next_step']})"


def dates(report: Report, place: Path, fleet: Mapping[int, list[Week]], facts: Path) -> None:
    """The same runs after `cp -r`, which makes all files of today."""
    wanted = {week.name: float(int(week.time_s)) for runs in fleet.values() for week in runs}
    report.bounded("runs dated rightly by the manifest", *right(starts(place / "store0"), wanted))
    copied = place / "copied"
    subprocess.run(["cp", "-r", str(place / "runs"), str(copied)], check=True)
    write_manifest(copied / "manifest.csv", fleet, "none", dated=False)
    words = ["--manifest", str(copied / "manifest.csv"), "--drive", str(facts)]
    done = typed("fleet", "add", str(place / "by_file"), *words)
    cautions = done.stderr.count("by the dates of their files")
    report.bounded(
        "after `cp -r`, drives of which `fleet add` warns", f"{cautions} of {len(fleet)}", cautions == len(fleet), "all"
    )
    typed("fleet", "add", str(place / "by_file"), *words, "--time-from", "name")
    report.bounded(
        "... dated rightly by adding again with `--time-from name`", *right(starts(place / "by_file"), wanted)
    )


def right(found: Mapping[str, float], wanted: Mapping[str, float]) -> tuple[str, bool, str]:
    """How many starts are right to the second."""
    same = sum(abs(found[name] - start) < 1.0 for name, start in wanted.items())
    return f"{same} of {len(wanted)}", same == len(wanted), "all"


if __name__ == "__main__":
    main(run)

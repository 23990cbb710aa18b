"""What a page may ask for: each action is a line of the command line, with the role that it needs."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from ..config.axis import read_axis
from ..config.drive_section import CanopenDriveSection
from ..documents import DocumentError
from ..roles import Role
from ..workflows.circle import identification_profile, recipe_profile
from ..workflows.plan import make_plan
from . import shelf
from .simulated_axis import simulator_words

MOTIONS = ("profile", "identify", "recipe")


class CommandLine(NamedTuple):
    """What an action comes to: the words after `fffo-drive`, and what they write."""

    title: str
    words: tuple[str, ...]
    out: Path | None = None


class Bench(NamedTuple):
    """What the actions work on."""

    directory: Path
    axis: Path | None  # the file in use
    facts: Path | None  # declared about the drive of foreign recordings
    given: tuple[Path, ...]  # recordings given at the start
    served: Path | None = None  # sockets of the daemon that has the axis
    who: str = ""  # on whose behalf, for the daemon's log
    fleet: str | None = None  # store of records

    def required_axis(self) -> Path:
        """Raises DocumentError without an axis file."""
        if self.axis is None:
            raise DocumentError("this workbench was opened on recordings: give it an axis file for that")
        return self.axis

    def required_fleet(self) -> str:
        """The store. Raises DocumentError without one."""
        if self.fleet is None:
            raise DocumentError("no store: give one with --fleet, or name it in the axis file (daemon.fleet)")
        return self.fleet

    def runs(self, names: Any) -> list[str]:
        """Paths of recordings of this bench. Raises DocumentError for none, and for one that is not on it."""
        if not isinstance(names, list) or not names:
            raise DocumentError("tick at least one run")
        known = [run["path"] for run in shelf.recordings(self.directory, self.given)]
        strangers = [name for name in names if name not in known]
        if strangers:
            raise DocumentError(f"{strangers[0]}: is no recording of this workbench")
        return names

    def declared(self) -> list[str]:
        """The option that names the declared facts."""
        return [] if self.facts is None else ["--drive", str(self.facts)]


Make = Callable[[Bench, Mapping[str, Any]], CommandLine]


class PageAction(NamedTuple):
    """An action, and who may."""

    role: Role
    make: Make
    moves: bool = False  # the page asks before it, unless it asks itself, and it opens the bus itself
    asks: bool = False  # it asks before each motion
    by_daemon: bool = False  # where a daemon has the axis, it is asked instead
    computes: bool = False  # only: it gives way to a loop on this machine
    beside: bool = False  # a service: runs beside the other jobs, until it is cancelled


def _record(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    axis, motion, toggle = bench.required_axis(), str(wish.get("motion", "profile")), wish.get("toggle")
    out = bench.directory / shelf.RUNS / f"{motion.replace(':', '_')}_{time.strftime('%H%M%S')}.mcap"
    words = ["run", str(axis), "--out", str(out)]
    if motion in ("identify", "recipe"):
        plan = make_plan(axis)
        profile = recipe_profile(plan) if motion == "recipe" else identification_profile(plan, quick=False)
        path = bench.directory / f"{motion}.yaml"
        path.write_text(yaml.safe_dump({"profile": profile}, sort_keys=False), encoding="utf-8")
        words += ["--profile", str(path)]
    elif motion.startswith("decide:"):
        words += ["--decide", motion.removeprefix("decide:")]
    elif motion != "profile":
        raise DocumentError(f"no motion is called {motion!r}; known: {', '.join(MOTIONS)}, decide:EFFECT")
    if toggle in ("off", "ff", "fb"):
        words += ["--toggle", toggle]
    if bench.served is not None:
        words += ["--served", "--sockets", str(bench.served), "--who", bench.who]
    return CommandLine(f"record {motion}", tuple(words), out)


def _serve(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    axis = bench.required_axis()
    if not isinstance(read_axis(axis).drive, CanopenDriveSection):
        raise DocumentError(f"{axis}: a simulated drive in process is not served: a daemon needs a drive on a bus")
    live = ("--scope", "0") if find_spec("websockets") is not None else ()  # the scope is an extra
    return CommandLine("serve", ("serve", str(axis), *live))


def _simulate(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    return CommandLine("simulated drive", simulator_words(bench.required_axis(), bench.directory))


def _commission(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    axis = bench.required_axis()
    if not isinstance(read_axis(axis).drive, CanopenDriveSection):
        raise DocumentError(f"{axis}: a simulated drive in process needs no commissioning record: record a run")
    return CommandLine("commission", ("commission", str(axis)))


def _accept(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    return CommandLine("name the record in the axis file", ("commission", str(bench.required_axis()), "--accept"))


def _identify(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    out = shelf.next_free(bench.directory, "identify")
    return CommandLine(
        "identify", ("identify", *bench.declared(), "--out", str(out), *bench.runs(wish.get("fit"))), out
    )


def _tune(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    out = shelf.next_free(bench.directory, "tune")
    words = ["tune", _model(bench, wish), "--out", str(out)]
    if bench.axis is not None:
        words += ["--axis", str(bench.axis)]
    return CommandLine("tune", tuple(words), out)


def _diagnose(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    out = shelf.next_free(bench.directory, "diagnose")
    words = ["diagnose", *bench.declared(), "--out", str(out), "--fit", *bench.runs(wish.get("fit"))]
    if wish.get("held_out"):
        words += ["--held-out", *bench.runs(wish["held_out"])]
    return CommandLine("diagnose", tuple(words), out)


def _adopt(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    words = ["adopt", _model(bench, wish), "--axis", str(bench.required_axis())]
    if wish.get("dry_run"):
        return CommandLine("show the gates", (*words, "--dry-run"))
    return CommandLine("adopt", tuple(words))


def _circle(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    out = shelf.next_free(bench.directory, "circle")
    words = ["close-the-loop", str(bench.required_axis()), "--out", str(out)]
    return CommandLine("the whole circle", (*words, "--quick") if wish.get("quick") else tuple(words), out)


def _roll_back(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    return CommandLine("undo the last adoption", ("adopt", "--rollback", "--axis", str(bench.required_axis())))


def _compare(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    out = shelf.next_free(bench.directory, "compare")
    return CommandLine("compare runs", ("evaluate", "--out", str(out), "--runs", *bench.runs(wish.get("fit"))), out)


def _fleet_add(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    words = ("fleet", "add", bench.required_fleet(), *bench.runs(wish.get("fit")), *bench.declared())
    return CommandLine("add runs to the fleet", words)


def _fleet_work(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    return CommandLine("records of the fleet", ("fleet", "work", bench.required_fleet()))


def _fleet_report(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    return _of_fleet(bench, wish, "report of the fleet", "report", shelf.FLEET)


def _fleet_diagnose(bench: Bench, wish: Mapping[str, Any]) -> CommandLine:
    return _of_fleet(bench, wish, "diagnose drives of the fleet", "diagnose", shelf.FLEET_DRIVES)


def _of_fleet(bench: Bench, wish: Mapping[str, Any], title: str, verb: str, stem: str) -> CommandLine:
    rate, serial = wish.get("alarms_per_drive_year"), wish.get("serial")
    out = shelf.next_free(bench.directory, stem)
    words = ["fleet", verb, bench.required_fleet(), "--out", str(out)]
    if not isinstance(rate, int | float) or isinstance(rate, bool) or not rate > 0.0:
        raise DocumentError("alarms per drive and year: a number above 0")
    words.append(f"--alarms-per-drive-year={rate:g}")
    if serial:
        words.append(f"--serial={serial}")  # one word: a name may begin with a dash
    return CommandLine(title, tuple(words), out)


def _model(bench: Bench, wish: Mapping[str, Any]) -> str:
    """A model that stands beside a page of this bench. Raises DocumentError for any other."""
    known = [page["model"] for page in shelf.pages(bench.directory) if page["model"]]
    if wish.get("model") not in known:
        raise DocumentError("choose a model: `identify` and `diagnose` write one")
    return str(wish["model"])


ACTIONS: dict[str, PageAction] = {
    "commission": PageAction("move", _commission, moves=True, asks=True),
    "accept": PageAction("move", _accept),
    "record": PageAction("move", _record, moves=True, by_daemon=True),
    "serve": PageAction("move", _serve, beside=True),
    "simulate": PageAction("move", _simulate, beside=True),
    "circle": PageAction("tune", _circle, moves=True),
    "identify": PageAction("move", _identify, computes=True),
    "diagnose": PageAction("move", _diagnose, computes=True),
    "compare": PageAction("move", _compare, computes=True),
    "tune": PageAction("tune", _tune, computes=True),
    "fleet_add": PageAction("move", _fleet_add, computes=True),
    "fleet_work": PageAction("move", _fleet_work, computes=True),
    "fleet_report": PageAction("move", _fleet_report, computes=True),
    "fleet_diagnose": PageAction("move", _fleet_diagnose, computes=True),
    "adopt": PageAction("tune", _adopt),
    "roll_back": PageAction("tune", _roll_back),
}


def known_axis(path: Any, files: Sequence[Path]) -> Path:
    """An axis file of this bench. Raises DocumentError for any other, and for one that cannot be read."""
    chosen = next((file for file in files if str(file) == path), None)
    if chosen is None:
        raise DocumentError(f"{path}: is no axis file of this workbench")
    read_axis(chosen)
    return chosen

"""Many runs of many drives: store a small record of each run, compare, report, find wear.

fffo-drive fleet add STORE RUN...      index runs by drive, time and content; nothing is copied
fffo-drive fleet work STORE            make the record of every run that has none
fffo-drive fleet status STORE          how many runs have a record, and which failed
fffo-drive fleet compact STORE         merge the records' small files; --keep removes old ones
fffo-drive fleet report STORE          page and JSON: spread over the drives of each type, history of each drive
fffo-drive fleet watch STORE           what changed in each drive's own history, and since when
fffo-drive fleet diagnose STORE        diagnose the raw runs of each changed drive, before its change and now
fffo-drive fleet compare A B           two runs, or two periods of a drive: what differs beyond chance
fffo-drive fleet answer                for the unit fffo-drive-records@NAME: what a daemon asks for, on its socket

STORE is a directory, or s3://BUCKET/PREFIX. Needs the extra `fleet`.

Exit codes: 0 done; 74 the store's disk is full or not writable; 78 bad input, or a run could not be added or diagnosed.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import socket
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..documents import DocumentError, counted, did_you_mean, sentence
from ..extras import needs_extra
from ..identification.facts import read_facts
from .exits import EXIT_BAD_INPUT, printable
from .progress import progress_bar

if TYPE_CHECKING:
    from ..fleet.store import FleetStore
    from ..fleet.watch import Watched

MOST_SHOWN = 20  # failures that status prints; --json has all
LISTEN_FD = 3  # sd_listen_fds(3)
LONGEST_REQUEST = 1 << 20  # bytes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    add = _action(actions, "add", "index runs; nothing is copied")
    add.add_argument("runs", nargs="*", metavar="RUN", help="recording, or a log as `identify` takes it: path or URL")
    add.add_argument("--from", dest="source", metavar="DIR|URL", help="all finished recordings in DIR and below")
    add.add_argument("--drive", metavar="FILE", help="declared facts about the drive of tables (YAML)")
    add.add_argument("--serial", metavar="NAME", help="serial number of the drive, instead of the one in the runs")
    add.add_argument("--model", metavar="NAME", help="type of the drive, instead of the one in the runs")
    add.add_argument(
        "--time-from",
        choices=["name", "column"],
        help="date of a run: from its file's name, such as 2026-01-31_10h28m10, or from its column of time alone "
        "(default: that column, else the date of the file)",
    )
    add.add_argument(
        "--manifest",
        metavar="FILE",
        help="runs, a line each (CSV): path, and any of serial, model, time (ISO 8601), temperature_degc",
    )
    add.add_argument("--work", action="store_true", help="also make their records now")
    _engine_arguments(add)
    work = _action(actions, "work", "make the record of every run that has none")
    _engine_arguments(work)
    work.add_argument("--shard", metavar="K/N", help="only share K (1 to N) of N: one task of an array of jobs")
    work.add_argument("--retry", action="store_true", help="try failed runs again")
    _action(actions, "status", "how many runs have a record, and which failed")
    compact = _action(actions, "compact", "merge the small files of records, month by month")
    compact.add_argument("--keep", type=float, metavar="DAYS", help="remove runs that began more than DAYS days ago")
    report = _action(actions, "report", "page and JSON: spread over the drives of each type, history of each drive")
    report.add_argument("--out", required=True, metavar="DIR", help="directory of the page")
    _rate_argument(report)
    report.add_argument("--serial", nargs="+", default=[], metavar="NAME", help="drives whose history is drawn")
    watch = _action(actions, "watch", "find changes in each drive's own history, at the false-alarm rate that you set")
    _rate_argument(watch)
    diagnose = _action(actions, "diagnose", "diagnose the raw runs of each changed drive, before its change and now")
    diagnose.add_argument("--out", required=True, metavar="DIR", help="directory of the pages")
    _rate_argument(diagnose)
    diagnose.add_argument("--serial", nargs="+", default=[], metavar="NAME", help="only these drives, changed or not")
    diagnose.add_argument(
        "--runs", type=int, default=8, metavar="N", help="largest number of runs on each side (default: %(default)d)"
    )
    compare = actions.add_parser("compare", help="what differs between two runs, or two periods of a drive")
    compare.description = (
        "What differs between A and B beyond chance: two runs (files, or content hashes of --store), or with --serial "
        "two periods of a drive, FROM..TO in UTC (2026-01-01..2026-02-01; either end may be left out)."
    )
    compare.add_argument("sides", nargs=2, metavar="A|B", help="run, or FROM..TO")
    compare.add_argument(
        "--store",
        metavar="STORE",
        help="store of the records; the scatter between runs is then estimated from all drives",
    )
    compare.add_argument("--serial", metavar="NAME", help="drive whose periods are compared")
    compare.add_argument("--model", metavar="NAME", help="type of that drive, if several types have this serial number")
    compare.add_argument("--drive", metavar="FILE", help="declared facts about the drive of tables (YAML)")
    compare.add_argument("--out", required=True, metavar="DIR", help="directory of the page")
    compare.add_argument("--json", action="store_true", help="print one JSON object")
    actions.add_parser("answer", help="make the records that a daemon asks for: started by its unit, not by hand")


def _action(actions: Any, name: str, text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = actions.add_parser(name, help=text, description=sentence(text))
    parser.add_argument("store", metavar="STORE", help="directory, or s3://BUCKET/PREFIX")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _rate_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--alarms-per-drive-year",
        type=float,
        default=0.01,
        metavar="R",
        help="accepted false alarms per drive and year, over all watched quantities together (default: %(default)g)",
    )


def _engine_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--on", default="local", metavar="ENGINE",
        help="local: processes here; dask:local: a cluster here; dask:tcp://HOST:PORT: a running one (default: local)",
    )  # fmt: skip
    parser.add_argument("--workers", type=int, metavar="N", help="processes of --on local (default: all cores)")
    parser.add_argument("--idle", action="store_true", help="run at idle priority")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    try:
        import fsspec  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise DocumentError(f"{error}: {needs_extra('fleet', 'fleet')}") from None
    return int(_ACTIONS[options.action](options))


def _add(options: argparse.Namespace) -> int:
    from ..fleet.adding import Given, add_runs, all_places
    from ..fleet.dating import read_manifest
    from ..fleet.store import FleetStore

    facts = read_facts(options.drive) if options.drive else None
    manifest = read_manifest(Path(options.manifest)) if options.manifest else {}
    places = all_places([*options.runs, *manifest], options.source, facts is not None)
    store = FleetStore(options.store, create=True)
    given = Given(options.serial, options.model, facts, time_from=options.time_from)
    with progress_bar("add", quiet=options.json) as progress:
        added = add_runs(store, places, given, progress, {*options.runs, *manifest}, manifest)
    for problem in added.problems:
        print(f"not added: {printable(problem)}", file=sys.stderr)
    for caution in added.cautions:
        print(f"caution: {caution}", file=sys.stderr)
    for skipped in added.skipped:
        print(f"skipped, not a run: {printable(skipped)}", file=sys.stderr)
    if options.json:
        print(json.dumps(added._asdict(), indent=2))
    else:
        known = added.found - added.new - added.changed - len(added.problems) - len(added.skipped)
        print(
            f"{counted(added.new, 'run')} added, {known} known before"
            + (f", {added.changed} changed (drive, type, date or temperature)" * bool(added.changed))
            + (f", {len(added.problems)} not added" * bool(added.problems))
            + (f", {len(added.skipped)} skipped" * bool(added.skipped))
        )
    missing = 0
    if options.work:
        named = set(added.runs)
        missing = _make_records(options, store, [entry for entry in store.waiting() if entry["run"] in named])
    elif not options.json:
        print(f"next: fffo-drive fleet work {options.store}")
    return EXIT_BAD_INPUT if added.problems or missing else 0


def _work(options: argparse.Namespace) -> int:
    from ..fleet.store import FleetStore
    from ..fleet.work import shard_of

    store = FleetStore(options.store)
    if options.retry:
        store.forgive()
    entries = store.waiting()
    if options.shard:
        entries = shard_of(entries, *_share(options.shard))
    return EXIT_BAD_INPUT if _make_records(options, store, entries) else 0


def _make_records(options: argparse.Namespace, store: FleetStore, entries: list[dict[str, Any]]) -> int:
    """Make them; the number of runs that got none."""
    from ..fleet.work import work

    if options.workers is not None and options.workers < 1:
        raise DocumentError(f"--workers {options.workers}: at least 1")
    if options.idle:
        os.nice(19)
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    engine, _, where = options.on.partition(":")
    if engine == "local" and not where:
        run = partial(work, store.place.address, entries, options.workers)
    elif engine == "dask" and where:
        try:
            from ..fleet.dask_engine import work_on_dask
        except ImportError as error:
            raise DocumentError(f"--on {options.on} needs the extra `fleet`: {error}") from None
        run = partial(work_on_dask, where, store.place.address, entries)
    else:
        raise DocumentError(f"--on {options.on}: local, dask:local or dask:tcp://HOST:PORT")
    with progress_bar("records", quiet=options.json) as progress:
        run(progress=progress)
    asked = {entry["run"] for entry in entries}
    failed = [failure for failure in store.failures() if failure.run in asked]
    unreached = [one for one in store.unreached() if one.run in asked]
    if options.json and not hasattr(options, "runs"):
        outcome = {"failed": [one._asdict() for one in failed], "unreached": [one._asdict() for one in unreached]}
        print(json.dumps({"runs": len(entries), **outcome}, indent=2))
    elif not options.json:
        made = len(entries) - len(failed) - len(unreached)
        print(f"{counted(made, 'record')} made" + (f", {len(failed)} failed" if failed else ""))
        for failure in failed[:MOST_SHOWN]:
            print(f"failed: {printable(failure.reason)}", file=sys.stderr)
        for attempt in unreached[:MOST_SHOWN]:
            print(f"waits for the next work: {printable(attempt.reason)}", file=sys.stderr)
        if failed:
            print(f"all of them: fffo-drive fleet status {options.store}; again: work --retry", file=sys.stderr)
    return len(failed) + len(unreached)


def _share(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise DocumentError(f"--shard {text}: K/N with K from 1 to N, such as 3/8")
    return int(number), int(count)


def _status(options: argparse.Namespace) -> int:
    from ..fleet.store import FleetStore, status_lines, status_object

    store = FleetStore(options.store)
    if options.json:
        print(json.dumps(status_object(store), indent=2))
        return 0
    status, failures, unreached = store.status(), store.failures(), store.unreached()
    drives = store.drives().to_pylist()
    print("\n  ".join(status_lines(status)))
    print(f"  {counted(status.new_files, 'file')} to merge, {status.merged_files} merged")
    for row in drives[:MOST_SHOWN]:
        span = f"{row['first']:%Y-%m-%d} to {row['last']:%Y-%m-%d}"
        print(f"  {row['model']}, {row['drive']}: {counted(row['runs'], 'run')}, {span}")
    if len(drives) > MOST_SHOWN:
        print(f"  and {len(drives) - MOST_SHOWN} drives more (--json has all)")
    for attempt in unreached[:MOST_SHOWN]:
        print(f"waits for the next work: {printable(attempt.reason)}")
    for failure in failures[:MOST_SHOWN]:
        print(f"failed after {failure.tries} tries: {printable(failure.reason)}")
    return 0


def _compact(options: argparse.Namespace) -> int:
    from ..fleet.store import FleetStore

    if options.keep is not None and not options.keep > 0.0:
        raise DocumentError(f"--keep {options.keep:g}: days, more than 0")
    done = FleetStore(options.store).compact(options.keep)
    if options.json:
        print(json.dumps(done._asdict(), indent=2))
    else:
        print(
            f"{counted(done.records, 'record')} in {counted(done.files, 'file')}"
            + (f", {done.removed} removed" if done.removed else "")
        )
    return 0


def _report(options: argparse.Namespace) -> int:
    from ..fleet.history import histories
    from ..fleet.report import FleetSource, fleet_report, outsider_text, shown_drives
    from ..fleet.spread import SPREAD_COLUMNS, spreads_of
    from ..fleet.store import FleetStore
    from ..fleet.watch import alarm_text
    from ..report.page import write_report

    store = FleetStore(options.store)
    spreads = spreads_of(store.parts(SPREAD_COLUMNS))
    if not spreads:
        raise DocumentError(f"{options.store}: no record yet: `fffo-drive fleet work {options.store}` makes them")
    known = [drive for spread in spreads for drive in spread.drives]
    for name in options.serial:
        if name not in known:
            raise DocumentError(f"--serial {name}: no record of it: {did_you_mean(name, known)}")
    drawn = {}
    for spread in spreads:
        asked = [drive for drive in options.serial if drive in spread.drives]
        named = asked if options.serial else shown_drives(spread)
        drawn[spread.model] = histories(store, spread.model, named) if named else {}
    with progress_bar("watch", quiet=options.json):
        moved = _watched(store, options.alarms_per_drive_year)
    source = FleetSource(store.place.address, store.status(), spreads, drawn, moved)
    page = fleet_report(source)
    paths = write_report(page, Path(options.out))
    if options.json:
        print(json.dumps(json.loads(paths.json.read_text(encoding="utf-8"))["results"], indent=2))
        return 0
    for spread in spreads:
        print(f"{spread.model}: {counted(len(spread.drives), 'drive')}, {counted(int(spread.runs.sum()), 'run')}")
        for one in spread.outsiders[:MOST_SHOWN]:
            print(f"  {one.drive} stands outside: {outsider_text(one)}")
        alarms = moved[spread.model].alarms if spread.model in moved else ()
        for alarm in alarms:
            print(f"  changed: {alarm_text(alarm)}")
    verdict = page.verdict
    print(verdict.headline)
    for caution in verdict.cautions:
        print(f"caution: {caution}", file=sys.stderr)
    print(f"{verdict.confidence}; next: {verdict.next_step}")
    print(paths.page)
    return 0


def _watched(store: FleetStore, rate: float) -> dict[str, Watched]:
    """By model."""
    from ..fleet.history import models_of
    from ..fleet.watch import watch_model

    if not rate > 0.0:
        raise DocumentError(f"--alarms-per-drive-year {rate:g}: more than 0")
    return {model: watch_model(store, model, rate) for model in models_of(store)}


def _watch(options: argparse.Namespace) -> int:
    from ..fleet.store import FleetStore
    from ..fleet.watch import watch_lines

    found = _watched(FleetStore(options.store), options.alarms_per_drive_year)
    if options.json:
        print(json.dumps({model: one.as_plain() for model, one in found.items()}, indent=2))
        return 0
    for model, one in found.items():
        print("\n".join([f"{model}:", *(f"  {line}" for line in watch_lines(one))]))
    return 0


def _diagnose(options: argparse.Namespace) -> int:
    from ..fleet.diagnosing import diagnose_drives, diagnosis_lines, fleet_diagnosis_report, require_places, subjects_of
    from ..fleet.store import FleetStore
    from ..report.page import write_report

    if options.runs < 1:
        raise DocumentError(f"--runs {options.runs}: at least 1")
    out = Path(options.out)
    store = FleetStore(options.store)
    with progress_bar("watch", quiet=options.json):
        changed = _watched(store, options.alarms_per_drive_year)
    subjects = subjects_of(store, changed, options.serial, options.runs)
    require_places(subjects, out)
    found = diagnose_drives(store, subjects, out, partial(progress_bar, quiet=options.json))
    paths = write_report(fleet_diagnosis_report(found, store.place.address, out), out)
    for problem in found.problems:
        print(f"not diagnosed: {printable(problem)}", file=sys.stderr)
    if options.json:
        print(json.dumps(json.loads(paths.json.read_text(encoding="utf-8"))["results"], indent=2))
    else:
        print("\n".join([*diagnosis_lines(found), str(paths.page)]))
    return EXIT_BAD_INPUT if found.problems else 0


def _compare(options: argparse.Namespace) -> int:
    from ..fleet.compare import compared, comparison_report, side_of_file, side_of_store
    from ..fleet.difference import difference_lines
    from ..fleet.store import FleetStore
    from ..report.page import write_report

    facts = read_facts(options.drive) if options.drive else None
    store = FleetStore(options.store) if options.store else None
    if store is None and options.serial:
        raise DocumentError(f"--serial {options.serial}: give the store of its records with --store")
    first, second = (
        side_of_file(text, facts) if store is None else side_of_store(store, text, options.serial, options.model)
        for text in options.sides
    )
    found = compared(first, second, store)
    paths = write_report(comparison_report(first, second, found), Path(options.out))
    if options.json:
        print(json.dumps(json.loads(paths.json.read_text(encoding="utf-8"))["results"], indent=2))
        return 0
    print("\n".join([*difference_lines(found), str(paths.page)]))
    return 0


def _answer(_: argparse.Namespace) -> int:
    """One request on the socket that the service manager has passed (sd_listen_fds(3)), and its answer."""
    from . import main

    if os.environ.get("LISTEN_PID") != str(os.getpid()) or os.environ.get("LISTEN_FDS") != "1":
        raise DocumentError("fleet answer: fffo-drive-records@NAME.socket starts it; for yourself use fleet add --work")
    with socket.socket(fileno=LISTEN_FD) as listener:
        connection, _ = listener.accept()
    with connection, connection.makefile("rb") as lines:
        said = io.StringIO()
        try:
            wanted = json.loads(lines.readline(LONGEST_REQUEST))
            words = ["--work", "--workers", "1", "--idle", "--json", "--", str(wanted["store"]), *wanted["files"]]
        except (ValueError, KeyError, TypeError) as error:
            code = EXIT_BAD_INPUT
            said.write(f"not a request: {error}")
        else:
            with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
                code = main(["fleet", "add", *words])
        problem = (said.getvalue().strip() or f"exit code {code}") if code else ""
        connection.sendall(json.dumps({"problem": problem}).encode() + b"\n")
    return 0


_ACTIONS = {
    "add": _add, "work": _work, "status": _status, "compact": _compact, "report": _report, "watch": _watch,
    "diagnose": _diagnose, "compare": _compare, "answer": _answer,
}  # fmt: skip

"""Run one profile on a drive, in process or on a bus, and record it.

AXIS is an axis file (configs/axis_simulated.yaml, configs/axis_canopen.yaml): drive, model, control law, limits,
profile. Everything is checked before anything moves. The run is recorded in one MCAP file.
With --served, the daemon that serves this axis runs the profile and records it; this program opens no bus.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
import shlex
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..config.adoption import read_history
from ..config.axis import TOGGLES
from ..config.commissioning import permission
from ..control.reference import MODE_VELOCITY
from ..daemon.served_run import record_served
from ..daemon.serving import find_socket
from ..documents import DocumentError
from ..drive.port import ExchangeCounts
from ..model.effects.registry import name_error
from ..runtime.runs import timestamp_name
from ..workflows.errors import DriveFaultError, RecordingGapError
from ..workflows.plan import Plan, make_plan, open_drive
from ..workflows.record import record_run, summarise
from ..workflows.recordings import claim
from .progress import progress_bar
from .reset import add_reset_option


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("config", metavar="AXIS", help="axis file (YAML)")
    parser.add_argument(
        "--toggle",
        choices=list(TOGGLES),
        help="input of the friction observer: off (none), ff (reference), fb (measured velocity) (default: the file's)",
    )
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument(
        "--profile", metavar="FILE", help="run the profile in FILE (configs/profiles) instead of the axis file's"
    )
    chosen.add_argument(
        "--decide",
        type=_effect_name,
        metavar="EFFECT",
        help="motion that separates this effect from similar ones, instead of the file's profile",
    )
    parser.add_argument("--bus", help="bus instead of the file's: socketcan:can0, loopback:PORT")
    parser.add_argument("--out", metavar="FILE", help="file to write (default: recording.directory/NAME_TIME.mcap)")
    parser.add_argument(
        "--uncommissioned",
        action="store_true",
        help="enable a drive on a bus without a commissioning record",
    )
    add_reset_option(parser)
    parser.add_argument("--served", action="store_true", help="let the daemon that serves this axis run and record it")
    parser.add_argument(
        "--sockets", metavar="DIR", help="directory of that daemon's sockets (default: found by the axis's name)"
    )
    parser.add_argument("--who", metavar="NAME", help="name to enter in the daemon's log")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    wanted = TOGGLES[options.toggle] if options.toggle else None
    plan = make_plan(options.config, None if wanted is None else (wanted,), options.decide, options.profile)
    if options.served:
        if options.reset_fault:
            raise SystemExit("fffo-drive run: --reset-fault: of a served drive `fffo-drive ctl reset-fault` does it")
        return _served(options, plan)
    toggle = plan.toggle if wanted is None else wanted
    given = permission(plan.path, plan.axis, plan.model, options.uncommissioned)
    out = Path(options.out) if options.out else _default_path(plan)
    claim(out)

    drive = open_drive(plan, options.bus)
    bar = functools.partial(progress_bar, quiet=options.json)
    outcome = record_run(plan, drive, toggle, out, given, bar, reset_fault=options.reset_fault)
    summary = summarise(plan, outcome, toggle)
    if options.json:
        print(json.dumps(summary, indent=2))
    else:
        _print(summary)
        print(f"next: {next_step(plan, outcome.files)}")
    if outcome.fault_text is not None:
        raise DriveFaultError(f"the run ended with a fault: {outcome.fault_text}")
    if outcome.gap_text is not None:
        raise RecordingGapError(outcome.gap_text)
    return 0


def _served(options: argparse.Namespace, plan: Plan) -> int:
    """The run of a drive that a daemon has."""
    out = Path(options.out) if options.out else _default_path(plan)
    claim(out)
    sockets = find_socket(plan.axis.name, options.sockets, watching=False).parent
    section = plan.axis.profile.model_dump(mode="json", exclude_none=True)
    bar = functools.partial(progress_bar, quiet=options.json)
    files = record_served(sockets, section, options.toggle, out, options.who, bar)
    names = [str(file) for file in files]
    print(json.dumps({"axis": plan.axis.name, "files": names}, indent=2) if options.json else "\n".join(names))
    if not options.json:
        print(f"next: {next_step(plan, files)}")
    return 0


def next_step(plan: Plan, files: Sequence[Path]) -> str:
    """What to type with a run's files: nothing that led to the model in service."""
    names = shlex.join(map(str, files))
    if plan.profile.mode == MODE_VELOCITY and _is_adopted(plan):
        return f"fffo-drive evaluate --runs RUN_BEFORE_ADOPTION {names} --out DIR"
    diagnose = f"fffo-drive diagnose --fit {names} --held-out OTHER_RUN --out DIR"
    if plan.model.provenance.runs:  # fitted to runs of the axis
        return diagnose
    return f"fffo-drive identify {names} --out DIR, or {diagnose}"


def _is_adopted(plan: Plan) -> bool:
    """`fffo-drive adopt` has put the model in service. A damaged history is no reason to fail after a run."""
    with contextlib.suppress(DocumentError):
        adoptions = read_history(plan.path).adoptions
        return bool(adoptions) and adoptions[-1].model == plan.axis.model
    return False


def _effect_name(text: str) -> str:
    error = name_error(text)
    if error:
        raise argparse.ArgumentTypeError(error)
    return text


def _default_path(plan: Plan) -> Path:
    return Path(plan.axis.recording.directory) / f"{timestamp_name(plan.axis.name, time.time_ns())}.mcap"


def _print(summary: dict[str, Any]) -> None:
    if "metrics" in summary:
        metrics = summary["metrics"]
        print(
            f"{summary['axis']}, friction {summary['toggle']}: ISE {metrics['ise']:.4g} rps^2 s, "
            f"MAE {metrics['mae']:.4g}, MAX {metrics['max']:.4g}, STD {metrics['std']:.4g} rps"
        )
    if "ticks" in summary:
        ticks = summary["ticks"]
        print(
            f"{ticks['ticks']} ticks, {ticks['late']} late, {ticks['skipped']} skipped, "
            f"{ticks['missing_feedback']} without feedback; rows lost: {summary['rows_lost'] + summary['rows_dropped']}"
        )
        wire = [f"{ticks[name]} {name}" for name in ExchangeCounts._fields if ticks[name]]
        if wire:
            print(f"on the wire: {', '.join(wire)}")
    for warning in summary["warnings"]:
        print(warning)
    for file in summary["files"]:
        print(file)

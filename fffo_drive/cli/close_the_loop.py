"""The whole circle on one axis: run, record, diagnose, adopt, run again; the tracking error before and after.

AXIS is an axis file whose drive may move: in process, or on a bus (with --sim FILE a simulated drive is started there).
An identification current, the recipe that separates effects, and the file's own profile are recorded; the profile's run
is held out from the choice of effects. Everything is written to DIR, with an axis file of its own: AXIS stays as it is.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from rich.console import Console
from rich.table import Table

from ..config.adoption import Gate, gates, put_in_service, read_report
from ..config.axis import AxisFile, CanopenDriveSection, build_profile, model_of, read_axis
from ..config.checks import motion_problems
from ..config.commissioning import permission
from ..config.effects import slope_margin
from ..config.plan import checked_plan
from ..control.friction_observer import TOGGLE_OFF
from ..documents import DocumentError, parse, read_text
from ..evaluation.metrics import ErrorMetrics, run_metrics, true_metrics
from ..model.parameters import ModelFile, read_model
from .adopt import print_gates
from .drives import Plan, make_plan, open_drive
from .exits import DriveFaultError, RecordingGapError
from .recordings import claim, recorded_rows
from .run import record_run
from .simulated_process import SimulatedProcess

EXIT_NOT_ADOPTED = 1
GAIN_ROOM = 1.02  # of what condition (14) asks for
RECIPE = {"kind": "recipe", "repeats": 1}
IDENTIFY = {"kind": "identify", "duration_s": 40.0, "lowest_hz": 0.05}
BREAK_AWAY_RATIO = 2.4  # the identification current's peak over what breaks away; less where it goes too far
SHORTER = 0.85
LEAST_BREAK_AWAY_RATIO = 1.1


class Run(NamedTuple):
    """One recorded run of the circle."""

    path: Path
    measured: ErrorMetrics | None  # None: no velocity loop
    true: ErrorMetrics | None  # of the shaft, where the drive can know it


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("axis", metavar="AXIS", help="axis file (YAML)")
    parser.add_argument("--out", required=True, metavar="DIR", help="directory for runs, report, model and axis file")
    parser.add_argument("--drive", metavar="FACTS", help="declared facts (default: from the axis file)")
    parser.add_argument("--sim", metavar="FILE", help="start the simulated drive of this file on the axis' bus")
    parser.add_argument("--bus", help="bus instead of the file's: socketcan:can0, loopback:PORT")
    parser.add_argument("--uncommissioned", action="store_true", help="enable a drive on a bus without its record")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    out = Path(options.out)
    axis_path = Path(options.axis)
    plan = make_plan(axis_path)
    claim(out / "before.mcap")
    facts_path = Path(options.drive) if options.drive else _write_facts(plan, out, options.sim is not None)
    own_path = _write_axis(axis_path, out)
    say = Console(stderr=True, quiet=options.json).print
    with _drive_process(options, plan):
        say("run and record: identification current, recipe, the file's profile", soft_wrap=True)
        identify = _run(own_path, options, out / "identify.mcap", _identify(plan))
        recipe = _run(own_path, options, out / "recipe.mcap", _recipe(plan))
        before = _run(own_path, options, out / "before.mcap")
        say("diagnose", soft_wrap=True)
        _diagnose(facts_path, [identify.path, recipe.path], [before.path], out / "diagnosis")
        report = read_report(out / "diagnosis" / "model.yaml", None)
        adopted, found = _adopt(own_path, out / "diagnosis" / "model.yaml", report)
        after = None
        if adopted:
            say("adopted; run again", soft_wrap=True)
            after = _run(own_path, options, out / "after.mcap")
    result = _result(read_model(out / "diagnosis" / "model.yaml"), report, found, before, after)
    (out / "circle.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    if options.json:
        print(json.dumps(result, indent=2))
    else:
        _print(result, found, out)
    return 0 if adopted or not read_model(out / "diagnosis" / "model.yaml").effects else EXIT_NOT_ADOPTED


@contextlib.contextmanager
def _drive_process(options: argparse.Namespace, plan: Plan) -> Iterator[None]:
    """The simulated drive on the bus for as long as the circle takes, where it was asked for."""
    if options.sim is None:
        yield
        return
    section = plan.axis.drive
    if not isinstance(section, CanopenDriveSection):
        raise DocumentError(f"{plan.path}: drive.kind: simulated runs in process: leave --sim out")
    with SimulatedProcess(Path(options.sim), options.bus or section.bus):
        yield


def _identify(plan: Plan) -> dict[str, Any]:
    """An identification current that the axis can follow inside its envelope, by the model in service."""
    break_away_a = plan.model.friction.static_nm.value / plan.model.torque_constant_nm_per_a
    ratio = BREAK_AWAY_RATIO
    while ratio > LEAST_BREAK_AWAY_RATIO:
        profile = IDENTIFY | {"high_a": ratio * break_away_a, "low_a": 0.3 * ratio * break_away_a}
        axis = AxisFile.model_validate(plan.axis.model_dump() | {"profile": profile})
        if not motion_problems(axis, build_profile(axis.profile, axis.loop.period_s), plan.model):
            return profile
        ratio *= SHORTER
    raise DocumentError(
        f"{plan.path}: envelope: no current that breaks the axis away stays inside it by the model: record by hand "
        "and use `fffo-drive diagnose` and `fffo-drive adopt`"
    )


def _recipe(plan: Plan) -> dict[str, Any]:
    """The recipe inside the axis' limits."""
    return RECIPE | {"high_rps": min(14.0, 0.6 * plan.axis.envelope.speed_limit_rps)}


def _run(axis_path: Path, options: argparse.Namespace, path: Path, profile: dict[str, Any] | None = None) -> Run:
    """One run with the axis file as it is now, or with another profile."""
    axis = read_axis(axis_path)
    if profile is not None:
        axis = AxisFile.model_validate(axis.model_dump() | {"profile": profile})
    plan = checked_plan(axis_path, axis, model_of(axis_path, axis))
    given = permission(axis_path, axis, plan.model, options.uncommissioned or options.sim is not None)
    claim(path)
    outcome = record_run(plan, open_drive(plan, options.bus), plan.toggle, path, given, options.json)
    if outcome.fault_text is not None:
        raise DriveFaultError(f"{path.name}: {outcome.fault_text}")
    if outcome.gap_text is not None:
        raise RecordingGapError(f"{path.name}: {outcome.gap_text}")
    rows = recorded_rows(outcome.files)
    if plan.axis.profile.kind in ("identify", "frf"):
        return Run(path, None, None)
    period_s, samples = plan.profile.period_s, plan.profile.values.size
    true = true_metrics(rows, period_s, samples)
    return Run(path, run_metrics(rows, period_s, samples), true if true.ise == true.ise else None)


def _diagnose(facts: Path, fit: Sequence[Path], held_out: Sequence[Path], out: Path) -> None:
    """`fffo-drive diagnose` on the recorded runs."""
    from . import diagnose

    parser = argparse.ArgumentParser()
    diagnose.add_arguments(parser)
    words = ["--drive", str(facts), "--fit", *map(str, fit), "--held-out", *map(str, held_out), "--out", str(out)]
    with contextlib.redirect_stdout(sys.stderr):
        code = diagnose.execute(parser.parse_args(words))
    if code != 0:
        raise DocumentError(f"{out}: the diagnosis ended with exit code {code}")


def _adopt(axis_path: Path, model_path: Path, report: dict[str, Any] | None) -> tuple[bool, list[Gate]]:
    """Adopt what was found on the circle's own axis file. The observer's gain follows the refitted friction."""
    axis = read_axis(axis_path)
    model = read_model(model_path)
    if not model.effects:
        return False, []
    gain = _needed_gain(axis_path, axis, model)
    if gain is not None:
        _change(axis_path, ("controller", "observer", "gain_nm_per_rev"), gain)
        axis = read_axis(axis_path)
    found = gates(axis, model_of(axis_path, axis), model, report, None)
    if not all(gate.passed for gate in found):
        return False, found
    put_in_service(axis_path, model_path, found)
    return True, found


def _needed_gain(axis_path: Path, axis: AxisFile, model: ModelFile) -> float | None:
    """A larger L where the refitted B asks for it by (14); None where the file's is enough."""
    observer_on = axis.controller.observer.toggle != "off"
    plan = checked_plan(axis_path, axis, model_of(axis_path, axis), (TOGGLE_OFF,))
    left = slope_margin(axis, model, plan.profile, observer_on).condition_14_nm_per_rev
    if not observer_on or left >= 0.0:
        return None
    return round(GAIN_ROOM * (axis.controller.observer.gain_nm_per_rev - left), 3)


def _write_axis(axis_path: Path, out: Path) -> Path:
    """A copy of the axis file whose files are found from DIR, without a monitor: it would switch inside the runs."""
    data, _ = parse(read_text(axis_path), str(axis_path))
    for section, key in ((data, "model"), (data, "commissioning"), (data["drive"], "file"), (data["drive"], "eds")):
        if section.get(key):
            section[key] = str((axis_path.resolve().parent / section[key]).resolve())
    data["controller"].setdefault("effects", {})["monitor"] = False
    path = out / "axis.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False, width=110), encoding="utf-8")
    read_axis(path)
    return path


def _change(path: Path, key: Sequence[str], value: float) -> None:
    data, _ = parse(read_text(path), str(path))
    section = data
    for part in key[:-1]:
        section = section.setdefault(part, {})
    section[key[-1]] = value
    path.write_text(yaml.safe_dump(data, sort_keys=False, width=110), encoding="utf-8")


def _write_facts(plan: Plan, out: Path, simulated_on_bus: bool) -> Path:
    """What the axis file declares about the drive. The simulated drive's angle is the same in every run."""
    section = plan.axis.drive
    on_bus = isinstance(section, CanopenDriveSection)
    facts: dict[str, Any] = {
        "torque_constant_nm_per_a": plan.model.torque_constant_nm_per_a,
        "resolver_bits": section.resolver_bits if isinstance(section, CanopenDriveSection) else 15,
        "absolute_angle": simulated_on_bus or not on_bus,
    }
    path = out / "facts.yaml"
    path.write_text(yaml.safe_dump(facts, sort_keys=False), encoding="utf-8")
    return path


def _result(
    model: ModelFile, report: dict[str, Any] | None, found: Sequence[Gate], before: Run, after: Run | None
) -> dict[str, Any]:
    """The circle as one JSON object."""
    errors = {
        name: {kind: value._asdict() if value is not None else None for kind, value in
               (("measured", run.measured), ("true", run.true))}
        for name, run in (("before", before), ("after", after)) if run is not None
    }  # fmt: skip
    return {
        "format": "fffo_drive/circle/1",
        "verdict": (report or {}).get("verdict"),
        "effects": [effect.name for effect in model.effects],
        "adopted": after is not None,
        "gates": [gate._asdict() for gate in found],
        "tracking": errors,
        "model_error": {key: (report or {}).get(key) for key in ("before", "after")},
    }


def _print(result: dict[str, Any], found: list[Gate], out: Path) -> None:
    if found:
        print_gates(found)
    print(f"found: {', '.join(result['effects']) or 'nothing'} ({result['verdict']})")
    tracking = result["tracking"]
    if "after" in tracking:
        table = Table("tracking error", "before", "after", "change", box=None, pad_edge=False)
        for kind in ("measured", "true"):
            if tracking["before"][kind] is None or tracking["after"][kind] is None:
                continue
            for key, unit in (("ise", "rps^2 s"), ("mae", "rps"), ("max", "rps")):
                old, new = tracking["before"][kind][key], tracking["after"][kind][key]
                change = f"{100.0 * (new / old - 1.0):+.1f} %"
                table.add_row(f"{kind} {key.upper()} {unit}", f"{old:.4g}", f"{new:.4g}", change)
        Console().print(table)
    print(out / "diagnosis" / "report.html")
    print(out / "axis.yaml")

"""Check files, and print their schemas and tables.

fffo-drive config check AXIS...     all errors at once; margins, bus load; axes that share a bus
fffo-drive config schema KIND       JSON schema for editors: axis, drive_profile, simulated, model, scenario, facts
fffo-drive config drives            the drive profiles that come with the program, and how each was tested
fffo-drive config signals           the recorded signals with unit and meaning
fffo-drive config effects           the effects of the simulated drive with their parameters
"""

from __future__ import annotations

import argparse
import importlib
import json
import shutil
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..documents import StrictRecord, sentence

if TYPE_CHECKING:
    from ..config.drive_profile import DriveProfile
    from ..workflows.plan import Plan

SCHEMAS = {  # kind of file -> module and name of its record
    "axis": ("config.axis", "AxisFile"),
    "drive_profile": ("config.drive_profile", "DriveProfile"),
    "simulated": ("config.simulated", "SimulatedDriveRecord"),
    "model": ("model.parameters", "ModelFile"),
    "scenario": ("config.scenario", "ScenarioFile"),
    "facts": ("identification.facts", "DriveFacts"),
}
LEAST_TEXT = 20  # characters of the last column, even in a narrower terminal
EFFECTS_HEAD = "An effect is off while all its parameters marked (strength) are 0."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    check = _action(actions, "check", "check axis files and the files they name; show margins and bus load")
    check.add_argument("config", metavar="AXIS", nargs="+", help="axis file (YAML)")
    schema = _action(actions, "schema", "print the JSON schema of a kind of file")
    schema.add_argument("kind", choices=list(SCHEMAS), help="kind of file")
    for name, text in (
        ("drives", "list the profiles of drive families, for drive.profile, and how each was tested"),
        ("signals", "print the recorded signals with unit and meaning"),
        ("effects", "print the effects of the simulated drive with their parameters"),
    ):
        _action(actions, name, text).add_argument("--json", action="store_true", help="print one JSON object")


def _action(actions: Any, name: str, text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = actions.add_parser(name, help=text, description=sentence(text))
    return parser


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    if options.action == "check":
        _check_all(options.config)
    elif options.action == "schema":
        print(json.dumps(schema_record(options.kind).model_json_schema(), indent=2))
    elif options.action == "drives":
        told = {"family", "tried", "remarks", "to_fill_in"}
        found = {name: profile.model_dump(include=told) for name, profile in _drives().items()}
        print(json.dumps(found, indent=2) if options.json else "\n".join(drive_lines()))
    elif options.action == "signals":
        _print_signals(options.json)
    else:
        _print_effects(options.json)
    return 0


def schema_record(kind: str) -> type[StrictRecord]:
    """The record that a kind of file is read into."""
    module, name = SCHEMAS[kind]
    record: type[StrictRecord] = getattr(importlib.import_module(f"...{module}", __name__), name)
    return record


def aligned(rows: Sequence[Sequence[str]], widths: Sequence[int], indent: str = "") -> list[str]:
    """Rows in columns of `widths`; the last one is wrapped to the terminal, but not in a pipe, for grep."""
    lines = []
    for row in rows:
        front = indent + "".join(f"{text:<{width + 2}}" for text, width in zip(row, widths, strict=False))
        lines += wrapped(row[-1], front, " " * len(front))
    return lines


def wrapped(text: str, first: str, others: str) -> list[str]:
    """A text to the width of the terminal, behind `first` in its first line."""
    columns = shutil.get_terminal_size(fallback=(10_000, 24)).columns
    width = max(columns, len(first) + LEAST_TEXT)
    return textwrap.wrap(text, width, initial_indent=first, subsequent_indent=others, break_on_hyphens=False)


def _widths(rows: Sequence[Sequence[str]]) -> list[int]:
    """Of all columns but the last."""
    return [max(map(len, column)) for column in list(zip(*rows, strict=True))[:-1]]


def _print_signals(as_json: bool) -> None:
    from ..signals import SIGNALS

    if as_json:
        found = {s.name: {"type": s.dtype, "unit": s.unit, "meaning": s.meaning} for s in SIGNALS}
        print(json.dumps(found, indent=2))
        return
    rows = [("signal", "unit", "meaning"), *((s.name, s.unit, s.meaning) for s in SIGNALS)]
    print("\n".join(aligned(rows, _widths(rows))))


def _print_effects(as_json: bool) -> None:
    from ..drive.simulated.effects.registry import EFFECTS, PARAMETER_COLUMNS, parameter_cells
    from ..drive.simulated.effects.slots import STAGE_NAMES

    if as_json:
        found = {
            effect.name: {
                "acts_on": STAGE_NAMES[effect.stage], "meaning": effect.description,
                "parameters": [parameter._asdict() for parameter in effect.parameters],
            }
            for effect in EFFECTS.values()
        }  # fmt: skip
        print(json.dumps(found, indent=2))
        return
    cells = {effect.name: [parameter_cells(p) for p in effect.parameters] for effect in EFFECTS.values()}
    widths = _widths([PARAMETER_COLUMNS, *(row for rows in cells.values() for row in rows)])
    lines = wrapped(EFFECTS_HEAD, "", "") + aligned([PARAMETER_COLUMNS], widths, "  ")
    for effect in EFFECTS.values():
        lines += wrapped(f"{effect.description} (acts on: {STAGE_NAMES[effect.stage]})", f"{effect.name}: ", "  ")
        lines += aligned(cells[effect.name], widths, "  ")
    print("\n".join(lines))


def _drives() -> dict[str, DriveProfile]:
    from ..config.drive_profile import read_profile, shipped_profiles

    return {name: read_profile(path) for name, path in shipped_profiles().items()}


def drive_lines() -> list[str]:
    """Each profile of a drive family: name, family, what was tried on what, what must be known."""
    lines = []
    for name, profile in _drives().items():
        lines += wrapped(profile.family, f"{name}  ", "  ")
        for text in profile.notes:
            lines += wrapped(text, "  ", "    ")
    return lines


def _check_all(paths: Sequence[str]) -> None:
    from ..config.checks import shared_buses
    from ..workflows.plan import make_plan, open_drive

    plans = [make_plan(path) for path in paths]
    for plan in plans:
        open_drive(plan)  # an error in the file of a simulated drive, or no EDS, comes before any "ok"
    for plan in plans:
        _check(plan)
    for text in shared_buses([(str(plan.path), plan.axis) for plan in plans]):
        print(f"warning: {text}")


def _check(plan: Plan) -> None:
    from ..can.load import ChainStep
    from ..config.address import address_of, sandbox_problem
    from ..config.axis import loop_axis
    from ..config.checks import bus_sum, drive_limit_words, law_margins
    from ..config.drive_section import CanopenDriveSection
    from ..config.law_costs import law_costs
    from ..config.resolution import coarse_words, resolution_lines
    from ..config.runaway import accepted_words, runaway_lines
    from ..control.friction_observer import TOGGLE_OFF
    from ..recording.disk import life_text
    from ..workflows.recordings import expected_disk_life

    axis, model = plan.axis, plan.model
    margins = law_margins(axis, model, plan.toggle != TOGGLE_OFF)
    print(f"{plan.path}: ok")
    ends = loop_axis(axis, model).inertia_range_nm_s2_per_rev
    loads = "" if ends is None else f", at the worst inertia from {model.inertia_text(*ends)}"
    print(
        f"  loop: {axis.loop.rate_hz} Hz, phase margin {margins.phase_deg:.1f} deg, gain margin {margins.gain:.2f}, "
        f"crossover {margins.crossover_hz:.1f} Hz with {model.delay_s.value * 1e3:g} ms delay{loads}"
    )
    print(f"  profile: {plan.profile.name}, {plan.profile.duration_s:g} s, {plan.profile.values.size} samples")
    if isinstance(axis.drive, CanopenDriveSection):
        for line in resolution_lines(axis, model):
            print(f"  {line}")
        load, chain = bus_sum(axis, model)
        print(
            f"  bus load at {axis.drive.bitrate_hz / 1e6:g} Mbit/s: worst {load.worst:.1%}, typical {load.typical:.1%}"
        )
        print(f"  one period of {chain.period_s * 1e6:.0f} us        worst   typical (us)")
        for step in (*chain.steps, ChainStep("sum", chain.worst_s, chain.typical_s)):
            print(f"    {step.name:<22} {step.worst_s * 1e6:7.0f} {step.typical_s * 1e6:9.0f}")
        if not chain.fits:
            print(
                f"  warning: the worst case is {-chain.slack_s * 1e6:.0f} us beyond the period: a command that "
                "arrives after the next SYNC acts one period later (the drive counts an old set-point)"
            )
    for line in runaway_lines(axis, model):
        print(f"  {line}")
    directory = Path(axis.recording.directory)
    print(f"  recordings in {directory}: {life_text(expected_disk_life(axis, directory))}")
    for text in (*accepted_words(axis, model), *drive_limit_words(axis, model), *coarse_words(axis, model)):
        print(f"  warning: {text}")
    limit_rps = axis.envelope.following_error_rps
    for cost in law_costs(axis, model, plan.profile, plan.toggle != TOGGLE_OFF):
        print(f"  law: {cost}")
        if cost.largest_rps > limit_rps:
            print(f"  warning: that is more than envelope.following_error_rps, {limit_rps:g}: expect the axis to trip")
    for key in ("scope", "foxglove"):
        listen = getattr(axis.daemon, key)
        problem = sandbox_problem(address_of(listen)) if listen is not None else None
        if problem is not None:
            print(f"  warning: daemon.{key}: {problem}")

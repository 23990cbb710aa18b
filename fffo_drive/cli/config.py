"""Check files, and print their schemas and tables.

fffo-drive config check AXIS...     all errors at once; margins, bus load; axes that share a bus
fffo-drive config schema KIND       JSON schema for editors: axis, drive_profile, simulated, model, scenario, facts
fffo-drive config drives            the drive profiles that come with the program, and how each was tested
fffo-drive config signals           table of recorded signals
fffo-drive config effects           table of effects of the simulated drive
"""

from __future__ import annotations

import argparse
import json
from typing import Any

from ..can.load import ChainStep
from ..config.address import address_of, sandbox_problem
from ..config.axis import AxisFile
from ..config.checks import bus_sum, law_margins, shared_buses
from ..config.drive_profile import DriveProfile, read_profile, shipped_profiles
from ..config.drive_section import CanopenDriveSection
from ..config.resolution import coarse_words, resolution_lines
from ..config.scenario import ScenarioFile
from ..config.simulated import SimulatedDriveRecord
from ..control.friction_observer import TOGGLE_OFF
from ..documents import sentence
from ..identification.facts import DriveFacts
from ..model.parameters import ModelFile
from ..signals import SIGNALS
from ..workflows.plan import Plan, make_plan, open_drive

SCHEMAS: dict[str, Any] = {
    "axis": AxisFile,
    "drive_profile": DriveProfile,
    "simulated": SimulatedDriveRecord,
    "model": ModelFile,
    "scenario": ScenarioFile,
    "facts": DriveFacts,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    check = _action(actions, "check", "check axis files and the files they name; show margins and bus load")
    check.add_argument("config", metavar="AXIS", nargs="+", help="axis file (YAML)")
    schema = _action(actions, "schema", "print the JSON schema of a kind of file")
    schema.add_argument("kind", choices=list(SCHEMAS), help="kind of file")
    _action(actions, "drives", "list the profiles of drive families, for drive.profile, and how each was tested")
    _action(actions, "signals", "print the table of recorded signals (Markdown)")
    _action(actions, "effects", "print the table of effects of the simulated drive (Markdown)")


def _action(actions: Any, name: str, text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = actions.add_parser(name, help=text, description=sentence(text))
    return parser


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    if options.action == "check":
        plans = [make_plan(path) for path in options.config]
        for plan in plans:
            if not isinstance(plan.axis.drive, CanopenDriveSection):
                open_drive(plan)  # an error in the file of a simulated drive comes before any "ok"
        for plan in plans:
            _check(plan)
        for text in shared_buses([(str(plan.path), plan.axis) for plan in plans]):
            print(f"warning: {text}")
    elif options.action == "schema":
        print(json.dumps(SCHEMAS[options.kind].model_json_schema(), indent=2))
    elif options.action == "drives":
        print("\n".join(drive_lines()))
    elif options.action == "signals":
        print(signal_table())
    else:
        from ..drive.simulated.effects.registry import effect_table

        print(effect_table())
    return 0


def signal_table() -> str:
    """The recorded signals as a Markdown table."""
    lines = ["| signal | unit | meaning |", "| --- | --- | --- |"]
    lines += [f"| `{s.name}` | {s.unit} | {s.meaning} |" for s in SIGNALS]
    return "\n".join(lines)


def drive_lines() -> list[str]:
    """Each profile of a drive family: name, family, what was tried on what, what must be known."""
    lines = []
    for name, path in shipped_profiles().items():
        profile = read_profile(path)
        lines += [f"{name}  {profile.family}", f"  tried: {profile.tried}", *(f"  {text}" for text in profile.remarks)]
    return lines


def _check(plan: Plan) -> None:
    axis, model = plan.axis, plan.model
    margins = law_margins(axis, model, plan.toggle != TOGGLE_OFF)
    print(f"{plan.path}: ok")
    print(
        f"  loop: {axis.loop.rate_hz} Hz, phase margin {margins.phase_deg:.1f} deg, gain margin {margins.gain:.2f}, "
        f"crossover {margins.crossover_hz:.1f} Hz with {model.delay_s.value * 1e3:g} ms delay"
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
    for text in coarse_words(axis, model):
        print(f"  warning: {text}")
    for key in ("scope", "foxglove"):
        listen = getattr(axis.daemon, key)
        problem = sandbox_problem(address_of(listen)) if listen is not None else None
        if problem is not None:
            print(f"  warning: daemon.{key}: {problem}")

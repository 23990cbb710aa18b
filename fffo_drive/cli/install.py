"""Install the service on a Debian machine (systemd, udev), or remove it.

fffo-drive install                  the unit fffo-drive@.service, udev rule, group, networkd examples, /etc/fffo-drive
fffo-drive install --network can0   also put the networkd files of can0 into effect
fffo-drive install --uninstall      remove everything; files that you edited are kept and listed
fffo-drive install --root DIR       into another root directory (an image); `--program PATH` as seen from there

Nothing is enabled or started. The program must be installed where a service can read it, so not in a home directory:

    python3 -m venv /opt/fffo-drive && /opt/fffo-drive/bin/pip install . && /opt/fffo-drive/bin/fffo-drive install

exit codes: 0 done, 1 files installed but a system program failed, 2 wrong usage, 74 not permitted or disk error,
78 cannot be installed like this
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from ..system.placing import INSTALLED, KEPT, REMOVED, UNCHANGED, UPDATED, PlacedFiles, place_files, remove_files
from ..system.service_files import GROUP, example_interfaces, service_files
from ..system.system_commands import (
    Result,
    active_instances,
    after_install,
    after_removal,
    has_group,
    is_live,
    run_commands,
)
from .exits import EXIT_BAD_INPUT, EXIT_REFUSED

HIDDEN = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")  # from the service: ProtectHome=, PrivateTmp=
ACTIONS = (INSTALLED, UPDATED, UNCHANGED, REMOVED, KEPT)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("--uninstall", action="store_true", help="remove everything")
    parser.add_argument("--root", default="/", metavar="DIR", help="root directory of the machine (/)")
    parser.add_argument("--program", metavar="PATH", help="program that the service starts (default: this one)")
    parser.add_argument(
        "--network",
        action="append",
        default=[],
        metavar="NAME",
        help="put the networkd files of this interface into effect: can0, vcan0",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def execute(options: argparse.Namespace) -> int:
    """Run the subcommand."""
    root = Path(options.root).absolute()  # as groupdel needs it
    problem = _hindrance(root, options)
    if problem:
        print(f"fffo-drive install: {problem}", file=sys.stderr)
        return EXIT_BAD_INPUT
    try:
        if options.uninstall:
            outcomes = remove_files(root)
            commands = after_removal(root)
            results = run_commands(commands if has_group(root) else commands[1:])
        else:
            outcomes = place_files(root, service_files(_program(options), options.network))
            results = run_commands(after_install(root))
    except ValueError as error:  # a broken manifest
        print(f"fffo-drive install: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    print(_as_json(outcomes, results) if options.json else _as_text(root, options.uninstall, outcomes, results))
    return EXIT_REFUSED if any(result.problem for result in results) else 0


def _program(options: argparse.Namespace) -> Path:
    return Path(options.program) if options.program else Path(sys.prefix) / "bin" / "fffo-drive"


def _hindrance(root: Path, options: argparse.Namespace) -> str:
    """Why it cannot be done like this; empty when it can."""
    if not root.is_dir():
        return f"--root {root}: no such directory"
    if options.uninstall:
        running = active_instances() if is_live(root) else []
        return (
            f"{', '.join(running)} is running: first systemctl disable --now {' '.join(running)}, then again"
            if running
            else ""
        )
    unknown = set(options.network) - set(example_interfaces())
    if unknown:
        return f"--network {min(unknown)}: there are files for {', '.join(example_interfaces())}"
    program = _program(options)
    if not program.is_absolute():
        return f"--program {program}: an absolute path is needed"
    if options.program:
        return ""
    if not program.is_file():
        return f"{program}: no such program; is fffo-drive installed with pip? --program names another one"
    hidden = hidden_from_services([program, Path(sys.base_prefix)])
    if hidden is not None:
        return (
            f"{hidden} cannot be seen by a service: make the environment elsewhere with the system's Python "
            "(/usr/bin/python3 -m venv /opt/fffo-drive), install there and call that one's `fffo-drive install`"
        )
    return ""


def hidden_from_services(paths: Sequence[Path]) -> Path | None:
    """The first path, links followed, that the unit's sandbox hides."""
    for path in (one for given in paths for one in (given, given.resolve())):
        if any(path.is_relative_to(directory) for directory in HIDDEN):
            return path
    return None


def _as_text(root: Path, uninstall: bool, outcomes: Sequence[PlacedFiles], results: Sequence[Result]) -> str:
    lines = [f"{outcome.action:<10} {root / outcome.path}" for outcome in outcomes if outcome.action != KEPT]
    note = "edited since it was installed" if uninstall else "not what was installed here: yours"
    lines += [f"{KEPT:<10} {root / outcome.path} ({note})" for outcome in outcomes if outcome.action == KEPT]
    for command, problem in results:
        lines.append(
            f"{'failed' if problem else 'done':<10} {' '.join(command.words)}{f': {problem}' if problem else ''}"
        )
    if not uninstall:
        lines += [
            "",
            "next: edit /etc/fffo-drive/can0.yaml, fffo-drive doctor /etc/fffo-drive/can0.yaml,",
            "      fffo-drive commission /etc/fffo-drive/can0.yaml, systemctl enable --now fffo-drive@can0;",
            f"      usermod -aG {GROUP} NAME for each user of `fffo-drive ctl`",
        ]
    return "\n".join(lines)


def _as_json(outcomes: Sequence[PlacedFiles], results: Sequence[Result]) -> str:
    by_action = {action: [one.path for one in outcomes if one.action == action] for action in ACTIONS}
    ran = [{"command": " ".join(result.command.words), "problem": result.problem} for result in results]
    return json.dumps({**by_action, "commands": ran}, indent=2)

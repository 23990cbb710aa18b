"""The command `fffo-drive`: one module a subcommand, imported only when it is used."""

from __future__ import annotations

import argparse
import difflib
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Sequence

from .. import __version__
from ..workflows.progress import LINES_ENVIRONMENT
from .exits import EXIT_INTERRUPTED, EXIT_WRONG_USAGE, MEANINGS, exit_code_of, message_of, printable

# subcommand -> (module, one line for --help)
COMMANDS = {
    "run": ("run", "run one profile on a drive, in process or on a bus, and record it"),
    "bring-up": ("bring_up", "write the axis file of a drive on a bus: scan, read, measure; moves nothing"),
    "commission": ("commission", "check signs, scales, delay and limits of an axis, and write a record"),
    "sim": ("sim", "run the simulated drive as a CANopen node on a bus"),
    "bench": ("bench", "the paper's comparison live on a loopback bus: PI, PI+FBFO, PI+FFFO, and our PI+FFFO+"),
    "evaluate": ("evaluate", "compare controllers over seeds, on recordings or on a bus"),
    "replay": ("replay", "run a recording through the control law again and compare, bit for bit"),
    "import": ("import_logs", "convert logs of other programs: recognise their columns, write recordings"),
    "identify": ("identify", "fit a model to logs of an axis, with uncertainties and residuals"),
    "diagnose": ("diagnose", "find what the model of an axis lacks, name it, and show the error before and after"),
    "adopt": ("adopt", "put a diagnosed model in service on an axis if all gates pass"),
    "close-the-loop": ("close_the_loop", "run, record, diagnose, adopt, run again: the error before and after"),
    "tune": ("tune", "choose gains for a fitted model, with margins, and write them"),
    "serve": ("serve", "serve an axis as a daemon: supervise, record, listen on Unix sockets"),
    "fleet": ("fleet", "many runs of many drives: store a record of each, compare, report, find wear"),
    "workbench": ("workbench", "record, identify, tune, diagnose and adopt in a browser"),
    "init": ("init", "write the example files: axes, drives, models, profiles, scenarios"),
    "ctl": ("ctl", "control a daemon: status, enable, start, toggle, stop, set, record, events"),
    "scope": ("scope", "print the address of a daemon's scope page, and open it in a browser"),
    "top": ("top", "watch a daemon in the terminal: state, ticks, error, current, recorder"),
    "log": ("log", "read what was recorded: info, recover"),
    "doctor": ("doctor", "check this machine: kernel, limits, CPU, interrupts, CAN interface, lateness"),
    "install": ("install", "install or remove the units, rules and configuration of the service"),
    "drive-info": ("drive_info", "show from the EDS of a drive whether and how it can be used"),
    "config": ("config", "check an axis file, print JSON schemas and tables"),
    "manual": (".manual.command", "open the manual, or build its pages"),  # a layer above: it reads all other commands
}

COMPILES = "compiling for this machine, once for each version: half a minute, longer on a busy machine"
DESCRIPTION = """\
Real-time velocity controller for BLDC servo axes over CANopen: PI plus feed-forward friction observer.

Not a safety function in the sense of IEC 61800-5-2: hardware needs its own emergency stop, STO and limits in the drive.
"""


def build_parser() -> argparse.ArgumentParser:
    """The parser with all subcommands."""
    parser = argparse.ArgumentParser(
        prog="fffo-drive",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="\n".join(("exit codes:", *(f"  {code:<4}{text}" for code, text in MEANINGS.items()))),
    )
    parser.add_argument("--version", action="version", version=f"fffo-drive {__version__}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, (module, summary) in COMMANDS.items():
        subparser = subparsers.add_parser(
            name, help=summary, description=summary, formatter_class=argparse.ArgumentDefaultsHelpFormatter
        )
        subparser.set_defaults(module=module)
    return parser


def parser_of(command: str) -> argparse.ArgumentParser:
    """The parser of one subcommand, with its module's docstring as the description."""
    module = importlib.import_module(f".{COMMANDS[command][0]}", __package__)
    parser = argparse.ArgumentParser(
        prog=f"fffo-drive {command}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point. Returns the exit code; every known error is one message on stderr."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = build_parser()
    command = next((word for word in words if not word.startswith("-")), None)
    if os.environ.get(LINES_ENVIRONMENT):  # a job: it is interrupted even if who began it had that signal ignored
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if command in COMMANDS:
        # numpy is not loaded yet; work is shared out by threads here
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        # files are checked by their own rules alone, and no installed package is searched for others
        os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
        if arguments is None:  # of a process of its own
            from ..jit import say_when_compiling

            say_when_compiling(lambda: print(COMPILES, file=sys.stderr, flush=True))
            warnings.formatwarning = lambda message, *_, **__: f"warning: {message}\n"
        try:
            module = importlib.import_module(f".{COMMANDS[command][0]}", __package__)
            return int(module.execute(parser_of(command).parse_args(words[words.index(command) + 1 :])))
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            return EXIT_INTERRUPTED
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader has seen enough
            return 0
        except Exception as error:
            code = exit_code_of(error)
            if code is None:
                raise
            print(f"fffo-drive {command}: {printable(message_of(error))}", file=sys.stderr)
            return code
    near = difflib.get_close_matches(command or "", COMMANDS, 1)
    if near:
        parser.error(f"argument COMMAND: invalid choice: '{command}'; did you mean '{near[0]}'?")
    parser.parse_args(words)
    return EXIT_WRONG_USAGE

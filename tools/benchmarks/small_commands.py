"""CPU time of commands that compute nothing: help, checks, schemas, lists. With files that are in the disk's cache."""

from __future__ import annotations

import contextlib
import io
import resource
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from common import ROOT, Figures, Report, Variant, finish, interleaved, main, paired_ratio, parser, passes_of, shown

NAME = "small_commands"
LARGEST_S = 0.7
EMPTY, CPU = "python -c pass", "CPU, s"
# what takes long to load; SciPy's own modules load each for itself
HEAVY = (
    "numba",
    "scipy.linalg",
    "scipy.signal",
    "scipy.stats",
    "scipy.optimize",
    "scipy.ndimage",
    "scipy.special",
    "pandas",
    "pyarrow",
    "matplotlib",
    "sklearn",
    "dask",
    "canopen",
)
EDS = "tests/canopen/eds/twice.eds"
SMALL = (
    "--help",
    "ctl --help",
    "log --help",
    "run --help",
    "serve --help",
    "import --help",
    "identify --help",
    "diagnose --help",
    "tune --help",
    "evaluate --help",
    "commission --help",
    "workbench --help",
    "manual --help",
    "init SCRATCH/example",
    "config check configs/axis_simulated.yaml",
    "config check configs/axis_canopen.yaml",
    "config schema axis",
    "config schema scenario",
    "config drives",
    "config signals",
    "config effects",
    "log info tests/releases/0.1.0/run.mcap",
    "doctor --seconds 0",
    "ctl status",
    "scope",
    "top",
    f"drive-info {EDS}",  # the last: `canopen` reads the file
)


def loaded() -> Iterator[tuple[str, list[str]]]:
    """The commands one after the other in this process, and what of `HEAVY` each has loaded that none before it had."""
    from fffo_drive.cli import main as fffo_drive

    for command in SMALL:
        before, silent = set(sys.modules), io.StringIO()
        with (
            _words(command) as words,
            contextlib.redirect_stdout(silent),
            contextlib.redirect_stderr(silent),
            contextlib.suppress(SystemExit),  # of argparse, after help
            contextlib.chdir(ROOT),
        ):
            fffo_drive(words)
        yield command, [name for name in HEAVY if name in sys.modules and name not in before]


@contextlib.contextmanager
def _words(command: str) -> Iterator[list[str]]:
    with tempfile.TemporaryDirectory() as scratch:
        yield shlex.split(command.replace("SCRATCH", str(Path(scratch))))


def _cpu(words: list[str]) -> Figures:
    """Of a process of its own, user and system."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, timeout=120)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {CPU: after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime}


def _command(command: str) -> Figures:
    with _words(command) as words:
        return _cpu(["-m", "fffo_drive", *words])


def run() -> int:
    """The command."""
    options = parser(NAME, __doc__ or "", 9, 1).parse_args()
    variants: dict[str, Variant] = {EMPTY: lambda: _cpu(["-c", "pass"])}
    variants |= {command: partial(_command, command) for command in SMALL}
    for variant in variants.values():  # bytecode and files are in the cache from here on
        variant()
    with shown("commands") as progress:
        found = interleaved(variants, passes_of(options), progress)
    cpu = {name: figures[CPU] for name, figures in found.items()}
    medians = {name: float(np.median(values)) for name, values in cpu.items()}
    dearest = max(SMALL, key=medians.__getitem__)
    report = Report(NAME, "CPU seconds (user and system) of small commands, each in a process of its own, warm.")
    report.figure(f"the dearest (`{dearest}`)", medians[dearest], "s", LARGEST_S)
    report.figure(f"`{EMPTY}`", medians[EMPTY], "s")
    report.table(
        ["command", CPU, f"over `{EMPTY}`"],
        [[f"`{name}`", f"{medians[name]:.2f}", str(paired_ratio(cpu[name], cpu[EMPTY]))] for name in SMALL],
    )
    report.facts["loaded"] = {command: names for command, names in loaded() if names}
    return finish(report, options)


if __name__ == "__main__":
    main(run)

"""Mutants of the envelope against its tests, interpreted: `tools/mutate_envelope` runs all and writes the table.

Each mutant runs in a process forked from one that has everything imported, two at a time. One that the tests do not
notice must be in EQUIVALENT with the reason why it is no other program; the tool fails on any other.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from control.mutation import Mutant, mutants_of

HERE = Path(__file__).resolve().parent
SOURCE = HERE.parents[1] / "fffo_drive" / "control" / "envelope.py"
TABLE = HERE.parents[1] / "tools" / "tables" / "envelope_mutants.md"
MODULE = "fffo_drive.control.envelope"
TESTS = ("test_envelope_edges.py", "test_envelope.py")
PROCESSES = 2
ENOUGH_S = 60  # a mutant that takes longer is stopped, and counts as noticed

# name of a mutant -> why no test can tell it apart; each was looked at by hand
_ONCE = "the bit is not set yet: each is set in one place, on a number that began as 0"
EQUIVALENT: dict[str, str] = {
    "clamp_command: limits |= LIMIT_I2T → limits ^= LIMIT_I2T": _ONCE,
    "clamp_command: limits |= LIMIT_CURRENT → limits ^= LIMIT_CURRENT": _ONCE,
    "clamp_command: limits |= LIMIT_SLEW → limits ^= LIMIT_SLEW": _ONCE,
    "envelope_step: limits |= LIMIT_DRIVE → limits ^= LIMIT_DRIVE": _ONCE,
    "clamp_command: not config.i2t_trips and state.i2t_a2s > i2t_capacity_a2s(config)"
    " → state.i2t_a2s > i2t_capacity_a2s(config)": (
        "with i2t_trips so much heat has tripped already, and a command is clamped only without a trip"
    ),
}

HEAD = """\
# Mutants of the envelope

Made by `tools/mutate_envelope`: every comparison, operator, constant, condition and statement of `control/envelope.py`
is changed in turn, and the tests of the envelope run against each change, interpreted. Detected: {noticed} of {count}.
The others are listed with the reason why no test can tell them from the original. The tool fails if any change that is
not listed here goes undetected; `.ci/run` runs it.

| mutant | why no test can tell it apart |
| --- | --- |
"""


def runs_here() -> None:
    """Raise RuntimeError unless kernels are interpreted: a mutant is never compiled."""
    if os.environ.get("NUMBA_DISABLE_JIT") != "1":
        raise RuntimeError("set NUMBA_DISABLE_JIT=1: mutants run interpreted")


def _start(mutant: Mutant) -> int:
    """The tests with the mutant in the place of the envelope, in a process of their own: its id."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            code = _run_tests(mutant)
        finally:
            os._exit(code)
    return pid


def _run_tests(mutant: Mutant) -> int:
    import signal

    import pytest

    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    signal.alarm(ENOUGH_S)
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    import fffo_drive.control

    specification = importlib.util.spec_from_loader(MODULE, loader=None)
    assert specification is not None
    module = importlib.util.module_from_spec(specification)
    module.__file__ = str(SOURCE)
    module.__package__ = MODULE.rpartition(".")[0]
    sys.modules[MODULE] = module
    fffo_drive.control.envelope = module  # type: ignore[attr-defined]
    exec(compile(mutant.source, str(SOURCE), "exec"), module.__dict__)
    for name in [name for name in sys.modules if name.startswith("control.envelope_spec")]:
        del sys.modules[name]
    words = [
        "-x",
        "-q",
        "--assert=plain",
        "--noconftest",
        "-c",
        os.devnull,
        "--rootdir",
        str(HERE),
        "-p",
        "no:cacheprovider",
    ]
    words += [
        "--import-mode=importlib",
        "-p",
        "no:warnings",
        "-k",
        "not compiled",
        *(str(HERE / test) for test in TESTS),
    ]
    return int(pytest.main(words))


def survivors_of(mutants: Sequence[Mutant]) -> list[str]:
    """Names of those that the tests do not notice, in the given order."""
    runs_here()
    _import_everything()
    running: dict[int, str] = {}
    survivors: set[str] = set()

    def wait_for_one() -> None:
        pid, status = os.wait()
        name = running.pop(pid)
        if status == 0:
            survivors.add(name)
            print(f"not noticed: {name}", file=sys.stderr, flush=True)

    for mutant in mutants:
        if len(running) == PROCESSES:
            wait_for_one()
        running[_start(mutant)] = mutant.name
    while running:
        wait_for_one()
    return [mutant.name for mutant in mutants if mutant.name in survivors]


def _import_everything() -> None:
    """What every mutant needs, once."""
    import pytest  # noqa: F401

    import fffo_drive.control.envelope  # noqa: F401


def make_table(count: int, survivors: Sequence[str]) -> str:
    """The table of the survivors with their reasons."""
    rows = [f"| `{name.replace('|', chr(92) + '|')}` | {EQUIVALENT[name]} |" for name in survivors]
    return HEAD.format(noticed=count - len(survivors), count=count) + "\n".join(rows) + "\n"


def judged(survivors: Sequence[str], mutants: Sequence[Mutant]) -> list[str]:
    """What is wrong: survivors without a reason, and reasons whose mutant (among these) is noticed."""
    names = {mutant.name for mutant in mutants}
    problems = [f"not noticed, and no reason given: {name}" for name in survivors if name not in EQUIVALENT]
    problems += [f"a reason is given, but it is noticed: {name}" for name in EQUIVALENT if name in names - {*survivors}]
    return problems


def main(every: int) -> int:
    """Run every so-many-th mutant; with all of them, write the table. 1 when the table would not be right."""
    mutants = mutants_of(SOURCE.read_text(encoding="utf-8"))
    chosen = mutants[::every]
    survivors = survivors_of(chosen)
    problems = judged(survivors, chosen)
    problems += [f"a reason is given for no mutant: {name}" for name in EQUIVALENT.keys() - {m.name for m in mutants}]
    for problem in problems:
        print(problem, file=sys.stderr)
    if not problems and every == 1:
        TABLE.write_text(make_table(len(mutants), survivors), encoding="utf-8")
    print(f"{len(chosen)} of {len(mutants)} mutants ran, {len(survivors)} of them equivalent")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 1))

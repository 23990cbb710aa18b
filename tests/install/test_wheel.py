"""The wheel is whole: every command of an installed one, typed once as its user would after `fffo-drive init DIR`.

The wheel is built and installed into an environment of its own. Of the test environment it sees the libraries alone;
home, runtime directory and working directory are new. It is given what the source tree has compiled, minutes of work,
and compiles one small kernel of its own. A command without a line here fails by name.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from buses import PATIENCE_S
from daemon.rig import PATIENT, PATIENT_DAEMON, PATIENT_DRIVE, PATIENT_LIMITS, edit
from importing.axis_log import Dialect, as_text, truth
from install.test_install import PROGRAM
from numba.core.caching import UserProvidedCacheLocator

from fffo_drive.can.link import free_loopback_port
from fffo_drive.cli import COMMANDS, parser_of
from fffo_drive.cli.exits import EXIT_BAD_INPUT, EXIT_DRIVE_FAULT
from fffo_drive.jit import PACKAGE_DIRECTORY, cache_directory

PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"
# `commission` ends with it where a busy machine misses a limit of time; the record is written all the same
NOT_PASSED = EXIT_DRIVE_FAULT


class Typed(NamedTuple):
    """One line: `says` is in what it prints, `makes` is a file that was not there before."""

    line: str
    says: str = ""
    makes: str = ""
    codes: tuple[int, ...] = (0,)


IN_PROCESS = (
    Typed("config check configs/axis_simulated.yaml configs/axis_undeclared.yaml", "axis_undeclared.yaml: ok"),
    Typed("config schema axis", '"proportional_a_per_rps"'),
    Typed("config drives", "maxon_epos4"),
    Typed("config signals", "velocity_rps"),
    Typed("config effects", "cogging"),
    Typed("log info work.mcap", "complete"),
    Typed("log export work.mcap --to 0.5 --out part.mcap", "1000 rows", "part.mcap"),
    Typed("log recover torn.mcap.part whole.mcap", "bytes discarded", "whole.mcap"),
    Typed("replay work.mcap", "bit for bit"),
    Typed("close-the-loop configs/axis_undeclared.yaml --quick --out circle", "found: cogging", "circle/report.html"),
    Typed("identify circle/identify.mcap circle/before.mcap --out model", "+-", "model/model.yaml"),
    Typed("tune model/model.yaml --axis short.yaml --out tuned", "phase margin", "tuned/short.yaml"),
    Typed(
        "diagnose --fit circle/identify.mcap circle/other.mcap --held-out circle/before.mcap --out found",
        "model lacks: cogging",
        "found/model.yaml",
    ),
    Typed("adopt found/model.yaml --axis configs/axis_undeclared.yaml", "before: models/table1.yaml"),
    Typed("evaluate short_scenario.yaml --seeds 1 --workers 1 --out compared", "ISE", "compared/report.html"),
    Typed(
        "import speed.csv --torque-constant 0.148 --out imported --yes", "inertia and friction", "imported/facts.yaml"
    ),
    Typed("fleet add store work.mcap circle/before.mcap", "fleet work store", "store/store.json"),
    Typed("fleet work store --workers 1", "2 records made"),
    Typed("fleet status store", "100 % done"),
    Typed("fleet compact store", "2 records in 1 file"),
    Typed("fleet report store --out population", "2 runs", "population/report.html"),
    Typed("fleet answer", "for yourself use fleet add --work", codes=(EXIT_BAD_INPUT,)),
    Typed("fleet watch store", "a change is looked for from run 9 on"),
    Typed("fleet diagnose store --out changed", "changed/report.html", "changed/report.json"),
    Typed("fleet compare work.mcap circle/before.mcap --out differences", "1 run against 1", "differences/report.html"),
    Typed("sim configs/simulated_drive.yaml --eds drive.eds", "wrote drive.eds", "drive.eds"),
    Typed("drive-info drive.eds", "can be used, as far as the file says"),
    Typed("doctor configs/axis_bench.yaml --seconds 0.1 --record machine", "clock source", "machine", (0, 1)),
    Typed(f"install --root root --program {PROGRAM}", "fffo-drive@.service", "root/etc/fffo-drive/can0.yaml"),
    Typed("manual --path", "fffo_drive/manual/built/index.html"),
    Typed("bench --config patient.yaml --drive patient_drive.yaml --out bench", "PI+FFFO", "bench"),
)
FROM_A_BUS = (Typed("bring-up {bus} --out axis.yaml --yes --seconds 0.2", "commission axis.yaml", "axis.yaml"),)
ON_A_BUS = (
    Typed("commission axis.yaml --yes", "torque_sign", "axis.commissioning.yaml", (0, NOT_PASSED)),
    Typed("run axis.yaml --uncommissioned --out bus.mcap", "ISE", "bus.mcap"),
)
BEFORE_TORQUE = (
    Typed("ctl --sockets s info", "protocol"),
    Typed("ctl --sockets s status", "ready, for"),
    Typed("ctl --sockets s schema", "quick_stop"),
    Typed("ctl --sockets s model configs/models/table1.yaml", "table1"),
    Typed("ctl --sockets s reload", "applied:"),
    Typed("ctl --sockets s record on", "on: True"),
)
WITH_TORQUE = (
    Typed("ctl --sockets s enable", "state: enabled, reached: True"),
    Typed("ctl --sockets s toggle fb", "toggle: fb"),
    Typed("ctl --sockets s set controller.proportional_a_per_rps 0.9", "value: 0.9"),
    Typed("ctl --sockets s start gentle.yaml --wait-s 60", "state: enabled"),
    Typed("ctl --sockets s velocity 1 --run-on --wait-s 60", "to_rps: 1"),
    Typed("ctl --sockets s step 0.5 --run-on --wait-s 60", "to_rps: 1.5"),
)
WHILE_IT_TURNS = (
    Typed("top --sockets s --once", "following"),
    Typed("scope --sockets s", "http://127.0.0.1:"),
)
THE_END = (
    Typed("ctl --sockets s stop --wait-s 60", "rps measured; state: enabled"),
    Typed("ctl --sockets s quick-stop --wait-s 60", "rps measured; state: ready"),
    Typed("ctl --sockets s disable", "rps measured; state: ready"),
    Typed("ctl --sockets s reset-fault", "only in fault", codes=(EXIT_DRIVE_FAULT,)),
    Typed("ctl --sockets s record off", ".mcap"),
    Typed("ctl --sockets s events", "quick_stop"),
)
RUN = Typed("run short.yaml --out work.mcap", "0 skipped", "work.mcap")
INIT = Typed("init bench", "cd bench", "bench/configs/axis_bench.yaml")
LIBRARY = f"import fffo_drive as fd; print(fd.__file__); print(fd.replay('{RUN.makes}').exact)"
KERNEL = "from fffo_drive.control.notch import notches_at_rest; notches_at_rest()"  # a small one
SIM = "sim patient_drive.yaml --bus {bus}"
SERVE = "serve patient.yaml --bus {bus} --sockets s --uncommissioned --scope 0"
WORKBENCH = "workbench configs/axis_undeclared.yaml --out work --no-browser"
JOG, SUBSCRIBE = "ctl --sockets s jog 1", "ctl --sockets s subscribe --status-hz 10"
ALL = (INIT, RUN, *IN_PROCESS, *FROM_A_BUS, *ON_A_BUS, *BEFORE_TORQUE, *WITH_TORQUE, *WHILE_IT_TURNS, *THE_END)
LINES = [SIM, SERVE, WORKBENCH, JOG, SUBSCRIBE, *(typed.line for typed in ALL)]


def subcommands(command: str) -> tuple[str, list[str]]:
    """Where the parser puts the name of the subcommand, and the names; none for most commands."""
    for action in parser_of(command)._actions:
        if isinstance(action, argparse._SubParsersAction):
            return action.dest, list(action.choices)
    return "", []


def command_of(line: str) -> str:
    """Command and subcommand of a line, as the program's own parser takes it."""
    command, *words = shlex.split(line)
    place, _ = subcommands(command)
    name = getattr(parser_of(command).parse_args(words), place) if place else ""
    return f"{command} {name}".strip()


def test_every_command_and_subcommand_is_typed():
    there = {f"{command} {name}".strip() for command in COMMANDS for name in subcommands(command)[1] or [""]}
    assert there - set(map(command_of, LINES)) == set()


@pytest.fixture(scope="module")
def environment(wheel, tmp_path_factory) -> dict[str, str]:
    """Variables of a new user with the wheel installed: nothing of the tests but their libraries."""
    place = tmp_path_factory.mktemp("clean")
    venv, home = place / "venv", place / "home"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", venv], check=True)
    pip = [sys.executable, "-m", "pip", "--python", venv / "bin" / "python", "install", "--quiet", "--no-index"]
    subprocess.run([*pip, "--no-deps", wheel], check=True)
    # the libraries come after the wheel; an editable installation there is a .pth file, which is not read from here
    site = venv / "lib" / PYTHON / "site-packages"
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    share_kernels(site / "fffo_drive", home / ".cache" / "fffo_drive" / "numba")
    (home / "run").mkdir(mode=0o700, parents=True)
    return {
        "PATH": f"{venv / 'bin'}:/usr/bin:/bin", "HOME": str(home), "XDG_RUNTIME_DIR": str(home / "run"),
        "XDG_CACHE_HOME": str(home / ".cache"), "LANG": "C.UTF-8", "COLUMNS": "200", "PYTHONUNBUFFERED": "1",
    }  # fmt: skip


def share_kernels(installed: Path, cache: Path) -> None:
    """Give what is compiled of the source tree to the same files elsewhere: numba knows them by path and time."""
    there = cache / cache_directory().name
    for path in PACKAGE_DIRECTORY.rglob("*.py"):
        copy = installed / path.relative_to(PACKAGE_DIRECTORY)
        assert copy.read_bytes() == path.read_bytes()
        os.utime(copy, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns))
        of_source, of_copy = (UserProvidedCacheLocator.get_suitable_cache_subpath(str(file)) for file in (path, copy))
        if (cache_directory() / of_source).is_dir() and not (there / of_copy).exists():
            unfinished = shutil.ignore_patterns("*.tmp.*")
            shutil.copytree(cache_directory() / of_source, there / of_copy, ignore=unfinished)


class User:
    """Who types in a directory, and what was wrong with the answers."""

    def __init__(self, environment: dict[str, str], place: Path, bus: str) -> None:
        self.environment, self.place, self.bus = environment, place, bus
        self.wrong: list[str] = []
        self.program = Path(environment["PATH"].partition(":")[0]) / "fffo-drive"
        self.python = self.program.with_name("python")

    def words(self, line: str) -> list[str]:
        return [str(self.program), *shlex.split(line.format(bus=self.bus))]

    def type(self, *lines: Typed) -> None:
        """One after the other; each is waited for."""
        for typed in lines:
            there = bool(typed.makes) and (self.place / typed.makes).exists()
            began_s = time.monotonic()
            done = subprocess.run(
                self.words(typed.line), cwd=self.place, env=self.environment, capture_output=True, text=True,
                stdin=subprocess.DEVNULL,
            )  # fmt: skip
            made = not typed.makes or (self.place / typed.makes).exists()
            printed = done.stdout + done.stderr
            good = done.returncode in typed.codes and typed.says in printed and made and not there
            self.note(typed.line, good, time.monotonic() - began_s, f"-> {done.returncode}\n{printed}")

    def note(self, line: str, good: bool, seconds: float, said: str) -> None:
        print(f"{'ok   ' if good else 'WRONG'} {seconds:6.1f} s  fffo-drive {line}")
        if not good:
            self.wrong.append(f"$ fffo-drive {line} {said}")
            print(said)

    @contextmanager
    def beside(self, line: str, says: str, ended_by: int, codes: tuple[int, ...] = (0,)) -> Iterator[None]:
        """A command that goes on until it is ended; from the line on with which it is at work."""
        began_s = time.monotonic()
        process = subprocess.Popen(
            self.words(line), cwd=self.place, env=self.environment, text=True, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, preexec_fn=hears_interrupts,
        )  # fmt: skip
        assert process.stdout is not None
        with bounded(process.kill):
            heard = []
            for text in process.stdout:
                heard.append(text)
                if says in text:
                    break
        seconds = time.monotonic() - began_s
        try:
            yield
        finally:
            process.send_signal(ended_by)
            with bounded(process.kill):
                rest, _ = process.communicate()
        said = "".join(heard)
        good = says in said and process.returncode in codes
        self.note(line, good, seconds, f"-> {process.returncode}\n{said}{rest}")


def hears_interrupts() -> None:
    """As at a terminal: a shell has its background jobs ignore Ctrl-C, and what they start as well."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def bounded(give_up: Callable[[], None]) -> Iterator[None]:
    """Whatever is waited for here ends."""
    timer = threading.Timer(PATIENCE_S, give_up)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def own_files(place: Path) -> None:
    """What a user would write beside the examples: short profiles, patience with a shared machine, a log."""
    configs = place / "configs"
    axis = (configs / "axis_simulated.yaml").read_text()
    assert "duration_s: 60" in axis
    axis = axis.replace("duration_s: 60", "duration_s: 4").replace(
        "simulated_drive.yaml", "configs/simulated_drive.yaml"
    )
    (place / "short.yaml").write_text(axis.replace("models/table1.yaml", "configs/models/table1.yaml"))
    scenario = (configs / "scenarios" / "paper.yaml").read_text()
    scenario = scenario.replace("../axis_simulated.yaml", "short.yaml").replace("duration_s: 60", "duration_s: 5")
    (place / "short_scenario.yaml").write_text(scenario)
    (place / "gentle.yaml").write_text("{kind: sine, duration_s: 0.5, amplitude: 0.5, frequency_hz: 2}\n")
    (place / "speed.csv").write_text(as_text(truth(), Dialect()))
    (place / "root").mkdir()
    (place / "patient.yaml").write_text((configs / "axis_bench.yaml").read_text())
    edit(place / "patient.yaml", lambda axis: axis.update(PATIENT, model="configs/models/table1.yaml"))
    edit(place / "patient.yaml", be_patient)
    drive = (configs / "simulated_drive.yaml").read_text()
    assert "tolerance_ms: 500 " in drive
    (place / "patient_drive.yaml").write_text(drive.replace("tolerance_ms: 500 ", "tolerance_ms: 10000 "))


def be_patient(axis: dict[str, Any]) -> None:
    """An axis that forgives a shared machine its pauses."""
    axis["drive"] |= PATIENT_DRIVE
    axis["envelope"] |= PATIENT_LIMITS
    axis["daemon"] = PATIENT_DAEMON
    axis["profile"]["duration_s"] = 2


def without_observer(axis: dict[str, Any]) -> None:
    """As `bring-up` wrote it: PyYAML takes its `off` for false."""
    axis["controller"]["observer"] = {"toggle": "off"}


@pytest.mark.long  # and live, but patient with a machine that does other things beside it
@pytest.mark.timeout(1200)
def test_every_command_works_from_an_installed_wheel(environment, tmp_path):
    began_s = time.monotonic()
    user = User(environment, tmp_path, f"loopback:{free_loopback_port()}")
    user.type(INIT)
    user.place = tmp_path / "bench"
    own_files(user.place)
    user.type(RUN)
    library = [user.python, "-c", LIBRARY]
    done = subprocess.run(library, cwd=user.place, env=environment, capture_output=True, text=True, check=True)
    where, exact = done.stdout.splitlines()
    assert Path(where).is_relative_to(user.python.parents[1])
    assert exact == "True"
    new = environment | {"NUMBA_CACHE_DIR": str(tmp_path / "compiled")}
    subprocess.run([user.python, "-c", KERNEL], cwd=user.place, env=new, check=True)
    assert list((tmp_path / "compiled").rglob("*.nbc"))
    recording = (user.place / RUN.makes).read_bytes()
    (user.place / "torn.mcap.part").write_bytes(recording[: len(recording) // 2])
    user.type(*IN_PROCESS)
    with user.beside(WORKBENCH, "Ctrl-C ends it", signal.SIGINT):
        assert (user.place / "work" / "runs").is_dir()
    with user.beside(SIM, "ready", signal.SIGTERM):
        user.type(*FROM_A_BUS)
        edit(user.place / "axis.yaml", be_patient)
        edit(user.place / "axis.yaml", without_observer)
        user.type(*ON_A_BUS)
    with user.beside(SIM, "ready", signal.SIGTERM), user.beside(SERVE, "connected -> ready", signal.SIGTERM):
        user.type(*BEFORE_TORQUE)
        with user.beside(SUBSCRIBE, "rps of", signal.SIGTERM, (-signal.SIGTERM,)):
            user.type(*WITH_TORQUE)
            with user.beside(JOG, "to_rps: 1", signal.SIGINT):
                user.type(*WHILE_IT_TURNS)
            user.type(*THE_END)
    print(f"{time.monotonic() - began_s:.0f} s")
    assert user.wrong == []

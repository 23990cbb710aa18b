"""The simulated drive's plant against the same plant in C, and the closed loop in process in times real time."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common import ROOT, Figures, Report, commit_of, finish, interleaved, main, paired_ratio, parser, passes_of, shown
from in_c import Declarations, compile_c, compiler_version, packed
from numba import typeof
from plant_step import Floats, drive_plant

from fffo_drive.control.friction_observer import TOGGLE_FEEDFORWARD
from fffo_drive.drive.simulated import friction, noise
from fffo_drive.drive.simulated import state as at
from fffo_drive.drive.simulated.pack import new_state, plant_parameters
from fffo_drive.drive.simulated.parameters import PlantConfig
from fffo_drive.runtime import blocks as b
from fffo_drive.runtime.runs import simulated_ring_rows
from fffo_drive.runtime.session import Session
from fffo_drive.workflows.plan import make_plan, open_drive, plan_session

NAME = "plant"
AXIS = ROOT / "configs" / "axis_simulated.yaml"
TARGET = 1.3
SPEED_UP = 1.4  # of the closed loop over that of commit 095d31a
SUBSTEPS_PER_TICK = 11
REPEATS = 8  # runs of a variant in a pass, of which the least disturbed counts
TICK_S = 0.0005
FRICTION_CONSTANTS = (
    "COULOMB_NM", "RISE_NM", "VISCOUS_NM", "PER_STRIBECK", "STRIBECK_EXPONENT", "STIFFNESS", "ELASTIC_SHARE", "MEMORY",
    "TABLE_COLUMNS", "CONTACT_NM", "STICTION", "STATE_COLUMNS",
)  # fmt: skip
PRIVATE = {"NORMAL_MEAN": "_MEAN", "NORMAL_PER_DEVIATION": "_PER_DEVIATION"}  # of noise


class Plants:
    """One plant in both languages, under the same commands from the same seed."""

    def __init__(self, config: PlantConfig, commands_a: Floats) -> None:
        self._config = config
        self._commands_a = commands_a
        self._parameters = plant_parameters(config)
        declarations = Declarations()
        declarations.constants(at)
        declarations.constants(friction, *FRICTION_CONSTANTS)
        declarations.numbers({name: getattr(noise, private) for name, private in PRIVATE.items()})
        declarations.record(self._parameters)
        declarations.record(new_state(config))
        self._in_c = compile_c("plant.c", declarations.text)
        arguments = (self._parameters, new_state(config), commands_a, commands_a, SUBSTEPS_PER_TICK)
        drive_plant.compile(tuple(typeof(argument) for argument in arguments))  # type: ignore[attr-defined]

    def run(self, language: str) -> tuple[float, Floats, at.PlantState]:
        """Nanoseconds a sub-step, measured velocity (ticks,), and the state in the end, by "numba" or "C"."""
        state = new_state(self._config)
        velocities_rps = np.zeros_like(self._commands_a)
        ticks = self._commands_a.size
        if language == "C":
            records = [ctypes.create_string_buffer(packed(record)) for record in (self._parameters, state)]
            arrays = [ctypes.c_void_p(array.ctypes.data) for array in (self._commands_a, velocities_rps)]
            counts = (ctypes.c_int64(ticks), ctypes.c_int64(SUBSTEPS_PER_TICK))
            begin_ns = time.perf_counter_ns()
            self._in_c.drive_plant(*records, *arrays, *counts)
        else:
            begin_ns = time.perf_counter_ns()
            drive_plant(self._parameters, state, self._commands_a, velocities_rps, SUBSTEPS_PER_TICK)
        spent_ns = time.perf_counter_ns() - begin_ns
        return spent_ns / (ticks * SUBSTEPS_PER_TICK), velocities_rps, state

    def least(self, language: str) -> Figures:
        """The best of a few runs."""
        return {"substep": min(self.run(language)[0] for _ in range(REPEATS))}


def commands(ticks: int) -> Floats:
    """Currents (A) that bring the shaft through standstill, presliding and speed, again and again."""
    time_s = np.arange(ticks) * TICK_S
    return np.asarray(1.2 * np.sin(2.0 * np.pi * 0.7 * time_s) + 0.5 * np.sin(2.0 * np.pi * 6.1 * time_s))


def differing_parts(plants: Plants) -> list[str]:
    """Parts that are not bit for bit the same in both languages."""
    _, ours, state = plants.run("numba")
    _, theirs, other = plants.run("C")
    parts: dict[str, tuple[Any, Any]] = {"measured velocity": (ours, theirs)}
    parts |= {name: (one, two) for name, one, two in zip(state._fields, state, other, strict=True)}
    return [name for name, (one, two) in parts.items() if one.tobytes() != two.tobytes()]


class ClosedLoop:
    """The shipped axis on the simulated drive in process, again and again."""

    def __init__(self, seconds: float) -> None:
        self._plan = make_plan(AXIS)
        profile = self._plan.profile
        ticks = min(round(seconds / profile.period_s), profile.values.size)
        self._profile = profile._replace(values=profile.values[:ticks], derivatives=profile.derivatives[:ticks])
        self._rows = simulated_ring_rows(self._profile, self._plan.axis.loop.tail_s)

    def run(self) -> float:
        """Nanoseconds a tick of one run under FFFO."""
        drive = open_drive(self._plan)
        drive.connect()
        session = Session(drive, plan_session(self._plan, self._rows))
        session.compile()
        begin_ns = time.perf_counter_ns()
        ticks = session.run_profile(self._profile, TOGGLE_FEEDFORWARD)
        spent_ns = time.perf_counter_ns() - begin_ns
        if session.status(b.TRIP) != 0:
            raise RuntimeError("the loop tripped: this measures nothing")
        return spent_ns / ticks

    def least(self) -> Figures:
        """The best of a few runs, as time of a tick and in times real time."""
        tick_ns = min(self.run() for _ in range(REPEATS))
        return {"tick": tick_ns, "times": self._profile.period_s * 1e9 / tick_ns}


class EarlierLoop:
    """The closed loop of another checkout, in a process of its own: an earlier commit, in the same passes."""

    _SERVE = (
        "import sys; sys.path.insert(0, sys.argv[1] + '/tools/benchmarks')\n"
        "from plant import ClosedLoop\n"
        "loop = ClosedLoop(float(sys.argv[2])); loop.run(); print('ready', flush=True)\n"
        "for _ in sys.stdin: print(loop.least()['tick'], flush=True)\n"
    )

    def __init__(self, checkout: Path, seconds: float) -> None:
        place = str(checkout.resolve())
        python = [sys.executable, "-c", self._SERVE, place, str(seconds)]
        environment = os.environ | {"PYTHONPATH": place}
        self._process = subprocess.Popen(
            python, cwd=place, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        if self._answer() != "ready":
            raise RuntimeError(f"{checkout}: its closed loop does not run")

    def _answer(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()

    def least(self) -> Figures:
        """As ClosedLoop.least."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return {"tick": float(self._answer())}


def run() -> int:
    """The command."""
    options = parser(NAME, __doc__ or "", 40, 6)
    options.add_argument("--seconds", type=float, help="simulated time of a run (default 0.5; 0.25 with --sample)")
    options.add_argument(
        "--against", type=Path, metavar="CHECKOUT", help="a checkout of an earlier commit: the closed loop beside its"
    )
    chosen = options.parse_args()
    seconds = chosen.seconds or (0.25 if chosen.sample else 0.5)
    report = Report(
        NAME, "The plant's sub-step of 1/22 kHz (five surfaces, current loop, resolver), by numba and by gcc -O2."
    )
    plants = Plants(PlantConfig(), commands(round(seconds / TICK_S)))
    quiet = Plants(replace(PlantConfig(), roughness_nm=0.0), commands(4000))
    differing = differing_parts(plants) + differing_parts(quiet)
    report.facts["differing parts"] = differing
    if differing:
        raise RuntimeError(f"not the same plant: {', '.join(differing)} differ between numba and C")
    variants = {
        "numba": lambda: plants.least("numba"),
        "C": lambda: plants.least("C"),
        "closed loop": ClosedLoop(16.0 * seconds).least,
    }
    if chosen.against is not None:
        variants["earlier"] = EarlierLoop(chosen.against, 16.0 * seconds).least
    with shown(NAME) as progress:
        found = interleaved(variants, passes_of(chosen), progress)
    ours, theirs, loop = found["numba"]["substep"], found["C"]["substep"], found["closed loop"]
    report.ratio("sub-step, numba over C", paired_ratio(ours, theirs), TARGET)
    report.figure("closed loop in process, times real time (median)", float(np.median(loop["times"])), "")
    report.figure("closed loop in process, times real time (best pass)", float(loop["times"].max()), "")
    if chosen.against is not None:
        earlier = f"closed loop in process, a tick over that of {commit_of(chosen.against)}"
        report.ratio(earlier, paired_ratio(loop["tick"], found["earlier"]["tick"]), 1.0 / SPEED_UP)
    rows = [
        (name, f"{values.min():.0f}", f"{np.median(values):.0f}") for name, values in (("numba", ours), ("C", theirs))
    ]
    rows.append(("closed loop, a tick", f"{loop['tick'].min():.0f}", f"{np.median(loop['tick']):.0f}"))
    report.table(("variant", "least, ns", "median, ns"), rows)
    report.notes += [
        f"{passes_of(chosen)} passes; each takes the best of {REPEATS} runs of {seconds:g} s of simulated time.",
        f"C by {compiler_version()}, -O2.",
        "Final state and measured velocity are the same in both, bit for bit.",
        "The closed loop is the shipped axis on the five-surface drive, sensor noise included, under FFFO:"
        f" the best of {REPEATS} runs of {16.0 * seconds:g} s a pass.",
    ]
    return finish(report, chosen)


if __name__ == "__main__":
    main(run)

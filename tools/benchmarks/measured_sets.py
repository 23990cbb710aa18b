"""Measured machines as plain logs: what their authors published, as csv files and a `drive.yaml` of declared facts.

A set is a folder. Its logs are uniform in time and hold `time_s`, `current_command_a`, `position_rev` and, where the
machine has them, `velocity_rps` and `reference_rps`. Nothing is filtered, and nothing is invented: samples stand for
each other only within the period in which the logger missed one.

LAAS (MN4004 outrunner, heitor-andrade/laas_anti_cogging, BSD-3-Clause), BAM (XL330 servo on a pendulum, Rhoban/bam,
Apache-2.0), EMPS (Janot, Gautier and Brunot, 2019), Lorenz (servo with a disc, TeacherRock/Lorenz_Friction), TX40
(joints of a Staubli robot, thanhndv212/figaroh-examples).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.io import loadmat

Floats = np.ndarray[Any, np.dtype[np.float64]]

TURN = 2.0 * math.pi  # rad a revolution
LAAS_RATE_HZ = 1000.0
BAM_RATE_HZ = 200.0
FULL_LOAD = 1000.0  # counts of load at full voltage
WRAP = 1 << 16  # load is an unsigned number of 16 bits that stands for a signed one
BAM_ENDS = 20  # samples left out where the torque is switched
LORENZ_RATE_HZ = 1000.0
TX40_RATE_HZ = 5000.0
TX40_JOINTS = (1, 6)

LAAS_FACTS = {
    "torque_constant_nm_per_a": 0.025, "pole_pairs": 12, "slots": 18, "position_lsb_rev": 5.0e-5,
    "sample_rate_hz": LAAS_RATE_HZ,
}  # fmt: skip
# the commanded quantity is a voltage: the torque constant is one by declaration, and torque is in V
BAM_FACTS = {
    "torque_constant_nm_per_a": 1.0, "resolver_bits": 12, "sample_rate_hz": BAM_RATE_HZ, "absolute_angle": True,
}  # fmt: skip
EMPS_FACTS = {
    "torque_constant_nm_per_a": 35.15065, "units": "linear", "position_lsb_rev": 5.0e-8, "sample_rate_hz": 1000.0,
}  # fmt: skip
# torque is logged in Nm: the torque constant is one by declaration
LORENZ_FACTS = {"torque_constant_nm_per_a": 1.0, "position_lsb_rev": 1.0e-4, "sample_rate_hz": LORENZ_RATE_HZ}
# nobody published the torque constants of the joints: torque is in A
TX40_FACTS = {"torque_constant_nm_per_a": 1.0, "position_lsb_rev": 1.0e-6, "sample_rate_hz": TX40_RATE_HZ}
DECIMALS = {"time_s": 4, "current_command_a": 6, "position_rev": 9, "velocity_rps": 6, "reference_rps": 6}


def write_log(path: Path, columns: Mapping[str, Floats]) -> None:
    """One log as csv; columns (n,) by the names of `DECIMALS`."""
    names = [name for name in DECIMALS if name in columns]
    values = np.stack([columns[name] for name in names], axis=1)
    formats = [f"%.{DECIMALS[name]}f" for name in names]
    np.savetxt(path, values, fmt=formats, delimiter=",", header=",".join(names), comments="")


def _begin(out: Path, facts: Mapping[str, Any]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    (out / "drive.yaml").write_text(yaml.safe_dump(dict(facts), sort_keys=False))


def write_laas(source: Path, out: Path) -> None:
    """Each file as a whole, and its halves `_a`, `_b`: with the authors' anti-cogging and without (or the reverse)."""
    _begin(out, LAAS_FACTS)
    for path in sorted(source.glob("*.txt")):
        lines = [line.split(",") for line in path.read_text().splitlines()[1:]]
        rows = np.array([line for line in lines if len(line) == 6], dtype=float)  # one file ends in the middle of one
        rows = rows[np.concatenate([[True], np.diff(rows[:, 0]) > 0.0])]
        edge = int(np.flatnonzero(np.diff(rows[:, 5]))[0]) + 1
        for name, part in (("", rows), ("_a", rows[:edge]), ("_b", rows[edge:])):
            time_s = np.arange(part[0, 0], part[-1, 0], 1.0 / LAAS_RATE_HZ)
            position, velocity, reference, current = (np.interp(time_s, part[:, 0], part[:, k]) for k in (1, 2, 3, 4))
            columns = {
                "time_s": time_s, "current_command_a": current, "position_rev": position / TURN,
                "velocity_rps": velocity / TURN, "reference_rps": reference / TURN,
            }  # fmt: skip
            write_log(out / f"{path.stem}{name}.csv", columns)


def write_bam(source: Path, out: Path) -> None:
    """A log a run, `kp100_sin_sin` and so on: the part under torque, supply times load (V) as the command."""
    _begin(out, BAM_FACTS)
    for path in sorted(source.glob("*.json")):
        run = json.loads(path.read_text())
        columns = {key: np.array([e[key] for e in run["entries"]], dtype=float) for key in run["entries"][0]}
        load = np.where(columns["load"] >= WRAP // 2, columns["load"] - WRAP, columns["load"])
        stamps = columns["timestamp"]
        time_s = np.arange(stamps[0], stamps[-1], 1.0 / BAM_RATE_HZ)
        volts, position, goal, on = (
            np.interp(time_s, stamps, values)
            for values in (
                columns["input_volts"] * load / FULL_LOAD, columns["position"], columns["goal_position"],
                columns["torque_enable"],
            )
        )  # fmt: skip
        powered = np.flatnonzero(on > 0.99)  # from the beginning of each run to where it is let go
        kept = slice(int(powered[0]) + BAM_ENDS, int(powered[-1]) + 1 - BAM_ENDS)
        asked = {
            "time_s": time_s, "current_command_a": volts, "position_rev": position / TURN,
            "reference_rps": np.gradient(goal / TURN, 1.0 / BAM_RATE_HZ),
        }  # fmt: skip
        name = f"kp{run['kp']}_{run['trajectory']}"
        write_log(out / f"{name}.csv", {key: values[kept] for key, values in asked.items()})


def write_emps(source: Path, out: Path) -> None:
    """Both files: m for revolutions, V for A."""
    _begin(out, EMPS_FACTS)
    for path in sorted(source.glob("*.mat")):
        data = {key: np.ravel(values) for key, values in loadmat(path).items() if not key.startswith("__")}
        columns = {"time_s": data["t"], "current_command_a": data["vir"], "position_rev": data["qm"]}
        write_log(out / f"{path.stem}.csv", columns)


def write_lorenz(source: Path, out: Path) -> None:
    """A log a run, `Jm_1` and so on: position, velocity, their set points, torque."""
    _begin(out, LORENZ_FACTS)
    for path in sorted(source.glob("Lorenz_*.txt")):
        position, velocity, _, reference, torque = np.loadtxt(path).T
        columns = {
            "time_s": np.arange(position.size) / LORENZ_RATE_HZ,
            "current_command_a": torque,
            "position_rev": position / TURN,
            "velocity_rps": velocity / TURN,
            "reference_rps": reference / TURN,
        }
        write_log(out / f"{path.stem.removeprefix('Lorenz_')}.csv", columns)


def write_tx40(source: Path, out: Path) -> None:
    """Halves `_a`, `_b` of the one recording, for each joint."""
    _begin(out, TX40_FACTS)
    position, current = (
        np.genfromtxt(source / name, delimiter=",", names=True) for name in ("pos_read_data.csv", "curr_data.csv")
    )
    for joint in TX40_JOINTS:
        column = f"Joint_{joint}"
        time_s = np.arange(position.size) / TX40_RATE_HZ
        columns = {
            "time_s": time_s,
            "current_command_a": current[column],
            "position_rev": position[column] / TURN,
        }
        middle = time_s.size // 2
        for name, half in (("a", slice(0, middle)), ("b", slice(middle, None))):
            write_log(out / f"joint{joint}_{name}.csv", {key: values[half] for key, values in columns.items()})


WRITERS = {"laas": write_laas, "bam": write_bam, "emps": write_emps, "lorenz": write_lorenz, "tx40": write_tx40}


def write_all(data: Path, out: Path, machines: Iterable[str] = tuple(WRITERS)) -> None:
    """The sets of these machines below `out`; `data`: the folder with measured/ and emps/."""
    for name in machines:
        write = WRITERS[name]
        write(data / "emps" if name == "emps" else data / "measured" / name, out / name)

"""Runs of axes whose every number is known: tables on the disk, and their facts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from fffo_drive.fleet.adding import Given, add_runs
from fffo_drive.fleet.regress import STRIBECK_RPS
from fffo_drive.fleet.store import FleetStore
from fffo_drive.identification.facts import DriveFacts
from fffo_drive.units import TWO_PI

KT = 0.1
RATE_HZ = 500.0
FACTS = DriveFacts(name="axis", torque_constant_nm_per_a=KT, position_lsb_rev=1e-6, absolute_angle=True)
TRUTH = {
    "inertia_nm_s2_per_rev": 1e-3, "viscous_nm_per_rps": 3e-3, "coulomb_nm": 0.025, "stribeck_nm": 0.01,
    "offset_nm": 0.002, "viscous_excess_nm_per_rps": 4e-4, "gravity_cos_nm": 0.006, "gravity_sin_nm": -0.004,
}  # fmt: skip


def motion(seed, duration_s=8.0):
    """Time, position, velocity and acceleration of a few sines. (n,) each"""
    draw = np.random.default_rng(seed)
    time_s = np.arange(0.0, duration_s, 1.0 / RATE_HZ)
    position, velocity, acceleration = (np.zeros(time_s.size) for _ in range(3))
    for frequency_hz, size_rps in ((0.15, 3.0), (0.4, 1.5), (1.1, 0.8)):
        w, phase = TWO_PI * frequency_hz * draw.uniform(0.9, 1.1), draw.uniform(0.0, TWO_PI)
        velocity += size_rps * np.sin(w * time_s + phase)
        position += -size_rps / w * np.cos(w * time_s + phase)
        acceleration += size_rps * w * np.cos(w * time_s + phase)
    return time_s, position, velocity, acceleration


def torque_nm(position, velocity, acceleration, truth):
    """What the axis needs, by `truth`. (n,)"""
    sign, angle = np.sign(velocity), TWO_PI * position
    return (
        truth["inertia_nm_s2_per_rev"] * acceleration
        + truth["viscous_nm_per_rps"] * velocity
        + sign * (truth["coulomb_nm"] + truth["stribeck_nm"] * np.exp(-np.abs(velocity) / STRIBECK_RPS))
        + truth["offset_nm"]
        + truth["viscous_excess_nm_per_rps"] * np.abs(velocity)
        + truth["gravity_cos_nm"] * np.cos(angle)
        + truth["gravity_sin_nm"] * np.sin(angle)
    )


def write_run(path: Path, seed: int, truth=None, noise_nm=2e-3, duration_s=8.0, wave=(0.0, 0.0), more=None) -> Path:
    """A table of one run; `wave`: order and amplitude (Nm) of a wave that the regression does not have."""
    time_s, position, velocity, acceleration = motion(seed, duration_s)
    torque = torque_nm(position, velocity, acceleration, TRUTH if truth is None else truth)
    torque += wave[1] * np.sin(TWO_PI * wave[0] * position)
    torque += noise_nm * np.random.default_rng(seed + 1000).standard_normal(time_s.size)
    columns = {"time_s": time_s, "position_rev": position, "current_command_a": torque / KT, **(more or {})}
    table = np.stack([np.broadcast_to(values, time_s.shape) for values in columns.values()], axis=1)
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")
    return path


def filled_store(address, paths, drive="d1", model="m1"):
    """A store with these runs on its index."""
    store = FleetStore(str(address), create=True)
    added = add_runs(store, [str(path) for path in paths], Given(drive, model, FACTS))
    assert added.problems == ()
    return store


def files_of(root: Path) -> dict[str, bytes]:
    """Every file below a directory, by its name relative to it."""
    return {str(path.relative_to(root)): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def facts_file(tmp_path_factory):
    """Facts of the rig's drives, as a file."""
    path = tmp_path_factory.mktemp("facts") / "facts.yaml"
    path.write_text(yaml.safe_dump(FACTS.model_dump(exclude_defaults=True)))
    return path

"""A simulated axis that is excited and recorded in memory: known truth for the fits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from fffo_drive.config.axis import AxisFile
from fffo_drive.config.session import session_config
from fffo_drive.drive.simulated.in_process import SimulatedDrive
from fffo_drive.drive.simulated.parameters import PlantConfig, delay_budget, paper_plant
from fffo_drive.identification.dataset import Record
from fffo_drive.model.friction import OMEGA_CLIPPED, FrictionConfig
from fffo_drive.model.parameters import read_model
from fffo_drive.recording.ring_reader import RingReader
from fffo_drive.runtime.runs import simulated_ring_rows
from fffo_drive.runtime.session import Session
from fffo_drive.units import inertia_nm_s2_per_rev

PERIOD_S = 0.0005
TABLE_1 = Path(__file__).resolve().parents[2] / "configs" / "models" / "table1.yaml"
FRICTION = FrictionConfig(0.025, 0.067, 0.733, 1.07, 0.003, 778.0, 2.33, OMEGA_CLIPPED)


def session(drive, profile):
    """Plain PI with the paper's gains, as an axis file would give it, and wide limits."""
    document = {
        "name": "rig",
        "drive": {"kind": "simulated", "file": "none"},
        "model": "none",
        "controller": {"proportional_a_per_rps": 0.975, "integral_a_per_rev": 9.75, "current_limit_a": 12},
        "envelope": {
            "current_limit_a": 14, "continuous_current_a": 14, "speed_limit_rps": 150,
            "following_error_rps": 100, "following_error_s": 10,
        },
        "profile": {"kind": "paper"},
    }  # fmt: skip
    axis = AxisFile.model_validate(document)
    rows = simulated_ring_rows(profile, axis.loop.tail_s)
    return Session(drive, session_config(axis, read_model(TABLE_1), profile.values.size, rows))


def record(plant, profile, name="run"):
    """Run a profile on a plant from power-on, with plain PI where it is a velocity; the record of it."""
    drive = SimulatedDrive(plant)
    drive.connect()
    with session(drive, profile) as running:
        running.run_profile(profile, 0)
        rows = RingReader(running.ring).read().rows
    rows = rows[rows["profile_sample"] >= 0]
    closed = bool(profile.mode == 1)
    return Record(
        name=name, path=Path(name), period_s=PERIOD_S, torque_constant_nm_per_a=0.148,
        current_a=np.ascontiguousarray(rows["current_command_a"]),
        position_rev=np.ascontiguousarray(rows["position_rev"]),
        velocity_rps=np.ascontiguousarray(rows["velocity_rps"]),
        reference_rps=np.ascontiguousarray(rows["reference_rps"]) if closed else None,
        lsb_rev=2.0**-plant.resolver.bits, breaks=(), digest="",
    )  # fmt: skip


def random_plant(seed, noise_seed=None):
    """A plant with one 2SEP surface whose parameters are drawn around Table I, and its truth in the model's terms."""
    draw = np.random.default_rng(seed)
    base = paper_plant()
    if seed:
        f = base.friction.single
        u = lambda low, high: float(np.exp(draw.uniform(np.log(low), np.log(high))))  # noqa: E731
        coulomb = f.coulomb_nm * u(0.7, 1.5)
        single = replace(
            f,
            coulomb_nm=coulomb,
            stiction_nm=coulomb * u(1.5, 3.0),
            viscous_nm_per_rps=f.viscous_nm_per_rps * u(0.6, 1.6),
            stribeck_rps=f.stribeck_rps * u(0.6, 1.8),
            stribeck_exponent=u(0.8, 1.6),
            stiffness_per_rev=f.stiffness_per_rev * u(0.6, 1.8),
            attraction_nm_per_rev=f.attraction_nm_per_rev * u(0.6, 1.8),
        )
        base = replace(
            base,
            friction=replace(base.friction, single=single),
            inertia_kg_m2=base.inertia_kg_m2 * u(0.6, 1.8),
            delay_s=draw.uniform(0.0025, 0.005),
        )
    return replace(base, seed=seed * 1000 + 1 if noise_seed is None else noise_seed)


def truth(plant: PlantConfig) -> dict[str, float]:
    """What a fit on the position should find. The delay: without the hold, which the model has, and without the lag of
    the drive's velocity, which the position does not have."""
    f, d = plant.friction.single, delay_budget(plant)
    return {
        "inertia_nm_s2_per_rev": inertia_nm_s2_per_rev(plant.inertia_kg_m2),
        "delay_s": d.bus_tick_s + d.transport_s + d.current_loop_s,
        "viscous_nm_per_rps": f.viscous_nm_per_rps,
        "coulomb_nm": f.coulomb_nm,
        "static_nm": f.stiction_nm,
        "stribeck_velocity_rps": f.stribeck_rps,
        "stribeck_exponent": f.stribeck_exponent,
        "stiffness_per_rev": f.stiffness_per_rev,
        "attraction_nm_per_rev": f.attraction_nm_per_rev,
    }

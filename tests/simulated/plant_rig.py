"""Rigs for the plant's tests: run it with commands per tick or per sub-step, and write down what happened."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fffo_drive.drive.simulated import state as at
from fffo_drive.drive.simulated.friction import FrictionScales, friction_after
from fffo_drive.drive.simulated.pack import FRICTION_KINDS, new_state, plant_parameters
from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig, ThermalConfig, noiseless
from fffo_drive.drive.simulated.plant import plant_advance
from fffo_drive.drive.simulated.resolver import plant_latch
from fffo_drive.drive.simulated.state import STEP_S, PlantState
from fffo_drive.drive.simulated.surfaces import PlantFriction
from fffo_drive.jit import njit
from fffo_drive.units import inertia_nm_s2_per_rev

SUBSTEPS_PER_TICK = 11
TICK_S = 0.0005
NO_WARMING = ThermalConfig(k_per_w=0.0)
NO_FRICTION = PlantFriction(surfaces=())


def quiet(**changes) -> PlantConfig:
    """The default drive without noise and warming, and with these changes."""
    return replace(noiseless(PlantConfig(thermal=NO_WARMING)), **changes)


def copy_state(state: PlantState) -> PlantState:
    """A snapshot that shares nothing with `state`."""
    return PlantState._make([field.copy() for field in state])


def with_effects(config: PlantConfig, *effects: tuple[str, dict[str, float]]) -> PlantConfig:
    return replace(config, effects=tuple(EffectConfig(name, values) for name, values in effects))


@njit
def _record(parameters, state, commands_a, rows):
    for k in range(rows.shape[0]):
        x = state.values
        rows[k, 0] = state.words[at.SUBSTEP] * STEP_S
        rows[k, 1] = x[at.VELOCITY_RPS]
        rows[k, 2] = x[at.ANGLE_REV]
        current_a = x[at.CURRENT_A]
        plant_advance(parameters, state, commands_a[k // 11], 1)
        rows[k, 3] = 0.5 * (current_a + x[at.CURRENT_A])
        rows[k, 4] = x[at.TORQUE_NM]
        rows[k, 5] = x[at.FRICTION_NM]
        rows[k, 6] = x[at.VELOCITY_RPS]
        rows[k, 7] = x[at.ANGLE_REV]
        rows[k, 8] = x[at.TRACKED_REV]
        rows[k, 9] = x[at.TRACKED_RPS]


@dataclass
class Record:
    """One row a sub-step, each field (n,). Velocity and angle before the sub-step; `next_` after it."""

    time_s: np.ndarray
    velocity_rps: np.ndarray
    angle_rev: np.ndarray
    current_a: np.ndarray  # mean over the sub-step
    torque_nm: np.ndarray  # of the motor
    friction_nm: np.ndarray
    next_rps: np.ndarray
    next_rev: np.ndarray
    tracked_rev: np.ndarray
    tracked_rps: np.ndarray


def record(config: PlantConfig, commands_a: np.ndarray, state=None) -> Record:
    """Run the plant with one held current a tick (n,), seen at every sub-step."""
    commands_a = np.asarray(commands_a, float)
    rows = np.zeros((commands_a.size * SUBSTEPS_PER_TICK, 10))
    _record(plant_parameters(config), new_state(config) if state is None else state, commands_a, rows)
    return Record(*rows.T)


@njit
def _ticks(parameters, state, commands_a, rows):
    held_a = 0.0
    for k in range(rows.shape[0]):
        if k > 0:
            plant_advance(parameters, state, held_a, 11)
            held_a = commands_a[k - 1]  # a command of sample k acts at SYNC k+1
        report = plant_latch(parameters, state)
        rows[k, 0] = report.velocity_rps
        rows[k, 1] = report.position_counts
        rows[k, 2] = report.current_a
        rows[k, 3] = report.true_velocity_rps
        rows[k, 4] = report.true_friction_nm


def exchange(config: PlantConfig, commands_a: np.ndarray, seed: int | None = None) -> np.ndarray:
    """Run as a master does, a SYNC a tick: velocity, counts, current, true velocity, true friction: shape (n, 5)."""
    commands_a = np.asarray(commands_a, float)
    rows = np.zeros((commands_a.size, 5))
    _ticks(plant_parameters(config), new_state(config, seed), commands_a, rows)
    return rows


@njit
def _friction_along(table, state, velocity_rps, step_s, kind, torque_nm):
    for k in range(velocity_rps.shape[0]):
        torque_nm[k] = friction_after(kind, table, state, velocity_rps[k], step_s, FrictionScales(1.0, 1.0, 1.0))


def friction_along(
    friction: PlantFriction, velocity_rps: np.ndarray, step_s: float = STEP_S, state: np.ndarray | None = None
) -> np.ndarray:
    """Torque of the base friction that follows a motion from power-on (or from `state`, which moves on)."""
    config = PlantConfig(friction=friction)
    torque_nm = np.zeros(len(velocity_rps))
    contacts = new_state(config).friction if state is None else state
    table = plant_parameters(config).friction
    velocity_rps = np.asarray(velocity_rps, float)
    _friction_along(table, contacts, velocity_rps, step_s, FRICTION_KINDS[friction.kind], torque_nm)
    return torque_nm


def residual(config: PlantConfig, run: Record) -> np.ndarray:
    """What the axis without effects leaves over: Kt i - J dw/dt - F(w), in Nm, one value a sub-step."""
    inertia = inertia_nm_s2_per_rev(config.inertia_kg_m2)
    acceleration = (run.next_rps - run.velocity_rps) / STEP_S
    base_nm = friction_along(config.friction, run.velocity_rps)
    return config.torque_constant_nm_per_a * run.current_a - inertia * acceleration - base_nm


def lively_current(duration_s: float) -> np.ndarray:
    """A current that reverses the axis, lets it rest nearly, and brings it to more than 10 rps, in A."""
    t = np.arange(round(duration_s / TICK_S)) * TICK_S
    slow = 0.55 * np.sin(2 * np.pi * 0.5 * t) + 0.45 * np.sin(2 * np.pi * 1.7 * t + 1.0)
    return slow + 0.25 * np.sin(2 * np.pi * 7.1 * t)


def fitted(regressor: np.ndarray, target: np.ndarray) -> tuple[float, float]:
    """Least-squares factor of target on regressor, and their correlation (no constant term)."""
    factor = float(regressor @ target / (regressor @ regressor))
    return factor, float(regressor @ target / np.sqrt((regressor @ regressor) * (target @ target)))

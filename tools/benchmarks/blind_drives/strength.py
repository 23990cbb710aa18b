"""How strong an effect is once a base model has been refitted, and the strength that makes it as strong as wanted.

The motion with the effect is simulated without noise. What the torque balance with the true base parameters leaves is
the effect's torque; what a refit of inertia, delay and all friction parameters to that motion still leaves is the part
that a base model cannot take in. The friction in the refit is the plant's own, stepped along the motion.

A wave of many periods a turn lies mostly above the band of that balance, which would let only enormous ones count. No
base model takes it in, so its strength is that of the wave itself: rms over Coulomb friction.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy import signal

from fffo_drive.drive.simulated.friction import STATE_COLUMNS, STICTION, FrictionScales, single_step, surfaces_step
from fffo_drive.drive.simulated.pack import plant_parameters
from fffo_drive.drive.simulated.parameters import PlantConfig, delay_budget, noiseless
from fffo_drive.jit import njit

from .draw import WAVES, Draw, Variant
from .profiles import CLOSED_LOOP, HELD_OUT, PERIOD_S, Profile
from .simulate import Gains, Run, simulate

Floats = np.ndarray[Any, np.dtype[np.float64]]

LOWEST, HIGHEST = 0.05, 0.30  # share of the friction torque that an effect has after the refit
CLOSE_ENOUGH = 1.2
TRIALS = 7
SHOWN_PERIODS = 8.0  # most a turn of a wave that the balance shows at the usual speeds
CUTOFF_HZ = 60.0
DECIMATION = 10
MOVING_RPS = 0.05
ITERATIONS = 3
RIDGE = 1e-6
_FITTED = (0, 1, 2, 3, 4, 5, 7)  # columns of the plant's friction table
_STEP = 1e-3
_WORST_TRACKING = 0.35
_FASTEST_RPS = 70.0


class Balance(NamedTuple):
    """The torque balance of a motion, decimated: (n,) each, all filtered alike."""

    motor_nm: Floats
    acceleration_rps2: Floats
    motor_slope_nm_per_s: Floats
    base_friction_nm: Floats  # true base friction along this motion
    moving: np.ndarray[Any, np.dtype[np.bool_]]
    velocity_rps: list[Floats]  # of each run, at the full rate


class Calibrated(NamedTuple):
    """An effect with its strength, and the share of the friction torque that it has after the refit."""

    variant: Variant
    size: float
    share: float


@njit
def _single_along(table: Floats, velocity_rps: Floats, state: Floats, out: Floats) -> None:
    scales = FrictionScales(1.0, 1.0, 1.0)
    for k in range(velocity_rps.shape[0]):
        out[k] = single_step(table, state, velocity_rps[k], PERIOD_S, scales)


@njit
def _surfaces_along(table: Floats, velocity_rps: Floats, state: Floats, out: Floats) -> None:
    scales = FrictionScales(1.0, 1.0, 1.0)
    for k in range(velocity_rps.shape[0]):
        out[k] = surfaces_step(table, state, velocity_rps[k], PERIOD_S, scales)


def friction_along(plant: PlantConfig, table: Floats, velocity_rps: Floats) -> Floats:
    """The plant's base friction (Nm) along a velocity, with this table of parameters, from rest."""
    out = np.zeros(velocity_rps.size)
    state = np.zeros((table.shape[0], STATE_COLUMNS))
    if plant.friction.kind == "five_surfaces" and table.shape[0] > 1:
        state[:, STICTION] = 1.0
        _surfaces_along(table, velocity_rps, state, out)
    else:
        _single_along(table, velocity_rps, state, out)
    return out


def _low_pass(values: Floats) -> Floats:
    sections = signal.butter(2, CUTOFF_HZ, fs=1.0 / PERIOD_S, output="sos")
    return np.asarray(signal.sosfiltfilt(sections, values)[::DECIMATION])


def balance(plant: PlantConfig, runs: list[Run]) -> Balance:
    """Torque balance of noise-free runs. A drive with a resolver error is seen through its resolver."""
    budget = delay_budget(plant)
    late_s = budget.bus_tick_s + budget.hold_s + budget.transport_s + budget.current_loop_s
    table = plant_parameters(replace(plant, effects=())).friction
    through_sensor = any(effect.name == "resolver_error" for effect in plant.effects)
    parts: list[tuple[Floats, ...]] = []
    velocities: list[Floats] = []
    for run in runs:
        time_s = np.arange(run.true_rps.size) * PERIOD_S
        motor = plant.torque_constant_nm_per_a * run.columns["current_command_a"]
        motor = np.interp(time_s - late_s, time_s, motor, left=0.0)
        velocity = np.gradient(run.columns["position_rev"], PERIOD_S) if through_sensor else run.true_rps
        velocities.append(np.ascontiguousarray(velocity))
        filtered = _low_pass(motor)
        parts.append((
            filtered,
            _low_pass(np.gradient(velocity, PERIOD_S)),
            np.gradient(filtered, PERIOD_S * DECIMATION),
            _low_pass(friction_along(plant, table, run.true_rps)),
            np.abs(run.true_rps[::DECIMATION]) > MOVING_RPS,
        ))  # fmt: skip
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Balance(joined[0], joined[1], joined[2], joined[3], joined[4].astype(bool), velocities)


def _along(plant: PlantConfig, table: Floats, velocities: list[Floats]) -> Floats:
    return np.concatenate([_low_pass(friction_along(plant, table, velocity)) for velocity in velocities])


def refit(plant: PlantConfig, motion: Balance, start: Floats, motor_nm: Floats) -> tuple[Floats, Floats, Floats]:
    """Fit inertia, delay and a single surface to a motor torque (n,): what is left of it (n,), the table, and the
    change of (inertia, delay). `start`: table of the single surface."""
    inertia = 2.0 * math.pi * plant.inertia_kg_m2
    table = start.copy()
    moved = np.zeros(2)
    left = motor_nm
    for iteration in range(ITERATIONS + 1):
        friction = _along(plant, table, motion.velocity_rps)
        left = motor_nm - inertia * motion.acceleration_rps2 - friction
        left = left - moved[0] * motion.acceleration_rps2 - moved[1] * motion.motor_slope_nm_per_s
        if iteration == ITERATIONS:
            break
        columns = [motion.acceleration_rps2, motion.motor_slope_nm_per_s]
        for k in _FITTED:
            nudged = table.copy()
            nudged[0, k] *= 1.0 + _STEP
            columns.append((_along(plant, nudged, motion.velocity_rps) - friction) / _STEP)
        matrix = np.stack(columns, axis=1)
        scale = np.linalg.norm(matrix, axis=0) + 1e-12
        normal = (matrix / scale).T @ (matrix / scale)
        change = np.linalg.solve(normal + RIDGE * np.eye(scale.size), (matrix / scale).T @ left) / scale
        moved += change[:2]
        factors = np.exp(np.clip(change[2:], -0.7, 0.7))
        for k, factor in zip(_FITTED, factors, strict=True):
            table[0, k] *= factor
    return left, table, moved


def single_table(plant: PlantConfig) -> Floats:
    """Table of the plant's single surface, from which refits start."""
    alone = replace(plant, effects=(), friction=replace(plant.friction, kind="single_2sep"))
    return plant_parameters(alone).friction


def share_after_refit(plant: PlantConfig, runs: list[Run]) -> float:
    """Torque of the effects that a refitted base model leaves, over the friction torque (both rms, while moving).

    `runs`: noise-free runs of the plant with its effects.
    """
    motion = balance(plant, runs)
    with_effect, _, _ = refit(plant, motion, single_table(plant), motion.motor_nm)
    if plant.friction.kind == "five_surfaces":  # what one surface cannot say about five is no effect
        inertia = 2.0 * math.pi * plant.inertia_kg_m2
        base_nm = inertia * motion.acceleration_rps2 + motion.base_friction_nm
        without, _, _ = refit(plant, motion, single_table(plant), base_nm)
        with_effect = with_effect - without
    torque = math.sqrt(float(np.mean(with_effect[motion.moving] ** 2)))
    return torque / math.sqrt(float(np.mean(motion.base_friction_nm[motion.moving] ** 2)))


def quiet_runs(plant: PlantConfig, gains: Gains, asked: tuple[Profile, ...]) -> list[Run]:
    """The runs that are fitted, without noise."""
    quiet = noiseless(plant)
    return [simulate(quiet, gains, profile, 1) for profile in asked if profile.name != HELD_OUT]


def is_sound(runs: list[Run]) -> bool:
    """True where the loop is stable, the axis follows, and no speed is beyond what such a motor does."""
    for run in runs:
        if not np.isfinite(run.true_rps).all() or np.abs(run.true_rps).max() > _FASTEST_RPS:
            return False
        if run.profile.mode == CLOSED_LOOP:
            error = run.true_rps - run.profile.values
            if np.sqrt(np.mean(error**2)) > _WORST_TRACKING * np.sqrt(np.mean(run.profile.values**2)):
                return False
    return True


def calibrate(
    plant: PlantConfig, gains: Gains, asked: tuple[Profile, ...], variant: Variant, draw: Draw
) -> Calibrated | None:
    """The strength at which the effect has a drawn share of the friction torque. None: this effect cannot have it."""
    least = max(LOWEST * 1.15, variant.least_share)
    wanted = float(np.exp(draw.uniform(math.log(least), math.log(HIGHEST / 1.1))))
    if variant.name in WAVES and variant.fixed["order"] > SHOWN_PERIODS:
        return _wave(plant, gains, asked, variant, wanted)
    low, high = variant.lowest, variant.highest
    size = variant.first
    best: Calibrated | None = None
    for _ in range(TRIALS):
        effected = replace(plant, effects=(variant.at(size),))
        runs = [] if effected.errors() else quiet_runs(effected, gains, asked)
        if not runs or not is_sound(runs):
            high = size
            size = math.sqrt(low * high)
            continue
        share = share_after_refit(effected, runs)
        closer = best is None or abs(math.log(share / wanted)) < abs(math.log(best.share / wanted))
        if LOWEST <= share <= HIGHEST and closer:
            best = Calibrated(variant, size, share)
        if 1.0 / CLOSE_ENOUGH < share / wanted < CLOSE_ENOUGH:
            break
        low, high = (size, high) if share < wanted else (low, size)
        found = size * wanted / max(share, 1e-9)
        size = found if low < found < high else math.sqrt(low * high)
        if high / low < 1.02:
            break
    return best


def _wave(
    plant: PlantConfig, gains: Gains, asked: tuple[Profile, ...], variant: Variant, share: float
) -> Calibrated | None:
    """A wave of many periods whose rms is this share of Coulomb friction (a ripple: of the torque it is part of)."""
    size = math.sqrt(2.0) * share * (plant.friction.coulomb_nm if variant.name == "cogging" else 1.0)
    effected = replace(plant, effects=(variant.at(size),))
    sound = not effected.errors() and is_sound(quiet_runs(effected, gains, asked))
    return Calibrated(variant, size, share) if sound else None

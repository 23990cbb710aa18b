"""Logs as sensors, couplings and loggers spoil them. The axis has physics of its own: nothing of the model's code."""

from __future__ import annotations

import numpy as np

KT_NM_PER_A, INERTIA_KG_M2, COULOMB_NM, VISCOUS_NM_PER_RPS = 0.05, 2e-4, 0.030, 0.004
RATE_HZ, SECONDS = 500.0, 12.0
SPEED_PARTS = ((4.0, 0.31, 0.2), (2.5, 0.83, 1.1), (0.8, 2.9, 0.5))  # rps, Hz, rad


def motion(seconds=SECONDS, rate_hz=RATE_HZ, seed=0):
    """Columns of a clean log, without rounding: two slow sines and a fast one, torque by inverse dynamics."""
    time_s = np.arange(int(seconds * rate_hz)) / rate_hz
    turn = 2.0 * np.pi
    velocity = sum(a * np.sin(turn * f * time_s + p) for a, f, p in SPEED_PARTS)
    position = sum(a / (turn * f) * (np.cos(p) - np.cos(turn * f * time_s + p)) for a, f, p in SPEED_PARTS)
    acceleration = sum(a * turn * f * np.cos(turn * f * time_s + p) for a, f, p in SPEED_PARTS)
    friction = (COULOMB_NM + 0.012 * np.exp(-((velocity / 0.4) ** 2))) * np.tanh(velocity / 0.02)
    torque = turn * INERTIA_KG_M2 * acceleration + friction + VISCOUS_NM_PER_RPS * velocity
    torque = torque + 1e-3 * np.random.default_rng(seed).standard_normal(time_s.size)
    return {"time_s": time_s, "current_a": torque / KT_NM_PER_A, "position_rev": position, "velocity_rps": velocity}


def counted(position_rev, counts_a_turn=4096):
    """As an encoder counts."""
    return np.floor(position_rev * counts_a_turn) / counts_a_turn


def with_position(log, position_rev):
    """A log of time, current and position."""
    return {"time_s": log["time_s"], "current_a": log["current_a"], "position_rev": position_rev}


def with_velocity(log, velocity_rps):
    """A log of time, current and velocity."""
    return {"time_s": log["time_s"], "current_a": log["current_a"], "velocity_rps": velocity_rps}


def some(log, count, seed=5):
    """Rows, drawn without one twice, not at the ends."""
    size = log["time_s"].size
    return 100 + np.random.default_rng(seed).choice(size - 200, count, replace=False)


def spikes_each_turn(log):
    """Three samples wrong wherever the position passes a whole turn."""
    velocity = log["velocity_rps"].copy()
    for k in np.flatnonzero(np.diff(np.floor(log["position_rev"]))) + 1:
        spoiled = velocity[k : k + 3]
        spoiled += 25.0 * np.sign(spoiled) * np.array([1.0, 0.6, 0.3])[: spoiled.size]
    return with_velocity(log, velocity)


def velocities_off(log, count=20, by_rps=20.0):
    """Single velocities off by a fixed amount."""
    velocity = log["velocity_rps"].copy()
    velocity[some(log, count)] += by_rps
    return with_velocity(log, velocity)


def velocities_zero(log):
    """A missed frame, logged as zero."""
    velocity = log["velocity_rps"].copy()
    velocity[some(log, 60)] = 0.0
    return with_velocity(log, velocity)


def velocity_wraps(log):
    """An int16 that overflows beyond 5.9 rps."""
    step = 0.00018
    return with_velocity(log, ((log["velocity_rps"] / step + 32768) % 65536 - 32768) * step)


def positions_off(log):
    """Single positions off by a quarter turn."""
    position = counted(log["position_rev"])
    position[some(log, 20)] += 0.25
    return with_position(log, position)


def positions_zero(log):
    """A missed frame, logged as zero."""
    position = counted(log["position_rev"] + 1.3)
    position[some(log, 60)] = 0.0
    return with_position(log, position)


def slips(log):
    """A coupling that slips three times."""
    position = log["position_rev"].copy()
    for at_s, by_rev in ((3.0, 0.5), (5.5, -0.1), (9.1, 0.3)):
        position[log["time_s"] > at_s] += by_rev
    return with_position(log, counted(position))


def stands_still(log):
    """A sensor that stands for 50 ms, four times, and catches up."""
    position = counted(log["position_rev"])
    for k in (900, 1700, 4800, 5000):
        position[k : k + 25] = position[k]
    return with_position(log, position)


def hall(log, edges_a_turn=42):
    """The position by the edges of a Hall sensor."""
    return with_position(log, counted(log["position_rev"], edges_a_turn))


def eight_bits(log):
    """The position in 256 steps a turn."""
    return with_position(log, counted(log["position_rev"], 256))


def noise(log):
    """White noise of 0.5 rps on the velocity."""
    size = log["time_s"].size
    return with_velocity(log, log["velocity_rps"] + 0.5 * np.random.default_rng(3).standard_normal(size))


def rows_missing(log):
    """Single rows and one stretch of 60 ms are not there."""
    there = np.ones(log["time_s"].size, dtype=bool)
    there[some(log, 120)] = False
    there[3000:3030] = False
    whole = log | {"position_rev": counted(log["position_rev"])}
    return {name: values[there] for name, values in whole.items()}


def stamps_scatter(log):
    """Stamps that scatter by a fifth of the period."""
    late = 0.2 / RATE_HZ * np.random.default_rng(4).standard_normal(log["time_s"].size)
    return with_position(log, counted(log["position_rev"])) | {
        "time_s": np.maximum.accumulate(log["time_s"] + late) + 1e-9 * np.arange(late.size)
    }


def currents_off(log):
    """Single measured currents off by 40 A, which stand in for the command."""
    current = log["current_a"].copy()
    current[some(log, 20)] += 40.0
    return with_position(log, counted(log["position_rev"])) | {"current_a": current}


def held_five(log):
    """A position that is new in every fifth row only."""
    size = log["time_s"].size
    return with_position(log, counted(log["position_rev"])[np.arange(size) // 5 * 5])


def counts_lost(log, lost_rev=0.004):
    """Counts are lost for good at 0.37 of each turn."""
    return with_position(log, counted(log["position_rev"] - lost_rev * np.floor(log["position_rev"] - 0.37)))


def scale_damaged(log, by_rev=0.004):
    """For a twentieth of each turn from 0.37 on the position is behind."""
    behind = np.mod(log["position_rev"] - 0.37, 1.0) < 0.05
    return with_position(log, counted(log["position_rev"] - by_rev * behind))


ODD = (
    spikes_each_turn,
    velocities_off,
    velocities_zero,
    velocity_wraps,
    positions_off,
    positions_zero,
    slips,
    counts_lost,
    scale_damaged,
    stands_still,
    hall,
    eight_bits,
    noise,
    rows_missing,
    stamps_scatter,
    currents_off,
    held_five,
)


def steady(seed=0):
    """Eight constant speeds, ramps cut out: Coulomb and viscous friction, nothing else."""
    rng = np.random.default_rng(seed)
    speeds = np.repeat([1.0, 2.0, 3.5, 5.0, -1.0, -2.0, -3.5, -5.0], 800)
    time_s = np.arange(speeds.size) / RATE_HZ
    position = np.cumsum(speeds) / RATE_HZ
    torque = COULOMB_NM * np.sign(speeds) + VISCOUS_NM_PER_RPS * speeds + 1e-3 * rng.standard_normal(speeds.size)
    kept = np.tile(np.arange(800) > 100, 8)
    log = {"time_s": time_s, "current_a": torque / KT_NM_PER_A, "position_rev": position}
    return {name: values[kept] for name, values in log.items()}

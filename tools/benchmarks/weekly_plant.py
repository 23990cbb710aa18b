"""Weekly runs of axes on a plant of its own: LuGre friction, oil by Vogel's law, another controller, tables as logs.

Nothing in it is the project's: neither the simulated drive nor any law of its fits.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

AXES, WEEKS = 20, 44
WEEK_S = 7.0 * 86400.0
BEGIN_S = 1_767_571_200.0  # 2026-01-05, a Monday
RATE_HZ, STEP_HZ, RUN_S = 500.0, 20_000.0, 8.0
KT, COUNTS = 0.1, 2.0**17
SIZE = 0.10  # of each change
NONE, COULOMB, VISCOUS, INERTIA, OFFSET = "none", "Coulomb friction", "viscous friction", "inertia", "constant torque"
CHANGES = (COULOMB, VISCOUS, COULOMB, INERTIA, COULOMB, OFFSET, COULOMB, VISCOUS, COULOMB, INERTIA)
WARMED, WARMER_K = (12, 14, 16), 8.0  # axes that are warmed for good at a week of their own
OTHER_MOTION = 18  # the axis that gets another programme
VOGEL_K, VOGEL_DEGC = 900.0, 110.0  # viscosity goes with exp(VOGEL_K / (degC + VOGEL_DEGC)): -4.2 % a kelvin at 25 degC
COULOMB_PER_K = -0.004


class Axis(NamedTuple):
    """An axis and what happens to it."""

    number: int
    change: str
    week: int  # from here on
    coulomb_nm: float
    viscous_nm_per_rps: float
    inertia_nm_s2_per_rev: float
    offset_nm: float


class Week(NamedTuple):
    """One run."""

    name: str
    time_s: float
    degc: float  # of the drive
    room_degc: float  # the part of it that is the room's; the rest is the process beside the axis


def axes(seed: int) -> list[Axis]:
    """All of them; half change at some week."""
    found = []
    for number in range(AXES):
        draw = np.random.default_rng([seed, number])
        about = np.exp(np.array([0.12, 0.15, 0.05]) * draw.standard_normal(3))
        change = CHANGES[number // 2] if number % 2 == 1 else NONE
        found.append(
            Axis(
                number,
                change,
                int(draw.integers(16, 28)),
                0.03 * about[0],
                3.5e-3 * about[1],
                1.2e-3 * about[2],
                2e-3 * draw.standard_normal(),
            )
        )
    return found


def weeks(axis: Axis, seed: int) -> list[Week]:
    """Its runs, with a temperature of season, weather and process."""
    draw = np.random.default_rng([seed, axis.number, 1])
    phase, weather, process = draw.random(), 0.0, 0.0
    found = []
    for week in range(WEEKS):
        time_s = BEGIN_S + week * WEEK_S + float(draw.uniform(0.0, 5.0)) * 86400.0
        weather = 0.6 * weather + 2.0 * draw.standard_normal()
        process = 0.8 * process + 3.0 * draw.standard_normal()
        room = 24.0 + 6.0 * math.sin(2.0 * math.pi * (week / 52.0 + phase)) + weather
        warmer = WARMER_K if axis.number in WARMED and week >= axis.week else 0.0
        stamp = np.datetime64(int(time_s), "s").item().strftime("%Y-%m-%d_%Hh%Mm%S")
        found.append(Week(f"axis{axis.number:02d}_{stamp}.csv", time_s, room + process + warmer, room))
    return found


def programme(axis: Axis, week: int, seed: int) -> Floats:
    """Velocity reference (n,) at STEP_HZ: the axis' own moves, each week at other times and speeds by some per cent."""
    other = axis.number == OTHER_MOTION and week >= axis.week
    own, now = np.random.default_rng([seed, axis.number, 2, other]), np.random.default_rng([seed, axis.number, 3, week])
    speeds = own.uniform(0.1, 1.0, 9) ** 1.5 * 7.0 * np.where(np.arange(9) % 2, -1.0, 1.0) * (0.6 if other else 1.0)
    speeds *= now.uniform(0.93, 1.07)
    time_s = np.arange(round(RUN_S * STEP_HZ)) / STEP_HZ
    edges = np.sort(own.uniform(0.5, 1.0, 9).cumsum())
    edges = 0.2 + edges / edges[-1] * (RUN_S - 0.8) + now.uniform(-0.02, 0.02)
    points, values = [0.0], [0.0]
    for end, speed in zip(edges, speeds, strict=True):
        begin = points[-1]
        ramp = 0.12 * (end - begin) + abs(speed) / 120.0
        points += [begin + ramp, end - ramp, end]
        values += [speed, speed, 0.0]
    return np.asarray(np.interp(time_s, points, values))


@numba.njit(cache=True)
def _run(
    reference: Floats, inertia: float, coulomb: float, rise: float, viscous: float, offset: float, noise: Floats
) -> Floats:
    """Rows (n, 3) at RATE_HZ of position, velocity as the drive reports it, and current."""
    h, every = 1.0 / STEP_HZ, round(STEP_HZ / RATE_HZ)
    stiff, damp, slide = 60.0, 0.02, 0.4
    position, velocity, bristle, integral, current, command, reported, seen = 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.3
    found = np.zeros((reference.size // every, 3))
    for n in range(reference.size):
        if n % 40 == 0:  # the drive's own loop at 500 Hz, current as it was commanded a cycle before
            counted = math.floor(position * COUNTS) / COUNTS
            reported += 0.35 * ((counted - seen) * 500.0 - reported)
            seen = counted
            error = reference[n] - reported
            integral += 0.5 * error / 500.0
            found[n // 40, 0], found[n // 40, 1], found[n // 40, 2] = counted, reported, command
            current = command
            command = 0.12 * error / KT * 0.5 + integral / KT + noise[n // 40]
        level = coulomb + rise * math.exp(-((velocity / slide) ** 2))
        rate = velocity - stiff * abs(velocity) / level * bristle
        friction = stiff * bristle + damp * rate + viscous * velocity
        bristle += h * rate
        velocity += h * (KT * current - friction - offset) / inertia
        position += h * velocity
    return found


def write_run(path: Path, axis: Axis, week: int, run: Week, seed: int) -> None:
    """The table of a run."""
    share = SIZE if week >= axis.week else 0.0
    grown = {name: 1.0 + (share if axis.change == name else 0.0) for name in (COULOMB, VISCOUS, INERTIA)}
    cold = math.exp(VOGEL_K / (run.degc + VOGEL_DEGC) - VOGEL_K / (25.0 + VOGEL_DEGC))
    coulomb = axis.coulomb_nm * grown[COULOMB] * (1.0 + COULOMB_PER_K * (run.degc - 25.0))
    noise = 0.02 * np.random.default_rng([seed, axis.number, 4, week]).standard_normal(round(RUN_S * RATE_HZ))
    rows = _run(
        programme(axis, week, seed),
        axis.inertia_nm_s2_per_rev * grown[INERTIA],
        coulomb,
        0.5 * coulomb,
        axis.viscous_nm_per_rps * grown[VISCOUS] * cold,
        axis.offset_nm + (share * axis.coulomb_nm if axis.change == OFFSET else 0.0),
        noise,
    )
    time_s = np.arange(len(rows)) / RATE_HZ
    table = np.column_stack([time_s, rows])
    names = "time_s,position_rev,velocity_rps,current_command_a"
    np.savetxt(path, table, fmt=("%.3f", "%.8f", "%.5f", "%.5f"), delimiter=",", header=names, comments="")

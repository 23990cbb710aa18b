"""Records of simulated lives: real ones from the plant, and drawn ones whose scatter is that of the real ones.

A drawn run is a run of a real drive without wear, chosen at random in blocks of neighbours: its information, its speed,
and what its estimates deviate from the drive's own level and temperature slope, of all columns and amplitudes at once.
Level, slopes, temperatures and times are drawn anew, and wear adds what the same wear adds to real records on the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from lives_plant import (
    BEGIN_S,
    JITTER_S,
    NONE,
    WEEK_S,
    Life,
    ambient_k,
    life_runs,
    recorded,
    wear_share,
)

from fffo_drive.evaluation.campaign import Candidate, Case
from fffo_drive.fleet.backlash import Gap, gap_of
from fffo_drive.fleet.channels import MEAN_DEGC, STEP_K, inverse_total, learn, stacked
from fffo_drive.fleet.history import RunHistory
from fffo_drive.fleet.measure import balance_in, gap_in
from fffo_drive.fleet.pieces import whole
from fffo_drive.fleet.regress import PARAMETERS
from fffo_drive.identification.dataset import Record
from fffo_drive.identification.facts import DriveFacts

Floats = npt.NDArray[np.float64]

FACTS = DriveFacts(torque_constant_nm_per_a=0.148, rated_current_a=8.3, gear_ratio=160.0)
THERMOMETER_K = 0.5  # noise of a logged temperature
BLOCK = 5  # neighbours that are drawn together: what has a memory keeps it
ORDERS = np.arange(1.0, 101.0)
GENERATED = ("level", "slope", "size", "away", "wave", "info", "speed", "gap_sd")  # of each real drive
LEAST_RUNS = 20  # without wear, of a real drive that is drawn from


class RealLife(NamedTuple):
    """A life on the plant, as records."""

    life: Life
    history: RunHistory  # with the temperature
    wear: Floats  # (n,) share of the whole size


def row_of(record: Record) -> dict[str, Floats]:
    """What a history has of a run."""
    balanced = balance_in(whole(record), FACTS, record.path)
    found = balanced.estimates
    sums = gap_in(whole(record), FACTS, balanced)
    gap = gap_of(sums, FACTS.units) if sums is not None else Gap(np.nan, np.nan, np.nan)
    return {
        "theta": found.theta, "info": found.information, "rms": np.array(found.rms_nm),
        "orders": np.asarray(balanced.left.columns(balanced.balance, FACTS, balanced.motion)["order_amplitude_nm"]),
        "speed": np.array(balanced.covered.columns()["speed_rms_rps"]),
        "gap": np.array(gap.gap_rev), "gap_sd": np.array(gap.log_sd),
    }  # fmt: skip


def make_life(case: Case, candidate: Candidate, life: Life, seed: int, path: Path) -> None:
    """Simulate a life and write its records (npz); a run that trips is left out."""
    kept: dict[str, list[Floats]] = {}
    for number, run in enumerate(life_runs(life, case.plant, case.session.loop.period_ns * 1e-9, seed)):
        try:
            row = row_of(recorded(case, candidate, run, f"{life.number}_{number}"))
        except ValueError:
            continue
        row |= {"time": np.array(run.time_s), "temp": np.array(run.temperature_degc), "wear": np.array(run.wear)}
        for name, value in row.items():
            kept.setdefault(name, []).append(value)
    partial = path.with_suffix(".part.npz")
    np.savez(partial, **{name: np.array(values) for name, values in kept.items()})
    partial.rename(path)


def read_life(life: Life, path: Path) -> RealLife:
    """What `make_life` wrote."""
    with np.load(path) as file:
        rows = {name: file[name] for name in file.files}
    count = rows["time"].size
    rng = np.random.default_rng([life.number, 7])
    degc = rows["temp"] + THERMOMETER_K * rng.standard_normal(count)
    names = np.array([f"{life.number}_{k}" for k in range(count)])
    own = RunHistory(
        rows["time"], rows["theta"], rows["info"], PARAMETERS, rows["rms"], rows["orders"], ORDERS, rows["speed"],
        degc, names, rows["gap"], rows["gap_sd"],
    )  # fmt: skip
    return RealLife(life, own, rows["wear"])


def without_temperature(history: RunHistory) -> RunHistory:
    """The same, where nothing logged the temperature."""
    return history._replace(temperature_degc=np.full(history.time_s.size, np.nan))


class Generator(NamedTuple):
    """What lives are drawn from."""

    levels: Floats  # (d, p) of real drives, in the units of the records
    slopes: Floats  # (d, p) per kelvin
    amplitude_levels: Floats  # (d, 3) logarithms: the ripple, the residual and the gap
    deviations: tuple[Floats, ...]  # of each drive (n, p)
    amplitudes: tuple[Floats, ...]  # (n, 3) less their level
    gap_sds: tuple[Floats, ...]  # (n,)
    information: tuple[Floats, ...]  # (n, p, p)
    speeds: tuple[Floats, ...]  # (n,)
    wears: dict[str, tuple[Floats, Floats]]  # of each law: what the whole wear adds, over the level; and to amplitudes


def fit_generator(lives: Sequence[RealLife], order: float) -> Generator:
    """Levels, slopes, scatter and signatures of wear of real lives."""
    place = int(np.flatnonzero(order == ORDERS)[0])
    stack = stacked({str(one.life.number): one.history for one in lives})
    fleet = learn(stack)
    columns = [PARAMETERS.index(name) for name in stack.columns]
    parts: dict[str, list[Floats]] = {name: [] for name in GENERATED}
    signatures: dict[str, list[Floats]] = {}
    signature_waves: dict[str, list[Floats]] = {}
    for number, one in enumerate(lives):
        runs = stack.of(number)
        theta, steps = stack.theta[runs], (one.history.temperature_degc - MEAN_DEGC) / STEP_K
        inverse = inverse_total(stack.information[runs], fleet.covariance)
        whole = one.wear
        design = np.column_stack([np.ones(steps.size), steps, whole][: 3 if whole.max() > 0.0 else 2])
        kept = (whole == 0.0) | (whole == 1.0)
        p, q = theta.shape[1], design.shape[1]
        normal = np.einsum("na,nb,nij->aibj", design[kept], design[kept], inverse[kept]).reshape(p * q, p * q)
        right = np.einsum("na,nij,nj->ai", design[kept], inverse[kept], theta[kept]).reshape(p * q)
        fitted = np.linalg.solve(normal + 1e-9 * np.eye(p * q), right).reshape(q, p)
        waves = np.log(np.column_stack(
            [one.history.order_amplitude_nm[:, place], one.history.rms_nm, one.history.gap_rev]
        ))  # fmt: skip
        quiet = np.flatnonzero(whole == 0.0)
        usual = np.nanmedian(waves[quiet], axis=0)
        if q == 3 and (whole == 1.0).sum() >= BLOCK:
            signatures.setdefault(one.life.wear, []).append(fitted[2])
            worn = np.nanmedian(waves[whole == 1.0], axis=0) - usual
            signature_waves.setdefault(one.life.wear, []).append(worn)
        if quiet.size < LEAST_RUNS:
            continue
        scale = stack.scales[number]
        parts["level"].append(fitted[0] * scale)
        parts["slope"].append(fitted[1] * scale / STEP_K)
        parts["size"].append(usual)
        parts["away"].append((theta[quiet] - design[quiet, :2] @ fitted[:2]) * scale)
        parts["wave"].append(np.where(np.isfinite(waves[quiet]), waves[quiet] - usual, np.nan))
        parts["info"].append(one.history.information[quiet][:, columns][:, :, columns])
        parts["gap_sd"].append(one.history.gap_log_sd[quiet])
        parts["speed"].append(one.history.speed_rms_rps[quiet])
    return Generator(
        np.array(parts["level"]), np.array(parts["slope"]), np.array(parts["size"]), tuple(parts["away"]),
        tuple(parts["wave"]), tuple(parts["gap_sd"]), tuple(parts["info"]), tuple(parts["speed"]),
        {wear: (np.mean(signatures[wear], axis=0), np.mean(signature_waves[wear], axis=0)) for wear in signatures},
    )  # fmt: skip


def drawn_life(generator: Generator, life: Life, seed: int, order: float) -> RunHistory:
    """A life from the generator: always the same one for a seed."""
    rng = np.random.default_rng([seed, life.number, 3])
    drives, p = generator.levels.shape
    own = int(rng.integers(drives))
    # level and slopes of a real drive, moved by a part of the spread between drives
    spread = generator.levels.std(axis=0)
    level = generator.levels[own] + 0.3 * spread * rng.standard_normal(p)
    slope = generator.slopes[own] * rng.uniform(0.85, 1.15)
    size = generator.amplitude_levels[own]
    season = rng.random()
    times = np.sort(BEGIN_S + np.arange(life.runs) * WEEK_S + rng.uniform(-JITTER_S, JITTER_S, life.runs))
    warmer_k = np.array([ambient_k(float(t), rng, season) for t in times])
    theta, information = np.empty((life.runs, p)), np.empty((life.runs, p, p))
    waves, speed, gap_sd = np.empty((life.runs, 3)), np.empty(life.runs), np.empty(life.runs)
    from_level, of_waves = generator.wears.get(life.wear, (np.zeros(p), np.zeros(3)))
    ratio = np.abs(level)
    scale = np.array([ratio[0], ratio[1], ratio[2], ratio[2], ratio[2], ratio[1], ratio[2], ratio[2]])[:p]
    for begin in range(0, life.runs, BLOCK):
        source = int(rng.integers(drives))
        count = generator.speeds[source].size
        first = int(rng.integers(0, max(1, count - BLOCK + 1)))
        for run in range(begin, min(begin + BLOCK, life.runs)):
            k = first + run - begin
            share = wear_share(life, run)
            theta[run] = level + slope * warmer_k[run] + generator.deviations[source][k] + share * from_level * scale
            information[run] = generator.information[source][k]
            waves[run] = size + generator.amplitudes[source][k] + share * of_waves
            speed[run] = generator.speeds[source][k]
            gap_sd[run] = generator.gap_sds[source][k]
    whole, matrix = np.zeros((life.runs, len(PARAMETERS))), np.zeros((life.runs, len(PARAMETERS), len(PARAMETERS)))
    whole[:, :p], matrix[:, :p, :p] = theta, information
    amplitudes = np.full((life.runs, ORDERS.size), np.nan)
    amplitudes[:, int(np.flatnonzero(order == ORDERS)[0])] = np.exp(waves[:, 0])
    degc = MEAN_DEGC + warmer_k + THERMOMETER_K * rng.standard_normal(life.runs)
    names = np.array([f"{life.number}_{k}" for k in range(life.runs)])
    return RunHistory(
        times, whole, matrix, PARAMETERS, np.exp(waves[:, 1]), amplitudes, ORDERS, speed, degc, names,
        np.exp(waves[:, 2]), gap_sd,
    )  # fmt: skip


def fleet_of_lives(drives: int, runs: int, seed: int, wears: Sequence[str], worn_share: float) -> list[Life]:
    """Lives of which a share wears, by each law in turn; when, and whether at once or slowly, is drawn."""
    found, turn = [], 0
    for number in range(drives):
        rng = np.random.default_rng([seed, number, 0])
        first, ramp = int(rng.integers(12, runs - 22)), int(rng.choice([0, rng.integers(4, 12)]))
        worn = int((number + 1) * worn_share) > int(number * worn_share)
        found.append(Life(number, runs, wears[turn % len(wears)] if worn else NONE, first, ramp))
        turn += worn
    return found

"""Simulated lives: drives of one model over a year of weekly runs, each run on the simulated drive's own plant.

The plant has five frictional surfaces, roughness, a gap and cogging: laws that no fit of the records shares.
Temperature follows season, hour and warm-up; the load and the profile of a run are drawn. Wear is a change of the
plant's configuration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fffo_drive.control.envelope import TRIP_NONE
from fffo_drive.control.reference import MODE_VELOCITY, Profile, piecewise_linear
from fffo_drive.drive.simulated.parameters import EffectConfig, PlantConfig
from fffo_drive.evaluation.campaign import Candidate, Case, simulate
from fffo_drive.identification.dataset import Record

Floats = npt.NDArray[np.float64]

WEEK_S = 7.0 * 86400.0
BEGIN_S = 1_735_689_600.0  # 2025-01-01
JITTER_S = 1.5 * 86400.0  # of a weekly run
LARGEST_K = 15.0  # of temperature, from the mean
SEASON_K, HOUR_K, CHANCE_K = 7.0, 4.0, 2.0
VISCOUS_PER_K = (-0.022, 0.004)  # mean and spread over drives
COULOMB_PER_K = (-0.004, 0.001)
WARM_UP_K_PER_W, WARM_UP_S = 20.0, 30.0
LEVEL_SPREAD, VISCOUS_SPREAD, INERTIA_SPREAD = 0.10, 0.12, 0.04  # over drives, of logarithms
INERTIA_SHARE = 0.4  # of what another population has more of friction, that it has more of inertia
GAP_REV, COGGING_NM, COGGING_ORDER = 0.02, 0.004, 12.0
GAP_SPREAD, COGGING_SPREAD = 0.10, 0.15
PAYLOADS = (-0.08, 0.0, 0.12)  # of the inertia
PAYLOAD_UNBALANCE_NM = 0.004
RUN_S = (5.0, 10.0)
SPEED_RPS = (4.0, 12.0)  # largest of a run
MOVES_A_SECOND = 1.6
NONE, COULOMB, BACKLASH, RIPPLE = "none", "coulomb", "backlash", "ripple"
WEARS = {COULOMB: 0.10, BACKLASH: 0.20, RIPPLE: 1.00}  # the size that has to be found


class Life(NamedTuple):
    """A drive and what happens to it."""

    number: int
    runs: int
    wear: str
    first: int  # run at which it begins
    ramp: int  # runs until the whole size; 0: a step
    more_friction: float = 0.0  # share, of a drive of another population


class LifeRun(NamedTuple):
    """Facts of one run of a life."""

    time_s: float
    temperature_degc: float
    wear: float  # share of the size, 0 to 1
    plant: PlantConfig
    profile: Profile


def wear_share(life: Life, run: int) -> float:
    """Share of the whole wear at a run."""
    if life.wear == NONE or run < life.first:
        return 0.0
    return 1.0 if life.ramp == 0 else min(1.0, (run - life.first + 1) / life.ramp)


def ambient_k(time_s: float, rng: np.random.Generator, season_turns: float) -> float:
    """Temperature less its mean at a time of the year, within LARGEST_K."""
    season = SEASON_K * math.sin(2.0 * math.pi * (time_s / (365.25 * 86400.0) + season_turns))
    hour = HOUR_K * math.sin(2.0 * math.pi * (time_s % 86400.0) / 86400.0)
    return float(np.clip(season + hour + CHANCE_K * rng.standard_normal(), -LARGEST_K, LARGEST_K))


def random_profile(rng: np.random.Generator, period_s: float) -> Profile:
    """Moves between random speeds in both directions, with rests: no two runs alike."""
    duration_s = float(rng.uniform(*RUN_S))
    top_rps = float(rng.uniform(*SPEED_RPS))
    count = max(6, round(MOVES_A_SECOND * duration_s))
    edges = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 1.5, count))])
    edges *= duration_s / edges[-1]
    levels = top_rps * np.sign(rng.standard_normal(count)) * rng.uniform(0.03, 1.0, count) ** 1.5
    levels[rng.random(count) < 0.15] = 0.0
    times, values = [0.0], [0.0]
    for k in range(count):
        ramp_s = min(0.4 * (edges[k + 1] - edges[k]), 0.05 + 0.15 * rng.random())
        times += [edges[k] + ramp_s, edges[k + 1]]
        values += [levels[k], levels[k]]
    return piecewise_linear("life", MODE_VELOCITY, period_s, np.array(times), np.array(values))


def life_runs(life: Life, nominal: PlantConfig, period_s: float, seed: int) -> list[LifeRun]:
    """All runs of a life; the same for the same seed."""
    own = np.random.default_rng([seed, life.number, 1])
    level, viscous, inertia = (
        math.exp(s * own.standard_normal()) for s in (LEVEL_SPREAD, VISCOUS_SPREAD, INERTIA_SPREAD)
    )
    level *= 1.0 + life.more_friction
    inertia *= 1.0 + INERTIA_SHARE * life.more_friction
    gap = GAP_REV * math.exp(GAP_SPREAD * own.standard_normal())
    cogging = COGGING_NM * math.exp(COGGING_SPREAD * own.standard_normal())
    phase, season = own.random(2)
    viscous_per_k = own.normal(*VISCOUS_PER_K)
    coulomb_per_k = own.normal(*COULOMB_PER_K)
    payload = int(own.integers(0, len(PAYLOADS)))
    found = []
    for run in range(life.runs):
        rng = np.random.default_rng([seed, life.number, 2, run])
        time_s = BEGIN_S + run * WEEK_S + float(rng.uniform(-JITTER_S, JITTER_S))
        warmer_k = ambient_k(time_s, rng, season)
        if rng.random() < 0.3:
            payload = int(rng.integers(0, len(PAYLOADS)))
        share = wear_share(life, run)
        grown = 1.0 + (WEARS[COULOMB] * share if life.wear == COULOMB else 0.0)
        friction = nominal.friction.scaled(level=level * grown * (1.0 + coulomb_per_k * warmer_k))
        factor = viscous * math.exp(viscous_per_k * warmer_k)
        friction = replace(
            friction,
            surfaces=tuple(replace(s, viscous_nm_per_rps=factor * s.viscous_nm_per_rps) for s in friction.surfaces),
        )
        gap_now = gap * (1.0 + (WEARS[BACKLASH] * share if life.wear == BACKLASH else 0.0))
        cogging_now = cogging * (1.0 + (WEARS[RIPPLE] * share if life.wear == RIPPLE else 0.0))
        unbalance_nm = PAYLOAD_UNBALANCE_NM * (1.0 + 2.0 * PAYLOADS[payload])
        effects = (
            EffectConfig("backlash", {"gap_rev": gap_now}),
            EffectConfig("cogging", {"amplitude_nm": cogging_now, "order": COGGING_ORDER, "phase_rev": phase}),
            EffectConfig("unbalance", {"amplitude_nm": unbalance_nm, "phase_rev": phase}),
        )
        plant = replace(
            nominal, seed=int(rng.integers(1, 2**31)), friction=friction, effects=effects,
            inertia_kg_m2=nominal.inertia_kg_m2 * inertia * (1.0 + PAYLOADS[payload]),
            initial_angle_rev=float(rng.uniform(-0.5, 0.5)),
            thermal=replace(
                nominal.thermal, k_per_w=WARM_UP_K_PER_W, time_constant_s=WARM_UP_S,
                viscous_per_k=viscous_per_k, coulomb_per_k=coulomb_per_k,
            ),
        )  # fmt: skip
        found.append(LifeRun(time_s, 25.0 + warmer_k, share, plant, random_profile(rng, period_s)))
    return found


def recorded(case: Case, candidate: Candidate, run: LifeRun, name: str) -> Record:
    """The run on the plant, as a record. ValueError where the envelope tripped."""
    rows, trip = simulate(case._replace(plant=run.plant, profile=run.profile), candidate)
    if trip != TRIP_NONE:
        raise ValueError(f"{name}: the envelope tripped")
    rows = rows[rows["profile_sample"] >= 0]
    columns = {key: np.ascontiguousarray(rows[key]) for key in ("position_rev", "velocity_rps", "reference_rps")}
    return Record(
        name=name, path=Path(name), period_s=run.profile.period_s,
        torque_constant_nm_per_a=run.plant.torque_constant_nm_per_a,
        current_a=np.ascontiguousarray(rows["current_command_a"]), lsb_rev=2.0**-run.plant.resolver.bits,
        breaks=(), digest=name, **columns,
    )  # fmt: skip


def lives(drives: int, runs: int, seed: int, wears: Sequence[str]) -> list[Life]:
    """Drives in turn with each of `wears`; when it begins and whether it is a step or a ramp is drawn."""
    found = []
    for number in range(drives):
        rng = np.random.default_rng([seed, number, 0])
        first = int(rng.integers(12, max(13, runs - 22)))
        ramp = int(rng.choice([0, rng.integers(4, 12)]))
        found.append(Life(number, runs, wears[number % len(wears)], first, ramp))
    return found

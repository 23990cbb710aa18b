"""The search: every law at every point of its shape grid, scored on what the base model leaves over."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..identification.facts import DriveFacts
from ..identification.prediction import THREADS
from ..identification.ranking import lower, ranked
from ..model.effects.law import SearchContext
from ..model.effects.laws.lookup import UNKNOWN
from ..model.effects.registry import LAWS
from .base import NAMES
from .candidates import Columns, Effect, Scene, effect_of, strength_columns
from .current_side import driving_a
from .evidence import Evidence, Score, score
from .paths import Rows
from .spectra import frequency_peaks, order_peaks, slow_orders

Floats = npt.NDArray[np.float64]

PEAKS = 4  # of each spectrum that become trials
SURROGATES = 400
SMALLEST = 1e-12  # probability that is stated: no tail is known beyond


class Trial(NamedTuple):
    """A law at its best shape."""

    name: str
    shapes: dict[str, float]
    explained: float  # fall of the white sum of squares
    rank: int
    effect: Effect
    window_scores: Floats
    columns: Columns


class Screening(NamedTuple):
    """What a search found."""

    trials: tuple[Trial, ...]  # best shape of every law, what explains most first
    threshold: float  # of `explained`, which noise alone passes in the stated share of searches
    surrogate_maxima: Floats  # (surrogates,) largest statistic of the whole search, noise alone
    tried: int


def search_context(
    rows: Rows, scenes: Sequence[Scene], physical: Floats, residual_nm: Floats, facts: DriveFacts
) -> SearchContext:
    """Facts of the data that the grids are laid over, with the orders and frequencies that stand out."""
    value = {name: float(physical[k]) for k, name in enumerate(NAMES)}
    speed = np.abs(rows.velocity_rps[rows.kept])
    torque = np.concatenate([s.motion[:, 5] for s in scenes])
    kt = facts.torque_constant_nm_per_a
    sign = np.tanh(rows.velocity_rps / max(0.02 * float(np.quantile(speed, 0.95)), 1e-12))
    row_torque = np.concatenate([rows.laws.rows(kt * s.motion[:, 5]) for s in scenes])
    scaled = row_torque / max(float(np.sqrt(np.mean(row_torque**2))), 1e-12)
    peaks = [
        *order_peaks(rows, residual_nm, PEAKS), *order_peaks(rows, residual_nm * sign, PEAKS),
        *order_peaks(rows, residual_nm * scaled, PEAKS),
    ]  # fmt: skip
    orders = sorted({p.place for p in peaks})
    longest = max(end - begin for begin, end in rows.bounds) * rows.filter.row_period_s
    return SearchContext(
        duration_s=float(np.ptp(rows.time_s)) if facts.units == "rotary" else longest,
        period_s=rows.filter.period_s,
        lowest_rps=float(np.quantile(speed, 0.02)),
        slow_rps=float(np.quantile(speed, 0.1)),
        highest_rps=float(np.quantile(speed, 0.999)),
        low_rev=float(rows.position_rev.min()),
        high_rev=float(rows.position_rev.max()),
        highest_current_a=float(np.quantile(np.abs(torque), 0.9999)),
        highest_torque_nm=float(kt * np.quantile(np.abs(torque), 0.9999)),
        driving_a=driving_a(scenes),
        coulomb_nm=value["coulomb_nm"],
        static_nm=value["static_nm"],
        stiffness_per_rev=value["stiffness_per_rev"],
        attraction_nm_per_rev=value["attraction_nm_per_rev"],
        gear_ratio=facts.gear_ratio,
        pole_pairs=facts.pole_pairs,
        slots=facts.slots,
        orders=tuple(orders),
        slow_orders=slow_orders(rows, residual_nm),
        slow_level_orders=slow_orders(rows, residual_nm * sign),
        frequencies_hz=tuple(p.place for p in frequency_peaks(rows, residual_nm, PEAKS)),
    )


def screen(
    evidence: Evidence, scenes: Sequence[Scene], context: SearchContext, absolute: bool, false_alarm_rate: float,
    names: Collection[str] | None = None, told: Callable[[float], None] | None = None, seed: int = 1,
) -> Screening:  # fmt: skip
    """Score every law of the library (or `names`) and calibrate the threshold over all of it."""
    work = [
        (name, shape)
        for name, law in LAWS.items()
        if (names is None or name in names) and not name.startswith(UNKNOWN)
        for shape in law.search(context)
    ]
    best: dict[str, Trial] = {}
    surrogates = Surrogates(evidence, seed)
    rows = evidence.rows
    runs = int(rows.run.max()) + 1

    def one(item: tuple[str, dict[str, float]]) -> tuple[str, dict[str, float], Columns, Score]:
        name, shape = item
        columns = strength_columns(scenes, name, shape, rows, absolute)
        return name, shape, columns, score(evidence, columns.values)

    with ThreadPoolExecutor(THREADS) as pool:
        for number, (name, shape, columns, found) in enumerate(pool.map(one, work)):
            if told is not None:
                told((number + 1) / len(work))
            if found.rank == 0:
                continue
            surrogates.take(found)
            if name not in best or lower(-found.explained, -best[name].explained):
                effect = effect_of(name, shape, columns, found.strengths, runs)
                best[name] = Trial(name, dict(shape), found.explained, found.rank, effect, found.window_scores, columns)
    trials = ranked(best.values(), key=lambda t: -penalised(t, evidence))
    maxima = surrogates.maxima
    threshold = float(np.quantile(maxima, 1.0 - false_alarm_rate)) if work else np.inf
    return Screening(tuple(trials), threshold, np.sort(maxima), len(work))


class Surrogates:
    """The largest statistic of a whole search where noise alone was searched: the windows' signs are drawn anew."""

    def __init__(self, evidence: Evidence, seed: int) -> None:
        draw = np.random.default_rng(seed)
        self._signs = draw.choice(np.array([-1.0, 1.0]), (SURROGATES, evidence.windows))
        self._variance = max(evidence.energy / max(1, evidence.residual.size), 1e-12)
        self.maxima = np.zeros(SURROGATES)

    def take(self, score: Score) -> None:
        """One more candidate of the search."""
        flipped = self._signs @ score.window_scores
        statistic = np.einsum("ij,ij->i", flipped, flipped) / self._variance
        np.maximum(self.maxima, comparable(statistic, max(1, score.rank)), out=self.maxima)

    def statistic(self, score: Score) -> float:
        """The statistic of the data themselves, on the same scale."""
        return float(comparable(np.array([score.explained / self._variance]), max(1, score.rank))[0])


def comparable(statistic: Floats, rank: int) -> Floats:
    """Chi-square statistics of different rank on one scale: as normal deviates, squared (Wilson and Hilferty)."""
    share = np.cbrt(np.maximum(statistic, 0.0) / rank)
    deviate = (share - (1.0 - 2.0 / (9.0 * rank))) / np.sqrt(2.0 / (9.0 * rank))
    return np.asarray(np.where(deviate > 0.0, deviate * deviate, 0.0))


def penalised(trial: Trial, evidence: Evidence) -> float:
    """What a trial explains, less what as many free numbers cost."""
    free = trial.rank + len(trial.shapes)
    return trial.explained - free * float(np.log(max(2, evidence.residual.size)))


def false_alarm_probability(statistic: float, maxima: Floats) -> float:
    """Share of surrogate searches that reach a statistic, with an exponential tail beyond the largest."""
    reached = float(np.mean(maxima >= statistic))
    if reached > 0.02:
        return reached
    tail = maxima[-max(10, maxima.size // 10) :]
    scale = max(float(np.mean(tail - tail[0])), 1e-9)
    return float(min(1.0, max(SMALLEST, tail.size / maxima.size * np.exp(-(statistic - tail[0]) / scale))))

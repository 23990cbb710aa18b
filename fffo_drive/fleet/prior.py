"""The population as a prior: what drives of a model are, and a drive after seconds of motion.

Random effects: the parameters of drive d are theta_d ~ N(mean, covariance) at one temperature, and move with it along a
slope of the drive's own, of which level and slope have one joint covariance. A run estimates the parameters at its
temperature with the covariance I^-1 + scatter, I its information. `population_of` fits mean and covariance by EM with
the correction of restricted maximum likelihood for the mean, drives that stand outside weighing less; `posterior` is
the drive given the population, both in closed form (Laird and Ware, Biometrics 38, 1982). Intervals are Student's with
as many degrees of freedom as drives determine the covariance; a drive of another population is found by its
Mahalanobis distance, held against Hotelling's distribution, or by one parameter of it, against Student's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy  # its modules load where they are first used

from .. import formats
from ..arrays import Floats
from ..units import MAD_TO_SD
from .channels import MEAN_DEGC, STEP_K, Stack, marginal, stacked
from .history import RunHistory
from .learning import learned
from .matrices import inverse_total

LEAST_DRIVES = 3
ROUNDS = 60
OUTLIER_P = 0.01  # a drive further out than this weighs less
LEAST_SPREAD = 1e-3  # of a scale, between drives: a covariance has to have an inverse
OTHER_POPULATION_P = 0.01  # a drive that is further out is reported
DETERMINED = 1e-6  # of the largest information, over the population's spread: what has less is not determined


class Warming(NamedTuple):
    """How temperature moves drives of one model; p columns of the records."""

    degc: float  # mean of the runs, at which a population's mean and covariance are
    sd_k: float  # of the runs' temperatures
    slope_per_k: Floats  # (p,) mean over drives
    level_slope: Floats  # (p, p) covariance over drives of level (rows) and slope (columns), per K
    slope_covariance: Floats  # (p, p) over drives, per K2


class Population(NamedTuple):
    """Drives of one model; p columns of the records."""

    names: tuple[str, ...]  # (p,)
    mean: Floats  # (p,)
    covariance: Floats  # (p, p) between drives
    scatter: Floats  # (p, p) between runs of one drive, beside their information
    drives: int
    warming: Warming | None = None  # None: the scatter includes that of temperature
    model: str = ""

    def at(self, temperature_degc: float | None) -> tuple[Floats, Floats]:
        """Mean (p,) of drives and covariance (p, p) between them at a temperature; None: as warm as runs are."""
        w = self.warming
        if w is None:
            return self.mean, self.covariance
        if temperature_degc is None:
            spread = w.slope_covariance + np.outer(w.slope_per_k, w.slope_per_k)
            return self.mean, self.covariance + w.sd_k**2 * spread
        warmer_k = temperature_degc - w.degc
        both = warmer_k * (w.level_slope + w.level_slope.T)
        return self.mean + warmer_k * w.slope_per_k, self.covariance + both + warmer_k**2 * w.slope_covariance

    def as_plain(self) -> dict[str, Any]:
        """JSON- and YAML-ready."""
        warming = None
        if self.warming is not None:
            warming = {key: value.tolist() if isinstance(value, np.ndarray) else value
                       for key, value in self.warming._asdict().items()}  # fmt: skip
        return {
            "format": formats.POPULATION.word, "names": list(self.names), "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(), "scatter": self.scatter.tolist(), "drives": self.drives,
            "warming": warming, "model": self.model,
        }  # fmt: skip


class RunEstimate(NamedTuple):
    """What one run gives by itself; k columns, all or some of them those of a population, in any order."""

    names: tuple[str, ...]  # (k,)
    theta: Floats  # (k,) nan where the motion determines nothing
    information: Floats  # (k, k) 0 there
    temperature_degc: float | None = None  # mean of the run; None: not logged


class Posterior(NamedTuple):
    """A drive by its own motion and by its population; p parameters."""

    names: tuple[str, ...]
    theta: Floats  # (p,)
    covariance: Floats  # (p, p)
    dof: float  # of the intervals
    p: float  # chance that a drive of the population is as far out
    other_population: bool
    prior: Floats  # (p,) mean of the population at the runs' temperature
    prior_sd: Floats  # (p,) between drives there
    own: Floats  # (p,) by the runs alone; nan where they determine nothing
    own_sd: Floats  # (p,) with the scatter between runs
    away_sd: Floats  # (p,) of the runs alone from the population, over the deviation that both explain; nan likewise

    def interval(self, confidence: float = 0.95) -> Floats:
        """Both ends of each parameter's interval. (p, 2)"""
        reach = scipy.stats.t.ppf(0.5 + 0.5 * confidence, self.dof) * np.sqrt(np.diag(self.covariance))
        return np.column_stack([self.theta - reach, self.theta + reach])


def population_from_plain(plain: Mapping[str, Any]) -> Population:
    """What `Population.as_plain` wrote. Raises ValueError for anything else."""
    needed = ("names", "mean", "covariance", "scatter", "drives")
    missing = [key for key in ("format", *needed) if key not in plain]
    if missing or plain["format"] != formats.POPULATION.word:
        said = (
            f"lacks {', '.join(missing)}"
            if missing
            else f"format is {plain['format']!r}, not {formats.POPULATION.word!r}"
        )
        raise ValueError(f"not a population: {said}")
    names = tuple(str(name) for name in plain["names"])
    size = len(names)

    def array(source: Mapping[str, Any], key: str, shape: tuple[int, ...]) -> Floats:
        values = np.array(source.get(key), dtype=np.float64)
        if values.shape != shape:
            raise ValueError(f"not a population: {key} has the shape {values.shape}, {size} names need {shape}")
        return values

    warming, stored = None, plain.get("warming")
    if stored is not None:
        square = (size, size)
        warming = Warming(
            float(stored["degc"]), float(stored["sd_k"]), array(stored, "slope_per_k", (size,)),
            array(stored, "level_slope", square), array(stored, "slope_covariance", square),
        )  # fmt: skip
    return Population(
        names, array(plain, "mean", (size,)), array(plain, "covariance", (size, size)),
        array(plain, "scatter", (size, size)), int(plain["drives"]), warming, str(plain.get("model", "")),
    )  # fmt: skip


def population_of(histories: Mapping[str, RunHistory], model: str = "") -> Population:
    """Fit a population to drives of one model. Raises ValueError for fewer than LEAST_DRIVES.

    Where temperatures are logged (of LEAST_DRIVES at least, which alone then count), the posterior is the drive at the
    temperature of its runs. Else the scatter includes that of temperature, and it is the drive at its mean temperature.
    """
    if len(histories) < LEAST_DRIVES:
        raise ValueError(f"{len(histories)} drives: a population needs {LEAST_DRIVES} at least")
    stack = stacked(histories)
    logged = np.flatnonzero(stack.seen == 1.0)
    if logged.size >= LEAST_DRIVES:
        stack = stack.part(logged, stack.bounds[logged + 1])
    else:
        stack = stack._replace(seen=np.full_like(stack.seen, np.nan), temperature=np.zeros_like(stack.temperature))
        logged = logged[:0]
    fleet, _ = learned(stack)
    scale = np.median(stack.scales, axis=0)
    size = np.outer(scale, scale)
    scatter = fleet.covariance if logged.size else fleet.ambient_covariance
    steps = stack.temperature[np.isfinite(stack.temperature)]
    middle = float(steps.mean()) if steps.size else 0.0
    mean, covariance, drives = _between(stack, scatter, scale, middle if logged.size else None)
    p = scale.size
    warming = None
    if logged.size:
        warming = Warming(
            MEAN_DEGC + STEP_K * middle, STEP_K * float(steps.std()), mean[p:] * scale / STEP_K,
            covariance[:p, p:] * size / STEP_K, covariance[p:, p:] * size / STEP_K**2,
        )  # fmt: skip
    return Population(
        stack.columns, mean[:p] * scale, covariance[:p, :p] * size, scatter * size, drives, warming, model
    )


def _between(stack: Stack, scatter: Floats, scale: Floats, middle: float | None) -> tuple[Floats, Floats, int]:
    """Random effects of drives over `scale` (p,), and how many: levels, and with a middle of temperatures slopes."""
    to_scale = stack.scales / scale  # the fleet's scales for every drive: drives differ, and that is what is asked
    counts = np.diff(stack.bounds)
    by_run = np.repeat(to_scale, counts, axis=0)
    theta = stack.theta * by_run
    inverse = inverse_total(stack.information / (by_run[:, :, None] * by_run[:, None, :]), scatter)
    if middle is not None:
        inverse = np.where(np.isfinite(stack.temperature)[:, None, None], inverse, 0.0)
    design = np.ones((theta.shape[0], 1))
    if middle is not None:
        design = np.column_stack([design, np.nan_to_num(stack.temperature - middle)])
    terms = design.shape[1] * scale.size
    total = np.einsum("na,nb,nij->naibj", design, design, inverse).reshape(-1, terms, terms)
    moment = np.einsum("na,nij,nj->nai", design, inverse, theta).reshape(-1, terms)
    begins = stack.bounds[:-1][counts > 0]
    found = random_effects(np.add.reduceat(total, begins, axis=0), np.add.reduceat(moment, begins, axis=0))
    return *found, int(begins.size)


def random_effects(information: Floats, moment: Floats) -> tuple[Floats, Floats]:
    """Mean (p,) and covariance (p, p) between drives, by each one's information (d, p, p) and that times theta (d, p).

    Outliers weigh less. What no drive determines keeps the smallest spread.
    """
    size = moment.shape[1]
    limit = float(scipy.stats.chi2.ppf(1.0 - OUTLIER_P, size))
    known = information + 1e-9 * np.einsum("dii->di", information).max() * np.eye(size)
    own = np.linalg.solve(known, moment[:, :, None])[:, :, 0]
    mean = np.median(own, axis=0)
    spread = MAD_TO_SD * np.median(np.abs(own - mean), axis=0)
    floor = LEAST_SPREAD**2 * np.eye(size)
    covariance = np.diag(spread**2) + floor
    for _ in range(ROUNDS):
        inverse = inverse_total(information, covariance)
        away = own - mean
        distance = np.einsum("di,dij,dj->d", away, inverse, away)
        weight = np.minimum(1.0, limit / np.maximum(distance, 1e-12)) ** 2  # far out: next to nothing
        weighted = inverse * weight[:, None, None]
        of_mean = np.linalg.pinv(weighted.sum(axis=0), hermitian=True)
        mean = of_mean @ np.einsum("dij,dj->i", weighted, own)
        inner = np.einsum("dij,dj->di", inverse, own - mean) @ covariance
        left = covariance - covariance @ inverse @ covariance
        # REML: the mean is estimated too
        left = left + covariance @ inverse @ of_mean @ inverse @ covariance
        covariance = np.einsum("d,dij->ij", weight, inner[:, :, None] * inner[:, None, :] + left) / weight.sum()
        covariance = 0.5 * (covariance + covariance.T) + 1e-12 * np.eye(size)
    return mean, covariance + floor


def posterior(population: Population, runs: Sequence[RunEstimate]) -> Posterior:
    """A drive of the population, by the estimates of its runs.

    At the mean temperature of the runs where all have one, else as warm as runs of the population are. Raises
    ValueError for no run, sizes that do not go together, and a parameter of the population that a run does not have.
    """
    if not runs:
        raise ValueError("no run")
    degc = [run.temperature_degc for run in runs if run.temperature_degc is not None]
    logged = population.warming is not None and len(degc) == len(runs)
    at_degc = float(np.mean(degc)) if logged else None
    mean, between = population.at(at_degc)
    scale = np.sqrt(np.diag(between))
    both = np.outer(scale, scale)
    scatter = population.scatter / both
    own, moment = np.zeros_like(between), np.zeros_like(mean)
    for run in runs:
        theta, information = _columns_of(run, population.names)
        away = theta - (population.at(run.temperature_degc)[0] if logged else mean)
        part = inverse_total(information * both, scatter)
        own += part
        moment += part @ (np.where(np.isfinite(away), away, 0.0) / scale)
    between = between / both
    precision = np.linalg.inv(between)
    covariance = np.linalg.inv(precision + own)
    values, directions = np.linalg.eigh(own)
    known = values > DETERMINED * max(float(values[-1]), 1e-300)
    inverse = (directions[:, known] / values[known]) @ directions[:, known].T
    alone = inverse @ moment
    sure = np.einsum("ij->i", directions[:, known] ** 2) > 1.0 - DETERMINED
    # (own^-1 + between)^-1, also where the motion determines only a part
    distance = float(alone @ own @ covariance @ precision @ alone)
    own_variance = np.where(sure, np.diag(inverse), np.nan)
    away_sd = alone / np.sqrt(1.0 + own_variance)
    dof = max(population.drives - 1.0, 2.0)
    p = _chance(distance, int(known.sum()), away_sd[sure], population.drives)
    return Posterior(
        population.names, mean + covariance @ moment * scale, covariance * both, dof, p, p < OTHER_POPULATION_P,
        mean, scale, np.where(sure, mean + alone * scale, np.nan), np.sqrt(own_variance) * scale,
        away_sd,
    )  # fmt: skip


def _columns_of(run: RunEstimate, names: Sequence[str]) -> tuple[Floats, Floats]:
    """A run's estimates of these parameters, whatever its others are."""
    missing = [name for name in names if name not in run.names]
    if missing:
        raise ValueError(f"the population has {', '.join(missing)}, the estimates do not")
    size = len(run.names)
    if run.theta.shape != (size,) or run.information.shape != (size, size):
        raise ValueError(f"{run.theta.size} estimates for {size} names")
    kept = [run.names.index(name) for name in names]
    return run.theta[kept], marginal(run.information[None], kept)[0]


def _chance(distance: float, rank: int, away_sd: Floats, drives: int) -> float:
    """That a drive of the population is as far out, in all parameters together or in one of them.

    The smaller of Hotelling's probability and of Student's of one of so many, for both were looked at: of few drives,
    Hotelling's test sees next to nothing.
    """
    together = _hotelling_p(distance, rank, drives)
    if not away_sd.size:
        return together
    far = float(np.max(np.abs(away_sd))) / np.sqrt(1.0 + 1.0 / drives)  # the mean is estimated too
    alone = away_sd.size * 2.0 * float(scipy.stats.t.sf(far, drives - 1.0))
    return min(1.0, 2.0 * min(together, alone))


def _hotelling_p(distance: float, rank: int, drives: int) -> float:
    if rank == 0:
        return 1.0
    free = drives - rank
    if free < 1:
        return float(scipy.stats.chi2.sf(distance, rank))
    ratio = distance * free * drives / (rank * (drives + 1.0) * (drives - 1.0))
    return float(scipy.stats.f.sf(ratio, rank, free))

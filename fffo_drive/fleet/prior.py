"""The population as a prior: what drives of a model are, and a drive after seconds of motion.

Random effects: the parameters of drive d are theta_d ~ N(mean, covariance); a run of it estimates them with the
covariance I^-1 + scatter, I its information. `population_of` fits mean and covariance by EM with the correction of
restricted maximum likelihood for the mean, drives that stand outside weighing less; `posterior` is the drive given the
population, both in closed form (Laird and Ware, Biometrics 38, 1982). Intervals are Student's with as many degrees of
freedom as drives determine the covariance; a drive of another population is found by its Mahalanobis distance, held
against Hotelling's distribution.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import stats

from .. import formats
from .channels import inverse_total, learned, marginal, stacked
from .history import RunHistory

Floats = npt.NDArray[np.float64]

LEAST_DRIVES = 3
ROUNDS = 60
OUTLIER_P = 0.01  # a drive further out than this weighs less
LEAST_SPREAD = 1e-3  # of a scale, between drives: a covariance has to have an inverse
OTHER_POPULATION_P = 0.01  # a drive that is further out is reported


class Population(NamedTuple):
    """Drives of one model; p columns of the records."""

    names: tuple[str, ...]  # (p,)
    mean: Floats  # (p,)
    covariance: Floats  # (p, p) between drives
    scatter: Floats  # (p, p) between runs of one drive, beside their information
    drives: int

    def as_plain(self) -> dict[str, Any]:
        """JSON- and YAML-ready."""
        return {
            "format": formats.POPULATION.word, "names": list(self.names), "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(), "scatter": self.scatter.tolist(), "drives": self.drives,
        }  # fmt: skip


class Posterior(NamedTuple):
    """A drive by its own motion and by its population; p parameters."""

    names: tuple[str, ...]
    theta: Floats  # (p,)
    covariance: Floats  # (p, p)
    dof: float  # of the intervals
    p: float  # chance that a drive of the population is as far out
    other_population: bool

    def interval(self, confidence: float = 0.95) -> Floats:
        """Both ends of each parameter's interval. (p, 2)"""
        reach = stats.t.ppf(0.5 + 0.5 * confidence, self.dof) * np.sqrt(np.diag(self.covariance))
        return np.column_stack([self.theta - reach, self.theta + reach])


def population_from_plain(plain: Mapping[str, Any]) -> Population:
    """What `Population.as_plain` wrote. Raises ValueError for anything else."""
    missing = [key for key in ("format", *Population._fields) if key not in plain]
    if missing or plain["format"] != formats.POPULATION.word:
        said = (
            f"lacks {', '.join(missing)}"
            if missing
            else f"format is {plain['format']!r}, not {formats.POPULATION.word!r}"
        )
        raise ValueError(f"not a population: {said}")
    names = tuple(str(name) for name in plain["names"])
    mean, covariance, scatter = (np.array(plain[key], dtype=np.float64) for key in ("mean", "covariance", "scatter"))
    if mean.shape != (len(names),) or covariance.shape != scatter.shape or covariance.shape != (len(names),) * 2:
        raise ValueError(f"not a population: {len(names)} names do not go with the sizes of mean and covariance")
    return Population(names, mean, covariance, scatter, int(plain["drives"]))


def population_of(histories: Mapping[str, RunHistory]) -> Population:
    """Fit a population to drives of one model. Raises ValueError for fewer than LEAST_DRIVES.

    Where temperatures are logged, weather is between drives and not in the scatter: the posterior is the drive as it is
    now. Else weather is in the scatter, and the posterior is the drive on the average of the weather.
    """
    if len(histories) < LEAST_DRIVES:
        raise ValueError(f"{len(histories)} drives: a population needs {LEAST_DRIVES} at least")
    stack = stacked(histories)
    fleet, _ = learned(stack)
    scale = np.median(stack.scales, axis=0)
    to_scale = stack.scales / scale  # the fleet's scales for every drive: drives differ, and that is what is asked
    counts = np.diff(stack.bounds)
    by_run = np.repeat(to_scale, counts, axis=0)
    theta = stack.theta * by_run
    information = stack.information / (by_run[:, :, None] * by_run[:, None, :])
    logged = bool(stack.logged.any())
    scatter = fleet.covariance if logged else fleet.weather_covariance
    inverse = inverse_total(information, fleet.weather_covariance)
    begins = stack.bounds[:-1][counts > 0]
    total = np.add.reduceat(inverse, begins, axis=0)
    moment = np.add.reduceat(np.einsum("nij,nj->ni", inverse, theta), begins, axis=0)
    mean, covariance = random_effects(total, moment)
    if logged:
        covariance = covariance + _positive(fleet.weather_covariance - fleet.covariance)
    size = np.outer(scale, scale)
    return Population(stack.columns, mean * scale, covariance * size, scatter * size, int(begins.size))


def random_effects(information: Floats, moment: Floats) -> tuple[Floats, Floats]:
    """Mean (p,) and covariance (p, p) between drives, by each one's information (d, p, p) and that times theta (d, p).

    Outliers weigh less. What no drive determines keeps the smallest spread.
    """
    size = moment.shape[1]
    limit = float(stats.chi2.ppf(1.0 - OUTLIER_P, size))
    known = information + 1e-9 * np.einsum("dii->di", information).max() * np.eye(size)
    own = np.linalg.solve(known, moment[:, :, None])[:, :, 0]
    mean = np.median(own, axis=0)
    spread = 1.4826 * np.median(np.abs(own - mean), axis=0)
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


def posterior(
    population: Population, theta: Floats, information: Floats, names: Sequence[str] | None = None
) -> Posterior:
    """A drive of the population by the estimates `theta` (k,) and `information` (k, k) of its motion.

    `names` (k,): of the estimates, where there are more than the population has, or in another order. `theta` may be
    nan where the motion determines nothing; the information is 0 there. Raises ValueError for sizes that do not go
    together, and for a parameter of the population that is not among the names.
    """
    if names is not None:
        missing = [name for name in population.names if name not in names]
        if missing:
            raise ValueError(f"the population has {', '.join(missing)}, the estimates do not")
        kept = [list(names).index(name) for name in population.names]
        theta, information = theta[kept], marginal(information[None], kept)[0]
    size = len(population.names)
    if theta.shape != (size,) or information.shape != (size, size):
        raise ValueError(f"{theta.size} estimates for the {size} parameters of the population")
    scale = np.sqrt(np.diag(population.covariance))
    both = np.outer(scale, scale)
    away = np.where(np.isfinite(theta), theta - population.mean, 0.0) / scale
    between, scatter = population.covariance / both, population.scatter / both
    own = inverse_total(information * both, scatter)
    precision = np.linalg.inv(between)
    covariance = np.linalg.inv(precision + own)
    moved = covariance @ own @ away
    # (own^-1 + between)^-1, also where the motion determines only a part
    distance = float(away @ own @ covariance @ precision @ away)
    rank = int(np.linalg.matrix_rank(own, tol=1e-9 * max(float(np.trace(own)), 1e-300), hermitian=True))
    dof = max(population.drives - 1.0, 2.0)
    p = _hotelling_p(distance, rank, population.drives)
    return Posterior(
        population.names, population.mean + moved * scale, covariance * both, dof, p, p < OTHER_POPULATION_P
    )


def _hotelling_p(distance: float, rank: int, drives: int) -> float:
    if rank == 0:
        return 1.0
    free = drives - rank
    if free < 1:
        return float(stats.chi2.sf(distance, rank))
    ratio = distance * free * drives / (rank * (drives + 1.0) * (drives - 1.0))
    return float(stats.f.sf(ratio, rank, free))


def _positive(matrix: Floats) -> Floats:
    """The nearest covariance."""
    values, directions = np.linalg.eigh(matrix)
    return np.asarray((directions * np.maximum(values, 0.0)) @ directions.T)

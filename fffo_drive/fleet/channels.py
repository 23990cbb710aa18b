"""Records to channels: one number a run for each law, without the effects of temperature and of the run's motion.

The estimates of one short run are correlated: where it hardly moved fast, viscous friction comes out high and
Coulomb friction low. Between runs they move together as well: along a line with temperature, and with the profile.
So a law is not watched by its own column. With theta_t the estimates of run t over the drive's own scales, I_t their
information and S the covariance between runs, both as a fleet shows it,

    P_t = (I_t^-1 + S)^-1,    y_t = e^T P_t (theta_t - mu_t) / e^T P_t e,    var y_t = 1 / e^T P_t e

is the generalised least-squares estimate of a change along e that leaves all else as it was (Rao's score for it). mu_t
is the drive's own level, from runs before t, and with a logged temperature its own slope. Without one, temperature is a
part of S: what moves along its line, viscous friction and Coulomb friction together, then counts for next to nothing.
Viscous friction stands in for the temperature.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats, Integers, Mask
from ..jit import njit
from ..units import MAD_TO_SD
from .detector import BURN_IN, CLIP
from .history import RunHistory, joined
from .matrices import factor, inverse_total, medians_of_known
from .thermometers import seen_share
from .words import WORDS

# columns of the records: the law that each stands for, the column that is its scale, and the typical standard deviation
# between runs of seconds, over that scale (for a fleet of one; each fleet has its own)
_COULOMB, _STRIBECK = "coulomb_nm", "stribeck_nm"
_VISCOUS, _INERTIA = "viscous_nm_per_rps", "inertia_nm_s2_per_rev"
COLUMNS: Mapping[str, tuple[str, str, float]] = {
    _INERTIA: ("inertia", _INERTIA, 0.07),
    _VISCOUS: ("viscous friction", _VISCOUS, 0.15),
    _COULOMB: ("Coulomb friction", _COULOMB, 0.07),
    _STRIBECK: ("stiction", _COULOMB, 0.20),
    "offset_nm": ("constant torque", _COULOMB, 0.05),
    "viscous_excess_nm_per_rps": ("friction that differs by direction", _VISCOUS, 0.08),
    "gravity_cos_nm": (WORDS["gravity_cos_nm"], _COULOMB, 0.05),
    "gravity_sin_nm": (WORDS["gravity_sin_nm"], _COULOMB, 0.05),
}
WITHOUT_TEMPERATURE = ("viscous friction",)  # not watched: it stands in for the temperature
UNMODELLED = "what no column explains (elasticity)"
BACKLASH = "backlash"
LARGEST_RATIO = 2.5  # of a drive's scale to that of the others of its model
LARGEST_RISE = 3.0  # stiction above Coulomb friction, over it
LARGEST_STEPS = 3.0  # along the line of temperature
CORRELATION = -0.4  # typical, of viscous and Coulomb friction between runs: of the fits, less that of temperature
PRIOR_RUNS = 30.0  # that the typical covariance counts for
PRIOR_DRIVES = 2.0  # ... and typical slopes and spreads
MEAN_DEGC, STEP_K = 25.0, 10.0  # temperatures are counted in steps from this mean
TEMPERATURE_SHARE = 0.8  # of the runs that log a temperature, for it to be used
SLOPE_SDS = 1.5  # slope per step of temperature, before any drive is seen: in typical deviations between runs
GAP_SD = 0.05  # of the logarithm of the gap between runs, beside what each run says: in simulated lives
EXTRA_SD = 0.15  # of logarithms of amplitudes, between runs
REFERENCE_EVERY = 8  # runs after which a drive's own level is taken anew
LEARNED_DRIVES, LEARNED_RUNS = 100, 60  # at most, to learn what a fleet is like
LEAST_TEACHING = BURN_IN + 6  # runs of a drive
LEARNING_ROUNDS = 12
MOST_ORDERS = 6
LEAST_STEADINESS = 2.5  # median amplitude over its spread: that of noise, which is Rayleigh's, has 1.8
ORDER_SHARE = 0.5  # of the runs that have to resolve an order
DRIVES_AT_ONCE = 40  # of about 50 runs: the intermediate arrays fit the processor's cache
LARGEST_NOISE = 25.0  # of a channel's usual variance: beyond it a run says nothing


class Stack(NamedTuple):
    """Runs of d drives, one after the other: n in all, p columns."""

    drives: tuple[str, ...]
    bounds: Integers  # (d + 1,)
    time_s: Floats  # (n,)
    theta: Floats  # (n, p) over the drive's scales; 0 where nothing is known
    information: Floats  # (n, p, p) likewise
    scales: Floats  # (d, p)
    temperature: Floats  # (n,) steps from the mean; 0 for drives without, nan for single runs without
    seen: Floats  # (d,) share of the temperature that a drive's log shows (`thermometers`); nan where it logs none
    log_speed: Floats  # (n,)
    extras: Floats  # (n, k) logarithms of amplitudes and of the gap; nan where a run has none
    extra_variance: Floats  # (n, k) of them
    run: npt.NDArray[np.str_]  # (n,)
    columns: tuple[str, ...]  # (p,)
    orders: tuple[float, ...]  # of extras; rms of the residual and the gap stand behind them

    @property
    def logged(self) -> Mask:
        """(d,) Whether a drive logs a temperature that shows some of its own."""
        return np.asarray(self.seen > 0.0)

    def of(self, drive: int) -> slice:
        """Runs of a drive."""
        return slice(int(self.bounds[drive]), int(self.bounds[drive + 1]))

    def part(self, drives: Integers, ends: Integers) -> Stack:
        """Some drives, each up to a run `ends` (drives,) of all runs."""
        begins = self.bounds[drives]
        runs = np.concatenate([np.arange(begin, end) for begin, end in zip(begins, ends, strict=True)])
        cut = {name: getattr(self, name)[runs] for name in _BY_RUN}
        bounds = np.concatenate([[0], np.cumsum(ends - begins)]).astype(np.int64)
        names = tuple(self.drives[k] for k in drives)
        return self._replace(drives=names, bounds=bounds, scales=self.scales[drives], seen=self.seen[drives], **cut)


_BY_RUN = ("time_s", "theta", "information", "temperature", "log_speed", "extras", "extra_variance", "run")


class FleetPrior(NamedTuple):
    """What a fleet of one model is like, run by run."""

    columns: tuple[str, ...]
    covariance: Floats  # (p, p) between runs, with the temperature taken out
    ambient_covariance: Floats  # (p, p) ... and with it, for drives that log none
    slope: Floats  # (p,) per step of temperature
    slope_sd: Floats  # (p,) between drives
    line: Floats  # (p,) what a step of temperature moves, or one like it where none is logged
    directions: Floats  # (p, p) what each law moves, by its row: its column, and what goes along
    orders: tuple[float, ...]

    def between(self, seen: float) -> Floats:
        """Covariance (p, p) between runs of a drive whose log shows this share of its temperature; nan: it has none."""
        share = float(np.nan_to_num(seen))
        return share * self.covariance + (1.0 - share) * self.ambient_covariance


class Channels(NamedTuple):
    """What is watched: n runs, c channels."""

    laws: tuple[str, ...]  # (c,)
    y: Floats  # (n, c) nan where a run has no value
    variance: Floats  # (n, c)
    covariates: Floats  # (n, 2) temperature and logarithm of speed from its median


def stacked(
    histories: Mapping[str, RunHistory], orders: Sequence[float] | None = None, columns: Sequence[str] | None = None
) -> Stack:
    """Histories of drives of one model. `columns`: of theta; None: those that a run determines.

    Raises ValueError where there are none, or their columns differ.
    """
    if not histories:
        raise ValueError("no drive has records")
    together = joined(histories)
    whole, bounds, information = together.whole, together.bounds, together.whole.information
    if columns is None:
        known = np.any(np.diagonal(information, 0, 1, 2) > 0.0, axis=0)
        columns = [name for name, seen in zip(whole.names, known, strict=True) if seen and name in COLUMNS]
    if not columns:
        raise ValueError("no run determines a parameter")
    columns, kept = tuple(columns), [whole.names.index(name) for name in columns]
    theta = whole.theta[:, kept]
    information = _of_known(information if len(kept) == len(whole.names) else marginal(information, kept), theta)
    theta = np.where(np.isfinite(theta), theta, 0.0)
    scales = _scales(bounds, theta, information, columns)
    by_run = np.repeat(scales, np.diff(bounds), axis=0)
    theta /= by_run
    information = information * by_run[:, :, None]
    information *= by_run[:, None, :]
    degc = whole.temperature_degc
    shares = np.add.reduceat(np.isfinite(degc), bounds[:-1]) / np.maximum(np.diff(bounds), 1)
    steps = (degc - MEAN_DEGC) / STEP_K
    seen = np.where(shares >= TEMPERATURE_SHARE, 1.0, np.nan)
    if _VISCOUS in columns:
        place = columns.index(_VISCOUS)
        variance = _variance(information, place) + typical_covariance(columns)[place, place]
        for drive in np.flatnonzero(np.isfinite(seen)):
            runs = slice(bounds[drive], bounds[drive + 1])
            seen[drive] = seen_share(theta[runs, place], variance[runs], steps[runs])
    temperature = np.where(np.repeat(seen > 0.0, np.diff(bounds)), steps, 0.0)
    chosen, extras, extra_variance = _extras(whole, bounds, orders)
    return Stack(
        tuple(together), bounds, whole.time_s, theta, information, scales, temperature, seen,
        np.log(np.maximum(whole.speed_rms_rps, 1e-6)), extras, extra_variance, whole.run, columns, chosen,
    )  # fmt: skip


def marginal(information: Floats, kept: Sequence[int]) -> Floats:
    """Information of some columns, whatever the others are."""
    rest = [k for k in range(information.shape[1]) if k not in kept]
    if not information[:, rest].any():
        return np.asarray(information[:, kept][:, :, kept])
    inner = np.linalg.pinv(information[:, rest][:, :, rest], hermitian=True)
    cross = information[:, kept][:, :, rest]
    return np.asarray(information[:, kept][:, :, kept] - cross @ inner @ cross.transpose(0, 2, 1))


def _variance(information: Floats, place: int) -> Floats:
    """Of one column, whatever the others are; infinite where a run does not determine it. (n,)"""
    own = marginal(information, [place])[:, 0, 0]
    return np.where(own > 0.0, 1.0 / np.maximum(own, 1e-300), np.inf)


def _of_known(information: Floats, theta: Floats) -> Floats:
    """Information of the finite columns alone: none about the others, whatever these are."""
    missing = ~np.isfinite(theta)
    if not missing.any():
        return information
    information = information.copy()
    patterns, which = np.unique(missing, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        if not pattern.any():
            continue
        runs = np.flatnonzero(which.ravel() == number)
        kept = np.flatnonzero(~pattern)
        reduced = np.zeros((runs.size, *information.shape[1:]))
        if kept.size:
            reduced[np.ix_(np.arange(runs.size), kept, kept)] = marginal(information[runs], kept.tolist())
        information[runs] = reduced
    return information


def _scales(bounds: Integers, theta: Floats, information: Floats, columns: Sequence[str]) -> Floats:
    """Size of each column for each drive, by its first runs. (d, p)

    With the scatter between runs counted, or the run that says most would set it; near that of the other drives.
    """
    lengths = np.minimum(np.diff(bounds), BURN_IN)
    runs = np.concatenate([np.arange(begin, begin + n) for begin, n in zip(bounds[:-1], lengths, strict=True)])
    of_column = np.array([columns.index(s) if (s := COLUMNS[name][1]) in columns else k
                          for k, name in enumerate(columns)])  # fmt: skip
    usual = np.array([_typical_size(theta[runs, k], information[runs, k, k]) for k in of_column])
    both = np.outer(usual, usual)
    inverse = inverse_total(information[runs] * both, typical_covariance(columns))
    begins = np.concatenate([[0], np.cumsum(lengths)])[:-1]
    own = theta[runs] / usual
    weight = np.ones(runs.size)
    for _ in range(3):
        weighted = inverse * weight[:, None, None]
        moment = np.einsum("nij,nj->ni", weighted, own)
        total = np.add.reduceat(weighted, begins, axis=0) + 1e-6 * np.eye(usual.size)
        mean = np.linalg.solve(total, np.add.reduceat(moment, begins, axis=0)[:, :, None])[:, :, 0]
        away = own - np.repeat(mean, lengths, axis=0)
        distance = np.einsum("ni,nij,nj->n", away, inverse, away)
        weight = np.minimum(1.0, 2.0 * usual.size / np.maximum(distance, 1e-9))
    return np.asarray(np.clip(np.abs(mean[:, of_column]), 1.0 / LARGEST_RATIO, LARGEST_RATIO) * usual)


def _typical_size(values: Floats, known: Floats) -> float:
    """Median magnitude of a column where runs determine it; 1 where none does."""
    sizes = np.abs(values[known > 0.0])
    size = float(np.median(sizes)) if sizes.size else 0.0
    return size if size > 0.0 else 1.0


def _extras(
    whole: RunHistory, bounds: Integers, orders: Sequence[float] | None
) -> tuple[tuple[float, ...], Floats, Floats]:
    """Logarithms of amplitudes of orders (None: those that stand out), of the residual and the gap; their variances."""
    if orders is None:
        some = itertools.pairwise(bounds[: LEARNED_DRIVES + 1])
        sample = np.concatenate([whole.order_amplitude_nm[a : min(a + LEARNED_RUNS, b)] for a, b in some])
        sample = np.asarray(sample, dtype=np.float64)
        resolved = np.mean(np.isfinite(sample), axis=0) >= ORDER_SHARE if sample.size else np.zeros(0, bool)
        steady = np.zeros(resolved.size)
        for k in np.flatnonzero(resolved):
            size = sample[np.isfinite(sample[:, k]), k]
            usual = float(np.median(size))
            spread = MAD_TO_SD * float(np.median(np.abs(size - usual)))
            steady[k] = usual / spread if spread > 0.0 and usual > LEAST_STEADINESS * spread else 0.0
        chosen = np.sort(np.argsort(steady)[::-1][:MOST_ORDERS])
        orders = [float(whole.orders[k]) for k in chosen if steady[k] > 0.0]
    places = [int(np.flatnonzero(whole.orders == order)[0]) for order in orders]
    values = np.column_stack([whole.order_amplitude_nm[:, places], whole.rms_nm, whole.gap_rev])
    variance = np.full(values.shape, EXTRA_SD**2)
    variance[:, -1] = GAP_SD**2 + np.where(np.isfinite(whole.gap_log_sd), whole.gap_log_sd, 0.0) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        return tuple(orders), np.where(values > 0.0, np.log(values), np.nan), variance


def typical_covariance(columns: Sequence[str]) -> Floats:
    """Between runs, before any is seen. (p, p)"""
    sds = np.array([COLUMNS[name][2] for name in columns])
    correlation = np.eye(len(columns))
    if _VISCOUS in columns and _COULOMB in columns:
        a, b = columns.index(_VISCOUS), columns.index(_COULOMB)
        correlation[a, b] = correlation[b, a] = CORRELATION
    return np.asarray(correlation * np.outer(sds, sds))


def learn(stack: Stack) -> FleetPrior:
    """Covariance between runs and slopes with temperature, by EM over the drives' own levels; outliers weigh less."""
    drives = np.arange(len(stack.drives))
    best = np.nanmax(np.nan_to_num(stack.seen), initial=0.0)
    logged = drives[stack.logged & (stack.seen == best)]  # those that see most say what is between runs beside it
    slope = np.zeros(len(stack.columns))
    covariance = typical_covariance(stack.columns)
    slope_sd = SLOPE_SDS * np.sqrt(np.diag(covariance))
    if logged.size:
        covariance, slopes = _between_runs(stack, logged, covariance, 2)
        share = logged.size / (logged.size + PRIOR_DRIVES)
        slope = share * np.median(slopes, axis=0)
        spread = MAD_TO_SD * np.median(np.abs(slopes - np.median(slopes, axis=0)), axis=0)
        slope_sd = np.sqrt(share * spread**2 + (1.0 - share) * slope_sd**2)
    unlogged, _ = _between_runs(stack, drives, typical_covariance(stack.columns), 1)
    line = slope if logged.size else _line(stack, unlogged)
    return FleetPrior(stack.columns, covariance, unlogged, slope, slope_sd, line, _directions(stack), stack.orders)


def _line(stack: Stack, covariance: Floats) -> Floats:
    """What temperature moves, where none is logged: friction that goes with what is lasting in viscous friction. (p,)

    The errors that a run's own motion causes are independent in the next run; the temperature of a season is not. So
    the covariance of neighbours in time is that of temperature, v v^T, and v is its column for viscous friction over
    the root of that column's own element. 0 where nothing lasts.
    """
    line = np.zeros(len(stack.columns))
    if _VISCOUS not in stack.columns:
        return line
    friction = [k for k, name in enumerate(stack.columns) if name in (_VISCOUS, _COULOMB, _STRIBECK)]
    place = stack.columns.index(_VISCOUS)
    known = np.einsum("nii->n", stack.information) > 0.0
    sd = np.sqrt(np.diag(covariance))
    common, pairs = np.zeros(len(friction)), 0
    for number in range(len(stack.drives)):
        runs = stack.of(number)
        theta = stack.theta[runs][known[runs]]
        if theta.shape[0] < LEAST_TEACHING:
            continue
        away = np.clip(theta - np.median(theta, axis=0), -CLIP * sd, CLIP * sd)
        viscous, away = away[:, place], away[:, friction]
        common += 0.5 * (away[1:].T @ viscous[:-1] + away[:-1].T @ viscous[1:])
        pairs += theta.shape[0] - 1
    own = float(common[friction.index(place)])
    if own > 0.0:
        line[friction] = -common / math.sqrt(own * pairs)  # warmer is less viscous
    return line


def _directions(stack: Stack) -> Floats:
    """Each law moves its column. Coulomb friction takes stiction along: a level that rises, rises at all speeds."""
    directions = np.eye(len(stack.columns))
    if _COULOMB in stack.columns and _STRIBECK in stack.columns:
        level, rise = stack.columns.index(_COULOMB), stack.columns.index(_STRIBECK)
        ratio = stack.theta[:, rise] / np.maximum(stack.theta[:, level], 1e-3)
        directions[level, rise] = float(np.clip(np.median(ratio[stack.theta[:, level] > 0.0]), 0.0, LARGEST_RISE))
    return directions


def _between_runs(stack: Stack, drives: Integers, typical: Floats, terms: int) -> tuple[Floats, Floats]:
    """Covariance (p, p) between runs of drives, beside a level and, with two terms, a slope; the slopes (d, p)."""
    size = typical.shape[0]
    parts = [stack.of(int(d)) for d in drives]
    runs = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    own = np.repeat(np.arange(len(parts)), [part.stop - part.start for part in parts])
    steps = np.nan_to_num(stack.temperature[runs])
    design = np.column_stack([np.ones(runs.size), steps])[:, :terms]
    information, theta = stack.information[runs], stack.theta[runs]
    known = np.einsum("nii->n", information) > 0.0
    covariance = typical
    coefficients = np.zeros((len(parts), terms * size))
    begins = np.flatnonzero(np.diff(own, prepend=-1))
    ridge = np.diag(np.concatenate([np.full(size, 1e-6), np.tile(1.0 / (SLOPE_SDS**2 * np.diag(typical)), terms - 1)]))
    weight = known.astype(np.float64)
    for _ in range(LEARNING_ROUNDS):
        inverse = inverse_total(information, covariance) * weight[:, None, None]
        moment = np.einsum("nij,nj->ni", inverse, theta)
        normal = np.einsum("na,nb,nij->naibj", design, design, inverse).reshape(runs.size, terms * size, terms * size)
        right = np.einsum("na,ni->nai", design, moment).reshape(runs.size, terms * size)
        total = np.add.reduceat(normal, begins, axis=0) + ridge
        coefficients = np.linalg.solve(total, np.add.reduceat(right, begins, axis=0)[:, :, None])[:, :, 0]
        predicted = np.einsum("na,nai->ni", design, coefficients.reshape(-1, terms, size)[own])
        residual = theta - predicted
        inverse = inverse_total(information, covariance)
        distance = np.einsum("ni,nij,nj->n", residual, inverse, residual)
        weight = np.where(known, np.minimum(1.0, 2.0 * size / np.maximum(distance, 1e-9)), 0.0)
        expected = np.einsum("ij,njk,nk->ni", covariance, inverse, residual)
        spread = covariance - covariance @ inverse @ covariance
        summed = np.einsum("n,ni,nj->ij", weight, expected, expected) + spread[known].sum(axis=0)
        # a level of its own takes a run from each drive, and outliers were pulled in
        count = max(float(known.sum()) - terms * len(parts), 1.0)
        covariance = (summed + PRIOR_RUNS * typical) / (count + PRIOR_RUNS)
        covariance = 0.5 * (covariance + covariance.T)
    return covariance, coefficients.reshape(-1, terms, size)[:, -1]


def channels_of(stack: Stack, prior: FleetPrior) -> Channels:
    """The channels of all runs: laws of the columns, orders, and the residual."""
    size = len(stack.columns)
    laws = [COLUMNS[name][0] for name in stack.columns]
    unwatched = np.flatnonzero([law in WITHOUT_TEMPERATURE for law in laws])
    y = np.full((stack.time_s.size, size), np.nan)
    variance = np.ones_like(y)
    steps = np.nan_to_num(stack.temperature)
    shares = np.nan_to_num(stack.seen)
    for seen in np.unique(shares):
        every = np.flatnonzero(shares == seen)
        covariance = prior.between(seen)
        usual = _usual_weights(stack, prior, every, covariance)
        for drives in np.array_split(every, -(-every.size // DRIVES_AT_ONCE)):
            runs = np.concatenate([np.arange(stack.bounds[d], stack.bounds[d + 1]) for d in drives])
            y[runs], variance[runs], along = _projected(stack, prior, drives, runs, covariance, usual)
            if seen < 1.0:  # viscous friction stands in for what the log does not show
                steps[runs] = along
                y[np.ix_(runs, unwatched)] = np.nan
    y[~np.isfinite(stack.temperature)] = np.nan
    with np.errstate(invalid="ignore"):
        usual = np.array([np.median(v[np.isfinite(v)]) if np.isfinite(v).any() else 1.0 for v in variance.T])
        y[variance > LARGEST_NOISE * usual] = np.nan
    names = [f"ripple of order {order:g}" for order in stack.orders] + [UNMODELLED, BACKLASH]
    covariates = np.column_stack([steps, stack.log_speed - np.median(stack.log_speed)])
    return Channels(
        (*laws, *names), np.column_stack([y, stack.extras]),
        np.column_stack([np.where(np.isfinite(y), variance, 1.0), stack.extra_variance]), covariates,
    )  # fmt: skip


def _weights(information: Floats, prior: FleetPrior, covariance: Floats) -> tuple[Floats, Floats, Floats]:
    """What each law's estimate takes of each column (n, law, column), its variance (n, law), and P (n, p, p).

    The last law is that of temperature: its line.
    """
    directions = np.vstack([prior.directions, prior.line])
    inverse = inverse_total(information, covariance)
    weights, variance = np.zeros((inverse.shape[0], *directions.shape)), np.empty((inverse.shape[0], len(directions)))
    _weigh(directions, inverse, weights, variance)
    weights[:, -1] = np.nan_to_num(weights[:, -1])  # runs that say nothing of temperature are at the usual one
    return weights, variance, inverse


@njit
def _weigh(directions: Floats, inverse: Floats, weights: Floats, variance: Floats) -> None:
    """Weights of each law (n, law, column), 0 before, and variances (n, law), by directions (law, column)."""
    size = directions.shape[1]
    for n in range(inverse.shape[0]):
        for law in range(directions.shape[0]):
            diagonal = 0.0
            for k in range(size):
                if directions[law, k] != 0.0:
                    for j in range(size):
                        weights[n, law, j] += directions[law, k] * inverse[n, k, j]
            for j in range(size):
                diagonal += weights[n, law, j] * directions[law, j]
            variance[n, law] = 1.0 / diagonal if diagonal > 0.0 else math.inf
            for j in range(size):
                weights[n, law, j] = weights[n, law, j] / diagonal if diagonal > 0.0 else math.nan


def _usual_weights(stack: Stack, prior: FleetPrior, drives: Integers, covariance: Floats) -> Floats:
    """Their median over some runs of these drives. (law, column)"""
    some = drives[np.unique(np.linspace(0, drives.size - 1, LEARNED_DRIVES).astype(np.int64))]
    runs = np.concatenate(
        [np.arange(stack.bounds[d], min(stack.bounds[d + 1], stack.bounds[d] + LEARNED_RUNS)) for d in some]
    )
    weights, _, _ = _weights(stack.information[runs], prior, covariance)
    usual = medians_of_known(weights, 0)
    return np.where(np.isfinite(usual), usual, 0.0)


def _projected(
    stack: Stack, prior: FleetPrior, drives: Integers, runs: Integers, covariance: Floats, usual: Floats
) -> tuple[Floats, Floats, Floats]:
    """Estimates (n, p) of a change along each law, their variances, and steps (n,) along the line of temperature.

    The population's slope is taken out. Of some drives and their runs. The steps are counted from the drive's first
    level: were it from the latest, all laws that go with them would jump where that is taken anew.
    """
    theta, steps = stack.theta[runs], np.nan_to_num(stack.temperature[runs])
    weights, variance, inverse = _weights(stack.information[runs], prior, covariance)
    lengths = np.diff(stack.bounds)[drives]
    own = np.repeat(np.arange(drives.size), lengths)
    begins = np.concatenate([[0], np.cumsum(lengths)])[:-1]
    place = np.arange(runs.size) - begins[own]
    level, slope = _references(theta, steps, inverse, own, place, drives.size, prior)
    which = np.maximum(place // REFERENCE_EVERY - 1, 0)
    reference = level[which, own] + steps[:, None] * slope[which, own]
    constant = reference - steps[:, None] * prior.slope
    found = np.einsum("nij,nj->ni", weights, theta - reference)
    line = np.clip(found[:, -1], -LARGEST_STEPS, LARGEST_STEPS)
    line += (reference - level[0, own]) @ usual[-1]
    return found[:, :-1] + constant @ usual[:-1].T, variance[:, :-1], line


def _references(
    theta: Floats, steps: Floats, inverse: Floats, own: Integers, place: Integers, drives: int, prior: FleetPrior
) -> tuple[Floats, Floats]:
    """Level and slope (blocks, d, p) of each drive by its runs up to the end of each block of REFERENCE_EVERY."""
    size = theta.shape[1]
    blocks = max(1, (int(place.max(initial=0)) + REFERENCE_EVERY) // REFERENCE_EVERY)
    slopes = bool(np.any(steps != 0.0))
    terms = 2 if slopes else 1
    ridge = np.concatenate([np.full(size, 1e-6), *([prior.slope_sd**-2] if slopes else [])])
    pull = np.concatenate([np.zeros(size), *([prior.slope * ridge[size:]] if slopes else [])])
    found = np.zeros((blocks, drives, 2, size))
    bounds = np.searchsorted(own, np.arange(drives + 1))
    square = (terms * size, terms * size)
    _follow(
        bounds, theta, steps, inverse, ridge, pull, np.empty(square), np.empty(terms * size), np.empty(size),
        np.zeros(square), found,
    )  # fmt: skip
    return found[:, :, 0], found[:, :, 1]


@njit
def _follow(
    bounds: Integers, theta: Floats, steps: Floats, inverse: Floats, ridge: Floats, pull: Floats, normal: Floats,
    right: Floats, own: Floats, lower: Floats, found: Floats,
) -> None:  # fmt: skip
    """Level and slope (blocks, d, 2, p) of drives by all of their runs so far; those far from the last weigh less."""
    size = theta.shape[1]
    terms = ridge.size // size
    for d in range(bounds.size - 1):
        for i in range(ridge.size):
            right[i] = pull[i]
            for j in range(ridge.size):
                normal[i, j] = ridge[i] if i == j else 0.0
        for block in range(found.shape[0]):
            begin = bounds[d] + block * REFERENCE_EVERY
            for n in range(begin, min(begin + REFERENCE_EVERY, bounds[d + 1])):
                weight = 1.0
                if block:
                    distance = 0.0
                    for i in range(size):
                        own[i] = theta[n, i] - found[block - 1, d, 0, i] - steps[n] * found[block - 1, d, 1, i]
                    for i in range(size):
                        for j in range(size):
                            distance += own[i] * inverse[n, i, j] * own[j]
                    weight = min(1.0, 2.0 * size / max(distance, 1e-9))
                for i in range(size):
                    moment = 0.0
                    for j in range(size):
                        moment += weight * inverse[n, i, j] * theta[n, j]
                    for a in range(terms):
                        left = steps[n] if a else 1.0
                        right[a * size + i] += left * moment
                        for b in range(terms):
                            both = left * (steps[n] if b else 1.0) * weight
                            for j in range(size):
                                normal[a * size + i, b * size + j] += both * inverse[n, i, j]
            factor(normal, lower)
            # one solution of the triangular systems, forwards and backwards
            for i in range(ridge.size):
                value = right[i]
                for k in range(i):
                    value -= lower[i, k] * found[block, d, k // size, k % size]
                found[block, d, i // size, i % size] = value / lower[i, i]
            for i in range(ridge.size - 1, -1, -1):
                value = found[block, d, i // size, i % size]
                for k in range(i + 1, ridge.size):
                    value -= lower[k, i] * found[block, d, k // size, k % size]
                found[block, d, i // size, i % size] = value / lower[i, i]

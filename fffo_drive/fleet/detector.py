"""The sequential test behind `watch`: a bound on false alarms that holds for heavy tails and without a simulation.

Each channel of a drive (one column of its records) is predicted from the drive's own earlier runs by a Bayesian linear
regression on level, temperature and speed, whose prior is the population. The innovations t_n, over their predictive
standard deviation and brought from Student's t to a normal score, are independent under a normal model whatever its
coefficients and variance are: they are recursive residuals (Brown, Durbin and Evans, J. R. Statist. Soc. B 37, 1975).

A score is clipped at CLIP. Its scale is set by the middle of the distribution, so that E min(z^2, 2.25) = 0.778
(Huber's proposal 2). The clipped score then has a second moment of at most SECOND_MOMENT for every tail from the
uniform to Student's t with two degrees of freedom, whose variance is infinite. A score that is symmetric about 0 and
has one peak is a mixture of uniform ones (Khintchine, 1938). So the largest E exp(l z) of all that have these two
moments is the value exp(norm(l)) of a linear programme (`log_norms`). Hence exp(l z - norm(l)) is an e-value, and with
starts weighted by the time since the run before, the Shiryaev-Roberts sum of each channel, sign and l

    R_n = (R_{n-1} + t_n - t_{n-1}) exp(l z_n - norm(l)),     E R_T <= E T,

and so their mean: stopped at R >= 1/rate the mean time to a false alarm is at least 1/rate, and the chance of one
within T at most T rate, for any schedule of runs (Pollak, Ann. Statist. 13, 1985; Shin, Ramdas and Rinaldo,
E-detectors, N. Engl. J. Statist. Data Sci. 2, 2024). What it rests on: scores symmetric about 0 with one peak given the
past, as they are where the regression holds and what it leaves has no memory but the one that `memory` takes out.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
import scipy  # its modules load where they are first used

from ..arrays import Floats, Integers
from ..jit import njit
from ..units import MAD_TO_SD

CLIP = 2.0  # of a score: one outlier counts for little; 1.75 and 2.25 find less (fleet_watch, seeds 1, 55 and 56)
SECOND_MOMENT = 1.04  # of a clipped score at most: Student's t with two degrees of freedom has 1.03, a normal one 0.92
SCALE_CLIP_SQUARED = 2.25  # of a squared score, in the estimate of the scale: Huber's proposal 2 with k = 1.5
SCALE_MEAN = 0.7784652  # mean of what is left of a normal one
SLOPES = np.array([1.0, 2.5])  # l: a small shift and a large one
LONGEST_TAIL, TAILS = 15.0, 1501  # largest half width of the uniform scores in the bound, and how many are tried
MOST_ALARMS = 4  # of one drive
BURN_IN = 8  # runs that set a level: what comes after is judged against it, these are not
# a channel's memory: 3 coefficients (level, temperature, speed), their covariance over the variance, shape and sum of
# the variance, the run before
_B, _V, _SHAPE, _SUM, _LAST, _HAS = 0, 3, 12, 13, 14, 17
STATE = 18
YEAR_S = 365.25 * 86400.0


class ChannelPrior(NamedTuple):
    """What is known of each of c channels before a drive's first run."""

    mean: Floats  # (c, 3) of level and slopes
    covariance: Floats  # (c, 3, 3) of them, over `variance`
    variance: Floats  # (c,) of a run
    shape: Floats  # (c,) half the degrees of freedom of `variance`
    memory: Floats  # (c,) correlation of a run with the one before


class Detections(NamedTuple):
    """Alarms in the order of drives and runs, (a,) each; scores (n, c) and the evidence (n,) of every run."""

    drive: Integers
    run: Integers  # at which the alarm was raised, in all runs
    channel: Integers
    sign: Integers
    first: Integers  # run after which the evidence grew
    score: Floats  # (n, c) innovations as normal scores, not clipped; nan where the channel has none
    evidence: Floats  # (n,) R times the rate: 1 raises an alarm


@njit
def normal_score(t: float, dof: float) -> float:
    """Normal deviate with nearly the same tail as Student's t (Wallace, Ann. Math. Statist. 30, 1959)."""
    root = math.sqrt(dof * math.log1p(t * t / dof)) * (8.0 * dof + 1.0) / (8.0 * dof + 3.0)
    return root if t >= 0.0 else -root


@njit
def _advance(
    state: Floats, y: float, noise: float, temperature: float, speed: float, memory: float, most_weight: float
) -> float:
    """Predict one value of a channel, learn from it by a weight of at most `most_weight`, and give its score."""
    own0, own1, own2, target, variance = 1.0, temperature, speed, y, noise
    if memory > 0.0:
        if state[_HAS] > 0.0:
            own0 = 1.0 - memory
            own1 -= memory * state[_LAST + 1]
            own2 -= memory * state[_LAST + 2]
            target -= memory * state[_LAST]
        else:
            variance /= 1.0 - memory * memory
        state[_HAS] = 1.0
        state[_LAST] = y
        state[_LAST + 1] = temperature
        state[_LAST + 2] = speed
    k0 = state[_V] * own0 + state[_V + 1] * own1 + state[_V + 2] * own2
    k1 = state[_V + 3] * own0 + state[_V + 4] * own1 + state[_V + 5] * own2
    k2 = state[_V + 6] * own0 + state[_V + 7] * own1 + state[_V + 8] * own2
    unknown = own0 * k0 + own1 * k1 + own2 * k2
    error = target - (own0 * state[_B] + own1 * state[_B + 1] + own2 * state[_B + 2])
    t = error / math.sqrt(state[_SUM] / state[_SHAPE] * (unknown + variance))
    z = normal_score(t, 2.0 * state[_SHAPE])
    weight = most_weight if abs(z) <= CLIP else min(most_weight, CLIP / abs(z))
    total = unknown + variance / (weight * weight)
    gain = error / total
    state[_B] += k0 * gain
    state[_B + 1] += k1 * gain
    state[_B + 2] += k2 * gain
    state[_V] -= k0 * k0 / total
    state[_V + 1] -= k0 * k1 / total
    state[_V + 2] -= k0 * k2 / total
    state[_V + 4] -= k1 * k1 / total
    state[_V + 5] -= k1 * k2 / total
    state[_V + 8] -= k2 * k2 / total
    state[_V + 3] = state[_V + 1]
    state[_V + 6] = state[_V + 2]
    state[_V + 7] = state[_V + 5]
    scale = state[_SUM] / state[_SHAPE]
    state[_SHAPE] += 0.5
    state[_SUM] += 0.5 * scale * min(z * z, SCALE_CLIP_SQUARED) / SCALE_MEAN
    return z


@njit
def _restart(state: Floats, level_covariance: float) -> None:
    """A new level, of which nothing is known; slopes and scale stay."""
    for k in range(3):
        state[_V + k] = 0.0
        state[_V + 3 * k] = 0.0
    state[_V] = level_covariance
    state[_HAS] = 0.0


@njit
def median_of(values: Floats, count: int) -> float:
    """Of the first `count` values, which it sorts."""
    for i in range(1, count):
        value = values[i]
        j = i - 1
        while j >= 0 and values[j] > value:
            values[j + 1] = values[j]
            j -= 1
        values[j + 1] = value
    return float(0.5 * (values[(count - 1) // 2] + values[count // 2]))


@njit
def _settle(
    state: Floats, y: Floats, noise: Floats, covariates: Floats, c: int, begin: int, end: int, memory: float,
    scratch: Floats,
) -> None:  # fmt: skip
    """Learn the runs of a level that begins, all at once: the first may be an outlier, and would set it by itself."""
    count = 0
    for n in range(begin, end):
        if y[n, c] == y[n, c]:
            scratch[count] = y[n, c] - state[_B + 1] * covariates[n, 0] - state[_B + 2] * covariates[n, 1]
            count += 1
    if count == 0:
        return
    centre = median_of(scratch, count)
    state[_B] = centre
    for k in range(count):
        scratch[k] = abs(scratch[k] - centre)
    spread = MAD_TO_SD * median_of(scratch, count)
    shape = state[_SHAPE]
    scale = math.sqrt((state[_SUM] + 0.5 * count * spread * spread) / (shape + 0.5 * count))
    for n in range(begin, end):
        if y[n, c] == y[n, c]:
            away = y[n, c] - state[_B + 1] * covariates[n, 0] - state[_B + 2] * covariates[n, 1] - centre
            distance = abs(away) / (scale * math.sqrt(noise[n, c]))
            weight = 1.0 if distance <= CLIP else CLIP / distance
            _advance(state, y[n, c], noise[n, c], covariates[n, 0], covariates[n, 1], memory, weight)


@njit
def _detect(
    bounds: Integers, step_y: Floats, y: Floats, noise: Floats, covariates: Floats, start: Floats, memory: Floats,
    norm: Floats, rate: float, state: Floats, kept: Floats, sums: Floats, climbs: Floats, begins: Integers,
    scratch: Floats,
    score: Floats, evidence: Floats, found: Integers,
) -> int:  # fmt: skip
    alarms = 0
    channels = y.shape[1]
    for drive in range(bounds.size - 1):
        own_alarms = 0
        active = 0
        level_begin = bounds[drive]
        for c in range(channels):
            for k in range(STATE):
                state[c, k] = start[c, k]
            for j in range(2 * SLOPES.size):
                sums[c, j] = 0.0
                climbs[c, j] = 0.0
                begins[c, j] = bounds[drive]
            for n in range(bounds[drive], bounds[drive + 1]):
                if y[n, c] == y[n, c]:
                    active += 1
                    break
        for n in range(bounds[drive], bounds[drive + 1]):
            total = 0.0
            best, best_channel, best_slope = 0.0, -1, -1
            for c in range(channels):
                for k in range(STATE):
                    kept[n - bounds[drive], c, k] = state[c, k]
                z = math.nan
                if y[n, c] == y[n, c]:
                    z = _advance(state[c], y[n, c], noise[n, c], covariates[n, 0], covariates[n, 1], memory[c], 1.0)
                if n < level_begin + BURN_IN:
                    z = math.nan
                score[n, c] = z
                clipped = min(max(z, -CLIP), CLIP)
                if n == level_begin + BURN_IN - 1:
                    for k in range(STATE):
                        state[c, k] = kept[level_begin - bounds[drive], c, k]
                    _settle(state[c], y, noise, covariates, c, level_begin, n + 1, memory[c], scratch)
                for j in range(2 * SLOPES.size):
                    sums[c, j] += step_y[n]
                    if z == z:
                        slope = SLOPES[j // 2] * (1.0 if j % 2 == 0 else -1.0)
                        grown = slope * clipped - norm[j // 2]
                        sums[c, j] *= math.exp(grown)
                        climbs[c, j] += grown
                    if climbs[c, j] <= 0.0:
                        climbs[c, j] = 0.0
                        begins[c, j] = n + 1
                    total += sums[c, j]
                    if sums[c, j] > best:
                        best, best_channel, best_slope = sums[c, j], c, j
            evidence[n] = total * rate / max(1, 2 * SLOPES.size * active)
            if n < level_begin + BURN_IN:
                for c in range(channels):
                    for j in range(2 * SLOPES.size):
                        sums[c, j] = 0.0
                        climbs[c, j] = 0.0
                        begins[c, j] = n + 1
                evidence[n] = 0.0
            if evidence[n] < 1.0 or own_alarms == MOST_ALARMS:
                continue
            first = min(begins[best_channel, best_slope], n)
            found[alarms, 0] = drive
            found[alarms, 1] = n
            found[alarms, 2] = best_channel
            found[alarms, 3] = 1 if best_slope % 2 == 0 else -1
            found[alarms, 4] = first
            alarms += 1
            own_alarms += 1
            # the channels as they were before the change, and the runs since then at a level of their own
            level_begin = first
            for c in range(channels):
                for k in range(STATE):
                    state[c, k] = kept[first - bounds[drive], c, k]
                _restart(state[c], start[c, _V])
                for k in range(STATE):
                    kept[first - bounds[drive], c, k] = state[c, k]
                _settle(state[c], y, noise, covariates, c, first, n + 1, memory[c], scratch)
                for j in range(2 * SLOPES.size):
                    sums[c, j] = 0.0
                    climbs[c, j] = 0.0
                    begins[c, j] = n + 1
    return alarms


@functools.cache
def log_norms() -> Floats:
    """Logarithm of the largest E exp(l z) for each of SLOPES. (l,)"""
    # half widths of the uniform scores that a score is a mixture of; the last one is all tail
    reach = np.append(np.linspace(1e-4, LONGEST_TAIL, TAILS), 1e9)
    inside = np.minimum(CLIP / reach, 1.0)  # share that is not clipped
    moments = [_mean_square(reach, clip) for clip in (SCALE_CLIP_SQUARED**0.5, CLIP)]
    found = []
    for slope in SLOPES:
        most = slope * np.minimum(reach, CLIP)
        growth = inside * np.sinh(most) / most + (1.0 - inside) * np.cosh(slope * CLIP)
        worst = scipy.optimize.linprog(
            -growth, A_ub=moments[1][None], b_ub=[SECOND_MOMENT],
            A_eq=np.stack([np.ones_like(reach), moments[0]]), b_eq=[1.0, SCALE_MEAN],
        )  # fmt: skip
        found.append(math.log(float(growth @ worst.x)))
    return np.array(found)


def _mean_square(reach: Floats, clip: float) -> Floats:
    """Of scores that are uniform within +-reach (k,), clipped. (k,)"""
    inside = np.minimum(clip / reach, 1.0)
    return np.asarray(inside * np.minimum(reach, clip) ** 2 / 3.0 + (1.0 - inside) * clip**2)


def detect(
    bounds: Integers, time_s: Floats, y: Floats, noise: Floats, covariates: Floats, prior: ChannelPrior,
    alarms_per_drive_year: float,
) -> Detections:  # fmt: skip
    """Watch the runs of many drives. `bounds` (d + 1,): drive k has the runs bounds[k]:bounds[k + 1], oldest first.

    `time_s` (n,), `y` (n, c) with nan where a run has no value, `noise` (n, c) variance over that of `prior`,
    `covariates` (n, 2) temperature and speed.
    """
    channels, runs = y.shape[1], y.shape[0]
    if alarms_per_drive_year <= 0.0:
        raise ValueError(f"alarms per drive and year: {alarms_per_drive_year:g}; it has to be above 0")
    elapsed = np.diff(time_s, prepend=time_s[:1])
    inside = np.ones(runs, dtype=bool)
    inside[bounds[:-1][bounds[:-1] < runs]] = False
    elapsed = np.where(inside, np.maximum(elapsed, 0.0), 0.0) / YEAR_S
    start = np.zeros((channels, STATE))
    start[:, _B:_V] = prior.mean
    start[:, _V:_SHAPE] = prior.covariance.reshape(channels, 9)
    start[:, _SHAPE] = prior.shape
    start[:, _SUM] = prior.shape * prior.variance
    longest = int(np.diff(bounds).max(initial=1))
    places = (channels, 2 * SLOPES.size)
    score, evidence = np.full((runs, channels), np.nan), np.zeros(runs)
    found = np.zeros((min(runs, MOST_ALARMS * (bounds.size - 1)) + 1, 5), dtype=np.int64)
    count = _detect(
        bounds, elapsed, y, noise, covariates, start, prior.memory, log_norms(), alarms_per_drive_year,
        np.empty((channels, STATE)), np.empty((longest, channels, STATE)), np.empty(places), np.empty(places),
        np.empty(places, dtype=np.int64), np.empty(longest), score, evidence, found,
    )  # fmt: skip
    drive, run, channel, sign, first = np.ascontiguousarray(found[:count].T)
    return Detections(drive, run, channel, sign, first, score, evidence)

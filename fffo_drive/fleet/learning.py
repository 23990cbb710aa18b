"""What a fleet is like: the slopes, scatter and memory of each channel, from runs in which nothing changes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..jit import njit
from ..units import MAD_TO_SD
from .channels import (
    COLUMNS,
    LEARNED_DRIVES,
    LEARNED_RUNS,
    LEAST_TEACHING,
    PRIOR_DRIVES,
    SLOPE_SDS,
    Channels,
    FleetPrior,
    Stack,
    channels_of,
    learn,
)  # fmt: skip
from .detector import BURN_IN, CLIP, SCALE_CLIP_SQUARED, SCALE_MEAN, ChannelPrior, detect, median_of

EXTRA_SLOPE_SD = 0.2  # of logarithms of amplitudes, per unit of a covariate
CHANNEL_SLOPE_SD = 0.02  # of a channel per e-fold of speed, over its scale
LEVEL_RUNS = 100.0  # variances of a run that a level may be away at first
LEARNING_RATE = 0.2  # alarms per drive and year, beyond which a drive's later runs teach nothing
LEAST_SHAPE, LARGEST_SHAPE = 2.0, 15.0
LARGEST_MEMORY = 0.8
SCALE_WASTE = 1.5  # variance of that scale, squared, over that of a mean square
MEAN_FITTED = 1.0  # a fitted level makes neighbours look this much over the number of runs less alike


def channel_prior(stack: Stack, channels: Channels) -> ChannelPrior:
    """Slopes, variance, its spread over drives, and memory of each channel, as this fleet has them."""
    count = len(channels.laws)
    size = len(stack.columns)
    typical = np.array([*(COLUMNS[name][2] for name in stack.columns)])
    slope_sd = np.vstack([
        np.column_stack([SLOPE_SDS * typical, CHANNEL_SLOPE_SD + 0.5 * typical]),
        np.full((count - size, 2), EXTRA_SLOPE_SD),
    ])  # fmt: skip
    mean, covariance = np.zeros((count, 3)), np.zeros((count, 3, 3))
    variance, shape, memory = np.ones(count), np.full(count, LEAST_SHAPE), np.zeros(count)
    for c in range(count):
        fits = _drive_fits(stack, channels, c, slope_sd[c])
        number = fits.dof.size
        share = number / (number + PRIOR_DRIVES)
        usual = np.nanmedian(channels.variance[:, c])
        between = slope_sd[c] ** 2
        if number:
            centre = np.median(fits.slopes, axis=0)
            own = np.median(fits.slope_variance, axis=0)
            spread = (MAD_TO_SD * np.median(np.abs(fits.slopes - centre), axis=0)) ** 2
            mean[c, 1:] = share * centre
            between = share * np.maximum(spread - own, 0.1 * spread) + (1.0 - share) * slope_sd[c] ** 2 + 1e-12
            lag = float(fits.lag.sum()) / max(float(fits.energy.sum()), 1e-300)
            runs = float(np.mean(fits.dof))
            memory[c] = min(max(share * (lag + MEAN_FITTED / runs), 0.0), LARGEST_MEMORY)
            logs = np.log(fits.variance)
            dof = float(np.median(fits.dof))
            variance[c] = np.exp(share * np.median(logs))
            beyond = (MAD_TO_SD * np.median(np.abs(logs - np.median(logs)))) ** 2 - SCALE_WASTE * 2.0 / dof
            wide = 1.0 / max(float(beyond), 1e-3)  # the variance of the logarithm is about 1 / shape
            shape[c] = np.clip(share * wide, LEAST_SHAPE, LARGEST_SHAPE)
        covariance[c] = np.diag([LEVEL_RUNS * usual, *(between / variance[c])])
    return ChannelPrior(mean, covariance, variance, shape, memory)


class _DriveFits(NamedTuple):
    """Of the d drives that have enough runs."""

    slopes: Floats  # (d, 2)
    slope_variance: Floats  # (d, 2)
    variance: Floats  # (d,) of what is left of a run, over what its record says
    dof: Floats  # (d,)
    lag: Floats  # (d,) sum of products of neighbours, outliers pulled in
    energy: Floats  # (d,) ... of squares


def _drive_fits(stack: Stack, channels: Channels, c: int, slope_sd: Floats) -> _DriveFits:
    """Level and slopes of one channel of each drive, by reweighted least squares."""
    found = np.full((len(stack.drives), 8), np.nan)
    y, variance = np.ascontiguousarray(channels.y[:, c]), np.ascontiguousarray(channels.variance[:, c])
    longest = int(np.diff(stack.bounds).max(initial=1))
    _fit_drives(
        stack.bounds, y, variance, channels.covariates, slope_sd, np.empty((longest, 6)), np.empty(longest),
        np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3), found,
    )  # fmt: skip
    own = found[np.isfinite(found[:, 0])]
    return _DriveFits(own[:, :2], own[:, 2:4], *own[:, 4:].T)


@njit
def _scale(rows: Floats, count: int, scratch: Floats) -> float:
    """Standard deviation of what is left beside a level and two slopes, by the middle of it (Huber's proposal 2)."""
    for k in range(count):
        scratch[k] = abs(rows[k, 4])
    scale = MAD_TO_SD * median_of(scratch, count)
    few = count / (count - 3.0)
    for _ in range(8):
        if scale <= 0.0:
            break
        total = 0.0
        for k in range(count):
            total += min((rows[k, 4] / scale) ** 2, SCALE_CLIP_SQUARED)
        scale *= math.sqrt(few * (total / count) / SCALE_MEAN)
    return scale


@njit
def _invert(m: Floats, inverse: Floats) -> None:
    """Of a symmetric matrix (3, 3), by cofactors."""
    for i in range(3):
        for j in range(3):
            a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            inverse[i, j] = m[a, c] * m[b, d] - m[a, d] * m[b, c]
    determinant = m[0, 0] * inverse[0, 0] + m[0, 1] * inverse[0, 1] + m[0, 2] * inverse[0, 2]
    for i in range(3):
        for j in range(3):
            inverse[i, j] /= determinant


@njit
def _fit_drives(
    bounds: Integers, y: Floats, variance: Floats, covariates: Floats, slope_sd: Floats, rows: Floats,
    scratch: Floats, normal: Floats, inverse: Floats, right: Floats, solution: Floats, found: Floats,
) -> None:  # fmt: skip
    for d in range(bounds.size - 1):
        count = 0  # rows: three columns and the target, whitened; the residual; its weight
        for n in range(bounds[d], bounds[d + 1]):
            if not math.isfinite(y[n]):
                continue
            white = 1.0 / math.sqrt(variance[n])
            rows[count, 0] = white
            rows[count, 1] = covariates[n, 0] * white
            rows[count, 2] = covariates[n, 1] * white
            rows[count, 3] = y[n] * white
            rows[count, 5] = 1.0
            count += 1
        if count < BURN_IN + 3:
            continue
        scale = 1.0
        for _ in range(4):
            for i in range(3):
                right[i] = 0.0
                for j in range(3):
                    normal[i, j] = 0.0
            for k in range(count):
                for i in range(3):
                    taken = rows[k, i] * rows[k, 5] / scale**2
                    right[i] += taken * rows[k, 3]
                    for j in range(3):
                        normal[i, j] += taken * rows[k, j]
            normal[1, 1] += 1.0 / slope_sd[0] ** 2
            normal[2, 2] += 1.0 / slope_sd[1] ** 2
            _invert(normal, inverse)
            for i in range(3):
                solution[i] = inverse[i, 0] * right[0] + inverse[i, 1] * right[1] + inverse[i, 2] * right[2]
            for k in range(count):
                fitted = rows[k, 0] * solution[0] + rows[k, 1] * solution[1] + rows[k, 2] * solution[2]
                rows[k, 4] = rows[k, 3] - fitted
            scale = max(_scale(rows, count, scratch), 1e-9)
            for k in range(count):
                rows[k, 5] = min(1.0, CLIP * scale / max(abs(rows[k, 4]), 1e-300))
        lag, energy, before = 0.0, 0.0, 0.0
        for k in range(count):
            clipped = min(max(rows[k, 4], -CLIP * scale), CLIP * scale)
            lag += clipped * before
            energy += clipped * clipped
            before = clipped
        found[d, 0] = solution[1]
        found[d, 1] = solution[2]
        found[d, 2] = inverse[1, 1]
        found[d, 3] = inverse[2, 2]
        found[d, 4] = scale**2
        found[d, 5] = count - 3.0
        found[d, 6] = lag
        found[d, 7] = energy


def evenly(drives: int) -> Integers:
    """Places of at most LEARNED_DRIVES, spread over all."""
    return np.unique(np.linspace(0, drives - 1, LEARNED_DRIVES).astype(np.int64))


def learned(stack: Stack) -> tuple[FleetPrior, ChannelPrior]:
    """What the fleet is like, from runs in which nothing changes: twice, for what changes has to be seen first."""
    drives = evenly(len(stack.drives))
    ends = np.minimum(stack.bounds[drives + 1], stack.bounds[drives] + LEARNED_RUNS)
    part = stack.part(drives, ends)
    prior = learn(part)
    channels = channels_of(part, prior)
    own = channel_prior(part, channels)
    found = detect(part.bounds, part.time_s, *channels[1:], own, LEARNING_RATE)
    kept = np.diff(part.bounds)
    for drive, first in zip(found.drive[::-1], found.first[::-1], strict=True):
        kept[drive] = first - part.bounds[drive]
    enough = np.flatnonzero(kept >= LEAST_TEACHING)
    if not found.drive.size or not enough.size:
        return prior, own
    quiet = part.part(enough, part.bounds[enough] + kept[enough])
    prior = learn(quiet)
    return prior, channel_prior(quiet, channels_of(quiet, prior))

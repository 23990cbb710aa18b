"""Samples on a uniform grid: uneven timestamps are interpolated, short gaps bridged and marked, long gaps left open.

Every filter and simulation assumes a constant period. A sample within `ON_GRID` of a grid point is taken as that of the
grid point, so a uniform log passes unchanged.

- Position: a monotone cubic (PCHIP), which does not overshoot between whole counts. Other sensors: linear.
- Command: each value is held from its stamp to the next; a grid point gets the mean over the period that it begins.
- Gaps up to `LONGEST_BRIDGE_S` are bridged; what was filled in is not `good`. Longer ones stay gaps.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy  # its modules load where they are first used: together they take a second

from ..arrays import Floats, Mask

COMMAND = "current_command_a"
POSITIONS = ("position_rev", "reference_position_rev")
GAP_PERIODS = 1.5  # a step in time beyond this many median periods is a gap
LONGEST_BRIDGE_S = 0.02  # longer gaps are not bridged: after a 40 Hz filter no real data would be left
ON_GRID = 0.05  # periods: a stamp this close to a grid point is taken as that grid point
ANTI_ALIAS = 0.4  # cut-off over the new rate when a log is decimated
ANTI_ALIAS_ORDER = 8  # of the Butterworth filter, forwards and backwards: 100 dB at the new rate


class Even(NamedTuple):
    """Samples at one period; (n,) each."""

    columns: dict[str, Floats]
    period_s: float
    breaks: tuple[int, ...]  # samples that come after a gap
    good: Mask | None  # False where filled in; None: nothing was
    jitter_s: float  # rms distance of the stamps from the grid, where it is more than ON_GRID; else 0
    largest_jitter_s: float


def typical_period_s(time_s: Floats) -> float:
    """Period of rising stamps (n,): the median step where the stamps lie on its multiples, else the mean of the steps.

    The median alone is wrong by the resolution of the stamps; the mean is pulled by missing samples, so steps beyond
    `GAP_PERIODS` medians, and what is caught up after them, are left out of it.
    """
    steps = np.diff(time_s)
    median_s = float(np.median(steps))
    stamps = (time_s - time_s[0]) / median_s
    if float(np.median(np.abs(_off_grid(stamps, _phase(stamps))))) <= ON_GRID:
        return median_s
    usual = steps[(steps > median_s / GAP_PERIODS) & (steps < GAP_PERIODS * median_s)]
    return float(usual.mean()) if usual.size else median_s


def on_even_grid(time_s: Floats, columns: Mapping[str, Floats], known: Mask | None = None) -> Even:
    """Columns (n,) at rising stamps (n,) on a uniform grid. `known`: False where a sample was filled in already."""
    period_s = typical_period_s(time_s)
    longest_s = max(LONGEST_BRIDGE_S, GAP_PERIODS * period_s) * (1.0 + 1e-9)
    edges = [0, *(np.flatnonzero(np.diff(time_s) > longest_s) + 1).tolist(), time_s.size]
    parts: list[dict[str, Floats]] = []
    goods: list[Mask] = []
    breaks: list[int] = []
    far: list[Floats] = []
    for begin, end in itertools.pairwise(edges):
        stamps = (time_s[begin:end] - time_s[begin]) / period_s
        values = {name: column[begin:end] for name, column in columns.items()}
        phase = _phase(stamps)
        part, good = _even_part(stamps, phase, values, None if known is None else known[begin:end])
        if parts:
            breaks.append((breaks[-1] if breaks else 0) + goods[-1].size)
        parts.append(part)
        goods.append(good)
        far.append(_off_grid(stamps, phase))
    distance = np.concatenate(far)
    uneven = bool((np.abs(distance) > ON_GRID).any())
    good = np.concatenate(goods)
    return Even(
        {name: np.ascontiguousarray(np.concatenate([part[name] for part in parts])) for name in columns},
        period_s,
        tuple(breaks),
        None if good.all() else good,
        float(np.sqrt(np.mean(distance * distance))) * period_s if uneven else 0.0,
        float(np.abs(distance).max()) * period_s if uneven else 0.0,
    )


def _off_grid(stamps: Floats, phase: float) -> Floats:
    """Distance of stamps (n,) in periods from the uniform grid at this phase."""
    return np.asarray(stamps - phase - np.round(stamps - phase))


def _phase(stamps: Floats) -> float:
    """Where between two whole numbers the stamps are, -0.5 to 0.5: their circular mean."""
    return float(np.angle(np.mean(np.exp(2j * np.pi * stamps))) / (2.0 * np.pi))


def _even_part(
    stamps: Floats, phase: float, columns: Mapping[str, Floats], known: Mask | None
) -> tuple[dict[str, Floats], Mask]:
    """One stretch without a long gap; `stamps` in periods from its first one, around a grid at this phase."""
    sure = np.ones(stamps.size, dtype=np.bool_) if known is None else known
    first = phase if phase >= -ON_GRID else phase + 1.0
    count = int(np.floor(float(stamps[-1]) + ON_GRID - first)) + 1
    grid = first + np.arange(max(count, 1), dtype=np.float64)
    if count == stamps.size and bool((np.abs(stamps - grid) <= ON_GRID).all()):
        return dict(columns), sure
    before = np.clip(np.searchsorted(stamps, grid, side="right") - 1, 0, stamps.size - 1)
    behind = np.minimum(before + 1, stamps.size - 1)
    near = np.where(np.abs(stamps[behind] - grid) < np.abs(stamps[before] - grid), behind, before)
    own = np.abs(stamps[near] - grid) <= ON_GRID
    found: dict[str, Floats] = {}
    for name, values in columns.items():
        if name == COMMAND:
            between = held_mean(stamps, values, grid, 1.0)
        elif name in POSITIONS and stamps.size > 1:
            between = scipy.interpolate.PchipInterpolator(stamps, values)(np.clip(grid, 0.0, stamps[-1]))
        else:
            between = np.interp(grid, stamps, values)
        found[name] = np.where(own, values[near], between)
    filled = ~own & (stamps[behind] - stamps[before] > GAP_PERIODS)
    return found, np.asarray(np.where(own, sure[near], sure[before] & sure[behind] & ~filled))


def held_mean(stamps: Floats, values: Floats, begins: Floats, width: float) -> Floats:
    """Mean over [begin, begin + width] of a value (n,) that is held from each stamp to the next. (begins,)"""
    reach = np.append(stamps, max(float(begins[-1]) + width, float(stamps[-1])) + width)
    charge = np.concatenate([[0.0], np.cumsum(values * np.diff(reach))])
    return np.asarray((np.interp(begins + width, reach, charge) - np.interp(begins, reach, charge)) / width)


def at_lower_rate(columns: Mapping[str, Floats], good: Mask | None, ratio: float) -> tuple[dict[str, Floats], Mask]:
    """One stretch (n,) at a period that is `ratio` (> 1) times as long; sensors without phase, the command's mean.

    A sample is good where all within half a new period are.
    """
    size = next(iter(columns.values())).size
    old = np.arange(size, dtype=np.float64)
    new = np.arange(0.0, size - ratio + 1e-9, ratio)
    sections = scipy.signal.butter(ANTI_ALIAS_ORDER // 2, min(0.9, 2.0 * ANTI_ALIAS / ratio), output="sos")
    found: dict[str, Floats] = {}
    for name, values in columns.items():
        if name == COMMAND:
            found[name] = held_mean(old, values, new, ratio)
            continue
        padding = min(size - 1, round(6.0 * ratio))
        smooth = scipy.signal.sosfiltfilt(sections, values - values[0], padlen=padding) + values[0]
        found[name] = scipy.interpolate.CubicSpline(old, smooth)(new)
    sure = np.ones(size) if good is None else good.astype(np.float64)
    half = round(0.5 * ratio)
    reach = (np.arange(-half, half + 1)[:, None] + np.round(new).astype(np.int64)).clip(0, size - 1)
    return found, np.asarray(sure[reach].min(axis=0) > 0.0)

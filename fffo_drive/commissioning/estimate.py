"""Estimators on pulses: scale and age of the velocity against the position, gain and delay from current to motion.

All are linear least squares with a search over one delay; each sliding segment has its own offset, so that friction at
rest has no influence:

    velocity against position     V(t) = q p(t - a) + b
    motion under current          v(t) = g I(t - Td) - c t - d V(t) + b

with V the integral of the velocity word and I that of the held command.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import scipy  # its modules load where they are first used

from ..arrays import Floats, Integers
from ..least_squares import LinearFit, least_squares
from .motion import PulseMotion, extreme, integral, pulse_windows

LARGEST_AGE_S = 0.02
DELAY_STEP_S = 5e-4  # grid of the search, before the bounded refinement
SLIDING_SHARE = 0.3  # of a pulse's peak speed: above, friction changes little
FAST_SHARE = 0.5
SHORTEST_STRETCH = 8  # rows
# of the variance of the velocity that one rigid inertia leaves: beyond the first, gain and delay are rough (backlash,
# elasticity, strong cogging); beyond the second they are wrong: an axis that is held, or whose load swings. On the axes
# 3300 to 3399 of tools/benchmarks/chain.py the delay was off by 0.3 ms in the median and 2.8 ms at most on the 16
# between the two, and by 3.3 ms on the one beyond; `tune` takes the longer of it and the fitted delay
RIGID_UNEXPLAINED = 0.1
LARGEST_UNEXPLAINED = 0.5


class HeldCurrent(NamedTuple):
    """0x6078 under a current that the axis stands under."""

    ratio: float  # mean of what the drive reports, over what was sent
    resolution: float  # one per mille, over what was sent: the resolution, and so the tolerance


class ScaleFit(NamedTuple):
    """Velocity against position."""

    ratio: float  # q: 1 when the integral of the velocity is the position
    age_s: float  # how much older the velocity word is than the position


class GainFit(NamedTuple):
    """Motion under current."""

    gain_rps2_per_a: float  # Kt/J in the units of the velocity word
    delay_s: float  # from the tick that computes a command to the velocity that shows it, without the hold
    unexplained: float  # residual of the fit, as a share of the velocity's variance

    @property
    def rigid(self) -> bool:
        """Whether one rigid inertia explains the motion well enough for gain and delay to be trusted."""
        return self.gain_rps2_per_a > 0.0 and self.unexplained <= LARGEST_UNEXPLAINED


def _search(cost: Callable[[float], float], low: float, high: float, step: float) -> float:
    """Minimum of a cost with perhaps several: a grid, then golden section round its best point."""
    grid = np.arange(low, high + 0.5 * step, step)
    best = float(grid[np.argmin([cost(float(x)) for x in grid])])
    result = scipy.optimize.minimize_scalar(
        cost, bounds=(max(low, best - step), min(high, best + step)), method="bounded"
    )
    return float(result.x)


def _centred(values: Floats, group: Integers) -> Floats:
    """Values less the mean of their group: what least squares with an offset for each group does. Shape (n,)."""
    means = np.bincount(group, values) / np.bincount(group)
    return np.asarray(values - means[group])


def _held_integral(time_s: Floats, values: Floats) -> Floats:
    """Integral of values that are held until the next row. Shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(time_s))])


def travel_ratio(motions: Sequence[PulseMotion]) -> float:
    """First rough estimate: the integral of the velocity over the position, by least squares. NaN at rest."""
    above = below = 0.0
    for motion in motions:
        for window in pulse_windows(motion):
            position = motion.position_rev[window] - motion.position_rev[window.start]
            by_velocity = integral(motion.time_s[window], motion.velocity_rps[window])
            above += float(position @ by_velocity)
            below += float(position @ position)
    return above / below if below > 0.0 else float("nan")


def fit_scale(motion: PulseMotion) -> ScaleFit:
    """Ratio and age of the velocity word against the position, over all pulses."""
    windows = pulse_windows(motion)
    rows, group = _rows_of(windows)
    time_s = motion.time_s[rows]
    target = _centred(integral(motion.time_s, motion.velocity_rps)[rows], group)

    def ratio_and_rest(age_s: float) -> tuple[float, float]:
        late = _centred(np.interp(time_s - age_s, motion.time_s, motion.position_rev), group)
        power = float(late @ late)
        ratio = float(late @ target) / power if power > 0.0 else float("nan")
        rest = target - ratio * late
        return ratio, float(rest @ rest)

    age_s = _search(lambda a: ratio_and_rest(a)[1], -0.5 * LARGEST_AGE_S, LARGEST_AGE_S, DELAY_STEP_S)
    return ScaleFit(ratio_and_rest(age_s)[0], age_s)


def _rows_of(windows: Sequence[slice]) -> tuple[Integers, Integers]:
    """Rows in slices, and the number of the slice of each."""
    rows = np.concatenate([np.arange(window.start, window.stop) for window in windows])
    group = np.concatenate([np.full(window.stop - window.start, k) for k, window in enumerate(windows)])
    return rows, group


def sliding_stretches(motion: PulseMotion, share: float) -> list[slice]:
    """Segments in which a pulse moves the axis one way at more than a share of its peak speed."""
    found = []
    for window in pulse_windows(motion):
        velocity = motion.velocity_rps[window]
        peak = extreme(velocity)
        runs = _fast_runs(velocity * np.sign(peak), share * abs(peak))
        if runs.size:
            begin, end = runs[np.argmax(runs[:, 1] - runs[:, 0])]
            found.append(slice(window.start + int(begin), window.start + int(end)))
    return found


def _fast_runs(speed_rps: Floats, above_rps: float) -> Integers:
    """Begin and end of each run of rows above a speed that is long enough. Shape (n, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], speed_rps > above_rps, [False]]).astype(np.int8)))
    runs = edges.reshape(-1, 2)
    return runs[runs[:, 1] - runs[:, 0] >= SHORTEST_STRETCH]


def _shortest_onset_s(motion: PulseMotion) -> float:
    """Shortest time from the start of a pulse until the axis slides, either way: the delay cannot be longer.

    In a wider search, friction that falls with speed can be mistaken for a long delay and a negative gain. A load on a
    spring swings back after the pulse, perhaps longer than the pulse drove it: only the first slide counts.
    """
    onsets_s = []
    for window in pulse_windows(motion):
        speed_rps = np.abs(motion.velocity_rps[window])
        runs = _fast_runs(speed_rps, SLIDING_SHARE * float(speed_rps.max()))
        if runs.size:
            onsets_s.append(motion.time_s[window.start + runs[0, 0]] - motion.time_s[window.start])
    return float(np.min(onsets_s))


def fit_gain(motion: PulseMotion) -> GainFit | None:
    """Gain and delay from the sliding segments of all pulses; None if the axis does not slide in them.

    Gain and delay can be trusted only where the fit is `rigid`.
    """
    stretches = sliding_stretches(motion, SLIDING_SHARE)
    if len(stretches) < 2:
        return None
    rows, group = _rows_of(stretches)
    time_s, velocity = motion.time_s[rows], motion.velocity_rps[rows]
    command = _held_integral(motion.time_s, motion.command_a)
    first = np.array([stretch.start for stretch in stretches])[group]
    slowed = _centred(-np.sign(motion.velocity_rps[first]) * time_s, group)
    damped = _centred(-integral(motion.time_s, motion.velocity_rps)[rows], group)
    target = _centred(velocity, group)

    def solve(delay_s: float) -> LinearFit:
        pushed = _centred(np.interp(time_s - delay_s, motion.time_s, command), group)
        return least_squares(np.column_stack([pushed, slowed, damped]), target)

    delay_s = _search(lambda d: solve(d).cost, 0.0, _shortest_onset_s(motion), DELAY_STEP_S)
    found = solve(delay_s)
    return GainFit(float(found.values[0]), delay_s, found.cost / float(target @ target))


def update_interval_s(motion: PulseMotion, period_s: float) -> float:
    """Update interval of the velocity word while the axis moves fast: median distance of its changes, or NaN."""
    intervals: list[float] = []
    for stretch in sliding_stretches(motion, FAST_SHARE):
        changes = np.flatnonzero(np.diff(motion.velocity_rps[stretch]) != 0.0)
        if changes.size >= 2:
            intervals += list(np.diff(motion.time_s[stretch][changes + 1]))
    return max(period_s, float(np.median(intervals))) if intervals else float("nan")


def current_slope(motion: PulseMotion) -> tuple[float, int]:
    """Reported over commanded current where the command has stood for a while, and how many samples there were.

    A report every n-th SYNC of a command that acts late: only rows whose command has been the same for 10 ms count.
    """
    settled = np.zeros(motion.size, bool)
    last_change = 0.0
    for k in range(1, motion.size):
        if motion.command_a[k] != motion.command_a[k - 1]:
            last_change = motion.time_s[k]
        settled[k] = motion.time_s[k] - last_change > 0.01
    use = settled & motion.current_fresh & (motion.command_a != 0.0)
    command = motion.command_a[use]
    power = float(command @ command)
    return (float(command @ motion.current_a[use]) / power if power else float("nan")), int(use.sum())


def fall_rate_rps2(motion: PulseMotion, high_rps: float, low_rps: float) -> float:
    """Mean deceleration between two speeds, after the highest of the run. NaN when it does not fall through them."""
    speed = np.abs(motion.velocity_rps)
    if not speed.size:
        return float("nan")
    top = int(np.argmax(speed))
    below_high = np.flatnonzero(speed[top:] < high_rps)
    below_low = np.flatnonzero(speed[top:] < low_rps)
    if speed[top] < high_rps or not below_high.size or not below_low.size:
        return float("nan")
    time_s = motion.time_s[top:]
    fall_s = float(time_s[below_low[0]] - time_s[below_high[0]])
    return (high_rps - low_rps) / fall_s if fall_s > 0.0 else float("nan")


def coasting_s(motion: PulseMotion, share: float = 0.03) -> float:
    """Time after the last current for which the axis still moves faster than a share of its highest speed."""
    driven = np.flatnonzero(motion.command_a)
    speed = np.abs(motion.velocity_rps)
    moving = np.flatnonzero(speed > share * speed.max()) if motion.size else driven
    if not driven.size or not moving.size:
        return 0.0
    return max(0.0, float(motion.time_s[moving[-1]] - motion.time_s[driven[-1]]))

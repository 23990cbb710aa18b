"""What the four runs of a drive ask for: current for `identify`, velocity for `track`, `recipe` and `check`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

Floats = np.ndarray[Any, np.dtype[np.float64]]

RATE_HZ = 2000
PERIOD_S = 1.0 / RATE_HZ
OPEN_LOOP = 0
CLOSED_LOOP = 1
HELD_OUT = "check"

STAIRCASE_RPS = (0.3, 0.7, 1.5, 3.0, 6.0, 10.0, 14.0)
DWELLS_S = (0.1, 0.3, 1.0, 2.0, 4.0, 7.0)
TRIANGLES_RPS = (0.5, 1.5)
PAIR_RAMPS_S = (0.25, 0.12, 0.06)


class Profile(NamedTuple):
    """One run: what it asks for, and when it begins on the clock since power-on."""

    name: str
    mode: int  # OPEN_LOOP: values are A; CLOSED_LOOP: values are rps
    begin_s: float
    values: Floats  # (n,)


def profiles(seed: int, high_a: float) -> tuple[Profile, ...]:
    """The four runs of a drive. `high_a` bounds the current of the chirp; the phases of the sines are drawn."""
    draw = np.random.default_rng((seed, 77))
    return (
        Profile("identify", OPEN_LOOP, 0.0, _chirps(0.27 * high_a, high_a)),
        Profile("track", CLOSED_LOOP, 75.0, _multisine(draw, 60.0, draw.uniform(11.0, 15.0))),
        Profile("recipe", CLOSED_LOOP, 150.0, _recipe()),
        Profile(HELD_OUT, CLOSED_LOOP, 280.0, _check(draw)),
    )


def _envelope(n: int, low: float, high: float) -> Floats:
    return np.asarray(low + (high - low) / (1.0 + np.exp(-12.0 * (np.arange(n) / n - 0.5))))


def _chirps(low_a: float, high_a: float) -> Floats:
    """10 Hz down to 0.01 Hz in 30 s and back up in as long, in a sigmoid envelope."""
    rate = math.log(10.0 / 0.01) / 30.0
    time_s = np.arange(30 * RATE_HZ) * PERIOD_S
    up = np.sin(2.0 * math.pi * 0.01 * np.expm1(rate * time_s) / rate)
    both = np.concatenate([up[::-1], up])
    return _envelope(both.size, low_a, high_a) * both


def _multisine(draw: np.random.Generator, duration_s: float, high_rps: float) -> Floats:
    """Lines from 0.03 to 10 Hz, amplitude falling with the frequency, in a sigmoid envelope that ends at the peak."""
    n = round(duration_s * RATE_HZ)
    time_s = np.arange(n) * PERIOD_S
    wave = np.zeros(n)
    for frequency_hz in np.geomspace(0.03, 10.0, 30):
        wave += np.sin(2.0 * math.pi * (frequency_hz * time_s + draw.uniform())) / frequency_hz**0.8
    wave *= _envelope(n, 0.01, 1.0)
    ends = np.minimum(1.0, np.minimum(np.arange(n), n - 1 - np.arange(n)) / (0.2 * RATE_HZ))
    return np.asarray(high_rps * wave * ends / np.abs(wave).max())


def _lines(corners: list[tuple[float, float]]) -> Floats:
    """Straight lines from 0 through levels: pairs of duration (s) and level at its end."""
    times = np.cumsum([0.0] + [duration_s for duration_s, _ in corners])
    levels = [0.0] + [level for _, level in corners]
    return np.interp(np.arange(round(times[-1] * RATE_HZ)) * PERIOD_S, times, levels)


def _staircase(levels_rps: tuple[float, ...], ramp_s: float, stay_s: tuple[float, float]) -> list[tuple[float, float]]:
    """Constant speeds upwards, one way and then the other; the first of `stay_s` for speeds below 1 rps."""
    corners: list[tuple[float, float]] = []
    for sign in (1.0, -1.0):
        for level in levels_rps:
            corners += [(ramp_s, sign * level), (stay_s[0] if level < 1.0 else stay_s[1], sign * level)]
    return [*corners, (0.4, 0.0)]


def _dwells(durations_s: tuple[float, ...], ramp_s: float, level_rps: float) -> list[tuple[float, float]]:
    """Standstills, each left by one and the same ramp, in both directions."""
    corners: list[tuple[float, float]] = []
    for duration_s in durations_s:
        for sign in (1.0, -1.0):
            corners += [(duration_s, 0.0), (ramp_s, sign * level_rps), (0.3, 0.0)]
    return corners


def _pairs(level_rps: float, ramps_s: tuple[float, ...], stay_s: float) -> list[tuple[float, float]]:
    """Accelerate and brake alike, at several torques, both ways."""
    corners: list[tuple[float, float]] = []
    for ramp_s in ramps_s:
        for sign in (1.0, -1.0):
            corners += [(ramp_s, sign * level_rps), (stay_s, sign * level_rps), (ramp_s, 0.0), (stay_s, 0.0)]
    return corners


def _recipe() -> Floats:
    triangles: list[tuple[float, float]] = []
    for level in TRIANGLES_RPS:
        triangles += [(1.0, level), (2.0, -level), (1.0, 0.0)] * 3
    staircase = _staircase(STAIRCASE_RPS, 0.3, (3.5, 2.2))
    return _lines([*staircase, *_dwells(DWELLS_S, 0.5, 0.8), *triangles, *_pairs(10.0, PAIR_RAMPS_S, 0.3)])


def _check(draw: np.random.Generator) -> Floats:
    rest = [*_dwells((0.5, 3.0, 1.5), 0.6, 1.0), *_pairs(8.0, (0.2, 0.08, 0.05), 0.25)]
    rest += _staircase((0.5, 2.0, 8.0, 13.0), 0.2, (1.2, 1.2))
    return np.concatenate([_multisine(draw, 35.0, draw.uniform(6.0, 12.0)), _lines(rest)])

"""Excitation: profiles from which the parameters of an axis can be identified.

Three of them: the paper's current sequence (section IV-B, Fig. 3), its chirp for the frequency response (IV-C), and a
velocity recipe that separates effects which one motion alone confuses. All are `Profile`s, sampled before anything
moves; `predict_motion` simulates an open-loop current on the axis model, so that speed and travel can be bounded as
well as current.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from ..control.reference import MODE_CURRENT, MODE_VELOCITY, Profile, piecewise_linear, sigmoid_envelope
from ..model.axis import AxisConfig, AxisState, simulate
from ..model.effects.registry import law_of
from ..model.friction import REST

STAIRCASE_SHARES = (0.01, 0.03, 0.07, 0.15, 0.3, 0.5, 0.75, 1.0)  # of the highest speed: eight levels both ways
DWELLS_S = (0.1, 0.25, 0.6, 1.5, 3.0, 6.0)  # six dwell times, each ended at the same torque rate
CHIRP, CHIRP_S, CHIRP_HZ = "chirp", 60.0, (1.0, 100.0)  # of current, instead of parts
CREEP_SHARES, CREEP_REV = (0.05, 0.1), 5.0  # of the highest speed; travel at each of them
BIASED_SINE_S, BIASED_SINES_HZ = 4.0, (1.0, 5.0)  # of each, either way
COAST_TIME_S = 0.35  # a coast-down as a reference: the speed falls with about the axis' own time constant
COAST_S, COAST_REST_S = 5.0 * COAST_TIME_S, 0.2


def chirp(first_hz: float, last_hz: float, duration_s: float, period_s: float) -> Floats:
    """Sine of falling or rising frequency, exponential in time, amplitude 1. Shape (n,)."""
    time_s = np.arange(round(duration_s / period_s)) * period_s
    rate = math.log(last_hz / first_hz) / duration_s
    phase = 2.0 * math.pi * first_hz * np.expm1(rate * time_s) / rate
    return np.asarray(np.sin(phase))


def identification_sequence(
    duration_s: float, period_s: float, low_a: float, high_a: float, lowest_hz: float, highest_hz: float
) -> Profile:
    """The paper's current sequence: a down-chirp, then an up-chirp, in one biased sigmoid envelope from low to high."""
    down = chirp(highest_hz, lowest_hz, 0.5 * duration_s, period_s)
    up = chirp(lowest_hz, highest_hz, 0.5 * duration_s, period_s)
    wave = np.concatenate([down, up])
    envelope, _ = sigmoid_envelope(wave.size, low_a, high_a)
    return _sampled("identify", MODE_CURRENT, period_s, envelope * wave)


def frequency_response_chirp(
    duration_s: float, period_s: float, amplitude_a: float, lowest_hz: float, highest_hz: float
) -> Profile:
    """The down-chirp for the frequency response (50 to 0.01 Hz in the paper), at one amplitude of current."""
    return _sampled("frf", MODE_CURRENT, period_s, amplitude_a * chirp(highest_hz, lowest_hz, duration_s, period_s))


def separating_recipe(period_s: float, high_rps: float, acceleration_rps2: float, repeats: int = 2) -> Profile:
    """Velocity reference that separates effects: see the parts below. The first two parts are repeated at the end.

    About 100 s with 2 repeats. `acceleration_rps2` is the highest; the accelerate/brake pairs use 1/4, 1/2 and 1 of it.
    """
    return motion_of("recipe", recipe_parts(repeats), period_s, high_rps, acceleration_rps2)


def recipe_parts(repeats: int) -> tuple[str, ...]:
    """Names of the recipe's parts in their order."""
    again = ("staircase", "triangles") * (max(1, repeats) - 1)
    return (*again, "dwells", "pairs", "biased_sines", "coast_downs", "staircase", "triangles")


def motion_of(name: str, parts: Sequence[str], period_s: float, high_rps: float, acceleration_rps2: float) -> Profile:
    """Velocity reference from parts of the recipe, one after another from rest to rest. Raises KeyError."""
    found = [PARTS[part].values(period_s, high_rps, acceleration_rps2) for part in parts]
    return _sampled(name, MODE_VELOCITY, period_s, np.concatenate(found))


def motion_s(parts: Sequence[str], high_rps: float, acceleration_rps2: float) -> float:
    """Duration of `motion_of` these parts, to one period each, without computing samples. Raises KeyError."""
    return sum(PARTS[part].duration_s(high_rps, acceleration_rps2) for part in parts)


def _sampled(name: str, mode: int, period_s: float, values: Floats) -> Profile:
    return Profile(name, mode, period_s, values, np.gradient(values, period_s))


Legs = tuple[list[float], list[float]]  # durations and the levels reached after them


def _lines(period_s: float, durations_s: list[float], levels: list[float]) -> Floats:
    """Linear segments from 0 through `levels`, each reached after its duration."""
    times = np.concatenate([[0.0], np.cumsum(durations_s)])
    return piecewise_linear("", MODE_VELOCITY, period_s, times, np.array([0.0, *levels])).values


def _staircase(high_rps: float, acceleration_rps2: float) -> Legs:
    """Constant speeds, rising in one direction and then the other: the steady friction curve on both sides."""
    durations: list[float] = []
    levels: list[float] = []
    for sign in (1.0, -1.0):
        last = 0.0
        for share in (*STAIRCASE_SHARES, 0.0):
            level = sign * share * high_rps
            durations += [max(0.05, 4.0 * abs(level - last) / acceleration_rps2), 0.2 if level == 0.0 else 1.2]
            levels += [level, level]
            last = level
    return durations, levels


def _dwells(high_rps: float, acceleration_rps2: float) -> Legs:
    """Dwells of six lengths, each ended by the same slow ramp: break-away over dwell time at a fixed torque rate."""
    durations: list[float] = []
    levels: list[float] = []
    for number, dwell_s in enumerate(DWELLS_S):
        level = 0.15 * high_rps * (1.0 if number % 2 else -1.0)
        ramp_s = max(0.3, 8.0 * abs(level) / acceleration_rps2)
        durations += [dwell_s, ramp_s, 0.2, ramp_s]
        levels += [0.0, level, level, 0.0]
    return durations, levels


def _triangles(high_rps: float, acceleration_rps2: float) -> Legs:
    """Slow reversals at two accelerations: separates presliding (same in travel) from a lag (not the same)."""
    durations: list[float] = []
    levels: list[float] = []
    for share, quarter_s in ((0.02, 0.5), (0.02, 0.15), (0.07, 0.5), (0.07, 0.15)):
        for level in (1.0, 0.0, -1.0, 0.0) * 2:
            durations.append(quarter_s)
            levels.append(level * share * high_rps)
    return durations, levels


def _pairs(high_rps: float, acceleration_rps2: float) -> Legs:
    """Equal acceleration and braking at three torques, both ways: separates inertia and torque from friction by
    sign.
    """
    durations: list[float] = []
    levels: list[float] = []
    for share in (0.25, 0.5, 1.0):
        for sign in (1.0, -1.0):
            ramp_s = 0.9 * high_rps / (share * acceleration_rps2)
            durations += [ramp_s, 0.25, ramp_s, 0.15]
            levels += [0.9 * sign * high_rps, 0.9 * sign * high_rps, 0.0, 0.0]
    return durations, levels


def _biased_sines(period_s: float, high_rps: float, acceleration_rps2: float) -> Floats:
    """Oscillation that never reverses, at two rates: frictional lag without presliding; both directions."""
    time_s = np.arange(round(BIASED_SINE_S / period_s)) * period_s
    parts = []
    for sign in (1.0, -1.0):
        for frequency_hz in BIASED_SINES_HZ:
            wave = 0.07 * (1.0 - 0.8 * np.cos(2.0 * math.pi * frequency_hz * time_s))
            parts.append(sign * high_rps * wave * np.minimum(1.0, np.minimum(time_s, time_s[::-1]) / 0.3))
    return np.concatenate(parts)


def _coast_downs(period_s: float, high_rps: float, acceleration_rps2: float) -> Floats:
    """Coast-down: hardly any torque at all speeds, so no effect of the torque appears in it."""
    rise = _lines(period_s, *_coast_rise(high_rps, acceleration_rps2))
    time_s = np.arange(round(COAST_S / period_s)) * period_s
    fall = high_rps * (np.exp(-time_s / COAST_TIME_S) - math.exp(-5.0) * time_s / time_s[-1])
    once = np.concatenate([rise, fall, np.zeros(round(COAST_REST_S / period_s))])
    return np.concatenate([once, -once])


def _coast_rise(high_rps: float, acceleration_rps2: float) -> Legs:
    return [2.0 * high_rps / acceleration_rps2, 0.3], [high_rps, high_rps]


def _creep(high_rps: float, acceleration_rps2: float) -> Legs:
    """Slow constant speed over five turns both ways, at two speeds: effects over the angle, and their sign."""
    durations: list[float] = []
    levels: list[float] = []
    for share in CREEP_SHARES:
        for sign in (1.0, -1.0):
            level = sign * share * high_rps
            ramp_s = max(0.05, 4.0 * abs(level) / acceleration_rps2)
            durations += [ramp_s, CREEP_REV / abs(level), ramp_s, 0.3]
            levels += [level, level, 0.0, 0.0]
    return durations, levels


class Part(NamedTuple):
    """A piece of a motion, from rest to rest: `values` by period, highest speed and acceleration, and its length."""

    values: Callable[[float, float, float], Floats]
    duration_s: Callable[[float, float], float]


def _of(legs: Callable[[float, float], Legs]) -> Part:
    return Part(lambda period_s, *shape: _lines(period_s, *legs(*shape)), lambda *shape: sum(legs(*shape)[0]))


PARTS: dict[str, Part] = {
    "staircase": _of(_staircase),
    "triangles": _of(_triangles),
    "dwells": _of(_dwells),
    "pairs": _of(_pairs),
    "biased_sines": Part(_biased_sines, lambda *_: 2.0 * len(BIASED_SINES_HZ) * BIASED_SINE_S),
    "coast_downs": Part(_coast_downs, lambda *shape: 2.0 * (sum(_coast_rise(*shape)[0]) + COAST_S + COAST_REST_S)),
    "creep": _of(_creep),
}


def deciding_motion(
    effect: str, period_s: float, high_rps: float, acceleration_rps2: float, amplitude_a: float
) -> Profile:
    """The motion that separates an effect of the library from similar effects, as far as a motion can.

    A velocity reference of at most `high_rps`; for effects that appear in the frequency response, a chirp of current at
    `amplitude_a`. Raises KeyError for an unknown effect.
    """
    motions = law_of(effect).motions
    if motions == (CHIRP,):
        return frequency_response_chirp(CHIRP_S, period_s, amplitude_a, *CHIRP_HZ)
    return motion_of(f"decide-{effect.replace(':', '-')}", motions, period_s, high_rps, acceleration_rps2)


def deciding_motion_s(effect: str, high_rps: float, acceleration_rps2: float) -> float:
    """Duration of `deciding_motion`. Raises KeyError for an unknown effect."""
    motions = law_of(effect).motions
    return CHIRP_S if motions == (CHIRP,) else motion_s(motions, high_rps, acceleration_rps2)


class MotionForecast(NamedTuple):
    """Predicted motion under an open-loop current."""

    speed_rps: float  # highest
    lowest_rev: float  # extremes of travel from the start
    highest_rev: float


def predict_motion(profile: Profile, axis: AxisConfig) -> MotionForecast:
    """Simulate a current profile on the axis model from rest: highest speed and travel."""
    if profile.mode != MODE_CURRENT:
        travel = np.cumsum(profile.values) * profile.period_s
        return MotionForecast(float(np.abs(profile.values).max()), float(travel.min()), float(travel.max()))
    states, _ = simulate(axis, AxisState(0.0, 0.0, REST), profile.values, profile.period_s, 2)
    return MotionForecast(float(np.abs(states[:, 0]).max()), float(states[:, 1].min()), float(states[:, 1].max()))

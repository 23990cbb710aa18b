"""Profiles: the motion of a run, sampled at the loop's rate before anything moves.

A profile is velocity (rps, loop closed) or current (A, open loop) with its time derivative. The paper's reference is a
multi-sine under a biased sigmoid envelope: low and high speeds in one record, changing direction all the time (Fig. 7).
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from ..arrays import Floats

MODE_IDLE = 0
MODE_VELOCITY = 1
MODE_CURRENT = 2

SIGMOID_STEEPNESS = 12.0  # over the whole record: the envelope's ends are within 0.3 % of their levels


class Profile(NamedTuple):
    """A sampled reference. `values` (n,) rps or A; `derivatives` (n,) per second."""

    name: str
    mode: int  # MODE_VELOCITY or MODE_CURRENT
    period_s: float
    values: Floats
    derivatives: Floats

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return float(self.values.size * self.period_s)


def sigmoid_envelope(n: int, low: float, high: float) -> tuple[Floats, Floats]:
    """Biased sigmoid from `low` to `high` over n samples, and its derivative per sample. Shapes (n,)."""
    position = SIGMOID_STEEPNESS * (np.arange(n) / n - 0.5)
    sigmoid = 1.0 / (1.0 + np.exp(-position))
    slope = (high - low) * sigmoid * (1.0 - sigmoid) * SIGMOID_STEEPNESS / n
    return low + (high - low) * sigmoid, slope


def multisine(
    duration_s: float, period_s: float, frequencies_hz: Floats, amplitudes: Floats, phases: Floats
) -> tuple[Floats, Floats]:
    """Sum of sines scaled to a peak of 1 over the record, and its derivative per second. Shapes (n,)."""
    n = round(duration_s / period_s)
    time_s = np.arange(n) * period_s
    values = np.zeros(n)
    derivatives = np.zeros(n)
    for frequency_hz, amplitude, phase in zip(frequencies_hz, amplitudes, phases, strict=True):
        omega = 2.0 * math.pi * frequency_hz
        angle = omega * time_s + phase
        values += amplitude * np.sin(angle)
        derivatives += amplitude * omega * np.cos(angle)
    peak = float(np.abs(values).max())
    return values / peak, derivatives / peak


def paper_reference(
    duration_s: float, period_s: float, low_rps: float, high_rps: float, lowest_hz: float, highest_hz: float,
    lines: int, slope: float, seed: int,
) -> Profile:  # fmt: skip
    """The comparison's reference: log-spaced lines with amplitude f^slope and random phases, sigmoid envelope.

    One minute takes 0.3 s to compute, and each plan of an axis asks for the same one: the last few are kept. Each
    caller gets arrays of its own.
    """
    made = _paper_reference(duration_s, period_s, low_rps, high_rps, lowest_hz, highest_hz, lines, slope, seed)
    return made._replace(values=made.values.copy(), derivatives=made.derivatives.copy())


@functools.lru_cache(maxsize=4)  # two megabytes a minute of a profile
def _paper_reference(
    duration_s: float, period_s: float, low_rps: float, high_rps: float, lowest_hz: float, highest_hz: float,
    lines: int, slope: float, seed: int,
) -> Profile:  # fmt: skip
    frequencies_hz = np.geomspace(lowest_hz, highest_hz, lines)
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * math.pi, lines)
    wave, wave_slope = multisine(duration_s, period_s, frequencies_hz, frequencies_hz**slope, phases)
    envelope, envelope_slope = sigmoid_envelope(wave.size, low_rps, high_rps)
    values = envelope * wave
    derivatives = envelope * wave_slope + wave * envelope_slope / period_s
    return Profile("paper", MODE_VELOCITY, period_s, values, derivatives)


def sine(name: str, mode: int, duration_s: float, period_s: float, amplitude: float, frequency_hz: float) -> Profile:
    """One sine, starting at zero."""
    time_s = np.arange(round(duration_s / period_s)) * period_s
    omega = 2.0 * math.pi * frequency_hz
    return Profile(name, mode, period_s, amplitude * np.sin(omega * time_s), amplitude * omega * np.cos(omega * time_s))


def piecewise_linear(name: str, mode: int, period_s: float, times_s: Floats, levels: Floats) -> Profile:
    """Linear interpolation between (time, level) points: staircases, ramps, triangles, dwells."""
    n = round(float(times_s[-1]) / period_s)
    time_s = np.arange(n) * period_s
    values = np.interp(time_s, times_s, levels)
    slopes = np.diff(levels) / np.maximum(np.diff(times_s), period_s)
    segment = np.clip(np.searchsorted(times_s, time_s, side="right") - 1, 0, slopes.size - 1)
    return Profile(name, mode, period_s, values, slopes[segment])


class ProfileBounds(NamedTuple):
    """Largest magnitudes of a profile, for the check against the envelope before anything moves."""

    value: float
    derivative: float
    travel: float  # integral's excursion: rev for a velocity profile


def profile_bounds(profile: Profile) -> ProfileBounds:
    """Peaks of a profile; `travel` is the larger excursion from the start of its integral."""
    travel = np.cumsum(profile.values) * profile.period_s
    return ProfileBounds(
        float(np.abs(profile.values).max()),
        float(np.abs(profile.derivatives).max()),
        float(np.abs(travel).max()),
    )

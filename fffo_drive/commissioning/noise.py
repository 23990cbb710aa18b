"""Noise of position and velocity while the axis moves, as power spectral densities.

At rest a position shows its noise only where that is larger than its counts. Under the sweep of commissioning the axis
makes the same motion twice, second by second: what differs is noise, and, at low frequencies, friction.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Floats
from .record import NoiseRecord
from .sweep import Sweeps

SEGMENT_S = 0.25
LEAST_HZ = 40.0  # below, the motion itself differs: kicks, friction and the slow loop
BANDS = 12
DIGITS = 4


def noise_record(sweeps: Sweeps) -> NoiseRecord:
    """Spectra of what differs between the two pairs of every run."""
    position, velocity = (_density(values, sweeps.period_s) for values in sweeps.repeated())
    frequency_hz = np.linspace(0.0, 0.5 / sweeps.period_s, position.size)
    edges_hz = np.geomspace(LEAST_HZ, frequency_hz[-1] * 1.001, BANDS + 1)
    number = np.digitize(frequency_hz, edges_hz)
    bands = [np.flatnonzero(number == k) for k in range(1, BANDS + 1)]

    def means(values: Floats) -> list[float]:
        return [float(f"{values[band].mean():.{DIGITS}g}") for band in bands if band.size]

    return NoiseRecord(
        frequency_hz=means(frequency_hz), position_rev2_per_hz=means(position), velocity_rps2_per_hz=means(velocity)
    )


def _density(pairs: Floats, period_s: float) -> Floats:
    """One-sided density of the noise in each of (runs, pairs, samples), by Welch's method."""
    from scipy.signal import welch  # loads slowly

    difference = np.diff(pairs, axis=1) / np.sqrt(2.0)
    found = welch(difference, 1.0 / period_s, nperseg=round(SEGMENT_S / period_s), detrend="constant")[1]
    return np.asarray(found.mean(axis=(0, 1)))

"""Frequency response as in Fig. 5: gain and coherence from a chirp, and a first-order plant fitted to the gain alone.

The phase is not used: the frictional lag bends it. Damping depends on the amplitude (17): it is estimated over time as
the power that friction takes over the mean square of the velocity, and sorted by amplitude.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy  # its modules load where they are first used

from ..arrays import Floats
from .dataset import DataError, Record
from .kinematics import acting_torque_nm, motion_of

SEGMENTS_S = (
    32.0,
    8.0,
    2.0,
    0.5,
)  # long segments for low frequencies, short ones for high: each covers about two octaves
CYCLES = 6.0  # cycles in a segment from which on it is used
LINES = 40
LEAST_COHERENCE = 0.6
POSITION_HZ = 150.0  # the position is differentiated below this


class FrequencyResponse(NamedTuple):
    """Velocity over current: (k,) each."""

    frequency_hz: Floats
    gain_rps_per_a: Floats
    phase_deg: Floats
    coherence: Floats


class FirstOrder(NamedTuple):
    """Gh / (Th p + 1): gain in rps per A, time constant in s."""

    gain_rps_per_a: float
    time_constant_s: float


class DampingPoint(NamedTuple):
    """Equivalent damping at one amplitude of velocity."""

    amplitude_rps: float
    damping_nm_per_rps: float
    windows: int


def frequency_response(record: Record) -> FrequencyResponse:
    """Welch estimates with a segment length for each frequency range. Raises DataError for a record that is too
    short.
    """
    period_s = record.period_s
    part = max(record.segments(), key=lambda s: s.stop - s.start)
    velocity = motion_of(record, part, min(POSITION_HZ, 0.2 / period_s)).velocity_rps
    current = record.current_a[part]
    rows: list[tuple[float, complex, float]] = []
    highest_hz = min(100.0, 0.1 / period_s)
    for segment_s in SEGMENTS_S:
        length = round(segment_s / period_s)
        if length > current.size:
            continue
        low_hz = CYCLES / segment_s if segment_s < SEGMENTS_S[0] else 1.0 / segment_s
        high_hz = min(highest_hz, 4.0 * CYCLES / segment_s) if segment_s > SEGMENTS_S[-1] else highest_hz
        frequency, cross = _cross_density(current, velocity, period_s, length)
        power = np.abs(_cross_density(current, current, period_s, length)[1])
        answer = np.abs(_cross_density(velocity, velocity, period_s, length)[1])
        inside = (frequency >= low_hz) & (frequency < high_hz)
        coherence = np.abs(cross) ** 2 / np.maximum(power * answer, 1e-300)
        rows += list(
            zip(frequency[inside], (cross / np.maximum(power, 1e-300))[inside], coherence[inside], strict=True)
        )
    if len(rows) < 5:
        raise DataError(f"{record.path}: {record.duration_s:.3g} s are too short for a frequency response")
    return _thinned(sorted(rows, key=lambda row: row[0]))


def _cross_density(
    first: Floats, second: Floats, period_s: float, length: int
) -> tuple[Floats, npt.NDArray[np.complex128]]:
    frequency, density = scipy.signal.csd(first, second, fs=1.0 / period_s, nperseg=length, noverlap=length * 3 // 4)
    return np.asarray(frequency), np.asarray(density, dtype=np.complex128)


def _thinned(rows: list[tuple[float, complex, float]]) -> FrequencyResponse:
    """About LINES points, evenly spaced in log frequency; each is a local average."""
    frequency = np.array([row[0] for row in rows])
    response = np.array([row[1] for row in rows])
    coherence = np.array([row[2] for row in rows])
    edges = np.geomspace(frequency[0] * 0.999, frequency[-1] * 1.001, LINES + 1)
    number = np.digitize(frequency, edges)
    found = [np.flatnonzero(number == k) for k in np.unique(number)]
    return FrequencyResponse(
        np.array([float(np.exp(np.log(frequency[i]).mean())) for i in found]),
        np.array([float(np.abs(response[i]).mean()) for i in found]),
        np.array([float(np.degrees(np.angle(response[i].mean()))) for i in found]),
        np.array([float(coherence[i].mean()) for i in found]),
    )


def fit_first_order(response: FrequencyResponse) -> FirstOrder:
    """Gain and time constant of a first-order plant on the logarithm of the gain, weighted by coherence."""
    good = response.coherence > LEAST_COHERENCE
    if good.sum() < 4:
        raise DataError(
            f"coherence is above {LEAST_COHERENCE:g} at only {int(good.sum())} frequencies: raise the chirp's current"
        )
    omega = 2.0 * math.pi * response.frequency_hz[good]
    level = np.log(response.gain_rps_per_a[good])
    weight = np.sqrt(response.coherence[good])

    def errors(x: Floats) -> Floats:
        return np.asarray(weight * (x[0] - 0.5 * np.log1p((omega * math.exp(x[1])) ** 2) - level))

    found = min(
        (
            scipy.optimize.least_squares(errors, [level.max(), math.log(t)], loss="soft_l1", f_scale=0.2)
            for t in (0.02, 0.1, 0.5)
        ),
        key=lambda result: float(result.cost),
    )
    return FirstOrder(math.exp(found.x[0]), math.exp(found.x[1]))


def damping_over_amplitude(
    records: Sequence[Record], inertia_nm_s2_per_rev: float, delay_s: float, window_s: float = 0.5, bins: int = 10
) -> list[DampingPoint]:
    """Damping D(|w|) (17): mean of friction torque times velocity over mean square velocity, sorted by amplitude."""
    amplitudes, dampings = [], []
    for record in records:
        for part in record.segments():
            motion = motion_of(record, part)
            torque = acting_torque_nm(record, part, delay_s) - inertia_nm_s2_per_rev * motion.acceleration_rps2
            length = round(window_s / record.period_s)
            count = torque.size // length
            v = motion.velocity_rps[: count * length].reshape(count, length)
            power = (torque[: count * length].reshape(count, length) * v).mean(axis=1)
            square = (v * v).mean(axis=1)
            moving = square > (3.0 * motion.speed_floor_rps) ** 2
            amplitudes.append(np.sqrt(2.0 * square[moving]))
            dampings.append(power[moving] / square[moving])
    amplitude, damping = np.concatenate(amplitudes), np.concatenate(dampings)
    if amplitude.size < 2 * bins:
        return []
    edges = np.geomspace(amplitude.min() * 0.999, amplitude.max() * 1.001, bins + 1)
    number = np.digitize(amplitude, edges)
    return [
        DampingPoint(
            float(np.median(amplitude[number == k])), float(np.median(damping[number == k])), int((number == k).sum())
        )
        for k in np.unique(number)
    ]

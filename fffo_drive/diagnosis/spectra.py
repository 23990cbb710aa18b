"""Orders of the motor angle and frequencies at which the residual stands out: periodograms over angle and over time.

Runs have reversals, so a wave in angle is no line over time. Residuals are binned by angle, separately for each class
of speed since the filter's gain for a wave falls with the speed; the spectra of the classes are added, weighted by that
gain. Phases of different runs are not compared, as the datum may differ.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
import scipy  # its modules load where they are first used

from ..arrays import Floats
from ..identification.ranking import ranked
from .rows import DiagnosisRows

BINS_A_PERIOD = 2.56  # of the shortest period
HIGHEST_ORDER = 50.0  # of the periodogram of a turn; above it whole orders are tried one by one
LEAST_PERIODS = 8.0  # fewest periods of a wave in the travel
SPEED_CLASSES = 8
LEVEL_BLOCKS = 16  # blocks in which the level of a spectrum is taken
NEIGHBOURS = 40  # bins to each side that belong to the same line
OUTSTANDING = 9.0  # height of a line over the level
LONGEST_BINS = 1 << 18
LINE_WIDTH = 1.5  # over the time of the longest stretch: half the width of a line, Hz
OWN_LINE = 5.0  # torque of a line of the motion over that of a load: 2 beside a true disturbance, 15 beside a false one
SLOWEST_LINE = 1.5  # below this order lines need not stand out ...
BAND_RATIO = 1.5  # ... the largest of each band of this ratio is taken


class Peak(NamedTuple):
    """A line of a periodogram."""

    place: float  # order or frequency
    strength: float  # power over the level nearby


def order_peaks(rows: DiagnosisRows, values: Floats, count: int, highest: float = HIGHEST_ORDER) -> list[Peak]:
    """Strongest orders of the motor angle in values (m,) at the kept rows, strongest first."""
    turns = rows.turns
    if turns * highest < LEAST_PERIODS:
        return []
    orders, power = order_spectrum(rows, values, turns, highest)
    return _peaks(orders, power, count, least=1.0 / turns)


def slow_orders(rows: DiagnosisRows, values: Floats) -> tuple[float, ...]:
    """The largest order of each band below SLOWEST_LINE.

    No line stands out there, because all other missing effects have their spectrum there too: an order is judged by
    what it explains.
    """
    turns = rows.turns
    if turns < 2.0:
        return ()
    return tuple(_slow_peaks(*order_spectrum(rows, values, turns, HIGHEST_ORDER), 1.5 / turns))


def order_spectrum(rows: DiagnosisRows, values: Floats, turns: float, highest: float) -> tuple[Floats, Floats]:
    """Orders up to the highest, and the power of each, averaged over the runs."""
    bins_per_turn = BINS_A_PERIOD * highest
    length = min(LONGEST_BINS, 1 << (math.ceil(2.0 * turns * bins_per_turn) - 1).bit_length())
    orders = np.asarray(np.fft.rfftfreq(length, 1.0 / bins_per_turn), dtype=np.float64)
    use = orders <= highest
    power = np.zeros(int(use.sum()))
    weight = np.full(power.size, 1e-300)
    for run in np.unique(rows.run):
        inside = rows.kept & (rows.run == run)
        if inside.sum() < 100:
            continue
        angle = rows.position_rev[inside] - rows.position_rev[inside].min()
        if np.ptp(angle) * highest < LEAST_PERIODS:
            continue
        speed = np.abs(rows.velocity_rps[inside])
        total = np.zeros(power.size, complex)
        norm = np.zeros(power.size)
        edges = np.quantile(speed, np.linspace(0.0, 1.0, SPEED_CLASSES + 1))
        for low, high in itertools.pairwise(edges):
            part = (speed >= low) & (speed <= high)
            index = np.minimum((angle[part] * bins_per_turn).astype(np.int64), length - 1)
            sums = np.bincount(index, (values[inside][part] - values[inside].mean()), length)
            gain = rows.filter.gain(orders[use] * 0.5 * (low + high))
            total += gain * np.fft.rfft(sums)[use]
            norm += gain * gain * part.sum()
        power += np.abs(total) ** 2 / np.maximum(norm, 1.0)
        weight += 1.0
    return orders[use], power / weight


def _slow_peaks(orders: Floats, power: Floats, least: float) -> list[float]:
    """The maximum of each band between `least` and SLOWEST_LINE, unless it is the flank of a neighbour's."""
    if not least < SLOWEST_LINE:
        return []
    count = max(1, round(np.log(SLOWEST_LINE / least) / np.log(BAND_RATIO)))
    found = []
    for low, high in itertools.pairwise(np.geomspace(least, SLOWEST_LINE, count + 1)):
        inside = np.flatnonzero((orders >= low) & (orders < high))
        if inside.size < 3:
            continue
        k = inside[np.argmax(power[inside])]
        if power[k - 1] <= power[k] >= power[k + 1]:
            found.append(float(orders[k]))
    return found


def frequency_peaks(rows: DiagnosisRows, values: Floats, count: int) -> list[Peak]:
    """Strongest frequencies of values (m,) over time."""
    frequency, power = time_spectrum(rows, values)
    use = frequency < rows.filter.cutoff_hz
    longest_s = max(end - begin for begin, end in rows.bounds) * rows.filter.row_period_s
    return _peaks(frequency[use], power[use], count, least=4.0 / longest_s)


def time_spectrum(rows: DiagnosisRows, values: Floats) -> tuple[Floats, Floats]:
    """Frequencies, Hz, and the power of values (m,) at each, summed over the stretches."""
    longest = max(end - begin for begin, end in rows.bounds)
    length = 1 << (4 * longest - 1).bit_length()
    power = np.zeros(length // 2 + 1)
    for begin, end in rows.bounds:
        part = np.where(rows.kept[begin:end], values[begin:end], 0.0)
        power += np.abs(np.fft.rfft(part - part.mean() * rows.kept[begin:end], length)) ** 2
    return np.asarray(np.fft.rfftfreq(length, rows.filter.row_period_s), dtype=np.float64), power


def own_line(
    rows: DiagnosisRows, motion_nm: Floats, load_nm: Floats, frequency_hz: float, width_hz: float = 0.0
) -> Peak | None:
    """The line of the torque that the motion needs (m,) at a frequency, which a load (m,) cannot have made; None: none.

    A disturbance moves the axis with its own torque, times what the loop amplifies; a spring near its resonance has the
    torque of its inertia, and more. The strength of the line is its amplitude over that of the load.
    """
    frequency, motion = time_spectrum(rows, motion_nm)
    load = time_spectrum(rows, load_nm)[1]
    longest_s = max(end - begin for begin, end in rows.bounds) * rows.filter.row_period_s
    near = np.flatnonzero(np.abs(frequency - frequency_hz) <= max(width_hz, LINE_WIDTH / longest_s))
    if not near.size:
        return None
    place = near[np.argmax(motion[near])]
    around = np.abs(np.arange(frequency.size) - place) <= max(NEIGHBOURS, near.size)
    found = Peak(float(frequency[place]), float(np.sqrt(motion[place] / max(float(load[near].max()), 1e-300))))
    stands_out = motion[place] > OUTSTANDING * float(np.median(motion[around]))
    stands_out &= bool(motion[place] == motion[max(0, place - 1) : place + 2].max())  # and is no flank of another line
    return found if stands_out and found.strength > OWN_LINE else None


def _peaks(places: Floats, power: Floats, count: int, least: float) -> list[Peak]:
    """Lines above the level, which is the median of blocks of a constant ratio: a strong line has broad flanks."""
    edges = np.geomspace(max(least, places[1]), places[-1], LEVEL_BLOCKS + 1)
    centres, levels = [], []
    for low, high in itertools.pairwise(edges):
        inside = (places >= low) & (places < high)
        if inside.sum() >= 4:
            centres.append(np.log(low * high) / 2.0)
            levels.append(np.log(max(float(np.median(power[inside])), 1e-300)))
    if len(levels) < 3:
        return []
    smooth = scipy.ndimage.median_filter(np.array(levels), 3, mode="nearest")
    level = np.exp(np.interp(np.log(np.maximum(places, places[1])), centres, smooth))
    ratio = np.where(places >= least, power / level, 0.0)
    top = (ratio == scipy.ndimage.maximum_filter1d(ratio, 2 * NEIGHBOURS + 1)) & (ratio > OUTSTANDING)
    found = [Peak(float(places[k]), float(ratio[k])) for k in np.flatnonzero(top)]
    return ranked(found, key=lambda p: -p.strength)[:count]

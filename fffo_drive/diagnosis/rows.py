"""Runs in the form that the diagnosis uses: the path at full rate, and rows at the rate of the shared filter.

Residual and regressors go through the same symmetric filter and are sampled at every `step`-th point, so any linear
relation between signals also holds between their rows. Derivatives are central differences taken before the filter:
filter and difference commute.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy  # its modules load where they are first used

from ..arrays import Floats, Integers, Mask
from ..identification.criterion import Folds, folds_of
from ..identification.dataset import Record
from ..identification.kinematics import low_pass
from ..identification.ladder import HIGHEST_ORDER, SLOW_QUANTILE
from ..least_squares import least_squares
from .kernels import filter_rows, play_path

CUTOFF_HZ = 45.0  # cut-off of the shared filter for runs that also contain slow motion
HIGHEST_SHARE = 0.15  # limit of a higher cut-off, as a share of the record's rate
STANDS_OUT = 0.05  # a wave raises the cut-off if it explains this share of a rigid axis' residual ...
ABOVE = 2.0  # ... and puts it this factor above the wave
ROW_SHARE = 2.8  # rows per second relative to the cut-off
RESPONSE_POINTS = 512
TAPS_PERIODS = 1.9  # half the filter's length, in periods of the cut-off
LAW_HZ = 500.0  # rate at which friction and effects are evaluated; higher for a high cut-off
LAW_RATIO = 5.0
PATH_HZ = 200.0  # cut-off of the position used by friction and effects
PLAY_LSB = 0.2
EDGE_S = 0.15  # margin at the ends of a stretch, where filters have no data
SHORTEST_S = 0.6  # shortest stretch: four margins
REST_S = 0.1  # rest: the low-pass position stays for this long ...
REST_LSB = 20.0  # ... within this many counts


class Filter(NamedTuple):
    """The shared filter: symmetric taps at the rate of the records, and the samples per row."""

    taps: Floats
    step: int
    cutoff_hz: float
    period_s: float
    law_period_s: float
    response: Floats  # gain for a sine, over frequencies up to half the rate

    @property
    def row_period_s(self) -> float:
        """Time between rows."""
        return self.step * self.period_s

    def rows(self, values: Floats) -> Floats:
        """One signal (n,), filtered, at the rows."""
        output = np.empty(-(-values.size // self.step))
        filter_rows(np.ascontiguousarray(values, dtype=np.float64), self.taps, self.step, output)
        return output

    def thinned(self) -> Filter:
        """The same filter for signals at the laws' rate."""
        thin = round(self.law_period_s / self.period_s)
        if thin == 1:
            return self
        half = self.taps.size // 2 // thin
        taps = scipy.signal.firwin(2 * half + 1, self.cutoff_hz, fs=1.0 / self.law_period_s, window="hamming")
        period_s = self.law_period_s
        return _filter(taps, self.step // thin, self.cutoff_hz, period_s, period_s)

    def gain(self, frequency_hz: Floats) -> Floats:
        """Gain for a sine, by its frequency."""
        return np.interp(np.abs(frequency_hz) * self.points_per_hz, np.arange(self.response.size), self.response)

    @property
    def points_per_hz(self) -> float:
        """Points of `response` per Hz."""
        return (self.response.size - 1) * 2.0 * self.period_s


def _filter(taps: Floats, step: int, cutoff_hz: float, period_s: float, law_period_s: float) -> Filter:
    k = np.arange(taps.size) - taps.size // 2
    grid = np.linspace(0.0, 0.5 / period_s, RESPONSE_POINTS)
    response = np.cos(2.0 * math.pi * np.outer(grid, k) * period_s) @ taps
    return Filter(np.asarray(taps, dtype=np.float64), step, cutoff_hz, period_s, law_period_s, np.asarray(response))


def thinning(period_s: float, cutoff_hz: float = CUTOFF_HZ) -> int:
    """Samples of the record per sample of the laws."""
    return max(1, int(1.0 / (max(LAW_HZ, LAW_RATIO * cutoff_hz) * period_s) + 1e-9))


def make_filter(period_s: float, cutoff_hz: float = CUTOFF_HZ) -> Filter:
    """Windowed-sinc low-pass: half at the cut-off, negligible at half the row rate."""
    cutoff_hz = min(cutoff_hz, 0.2 / period_s)
    half = max(2, round(TAPS_PERIODS / (cutoff_hz * period_s)))
    taps = scipy.signal.firwin(2 * half + 1, cutoff_hz, fs=1.0 / period_s, window="hamming")
    thin = thinning(period_s, cutoff_hz)
    step = thin * max(1, int(1.0 / (ROW_SHARE * cutoff_hz * period_s * thin) + 1e-9))
    return _filter(taps, step, cutoff_hz, period_s, thin * period_s)


def slow_rps(records: Sequence[Record]) -> float:
    """The speed below which a tenth of the motion lies."""
    speeds = []
    for record in records:
        for part in record.segments():
            position = record.position_rev[part]
            if position.size * record.period_s < SHORTEST_S:
                continue
            speed = np.abs(np.gradient(low_pass(position - position[0], CUTOFF_HZ, record.period_s), record.period_s))
            speeds.append(speed[speed > REST_LSB * record.lsb_rev / REST_S])
    moving = np.concatenate(speeds) if speeds else np.zeros(0)
    return float(np.quantile(moving, SLOW_QUANTILE)) if moving.size else 0.0


def cutoff_of(records: Sequence[Record], rotary: bool = True) -> float:
    """The cut-off, Hz: CUTOFF_HZ, or higher where the axis never turns slowly and a wave of high order stands out."""
    rate_hz = 1.0 / records[0].period_s
    slow = slow_rps(records)
    highest_hz = max(CUTOFF_HZ, HIGHEST_SHARE * rate_hz)
    if not rotary or slow * HIGHEST_ORDER <= CUTOFF_HZ or highest_hz <= CUTOFF_HZ:
        return CUTOFF_HZ
    filter_ = make_filter(records[0].period_s, highest_hz)
    stretches = stretches_of(records, filter_)
    if not stretches:
        return CUTOFF_HZ
    rows = rows_of(stretches, filter_)
    velocity, position = rows.velocity_rps, rows.position_rev
    torque = np.concatenate([filter_.rows(s.torque_constant_nm_per_a * s.current_a) for s in stretches])
    rigid = np.column_stack([rows.acceleration_rps2, velocity, np.sign(velocity), np.ones(velocity.size)])
    kept = rows.kept
    left = np.zeros(torque.size)
    left[kept] = least_squares(rigid[kept], torque[kept]).residual
    wanted_hz = CUTOFF_HZ
    usual = float(np.median(np.abs(velocity[kept])))
    for order in range(max(1, round(CUTOFF_HZ / usual)), round(min(HIGHEST_ORDER, highest_hz / slow)) + 1):
        wave = left * np.exp(2j * np.pi * order * position)
        # a line of amplitude A has a mean square of A^2 / 2; the datum may differ between runs
        lines = sum(2.0 * abs(wave[begin:end].sum()) ** 2 / (end - begin) for begin, end in rows.bounds)
        if lines > STANDS_OUT * float(left @ left):
            wanted_hz = min(highest_hz, ABOVE * order * usual)
    return wanted_hz


class DiagnosisStretch(NamedTuple):
    """A stretch of a record without a gap: sensors and command at the record's rate, (n,); motion at the laws',
    (l,).
    """

    run: int
    name: str
    begin_s: float  # on the clock of the log
    period_s: float
    torque_constant_nm_per_a: float
    lsb_rev: float
    position_rev: Floats  # (n,) measured
    current_a: Floats  # (n,) command
    measured_a: Floats | None  # (n,)
    reference_rps: Floats | None  # (n,)
    law_period_s: float
    smooth_rev: Floats  # (l,) low-pass position
    velocity_rps: Floats  # (l,) derivative of that; zero at rest
    acceleration_rps2: Floats  # (l,)
    path_rev: Floats  # (l,) position behind a play: changes only with real motion
    good: Mask  # (l,) measured; False: interpolated across a gap
    rest: Mask  # (l,) no motion that the sensor can resolve
    balance_nm: Floats  # (l,) motor torque minus inertia by the current base model: the friction at rest

    @property
    def samples(self) -> int:
        """Number of samples at the laws' rate."""
        return int(self.smooth_rev.size)

    @property
    def thin(self) -> int:
        """Samples of the record per sample of the laws."""
        return round(self.law_period_s / self.period_s)


def stretches_of(records: Sequence[Record], filter_: Filter) -> list[DiagnosisStretch]:
    """All stretches that are long enough, in the order of the records."""
    return [
        _stretch(number, record, part, round(filter_.law_period_s / filter_.period_s))
        for number, record in enumerate(records)
        for part in record.segments()
        if (part.stop - part.start) * record.period_s >= SHORTEST_S
    ]


def _stretch(number: int, record: Record, part: slice, thin: int) -> DiagnosisStretch:
    origin = record.position_rev[part.start]
    period_s = record.period_s
    position = np.ascontiguousarray(record.position_rev[part])
    smooth = low_pass(position - origin, min(PATH_HZ, 0.2 / period_s), period_s) + origin
    path = np.empty(smooth.size)
    play_path(smooth, PLAY_LSB * record.lsb_rev, path)
    velocity = np.gradient(smooth, period_s)
    acceleration = np.gradient(velocity, period_s)
    rest = resting(smooth, record.lsb_rev, period_s)
    velocity[rest] = 0.0
    good = np.ones(smooth.size, bool) if record.good is None else record.good[part]

    def cut(values: Floats | None) -> Floats | None:
        return None if values is None else np.ascontiguousarray(values[part])

    def slow(values: Floats) -> Floats:
        return np.ascontiguousarray(values[::thin])

    return DiagnosisStretch(
        number, record.name, record.begin_s + part.start * period_s, period_s, record.torque_constant_nm_per_a,
        record.lsb_rev, position, np.ascontiguousarray(record.current_a[part]), cut(record.measured_current_a),
        cut(record.reference_rps), thin * period_s, slow(smooth), slow(velocity), slow(acceleration), slow(path),
        np.minimum.reduceat(good, np.arange(0, good.size, thin)),
        np.ascontiguousarray(rest[::thin]), np.zeros(-(-smooth.size // thin)),
    )  # fmt: skip


class DiagnosisRows(NamedTuple):
    """The rows of all stretches, concatenated; (m,) each."""

    filter: Filter  # for signals at the record's rate
    laws: Filter  # the same for signals at the laws' rate
    bounds: tuple[tuple[int, int], ...]  # rows of each stretch
    run: Integers
    time_s: Floats  # on the clock of the log
    velocity_rps: Floats
    acceleration_rps2: Floats
    position_rev: Floats
    kept: Mask  # neither at rest, nor at the ends, nor near a gap
    folds: Folds

    def joined(self, parts: Iterable[Floats]) -> Floats:
        """Signals of all stretches at the laws' rate (l,), sampled at the rows without a filter. (m,)"""
        return np.concatenate([part[:: self.laws.step] for part in parts])

    @property
    def turns(self) -> float:
        """Range of the angle, rev."""
        return float(np.ptp(self.position_rev))


def rows_of(stretches: Sequence[DiagnosisStretch], filter_: Filter) -> DiagnosisRows:
    """Labels and kinematics of the rows."""
    laws = filter_.thinned()
    columns: dict[str, list[npt.NDArray[np.generic]]] = {}
    bounds, begin = [], 0
    edge = round(EDGE_S / filter_.row_period_s)
    reach = filter_.taps.size // 2 * 2 // (round(filter_.law_period_s / filter_.period_s) * 2)
    for stretch in stretches:
        position = filter_.rows(stretch.position_rev)
        count = position.size
        clean = scipy.ndimage.minimum_filter1d(stretch.good.astype(np.int8), 2 * reach + 1) > 0
        kept = (clean & ~stretch.rest)[:: laws.step]
        kept[:edge] = False
        kept[count - edge :] = False
        for name, values in (
            ("run", np.full(count, stretch.run)),
            ("time_s", stretch.begin_s + np.arange(count) * filter_.row_period_s),
            ("velocity_rps", laws.rows(stretch.velocity_rps)),
            ("acceleration_rps2", filter_.rows(second_difference(stretch.position_rev, stretch.period_s))),
            ("position_rev", position),
            ("kept", kept),
        ):
            columns.setdefault(name, []).append(values)
        bounds.append((begin, begin + count))
        begin += count
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    return DiagnosisRows(filter_, laws, tuple(bounds), folds=folds_of(bounds, filter_.row_period_s), **joined)


def resting(smooth_rev: Floats, lsb_rev: float, period_s: float) -> Mask:
    """True where the position stays within REST_LSB counts for REST_S. (n,)"""
    half = max(1, round(0.5 * REST_S / period_s))
    high = scipy.ndimage.maximum_filter1d(smooth_rev, 2 * half + 1)
    low = scipy.ndimage.minimum_filter1d(smooth_rev, 2 * half + 1)
    return np.asarray(high - low < REST_LSB * lsb_rev)


def second_difference(values: Floats, period_s: float) -> Floats:
    """Central second difference; zero at the two ends."""
    found = np.zeros(values.size)
    found[1:-1] = (values[2:] - 2.0 * values[1:-1] + values[:-2]) / (period_s * period_s)
    return found

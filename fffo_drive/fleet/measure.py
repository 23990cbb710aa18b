"""A run to its record: identity, the balance that adds up, what the run covered, and what the balance leaves."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .. import __version__
from ..arrays import Floats
from ..identification.dataset import DataError, Record
from ..identification.facts import DriveFacts
from ..identification.kinematics import DEFAULT_CUTOFF_HZ
from ..identification.ladder import SLOW_QUANTILE, WAVE_PERIODS, WaveSums, wave_sums, waves_of
from ..identification.rows import (
    RegressionRows,
    RegressionStretch,
    is_one_way,
    longest_delay_samples,
    parabola_minimum,
    rows_at,
    sliding_travel_rev,
    stroke_ends,
)
from ..least_squares import spectrum
from .backlash import GAP_REV, GAP_UPPER, GapSums, gap_of, gap_sums
from .pieces import LogPieces, MovingPart, Piece, moving_parts, temperatures_degc, whole
from .regress import (
    COULOMB,
    EVERY_COLUMN,
    INERTIA,
    OFFSET,
    PARAMETERS,
    RUNGS,
    VISCOUS,
    Balance,
    BalanceMotion,
    Estimates,
    balance_columns,
    columns_there,
    effective_rows,
    explained_by,
    packed,
    rows_a_block,
    solve,
)
from .schema import ANGLE_BINS, BAND_EDGES_HZ, HIGHEST_ORDER, LOAD_QUANTILES, SCHEMA_VERSION, SPEED_EDGES_RPS

SMALLEST, LARGEST = 1e-12, 1e9  # of what quantiles are taken of
QUANTILE_SHARE = 1e-4  # relative width of the histogram's bins
LEAST_ROWS = 40  # of sure sliding
TOOL = f"fffo-drive {__version__}"


def measured(path: Path, digest: str, facts: DriveFacts | None) -> dict[str, Any]:
    """The record of a run's file, without what the index says of it. `facts`: None where the recording carries them.

    The log is read in pieces, several times: how long it is makes no difference to the memory.
    Raises RecordingError (DataError too), DocumentError for a file that makes no record, OSError.
    """
    pieces = LogPieces(path, facts, digest)
    facts = pieces.facts
    found = balance_in(pieces, facts, path)
    return {
        "run": digest, "schema_version": SCHEMA_VERSION, "tool": TOOL,
        "duration_s": pieces.duration_s, "rate_hz": pieces.rate_hz, "units": facts.units,
        **_balance(found.balance, found.estimates), "delay_s": found.delay_s,
        **_gap(gap_in(pieces, facts, found), facts.units),
        **found.left.columns(found.balance, facts, found.motion),
        **found.covered.columns(),
        **pieces.temperature(), **pieces.ticks(),
    }  # fmt: skip


class Balanced(NamedTuple):
    """The balance of a run, and what goes with it."""

    balance: Balance
    estimates: Estimates
    delay_s: float
    motion: BalanceMotion
    covered: Covered
    left: Left


def balance_in(pieces: Iterable[Piece], facts: DriveFacts, path: Path) -> Balanced:
    """The balance of a log in pieces, which are iterated over three times. Raises DataError."""
    cutoff_hz = min(DEFAULT_CUTOFF_HZ, 0.1 / next(iter(pieces)).record.period_s)
    travel_rev = _sliding_travel_rev(pieces, cutoff_hz)
    covered, sums = Covered(), None
    for part, stretch in _stretches(pieces, cutoff_hz, travel_rev):
        sums = sums or DelaySums(stretch.motion.period_s, part.step(cutoff_hz))
        covered.take(part, stretch)
        sums.take(stretch, cutoff_hz, facts)
    if sums is None or sums.sliding < LEAST_ROWS:
        sliding = 0 if sums is None else sums.sliding
        raise DataError(
            f"{path}: {sliding} rows of sure sliding motion, {LEAST_ROWS} are needed: hardly anything moves"
        )
    delay_s, motion = sums.delay_s(), sums.motion()
    balance = sums.balance(delay_s, facts, motion)
    left = Left(solve(balance), sums, cutoff_hz)
    for _, stretch in _stretches(pieces, cutoff_hz, travel_rev):
        rows = rows_at([stretch], cutoff_hz, delay_s)
        left.take(rows, balance_columns(rows, facts, motion))
    balance = balance._replace(effective_rows=left.effective_rows(balance))
    return Balanced(balance, solve(balance), delay_s, motion, covered, left)


def gap_in(pieces: Iterable[Piece], facts: DriveFacts, found: Balanced) -> GapSums | None:
    """The sums of backlash; None for a run that says nothing of it."""
    return gap_sums(pieces, facts, found.estimates, found.delay_s, found.motion, found.covered.samples)


def _stretches(
    pieces: Iterable[Piece], cutoff_hz: float, travel_rev: float
) -> Iterator[tuple[MovingPart, RegressionStretch]]:
    for part in moving_parts(pieces, cutoff_hz):
        stretch = part.stretch(travel_rev, cutoff_hz)
        if stretch is not None:
            yield part, stretch


def _sliding_travel_rev(pieces: Iterable[Piece], cutoff_hz: float) -> float:
    """Travel after which presliding is over, by the strokes of all pieces. Raises DataError."""
    strokes, lsb_rev = [], 0.0
    for part in moving_parts(pieces, cutoff_hz):
        ends = stroke_ends(part.travel_rev)
        ends = ends[(ends + 1 >= part.core.start) & (ends + 1 < part.core.stop)]
        strokes.append(part.travel_rev[ends])
        lsb_rev = part.record.lsb_rev
    if not strokes:
        raise DataError("all stretches of the logs are too short for the filter")
    return sliding_travel_rev(np.concatenate(strokes), lsb_rev)


class Quantiles:
    """Quantiles of sizes by a histogram of their logarithms: each within QUANTILE_SHARE of its size."""

    def __init__(self) -> None:
        self._count = np.zeros(round(math.log(LARGEST / SMALLEST) / QUANTILE_SHARE) + 2, dtype=np.int64)

    def take(self, sizes: Floats) -> None:
        """More values (n,) from 0."""
        place = np.log(np.clip(sizes, SMALLEST, LARGEST) / SMALLEST) / QUANTILE_SHARE
        self._count += np.bincount(np.round(place).astype(np.int64), minlength=self._count.size)

    def quantile(self, share: float) -> float:
        """The value below which this share is; nan of none."""
        upto = np.cumsum(self._count)
        if not upto[-1]:
            return math.nan
        place = int(np.searchsorted(upto, share * (upto[-1] - 1), side="right"))
        return 0.0 if place == 0 else SMALLEST * math.exp(place * QUANTILE_SHARE)


class DelaySums:
    """Sums from which the balance of a run follows at any delay of its torque, and the delay itself."""

    def __init__(self, period_s: float, step: int) -> None:
        """`step`: samples from one row to the next."""
        self._period_s, self.row_period_s = period_s, step * period_s
        self._delays = longest_delay_samples(period_s) + 2  # whole samples; one more, and one to interpolate to
        size = len(PARAMETERS) + self._delays
        self._gram = np.zeros((size, size))
        self._ways = np.zeros(3)  # rows that slide one way, the other way, in all
        self._place_rev = (math.inf, -math.inf)
        self.rows = self.sliding = 0
        self.slow_rps = Quantiles()

    def take(self, stretch: RegressionStretch, cutoff_hz: float, facts: DriveFacts) -> None:
        """The rows of a piece."""
        rows = rows_at([stretch], cutoff_hz, 0.0)
        kept = rows.sliding
        self.rows += kept.size
        self.sliding += int(np.count_nonzero(kept))
        if not kept.any():
            return
        columns = balance_columns(rows, facts, EVERY_COLUMN)[kept]
        late = stretch.rows[kept][:, None] - np.arange(self._delays)
        both = np.column_stack([columns, stretch.torque_nm[np.maximum(late, 0)]])
        self._gram += both.T @ both
        way = rows.direction[kept]
        self._ways += np.array([np.sum(way > 0.0), np.sum(way < 0.0), way.size], dtype=np.float64)
        position_rev = rows.position_rev[kept]
        low, high = self._place_rev
        self._place_rev = min(low, float(position_rev.min())), max(high, float(position_rev.max()))
        self.slow_rps.take(np.abs(rows.velocity_rps[kept]))

    def motion(self) -> BalanceMotion:
        """As `motion_at` of all rows."""
        low, high = self._place_rev
        return BalanceMotion(is_one_way(*self._ways.tolist()), max(0.0, high - low))

    def delay_s(self) -> float:
        """Where the balance leaves least, as `rigid_balance`."""
        delays = np.arange(0, self._delays - 1, 2)
        rigid = np.array([INERTIA, VISCOUS, COULOMB, OFFSET])
        basis = spectrum(self._gram[np.ix_(rigid, rigid)]).basis()
        torque = len(PARAMETERS) + delays
        explained = np.sum((basis.T @ self._gram[np.ix_(rigid, torque)]) ** 2, axis=0)
        costs: Floats = self._gram[torque, torque] - explained
        return parabola_minimum(np.asarray(delays * self._period_s, dtype=np.float64), costs) or 0.0

    def balance(self, delay_s: float, facts: DriveFacts, motion: BalanceMotion) -> Balance:
        """At a delay; the effective rows are left to those who know the residual."""
        size = len(PARAMETERS)
        whole = min(math.floor(delay_s / self._period_s), self._delays - 2)
        part = delay_s / self._period_s - whole
        between = np.zeros(self._delays)
        between[[whole, whole + 1]] = 1.0 - part, part
        used = columns_there(facts, motion).astype(np.float64)
        normal = self._gram[:size, :size] * np.outer(used, used)
        moment = used * (self._gram[:size, size:] @ between)
        energy_nm2 = float(between @ self._gram[size:, size:] @ between)
        return Balance(normal, moment, energy_nm2, float(self.sliding), float(self.sliding))


class Left:
    """What the balance leaves, piece by piece."""

    def __init__(self, estimates: Estimates, sums: DelaySums, cutoff_hz: float) -> None:
        self._estimates, self._rows, self._cutoff_hz = estimates, 0, cutoff_hz
        self._slow_rps = sums.slow_rps.quantile(SLOW_QUANTILE)
        self._block = rows_a_block(sums.rows, sums.row_period_s)
        self._scores = np.zeros((sums.rows // self._block + 1, len(PARAMETERS)))
        self._energy_nm2, self._sliding = 0.0, 0
        self._waves: WaveSums | None = None
        self._power = np.zeros(BAND_EDGES_HZ.size - 1)

    def take(self, rows: RegressionRows, columns: Floats) -> None:
        """The rows of a piece and their columns."""
        residual_nm = np.where(rows.sliding, rows.torque_nm - columns @ self._estimates.theta, 0.0)
        block = (self._rows + np.arange(rows.sliding.size)) // self._block
        np.add.at(self._scores, block, columns * residual_nm[:, None])
        self._rows += rows.sliding.size
        self._sliding += int(np.count_nonzero(rows.sliding))
        self._energy_nm2 += float(residual_nm @ residual_nm)
        sums = wave_sums(rows, residual_nm, rows.sliding.astype(np.float64), HIGHEST_ORDER)
        self._waves = sums if self._waves is None else WaveSums(*map(operator.add, self._waves, sums))
        self._power += _band_power(rows, residual_nm)

    def effective_rows(self, balance: Balance) -> float:
        """Independent rows among those of the balance."""
        scores = self._scores[np.any(self._scores != 0.0, axis=1)]
        return effective_rows(balance, scores, float(self._estimates.rms_nm))

    def columns(self, balance: Balance, facts: DriveFacts, motion: BalanceMotion) -> dict[str, Any]:
        """Rungs of the ladder, orders of the angle and bands of frequency in the residual."""
        assert self._waves is not None
        waves, energy = waves_of(self._waves), self._energy_nm2
        order = np.arange(1, HIGHEST_ORDER + 1)
        # that the motion passes often enough, and slowly enough for the filter
        resolved = (order * self._slow_rps < self._cutoff_hz) & (order * motion.travel_rev >= WAVE_PERIODS)
        resolved &= facts.units == "rotary"
        share = np.where(resolved, waves.explained[0] / energy, 0.0) if energy > 0.0 else np.zeros(HIGHEST_ORDER)
        return {
            **{f"{rung}_share": explained_by(balance, columns) for rung, columns in RUNGS.items()},
            "wave_share": float(share.max()),
            "wave_order": int(np.argmax(share)) + 1 if resolved.any() else None,
            "order_amplitude_nm": np.asarray(np.where(resolved, np.abs(waves.amplitude[0]), np.nan)),
            "band_rms_nm": np.asarray(np.sqrt(self._power / self._sliding)),
        }


def _band_power(rows: RegressionRows, residual_nm: Floats) -> Floats:
    """Sum of the squared residual (m,) in each band; a piece has a spectrum of its own (Bartlett, 1950)."""
    power = np.zeros(BAND_EDGES_HZ.size - 1)
    for begin, end in rows.bounds:
        part = residual_nm[begin:end]
        density = np.abs(np.fft.rfft(part)) ** 2
        density[1 : -1 if part.size % 2 == 0 else None] *= 2.0
        frequency_hz = np.fft.rfftfreq(part.size, rows.period_s)
        power += np.histogram(frequency_hz, BAND_EDGES_HZ, weights=density / part.size)[0]
    return power


class Covered:
    """What a run covered, piece by piece."""

    def __init__(self) -> None:
        self.samples = 0
        self._speed = np.zeros(SPEED_EDGES_RPS.size - 1, dtype=np.int64)
        self._angle = np.zeros(ANGLE_BINS, dtype=np.int64)
        self._squares = np.zeros(2)  # of velocity and acceleration
        self._load = Quantiles()
        self._place_rev = (math.inf, -math.inf)

    def take(self, part: MovingPart, stretch: RegressionStretch) -> None:
        """The samples of a piece's core."""
        velocity_rps = stretch.motion.velocity_rps[part.core]
        position_rev = stretch.motion.position_rev[part.core]
        acceleration_rps2 = stretch.motion.acceleration_rps2[part.core]
        self.samples += velocity_rps.size
        self._speed += np.histogram(np.abs(velocity_rps), SPEED_EDGES_RPS)[0]
        self._angle += np.histogram(np.mod(position_rev, 1.0), ANGLE_BINS, (0.0, 1.0))[0]
        self._squares += (velocity_rps @ velocity_rps, acceleration_rps2 @ acceleration_rps2)
        self._load.take(np.abs(stretch.torque_nm[part.core]))
        low, high = self._place_rev
        self._place_rev = min(low, float(position_rev.min())), max(high, float(position_rev.max()))

    def columns(self) -> dict[str, Any]:
        """Of the record."""
        speed_rms_rps, acceleration_rms_rps2 = np.sqrt(self._squares / self.samples).tolist()
        return {
            "speed_share": self._speed / self.samples,
            "speed_rms_rps": speed_rms_rps,
            "acceleration_rms_rps2": acceleration_rms_rps2,
            "load_quantile_nm": np.array([self._load.quantile(share) for share in LOAD_QUANTILES]),
            "angle_share": self._angle / self.samples,
            "travel_rev": self._place_rev[1] - self._place_rev[0],
        }


def balance_of_record(record: Record, facts: DriveFacts) -> Balance:
    """The balance that the record of a run holds. Raises DataError for one that hardly moves."""
    return balance_in(whole(record), facts, record.path).balance


def temperature_of(columns: Mapping[str, Any]) -> float | None:
    """Mean temperature (degC) of a run by its columns; None where it was not logged."""
    values = temperatures_degc(columns)
    return float(values.mean()) if values.size else None


def _balance(balance: Balance, estimates: Estimates) -> dict[str, Any]:
    known = np.isfinite(estimates.sd)
    pairs = list(zip(PARAMETERS, estimates.theta.tolist(), estimates.sd.tolist(), known.tolist(), strict=True))
    return {
        "normal": packed(balance.normal), "moment": balance.moment, "energy_nm2": balance.energy_nm2,
        "rows": balance.rows, "effective_rows": balance.effective_rows,
        **{name: value if sure else None for name, value, _, sure in pairs},
        **{f"{name}_sd": sd if sure else None for name, _, sd, sure in pairs},
        "torque_rms_nm": float(np.sqrt(balance.energy_nm2 / balance.rows)), "rms_nm": float(estimates.rms_nm),
    }  # fmt: skip


def _gap(sums: GapSums | None, units: str) -> dict[str, Any]:
    """Sums of the gap; those of a run that says nothing of it are 0."""
    sums = sums or GapSums(np.zeros((GAP_REV.size, GAP_REV.size)), np.zeros(GAP_REV.size), 0.0, 0.0, 0.0)
    found = gap_of(sums, units)
    views = {"gap_rev": found.gap_rev, "gap_log_sd": found.log_sd, "gap_share": found.share}
    return {
        "gap_normal": sums.normal[GAP_UPPER], "gap_moment": sums.moment, "gap_energy_nm2": sums.energy_nm2,
        "gap_rows": sums.rows, "gap_effective_rows": sums.effective_rows,
        **{name: float(value) if np.isfinite(value) else None for name, value in views.items()},
    }  # fmt: skip

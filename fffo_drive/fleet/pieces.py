"""A log in pieces: what its record needs, in memory that does not grow with its length.

A piece is a core, and on both sides of it a margin in which filters settle; the cores join without gap or overlap. A
recording is read anew for each iteration, block by block; a table, which is read at once, is only cut.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats, Integers
from ..identification.dataset import (
    MODE,
    SHORTEST_S,
    TAKEN,
    TIMING,
    DataError,
    Record,
    check_record,
    log_of,
    record_of_part,
)
from ..identification.facts import DriveFacts
from ..identification.gaps import LogTiming
from ..identification.kinematics import NOTHING_BEFORE, Before, Kinematics, motion_of, sure_direction
from ..identification.kinematics import travel_since_reversal_rev as travel_of
from ..identification.rows import RegressionStretch, samples_a_row, stretch_of
from ..identification.timebase import GAP_PERIODS, LONGEST_BRIDGE_S, typical_period_s
from ..importing.read import RECORDINGS
from ..recording.events import Level
from ..recording.reader import RowBlocks, Run
from ..signals import TEMPERATURE
from ..units import NS_PER_S
from ..workflows.recorded_facts import facts_in

PIECE_S = 20.0  # of a core
MARGIN_S = 2.0  # on each side: the slowest filter has forgotten what was before by a factor of 1e15
TICKS = (*TIMING, MODE, "late", "trip", "error_rps")
NEEDED = {*TAKEN, *TICKS, TEMPERATURE.name}

Columns = Mapping[str, Any]


class Piece(NamedTuple):
    """A part of a log with its margins."""

    record: Record
    span: int  # stretch of the log without a gap in time
    offset: int  # of its first sample in that
    core: tuple[int, int]  # samples from, to


@dataclass
class _Seen:
    """What one look at all rows of a log shows."""

    rows: int = 0
    active: tuple[int, int] | None = None  # first and last row in which the loop applied torque
    late: int = 0
    skipped: int = 0
    without_feedback: int = 0
    trip: int = 0
    error: tuple[float, int] = (0.0, 0)  # sum of squares of the control error with torque on, and rows
    temperature: tuple[float, int, float, float] = (0.0, 0, math.inf, -math.inf)  # sum, rows, low, high
    _tick: int | None = field(default=None, repr=False)

    def take(self, columns: Columns) -> None:
        """The next rows."""
        size = columns["time_s"].size
        if "mode" in columns:
            active = np.flatnonzero(columns["mode"]) + self.rows
            if active.size:
                self.active = (self.active[0] if self.active else int(active[0]), int(active[-1]))
        if set(TICKS) <= set(columns) and size:
            tick, on = columns["tick"].astype(np.int64), columns["mode"] != 0
            before = tick[0] - 1 if self._tick is None else self._tick
            self.skipped += int(np.sum(np.diff(tick, prepend=before) - 1))
            self._tick = int(tick[-1])
            self.late += int(np.count_nonzero(columns["late"]))
            self.without_feedback += int(np.count_nonzero(columns["velocity_age"]))
            self.trip = int(columns["trip"][-1])
            error_rps = columns["error_rps"][on].astype(np.float64)
            self.error = (self.error[0] + float(error_rps @ error_rps), self.error[1] + error_rps.size)
        values = temperatures_degc(columns)
        if values.size:
            total, count, low, high = self.temperature
            low, high = min(low, float(values.min())), max(high, float(values.max()))
            self.temperature = (total + float(values.sum()), count + values.size, low, high)
        self.rows += size


def temperatures_degc(columns: Columns) -> Floats:
    """Those that were logged. (n,)"""
    values = np.asarray(columns.get(TEMPERATURE.name, []), dtype=np.float64)
    return values[np.isfinite(values)]


class LogPieces:
    """A log in pieces, as often as it is iterated over."""

    def __init__(self, path: Path, facts: DriveFacts | None, digest: str) -> None:
        """`facts`: None where the recording carries them. Raises RecordingError (DataError too), DocumentError for a
        log that makes no record, OSError.
        """
        self._path, self._digest = path, digest
        self._table: Columns | None = None
        self._blocks = RowBlocks(path) if path.name.endswith(RECORDINGS) else None
        self._start_ns: int | None = None
        self._kept: list[Piece] | None = None  # of a log that is one piece
        if self._blocks is None:
            if facts is None:
                raise DataError(f"{path}: a table carries no facts about its drive: add it with --drive FILE")
            self._table = log_of(path, facts).columns
        self._seen = _Seen()
        first: list[Floats] = []
        for columns in self._columns():
            self._seen.take(columns)
            if sum(map(len, first)) < 10_000:
                first.append(columns["time_s"])
        run = None if self._blocks is None else self._blocks.rest
        self.run: Run | None = run  # without its rows
        self.facts: DriveFacts = facts or facts_in(self._blocks.rest)  # type: ignore[union-attr]
        self._loops = run is not None and MODE in (run.rows.dtype.names or ())
        if run is not None and self._loops and self._seen.active is None:
            raise DataError(run.lacks("the loop never applied torque in this run"))
        times_s = np.concatenate(first) if first else np.zeros(0)
        if times_s.size < 3:
            raise DataError(f"{path}: {self._seen.rows} rows; at least {SHORTEST_S:g} s are needed")
        self.period_s = typical_period_s(times_s)
        self._require_usable()

    @property
    def rate_hz(self) -> float:
        """Samples a second."""
        return 1.0 / self.period_s

    def _require_usable(self) -> None:
        """Raise DataError for what the piece that moves most says against a fit; take its resolution for all."""
        pieces = list(self._pieces()) if self._seen.rows * self.period_s <= PIECE_S else self._pieces()
        best: Record | None = None
        travel_rev = -1.0
        duration = 0
        for piece in pieces:
            duration += piece.core[1] - piece.core[0]
            position_rev = piece.record.position_rev
            finite = bool(np.isfinite(position_rev).all() and np.isfinite(piece.record.current_a).all())
            if not finite or float(np.ptp(position_rev)) > travel_rev:
                best, travel_rev = piece.record, math.inf if not finite else float(np.ptp(position_rev))
        if best is None:
            raise DataError(f"{self._path}: no stretch without a gap is long enough: record it without losses")
        problems, _ = check_record(best)
        if problems:
            raise DataError("\n".join(problems))
        self._lsb_rev, self.period_s, self.duration_s = best.lsb_rev, best.period_s, duration * best.period_s
        if isinstance(pieces, list):
            self._kept = pieces

    def __iter__(self) -> Iterator[Piece]:
        for piece in self._pieces() if self._kept is None else self._kept:
            yield piece._replace(record=replace(piece.record, lsb_rev=self._lsb_rev, period_s=self.period_s))

    # -- reading

    def _columns(self) -> Iterator[Columns]:
        """What is needed of all rows, in blocks."""
        if self._blocks is None:
            yield {name: np.asarray(values) for name, values in (self._table or {}).items() if name in NEEDED}
            return
        for block in self._blocks:
            names = block.rows.dtype.names or ()
            stamps = block.rows["deadline_ns"] if "deadline_ns" in names else block.log_time_ns
            if len(stamps) == 0:
                continue
            if self._start_ns is None:
                self._start_ns = int(stamps[0])
            columns = {name: np.ascontiguousarray(block.rows[name]) for name in names if name in NEEDED}
            yield {**columns, "time_s": (stamps.astype(np.int64) - self._start_ns) / NS_PER_S}

    def _active(self) -> Iterator[Columns]:
        """The part in which the loop applied torque; of other logs all."""
        begin, end = self._seen.active if self._loops and self._seen.active else (0, self._seen.rows - 1)
        number = 0
        for columns in self._columns():
            size = columns["time_s"].size
            part = slice(max(0, begin - number), max(0, min(size, end + 1 - number)))
            number += size
            if part.stop > part.start:
                yield {name: values[part] for name, values in columns.items()}

    def _spans(self) -> Iterator[tuple[bool, Columns]]:
        """Blocks without a gap in time inside, and whether there is one in front of them."""
        longest_s = max(LONGEST_BRIDGE_S, GAP_PERIODS * self.period_s) * (1.0 + 1e-9)
        last_s = -math.inf
        for columns in self._active():
            time_s = columns["time_s"]
            gaps = np.flatnonzero(np.diff(time_s, prepend=last_s) > longest_s)
            for a, b in zip([0, *gaps.tolist()], [*gaps.tolist(), time_s.size], strict=True):
                if b > a:
                    yield a in gaps, {name: values[a:b] for name, values in columns.items()}
            last_s = float(time_s[-1])

    def _pieces(self) -> Iterator[Piece]:
        cut: _Cut | None = None
        for number, (fresh, columns) in enumerate(self._spans()):
            if fresh or cut is None:
                if cut is not None:
                    yield from cut.rest()
                cut = _Cut(self, number)
            yield from cut.take(columns)
        if cut is not None:
            yield from cut.rest()

    def record_of(self, columns: Columns) -> Record | None:
        """Rows as a record; None for too few."""
        time_s = columns["time_s"]
        if time_s.size < 3:
            return None
        timing = None
        if self._loops and set(TIMING) <= set(columns):
            timing = LogTiming(*(columns[name].astype(np.int64) for name in TIMING))
        own = {name: values for name, values in columns.items() if name in TAKEN}
        record = record_of_part(self._path, own, timing, self.facts, self._digest)
        return record if record.segments() else None

    # -- what the rows say by themselves

    def temperature(self) -> dict[str, Any]:
        """Columns of the record."""
        total, count, low, high = self._seen.temperature
        if not count:
            return {}
        return {"temperature_degc": total / count, "temperature_low_degc": low, "temperature_high_degc": high}

    def ticks(self) -> dict[str, Any]:
        """What the loop did, of a recording of our own."""
        if self.run is None:
            return {}
        levels = np.array([event.level for event in self.run.events], dtype=np.int64)
        found: dict[str, Any] = {
            "complete": self.run.complete,
            "warnings": int(np.count_nonzero((levels >= Level.WARNING) & (levels < Level.ERROR))),
            "errors": int(np.count_nonzero(levels >= Level.ERROR)),
        }
        if not set(TICKS) <= set(self.run.rows.dtype.names or ()):
            return found
        seen = self._seen
        total, count = seen.error
        return found | {
            "ticks": seen.rows,
            "late": seen.late,
            "skipped": seen.skipped,
            "without_feedback": seen.without_feedback,
            "trip": seen.trip,
            "speed_error_rms_rps": math.sqrt(total / count) if count else None,
        }


class _Cut:
    """One stretch without a gap in time, cut into pieces."""

    def __init__(self, log: LogPieces, span: int) -> None:
        self._log, self._span = log, span
        self._held: list[Columns] = []
        self._begin_s = math.nan  # of the span, by its rows
        self._first_s: float | None = None  # by its first sample
        self._number = 0
        self._samples = max(1, round(PIECE_S / log.period_s))

    def take(self, columns: Columns) -> Iterator[Piece]:
        """The next rows; the pieces that are complete with them."""
        self._held.append(columns)
        if math.isnan(self._begin_s):
            self._begin_s = float(columns["time_s"][0])
        while float(columns["time_s"][-1]) > self._edge_s(self._number + 1) + MARGIN_S:
            yield from self._piece(self._edge_s(self._number + 1) + MARGIN_S)

    def rest(self) -> Iterator[Piece]:
        """The last piece."""
        yield from self._piece(math.inf)

    def _edge_s(self, number: int) -> float:
        return self._begin_s + number * self._samples * self._log.period_s

    def _piece(self, end_s: float) -> Iterator[Piece]:
        held = {name: np.concatenate([one[name] for one in self._held]) for name in self._held[0]}
        here = held["time_s"] < end_s
        record = self._log.record_of({name: values[here] for name, values in held.items()})
        number, self._number = self._number, self._number + 1
        later = held["time_s"] >= self._edge_s(self._number) - MARGIN_S
        self._held = [{name: values[later] for name, values in held.items()}]
        if record is None:
            return
        if self._first_s is None:
            self._first_s = record.begin_s
        offset = round((record.begin_s - self._first_s) / self._log.period_s)
        begin = max(0, number * self._samples - offset)
        end = record.samples if end_s == math.inf else min(record.samples, self._number * self._samples - offset)
        if end > begin:
            yield Piece(record, self._span, offset, (begin, end))


class MovingPart(NamedTuple):
    """A stretch of a piece without a gap, with its motion."""

    record: Record
    part: slice
    motion: Kinematics
    travel_rev: Floats  # since the last certain reversal (n,)
    before: Before
    offset: int
    core: slice  # samples of the stretch in the core

    def step(self, cutoff_hz: float) -> int:
        """Samples from one row to the next, whatever the last digits of the period."""
        return samples_a_row(self.record.period_s * (1.0 + 1e-9), cutoff_hz)

    def rows(self, cutoff_hz: float) -> Integers:
        """Samples of the core that are rows, counted from the begin of the span."""
        step = self.step(cutoff_hz)
        return np.arange(self.core.start + (-(self.offset + self.core.start)) % step, self.core.stop, step)

    def stretch(self, travel_rev: float, cutoff_hz: float) -> RegressionStretch | None:
        """As a stretch of a regression, where presliding is over after `travel_rev`; None for hardly any row."""
        rows = self.rows(cutoff_hz)
        if rows.size < 2:
            return None
        return stretch_of(0, self.record, self.part, self.motion, travel_rev, cutoff_hz, rows, self.before)


def whole(record: Record) -> list[Piece]:
    """A record in memory as one piece."""
    return [Piece(record, 0, 0, (0, record.samples))]


def moving_parts(pieces: Iterable[Piece], cutoff_hz: float) -> Iterator[MovingPart]:
    """The motion of all pieces in order; the last certain direction goes from each to the next."""
    last: tuple[int, int, Floats, Floats] | None = None
    for piece in pieces:
        for part in piece.record.segments():
            if part.stop - part.start <= 4.0 / (cutoff_hz * piece.record.period_s):
                continue
            motion = motion_of(piece.record, part, cutoff_hz)
            offset, before = piece.offset + part.start, NOTHING_BEFORE
            if last is not None and last[0] == piece.span and 0 <= offset - last[1] < last[2].size:
                before = Before(float(last[2][offset - last[1]]), float(last[3][offset - last[1]]))
            direction, travel_rev = sure_direction(motion, before), travel_of(motion, before)
            last = (piece.span, offset, direction, travel_rev)
            core = slice(max(0, piece.core[0] - part.start), min(part.stop, piece.core[1]) - part.start)
            if core.stop > core.start:
                yield MovingPart(piece.record, part, motion, travel_rev, before, offset, core)

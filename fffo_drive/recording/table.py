"""Import of logs that other programs made: CSV (plain, gzip) and MAT, into the columns that `reader.Run` has.

Nothing is repaired silently: data unusable for a fit are an error with file, place and column, anomalies are a warning.
A wrong unit cannot be detected here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..documents import did_you_mean
from .column_map import TIME, ColumnMap, Conversion, conversions, identity_map
from .csv_file import CsvFile
from .errors import RecordingError
from .mat_file import MatFile

Array = np.ndarray[Any, np.dtype[np.float64]]

GAP_PERIODS = 1.5  # a step in time beyond this many median periods is a gap
ROUNDED_SHARE = 0.05  # this many equal timestamps are due to the limited resolution of the log, not chance
TEXT_SUFFIXES = tuple(kind + packed for kind in (".csv", ".txt", ".tsv") for packed in ("", ".gz"))
SUFFIXES = (*TEXT_SUFFIXES, ".mat")


class _TableFile(Protocol):
    path: Path

    @property
    def names(self) -> list[str]: ...
    @property
    def scalars(self) -> dict[str, float]: ...
    @property
    def warnings(self) -> tuple[str, ...]: ...
    def columns(self, wanted: Sequence[str]) -> dict[str, Array]: ...
    def place(self, row: int) -> str: ...


@dataclass(frozen=True)
class LogTable:
    """An imported log."""

    path: Path
    columns: Mapping[str, Array]  # (n,) float64 each, `time_s` among them
    units: Mapping[str, str]
    scalars: Mapping[str, float]  # single numbers of a MAT file
    warnings: tuple[str, ...]
    gaps: tuple[int, ...]  # rows that come after a gap (only with `uneven_time`)

    @property
    def time_s(self) -> Array:
        """Time as the file has it."""
        return self.columns[TIME]

    @property
    def period_s(self) -> float:
        """Median step in time."""
        return float(np.median(np.diff(self.time_s)))

    def column(self, name: str) -> Array:
        """One column; RecordingError with the nearest names when there is none of this name."""
        if name not in self.columns:
            raise RecordingError(f"{self.path}: no column {name!r}: {did_you_mean(name, self.columns)}")
        return self.columns[name]


def read_table(
    path: Path | str,
    mapping: ColumnMap | None = None,
    *,
    require: Sequence[str] = (TIME,),
    uneven_time: bool = False,
) -> LogTable:
    """Read a CSV or MAT file by `mapping`; None takes the columns that are named as signals are.

    `require` names signals that must be there. Raises RecordingError with all that is wrong with the data:
    NaN or inf, stamps that are equal or run backwards, gaps; OSError when it cannot be opened. With `uneven_time` gaps
    are warnings and in `Table.gaps`, and single rows whose stamp is not later than all before it are dropped and
    counted in a warning.
    """
    source = _open(Path(path))
    mapping = identity_map(source.names) if mapping is None else mapping
    convert = _conversions(source, mapping, require)
    raw = source.columns([entry.column for entry in convert.values()] + list(mapping.extra))
    rows = len(next(iter(raw.values())))
    if rows < 2:
        raise RecordingError(f"{path}: {rows} rows of numbers; at least 2 are needed")
    columns = {} if mapping.rate_hz is None else {TIME: np.arange(rows) / mapping.rate_hz}
    columns |= {signal: _converted(raw[entry.column], entry) for signal, entry in convert.items()}
    columns |= {name: raw[name] for name in mapping.extra}
    units = {signal: entry.unit for signal, entry in convert.items()} | dict.fromkeys(mapping.extra, "-")
    labels = {signal: f"{entry.column!r} ({signal})" for signal, entry in convert.items()}
    warnings, gaps = _check(source, columns, labels, uneven_time)
    if uneven_time and TIME in columns:
        later = _later(columns[TIME])
        if not later.all():
            columns = {name: values[later] for name, values in columns.items()}
    return LogTable(Path(path), columns, {TIME: "s"} | units, source.scalars, (*source.warnings, *warnings), gaps)


def column_names(path: Path) -> list[str]:
    """Names of the columns of a CSV or MAT file. Raises RecordingError; OSError when it cannot be opened."""
    return list(_open(path).names)


def _open(path: Path) -> _TableFile:
    name = path.name.lower()
    if name.endswith(".mat"):
        return MatFile(path)
    if name.endswith(TEXT_SUFFIXES):
        return CsvFile(path)
    raise unknown_kind(path)


def unknown_kind(path: Path | str) -> RecordingError:
    """For a file whose name has no ending of a table."""
    return RecordingError(f"{path}: unknown kind of table; {', '.join(SUFFIXES)} can be read")


def _conversions(source: _TableFile, mapping: ColumnMap, require: Sequence[str]) -> dict[str, Conversion]:
    try:
        convert = conversions(mapping)
    except RecordingError as error:
        raise RecordingError(f"{source.path}: {error}") from error
    if not convert and not mapping.extra:
        listed = ", ".join(source.names) or "none"
        raise RecordingError(f"{source.path}: no column is named as a signal ({listed}): give a column map")
    provided = {*convert, *([TIME] if mapping.rate_hz is not None else [])}
    missing = [signal for signal in require if signal not in provided]
    if missing:
        hints = [f"nothing gives {signal}: {did_you_mean(signal, source.names)}" for signal in missing]
        raise RecordingError(f"{source.path}: " + "\n  ".join(hints))
    return convert


def _converted(raw: Array, entry: Conversion) -> Array:
    if entry.factor == 1.0 and entry.shift == 0.0:
        return raw
    return raw * entry.factor + entry.shift


def _check(
    source: _TableFile, columns: Mapping[str, Array], labels: Mapping[str, str], uneven_time: bool
) -> tuple[list[str], tuple[int, ...]]:
    problems: list[str] = []
    warnings: list[str] = []
    for name, values in columns.items():
        label = labels.get(name, repr(name))
        wrong = np.flatnonzero(~np.isfinite(values))
        if len(wrong):
            value = values[wrong[0]]
            problems.append(f"{source.place(int(wrong[0]))}, column {label}: {value}{_more(wrong)}")
        elif name != TIME and values.min() == values.max():
            warnings.append(f"column {label} is {values[0]:g} throughout")
    gaps: tuple[int, ...] = ()
    time = columns.get(TIME)
    if time is not None and np.isfinite(time).all():
        later = _later(time)
        kept = np.flatnonzero(later)
        dropped = time.size - kept.size
        if uneven_time and 0 < dropped <= ROUNDED_SHARE * time.size:
            first = source.place(int(np.argmin(later)))
            warnings.append(f"{dropped} rows whose stamp is not later than all before it are dropped, first at {first}")
        else:
            _check_order(source.place, time, problems)
            kept = np.arange(time.size)
        gap_list = warnings if uneven_time else problems
        gaps = _check_gaps(lambda row: source.place(int(kept[row])), time[kept], gap_list)
    if problems:
        raise RecordingError(f"{source.path}: " + "\n  ".join(problems))
    return [f"{source.path}: {warning}" for warning in warnings], gaps


def _later(time: Array) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Rows whose stamp is later than all before it. (n,)"""
    return np.concatenate([[True], time[1:] > np.maximum.accumulate(time)[:-1]])


def _check_order(place: Callable[[int], str], time: Array, problems: list[str]) -> None:
    """Timestamps that decrease or repeat."""
    steps = np.diff(time)
    backwards = np.flatnonzero(steps < 0.0)
    if len(backwards):
        row = int(backwards[0])
        values = f"{time[row]:.9g} s to {time[row + 1]:.9g} s"
        problems.append(f"{place(row + 1)}: time runs backwards, {values}{_more(backwards)}")
    equal = np.flatnonzero(steps == 0.0)
    if len(equal):
        rounded = len(equal) > ROUNDED_SHARE * len(time)
        hint = "; the stamps seem to be rounded: leave the column out and give rate_hz" if rounded else ""
        problems.append(f"{place(int(equal[0]) + 1)}: the stamp of the line before again{_more(equal)}{hint}")


def _check_gaps(place: Callable[[int], str], time: Array, gap_list: list[str]) -> tuple[int, ...]:
    """Rows after gaps."""
    steps = np.diff(time)
    forward = steps[steps > 0.0]
    if not len(forward):
        return ()
    period = float(np.median(forward))
    gaps = np.flatnonzero(steps > GAP_PERIODS * period)
    if len(gaps):
        row = int(gaps[0])
        length = f"{steps[row]:.6g} s ({steps[row] / period:.1f} periods)"
        gap_list.append(f"{place(row + 1)}: a gap in time of {length}{_more(gaps)}")
    return tuple(int(row) + 1 for row in gaps)


def _more(found: np.ndarray[Any, Any]) -> str:
    return f", and {len(found) - 1} more of this kind" if len(found) > 1 else ""

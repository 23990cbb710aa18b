"""Mapping of the columns of a foreign table to signals and units."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from .. import units
from ..documents import did_you_mean
from ..signals import REFERENCE_POSITION, SIGNALS, TEMPERATURE
from .errors import RecordingError

TIME = "time_s"
_FOREIGN = (*SIGNALS, REFERENCE_POSITION, TEMPERATURE)
STATUSWORD = "statusword"  # read where it is declared: other programs may write it in hexadecimal
_NAMED_UNITS = {TIME: "s"} | {signal.name: signal.unit for signal in _FOREIGN if signal.dtype == "<f8"}
SIGNAL_UNITS = _NAMED_UNITS | {STATUSWORD: "-"}

_DEG_PER_REV = 360.0
_FACTORS: dict[str, dict[str, float]] = {  # by unit of the signal: accepted unit -> factor
    "s": {
        "s": 1.0,
        "ms": 1e-3,
        "us": 1e-6,
        "ns": 1.0 / units.NS_PER_S,
        "min": units.S_PER_MIN,
    },
    "rev": {"rev": 1.0, "rad": 1.0 / units.TWO_PI, "deg": 1.0 / _DEG_PER_REV},
    "rps": {
        "rps": 1.0,
        "rev/s": 1.0,
        "rpm": units.rps_from_rpm(1.0),
        "rad/s": 1.0 / units.TWO_PI,
        "deg/s": 1.0 / _DEG_PER_REV,
    },
    "rps2": {"rps2": 1.0, "rev/s2": 1.0, "rad/s2": 1.0 / units.TWO_PI, "deg/s2": 1.0 / _DEG_PER_REV},
    "A": {"A": 1.0, "mA": 1e-3},
    "Nm": {"Nm": 1.0, "mNm": 1e-3},
    "Nm/s": {"Nm/s": 1.0},
    "Nm/rps": {"Nm/rps": 1.0},
    "A2s": {"A2s": 1.0},
    "V": {"V": 1.0, "mV": 1e-3},
    "m": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3},
    "m/s2": {"m/s2": 1.0, "mm/s2": 1e-3},
    "N": {"N": 1.0},
    "N/s": {"N/s": 1.0},
    "N s/m": {"N s/m": 1.0},
    "degC": {"degC": 1.0},
    "-": {"-": 1.0},
}
_ALSO = {"A": ("V",)}  # an amplifier's input in volts takes the place of the current command


@dataclass(frozen=True)
class MappedColumn:
    """`column` of the file, times `scale`, plus `offset`, is `signal` in `unit` (None: the signal's own)."""

    column: str
    signal: str
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class ColumnMap:
    """How to read a table.

    `rate_hz` gives the time if the file has no time column. On a `linear` axis _rev, _rps and _nm stand
    for m, m/s and N. `extra` columns are kept under their own names, unscaled.
    """

    columns: tuple[MappedColumn, ...]
    rate_hz: float | None = None
    linear: bool = False
    extra: tuple[str, ...] = ()


class Conversion(NamedTuple):
    """value = raw * factor + shift, in `unit`."""

    column: str
    factor: float
    shift: float
    unit: str


def identity_map(names: Iterable[str]) -> ColumnMap:
    """The map of a file whose columns are named as the signals are; others are left out."""
    return ColumnMap(tuple(MappedColumn(name, name) for name in dict.fromkeys(names) if name in _NAMED_UNITS))


def conversions(mapping: ColumnMap) -> dict[str, Conversion]:
    """Conversion by signal name. Raises RecordingError with every mistake of the map at once."""
    found: dict[str, Conversion] = {}
    problems: list[str] = []
    for column in mapping.columns:
        if column.signal in found:
            problems.append(f"signal {column.signal!r} is mapped twice")
            continue
        try:
            found[column.signal] = _conversion(column, mapping.linear)
        except RecordingError as error:
            problems.append(str(error))
    if mapping.rate_hz is not None:
        if TIME in found:
            problems.append(f"{TIME} comes from column {found[TIME].column!r} and from rate_hz: leave one out")
        if not (mapping.rate_hz > 0.0 and math.isfinite(mapping.rate_hz)):
            problems.append(f"rate_hz = {mapping.rate_hz}: a positive number is needed")
    problems += [f"extra column {name!r} is mapped already" for name in mapping.extra if name in found]
    if problems:
        raise RecordingError("column map: " + "\n  ".join(problems))
    return found


def _conversion(column: MappedColumn, linear: bool) -> Conversion:
    own = SIGNAL_UNITS.get(column.signal)
    if own is None:
        hint = did_you_mean(column.signal, SIGNAL_UNITS)
        raise RecordingError(f"column {column.column!r}: no signal {column.signal!r}: {hint}")
    own = units.unit_on(own, linear)
    for base in (own, *_ALSO.get(own, ())):
        unit = base if column.unit is None else column.unit
        if unit in _FACTORS[base]:
            factor = _FACTORS[base][unit]
            if not math.isfinite(column.scale) or column.scale == 0.0 or not math.isfinite(column.offset):
                raise RecordingError(f"column {column.column!r}: scale {column.scale}, offset {column.offset}")
            return Conversion(column.column, column.scale * factor, column.offset * factor, base)
    known = [unit for base in (own, *_ALSO.get(own, ())) for unit in _FACTORS[base]]
    axis = "a linear" if linear else "a rotary"
    hint = did_you_mean(str(column.unit), known)
    raise RecordingError(
        f"column {column.column!r}: {column.unit!r} is no unit of {column.signal} on {axis} axis: {hint}"
    )

"""The record of a run as a row: columns with units and meanings, and how rows become bytes of a Parquet file.

What adds up over the runs of an axis is `normal`, `moment`, `energy_nm2`, `rows` and `effective_rows` (`regress`), and
the same of the gap with `gap_` before the name (`backlash`). The
columns named after the parameters are views of them for readers without this program. A history takes the gap from its
view, which is what the sums of that run give.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from .backlash import GAP_REV, GAP_UPPER
from .regress import PARAMETERS, UPPER

SCHEMA_VERSION = 3  # rises when records are to be made anew: 3 has the gap of a damped flank. Older ones are read
FORMAT_KEY = b"fffo_drive_fleet"  # of the files' metadata
HIGHEST_ORDER = 100  # whole orders of the motor angle
ORDERS = np.arange(1.0, HIGHEST_ORDER + 1.0)
BAND_EDGES_HZ = np.geomspace(0.25, 64.0, 25)  # of the residual's spectrum: three bands an octave
SPEED_EDGES_RPS = np.concatenate([[0.0], np.geomspace(0.01, 200.0, 15), [np.inf]])
ANGLE_BINS = 16  # of a motor turn
LOAD_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
ROWS_A_GROUP = 20_000  # of a merged file: readers skip groups by drive and time
COMPRESSION_LEVEL = 3


def _numbers(size: int, kind: pa.DataType | None = None) -> pa.DataType:
    return pa.list_(kind or pa.float32(), size)


def _field(name: str, kind: pa.DataType, unit: str, meaning: str) -> pa.Field:
    return pa.field(name, kind, metadata={"unit": unit, "meaning": meaning})


_F8, _F4, _I4 = pa.float64(), pa.float32(), pa.int32()
_UNIT_OF_ENDING = (
    ("_nm_s2_per_rev", "Nm s2/rev"), ("_nm_per_rps", "Nm/rps"), ("_nm", "Nm"),
)  # fmt: skip


def unit_of(parameter: str) -> str:
    """Unit of a base parameter, by the end of its name."""
    return next(unit for ending, unit in _UNIT_OF_ENDING if parameter.endswith(ending))


RECORD_SCHEMA = pa.schema(
    [
        _field("run", pa.string(), "-", "SHA-256 of the run's file, hex"),
        _field("schema_version", pa.int16(), "-", "of this row"),
        _field("tool", pa.string(), "-", "program that made this row"),
        _field("drive", pa.string(), "-", "serial number, or what was given in its place"),
        _field("model", pa.string(), "-", "type of drive: the population"),
        _field("path", pa.string(), "-", "where the run's file was: path or URL"),
        _field("start", pa.timestamp("us", tz="UTC"), "UTC", "of the run"),
        _field("duration_s", _F8, "s", "of the run"),
        _field("rate_hz", _F8, "Hz", "samples a second"),
        _field("units", pa.string(), "-", "rotary; linear: m for rev, m/s for rps, N for Nm"),
        _field("normal", _numbers(UPPER[0].size, _F8), "-", "X^T X, upper triangle row by row; adds up"),
        _field("moment", _numbers(len(PARAMETERS), _F8), "-", "X^T y; adds up"),
        _field("energy_nm2", _F8, "Nm2", "y^T y, of the torque; adds up"),
        _field("rows", _F8, "-", "rows of sure sliding that the regression has; adds up"),
        _field("effective_rows", _F8, "-", "independent ones among them; adds up"),
        *(_field(name, _F8, unit_of(name), "view: estimate of this run alone; null: not determined")
          for name in PARAMETERS),
        *(_field(f"{name}_sd", _F8, unit_of(name), "view: its standard deviation") for name in PARAMETERS),
        _field("gap_normal", _numbers(GAP_UPPER[0].size, _F8), "-",
               "E^T M E of the grid of gaps (`fleet.backlash`), upper triangle row by row; adds up; 0: not determined"),
        _field("gap_moment", _numbers(GAP_REV.size, _F8), "-", "E^T M y; adds up"),
        _field("gap_energy_nm2", _F8, "Nm2", "y^T M y; adds up"),
        _field("gap_rows", _F8, "-", "rows in motion that this regression has; adds up"),
        _field("gap_effective_rows", _F8, "-", "independent ones among them; adds up"),
        _field("gap_rev", _F8, "rev", "view: backlash at the motor shaft, by this run alone; null: none found"),
        _field("gap_log_sd", _F8, "-", "view: standard deviation of its logarithm"),
        _field("gap_share", _F8, "-", "view: share of the inertia behind it"),
        _field("delay_s", _F8, "s", "command to torque, by this run"),
        _field("torque_rms_nm", _F8, "Nm", "of those rows"),
        _field("rms_nm", _F8, "Nm", "of the residual at those rows"),
        _field("constant_share", _F4, "-", "of the squared residual: what a constant torque explains beside all else"),
        _field("direction_share", _F4, "-", "... viscous friction that differs by direction"),
        _field("gravity_share", _F4, "-", "... gravity at the angle"),
        _field("wave_share", _F4, "-", "... the strongest wave of the angle"),
        _field("wave_order", pa.int16(), "1/rev", "its order; null: none is resolved"),
        _field("order_amplitude_nm", _numbers(HIGHEST_ORDER), "Nm",
               "of the residual at orders 1, 2, ... of the motor angle; NaN: not resolved"),
        _field("band_rms_nm", _numbers(BAND_EDGES_HZ.size - 1), "Nm",
               "of the residual in bands of a third of an octave from 0.25 Hz"),
        _field("speed_share", _numbers(SPEED_EDGES_RPS.size - 1), "-",
               "of the time at speeds from 0, 0.01 rps, then in 14 equal ratios up to 200 rps, and above"),
        _field("speed_rms_rps", _F8, "rps", "of the whole run"),
        _field("acceleration_rms_rps2", _F8, "rps2", "of the whole run, below the filter's cut-off"),
        _field("load_quantile_nm", _numbers(len(LOAD_QUANTILES)), "Nm",
               "of the motor torque's size: 5, 25, 50, 75, 95 %"),
        _field("angle_share", _numbers(ANGLE_BINS), "-", "of the time at each sixteenth of a motor turn"),
        _field("travel_rev", _F8, "rev", "between the ends of the motion"),
        _field("temperature_degc", _F8, "degC", "mean; null where not logged"),
        _field("temperature_low_degc", _F8, "degC", "lowest"),
        _field("temperature_high_degc", _F8, "degC", "highest"),
        _field("ticks", pa.int64(), "-", "of the loop; null: not of this program's loop"),
        _field("late", _I4, "-", "ticks that woke late"),
        _field("skipped", _I4, "-", "ticks that were left out"),
        _field("without_feedback", _I4, "-", "ticks whose feedback did not come in time"),
        _field("trip", _I4, "-", "latched fault at the end: control.envelope.TRIP_*"),
        _field("warnings", _I4, "-", "events of this level in the recording"),
        _field("errors", _I4, "-", "events of this level and above"),
        _field("speed_error_rms_rps", _F8, "rps", "of the control error while torque was on"),
        _field("complete", pa.bool_(), "-", "false: the file is torn, its whole part was taken"),
    ]
)  # fmt: skip
INDEX_SCHEMA = pa.schema(
    [
        _field("run", pa.string(), "-", "SHA-256 of the file, hex"),
        _field("drive", pa.string(), "-", "serial number, or what was given in its place"),
        _field("model", pa.string(), "-", "type of drive"),
        _field("path", pa.string(), "-", "where the file is: absolute path or URL"),
        _field("start", pa.timestamp("us", tz="UTC"), "UTC", "of the run; where the log does not say, of the file"),
        _field("bytes", pa.int64(), "B", "size of the file"),
        _field("stamp", pa.string(), "-", "of the file as it was: unchanged, it is not read again"),
        _field("facts", pa.string(), "-", "declared facts of its drive, JSON; null: the recording carries them"),
        _field("temperature_degc", _F8, "degC", "of the run, as it was added; null: what the log says"),
    ]
)
TEMPERATURES = ("temperature_degc", "temperature_low_degc", "temperature_high_degc")
SORTED_BY = [("model", "ascending"), ("drive", "ascending"), ("start", "ascending"), ("run", "ascending")]


def said_in_index(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of a record that its entry of the index says."""
    said = {name: entry[name] for name in ("drive", "model", "path", "start")}
    degc = entry.get("temperature_degc")
    return said if degc is None else said | dict.fromkeys(TEMPERATURES, degc)


def table_of(rows: Iterable[Mapping[str, Any]], schema: pa.Schema = RECORD_SCHEMA) -> pa.Table:
    """Rows as a table."""
    return pa.Table.from_pylist([dict(row) for row in rows], schema=schema)


def file_bytes(table: pa.Table, small: bool = False) -> bytes:
    """A Parquet file: the same bytes for the same rows. `small`: of one row, where what describes it weighs most."""
    sink = pa.BufferOutputStream()
    described = table.schema.with_metadata({FORMAT_KEY: str(SCHEMA_VERSION).encode()})
    options: dict[str, Any] = {"use_dictionary": False, "compression": "none", "write_statistics": False}
    if small:  # units and meanings stand in the merged files
        described = pa.schema([f.remove_metadata() for f in described], described.metadata)
    else:  # numbers of which hardly two are alike make no dictionary; byte by byte they are smaller and read faster
        split = [f"{f.name}.list.element" if pa.types.is_fixed_size_list(f.type) else f.name
                 for f in described if pa.types.is_floating(getattr(f.type, "value_type", f.type))]  # fmt: skip
        words = [f.name for f in described if pa.types.is_string(f.type) and f.name != "run"]
        options = {"use_dictionary": words, "use_byte_stream_split": split, "compression": "zstd",
                   "compression_level": COMPRESSION_LEVEL}  # fmt: skip
    with pq.ParquetWriter(sink, described, store_schema=not small, **options) as writer:
        writer.write_table(table.cast(described), row_group_size=None if small else ROWS_A_GROUP)
    return bytes(sink.getvalue())

"""Logs that are in memory already: arrays by name, or a frame of pandas or polars."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from ..identification.dataset import Record, record_of_columns
from ..identification.facts import DriveFacts
from .convert import converted, facts_of, usable
from .recognise import Hints, Recognition, recognise
from .source import source_of_arrays


class DataFrameLike(Protocol):
    """What frames of pandas and polars have in common."""

    @property
    def columns(self) -> Any:
        """Names of the columns."""

    def __getitem__(self, name: str) -> Any: ...


def record_of(
    data: Mapping[str, Any] | DataFrameLike, *, name: str = "data", hints: Hints | None = None, **declared: Any
) -> tuple[Record, DriveFacts, Recognition]:
    """A log in memory as `fffo-drive import` takes a file: the record for `identify` and `diagnose`, its facts, and
    what was recognised on what grounds.

    `data`: columns (n,) by name, with units in the names ("speed_rpm", "angle [deg]") or in `hints`. `declared`: keys
    of the facts (`torque_constant_nm_per_a`, `gear_ratio`, ...). Raises RecordingError for what cannot be used.
    """
    names = list(data) if isinstance(data, Mapping) else [str(column) for column in data.columns]
    arrays = {column: _array(data[column]) for column in names}
    source = source_of_arrays(Path(name), arrays)
    found = recognise(source, hints)
    log = usable(name, converted(source, found), found)
    facts = facts_of(found, declared)
    return record_of_columns(name, log.columns, facts, [f"{name}: {remark}" for remark in log.remarks]), facts, found


def _array(column: Any) -> Any:
    return column.to_numpy() if hasattr(column, "to_numpy") else column

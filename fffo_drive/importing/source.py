"""A log as it lies in somebody else's file: columns by name, the units that the file gives, nothing converted yet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..arrays import Floats
from ..recording.errors import RecordingError
from ..recording.files import check_columns
from .units import split_name

if TYPE_CHECKING:
    from ..drive.canopen.config import CanopenDriveConfig

LEAST_ROWS = 2
SHORT = 0.01  # of the longest vector: gains and limits that came with a log, not samples


@dataclass(frozen=True)
class TraceDrive:
    """The drive whose PDOs are in a trace of a CAN bus, as far as the user says."""

    node: str | None = None  # [CHANNEL:]ID
    eds: Path | None = None  # EDS or DCF
    config: CanopenDriveConfig | None = None  # of a profile or an axis file: PDOs, objects, signs
    said: str = ""  # where that is from
    node_of_axis: int | None = None  # as an axis file has it, where several are in the trace
    keys: Mapping[str, Any] = field(default_factory=dict)  # scales of this drive, as in a drive section
    profile_keys: Mapping[str, Any] = field(default_factory=dict)  # likewise, of its family
    profile_named: bool = False  # by the user; else by the vendor's number in the EDS
    torque_constant_nm_per_a: float | None = None
    files: tuple[str, ...] = ()  # as the user names them
    scales: Mapping[str, float] = field(default_factory=dict)  # likewise

    @property
    def for_a_trace(self) -> bool:
        """Whether something is said that no other log needs."""
        return bool(self.node or self.eds or self.config or set(self.keys) - {"counts_per_rev"})


@dataclass(frozen=True)
class Source:
    """Columns (n,) float64, NaN where the file has nothing."""

    path: Path
    columns: dict[str, Floats]
    units: dict[str, str] = field(default_factory=dict)  # as the file writes them
    period_s: float | None = None  # where the file declares it
    scalars: dict[str, float] = field(default_factory=dict)  # single numbers that came with the data
    remarks: tuple[str, ...] = ()  # what became of some rows
    left: Mapping[str, str] = field(default_factory=dict)  # columns that are none of numbers: why
    first_line: int = 0  # of a text in which each line after it is a row; 0: of any other file
    run: int = 0  # of several in one file, from 1; 0: the only one
    roles: dict[str, str] = field(default_factory=dict)  # signal -> column, where the file itself says which is which
    doubts: dict[str, str] = field(default_factory=dict)  # column -> why its scale is an assumption
    joints: dict[str, dict[str, str]] = field(default_factory=dict)  # joint -> its columns -> their names without it
    joint: str = ""  # that was chosen
    of_dataset: bool = False  # one of many that have one meaning

    @property
    def rows(self) -> int:
        """Number of samples."""
        return next(iter(self.columns.values())).size

    @property
    def said(self) -> str:
        """The file, with the run where it holds several."""
        joint = f", {self.joint}" if self.joint else ""
        return f"{self.path}{joint}, run {self.run}" if self.run else f"{self.path}{joint}"

    def place(self, row: int) -> str:
        """Where a row (from 0) stands, in words."""
        return f"line {self.first_line + row}" if self.first_line else f"row {row + 1}"

    def part(self, rows: slice, run: int) -> Source:
        """Some of the rows, as a run."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        return replace(self, columns=columns, run=run, first_line=self.first_line and self.first_line + rows.start)


def _with_nothing(objects: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Numbers and nothing (null) as numbers and NaN; objects of any other kind as they are."""
    given = [one for one in objects.ravel() if one is not None]
    if not given or not all(isinstance(one, bool | int | float | np.number) for one in given):
        return objects
    return np.array([np.nan if one is None else float(one) for one in objects.ravel()]).reshape(objects.shape)


def source_of_arrays(
    path: Path, arrays: Mapping[str, Any], remarks: tuple[str, ...] = (), period_s: float | None = None
) -> Source:
    """A source of named arrays: vectors, matrices (a column each), single numbers; text is left out and named.

    Vectors of another length than most are left out and named. Raises RecordingError where no vector is left.
    """
    vectors: dict[str, Floats] = {}
    scalars: dict[str, float] = {}
    left: dict[str, str] = {}
    for name, value in arrays.items():
        array = np.asarray(value)
        if array.dtype.kind == "O":
            array = _with_nothing(array)
        if array.dtype.kind == "M" and array.size:  # a date: seconds since the first
            array = (array - np.fmin.reduce(array, axis=None)) / np.timedelta64(1, "s")  # NaT is none of them
        elif array.dtype.kind == "m":
            array = array / np.timedelta64(1, "s")
        if array.dtype.kind not in "biuf":
            left[name] = "holds no numbers"
        elif array.size == 1:
            scalars[name] = float(array.reshape(()))
        elif array.ndim == 2 and min(array.shape) > 1:
            array = array if array.shape[0] >= array.shape[1] else array.T
            check_columns(path, array.shape[1], f", {name!r}")
            vectors |= {f"{name}_{k + 1}": column.astype(np.float64) for k, column in enumerate(array.T)}
        elif max(array.shape, default=0) == array.size:
            vectors[name] = array.ravel().astype(np.float64)
        else:
            left[name] = f"has shape {array.shape}"
    check_columns(path, len(vectors))
    sizes = [column.size for column in vectors.values() if column.size >= LEAST_ROWS]
    if not sizes:
        told = "; ".join(f"{name!r} {why}" for name, why in left.items())
        raise RecordingError(f"{path}: no column of numbers in it" + (f": {told}" if told else ""))
    sizes = [size for size in sizes if size > SHORT * max(sizes)]
    usual = max(set(sizes), key=lambda size: (sizes.count(size), size))
    left |= {name: f"has {v.size} samples, the others {usual}" for name, v in vectors.items() if v.size != usual}
    kept = {name: np.ascontiguousarray(column) for name, column in vectors.items() if column.size == usual}
    units = {name: unit for name in kept if (unit := split_name(name)[1])}
    return Source(path, kept, units, period_s, scalars, remarks, left)

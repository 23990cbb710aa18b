"""Columns of a MATLAB file (v4 to v7.2, by scipy)."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..documents import did_you_mean
from .errors import RecordingError
from .mat_elements import unpacked

Array = np.ndarray[Any, np.dtype[np.float64]]


class MatFile:
    """Vectors and scalars of a MAT file. A field of a struct has the name `struct.field`."""

    def __init__(self, path: Path) -> None:
        from scipy.io import loadmat  # slow to import, and rarely needed

        self.path = path
        data = io.BytesIO(unpacked(path))
        try:
            content = loadmat(data, squeeze_me=True)  # type: ignore[arg-type]  # stubs know paths only
        except NotImplementedError as error:
            raise RecordingError(f"{path}: a MAT file of version 7.3; save it with '-v7' in MATLAB") from error
        except Exception as error:  # scipy raises whatever the bytes lead it to
            raise RecordingError(f"{path}: not a readable MAT file: it is damaged, or of another kind") from error
        self._values: dict[str, Any] = {}
        for name, value in content.items():
            if not name.startswith("__"):
                self._collect(name, value)

    def _collect(self, name: str, value: Any) -> None:
        if isinstance(value, np.ndarray) and value.dtype.names and value.ndim == 0:
            for field in value.dtype.names:
                self._collect(f"{name}.{field}", value[field][()])
        else:
            self._values[name] = np.asarray(value)

    @property
    def names(self) -> list[str]:
        """Everything that is a vector of numbers."""
        return [name for name, value in self._values.items() if value.ndim == 1 and value.dtype.kind in "biuf"]

    @property
    def scalars(self) -> dict[str, float]:
        """Single numbers: gains and constants that came with the data."""
        return {
            name: float(value) for name, value in self._values.items() if value.ndim == 0 and value.dtype.kind in "biuf"
        }

    @property
    def warnings(self) -> tuple[str, ...]:
        """A MAT file is whole, or it is not read."""
        return ()

    def columns(self, wanted: Sequence[str]) -> dict[str, Array]:
        """The vectors of these names, float64, all of one length."""
        found = {}
        for name in wanted:
            if name not in self._values:
                raise RecordingError(f"{self.path}: no variable {name!r}: {did_you_mean(name, self.names)}")
            if name not in self.names:
                value = self._values[name]
                raise RecordingError(
                    f"{self.path}: variable {name!r} has shape {value.shape} and type {value.dtype}: "
                    "a vector of real numbers is needed"
                )
            found[name] = np.ascontiguousarray(self._values[name], np.float64)
        lengths = {name: len(column) for name, column in found.items()}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise RecordingError(f"{self.path}: vectors of unequal length: {listed}")
        return found

    def place(self, row: int) -> str:
        """Where row `row` (from 0) stands: MATLAB counts from 1."""
        return f"sample {row + 1}"

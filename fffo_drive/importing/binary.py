"""MATLAB, NumPy, Parquet and JSON files as sources; each by the library that is kept for it."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..recording.errors import RecordingError
from ..recording.files import check_columns, text_bytes
from ..recording.mat_elements import unpacked
from ..recording.unpack import Allowance
from .joints import declared_names, with_joints
from .source import Source, source_of_arrays

LARGEST_ARRAYS_BYTES = 1 << 32  # of a log as numbers, unpacked
ZIP_MAGIC = b"PK\x03\x04"
LONGEST_LIST = 512  # numbers a row: a picture is no log of an axis
DEEPEST = 8  # of structures within structures
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
MAT_BLOCK_BYTES = 512  # in front of the HDF5 of MATLAB


def read_mat(path: Path) -> Source:
    """A MAT file: vectors, matrices (a column each) and structs of them; v7.3 by h5py, all others by scipy."""
    from scipy.io import loadmat  # slow to import

    if _is_hdf5(path):
        return _read_mat_73(path)
    found: dict[str, Any] = {}
    remarks: list[str] = []
    try:
        content = loadmat(io.BytesIO(unpacked(path)), simplify_cells=True)  # type: ignore[arg-type]  # stubs know paths
    except RecordingError:
        raise
    except Exception as error:  # scipy raises whatever the bytes lead it to
        raise RecordingError(f"{path}: not a readable MAT file: it is damaged, or of another kind") from error
    for name, value in content.items():
        if name.startswith("__") or type(value).__name__ == "MatlabOpaque":
            if not name.startswith("__"):
                remarks.append(_object_remark(name))
            continue
        _flatten(name, value, found)
    if not found and remarks:
        raise RecordingError(f"{path}: {remarks[0]}")
    return with_joints(source_of_arrays(path, found, tuple(remarks)))


def _is_hdf5(path: Path) -> bool:
    """Whether a MAT file is of version 7.3: HDF5 behind a block of its own."""
    with path.open("rb") as file:
        begin = file.read(MAT_BLOCK_BYTES + len(HDF5_MAGIC))
    return HDF5_MAGIC in (begin[: len(HDF5_MAGIC)], begin[MAT_BLOCK_BYTES:])


def _object_remark(name: str) -> str:
    return (
        f"left out: {name or 'a variable'!r} is an object of MATLAB (a timetable, table or timeseries), which no other "
        "program can read; in MATLAB: T = timetable2table(X); S = table2struct(T, 'ToScalar', true); save S"
    )


def _read_mat_73(path: Path) -> Source:
    import h5py

    found: dict[str, Any] = {}
    remarks: list[str] = []
    allowance = Allowance(path, path.stat().st_size, LARGEST_ARRAYS_BYTES)
    try:
        with h5py.File(path, "r") as file:

            def take(name: str, item: Any) -> None:
                if name.startswith("#"):  # what objects and cells refer to
                    return
                kind = item.attrs.get("MATLAB_class", b"")
                if "MATLAB_object_decode" in item.attrs:
                    remarks.append(_object_remark(name))
                elif isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf" and kind not in (b"char", b"cell"):
                    allowance.take(item.nbytes)
                    found[name.replace("/", ".")] = np.asarray(item[()])

            file.visititems(take)
    except OSError as error:
        raise RecordingError(f"{path}: not a readable MAT file: {error}") from error
    if not found and remarks:
        raise RecordingError(f"{path}: {remarks[0]}")
    return with_joints(source_of_arrays(path, found, tuple(remarks)))


def read_npz(path: Path) -> Source:
    """Arrays of an NPZ or NPY file; fields of a structured array, columns of a matrix."""
    try:
        data = path.read_bytes()
        if data.startswith(ZIP_MAGIC):
            allowance = Allowance(path, len(data), LARGEST_ARRAYS_BYTES)
            with zipfile.ZipFile(io.BytesIO(data)) as packed:
                for member in packed.infolist():
                    allowance.take(member.file_size)
        content = np.load(io.BytesIO(data), allow_pickle=False)
        arrays = (
            {path.stem: content} if isinstance(content, np.ndarray) else {name: content[name] for name in content.files}
        )
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise RecordingError(f"{path}: not a readable NumPy file: {error}") from error
    found: dict[str, Any] = {}
    for name, array in arrays.items():
        if array.dtype.names:
            found |= {field: array[field] for field in array.dtype.names}
        else:
            found[name] = array
    return with_joints(source_of_arrays(path, found))


def read_parquet(path: Path) -> Source:
    """Columns of numbers of a Parquet or Feather file, and lists of numbers: a column each, `name[k]`."""
    import pyarrow
    from pyarrow import feather, parquet

    try:
        if path.suffix.lower() in (".parquet", ".pq"):
            inside = parquet.read_metadata(path)
            check_columns(path, inside.num_columns)
            _check_size(path, inside.num_rows * inside.num_columns * np.float64().nbytes)
            schema = parquet.read_schema(path)
            read = [name for name in schema.names if not _holds_no_numbers(schema.field(name).type)]
            table = parquet.read_table(path, columns=read)
        else:
            table = feather.read_table(path)
            schema = table.schema
            read = [name for name in schema.names if not _holds_no_numbers(schema.field(name).type)]
    except (pyarrow.ArrowInvalid, OSError) as error:
        raise RecordingError(f"{path}: not a readable Parquet or Feather file: {error}") from error
    columns: dict[str, Any] = {}
    left = {name: "holds no numbers" for name in schema.names if name not in read}
    for name in read:
        column = table.column(name)
        if not _is_list(column.type):
            columns[name] = column.to_numpy()
            continue
        matrix = _matrix(column)
        if matrix is None:
            left[name] = "holds lists of unequal or great length"
        else:
            columns |= {f"{name}[{k}]" if matrix.shape[1] > 1 else name: values for k, values in enumerate(matrix.T)}
    names, period_s = declared_names(path)
    source = source_of_arrays(path, columns, period_s=period_s)
    return with_joints(replace(source, left={**left, **source.left}), names)


def _is_list(kind: Any) -> bool:
    from pyarrow import types

    return bool(types.is_list(kind) or types.is_fixed_size_list(kind) or types.is_large_list(kind))


def _holds_no_numbers(kind: Any) -> bool:
    """Of a nested type, and of bytes: pictures."""
    from pyarrow import types

    plain = kind.value_type if _is_list(kind) else kind
    if plain is not kind and not (types.is_integer(plain) or types.is_floating(plain) or types.is_boolean(plain)):
        return True
    return bool(types.is_nested(plain) or types.is_binary(plain) or types.is_large_binary(plain))


def _matrix(column: Any) -> Any:
    """Lists of one length as numbers (rows, length), NaN where there is none; None for lists of several lengths."""
    from pyarrow import compute

    whole = column.combine_chunks()
    given = whole.is_valid().to_numpy(zero_copy_only=False)
    lengths = compute.unique(compute.list_value_length(whole.filter(whole.is_valid()))).to_pylist()
    if len(lengths) != 1 or not 0 < lengths[0] <= LONGEST_LIST:
        return None
    found = np.full((given.size, lengths[0]), np.nan)
    found[given] = compute.list_flatten(whole).to_numpy(zero_copy_only=False).reshape(-1, lengths[0])
    return found


def _check_size(path: Path, size_bytes: int) -> None:
    """Raises RecordingError for numbers that no memory holds."""
    Allowance(path, size_bytes, LARGEST_ARRAYS_BYTES).take(size_bytes)


def read_json(path: Path) -> Source:
    """Records (a list of objects), or lists by name, at the top or one level below; single numbers beside them."""
    try:
        content = json.loads(text_bytes(path))
    except ValueError as error:
        raise RecordingError(f"{path}: not readable as JSON: {error}") from error
    except RecursionError:
        raise RecordingError(f"{path}: not readable as JSON: nested too deeply") from None
    found: dict[str, Any] = {}
    if isinstance(content, dict):
        for name, value in content.items():
            if _are_records(value):
                found |= _of_records(path, value)
            else:
                _flatten(name, value, found)
    elif _are_records(content):
        found = _of_records(path, content)
    else:
        raise RecordingError(
            f"{path}: a list of objects, or an object of lists is needed; it holds {type(content).__name__}"
        )
    return with_joints(source_of_arrays(path, found))


def _are_records(value: Any) -> bool:
    return isinstance(value, list) and len(value) > 1 and all(isinstance(row, dict) for row in value)


def _of_records(path: Path, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Columns of records, NaN where one has not the key; text is left to the caller to refuse."""
    flat: list[dict[str, Any]] = []
    for row in rows:
        own: dict[str, Any] = {}
        _flatten("", row, own)
        for name in [name for name, value in own.items() if value.ndim == 1 and value.dtype.kind in "biuf"]:
            if own[name].size <= LONGEST_LIST:
                own |= {f"{name}[{k}]": number for k, number in enumerate(own.pop(name))}
        check_columns(path, len(own), f", record {len(flat) + 1}")
        flat.append(own)
    names = dict.fromkeys(name for row in flat for name in row)
    found: dict[str, Any] = {}
    for name in names:
        values = [row.get(name) for row in flat]
        given = [v for v in values if v is not None and v.dtype != object]
        plain = bool(given) and all(v.ndim == 0 and v.dtype.kind in "biuf" for v in given)
        found[name] = (
            np.array([np.nan if v is None or v.dtype == object else float(v) for v in values])
            if plain
            else np.array(["text"] * len(values))
        )
    return found


def _flatten(name: str, value: Any, found: dict[str, Any], depth: int = 0) -> None:
    """Structures within structures, by names with dots."""
    if isinstance(value, Mapping) and depth < DEEPEST:
        for key, inner in value.items():
            _flatten(f"{name}.{key}" if name else str(key), inner, found, depth + 1)
        return
    try:
        found[name] = np.asarray(value)
    except ValueError:
        found[name] = np.array("rows of unequal length")

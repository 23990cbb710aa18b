"""A file of any kind as a source, by its first bytes and its name."""

from __future__ import annotations

import re
from pathlib import Path

from ..extras import needs_extra
from ..recording.errors import RecordingError
from ..recording.files import regular
from .source import Source

MCAP_MAGIC = b"\x89MCAP0\r\n"
PARQUET_MAGIC = b"PAR1"
FEATHER_MAGIC = b"ARROW1"
NPY_MAGIC = b"\x93NUMPY"
MATLAB_MAGIC = b"MATLAB"
OTHERS = {b"%PDF": "a PDF", b"\x89PNG": "a picture", b"\xd0\xcf\x11\xe0": "a workbook of Excel (XLS)"}

BEGIN_BYTES = 1024
TRACES = {  # a line of each, which no table of numbers has
    "candump": re.compile(r"\s*(\(\d+\.\d+\)\s+)?\w+\s+[0-9A-Fa-f]{3,8}(#|\s+\[\d+\]\s)"),
    "PCAN-View, TRC": re.compile(r";\$FILEVERSION="),
    "Vector ASC": re.compile(r"base (hex|dec)\s+timestamps\b", re.IGNORECASE),
    "python-can CSV": re.compile(r"timestamp,arbitration_id,", re.IGNORECASE),
}


def read_source(path: Path | str) -> Source:
    """Read one file. Raises RecordingError for what cannot be used, OSError for what cannot be opened."""
    path = Path(path)
    with regular(path).open("rb") as file:
        begin = file.read(BEGIN_BYTES)
    if not begin:
        raise RecordingError(f"{path}: the file is empty")
    try:
        return _read(path, begin)
    except ImportError as error:
        raise RecordingError(f"{path}: {error}: {needs_extra('reading it', 'import')}") from error
    except MemoryError as error:
        raise RecordingError(f"{path}: too large for the memory of this machine") from error


def trace_kind(begin: bytes) -> str | None:
    """The program or format of a trace of a CAN bus, by its first bytes; None for any other file."""
    if begin.startswith(b"LOGG"):
        return "BLF"
    if not begin or b"\0" in begin:
        return None
    lines = begin.decode("latin-1").splitlines()
    return next((kind for kind, shape in TRACES.items() if any(shape.match(line) for line in lines)), None)


def _read(path: Path, begin: bytes) -> Source:
    from . import binary

    suffix = path.suffix.lower()
    if begin.startswith(MCAP_MAGIC):
        from .foreign_mcap import read_foreign_mcap

        return read_foreign_mcap(path)
    if begin.startswith((MATLAB_MAGIC, binary.HDF5_MAGIC)) or suffix == ".mat":
        return binary.read_mat(path)
    if begin.startswith((PARQUET_MAGIC, FEATHER_MAGIC)) or suffix in (".parquet", ".pq", ".feather"):
        return binary.read_parquet(path)
    if begin.startswith(NPY_MAGIC) or suffix in (".npz", ".npy"):
        return binary.read_npz(path)
    if begin.startswith(binary.ZIP_MAGIC):
        raise RecordingError(f"{path}: a ZIP archive or a workbook of Excel: unpack it, or save the sheet as CSV")
    for magic, kind in OTHERS.items():
        if begin.startswith(magic):
            raise RecordingError(f"{path}: {kind}, no log")
    if (trace := trace_kind(begin)) is not None:
        raise RecordingError(
            f"{path}: a trace of a CAN bus ({trace}): its frames hold the drive's values as bytes, and only the "
            "mapping of the PDOs says what they mean. Decode it first: python-can reads it (can.LogReader), canopen "
            "decodes the frames with the EDS of the drive (node.tpdo); import the values as CSV, a row for each SYNC"
        )
    if suffix == ".json" or begin.lstrip()[:1] in (b"{", b"["):
        return binary.read_json(path)
    from .text import read_text

    return read_text(path)

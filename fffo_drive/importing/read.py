"""A file of any kind as a source, by its first bytes and its name."""

from __future__ import annotations

import contextlib
import zlib
from pathlib import Path

from ..extras import needs_extra
from ..recording.errors import RecordingError
from ..recording.files import regular
from ..recording.unpack import GZIP, GZIP_WINDOW_BITS
from .can_frames import trace_kind
from .source import Source, TraceDrive

MCAP_MAGIC = b"\x89MCAP0\r\n"
PARQUET_MAGIC = b"PAR1"
FEATHER_MAGIC = b"ARROW1"
NPY_MAGIC = b"\x93NUMPY"
MATLAB_MAGIC = b"MATLAB"
OTHERS = {b"%PDF": "a PDF", b"\x89PNG": "a picture", b"\xd0\xcf\x11\xe0": "a workbook of Excel (XLS)"}

BEGIN_BYTES = 1024


TEXT_SUFFIXES = tuple(kind + packed for kind in (".csv", ".txt", ".tsv") for packed in ("", ".gz"))
SUFFIXES = (*TEXT_SUFFIXES, ".mat")  # of tables that are looked for in a directory
RECORDINGS = (".mcap", ".mcap.part")
ALL_SUFFIXES = (
    *RECORDINGS,
    *SUFFIXES,
    ".json",
    ".npz",
    ".npy",
    ".parquet",
    ".pq",
    ".feather",
    ".log",
    ".dat",
    ".asc",
    ".trc",
    ".blf",
)


def short_name(path: Path) -> str:
    """The file's name without what says of which kind it is."""
    suffix = max((s for s in ALL_SUFFIXES if path.name.lower().endswith(s)), key=len, default="")
    return path.name[: len(path.name) - len(suffix)]


def read_source(path: Path | str, drive: TraceDrive | None = None, rows: bool = True) -> Source:
    """Read one file; without its `rows` where the names of its columns are wanted, and a text gives them in advance.

    `drive`: whose PDOs a trace of a CAN bus holds.

    Raises RecordingError for what cannot be used, OSError for what cannot be opened.
    """
    path = Path(path)
    with regular(path).open("rb") as file:
        begin = file.read(BEGIN_BYTES)
    if begin.startswith(GZIP):
        with contextlib.suppress(zlib.error):  # what reads it then says so
            begin = zlib.decompressobj(GZIP_WINDOW_BITS).decompress(begin, BEGIN_BYTES) or begin
    if not begin:
        raise RecordingError(f"{path}: the file is empty")
    try:
        return _read(path, begin, drive, rows)
    except ImportError as error:
        raise RecordingError(f"{path}: {error}: {needs_extra('reading it', 'import')}") from error
    except MemoryError as error:
        raise RecordingError(f"{path}: too large for the memory of this machine") from error


def _read(path: Path, begin: bytes, drive: TraceDrive | None, rows: bool) -> Source:
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
        from .can_trace import read_trace

        return read_trace(path, trace, drive)
    if drive is not None and drive.for_a_trace:
        raise RecordingError(f"{path}: no trace of a CAN bus: --eds, --node and the scales of a drive are for one")
    if suffix == ".json" or begin.lstrip()[:1] in (b"{", b"["):
        return binary.read_json(path)
    from .text import read_text

    return read_text(path, rows)

"""Rows of recordings as CSV or Parquet, block by block in constant memory, for programs that read no MCAP."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..documents import did_you_mean
from ..extras import needs_extra
from ..units import NS_PER_S
from .errors import RecordingError
from .events import Event
from .reader import RowBlock, RowBlocks, Window, groups

TIME = "time_s"  # since the first row of the first file
AROUND_S = 1.0  # on each side of an event
FORMATS = (".csv", ".parquet")


class Exported(NamedTuple):
    """What was written."""

    path: Path
    rows: int
    columns: tuple[str, ...]  # without `time_s`, which is always the first
    incomplete: tuple[str, ...]  # why files were read in part


class _Part(NamedTuple):
    """One file, without its rows."""

    path: Path
    rows: int
    begin_ns: int  # log time of the first
    columns: tuple[str, ...]
    events: tuple[Event, ...]


def export(
    paths: Sequence[Path],
    out: Path,
    columns: Sequence[str] = (),
    window: Window | None = None,
    told: Callable[[float], object] = lambda share: None,
) -> Exported:
    """Write the rows of recordings that follow each other; `columns`: those alone, else all. The window's times count
    from the first row of the first file.

    Raises RecordingError for what cannot be read, has other columns or is not named for a format; OSError, and
    FileExistsError where `out` is taken.
    """
    if out.suffix.lower() not in FORMATS:
        raise RecordingError(f"{out}: name it for its format: {' or '.join(FORMATS)}")
    window = window or Window()
    parts = [_part(path) for path in paths]
    begin_ns, names = parts[0].begin_ns, tuple(columns) or parts[0].columns
    for part in parts:
        for name in names:
            if name not in part.columns:
                raise RecordingError(f"{part.path}: no column {name!r}: {did_you_mean(name, part.columns)}")
        if part.begin_ns < begin_ns:
            raise RecordingError(f"{part.path} begins before {parts[0].path}: name the files in their order in time")
    expected = sum(part.rows for part in parts)
    rows, incomplete = 0, list[str]()
    with _writer(out) as write:
        for part in parts:
            later_s = (part.begin_ns - begin_ns) / NS_PER_S
            blocks = RowBlocks(part.path, window=Window(window.from_s - later_s, window.to_s - later_s))
            for block in groups(blocks):  # each a row group of Parquet, with statistics of every column in the footer
                write(_columns(block, names, begin_ns))
                rows += len(block.rows)
                told(rows / expected)
            incomplete += [blocks.rest.reason] * (not blocks.rest.complete)
    if not rows:
        out.unlink()
        raise RecordingError(f"{out}: not written: no row lies from {window.from_s:g} s to {window.to_s:g} s")
    return Exported(out, rows, names, tuple(incomplete))


def around(path: Path, text: str, margin_s: float = AROUND_S) -> tuple[Window, Event]:
    """The window around the first event of a recording that says a text (a fault, a trip's name), and the event.

    Raises RecordingError where no event does.
    """
    part = _part(path)
    for event in part.events:
        if text.casefold() in f"{event.source}: {event.text}".casefold():
            at_s = (event.time_ns - part.begin_ns) / NS_PER_S
            return Window(at_s - margin_s, at_s + margin_s), event
    said = "\n".join(f"  {event.time} {event.source}: {event.text}" for event in part.events)
    raise RecordingError(
        f"{path}: no event says {text!r}" + (f"; there are:\n{said}" if said else ", and there is none")
    )


def _part(path: Path) -> _Part:
    blocks = RowBlocks(path)
    first: RowBlock | None = None
    for block in blocks.ends():
        first = first or block
    if first is None:
        raise RecordingError(f"{path}: no row is in it")
    names = first.rows.dtype.names or ()
    return _Part(path, blocks.count, int(first.log_time_ns[0]), names, blocks.rest.events)


def _columns(block: RowBlock, names: Sequence[str], begin_ns: int) -> dict[str, Any]:
    time_s = (block.log_time_ns - begin_ns) / NS_PER_S
    return {TIME: time_s, **{name: np.ascontiguousarray(block.rows[name]) for name in names}}


@contextlib.contextmanager
def _writer(out: Path) -> Iterator[Callable[[dict[str, Any]], None]]:
    """Writes tables of columns (n,) each to a new file, which is removed where an error ends it."""
    try:
        import pyarrow
        from pyarrow import csv, parquet
    except ImportError as error:
        raise RecordingError(needs_extra("`log export`", "import")) from error
    kind: Any = csv.CSVWriter if out.suffix.lower() == ".csv" else parquet.ParquetWriter
    writer: Any = None

    def write(columns: dict[str, Any]) -> None:
        nonlocal writer
        table = pyarrow.table(columns)
        writer = writer or kind(file, table.schema)
        writer.write_table(table)

    with out.open("xb") as file:
        try:
            yield write
            if writer is not None:
                writer.close()
        except BaseException:
            out.unlink()
            raise

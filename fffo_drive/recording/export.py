"""Rows of recordings as CSV or Parquet for programs that read no MCAP, or a part of them as a recording of its own.

Block by block, in constant memory.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..documents import did_you_mean
from ..extras import needs_extra
from ..signals import ROW
from ..units import NS_PER_S
from .errors import RecordingError
from .events import Event
from .reader import RowBlock, RowBlocks, Run, TimeWindow, groups
from .rotation import CONTINUES
from .writer import RunWriter

TIME = "time_s"  # since the first row of the first file
AROUND_S = 1.0  # on each side of an event
RECORDING = ".mcap"
PART_OF = "part_of"  # in the metadata of a recording that is a part of another: of which, and from when to when
FORMATS = (".csv", ".parquet", RECORDING)


class Exported(NamedTuple):
    """What was written."""

    path: Path
    rows: int
    columns: tuple[str, ...]  # without `time_s`, which is always the first
    incomplete: tuple[str, ...]  # why files were read in part


class _Part(NamedTuple):
    """One file, without its rows."""

    run: Run
    rows: int
    begin_ns: int  # log time of the first
    offset_ns: int  # of log times from deadlines

    @property
    def columns(self) -> tuple[str, ...]:
        return self.run.rows.dtype.names or ()


def export(
    paths: Sequence[Path],
    out: Path,
    columns: Sequence[str] = (),
    window: TimeWindow | None = None,
    told: Callable[[float], object] = lambda share: None,
) -> Exported:
    """Write the rows of recordings that follow each other; `columns`: those alone, else all. The window's times count
    from the first row of the first file. A recording keeps what stands beside the rows, and the events in the window.

    Raises RecordingError for what cannot be read, has other columns or is not named for a format; OSError, and
    FileExistsError where `out` is taken.
    """
    if out.suffix.lower() not in FORMATS:
        raise RecordingError(f"{out}: name it for its format: {' or '.join(FORMATS)}")
    window = window or TimeWindow()
    parts = [_part(path) for path in paths]
    begin_ns, names = parts[0].begin_ns, tuple(columns) or parts[0].columns
    for part in parts:
        for name in names:
            if name not in part.columns:
                raise RecordingError(f"{part.run.path}: no column {name!r}: {did_you_mean(name, part.columns)}")
        if part.begin_ns < begin_ns:
            raise RecordingError(
                f"{part.run.path} begins before {parts[0].run.path}: name the files in their order in time"
            )
    expected = sum(part.rows for part in parts)
    rows, incomplete = 0, list[str]()
    if out.suffix.lower() == RECORDING and columns:
        raise RecordingError(f"{out}: a recording has all columns: give none, or name it for another format")
    with _recording(out, parts, window) if out.suffix.lower() == RECORDING else _table(out, names, begin_ns) as write:
        for part in parts:
            later_s = (part.begin_ns - begin_ns) / NS_PER_S
            blocks = RowBlocks(part.run.path, window=TimeWindow(window.from_s - later_s, window.to_s - later_s))
            for block in groups(blocks):  # each a row group of Parquet, with statistics of every column in the footer
                write(block)
                rows += len(block.rows)
                told(rows / expected)
            incomplete += [blocks.rest.reason] * (not blocks.rest.complete)
        if not rows:
            raise RecordingError(f"{out}: not written: no row lies from {window.from_s:g} s to {window.to_s:g} s")
    return Exported(out, rows, names, tuple(incomplete))


def around(path: Path, text: str, margin_s: float = AROUND_S) -> tuple[TimeWindow, Event]:
    """The window around the first event of a recording that contains a text (a fault, a trip's name), and the event.

    Raises RecordingError where none does.
    """
    part = _part(path)
    for event in part.run.events:
        if text.casefold() in f"{event.source}: {event.text}".casefold():
            at_s = (event.time_ns - part.begin_ns) / NS_PER_S
            return TimeWindow(at_s - margin_s, at_s + margin_s), event
    said = "\n".join(f"  {event.time} {event.source}: {event.text}" for event in part.run.events)
    raise RecordingError(
        f"{path}: no event contains {text!r}" + (f"; there are:\n{said}" if said else ", and there is none")
    )


def _part(path: Path) -> _Part:
    blocks = RowBlocks(path)
    first: RowBlock | None = None
    for block in blocks.ends():
        first = first or block
    if first is None:
        raise RecordingError(f"{path}: no row is in it")
    begin_ns = int(first.log_time_ns[0])
    return _Part(blocks.rest, blocks.count, begin_ns, begin_ns - int(first.stamps_ns[0]))


@contextlib.contextmanager
def _table(out: Path, names: Sequence[str], begin_ns: int) -> Iterator[Callable[[RowBlock], None]]:
    """Writes columns of blocks to a new file, which is removed where an error ends it."""
    try:
        import pyarrow
        from pyarrow import csv, parquet
    except ImportError as error:
        raise RecordingError(needs_extra("`log export`", "import")) from error
    kind: Any = csv.CSVWriter if out.suffix.lower() == ".csv" else parquet.ParquetWriter
    writer: Any = None

    def write(block: RowBlock) -> None:
        nonlocal writer
        time_s = (block.log_time_ns - begin_ns) / NS_PER_S
        table = pyarrow.table({TIME: time_s, **{name: np.ascontiguousarray(block.rows[name]) for name in names}})
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


@contextlib.contextmanager
def _recording(out: Path, parts: Sequence[_Part], window: TimeWindow) -> Iterator[Callable[[RowBlock], None]]:
    """Writes blocks to a new recording, with what stands beside the rows of the first file."""
    runs = [part.run for part in parts]
    offsets_ns = {part.offset_ns for part in parts}
    if len(offsets_ns) > 1 or any(run.rows.dtype != ROW for run in runs):
        raise RecordingError(
            f"{out}: only recordings of one run, by this version, become one recording; write a table (.csv, .parquet)"
        )
    names = ", ".join(run.path.name for run in runs)
    cut = {PART_OF: f"{names}, from {window.from_s:g} s to {window.to_s:g} s"}
    metadata = {key: value for key, value in runs[0].metadata.items() if key != CONTINUES}
    attachments = [(one.name, one.media_type, one.data) for one in runs[0].attachments.values()]
    writer = RunWriter(out, {**metadata, **cut}, attachments, *offsets_ns)
    try:
        for record in {record.sequence: record for run in runs for record in run.records}.values():
            writer.write_record(record, parts[0].begin_ns)
        yield lambda block: writer.write_rows(block.rows)
        for event in (event for run in runs for event in run.events):
            if window.from_s <= (event.time_ns - parts[0].begin_ns) / NS_PER_S < window.to_s:
                writer.write_event(event)
        writer.close()
    except BaseException:
        writer.abandon()
        writer.part_path.unlink(missing_ok=True)
        raise

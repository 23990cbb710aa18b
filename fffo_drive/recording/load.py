"""Any log by its name: a recording of this program, or a table from another."""

from __future__ import annotations

from pathlib import Path

from .column_map import ColumnMap
from .errors import RecordingError
from .reader import Run, read_run
from .table import LogTable, read_table


def read_log(path: Path | str, mapping: ColumnMap | None = None) -> Run | LogTable:
    """MCAP (or .part) by `read_run`, the rest by `read_table`; both have `columns`, `units`, `column(name)`.

    Raises RecordingError for files that cannot be used, OSError for files that cannot be opened.
    """
    name = Path(path).name
    if name.endswith((".mcap", ".mcap.part")):
        if mapping is not None:
            raise RecordingError(f"{path}: a recording names its own columns and units; leave the column map out")
        return read_run(path)
    return read_table(path, mapping)

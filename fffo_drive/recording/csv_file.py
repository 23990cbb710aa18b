"""Columns of a CSV file, plain or gzip. NumPy's own parser (3 million numbers a second) does the work.

Its error messages say little; if it fails, the file is parsed again, slowly, to name line and column.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..documents import did_you_mean
from .errors import RecordingError
from .files import table_text

Array = np.ndarray[Any, np.dtype[np.float64]]

_DELIMITERS = ",;\t"
_COMMENTS = ("#", "%")


class CsvFile:
    """A table of text: one line of names, then numbers, separated by comma, semicolon, tab or blanks.

    Lines before the names that begin with # or % are comments; a commented line of names (`numpy.savetxt`)
    counts, too.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        text = table_text(path)
        header, position, self._first_line = _find_header(text, path)
        self._delimiter = _delimiter(header)
        self.names = [cell.strip().strip("\"'").strip() for cell in header.split(self._delimiter)]
        self._body, self.warnings = self._whole_lines(text[position:])

    @property
    def scalars(self) -> dict[str, float]:
        """A CSV file has none."""
        return {}

    def _whole_lines(self, body: str) -> tuple[str, tuple[str, ...]]:
        """The lines of numbers, without a truncated last one, as in a log whose program was stopped."""
        begin = body.rfind("\n") + 1
        last = body[begin:]
        if not begin or not last.strip() or len(last.split(self._delimiter)) >= len(self.names):
            return body, ()
        return body[:begin], (f"{self.path}: the last line ends in the middle and is left out",)

    def columns(self, wanted: Sequence[str]) -> dict[str, Array]:
        """The columns of these names, float64. Raises RecordingError naming line and column."""
        places = [self._place_of(name) for name in wanted]
        values = self._parse(places)
        return {name: np.ascontiguousarray(values[:, index]) for index, name in enumerate(wanted)}

    def _place_of(self, name: str) -> int:
        if name not in self.names:
            raise RecordingError(f"{self.path}: no column {name!r}: {did_you_mean(name, self.names)}")
        if self.names.count(name) > 1:
            raise RecordingError(f"{self.path}: column {name!r} stands {self.names.count(name)} times in the header")
        return self.names.index(name)

    def _parse(self, places: list[int]) -> Array:
        if not self._body.strip():
            raise RecordingError(f"{self.path}: no line of numbers under the names")
        try:
            values = np.loadtxt(
                io.StringIO(self._body), delimiter=self._delimiter, usecols=places, comments=None, ndmin=2
            )
        except (ValueError, IndexError) as error:
            raise self._complaint(places, str(error)) from error
        separators = len(values) * (len(self.names) - 1)
        if self._delimiter is not None and self._body.count(self._delimiter) != separators:
            raise self._complaint(places, "lines of unequal length")
        return values

    def _complaint(self, places: list[int], fallback: str) -> RecordingError:
        for number, line in self._lines():
            cells = line.split(self._delimiter)
            if len(cells) != len(self.names):
                expected = f"the header names {len(self.names)} columns"
                return RecordingError(f"{self.path}, line {number}: {len(cells)} cells, but {expected}")
            for place in places:
                if not _is_number(cells[place]):
                    return RecordingError(
                        f"{self.path}, line {number}, column {self.names[place]!r}: {_complain(cells[place])}"
                    )
        return RecordingError(f"{self.path}: {fallback}")

    def _lines(self) -> Iterator[tuple[int, str]]:
        for number, line in enumerate(self._body.split("\n"), start=self._first_line):
            if line.strip():
                yield number, line.rstrip("\r")

    def place(self, row: int) -> str:
        """Place of row `row` (from 0) in the file."""
        for index, (number, _) in enumerate(self._lines()):
            if index == row:
                return f"line {number}"
        return f"row {row + 1}"


def _find_header(text: str, path: Path) -> tuple[str, int, int]:
    """The line of names, where the numbers begin, and the number of their first line (from 1)."""
    position, number, comment = 0, 1, ""
    while position < len(text):
        end = text.find("\n", position)
        end = len(text) if end < 0 else end
        line = text[position:end].strip()
        if line and not line.startswith(_COMMENTS):
            cells = line.split(_delimiter(line))
            if not all(_is_number(cell) for cell in cells):
                return line, end + 1, number + 1
            if len(comment.split(_delimiter(line))) == len(cells):
                return comment, position, number
            raise RecordingError(f"{path}, line {number}: numbers where the names of the columns should stand")
        comment = line.lstrip("#% ") if line else comment
        position, number = end + 1, number + 1
    raise RecordingError(f"{path}: no line with names of columns")


def _delimiter(line: str) -> str | None:
    best = max(_DELIMITERS, key=line.count)
    return best if best in line else None  # None: blanks


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _complain(cell: str) -> str:
    text = cell.strip()
    if not text:
        return "the cell is empty"
    if "," in text and _is_number(text.replace(",", ".")):
        return f"{text!r} has a decimal comma; write {text.replace(',', '.')!r}"
    return f"{text!r} is not a number"

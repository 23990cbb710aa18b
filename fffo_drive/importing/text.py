"""Text of numbers: any delimiter, decimal comma, metadata and unit lines, with or without names; TwinCAT Scope too.

The layout follows from the lines themselves: of all pairs of delimiter and decimal sign the one that reads the most
numbers. pyarrow's parser does the work.
"""

from __future__ import annotations

import csv
import datetime
import io
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import Floats
from ..documents import counted
from ..recording.errors import RecordingError
from ..recording.files import table_text
from .evidence import DAY_S, at_stamps, unwrapped
from .names import measured_wrap
from .source import Source
from .units import split_name, time_scale, unit_of

SAMPLE_LINES = 400  # from which the layout is recognised
SAMPLE_CHARACTERS = 1 << 21  # likewise, where lines are long
DELIMITERS = ("\t", ";", ",", "|", " ")  # " ": any run of blanks
MISSING = {"", "nan", "null", "none", "n/a", "na", "#n/a", "-", "--", "nil", "?"}
WORDS = {"true": 1.0, "false": 0.0, "on": 1.0, "off": 0.0, "yes": 1.0, "no": 0.0}
MOST_UNREADABLE = 0.05  # of the rows or of a column's cells, that may be missing as unreadable
COMMENTS = "#%"
LEAST_UNITS = 2  # of a line of units that many columns have none of
MONTHS = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"]
TICKS_PER_MS = 10_000  # of a Windows FILETIME
FILETIMES = 1e15  # no count of milliseconds is so large

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?|[+-]?(inf|infinity)", re.IGNORECASE)
GROUPED = r"^[+-]?\d{1,3}(\.\d{3})+(,\d+)?$"  # thousands with dots, where the decimal sign is a comma
_GROUPED = re.compile(GROUPED)
_HEX = re.compile(r"0x[0-9a-f]+", re.IGNORECASE)
_CLOCK = re.compile(  # of a day, or pandas' time since the begin
    r"(?:(?P<days>-?\d+) days?,? )?(?P<h>\d{1,2}):(?P<m>\d{2}):(?P<s>\d{2}(?:[.,]\d+)?) ?(?P<half>[AP]M)?",
    re.IGNORECASE,
)
_DATE = re.compile(
    r"(?P<a>\d{1,4})(?P<sign>[./ -])(?P<b>\d{1,2}|[A-Za-z]{3})(?P=sign)(?P<c>\d{2,4})(?:[T ]+(?P<clock>.*))?"
)
_PERIOD = re.compile(
    r"(?:sampl\w*[ _-]*(?:period|time|interval)|cycle[ _-]*time|\bts)\W+?(?P<value>\d+(?:[.,]\d+)?)\W*"
    r"(?P<unit>[mµuμn]?s)\b",
    re.IGNORECASE,
)
_RATE = re.compile(
    r"(?:sampl\w*[ _-]*(?:rate|freq\w*)|\bfs)\W+?(?P<value>\d+(?:[.,]\d+)?)\W*(?P<unit>k?hz)\b", re.IGNORECASE
)


class Layout(NamedTuple):
    """How a text is laid out."""

    delimiter: str
    decimal: str
    cells: int
    first: int  # line (from 0) where the numbers begin


def read_text(path: Path, rows: bool = True) -> Source:
    """Read a text; without its `rows` the names of its columns alone. Raises RecordingError naming line and column."""
    text = _text_of(path)
    lines = text[:SAMPLE_CHARACTERS].split("\n", SAMPLE_LINES * 4)[: SAMPLE_LINES * 4]
    if len(lines) > 1 and len(text) > SAMPLE_CHARACTERS:
        del lines[-1]  # it may end in the middle
    layout = _layout(lines, path)
    head = [line.rstrip("\r") for line in lines[: layout.first]]
    scope = _scope_channels(head, layout)
    names, units, unused = (*scope, []) if scope else _names(head, lines[layout.first], layout)
    begin = 0
    for _ in range(layout.first):
        begin = text.index("\n", begin) + 1
    body = text[begin:]
    del text  # a log of 100 MB is in memory as often as somebody holds it
    if not rows:
        return Source(path, dict.fromkeys(names, np.zeros(0)), units)
    columns, stamps, remarks, left = _numbers(path, body, layout, names)
    columns = _clocks(columns, stamps)
    units |= {name: "s" for name in stamps if name in columns}
    remarks = unused + remarks
    if scope:
        columns, more = _on_one_time(columns, names, units)
        units["time"] = "ms"
        remarks += more
    declared = None if scope else _declared_period_s(head)
    size = body.count("\n") + (not body.endswith("\n"))
    first_line = layout.first + 1 if next(iter(columns.values())).size == size else 0
    return Source(path, columns, units, declared, remarks=tuple(remarks), left=left, first_line=first_line)


def _text_of(path: Path) -> str:
    text = table_text(path)
    if "\0" in text[:4096]:
        raise RecordingError(f"{path}: not a text of numbers, and of no other kind that can be read")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _cells(line: str, delimiter: str) -> list[str]:
    if '"' in line:
        parts = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    else:
        parts = line.split() if delimiter == " " else line.split(delimiter)
    return [part.strip() for part in parts]


def _value(cell: str, decimal: str) -> float | None:
    """A cell as a number, NaN where nothing is in it; None where it is something else."""
    word = cell.lower()
    if word in MISSING:
        return float("nan")
    if word in WORDS:
        return WORDS[word]
    if _HEX.fullmatch(word):
        return float(int(word, 16))
    plain = cell
    if decimal == ",":
        if "." in cell and not _GROUPED.fullmatch(cell):
            return _seconds(cell)
        plain = cell.replace(".", "").replace(",", ".")
    if _NUMBER.fullmatch(plain):
        return float(plain.lower().replace("d", "e"))
    return _seconds(plain)


def _seconds(text: str, day_first: bool = True) -> float | None:
    """A time of day, or a date, in seconds; of 01/03/2026 the day is the first but where `day_first` is False."""
    clock = _CLOCK.fullmatch(text)
    if clock:
        hour = int(clock["h"])
        if clock["half"]:
            hour = hour % 12 + (12 if clock["half"].upper() == "PM" else 0)
        whole = DAY_S * int(clock["days"] or 0) + 3600.0 * hour + 60.0 * int(clock["m"])
        return whole + float(clock["s"].replace(",", "."))
    if not text[:1].isdigit() or "\t" in text or _NUMBER.fullmatch(text):
        return None
    try:
        date = _DATE.fullmatch(text)
        if date is None or len(date["a"]) == len("2026"):
            stamp = datetime.datetime.fromisoformat(text.replace("/", "-") if date else text)
            return stamp.replace(tzinfo=stamp.tzinfo or datetime.UTC).timestamp()
        named = date["b"].isalpha()
        day, month = int(date["a"]), MONTHS.index(date["b"].lower()) + 1 if named else int(date["b"])
        if month > 12 or (date["sign"] == "/" and not day_first):
            day, month = month, day
        year = int(date["c"]) + (2000 if len(date["c"]) == 2 else 0)
        of_day = _seconds(date["clock"]) if date["clock"] else 0.0
        if of_day is None:
            return None
        return datetime.datetime(year, month, day, tzinfo=datetime.UTC).timestamp() + of_day
    except (ValueError, OverflowError):
        return None


def _clocks(columns: dict[str, Floats], cells: Mapping[str, str]) -> dict[str, Floats]:
    """Columns of a clock with the date beside them; a time of day alone goes on over midnight.

    `cells`: one of each column of dates or of times of day, as it is written.
    """
    dates = [name for name, cell in cells.items() if ":" not in cell]
    clocks = [name for name, cell in cells.items() if _CLOCK.fullmatch(cell)]
    found = dict(columns)
    for name in clocks:
        found[name] = columns[name] + columns[dates[0]] if dates else unwrapped(columns[name], DAY_S)
    return {name: values for name, values in found.items() if not clocks or name not in dates}


def _layout(lines: Sequence[str], path: Path) -> Layout:
    """Of all pairs of delimiter and decimal sign, the one that reads the most numbers in lines of one length.

    Columns of text are looked for as well: without them where that reads as many.
    """
    ways = [(decimal, delimiter) for decimal in ".," for delimiter in DELIMITERS if delimiter != decimal]
    found = [one for texts in (False, True) for decimal, sign in ways if (one := _read_as(lines, sign, decimal, texts))]
    if found:
        return max(found, key=lambda one: one[0])[1]
    raise RecordingError(f"{path}: no lines of numbers in it{_not_understood(lines)}")


def _not_understood(lines: Sequence[str]) -> str:
    """The cell that keeps most lines from being numbers, where they hold some."""
    rows = [(number, _cells(line, sign)) for number, line in enumerate(lines, 1) for sign in DELIMITERS]
    other = {
        number: (cells, [cell for cell in cells if _value(cell, ".") is None and _value(cell, ",") is None])
        for number, cells in rows
        if len(cells) > 2
    }
    near = [(number, left[0]) for number, (cells, left) in other.items() if 0 < 2 * len(left) < len(cells)]
    return f": in line {near[0][0]} {near[0][1]!r} is neither a number nor a time" if near else ""


def _read_as(lines: Sequence[str], delimiter: str, decimal: str, texts: bool) -> tuple[int, Layout] | None:
    """How many numbers lines hold that have the usual number of cells, and the layout. `texts`: with columns of text,
    fewer than half of them.
    """
    split = [_cells(line, delimiter) if line.strip() else [] for line in lines]
    rows = [[_value(cell, decimal) for cell in cells] for cells in split]
    if texts:
        rows = _without_texts(split, rows)
    numbers: list[int] = []
    sizes: list[int] = []
    for cells, values in zip(split, rows, strict=True):
        whole = bool(values) and all(v is not None for v in values) and any(v == v for v in values)
        numbers.append(sum(v == v for v in values) - _parted(cells) if whole else 0)
        sizes.append(len(values) if whole else 0)
    counted = [size for size in sizes if size]
    if not counted:
        return None
    usual = max(set(counted), key=counted.count)
    own = [k for k, size in enumerate(sizes) if size == usual]
    # a line of metadata may hold numbers alone: the table begins under names, or where two such lines come together
    first = next(
        (
            k
            for k, after in itertools.pairwise(own)
            if not any(lines[k + 1 : after]) or _are_names(lines, k, usual, delimiter)
        ),
        own[0],
    )
    return sum(numbers[k] for k in own if k >= first), Layout(delimiter, decimal, usual, first)


def _parted(cells: list[str]) -> int:
    """How many stamps are cut in two between their date and their clock: a blank that separates no columns."""
    return sum(":" in after and _DATE.fullmatch(cell) is not None for cell, after in itertools.pairwise(cells))


def _without_texts(split: list[list[str]], rows: list[list[float | None]]) -> list[list[float | None]]:
    """The rows with nothing in place of a column of text: one that is no number in most rows of the usual length.

    Few words come again and again; of other text each cell may be a stamp that is not understood.
    """
    some = [k for k, row in enumerate(rows) if any(value is not None for value in row)]
    usual = Counter(len(rows[k]) for k in some).most_common(1)[0][0] if some else 0
    own = [k for k in some if len(rows[k]) == usual]
    texts = {k for k in range(usual) if 2 * sum(rows[row][k] is None for row in own) > len(own)}
    texts = {k for k in texts if 2 * len({split[row][k] for row in own}) <= len(own)}
    if not 0 < 2 * len(texts) < usual:
        return rows
    return [
        [math.nan if k in texts else value for k, value in enumerate(row)]
        if len(row) == usual and any(value is not None for value in row)
        else row
        for row in rows
    ]


def _are_names(lines: Sequence[str], row: int, cells: int, delimiter: str) -> bool:
    """Whether the line above a row has as many cells, none of which is a number."""
    above = _cells(lines[row - 1], delimiter) if row else []
    return len(above) == cells > 1 and all(_value(cell, sign) is None for cell in above for sign in ".,")


def _names(head: Sequence[str], row: str, layout: Layout) -> tuple[list[str], dict[str, str], list[str]]:
    """Names of the columns, units by name, and what is not used, from the last lines above the first `row`."""
    rows: list[list[str]] = []
    remarks: list[str] = []
    for line in reversed(head):
        plain = line.strip().lstrip(COMMENTS).strip() if line.strip()[:1] in tuple(COMMENTS) else line
        if not plain.strip():
            continue
        cells = _heading(plain, layout)
        fitted = _fitted(cells, row, layout) if len(rows) < 2 else None
        if fitted is None:
            if len(cells) > 1 and (not rows or (len(rows) == 1 and _are_units(rows[0]))):
                remarks.append(f"the heading has {len(cells)} cells, the rows {layout.cells}: its names are not used")
            break
        rows.append(fitted)
    units: list[str | None] = [None] * layout.cells
    written = rows[0] if rows else [""] * layout.cells
    if rows and _are_units(rows[0]):
        units = [unit_of(cell) for cell in rows[0]]
        written = rows[-1]
    names: list[str] = []
    for k, cell in enumerate(written):
        name, unit = split_name(cell)
        units[k] = units[k] or unit
        if not name:
            name = "time" if units[k] is not None and time_scale(units[k]) is not None else f"column {k + 1}"
        names.append(name)
    names = _distinct(names)
    return names, {name: unit for name, unit in zip(names, units, strict=True) if unit}, remarks


def _distinct(names: Iterable[str]) -> list[str]:
    """The names, with a number where one before has it too."""
    found: dict[str, None] = {}
    numbers: Counter[str] = Counter()  # the last that a name was given
    for name in names:
        own = name
        while own in found:
            numbers[name] += 1
            own = f"{name} ({numbers[name] + 1})"
        found[own] = None
    return list(found)


def _heading(line: str, layout: Layout) -> list[str]:
    """The cells of a line above the numbers, which may have a delimiter of its own; blanks may be in its names."""
    cells = _cells(line, layout.delimiter)
    if len(cells) == layout.cells or (len(cells) > 1 and layout.delimiter != " "):
        return cells
    return next((own for other in DELIMITERS if len(own := _cells(line, other)) > 1), cells)


def _fitted(cells: list[str], row: str, layout: Layout) -> list[str] | None:
    """The cells of a heading, as many as the row has: a line that ends in a delimiter has an empty one more.

    None where they do not belong to the cells of the row.
    """
    spare = _cells(row, layout.delimiter)[len(cells) :] + cells[layout.cells :]
    return None if any(spare) else (cells + [""] * layout.cells)[: layout.cells]


def _are_units(cells: Sequence[str]) -> bool:
    """Whether a line holds units: each cell is one, or empty, and half or several of them are."""
    known = [unit_of(cell) is not None for cell in cells]
    return (2 * sum(known) >= len(cells) or sum(known) >= LEAST_UNITS) and all(
        one or cell in ("", "-", "[]", "()") for one, cell in zip(known, cells, strict=True)
    )


def _declared_period_s(head: Sequence[str]) -> float | None:
    for line in head:
        plain = line.replace(";", " ").replace("\t", " ")
        if found := _PERIOD.search(plain):
            return float(found["value"].replace(",", ".")) * (time_scale(found["unit"]) or 1.0)
        if found := _RATE.search(plain):
            return 1.0 / (float(found["value"].replace(",", ".")) * (1e3 if found["unit"].lower() == "khz" else 1.0))
    return None


def _numbers(
    path: Path, body: str, layout: Layout, names: Sequence[str]
) -> tuple[dict[str, Floats], dict[str, str], list[str], dict[str, str]]:
    """All columns below the head, a cell of each that holds dates or times of day; remarks, and columns left out."""
    try:
        import pyarrow
        from pyarrow import csv as parser
    except ImportError:
        return dict(zip(names, _plain_numbers(body, layout), strict=True)), {}, [], {}

    if layout.delimiter == " ":
        body = re.sub(r"[ \t]+", " ", re.sub(r"(?m)^[ \t]+|[ \t]+$", "", body))
    labels = [f"c{k}" for k in range(layout.cells)]
    short = 0

    def skipped(row: Any) -> str:
        nonlocal short
        short += 1
        return "skip"

    def parsed(data: bytes, kind: Any) -> Any:
        nonlocal short
        short = 0
        return parser.read_csv(
            io.BytesIO(data),
            read_options=parser.ReadOptions(column_names=labels, use_threads=False),
            parse_options=parser.ParseOptions(delimiter=layout.delimiter, invalid_row_handler=skipped),
            convert_options=parser.ConvertOptions(
                column_types=dict.fromkeys(labels, kind), decimal_point=layout.decimal,
                null_values=[*MISSING, *(word.upper() for word in MISSING)], strings_can_be_null=False,
            ),
        )  # fmt: skip

    data = body.encode()
    try:
        try:
            table = parsed(data, pyarrow.float64())
        except pyarrow.ArrowInvalid:  # a cell that is no number: one by one
            table = parsed(data, pyarrow.string())
    except pyarrow.ArrowInvalid as error:
        raise RecordingError(f"{path}: {error}") from error
    del data
    rows = table.num_rows
    if rows < 2:
        raise RecordingError(f"{path}: {rows} rows of numbers; at least 2 are needed")
    if short > max(2.0, MOST_UNREADABLE * rows):
        raise RecordingError(
            f"{path}, line {_first_short(body, layout) + 1}: {short} of {rows + short} lines do not have "
            f"{layout.cells} cells"
        )
    remarks = [_said_of_short(short, body, layout)] if short else []
    found: dict[str, Floats] = {}
    left: dict[str, str] = {}
    stamps: dict[str, str] = {}
    headings = _repeated(table, labels, names)
    if headings.any():
        table = table.filter(pyarrow.array(~headings))
        remarks.append(f"the heading is repeated {counted(int(headings.sum()), 'time')}")
    rows = table.num_rows
    for name, label in zip(names, labels, strict=True):
        values, unreadable, stamp = _column(table.column(label).combine_chunks(), layout.decimal)
        if stamp is not None:
            stamps[name] = stamp
        if unreadable.size:
            place = f"line {_line_of(body, layout, int(unreadable[0])) + 1}, column {name!r}"
            cell = table.column(label)[int(unreadable[0])].as_py()
            if unreadable.size > MOST_UNREADABLE * rows:
                if np.isnan(values).all():
                    left[name] = "holds text"
                    continue
                raise RecordingError(
                    f"{path}, {place}: {cell!r} is not a number, and {unreadable.size - 1} more like it"
                )
            what = "is not a number and counts" if unreadable.size == 1 else "are not numbers and count"
            remarks.append(f"{counted(unreadable.size, 'cell')} {what} as missing, the first is {cell!r} in {place}")
        if np.isnan(values).all():
            continue
        found[name] = values
    if not found:
        raise RecordingError(f"{path}: no column of numbers in it")
    return found, {name: cell for name, cell in stamps.items() if name in found}, remarks, left


def _plain_numbers(body: str, layout: Layout) -> Floats:
    """All columns (columns, n) without pyarrow: of numbers alone. Raises ImportError for any other text."""
    plain = body.replace(",", ".") if layout.decimal == "," else body
    delimiter = None if layout.delimiter == " " else layout.delimiter
    try:
        return np.loadtxt(io.StringIO(plain), delimiter=delimiter, comments=None, ndmin=2, unpack=True)
    except ValueError:
        raise ImportError("it holds more than rows of numbers") from None


def _said_of_short(count: int, body: str, layout: Layout) -> str:
    """What is said of lines without all cells: the last one is that of a program that was stopped."""
    first = _first_short(body, layout)
    if count == 1 and first == layout.first + body.rstrip().count("\n"):
        return "the last line ends in the middle and is left out"
    return f"left out: {counted(count, 'line')} without {layout.cells} cells, the first is line {first + 1}"


def _repeated(table: Any, labels: Sequence[str], names: Sequence[str]) -> npt.NDArray[np.bool_]:
    """The rows that are the heading once more."""
    import pyarrow
    from pyarrow import compute

    cells = table.column(labels[0])
    if pyarrow.types.is_floating(cells.type):
        return np.zeros(table.num_rows, bool)
    words = compute.match_substring_regex(cells, r"^\s*[^\d\s+.,-]")
    rows = np.flatnonzero(np.asarray(words.to_numpy(zero_copy_only=False), dtype=bool))
    same = np.zeros(table.num_rows, bool)
    for row in rows.tolist():
        same[row] = all(
            split_name(table.column(label)[row].as_py())[0] == name.split(" (")[0]
            for label, name in zip(labels, names, strict=True)
        )
    return same


def _column(cells: Any, decimal: str) -> tuple[Floats, npt.NDArray[np.int64], str | None]:
    """Numbers (n,) of cells of text, the rows that hold something else, and a cell that is a date or a time of day."""
    import pyarrow
    from pyarrow import compute

    if pyarrow.types.is_floating(cells.type):
        return np.asarray(cells.to_numpy(zero_copy_only=False), dtype=np.float64), np.zeros(0, np.int64), None
    plain = compute.utf8_trim_whitespace(cells)
    if decimal == ",":
        grouped = compute.match_substring_regex(plain, GROUPED)
        plain = compute.if_else(grouped, compute.replace_substring(plain, ".", ""), plain)
    simple = compute.match_substring_regex(plain, rf"^-?[0-9]*{re.escape(decimal)}?[0-9]+([eE][-+]?[0-9]+)?$")
    pointed = compute.replace_substring(plain, decimal, ".")
    values = compute.cast(compute.if_else(simple, pointed, pyarrow.scalar(None, pyarrow.string())), pyarrow.float64())
    found = np.array(values.to_numpy(zero_copy_only=False), dtype=np.float64)
    wrong = []
    for row in np.flatnonzero(~np.asarray(simple.to_numpy(zero_copy_only=False), dtype=bool)):
        value = _value(plain[int(row)].as_py(), decimal)
        if value is None:
            wrong.append(int(row))
        found[row] = np.nan if value is None else value
    begin = next((cell for cell in plain.to_pylist() if cell and cell.lower() not in MISSING), "")
    if _seconds(begin) is None or len(wrong) > MOST_UNREADABLE * found.size:
        return found, np.array(wrong, dtype=np.int64), None
    if "/" in begin:  # of two orders of day and month, the one in which less time passes
        other = np.array([_seconds(cell, day_first=False) or np.nan for cell in plain.to_pylist()])
        spans = [float(np.nanmax(one) - np.nanmin(one)) for one in (other, found)]
        found = other if begin.upper().endswith("M") or spans[0] < spans[1] else found
    return found, np.array(wrong, dtype=np.int64), begin


def _body_lines(body: str, layout: Layout) -> Iterator[tuple[int, int]]:
    """Line number (from 0) and number of cells of each line of the body that is not empty."""
    for number, line in enumerate(body.split("\n")):
        if line.strip():
            yield layout.first + number, len(_cells(line, layout.delimiter))


def _first_short(body: str, layout: Layout) -> int:
    return next((number for number, cells in _body_lines(body, layout) if cells != layout.cells), layout.first)


def _line_of(body: str, layout: Layout, row: int) -> int:
    whole = (number for number, cells in _body_lines(body, layout) if cells == layout.cells)
    return next((number for k, number in enumerate(whole) if k == row), layout.first)


# TwinCAT Scope: a block of channel headers, each a pair of columns, then time and value of each channel


def _scope_channels(head: Sequence[str], layout: Layout) -> tuple[list[str], dict[str, str]] | None:
    """Names of time and value of each channel, where the file is an export of TwinCAT Scope."""
    rows = [_cells(line, layout.delimiter) for line in head]
    sampled = [cells for cells in rows if cells and cells[0].startswith("SampleTime")]
    named = [cells for cells in rows if cells and cells[0] == "Name" and len(cells) >= 2]
    if not sampled or not named:
        return None
    channels = _distinct(filter(None, named[-1][1::2]))
    if 2 * len(channels) != layout.cells:
        return None
    unit_row = next((cells for cells in rows if cells and cells[0] == "Unit"), [])
    units = dict(zip(channels, unit_row[1::2], strict=False))
    names = [name for channel in channels for name in (f"time of {channel}", channel)]
    return names, {channel: found for channel, unit in units.items() if (found := unit_of(unit))}


def _on_one_time(
    columns: dict[str, Floats], names: Sequence[str], units: Mapping[str, str]
) -> tuple[dict[str, Floats], list[str]]:
    """All channels on the time of the one with the most samples; milliseconds, or FILETIME."""
    channels = [name for name in names[1::2] if name in columns]
    stamps = {channel: columns[f"time of {channel}"] for channel in channels}
    fullest = max(channels, key=lambda channel: int(np.isfinite(stamps[channel]).sum()))
    used = np.isfinite(stamps[fullest])
    time = stamps[fullest][used]
    found, remarks = {}, []
    for channel in channels:
        own = np.isfinite(stamps[channel]) & np.isfinite(columns[channel])
        if np.array_equal(stamps[channel][used], time):
            found[channel] = columns[channel][used]
        else:
            wrap = measured_wrap(channel, units.get(channel), columns[channel][own])
            found[channel] = at_stamps(columns[channel][own], stamps[channel][own], time, wrap)
            remarks.append(f"{channel!r} has a time of its own: interpolated to that of {fullest!r}")
    milliseconds = (time - time[0]) / TICKS_PER_MS if time[0] > FILETIMES else time
    return {"time": milliseconds, **found}, remarks

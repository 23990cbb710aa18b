"""Log files as bytes and as text: what is not a regular file, or cannot be a table, is refused before it is parsed.

A table of 4096 columns with 60 characters each has lines of 240 kB. Without these bounds one line of 300 MB, or 200,000
columns, kept a reader busy for minutes.
"""

from __future__ import annotations

import stat
from pathlib import Path

from ..documents import counted
from .errors import RecordingError
from .unpack import gunzipped

LARGEST_TEXT_BYTES = 1 << 30  # of a log as text, unpacked: it is in memory several times while it is parsed
MOST_COLUMNS = 4096
LONGEST_LINE_BYTES = 1 << 18
DELIMITERS = (b",", b";", b"\t", b"|")
COMMENTS = (b"#", b"%")


def regular(path: Path) -> Path:
    """The path, if it is a regular file; a directory is refused when it is opened.

    Raises RecordingError, OSError.
    """
    mode = path.stat().st_mode
    if stat.S_ISREG(mode) or stat.S_ISDIR(mode):
        return path
    kind = "a pipe" if stat.S_ISFIFO(mode) else "a device"
    raise RecordingError(f"{path}: is {kind}, and one file is expected here; write the log to a file first")


def text_bytes(path: Path) -> bytes:
    """A log as text, unpacked. Raises RecordingError for more than LARGEST_TEXT_BYTES; OSError."""
    size = regular(path).stat().st_size
    if size > LARGEST_TEXT_BYTES:
        raise RecordingError(f"{path}: {size} bytes of text; at most {LARGEST_TEXT_BYTES} can be read: split it")
    return gunzipped(path, path.read_bytes(), LARGEST_TEXT_BYTES)


def table_text(path: Path) -> str:
    """The text of a table, each line of which is short enough to be one. Raises RecordingError naming the line."""
    data = text_bytes(path)
    _check_lines(path, data)
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def check_columns(path: Path, count: int, place: str = "") -> None:
    """Raises RecordingError for more columns than a log has. `place`: of the file, where it is known."""
    if count > MOST_COLUMNS:
        raise RecordingError(
            f"{path}{place}: {counted(count, 'column')}; at most {MOST_COLUMNS} can be read: is it a log, with a row "
            "for each time? Keep the columns that are needed"
        )


def _check_lines(path: Path, data: bytes) -> None:
    """Look at the lines with more bytes than a table has columns; all others are passed over, unread."""
    line_end = b"\n" if b"\n" in data else b"\r"
    begin = 0
    while begin + MOST_COLUMNS < len(data):
        end = data.rfind(line_end, begin, begin + MOST_COLUMNS)
        if end < 0:  # the line that begins here is longer
            end = data.find(line_end, begin)
            end = len(data) if end < 0 else end
            columns = _columns(data, begin, end)
            if columns > MOST_COLUMNS or end - begin > LONGEST_LINE_BYTES:
                place = f", line {data.count(line_end, 0, begin) + 1}"
                check_columns(path, columns, place)
                raise RecordingError(
                    f"{path}{place}: a line of {end - begin} bytes; a table has at most {LONGEST_LINE_BYTES} in one: "
                    "is it a log, with a line for each row?"
                )
        begin = end + 1


def _columns(data: bytes, begin: int, end: int) -> int:
    """Cells of a line, by the delimiter that makes the most of them; a comment has none."""
    if data.startswith(COMMENTS, begin):
        return 0
    by_blanks = len(data[begin : min(end, begin + LONGEST_LINE_BYTES)].split())
    return max(by_blanks, *(data.count(sign, begin, end) + 1 for sign in DELIMITERS))

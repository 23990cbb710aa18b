"""Writes what is kept between versions to tables/versions.md: every kind of file, the API, recordings."""

from __future__ import annotations

from pathlib import Path

from fffo_drive.formats import FORMATS

_HEAD = """\
# What is kept between versions

Made by `tools/versions` from the list in `fffo_drive/formats.py`; a test checks that it is current.

## Files

A file says `format: fffo_drive/KIND/NUMBER`; a file without this line has number 1. The number rises only when one
version would misread the file of another. A file with an older number is converted step by step while it is read; the
file on the disk is not changed. A file with a newer number is refused. The message names the version of fffo-drive that
wrote it, if the file says so (`tool`, `provenance.tool`; a file written by hand does not): that version and later ones
can read it.

A key that the program does not know is an error, so that a mistyped limit is noticed: a file that uses a key of a
later version is refused, and the message names the key. No key changes its meaning, unit or default without a new
number.
"""
_REST = """\

`programs of others`: fffo-drive itself never reads it again. `/etc/fffo-drive/.installed.json` has no number: it
lists what `fffo-drive install` has installed, and later versions read it.

Small files of each release are kept in `tests/releases/`; a test reads each of them with the present version and
compares its values.

## Recordings

MCAP, profile `ros2`: rows are messages `fffo_drive_msgs/msg/Row` on `/fffo_drive/row`, events
`fffo_drive_msgs/msg/Event` on `/fffo_drive/events`, what was in force and what was requested
`fffo_drive_msgs/msg/Record` on `/fffo_drive/records` (recordings of 0.1.0 have none: they are replayed with the axis
file and model in them). Names, units and places of a row's fields come from the schema in the file, never from the
program's own list: a file with more or fewer fields is read with the fields that it has, and a command that needs a
missing field names it. A field keeps its name as long as it keeps unit and meaning. The metadata of a file name the
version that wrote it (`tool`, `fffo_drive`). The attached files (axis, model, record) have the formats above.

## API of the daemon

`info` takes `protocol`: a version, or a list of those that the client supports. It answers with the newest that both
support, or refuses and names its own; without the parameter it answers with its newest. Within a version methods,
parameters and keys of answers may be added, but none is removed or changes its meaning: clients must ignore keys that
they do not know. The versions that this program supports are `PROTOCOLS` in `fffo_drive/daemon/parameters.py`.
"""


def markdown() -> str:
    """The page."""
    lines = [
        _HEAD,
        "| file | format | written by | read by | older numbers that are read |",
        "| --- | --- | --- | --- | --- |",
    ]
    for one in FORMATS.values():
        older = ", ".join(str(number) for number in range(1, one.newest)) or "none yet"
        lines.append(f"| {one.what} | `{one.word}` | {one.written_by} | {one.read_by} | {older} |")
    return "\n".join([*lines, _REST])


if __name__ == "__main__":
    (Path(__file__).parent / "tables" / "versions.md").write_text(markdown(), encoding="utf-8")

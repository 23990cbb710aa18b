"""Writes what is kept between versions to tables/versions.md: every kind of file, the API, recordings."""

from __future__ import annotations

from pathlib import Path

from fffo_drive.formats import FORMATS

_HEAD = """\
# What is kept between versions

Made by `tools/versions` from the list in `fffo_drive/formats.py`; a test checks that it is current.

## Files

A file says `format: fffo_drive/KIND/NUMBER`; one that says nothing is of number 1. The number rises only when one
version would misread the file of another. A file of an older number is brought up to date as it is read, step by
step, and left as it is on the disk. One of a newer number is refused with the version of fffo-drive that wrote it,
as far as it says so (`tool`, `provenance.tool`; what is written by hand does not): that version reads it, and later
ones do.

A key that a program does not know is an error, so that a mistyped limit is noticed: a file that uses a key of a
later version is refused with that key. No key changes its meaning, unit or default without another number.
"""
_REST = """\

`programs of others`: fffo-drive itself never reads it again. `/etc/fffo-drive/.installed.json` has no number: it
lists what `fffo-drive install` has put in place, and later versions read it.

Small files of each release are kept in `tests/releases/`; every one is read there by the program of today, and its
values compared.

## Recordings

MCAP, profile `ros2`: rows are messages `fffo_drive_msgs/msg/Row` on `/fffo_drive/row`, events
`fffo_drive_msgs/msg/Event` on `/fffo_drive/events`, what was in force and asked for `fffo_drive_msgs/msg/Record` on
`/fffo_drive/records` (recordings of 0.1.0 have none: they are replayed with the axis file and model in them). Names,
units and places of a row's fields come from the schema that the file carries, never from the program's own list: a
file with more or fewer fields is read with the fields that it has, and a command that needs one which is not there
names it. A field keeps its name as long as it keeps unit and meaning. The version that wrote a file stands in its
metadata (`tool`, `fffo_drive`). The files in it
(axis, model, record) are of the formats above.

## API of the daemon

`info` takes `protocol`: a version, or a list of those that the client speaks. It answers with the newest that both
speak, or refuses and names its own; without the parameter it answers with its newest. Within a version methods,
parameters and keys of answers are added, and none is taken away or changes its meaning: clients ignore keys that
they do not know. The versions that this program speaks are `PROTOCOLS` in `fffo_drive/daemon/parameters.py`.
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

"""One line of an axis file changed as somebody with an editor would: the rest, with its comments, stays as it is."""

from __future__ import annotations

import contextlib
import json
import re
import shutil
from pathlib import Path

from ..documents import DocumentError, parse, read_text

AFTER = "model"  # a key that is not there yet gets its line behind this one


def with_line(axis_path: Path, key: str, value: str) -> str:
    """The text of an axis file in which a key at the top has another value, or its first one.

    Raises DocumentError where its line cannot be replaced.
    """
    text = read_text(axis_path)
    content, lines = parse(text, str(axis_path))
    rows = text.splitlines(keepends=True)
    shown = json.dumps(value) if re.search(r"[^A-Za-z0-9_./-]", value) else value
    if key in content:
        at = lines[(key,)] - 1
        pattern = rf"^(\s*{key}\s*:\s*)[^#\r\n]*?(\s*(?:#.*)?)(\r?\n?)$"
        rows[at] = re.sub(pattern, lambda m: f"{m[1]}{shown}{m[2]}{m[3]}", rows[at])
    else:
        at = lines[(AFTER,)] - 1
        end = "\r\n" if rows[at].endswith("\r\n") else "\n"
        rows[at] = rows[at] if rows[at].endswith("\n") else rows[at] + end
        rows.insert(at + 1, f"{key}: {shown}{end}")
    try:
        found, _ = parse("".join(rows), str(axis_path))
    except DocumentError:
        found = {}
    if found != {**content, key: value}:
        raise DocumentError(f"{axis_path}:{at + 1}: {key}: write `{key}: {value}` on a line of its own yourself")
    return "".join(rows)


def replace_file(path: Path, text: str) -> None:
    """The whole file or none of it, with its rights; a link stays one. Raises OSError."""
    path = path.resolve()
    fresh = path.with_name(f".{path.name}.new")
    try:
        fresh.write_text(text, encoding="utf-8")
        if path.exists():
            shutil.copymode(path, fresh)
        fresh.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            fresh.unlink()
        raise

"""Names in configuration files: bounds that file names and sockets set."""

from __future__ import annotations

from pathlib import PurePath
from typing import Annotated

from pydantic import AfterValidator

LONGEST_NAME = 64  # characters of an axis or a scenario: their recordings and sockets add more
LONGEST_FILE_NAME = 255  # bytes of each part of a path, in Linux


def is_file_name(text: str) -> bool:
    """Whether a file may have this path."""
    return "\0" not in text and all(len(part.encode()) <= LONGEST_FILE_NAME for part in PurePath(text).parts)


def _checked(text: str) -> str:
    if not is_file_name(text):
        raise ValueError(f"no file may have this name: at most {LONGEST_FILE_NAME} bytes in each part of its path")
    return text


FileName = Annotated[str, AfterValidator(_checked)]

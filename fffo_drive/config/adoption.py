"""What an axis has had in service: AXIS.adoptions.yaml, beside the axis file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import yaml
from pydantic import Field

from .. import __version__, formats
from ..documents import StrictRecord, load
from .axis_text import replace_file

HISTORY_SUFFIX = ".adoptions.yaml"


class Adoption(StrictRecord):
    """One entry of an axis file's history."""

    date: Annotated[str, Field(description="UTC, ISO 8601")]
    model: Annotated[str, Field(description="the model file, as the axis file names it")]
    model_hash: Annotated[str, Field(description="content hash of the model")]
    former: Annotated[str, Field(description="the previous model file; a rollback restores it")]
    gates: Annotated[list[str], Field(description="gates that the model passed, with their values")]


class History(StrictRecord):
    """What was adopted on an axis, the last one at the end."""

    format: Annotated[str, formats.ADOPTIONS.key] = formats.ADOPTIONS.word
    tool: Annotated[str, Field(description="program that wrote it last")] = ""
    adoptions: list[Adoption] = Field(
        default_factory=list, description="the oldest first; a rollback removes the last one"
    )


def history_path(axis_path: Path) -> Path:
    """Where the adoptions of an axis file stand."""
    return axis_path.with_suffix(HISTORY_SUFFIX)


def read_history(axis_path: Path) -> History:
    """What was adopted on this axis; nothing yet where there is no file."""
    path = history_path(axis_path)
    return load(path, History) if path.exists() else History()


def write_history(axis_path: Path, history: History) -> None:
    """Replace the file. Raises OSError."""
    written = history.model_copy(update={"tool": f"fffo-drive {__version__}"})
    text = yaml.safe_dump(written.model_dump(mode="json"), sort_keys=False, width=110)
    replace_file(history_path(axis_path), text)

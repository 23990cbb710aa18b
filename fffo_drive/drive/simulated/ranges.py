"""Dataclass fields with unit, range and meaning, and their check.

`config` reads them from the metadata (`key_of`, `note_of`), so that nothing is listed a second time.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

_METADATA = "key"
_NOTE = "note"
NOT_IN_A_FILE = "not in a file"  # in the metadata of a field that a program sets


class Key(NamedTuple):
    """Allowed numbers of a configuration key, `low` and `high` included."""

    unit: str  # "-" for a number without one
    low: float
    high: float
    meaning: str


def key(default: Any, unit: str, low: float, high: float, meaning: str) -> Any:
    """A dataclass field with a range."""
    return dataclasses.field(default=default, metadata={_METADATA: Key(unit, low, high, meaning)})


def required_key(unit: str, low: float, high: float, meaning: str) -> Any:
    """A dataclass field with a range and no default."""
    return dataclasses.field(metadata={_METADATA: Key(unit, low, high, meaning)})


def note(default: Any, meaning: str) -> Any:
    """A dataclass field other than a number, with its meaning. A mapping as default is copied for each instance."""
    if isinstance(default, dict):
        return dataclasses.field(default_factory=lambda: dict(default), metadata={_NOTE: meaning})
    return dataclasses.field(default=default, metadata={_NOTE: meaning})


def required_note(meaning: str) -> Any:
    """A dataclass field other than a number, without default, with its meaning."""
    return dataclasses.field(metadata={_NOTE: meaning})


def note_of(field: dataclasses.Field[Any]) -> str | None:
    """The meaning of a dataclass field that has no range."""
    return field.metadata.get(_NOTE)


def key_of(field: dataclasses.Field[Any]) -> Key | None:
    """The range of a dataclass field, or None where it has none."""
    return field.metadata.get(_METADATA)


def range_errors(record: Any, path: str = "") -> list[tuple[str, str]]:
    """Everything out of range in a dataclass and its members: pairs of dotted key and text."""
    errors: list[tuple[str, str]] = []
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        name = f"{path}{field.name}"
        allowed = key_of(field)
        if allowed is not None:
            text = _number_error(value, allowed, whole=field.type == "int")
            if text:
                errors.append((name, text))
        elif dataclasses.is_dataclass(value):
            errors += range_errors(value, f"{name}.")
        elif isinstance(value, tuple):
            for k, item in enumerate(value):
                if dataclasses.is_dataclass(item):
                    errors += range_errors(item, f"{name}[{k}].")
    return errors


def _number_error(value: Any, allowed: Key, whole: bool) -> str:
    span = f"{allowed.low:g} to {allowed.high:g}" + ("" if allowed.unit == "-" else f" {allowed.unit}")
    kinds = (int,) if whole else (int, float)
    if isinstance(value, bool) or not isinstance(value, kinds) or not math.isfinite(value):
        return f"{value!r} is not a {'whole ' if whole else ''}number ({allowed.meaning}: {span})"
    if not allowed.low <= value <= allowed.high:
        return f"{value:g} is outside {span} ({allowed.meaning})"
    return ""

"""YAML files into checked records: every error at once, with file, line, key, allowed range and the nearest known key.

PyYAML reads YAML 1.1, in which `1e3` is a string and a key given twice silently wins; both are mended here.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Hashable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

M = TypeVar("M", bound=BaseModel)
Location = tuple[str | int, ...]

_FLOAT = re.compile(
    r"^[-+]?(\d[\d_]*)(\.[\d_]*)?([eE][-+]?\d+)?$|^[-+]?\.\d[\d_]*([eE][-+]?\d+)?$|^[-+]?\.inf$|^\.nan$"
)


class DocumentError(Exception):
    """A file that cannot be used: one line for each error, FILE:LINE: KEY: what is wrong, what is allowed."""


class Record(BaseModel):
    """Base of all configuration records: unknown keys are errors, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _Loader(yaml.SafeLoader):
    """SafeLoader with YAML 1.2 floats, true/false as the only booleans, and an error for a key given twice."""


_Loader.yaml_implicit_resolvers = {
    first: [
        (tag, pattern) for tag, pattern in resolvers if tag not in ("tag:yaml.org,2002:float", "tag:yaml.org,2002:bool")
    ]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+0123456789."))
_Loader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile(r"^(true|false)$"), list("tf"))


def _integers_first(loader: _Loader) -> None:
    """The float pattern also matches integers: PyYAML takes the first resolver that matches, so int goes first."""
    for resolvers in loader.yaml_implicit_resolvers.values():
        resolvers.sort(key=lambda pair: pair[0] != "tag:yaml.org,2002:int")


_integers_first(_Loader)  # type: ignore[arg-type]


def _walk(node: yaml.Node, path: Location, lines: dict[Location, int], errors: list[tuple[int, str]]) -> None:
    """Collect the line of every key and item, and the keys that stand twice in one mapping."""
    lines.setdefault(path, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        seen: dict[str, int] = {}
        for key_node, value_node in node.value:
            key = str(key_node.value)
            line = key_node.start_mark.line + 1
            if key in seen:
                errors.append((line, f"{'.'.join(map(str, (*path, key)))}: given twice, first in line {seen[key]}"))
            seen[key] = line
            lines[(*path, key)] = line
            _walk(value_node, (*path, key), lines, errors)
    elif isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            _walk(item, (*path, index), lines, errors)


def parse(text: str, name: str) -> tuple[Any, dict[Location, int]]:
    """Data and the line of every key. Raises DocumentError for text that is not YAML or has a key twice."""
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        data = loader.construct_document(node) if node is not None else {}
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark is not None else ""
        raise DocumentError(f"{name}{line}: not valid YAML: {getattr(error, 'problem', None) or error}") from None
    except (ValueError, RecursionError) as error:  # an impossible date, say, or thousands of brackets
        raise DocumentError(f"{name}: not valid YAML: {error}") from None
    lines: dict[Location, int] = {}
    errors: list[tuple[int, str]] = []
    if node is not None:
        _walk(node, (), lines, errors)
    if errors:
        raise DocumentError("\n".join(f"{name}:{line}: {text}" for line, text in errors))
    return data, lines


def read_text(path: Path) -> str:
    """The file's text. Raises DocumentError with the reason when it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise DocumentError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise DocumentError(f"{path}: not UTF-8 text (byte {error.start})") from None


def load(path: str | Path, record: type[M]) -> M:
    """Read and check a file. Raises DocumentError with every error in it."""
    path = Path(path)
    data, lines = parse(read_text(path), str(path))
    return check(data, record, str(path), lines)


def check(data: Any, record: type[M], name: str, lines: dict[Location, int] | None = None) -> M:
    """Check parsed data against a record. Raises DocumentError with every error in it."""
    if not isinstance(data, dict):
        raise DocumentError(f"{name}:1: a mapping of keys to values is needed, this is {type(data).__name__}")
    try:
        return record.model_validate(data)
    except ValidationError as error:
        found = sorted(_sentence(record, data, e, name, lines or {}) for e in error.errors())
        raise DocumentError("\n".join(text for _, text in found)) from None


def refuse(path: str | Path, problems: Iterable[tuple[str, str]]) -> None:
    """Raise DocumentError, if there are any (dotted key, what is wrong with it): FILE:LINE: KEY: TEXT each."""
    found = list(problems)
    if found:
        _, lines = parse(read_text(Path(path)), str(path))
        raise DocumentError(
            "\n".join(f"{path}:{_line_of(lines, _location(key))}: {key}: {text}" for key, text in found)
        )


def _location(key: str) -> Location:
    """Parts of a dotted key with [index] parts."""
    parts = key.replace("]", "").replace("[", ".").split(".")
    return tuple(int(part) if part.isdigit() else part for part in parts)


def _line_of(lines: dict[Location, int], location: Location) -> int:
    """Line of the innermost part that is in the file."""
    return next((lines[location[:n]] for n in range(len(location), -1, -1) if location[:n] in lines), 1)


def _sentence(
    record: type[BaseModel], data: Any, error: ErrorDetails, name: str, lines: dict[Location, int]
) -> tuple[int, str]:
    """(line, text) for one error of pydantic's."""
    location = _keys_only(error["loc"], data)
    line = _line_of(lines, location)
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] == "extra_forbidden":
        message = "unknown key"
        known = _known_keys(data, location, record)
        close = difflib.get_close_matches(str(location[-1]), known, 1, cutoff=0.55)
        message += f"; did you mean '{close[0]}'?" if close else f"; known here: {', '.join(known)}"
    elif error["type"] == "missing":
        message = "missing"
    elif not isinstance(error["input"], dict | list):
        message += f" (got {error['input']!r})"
    key = ".".join(map(str, location)) or "(file)"
    return line, f"{name}:{line}: {key}: {message}"


def _keys_only(location: Sequence[str | int], data: Any) -> Location:
    """The location without the tags that pydantic adds for unions: only what is in the data, and a last missing key."""
    path: list[str | int] = []
    for position, part in enumerate(location):
        inside = isinstance(data, dict) and isinstance(part, Hashable) and part in data
        if inside or (isinstance(data, list) and isinstance(part, int) and part < len(data)):
            data = data[part]
            path.append(part)
        elif position == len(location) - 1:
            path.append(part)
    return tuple(path)


def _known_keys(data: Any, location: Location, record: type[BaseModel]) -> list[str]:
    """Field names of the record in which the last part of `location` stands."""
    candidates: list[type[BaseModel]] = [record]
    for part in location[:-1]:
        data = data[part]
        following: list[type[BaseModel]] = []
        for candidate in candidates:
            field = candidate.model_fields.get(str(part))
            following.extend(_records_in(field.annotation if field else None) if field else [])
        candidates = following or candidates
    tagged = [c for c in candidates if _tag_matches(c, data)]
    return [key for candidate in tagged or candidates for key in candidate.model_fields]


def _tag_matches(record: type[BaseModel], data: Any) -> bool:
    field = record.model_fields.get("kind")
    return field is None or (isinstance(data, dict) and repr(data.get("kind")) in str(field.annotation))


def _records_in(annotation: Any) -> list[type[BaseModel]]:
    """Record types inside an annotation (unions, lists, dicts)."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    found: list[type[BaseModel]] = []
    for argument in getattr(annotation, "__args__", ()):
        found.extend(_records_in(argument))
    return found

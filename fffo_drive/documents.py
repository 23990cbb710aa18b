"""YAML files into checked records: every error at once, with file, line, key, allowed range and the nearest known key.

PyYAML reads YAML 1.1, in which `1e3` is a string and a key given twice silently wins; both are mended here.
"""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Callable, Hashable, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from .formats import FormatError, migrated

M = TypeVar("M", bound=BaseModel)
Location = tuple[str | int, ...]

LARGEST_BYTES = 256 * 1024  # of a file, as of a line of the daemon's API: thousands of points fit
MOST_ENTRIES = 30_000  # values of a file; reading so many takes a second
MOST_DIGITS = 40  # of a whole number
LARGEST_JSON_BYTES = 16 * 1024 * 1024  # of a report with its curves
MOST_KEPT = 16  # texts of files, for the lines of what is found wrong in them later
LONGEST_SHOWN = 80  # characters of a value in a message
DEEPEST = 32  # of mappings and lists in each other

_INTEGER = re.compile(r"^[-+]?\d[\d_]*$|^[-+]?0x[\da-fA-F_]+$")
_DOTTED = re.compile(r"[a-z_]\w*(\.\w+)*")  # a key in its sections, or the place in a list
_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")  # a number with a decimal comma
_FLOAT = re.compile(r"^[-+]?\d[\d_]*(\.[\d_]*)?([eE][-+]?\d+)?$|^[-+]?\.\d[\d_]*([eE][-+]?\d+)?$|^[-+]?\.inf$|^\.nan$")


_texts: dict[str, str] = {}  # by path, as last read


class DocumentError(Exception):
    """A file that cannot be used: one line for each error, FILE:LINE: KEY: what is wrong, what is allowed."""


WHOLE_FILE = "(file)"  # in place of a key, where what is wrong is in none

Confidence = Literal["certain", "probable", "cannot tell"]  # of what a page or a report says


class StrictRecord(BaseModel):
    """Base of all configuration records: unknown keys are errors, a number is a number, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True, defer_build=True)


class _NotAllowedError(yaml.MarkedYAMLError):
    """YAML that no file of ours needs."""


class _Loader(yaml.SafeLoader):
    """SafeLoader with the scalars of YAML 1.2 (null, true, false, numbers, text), no aliases and no tags, and bounds.

    An alias is refused, not followed: nine of them in a line make a file of 300 bytes a million entries.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._entries = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """One value with all that is in it. Raises ComposerError."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        self._entries += 1
        refusal = None
        if isinstance(event, yaml.AliasEvent):
            refusal = f"the alias *{event.anchor} is not allowed: write the value itself"
        elif getattr(event, "anchor", None):
            refusal = f"the anchor &{event.anchor} is not allowed: nothing may refer to it, leave it out"
        elif getattr(event, "tag", None):
            refusal = f"the tag {event.tag} is not allowed: leave it out"
        elif self._depth >= DEEPEST:
            refusal = f"mappings and lists in each other are not allowed deeper than {DEEPEST}"
        elif self._entries > MOST_ENTRIES:
            refusal = f"more than {MOST_ENTRIES} values are not allowed in a file"
        if refusal is not None:
            raise _NotAllowedError(problem=refusal, problem_mark=event.start_mark)
        self._depth += 1
        node: yaml.Node | None = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_number(self, node: yaml.ScalarNode) -> int:
        """A whole number; a leading zero does not make it octal."""
        text = node.value.replace("_", "")
        if len(text) > MOST_DIGITS:
            problem = f"a number of {len(text)} digits is not allowed"
            raise _NotAllowedError(problem=problem, problem_mark=node.start_mark)
        return int(text, 16 if "x" in text else 10)


# of YAML 1.1 null is left: its other booleans, base 60, dates, octal numbers and merged keys are text in 1.2
_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in (
    ("null", re.compile(r"^(~|null|Null|NULL|)$"), ["~", "n", "N", ""]),
    ("bool", re.compile(r"^(true|false)$"), list("tf")),
    ("int", _INTEGER, list("-+0123456789")),  # the float pattern matches whole numbers too: this one goes first
    ("float", _FLOAT, list("-+0123456789.")),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", _pattern, _first)
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_number)


def _walk(node: yaml.Node, path: Location, lines: dict[Location, int], errors: list[tuple[int, str]]) -> None:
    """Collect the line of every key and item, and the keys that stand twice in one mapping."""
    lines.setdefault(path, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        seen: dict[str, int] = {}
        earlier, number = "", ""
        for key_node, value_node in node.value:
            key = str(key_node.value)
            line = key_node.start_mark.line + 1
            if node.flow_style and value_node.value == "" and _COMMA.fullmatch(f"{number},{key}"):
                place = ".".join(map(str, (*path, earlier)))
                errors.append((line, f"{place}: write {number}.{key}, with a decimal point (got {number},{key})"))
            earlier, number = key, value_node.value if isinstance(value_node, yaml.ScalarNode) else ""
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
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark is not None else ""
        kind = "" if isinstance(error, _NotAllowedError) else "not valid YAML: "
        text = error.problem or error.context or ""
        remedy = ": indent with blanks, YAML takes no tabs" if "'\\t'" in text else ""
        raise DocumentError(f"{name}{line}: {kind}{text}{remedy}") from None
    except yaml.reader.ReaderError as error:
        line = f":{text.count(chr(10), 0, error.position) + 1}"
        raise DocumentError(f"{name}{line}: not valid YAML: the character {text[error.position]!a}") from None
    lines: dict[Location, int] = {}
    errors: list[tuple[int, str]] = []
    if node is not None:
        _walk(node, (), lines, errors)
    if errors:
        raise DocumentError("\n".join(f"{name}:{line}: {text}" for line, text in errors))
    return data, lines


def read_text(path: Path, largest_bytes: int = LARGEST_BYTES) -> str:
    """The file's text. Raises DocumentError with the reason when it cannot be read."""
    try:
        with path.open("rb") as file:
            content = file.read(largest_bytes + 1)
        if len(content) > largest_bytes:
            most = f"larger than {largest_bytes} bytes, which no file of this kind is"
            raise DocumentError(f"{path}: {most}: a text file is needed here")
        text = content.decode("utf-8")
    except FileNotFoundError:
        raise DocumentError(no_such_file(path)) from None
    except OSError as error:
        raise DocumentError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise DocumentError(f"{path}: not UTF-8 text (byte {error.start})") from None
    if len(text) <= LARGEST_BYTES:
        _texts.pop(str(path), None)
        _texts[str(path)] = text
        for oldest in list(_texts)[:-MOST_KEPT]:
            _texts.pop(oldest, None)
    return text


def no_such_file(path: Path) -> str:
    """The message for a file that is not there, with one beside it that has nearly its name."""
    beside = [found.stem for found in path.parent.glob(f"*{path.suffix}") if found.is_file()]
    near = difflib.get_close_matches(path.stem, beside, 1)
    hint = f": did you mean '{near[0]}{path.suffix}'?" if near else ""
    return f"{path}: cannot be read: No such file or directory{hint}"


def require_named(path: str | Path, key: str, named: Path) -> Path:
    """The file that a key of the file `path` names. Raises DocumentError with FILE:LINE: KEY where it is not there."""
    if not named.exists():
        refuse(path, [(key, no_such_file(named))])
    return named


def load(path: str | Path, record: type[M]) -> M:
    """Read and check a file. Raises DocumentError with every error in it."""
    path = Path(path)
    data, lines = parse(read_text(path), str(path))
    return check(data, record, str(path), lines)


def load_json(path: Path) -> Any:
    """A file that programs write, as it is. Raises DocumentError."""
    try:
        return json.loads(read_text(path, LARGEST_JSON_BYTES))
    except json.JSONDecodeError as error:
        raise DocumentError(f"{path}:{error.lineno}: not JSON: {error.msg}") from None
    except (ValueError, RecursionError):
        raise DocumentError(f"{path}: not JSON that a program would write") from None


def json_object(text: str | bytes) -> dict[str, Any]:
    """A JSON object as RFC 8259 has it, each key once. Raises ValueError for anything else, however deep it is."""
    try:
        found = json.loads(text, parse_constant=_no_constant, object_pairs_hook=_once)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if not isinstance(found, dict):
        raise ValueError("not an object")
    return found


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a key is given twice")
    return found


def check(data: Any, record: type[M], name: str, lines: dict[Location, int] | None = None) -> M:
    """Check parsed data against a record, an older format brought up to date. Raises DocumentError with every error."""
    lines = lines or {}
    field = record.model_fields.get("format")
    kind = None if field is None else str(field.default).split("/")[1]
    data = up_to_date(data, kind, name, lines)
    try:
        return record.model_validate(data)
    except ValidationError as error:
        found = sorted(_sentence(record, data, e, name, lines) for e in error.errors())
        raise DocumentError("\n".join(text for _, text in found)) from None


def up_to_date(data: Any, kind: str | None, name: str, lines: dict[Location, int] | None = None) -> Mapping[str, Any]:
    """A parsed file of this kind (of `formats`; None: of none) as today's program writes it. Raises DocumentError."""
    if not isinstance(data, dict):
        raise DocumentError(f"{name}:1: a mapping of keys to values is needed, this is {_kind_of(data)}")
    if kind is None:
        return data
    try:
        return migrated(data, kind)
    except FormatError as error:
        raise DocumentError(f"{name}:{_line_of(lines or {}, ('format',))}: format: {error}") from None


def refuse_argument(name: str, problems: Iterable[tuple[str, str]]) -> None:
    """Raise DocumentError, if there are any (dotted key, what is wrong with it), of an argument that no file holds."""
    found = list(problems)
    if found:
        raise DocumentError("\n".join(f"{name}: {key}: {text}" for key, text in found))


def refuse(path: str | Path, problems: Iterable[tuple[str, str]], lines: dict[Location, int] | None = None) -> None:
    """Raise DocumentError, if there are any (dotted key, what is wrong with it): FILE:LINE: KEY: TEXT each.

    Without `lines` they are those of the text that was read last: the file may have changed since, or its disk hang.
    """
    found = list(problems)
    if found:
        if lines is None:
            _, lines = parse(_texts.get(str(path)) or read_text(Path(path)), str(path))
        raise DocumentError(
            "\n".join(f"{path}:{_line_of(lines, location_of(key))}: {key}: {text}" for key, text in found)
        )


def location_of(key: str) -> Location:
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
    location = _keys_only(error, data)
    message = what_is_wrong(error, record, data)
    key, said = key_of(error, data), message.partition(": ")
    if error["type"] == "value_error" and _DOTTED.fullmatch(said[0]):  # a check of several keys names the one at fault
        inner = (*location, *location_of(said[0]))
        if inner[: len(location) + 1] in lines:
            location, key, message = inner, ".".join(map(str, inner)), said[2]
    line = _line_of(lines, location)
    if error["type"] == "extra_forbidden":
        known = _known_keys(data, location, record)
        close = difflib.get_close_matches(str(location[-1]), known, 1, cutoff=0.55)
        message += f"; did you mean '{close[0]}'?" if close else f"; known here: {', '.join(known)}"
    place = f"{name}:{line}" if lines else name  # of values that are in no file there is no line
    return line, f"{place}: {key}: {message}"


NEEDED = {  # by the type of pydantic's error
    "extra_forbidden": "unknown key",
    "missing": "missing",
    "finite_number": "a finite number is needed",
    "bool_type": "true or false is needed",
    "string_type": "text is needed (in quotes, where it looks like something else)",
    "string_pattern_mismatch": "text like {pattern} is needed",
    "string_too_long": "at most {max_length} characters are allowed",
    "string_too_short": "at least {min_length} characters are needed",
    "literal_error": "{expected} is needed",
    "too_short": "at least {min_length} entries are needed",
    "too_long": "at most {max_length} entries are allowed",
    "list_type": "a list is needed",
    "tuple_type": "a list is needed",
    "dict_type": "a mapping of keys to values is needed",
    "model_type": "a mapping of keys to values is needed",
    "model_attributes_type": "a mapping of keys to values is needed",
    "union_tag_not_found": "missing",
    "union_tag_invalid": "'{tag}' is none of {expected_tags}",
    "value_error": "{error}",
}
WHOLE = ("int_type", "int_from_float")
NUMBERS = ("float_type", "greater_than", "greater_than_equal", "less_than", "less_than_equal", *WHOLE)


def what_is_wrong(error: ErrorDetails, record: type[BaseModel], data: Any) -> str:
    """What a value must be and what it is, of an error that pydantic found in `data`; of a number its range too."""
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    if kind in NUMBERS:
        limits = {**_limits(record, data, _keys_only(error, data)), **context}
        text = f"a {'whole ' if kind in WHOLE else ''}number{_range(limits)} is needed"
        if kind in WHOLE and isinstance(value, float) and value.is_integer():
            return f"{text}: write {value:.0f} (got {_shown(value)})"
        if isinstance(value, str) and _COMMA.fullmatch(value):
            return f"{text}: write {value.replace(',', '.')}, with a decimal point (got {_shown(value)})"
    else:
        text = NEEDED.get(kind, "a value of another kind is needed").format(**context)
    self_explanatory = kind in ("extra_forbidden", "missing") or isinstance(value, dict | list)
    return text if self_explanatory else f"{text} (got {_shown(value)})"


def key_of(error: ErrorDetails, data: Any) -> str:
    """The dotted key in `data` that an error of pydantic's is about."""
    return ".".join(map(str, _keys_only(error, data))) or WHOLE_FILE


def wrong_parameters(error: ValidationError, record: type[BaseModel], given: Any) -> list[str]:
    """What is wrong with the parameters of a request, one sentence each."""
    found = error.errors()
    # a name or an object: of an object, only what is wrong as one
    found = [e for e in found if e["type"] != "string_type" or not isinstance(e["input"], dict)] or found
    texts = (f"{key_of(e, given)}: {what_is_wrong(e, record, given)}".removeprefix(f"{WHOLE_FILE}: ") for e in found)
    return list(dict.fromkeys(text.replace("unknown key", "unknown parameter") for text in texts))


def _limits(record: type[BaseModel], data: Any, location: Location) -> dict[str, float]:
    """The bounds of the number at a location by their names in pydantic: ge, gt, le, lt."""
    found: dict[str, float] = {}
    for depth in range(len(location), 0, -1):  # of an entry of a list: those of the list's key
        for owner in _records_at(data, location[:depth], record) if isinstance(location[depth - 1], str) else ():
            field = owner.model_fields.get(str(location[depth - 1]))
            for bound in _metadata(field.annotation, field.metadata) if field is not None else ():
                found |= {key: getattr(bound, key) for key in ("ge", "gt", "le", "lt") if hasattr(bound, key)}
            return found
    return found


def _metadata(annotation: Any, own: Iterable[Any]) -> list[Any]:
    """What is annotated on a field, and on the alternatives of a union in it."""
    inner = [part for argument in getattr(annotation, "__args__", ()) for part in getattr(argument, "__metadata__", ())]
    return [*(part for item in inner for part in getattr(item, "metadata", [item])), *own]


def _range(limits: Mapping[str, float]) -> str:
    """The range of a number in words, with a blank in front; nothing where it has none."""
    low = f" from {limits['ge']:.10g}" if "ge" in limits else f" above {limits['gt']:.10g}" if "gt" in limits else ""
    if "le" in limits:
        return f"{low}{' to' if 'ge' in limits else ' and up to' if low else ' up to'} {limits['le']:.10g}"
    if "lt" in limits:
        return f"{low}{' and' if low else ''} below {limits['lt']:.10g}"
    return f"{low} up" if "ge" in limits else low


def _shown(value: Any) -> str:
    """A value as YAML and JSON have it, cut where it is long."""
    text = json.dumps(value, ensure_ascii=False) if isinstance(value, bool | None) else repr(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."


def _kind_of(value: Any) -> str:
    """What a value is, in the words of YAML and JSON."""
    names: list[tuple[Any, str]] = [
        (bool, "true or false"), (int | float, "a number"), (str, "text"), (list, "a list"), (type(None), "nothing")
    ]  # fmt: skip
    return next((name for kind, name in names if isinstance(value, kind)), "something else")


def _keys_only(error: ErrorDetails, data: Any) -> Location:
    """Where an error is, without the tags that pydantic adds for unions: what is in the data, and a missing key."""
    path: list[str | int] = []
    for position, part in enumerate(error["loc"], 1):
        inside = isinstance(data, dict) and isinstance(part, Hashable) and part in data
        if inside or (isinstance(data, list) and isinstance(part, int) and part < len(data)):
            data = data[part]
            path.append(part)
        elif position == len(error["loc"]) and error["type"] == "missing":
            path.append(part)
    if error["type"].startswith("union_tag_"):
        path.append(error["ctx"]["discriminator"].strip("'"))
    return tuple(path)


def _known_keys(data: Any, location: Location, record: type[BaseModel]) -> list[str]:
    """Field names of the record in which the last part of `location` stands."""
    return [key for candidate in _records_at(data, location, record) for key in candidate.model_fields]


def _records_at(data: Any, location: Location, record: type[BaseModel]) -> list[type[BaseModel]]:
    """The records in which the last part of `location` may stand: several in a union whose tag is wrong."""
    candidates: list[type[BaseModel]] = [record]
    for part in location[:-1]:
        data = data[part]
        following: list[type[BaseModel]] = []
        for candidate in candidates:
            field = candidate.model_fields.get(str(part))
            following.extend(_records_in(field.annotation if field else None) if field else [])
        candidates = following or candidates
    return [candidate for candidate in candidates if _tag_matches(candidate, data)] or candidates


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


def counted(number: int, noun: str) -> str:
    """A number with its noun: 1 run, 2 runs."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def finite(value: float) -> float | None:
    """A number as JSON has it: None for nan and infinities."""
    return float(value) if math.isfinite(value) else None


def as_json(value: Any, not_finite: Callable[[float], float | str | None] = finite) -> Any:
    """A value in terms of JSON: arrays as lists, nan and infinities by `not_finite`, what JSON cannot say as text."""
    if isinstance(value, Mapping):
        return {str(key): as_json(item, not_finite) for key, item in value.items()}
    if hasattr(value, "tolist"):  # of numpy, which the command line of the daemon does not load
        return as_json(value.tolist(), not_finite)
    if isinstance(value, list | tuple | set | frozenset):
        return [as_json(item, not_finite) for item in value]
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else not_finite(value)
    return str(value)


def accepts(record: type[BaseModel], values: Any) -> bool:
    """Whether values make such a record."""
    try:
        record.model_validate(values)
    except ValidationError:
        return False
    return True


def sentence(text: str) -> str:
    """A phrase with a capital letter and a full stop."""
    return f"{text[0].upper()}{text[1:]}."


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The tail of a message about an unknown name: the nearest known ones, else all of them."""
    names = sorted(set(known))
    lowered = {candidate.lower(): candidate for candidate in names}
    near = [lowered[match] for match in difflib.get_close_matches(name.lower(), lowered, n=3)]
    if near:
        return "did you mean " + " or ".join(repr(candidate) for candidate in near) + "?"
    return "there is " + (", ".join(names) if names else "nothing") + "."

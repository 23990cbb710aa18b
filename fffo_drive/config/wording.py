"""What is wrong with the parameters of a request, in words: name, what is wanted there with its range, what came."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

SHOWN = 40  # characters of a wrong value

Schema = Mapping[str, Any]
Place = tuple[str | int, ...]

_TYPES = {
    "number": "a number", "integer": "a whole number", "boolean": "true or false", "string": "a text",
    "array": "a list", "object": "an object", "null": "null",
}  # fmt: skip
_BOUNDS = {
    "minimum": "from {}", "exclusiveMinimum": "above {}", "maximum": "up to {}", "exclusiveMaximum": "below {}",
    "minLength": "of {} characters at least", "maxLength": "of {} characters at most",
    "minItems": "of {} entries at least", "maxItems": "of {} entries at most",
}  # fmt: skip


def sentences(schema: Schema, given: Mapping[str, Any], error: ValidationError) -> list[str]:
    """One for each place that is wrong; `schema` is that of the record, `given` what was checked."""
    found = {_place(problem, given): problem for problem in error.errors()}
    # where one of several kinds is possible, each complains; the innermost knows which was meant
    told = [place for place in found if not any(other != place and other[: len(place)] == place for other in found)]
    return [_sentence(schema, given, place, found[place]) for place in told]


def _place(problem: ErrorDetails, given: Any) -> Place:
    """The location without the names of kinds that pydantic adds: what was given, and a missing key."""
    place: list[str | int] = []
    for part in problem["loc"]:
        if part in given if isinstance(given, dict) else isinstance(given, list) and isinstance(part, int):
            given = given[part]
            place.append(part)
    return (*place, problem["loc"][-1]) if problem["type"] == "missing" else tuple(place)


def _sentence(schema: Schema, given: Any, place: Place, problem: ErrorDetails) -> str:
    where = ".".join(map(str, place)) or "the request"
    if problem["type"] == "extra_forbidden":
        return f"{where} is no parameter"
    if problem["type"] == "value_error":  # of a record of ours, in its own words
        return f"{where}: {problem['ctx']['error']}"
    root = schema
    for part in place:
        schema = _inside(_chosen(root, schema, given), part)
        given = given.get(part) if isinstance(given, dict) else given[part]
    wanted = _wanted(root, schema)
    if problem["type"] == "missing":
        return f"{where}: wanted {wanted}, got nothing"
    return f"{where}: wanted {wanted}, got {json.dumps(given)[:SHOWN]}"


def _chosen(root: Schema, schema: Schema, given: Any) -> Schema:
    """The schema that what was given is meant for, of several that are possible."""
    schema = _resolved(root, schema)
    for one in _choices(root, schema):
        kind = one.get("properties", {}).get("kind", {}).get("const")
        if isinstance(given, dict) and kind is not None and kind == given.get("kind"):
            return one
    return schema


def _choices(root: Schema, schema: Schema) -> list[Schema]:
    alternatives = [_resolved(root, one) for one in (*schema.get("anyOf", ()), *schema.get("oneOf", ()))]
    return [last for one in alternatives for last in (_choices(root, one) or [one])]


def _inside(schema: Schema, part: str | int) -> Schema:
    ahead = schema.get("properties", {}) if isinstance(part, str) else dict(enumerate(schema.get("prefixItems", ())))
    found: Schema = ahead.get(part) or schema.get("items") or {}
    return found


def _resolved(root: Schema, schema: Schema) -> Schema:
    name = schema.get("$ref", "").removeprefix("#/$defs/")
    found: Schema = root["$defs"][name] if name else schema
    return found


def _wanted(root: Schema, schema: Schema) -> str:
    """Type and range."""
    schema = _resolved(root, schema)
    if choices := _choices(root, schema):
        return str(schema.get("description") or " or ".join(dict.fromkeys(_wanted(root, one) for one in choices)))
    if "const" in schema:
        return json.dumps(schema["const"])
    if "enum" in schema:
        return f"one of {', '.join(map(str, schema['enum']))}"
    words = [_TYPES.get(str(schema.get("type")), "another value")]
    words += [text.format(f"{schema[name]:g}") for name, text in _BOUNDS.items() if name in schema]
    return " ".join(words)

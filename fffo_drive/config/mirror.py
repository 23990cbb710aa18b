"""Checked records made from the dataclasses of the simulated drive, so that no key stands in two places.

The dataclasses carry unit, range and meaning in their fields' metadata; this makes the pydantic record of them that a
YAML file is read into, and turns the record back into the dataclass.
"""

from __future__ import annotations

import dataclasses
import functools
import typing
from collections.abc import Mapping
from enum import IntEnum
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, Strict, create_model

from ..documents import StrictRecord
from ..drive.simulated.ranges import NOT_IN_A_FILE, key_of, note_of

T = TypeVar("T")


@functools.cache
def record_of(dataclass: type) -> type[StrictRecord]:
    """The record with the keys, ranges, defaults and meanings of a dataclass."""
    hints = typing.get_type_hints(dataclass)
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(dataclass):
        if not field.init or field.metadata.get(NOT_IN_A_FILE):
            continue
        annotation = _annotation(hints[field.name])
        limits = key_of(field)
        if limits is not None:
            text = limits.meaning if limits.unit == "-" else f"{limits.meaning} [{limits.unit}]"
            annotation = Annotated[annotation, Field(ge=limits.low, le=limits.high, description=text)]
        elif note_of(field) is not None:
            annotation = Annotated[annotation, Field(description=note_of(field))]
        if field.default is not dataclasses.MISSING:
            fields[field.name] = (annotation, field.default)
        elif field.default_factory is not dataclasses.MISSING:
            fields[field.name] = (annotation, Field(default_factory=_record_default(field)))
        else:
            fields[field.name] = (annotation, ...)
    return create_model(dataclass.__name__, __base__=StrictRecord, __doc__=dataclass.__doc__, **fields)


def dataclass_of(dataclass: type[T], record: Any) -> T:
    """The dataclass with the values of its record."""
    hints = typing.get_type_hints(dataclass)
    values = {
        field.name: _value(hints[field.name], getattr(record, field.name))
        for field in dataclasses.fields(dataclass)  # type: ignore[arg-type]
        if field.init and not field.metadata.get(NOT_IN_A_FILE)
    }
    return dataclass(**values)


def _annotation(hint: Any) -> Any:
    """The hint with every dataclass in it replaced by its record, tuples of them by lists, enumerations by names."""
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return record_of(hint)
    if isinstance(hint, type) and issubclass(hint, IntEnum):
        return Literal[tuple(member.name.lower() for member in hint)]
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is tuple and len(arguments) == 2 and arguments[1] is Ellipsis:
        return Annotated[list[_annotation(arguments[0])], Strict(False)]  # type: ignore[misc]  # tuples of defaults
    if origin is Mapping or (isinstance(origin, type) and issubclass(origin, Mapping)):
        return dict[arguments[0], arguments[1]]  # type: ignore[valid-type]
    return hint


def _record_default(field: dataclasses.Field[Any]) -> Any:
    """A factory of the record's default from the dataclass's."""
    factory: Any = field.default_factory

    def make() -> Any:
        value = factory()
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            return record_of(type(value)).model_validate(dataclasses.asdict(value))
        return value

    return make


def _value(hint: Any, value: Any) -> Any:
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return dataclass_of(hint, value)
    if isinstance(hint, type) and issubclass(hint, IntEnum):
        return hint[value.upper()]
    arguments = typing.get_args(hint)
    if typing.get_origin(hint) is tuple and len(arguments) == 2 and arguments[1] is Ellipsis:
        return tuple(_value(arguments[0], item) for item in value)
    return value

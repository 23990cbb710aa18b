"""Records to flat arrays of float64 and back, made from the records' own definitions: no place is counted by hand.

A record is a NamedTuple whose fields are float, int, bool or another such record. The functions that read one back,
and those that write one without making an array, are plain functions that numba compiles: hand them to `njit`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, get_type_hints

import numpy as np


def flat_names(record: type[Any], prefix: str = "") -> tuple[str, ...]:
    """Names of the numbers of a packed record, in their order; those of an inner record as `outer.inner`."""
    return tuple(_names(record, prefix))


def _names(record: type[Any], prefix: str) -> Iterator[str]:
    hints = get_type_hints(record)
    for name in record._fields:
        if hasattr(hints[name], "_fields"):
            yield from _names(hints[name], f"{prefix}{name}.")
        else:
            yield prefix + name


def pack(record: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The numbers of a record, shape (len(flat_names),)."""
    return np.array(list(_numbers(record)), dtype=np.float64)


def _numbers(record: Any) -> Iterator[float]:
    for value in record:
        if hasattr(value, "_fields"):
            yield from _numbers(value)
        else:
            yield float(value)


def reader(record: type[Any], called: str) -> Callable[[Any], Any]:
    """The function `called(block)` that makes a record of its packed numbers."""
    classes: dict[str, type[Any]] = {}
    places = iter(range(len(flat_names(record))))
    body = _construction(record, classes, places)
    text = f"def {called}(block):\n    return {body}\n"
    space: dict[str, Any] = dict(classes)
    exec(compile(text, __file__, "exec"), space)  # this file: numba keeps compiled code of dated files alone
    made: Callable[[Any], Any] = space[called]
    made.__doc__ = f"{record.__name__} from the {len(flat_names(record))} numbers of `pack`."
    made.__module__ = record.__module__
    return made


def writer(record: type[Any], called: str) -> Callable[[Any, Any], None]:
    """The function `called(record, block)` that writes the numbers of `pack` into the front of an array."""
    lines = [f"    block[{place}] = {value}" for place, value in enumerate(_values(record, "record"))]
    text = "\n".join([f"def {called}(record, block):", *lines, ""])
    space: dict[str, Any] = {}
    exec(compile(text, __file__, "exec"), space)
    made: Callable[[Any, Any], None] = space[called]
    made.__doc__ = f"The {len(lines)} numbers of {record.__name__}, as `pack` has them, into `block`."
    made.__module__ = record.__module__
    return made


def _values(record: type[Any], place: str) -> Iterator[str]:
    hints = get_type_hints(record)
    for name in record._fields:
        kind = hints[name]
        if hasattr(kind, "_fields"):
            yield from _values(kind, f"{place}.{name}")
        else:
            yield f"1.0 if {place}.{name} else 0.0" if kind is bool else f"float({place}.{name})"


def _construction(record: type[Any], classes: dict[str, type[Any]], places: Iterator[int]) -> str:
    classes[record.__name__] = record
    hints = get_type_hints(record)
    parts = []
    for name in record._fields:
        kind = hints[name]
        if hasattr(kind, "_fields"):
            parts.append(_construction(kind, classes, places))
        elif kind in (int, bool):
            number = f"block[{next(places)}]"
            parts.append(f"int({number})" if kind is int else f"{number} != 0.0")
        else:
            parts.append(f"block[{next(places)}]")
    return f"{record.__name__}({', '.join(parts)})"

"""Messages of numbers, texts and lists of them in CDR (OMG DDSI-RTPS 10.2, plain, little-endian), from one field list.

Rows are blocks of memory and do not need this; events, records and messages to viewers are encoded here.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from .schema import CDR_HEADER

_PACKED = {
    "float64": "<d", "int64": "<q", "uint64": "<Q", "uint32": "<I", "uint8": "<B", "bool": "<?",
}  # fmt: skip
_LIST = "[]"


class Field(NamedTuple):
    """One field of a message."""

    kind: str  # of ROS 2: a number, string, or a list of either (float64[])
    name: str
    unit: str
    meaning: str


def schema_of(title: str, fields: Sequence[Field]) -> str:
    """The `ros2msg` definition, unit and meaning as comments."""
    lines = [f"{field.kind} {field.name}  # [{field.unit}] {field.meaning}" for field in fields]
    return "\n".join((f"# {title}", *lines)) + "\n"


def encode(values: Iterable[tuple[str, Any]]) -> bytes:
    """Kinds and values, in their order, with the CDR header. Text: UTF-8, without zero bytes."""
    out = bytearray()
    for kind, value in values:
        if kind.endswith(_LIST):
            _append(out, "uint32", len(value))
            for item in value:
                _append(out, kind.removesuffix(_LIST), item)
        else:
            _append(out, kind, value)
    return CDR_HEADER + bytes(out)


def _append(out: bytearray, kind: str, value: Any) -> None:
    if kind == "string":
        raw = str(value).encode("utf-8", "replace").replace(b"\0", b"") + b"\0"
        _append(out, "uint32", len(raw))
        out += raw
        return
    layout = _PACKED[kind]
    out += bytes(-len(out) % struct.calcsize(layout)) + struct.pack(layout, value)


def decode(payload: bytes, fields: Sequence[Field]) -> Mapping[str, Any]:
    """The values of a message by name, the inverse of `encode`; lists as tuples.

    Raises ValueError for bytes that are not such a message.
    """
    if payload[:2] != CDR_HEADER[:2]:
        raise ValueError("a message that is not little-endian CDR")
    reader = _Reader(payload[len(CDR_HEADER) :])
    try:
        return {field.name: reader.take(field.kind) for field in fields}
    except struct.error:
        raise ValueError("a message that is cut off") from None


class _Reader:
    def __init__(self, body: bytes) -> None:
        self._body = body
        self._at = 0

    def take(self, kind: str) -> Any:
        if kind.endswith(_LIST):
            count = self.take("uint32")
            if count > len(self._body):  # each item takes a byte at least
                raise ValueError(f"a list of {count} items in a message of {len(self._body)} bytes")
            return tuple(self.take(kind.removesuffix(_LIST)) for _ in range(count))
        if kind == "string":
            length = self.take("uint32")
            raw = self._body[self._at : self._at + length]
            if len(raw) != length:
                raise ValueError("a message that is cut off")
            self._at += length
            return raw.removesuffix(b"\0").decode()
        layout = _PACKED[kind]
        self._at += -self._at % struct.calcsize(layout)
        (value,) = struct.unpack_from(layout, self._body, self._at)
        self._at += struct.calcsize(layout)
        return value

"""The row as a ROS 2 message: schema text and CDR layout made from `signals.SIGNALS`, and the way back.

A row is a flat message of numbers in falling order of size, so its CDR encoding (OMG DDSI-RTPS 10.2,
little-endian) is the 4-byte encapsulation header followed by the bytes of the NumPy record. Files of other
versions have other fields: they are read by the schema they carry, never by today's list.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..signals import SIGNALS, Signal
from .errors import RecordingError

PROFILE = "ros2"
MESSAGE_ENCODING = "cdr"
SCHEMA_ENCODING = "ros2msg"
ROW_TOPIC = "/fffo_drive/row"
ROW_TYPE = "fffo_drive_msgs/msg/Row"
EVENT_TOPIC = "/fffo_drive/events"
EVENT_TYPE = "fffo_drive_msgs/msg/Event"
CDR_HEADER = bytes((0, 1, 0, 0))  # plain CDR, little-endian, no options

METADATA_NAME = "fffo_drive"  # written first: what, with what, when
SUMMARY_NAME = "fffo_drive_summary"  # written last: counts, how it ended

_ROS_TYPES = {
    "u1": "uint8",
    "u2": "uint16",
    "u4": "uint32",
    "u8": "uint64",
    "i1": "int8",
    "i2": "int16",
    "i4": "int32",
    "i8": "int64",
    "f4": "float32",
    "f8": "float64",
    "b1": "bool",
}
_NUMPY_TYPES = {ros: kind for kind, ros in _ROS_TYPES.items()} | {"byte": "u1", "char": "u1"}
LONGEST_ARRAY = 65_536  # numbers in a field of a row
_FIELD = re.compile(r"(?P<type>[\w/]+)(?:\[(?P<count>\d*)\])?\s+(?P<name>\w+)(?P<rest>.*)")
_COMMENT = re.compile(r"\s*(?:\[(?P<unit>[^\]]*)\])?\s*(?P<meaning>.*)")


class RowLayout(NamedTuple):
    """A message of numbers as NumPy sees it behind the CDR header."""

    dtype: np.dtype[np.void]
    units: dict[str, str]
    meanings: dict[str, str]


def message_dtype(payload_size: int) -> np.dtype[np.void]:
    """One MCAP Message record (opcode 0x05) with a payload of fixed size, packed as in a chunk."""
    return np.dtype(
        [
            ("opcode", "u1"),
            ("length", "<u8"),
            ("channel", "<u2"),
            ("sequence", "<u4"),
            ("log_time", "<u8"),
            ("publish_time", "<u8"),
            ("payload", f"V{payload_size}"),
        ]
    )


def schema_text(signals: Sequence[Signal] = SIGNALS, title: str = "One tick of the velocity loop.") -> str:
    """The `ros2msg` definition of a row, unit and meaning as comments."""
    lines = [f"# {title}"]
    for signal in signals:
        kind = np.dtype(signal.dtype)
        ros_type = _ROS_TYPES.get(kind.str[1:])
        if ros_type is None:
            raise RecordingError(f"signal {signal.name}: NumPy type {signal.dtype!r} has no ROS 2 counterpart")
        lines.append(f"{ros_type} {signal.name}  # [{signal.unit}] {' '.join(signal.meaning.split())}")
    return "\n".join(lines) + "\n"


def layout_from_schema(text: str) -> RowLayout:
    """NumPy layout, units and meanings of a flat `ros2msg` definition; each number aligned to its own size.

    Raises `RecordingError` with the line for strings, sequences and nested types, which have no fixed place.
    """
    names: list[str] = []
    formats: list[Any] = []
    offsets: list[int] = []
    units: dict[str, str] = {}
    meanings: dict[str, str] = {}
    end = 0
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("==="):
            break  # definitions of nested types follow
        declaration, _, comment = line.partition("#")
        field = _FIELD.fullmatch(declaration.strip())
        if field is None:
            if declaration.strip():
                raise RecordingError(f"schema line {number}: cannot read {line.strip()!r} as 'type name'")
            continue
        if "=" in field["rest"]:
            continue  # a constant takes no room
        kind = _NUMPY_TYPES.get(field["type"])
        if kind is None or field["count"] == "":
            raise RecordingError(f"schema line {number}: {line.strip()!r} is no number of fixed size")
        scalar = np.dtype(f"<{kind}")
        end += -end % scalar.itemsize
        names.append(field["name"])
        formats.append((scalar, (int(field["count"]),)) if field["count"] else scalar)
        offsets.append(end)
        if int(field["count"] or 1) > LONGEST_ARRAY:
            raise RecordingError(f"schema line {number}: {line.strip()!r} has more than {LONGEST_ARRAY} numbers")
        end += np.dtype(formats[-1]).itemsize
        note = _COMMENT.fullmatch(comment)
        units[field["name"]] = (note["unit"] if note else None) or "-"
        meanings[field["name"]] = (note["meaning"].strip() if note else "") or ""
    if len(set(names)) != len(names):
        raise RecordingError("schema: a field name stands twice")
    layout = {"names": names, "formats": formats, "offsets": offsets, "itemsize": end}
    return RowLayout(np.dtype(layout), units, meanings)  # type: ignore[call-overload]

"""Events: what happens outside the ticks (state changes, faults, parameters, gaps in the recording).

They travel as CDR like the rows, because a file of profile `ros2` may hold nothing else: readers of that
profile refuse it if a channel has a JSON schema. Free-form content is a JSON object in `data`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from enum import IntEnum
from typing import Any, NamedTuple

from ..documents import as_json, json_object
from ..units import NS_PER_S
from .cdr import Field, decode, encode, schema_of

EVENT_FIELDS = (
    Field("uint64", "time_ns", "ns", "wall clock, Unix epoch"),
    Field("uint8", "level", "-", "10 debug, 20 info, 30 warning, 40 error, 50 fatal"),
    Field("string", "source", "-", "who says so: loop, supervisor, drive, recorder"),
    Field("string", "text", "-", "one sentence for people"),
    Field("string", "data", "-", "JSON object for programs"),
)
EVENT_SCHEMA = schema_of("What happened beside the ticks.", EVENT_FIELDS)


class Level(IntEnum):
    """Severity; the numbers of rcl_interfaces/msg/Log and of Python's logging."""

    DEBUG = 10
    INFO = 20
    WARNING = 30
    ERROR = 40
    FATAL = 50


class Event(NamedTuple):
    """One event. `data` holds what JSON holds; numbers that JSON lacks (NaN, inf) come back as strings."""

    time_ns: int  # wall clock, Unix epoch
    level: int
    source: str
    text: str
    data: Mapping[str, Any] = {}

    @property
    def time(self) -> str:
        """Time in UTC, ISO 8601, to the nanosecond."""
        return utc_text(self.time_ns)

    def as_dict(self) -> dict[str, Any]:
        """For JSON output."""
        name = Level(self.level).name.lower() if self.level in set(Level) else str(self.level)
        return {
            "time": self.time,
            "level": name,
            "source": self.source,
            "text": self.text,
            "data": as_json(self.data, not_finite=str),
        }


def utc_text(time_ns: int) -> str:
    """Unix time in nanoseconds as ISO 8601 in UTC; the bare number where a calendar has no such year."""
    seconds, rest = divmod(time_ns, NS_PER_S)
    try:
        return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%S") + f".{rest:09d}Z"
    except (OverflowError, ValueError, OSError):
        return f"{time_ns} ns"


def encode_event(event: Event) -> bytes:
    """CDR payload (with header) of `EVENT_SCHEMA`."""
    values = (*event[:4], json_text(event.data))
    return encode((field.kind, value) for field, value in zip(EVENT_FIELDS, values, strict=True))


def decode_event(payload: bytes) -> Event:
    """The inverse of `encode_event`; raises ValueError for bytes that are no event."""
    values = decode(payload, EVENT_FIELDS)
    return Event(**{**values, "data": json_object(values["data"])})


def json_text(data: Mapping[str, Any]) -> str:
    """A JSON object; what JSON cannot say becomes text."""
    return json.dumps(as_json(data, not_finite=str), allow_nan=False)

"""Frames on the WebSocket: text frames are JSON objects with a `kind`; binary frames have a JSON head and numbers.

A binary frame is: length of the head (4 bytes, little-endian), the head (JSON, padded with spaces so that the payload
is aligned to 8 bytes), the payload. Kinds: `rows` has float64 (bins, signals, 3) with minimum, maximum and last value;
`capture` has rows in the layout of `signals.ROW`. The table of fields is made from `SIGNALS`.
"""

from __future__ import annotations

import json
from typing import Any

from ..signals import ROW, SIGNALS

HEAD_BYTES = 4
ALIGNMENT = 8


def text(kind: str, **content: Any) -> str:
    """A text frame."""
    return json.dumps({"kind": kind, **content}, separators=(",", ":"))


def binary(kind: str, payload: bytes, **content: Any) -> bytes:
    """A binary frame."""
    head = text(kind, **content).encode()
    head += b" " * (-(HEAD_BYTES + len(head)) % ALIGNMENT)
    return len(head).to_bytes(HEAD_BYTES, "little") + head + payload


def fields() -> list[dict[str, Any]]:
    """The signals in order, with their types and offsets in a row of a capture."""
    places = ROW.fields
    assert places is not None
    return [
        {"name": s.name, "type": s.dtype, "unit": s.unit, "meaning": s.meaning, "offset": places[s.name][1]}
        for s in SIGNALS
    ]

"""What every reader has to find in a recording, in one form: digests over whole columns, first and last values."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Facts = dict[str, Any]


def facts_of(
    columns: Mapping[str, np.ndarray],
    log_time_ns: np.ndarray,
    events: Sequence[Sequence[Any]],
    records: Sequence[Sequence[Any]],
    attachments: Mapping[str, tuple[str, bytes]],
    metadata: Mapping[str, Mapping[str, str]],
) -> Facts:
    """Columns as float64 (NaN of any payload is one NaN) or int64 modulo 2^64, little-endian; the rest as JSON.

    A record: time_ns, sequence, number, kind, names, values, data.
    """
    return {
        "rows": len(log_time_ns),
        "columns": {name: _column(values) for name, values in columns.items()},
        "log_time_ns": _column(np.asarray(log_time_ns)),
        "events": len(events),
        "event_first": [str(part) for part in events[0]],
        "event_last": [str(part) for part in events[-1]],
        "records": len(records),
        "record_last": [str(part) for part in (*records[-1][:4], *records[-1][4], records[-1][6])],
        "record_values": _column(np.array([value for record in records for value in record[5]], np.float64)),
        "attachments": {
            name: [media_type, len(data), hashlib.sha256(data).hexdigest()]
            for name, (media_type, data) in attachments.items()
        },
        "metadata": {name: dict(entries) for name, entries in metadata.items()},
    }


def _column(values: np.ndarray) -> dict[str, str]:
    if values.dtype.kind == "f":
        numbers = values.astype("<f8")
        numbers[np.isnan(numbers)] = np.nan
    else:
        numbers = values.astype("<u8" if values.dtype == np.uint64 else "<i8")
    raw = numbers.tobytes()
    return {"first": raw[:8].hex(), "last": raw[-8:].hex(), "sha256": hashlib.sha256(raw).hexdigest()}


def disagreements(expected: Facts, found: Facts, place: str = "") -> list[str]:
    """Where two readings differ; what a reader cannot tell (a key that is missing) is passed over."""
    problems = []
    for key, value in found.items():
        name = f"{place}.{key}" if place else key
        if key not in expected:
            problems.append(f"{name}: {json.dumps(value)}, which our reader does not have")
        elif isinstance(value, dict):
            absent = sorted(set(expected[key]) - set(value))
            problems += [f"{name}: {', '.join(absent)} not found"] if absent else []
            problems += disagreements(expected[key], value, name)
        elif value != expected[key]:
            problems.append(f"{name}: {json.dumps(value)}, ours {json.dumps(expected[key])}")
    return problems

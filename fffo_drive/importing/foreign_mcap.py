"""MCAP files of other programs: every numeric field of every topic, whatever the schema (ROS 2, protobuf, JSON)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode

from ..recording.errors import RecordingError
from ..recording.scan import DamagedRecordError, Scanner
from ..units import NS_PER_S
from .evidence import at_stamps
from .names import measured_wrap
from .source import Source, source_of_arrays
from .units import split_name

DEEPEST = 6
LARGEST_ARRAY = 64  # numbers of a message that become columns: an image is no log of an axis


def read_foreign_mcap(path: Path) -> Source:
    """All topics on the time of the one with the most messages: stamps of the header, else those of the log.

    Raises RecordingError for a file that cannot be read, or that has no numbers in it.
    """
    from mcap.exceptions import McapError
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory as Protobuf
    from mcap_ros2.decoder import DecoderFactory as Ros2

    topics: dict[str, list[tuple[int, dict[str, float]]]] = {}  # stamps in ns: seconds since 1970 lose digits
    remarks: list[str] = []
    try:
        _check_chunks(path)
        with path.open("rb") as file:
            reader = make_reader(file)
            decoders: dict[int, Any] = {}
            for schema, channel, message in reader.iter_messages():
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(channel, schema, (Ros2(), Protobuf()))
                    if decoders[channel.id] is None:
                        remarks.append(f"left out: topic {channel.topic} has the encoding {channel.message_encoding!r}")
                decode = decoders[channel.id]
                if decode is None:
                    continue
                numbers = dict(_numbers("", decode(message.data)))
                stamp_ns = _stamp_ns(numbers)
                numbers = {name: value for name, value in numbers.items() if not _is_stamp(name)}
                if numbers:
                    time_ns = message.log_time if stamp_ns is None else stamp_ns
                    topics.setdefault(channel.topic, []).append((time_ns, numbers))
    except (McapError, DamagedRecordError, RecursionError, ValueError, LookupError, EOFError, OSError) as error:
        raise RecordingError(f"{path}: not a readable MCAP file: {error}") from error
    topics = {topic: rows for topic, rows in topics.items() if len(rows) > 1}
    if not topics:
        raise RecordingError(f"{path}: no topic with numbers in it" + ("; " + "; ".join(remarks) if remarks else ""))
    return _joined(path, topics, remarks)


def _check_chunks(path: Path) -> None:
    """Unpack each chunk within its allowance, which mcap's reader does not have. Raises RecordingError."""
    with path.open("rb") as file:
        scanner = Scanner(file, str(path))
        for record in scanner:
            if record.opcode == Opcode.CHUNK:
                scanner.contents(record)


def _decoder(channel: Any, schema: Any, factories: tuple[Any, ...]) -> Any:
    if channel.message_encoding == "json":
        return json.loads
    return next(
        (found for factory in factories if (found := factory.decoder_for(channel.message_encoding, schema))), None
    )


def _numbers(name: str, value: Any, depth: int = 0) -> Iterator[tuple[str, float]]:
    """Numeric fields by names with dots; those of a JointState by the names of its joints."""
    if isinstance(value, (bool, int, float, np.number)):
        yield name, float(value)
    elif isinstance(value, str | bytes) or depth > DEEPEST:
        return
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(f"{name}.{key}" if name else str(key), inner, depth + 1)
    elif hasattr(value, "DESCRIPTOR"):  # protobuf
        for field in value.DESCRIPTOR.fields:
            yield from _numbers(f"{name}.{field.name}" if name else field.name, getattr(value, field.name), depth + 1)
    elif hasattr(value, "__slots__"):  # ROS 2
        joints = list(getattr(value, "name", [])) if isinstance(getattr(value, "name", None), list) else []
        for key in value.__slots__:
            inner = getattr(value, key.lstrip("_"), None)
            label = f"{name}.{key.lstrip('_')}" if name else key.lstrip("_")
            if (
                joints
                and isinstance(inner, (list, np.ndarray))
                and len(inner) == len(joints)
                and key.lstrip("_") != "name"
            ):
                yield from ((f"{joint}.{label}", float(number)) for joint, number in zip(joints, inner, strict=True))
            else:
                yield from _numbers(label, inner, depth + 1)
    elif hasattr(value, "__len__") and len(value) <= LARGEST_ARRAY:
        for k, inner in enumerate(value):
            yield from _numbers(f"{name}[{k}]", inner, depth + 1)


def _is_stamp(name: str) -> bool:
    return name.endswith(("stamp.sec", "stamp.nanosec", "stamp.seconds", "stamp.nanos"))


def _stamp_ns(numbers: dict[str, float]) -> int | None:
    """The stamp of the header, where it has one that was set."""
    parts = {name.rsplit(".", 1)[1]: value for name, value in numbers.items() if _is_stamp(name)}
    seconds = parts.get("sec", parts.get("seconds"))
    if not seconds:
        return None
    return round(seconds) * NS_PER_S + round(parts.get("nanosec", parts.get("nanos", 0.0)))


def _joined(path: Path, topics: dict[str, list[tuple[int, dict[str, float]]]], remarks: list[str]) -> Source:
    fullest = max(topics, key=lambda topic: len(topics[topic]))
    first_ns = topics[fullest][0][0]
    time_s = np.array([(stamp - first_ns) / NS_PER_S for stamp, _ in topics[fullest]])
    columns: dict[str, Any] = {"time_s": time_s}
    for topic, rows in topics.items():
        own_s = np.array([(stamp - first_ns) / NS_PER_S for stamp, _ in rows])
        order = np.argsort(own_s, kind="stable")
        label = "" if len(topics) == 1 else topic.strip("/").replace("/", ".") + "."
        for name in dict.fromkeys(name for _, numbers in rows for name in numbers):
            values = np.array([numbers.get(name, np.nan) for _, numbers in rows])
            if topic != fullest:
                heading, unit = split_name(name)
                values = at_stamps(values, own_s, time_s, measured_wrap(heading, unit, values[order]))
            columns[label + name] = values
        if topic != fullest:
            remarks.append(f"{topic} is interpolated to the stamps of {fullest}")
    return source_of_arrays(path, columns, tuple(remarks))

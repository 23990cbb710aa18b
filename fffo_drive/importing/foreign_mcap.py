"""MCAP files of other programs: every numeric field of every topic, whatever the schema (ROS 2, protobuf, JSON)."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from ..recording.errors import RecordingError
from ..recording.scan import HEAD_SIZE, DamagedRecordError, Scanner, parse, record_data, segments
from ..units import NS_PER_S
from .evidence import at_stamps
from .joints import with_joints
from .names import measured_wrap
from .source import Source, source_of_arrays
from .units import split_name

DEEPEST = 6
MESSAGE_HEAD = 22  # channel u2, sequence u4, log time u8, publish time u8
LEAST_LEFT_OVER = 4  # bytes: fewer may be padding
MOST_CHECKED = 1 << 16  # bytes of a message of which the end is looked at: a picture is no log of an axis
MOST_WRONG = 0.01  # of the messages of a topic that may not fit their schema
LONGEST_REASON = 160
LARGEST_ARRAY = 64  # numbers of a message that become columns: an image is no log of an axis


class _Topic:
    """What came of the messages of one channel."""

    def __init__(self, channel: Channel, schema: Schema | None) -> None:
        self.name, self.encoding, self.schema = channel.topic, channel.message_encoding, schema
        self.rows: list[tuple[int, dict[str, float]]] = []  # stamps in ns: seconds since 1970 lose digits
        self.wrong = 0
        self.why = ""
        self.checked = False
        try:
            self.decode = self._decoder()
            kind = f"a schema in {schema.encoding!r}" if schema else "no schema"
            self.refusal = "" if self.decode else f"has the encoding {self.encoding!r} with {kind}, which is not read"
        except Exception as error:  # the parsers of schemas raise whatever their text leads them to
            self.decode, self.refusal = None, f"has a schema that cannot be used ({_plain(error)})"

    def _decoder(self) -> Callable[[bytes], Any] | None:
        from mcap_protobuf.decoder import DecoderFactory as Protobuf
        from mcap_ros2.decoder import DecoderFactory as Ros2

        if self.encoding == "json":
            return json.loads
        made = (factory.decoder_for(self.encoding, self.schema) for factory in (Ros2(), Protobuf()))
        return next(filter(None, made), None)

    def take(self, log_time_ns: int, data: bytes) -> None:
        """Decode one message; one that does not fit the schema is counted, and the first of them described."""
        assert self.decode is not None
        try:
            value = self.decode(data)
            numbers = dict(_numbers("", value))
            if not self.checked and self.encoding == "cdr" and _left_over(self.decode, data):
                raise ValueError("the message has bytes that the schema does not know")
            self.checked = True
        except Exception as error:  # struct.error, DecodeError, NotImplementedError, ...: one for each library
            self.wrong += 1
            self.why = self.why or _plain(error)
            return
        stamp_ns = _stamp_ns(numbers)
        numbers = {name: value for name, value in numbers.items() if not _is_stamp(name)}
        if numbers:
            self.rows.append((log_time_ns if stamp_ns is None else stamp_ns, numbers))

    @property
    def lies(self) -> bool:
        """Whether so many messages do not fit the schema that it is not theirs."""
        return self.wrong > MOST_WRONG * (self.wrong + len(self.rows))

    def remark(self) -> str | None:
        """What was left out of the topic."""
        if self.refusal:
            return f"left out: topic {self.name} {self.refusal}"
        if not self.wrong:
            return None
        own = f"topic {self.name}" if self.lies else f"messages of topic {self.name}"
        every = self.wrong + len(self.rows)
        return f"left out: {own}: {self.wrong} of {every} do not fit the schema, the first for {self.why}"


def read_foreign_mcap(path: Path) -> Source:
    """All topics on the time of the one with the most messages: stamps of the header, else those of the log.

    A file that was never closed, or is damaged, is read as far as it goes. Raises RecordingError for one that cannot be
    read, or that has no numbers in it.
    """
    topics: dict[int, _Topic] = {}
    schemas: dict[int, Schema] = {}
    with path.open("rb") as file:
        scanner = Scanner(file, str(path))
        for record in scanner:
            try:
                data = scanner.contents(record) if record.opcode == Opcode.CHUNK else record_data(record)
                if record.opcode in (Opcode.CHUNK, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                    _take(data, schemas, topics)
            except DamagedRecordError as error:
                scanner.damage(record, str(error))
                break
    remarks = [text for topic in topics.values() if (text := topic.remark())]
    if scanner.tear:
        remarks.append(f"the file {scanner.tear}: read up to there (fffo-drive log recover mends it)")
    found: dict[str, list[tuple[int, dict[str, float]]]] = {}
    for topic in topics.values():
        found.setdefault(topic.name, []).extend([] if topic.lies else topic.rows)
    found = {name: rows for name, rows in found.items() if len(rows) > 1}
    if not found:
        raise RecordingError(f"{path}: no topic with numbers in it" + ("; " + "; ".join(remarks) if remarks else ""))
    return _joined(path, found, remarks)


def _take(data: bytes, schemas: dict[int, Schema], topics: dict[int, _Topic]) -> None:
    """The records of a chunk. Raises DamagedRecordError."""
    for part in segments(data):
        for k in range(part.repeats):
            begin = part.offset + k * part.size
            body = data[begin + HEAD_SIZE : begin + part.size]
            if part.opcode == Opcode.SCHEMA:
                schema = parse(Schema.read, body)
                schemas[schema.id] = schema
            elif part.opcode == Opcode.CHANNEL:
                channel = parse(Channel.read, body)
                topics.setdefault(channel.id, _Topic(channel, schemas.get(channel.schema_id)))
            elif part.channel not in topics:
                raise DamagedRecordError(f"a message of channel {part.channel}, which is not in the file")
            elif topics[part.channel].decode is not None:
                log_time_ns = int.from_bytes(body[6:14], "little")
                topics[part.channel].take(log_time_ns, body[MESSAGE_HEAD:])


def _left_over(decode: Callable[[bytes], Any], data: bytes) -> bool:
    """Whether the last bytes of a CDR message mean nothing to its schema; up to three may be padding."""
    if not LEAST_LEFT_OVER <= len(data) - LEAST_LEFT_OVER <= MOST_CHECKED:
        return False
    told = repr(decode(data))
    for filler in (b"\x00", b"\xff"):
        try:
            if repr(decode(data[:-LEAST_LEFT_OVER] + LEAST_LEFT_OVER * filler)) != told:
                return False
        except Exception:  # as in `take`: they meant something
            return False
    return True


def _plain(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".replace("\n", " ").strip()[:LONGEST_REASON]


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
                named = (f"{joint}.{label}" if len(joints) == 1 else f"{label}[{joint}]" for joint in joints)
                yield from ((one, float(number)) for one, number in zip(named, inner, strict=True))
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
    return with_joints(source_of_arrays(path, columns, tuple(remarks)))

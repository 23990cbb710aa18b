"""Messages for viewers as ROS 2 messages: schema texts and CDR, both from one list of fields.

Foxglove and Lichtblick read anything with a schema; PlotJuggler's bridge reads only CDR with `ros2msg`. A bin has the
topic and field names of a recorded row, so that one layout shows both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any, NamedTuple

from ..recording.cdr import Field, encode, schema_of
from ..recording.events import EVENT_SCHEMA, Event, Level
from ..recording.schema import CDR_HEADER, EVENT_TOPIC, EVENT_TYPE, ROW_TOPIC
from ..signals import SIGNALS
from ..units import NS_PER_S
from .decimation import LAST, LATENESS_EDGES_US, MAXIMUM, MINIMUM, Matrix

BIN_TOPIC, BIN_TYPE = ROW_TOPIC, "fffo_drive_msgs/msg/Bin"
STATE_TOPIC, STATE_TYPE = "/fffo_drive/state", "fffo_drive_msgs/msg/State"
LATENESS_TOPIC, LATENESS_TYPE = "/fffo_drive/lateness", "fffo_drive_msgs/msg/Lateness"
LOG_TOPIC, LOG_TYPE = "/fffo_drive/log", "rcl_interfaces/msg/Log"

_LEVELS = {level.name.lower(): level for level in Level}


class Message(NamedTuple):
    """A flat message of numbers and strings."""

    topic: str
    type: str
    title: str
    fields: tuple[Field, ...]

    @property
    def schema(self) -> str:
        """`ros2msg`, unit and meaning as comments."""
        return schema_of(self.title, self.fields)

    def encode(self, values: Mapping[str, Any]) -> bytes:
        """CDR, little-endian, with its header."""
        return encode((field.kind, values[field.name]) for field in self.fields)


def _bin_fields() -> tuple[Field, ...]:
    fields = []
    for signal in SIGNALS:
        fields += [
            Field("float64", signal.name, signal.unit, f"{signal.meaning}: last of the bin"),
            Field("float64", f"{signal.name}_min", signal.unit, "smallest of the bin"),
            Field("float64", f"{signal.name}_max", signal.unit, "largest of the bin"),
        ]
    return tuple(fields)


def _lateness_names() -> tuple[str, ...]:
    return (*(f"within_{edge}_us" for edge in LATENESS_EDGES_US), f"beyond_{LATENESS_EDGES_US[-1]}_us")


BIN = Message(BIN_TOPIC, BIN_TYPE, "Ticks of 20 ms: last, smallest and largest value of each signal.", _bin_fields())

LATENESS = Message(
    LATENESS_TOPIC, LATENESS_TYPE, "Lateness of the ticks of about a second: each is counted once.",
    (
        Field("uint32", "ticks", "-", "ticks counted"),
        Field("uint32", "late", "-", "of them beyond the configured share of the period"),
        Field("uint32", "lost", "-", "rows that this stream was too slow to read; the recording has its own reader"),
        *(Field("uint32", name, "-", "ticks in this class alone") for name in _lateness_names()),
    ),
)  # fmt: skip

STATE = Message(
    STATE_TOPIC, STATE_TYPE, "State of the axis.",
    (
        Field("float64", "state_s", "s", "how long it has been in this state"),
        Field("float64", "profile_share", "-", "how much of the running profile is done; NaN when none runs"),
        Field("int64", "tick", "-", "of the loop; -1 without one"),
        Field("int64", "late", "-", "late ticks since the loop began; -1 without one"),
        Field("int64", "skipped", "-", "skipped ticks since the loop began; -1 without one"),
        Field("int64", "missing_feedback", "-", "ticks without an answer since the loop began; -1 without a loop"),
        Field("int64", "epoch", "-", "raised by every stop, an argument of `start` and `enable`; -1 when unknown"),
        Field("int64", "rows_written", "-", "rows in the recording; -1 when there is none"),
        Field("string", "state", "-", "connected, ready, enabled, running, following, ...: `info` lists them all"),
        Field("string", "fault", "-", "name of the latched fault; empty without one"),
        Field("string", "fault_text", "-", "the same for people"),
        Field("string", "obstacles", "-", "why the axis may not be enabled"),
        Field("string", "toggle", "-", "friction from ff (reference), fb (feedback) or off"),
        Field("string", "profile", "-", "name of the running profile"),
        Field("string", "model", "-", "name of the model in use"),
        Field("string", "drive_state", "-", "state of the drive after CiA 402"),
        Field("string", "trouble", "-", "of the recording; empty without any"),
        Field("bool", "recording", "-", "a recording is on"),
    ),
)  # fmt: skip

MESSAGES = (BIN, LATENESS, STATE)
SCHEMAS = {
    **{message.topic: (message.type, message.schema) for message in MESSAGES},
    EVENT_TOPIC: (EVENT_TYPE, EVENT_SCHEMA),
    LOG_TOPIC: (
        LOG_TYPE,
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\n"
        f"uint32 line\n{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n",
    ),
}  # topic -> (type, ros2msg)


def bin_payloads(bins: Matrix) -> list[bytes]:
    """Each of (bins, signals, 3) as a message `BIN`."""
    ordered = bins[:, :, (LAST, MINIMUM, MAXIMUM)]
    return [CDR_HEADER + one.tobytes() for one in ordered]


def lateness_payload(counts: Iterable[int], ticks: int, late: int, lost: int) -> bytes:
    """A message `LATENESS`."""
    classes = dict(zip(_lateness_names(), map(int, counts), strict=True))
    return LATENESS.encode({"ticks": ticks, "late": late, "lost": lost, **classes})


def state_payload(status: Mapping[str, Any]) -> bytes:
    """A message `STATE` of a `status` of the control API."""
    loop, profile, fault = status["loop"] or {}, status["profile"] or {}, status["fault"] or {}
    recording = status["recording"]
    counts = {name: loop.get(name, -1) for name in ("tick", "late", "skipped", "missing_feedback")}
    return STATE.encode({
        **counts,
        "state_s": status["state_s"],
        "profile_share": profile["sample"] / max(1, profile["samples"]) if profile else float("nan"),
        "epoch": status.get("epoch", -1),
        "rows_written": recording.get("rows_written", -1),
        "state": status["state"],
        "fault": fault.get("name", ""),
        "fault_text": fault.get("text", ""),
        "obstacles": "; ".join(status["obstacles"]),
        "toggle": status["toggle"],
        "profile": profile.get("name", ""),
        "model": status["model"]["name"],
        "drive_state": (status["drive"] or {}).get("state", ""),
        "trouble": recording["trouble"],
        "recording": recording["on"],
    })  # fmt: skip


def event_of(event: Mapping[str, Any]) -> Event:
    """An event of the control API as it is recorded."""
    level = _LEVELS.get(event["level"], Level.INFO)
    return Event(time_ns_of(event["time"]), level, "supervisor", event["text"], {"kind": event["kind"]})


def log_payload(event: Event) -> bytes:
    """The event for a log panel."""
    seconds, rest_ns = divmod(event.time_ns, NS_PER_S)
    empty = (("string", ""), ("string", ""), ("uint32", 0))
    return encode((
        ("uint32", seconds), ("uint32", rest_ns), ("uint8", int(event.level)), ("string", event.source),
        ("string", event.text), *empty,
    ))  # fmt: skip


def time_ns_of(text: str) -> int:
    """The inverse of `recording.events.utc_text`."""
    whole, _, fraction = text.removesuffix("Z").partition(".")
    seconds = int(datetime.fromisoformat(whole).replace(tzinfo=UTC).timestamp())
    return seconds * NS_PER_S + int(fraction.ljust(9, "0")[:9] or 0)

"""Records: numbered, with all values, of what was in force in a run and what was requested.

A row names the parameters, the effects and the profile that were in use by their numbers, and the last request that
the loop had seen when its tick began (`request_number`): rows and records are matched by numbers, never by clocks. The
records in force are written at the beginning of every file, with the loop's memory before its first row, so that each
file is self-contained.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

from ..documents import json_object
from .cdr import Field, decode, encode, schema_of
from .events import json_text

RECORD_TOPIC = "/fffo_drive/records"
RECORD_TYPE = "fffo_drive_msgs/msg/Record"
RECORD_FIELDS = (
    Field("uint64", "time_ns", "ns", "wall clock when it was made, Unix epoch"),
    Field("uint32", "sequence", "-", "place among the session's records; a row's request_number is one; memory: 0"),
    Field(
        "uint32",
        "number",
        "-",
        "as rows name it: of parameters, effects, profile, set point; memory: row_number of the row behind it; also "
        "model and reset",
    ),
    Field(
        "string",
        "kind",
        "-",
        "session, model, parameters, effects, profile, set_point, memory, request, or a loop's word",
    ),
    Field("string[]", "names", "-", "of the values; units as suffixes"),
    Field("float64[]", "values", "-", "bit for bit as the loop has them"),
    Field("string", "data", "-", "JSON object for programs: names, texts, hashes, who asked for what"),
)
RECORD_SCHEMA = schema_of("What was in force, and what was asked for.", RECORD_FIELDS)


class RecordKind(StrEnum):
    """Kind of a record."""

    SESSION = "session"  # times of the loop, limits of the envelope, the session's id
    MODEL = "model"  # a model file: name, content hash, text
    PARAMETERS = "parameters"  # a whole controller block
    EFFECTS = "effects"  # a whole table of compensated effects
    PROFILE = "profile"  # a profile handed to the loop; its samples are in the rows
    SET_POINT = "set_point"  # a live set point handed to the loop: control.set_point.SetPoint
    MEMORY = "memory"  # what the loop remembered before the first row of a file that begins in its midst
    REQUEST = "request"  # who asked for what
    GOAL = "goal"  # from here on words of the loop: drive.cia402.GOAL_*
    TOGGLE = "toggle"  # control.friction_observer.TOGGLE_*
    IN_SERVICE = "in_service"  # effects in service, as bits
    RESET = "reset"  # of the latched trip and the drive's fault
    ABORT = "abort"  # the number of a profile that has to end at once
    SET_POINT_ABORT = "set_point_abort"  # the number of a set point whose motion is to end at once
    STOP = "stop"  # the loop is to end
    AUTOSTOP = "autostop"  # the loop has to end with the profile


NAMED_BY_ROWS: dict[str, str] = {  # kind -> the row's field with its number
    RecordKind.PARAMETERS: "parameters_number",
    RecordKind.EFFECTS: "effects_number",
    RecordKind.PROFILE: "profile_number",
    RecordKind.SET_POINT: "set_point_number",
}
REQUEST_NUMBER = "request_number"


class RunRecord(NamedTuple):
    """One record. Values that are integers are exact up to 2^53."""

    time_ns: int  # wall clock, Unix epoch
    sequence: int
    number: int
    kind: str  # Kind, or one that a later version knows
    names: tuple[str, ...] = ()
    values: tuple[float, ...] = ()
    data: Mapping[str, Any] = {}

    @property
    def by_name(self) -> dict[str, float]:
        """The values by their names."""
        return dict(zip(self.names, self.values, strict=True))

    def as_dict(self) -> dict[str, Any]:
        """For JSON output."""
        fields = self._asdict()
        return json_object(json_text({**fields, "names": list(self.by_name), "values": list(self.values)}))


def encode_record(record: RunRecord) -> bytes:
    """CDR payload (with header) of `RECORD_SCHEMA`."""
    values = (*record[:6], json_text(record.data))
    return encode((field.kind, value) for field, value in zip(RECORD_FIELDS, values, strict=True))


def decode_record(payload: bytes) -> RunRecord:
    """The inverse of `encode_record`; raises ValueError for bytes that are no record."""
    values = decode(payload, RECORD_FIELDS)
    if len(values["names"]) != len(values["values"]):
        raise ValueError("a record with another number of names than of values")
    return RunRecord(**{**values, "data": json_object(values["data"])})


def still_in_force(records: Iterable[RunRecord], row: Any) -> list[RunRecord]:
    """The records (in their order) that this row or a later one can name, and the last of each kind.

    These are a record named by the row and all later ones; for other kinds, the last one that the loop had seen and all
    later ones.
    """
    given = list(records)
    seen = int(row[REQUEST_NUMBER])
    last = {record.kind: record.sequence for record in given if record.sequence <= seen}

    def is_current(record: RunRecord) -> bool:
        name = NAMED_BY_ROWS.get(record.kind)
        return record.number >= int(row[name]) if name else record.sequence > seen

    kept = [record for record in given if is_current(record) or last.get(record.kind) == record.sequence]
    models = {record.data.get("model") for record in kept if record.kind == RecordKind.PARAMETERS}
    kept += [record for record in given if record.kind == RecordKind.MODEL and record.data["content_hash"] in models]
    by_sequence = {record.sequence: record for record in kept}
    return [by_sequence[number] for number in sorted(by_sequence)]


class FileStart(NamedTuple):
    """Where a file may begin in the midst of a motion."""

    row: int  # the first one, counted from the first that the ring ever got
    memory: RunRecord  # what the loop remembered before it


class MemorySource(Protocol):
    """A loop that hands out its memory behind a tick. Nothing waits for it."""

    def ask_for_memory(self) -> int | None:
        """Ask. Returns the number of the request; None where no loop is left to answer."""
        ...

    def memory_given(self, number: int) -> FileStart | None:
        """The answer to this request or a later one; None until there is one."""
        ...


Listener = Callable[[RunRecord], None]


class RecordBook:
    """The records of a session that are in force, and the listeners for new ones. Thread-safe."""

    def __init__(self, wall_ns: Callable[[], int] = time.time_ns) -> None:
        self._wall_ns = wall_ns
        self._lock = threading.Lock()
        self._records: list[RunRecord] = []
        self._listeners: list[Listener] = []

    def add(self, record: RunRecord) -> None:
        """Add a record with the present time; the listeners are called before this returns."""
        with self._lock:
            record = record._replace(time_ns=self._wall_ns())
            self._records.append(record)
            for listener in self._listeners:
                listener(record)

    def forget(self, row: Any) -> None:
        """Drop records that neither this row nor later ones name."""
        with self._lock:
            self._records = still_in_force(self._records, row)

    def listen(self, listener: Listener) -> list[RunRecord]:
        """Subscribe to all records from now on (the listener must not wait). Return those in force: none is missed or
        doubled.
        """
        with self._lock:
            self._listeners.append(listener)
            return list(self._records)

    def leave(self, listener: Listener) -> None:
        """Unsubscribe."""
        with self._lock:
            self._listeners = [other for other in self._listeners if other != listener]

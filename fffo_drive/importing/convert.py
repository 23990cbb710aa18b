"""A recognised log in our signals and units, and as a recording of ours with the facts that it needs."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from ..arrays import Floats
from ..recording.container import ChunkBuilder, McapFile, record_bytes
from ..recording.errors import RecordingError
from ..recording.schema import (
    CDR_HEADER,
    MESSAGE_ENCODING,
    METADATA_NAME,
    PROFILE,
    ROW_TOPIC,
    ROW_TYPE,
    SCHEMA_ENCODING,
    message_dtype,
    schema_text,
)
from ..recording.writer import LIBRARY
from ..signals import MEASURED_TORQUE, REFERENCE_POSITION, SIGNALS, TEMPERATURE, Signal
from ..units import NS_PER_S, unit_on
from .candidates import (
    COMMAND_A,
    CURRENT_A,
    ENCODER_REV,
    POSITION_REV,
    REFERENCE_RPS,
    SETPOINT_REV,
    TIME_S,
    VELOCITY_RPS,
    AnswerNeededError,
    Guess,
    Recognition,
)
from .evidence import bridged, signed, unwrapped
from .source import Source
from .times import clock_time

FACTS_NAME = "facts.yaml"  # of the attachment that a recording carries
YAML_TYPE = "application/yaml"
CHUNK_ROWS = 4096
DATE_FROM = "date_from"  # in the metadata of what is imported: where the date of its messages comes from
DATE_OF_CLOCK, DATE_OF_FILE = "clock of the log", "modification time of the source file"
MOST_LEFT_OUT = 0.01  # of the rows of a run, without `drop`
WRITTEN = (
    POSITION_REV,
    VELOCITY_RPS,
    REFERENCE_RPS,
    COMMAND_A,
    CURRENT_A,
    ENCODER_REV,
    TEMPERATURE.name,
    MEASURED_TORQUE.name,
)


class Converted(NamedTuple):
    """A log in our signals: `time_s` from 0, the others by their names; rows that miss something are not there."""

    columns: dict[str, Floats]
    remarks: tuple[str, ...]
    doubts: tuple[str, ...] = ()  # what is assumed of columns and units
    torque_unit: str = "A"  # of the input: A, Nm, N, V, or the column's own
    left_out: int = 0  # rows that miss a number, or whose stamp is not later than all before
    begin_s: float = 0.0  # stamp of the first row, on the clock of the log


def converted(source: Source, found: Recognition, drop: bool = True, from_zero: bool = True) -> Converted:
    """All signals in our units, wraps undone, rows without a time or a number left out (they are gaps).

    `drop`: however many. `from_zero`: the time, else on the clock of the log. Raises RecordingError where nothing is
    left, AnswerNeededError for more rows than MOST_LEFT_OUT.
    """
    columns = {guess.signal: _values(source, guess) for guess in found.guesses}
    remarks = [*source.remarks, *(f"left out: {name!r} {why}" for name, why in source.left.items()), *found.remarks]
    if found.period_s is not None:
        columns[TIME_S] = np.arange(source.rows, dtype=np.float64) / (1.0 / found.period_s)
    if TEMPERATURE.name in columns:  # logged as it changes
        columns[TEMPERATURE.name] = bridged(columns[TEMPERATURE.name])
    usable = np.logical_and.reduce([np.isfinite(values) for values in columns.values()])
    left_out = int((~usable).sum())
    if not usable.all():
        first = int(np.argmin(usable))
        miss = next(guess.column for guess in found.guesses if not np.isfinite(columns[guess.signal][first]))
        remarks.append(
            f"{left_out} of {usable.size} rows miss a number and are left out: they are gaps; the first is "
            f"{source.place(first)}, column {miss!r}"
        )
    if found.enable is not None:
        on = np.nan_to_num(source.columns[found.enable]) > 0.5
        if on.any() and not on.all():
            first, last = np.flatnonzero(on)[[0, -1]]
            inside = np.zeros(on.size, bool)
            inside[first : last + 1] = True
            remarks.append(f"{int((~inside).sum())} rows before and after {found.enable!r} are left out: no torque")
            usable &= inside
    time_s = np.where(usable, columns[TIME_S], -np.inf)
    later = usable & np.concatenate([[True], time_s[1:] > np.maximum.accumulate(time_s)[:-1]])
    late = usable & ~later
    left_out += int(late.sum())
    if late.any():
        remarks.append(
            f"{int(late.sum())} rows whose stamp is not later than all before are left out, the first is "
            f"{source.place(int(np.argmax(late)))}"
        )
    if later.sum() < 2:
        raise RecordingError(f"{source.path}: no two rows hold a number in all of {', '.join(columns)}")
    if left_out > MOST_LEFT_OUT * source.rows and not drop:
        why = "; ".join(remark for remark in remarks if "left out" in remark and "row" in remark)
        raise AnswerNeededError(
            f"{source.said}: {100.0 * left_out / source.rows:.3g} % of its rows would be left out ({why}): "
            "--drop accepts that",
            "--drop",
        )
    columns = {name: np.ascontiguousarray(values[later]) for name, values in columns.items()}
    begin_s = float(columns[TIME_S][0])
    if from_zero:
        columns[TIME_S] = columns[TIME_S] - begin_s
    setpoint = columns.pop(SETPOINT_REV, None)
    if setpoint is not None and REFERENCE_RPS not in columns:
        columns[REFERENCE_RPS] = np.gradient(setpoint, columns[TIME_S])
        guess = found.of(SETPOINT_REV)
        assert guess is not None
        remarks.append(f"the reference is the derivative of {guess.column!r}")
    return Converted(columns, tuple(remarks), assumed(found), found.torque_unit, left_out, begin_s)


def assumed(found: Recognition) -> tuple[str, ...]:
    """What names, units and data leave open, in words."""
    return tuple(f"{g.signal} is {g.column!r} [{g.unit}]: {g.evidence}" for g in found.guesses if not g.sure)


def _values(source: Source, guess: Guess) -> Floats:
    raw = signed(source.columns[guess.column], guess.register)
    if guess.wrap is not None:
        raw = unwrapped(raw, guess.wrap)
    if (guess.factor, guess.shift) == (1.0, 0.0):
        return raw
    return np.asarray(raw * guess.factor + guess.shift)


def write_recording(
    path: Path, source: Path, log: Converted, facts: str, linear: bool, assumed: Sequence[str] = ()
) -> None:
    """The log as a recording of ours: rows at the stamps of the log, with the `facts` (YAML) and what was `assumed`.

    The messages have the date of the log: by its own clock where that is one of a calendar, else of its file, and the
    metadata say which.
    """
    names = [name for name in WRITTEN if name in log.columns]
    by_name = {signal.name: signal for signal in (*SIGNALS, REFERENCE_POSITION, TEMPERATURE, MEASURED_TORQUE)}
    signals = [by_name["deadline_ns"]._replace(meaning="time of the sample on the clock of the log")]
    for name in names:
        own = by_name[name]
        unit = unit_on(own.unit, linear)
        signals.append(Signal(name, own.dtype, unit, own.meaning))
    stamps = np.round(log.columns[TIME_S] * NS_PER_S).astype(np.int64)
    rows = np.empty(stamps.size, [(s.name, s.dtype) for s in signals])
    rows["deadline_ns"] = stamps
    for name in names:
        rows[name] = log.columns[name]
    by_clock = clock_time(log.begin_s)
    start_ns = round(log.begin_s * NS_PER_S) if by_clock else source.stat().st_mtime_ns
    metadata = {
        DATE_FROM: DATE_OF_CLOCK if by_clock else DATE_OF_FILE,
        "tool": LIBRARY, "imported_from": source.name, "sha256": hashlib.sha256(source.read_bytes()).hexdigest(),
        "remarks": "\n".join([*(f"assumed: {one}" for one in assumed), *log.remarks]),
    }  # fmt: skip
    schema = Schema(
        id=1, name=ROW_TYPE, encoding=SCHEMA_ENCODING, data=schema_text(signals, "One sample of a log.").encode()
    )
    channel = Channel(id=1, topic=ROW_TOPIC, message_encoding=MESSAGE_ENCODING, metadata={}, schema_id=1)
    with path.open("xb") as file:
        mcap = McapFile(file, PROFILE, LIBRARY)
        mcap.add_metadata(METADATA_NAME, metadata)
        mcap.add_attachment(FACTS_NAME, YAML_TYPE, facts.encode())
        for begin in range(0, stamps.size, CHUNK_ROWS):
            chunk = ChunkBuilder()
            for record in (schema, channel):
                if begin == 0:
                    mcap.register(record)
                    chunk.add_record(record_bytes(record))
            part = slice(begin, begin + CHUNK_ROWS)
            times_ns = start_ns + stamps[part]
            chunk.add_messages(1, _messages(rows[part], times_ns, begin), times_ns.astype(np.uint64))
            mcap.add_chunk(chunk)
        mcap.finish()


def _messages(rows: np.ndarray[Any, Any], times_ns: np.ndarray[Any, Any], first: int) -> bytes:
    """MCAP messages of rows, one after another."""
    size = len(CDR_HEADER) + rows.itemsize
    found = np.empty(rows.size, message_dtype(size))
    found["opcode"] = Opcode.MESSAGE
    found["length"] = found.itemsize - 9
    found["channel"] = 1
    found["sequence"] = first + np.arange(rows.size)
    found["log_time"] = found["publish_time"] = times_ns
    payload = np.empty((rows.size, size), np.uint8)
    payload[:, : len(CDR_HEADER)] = np.frombuffer(CDR_HEADER, np.uint8)
    payload[:, len(CDR_HEADER) :] = np.frombuffer(rows.tobytes(), np.uint8).reshape(rows.size, rows.itemsize)
    found["payload"] = payload.view(f"V{size}").ravel()
    return found.tobytes()

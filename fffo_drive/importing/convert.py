"""A recognised log in our signals and units, and as a recording of ours with the facts that it needs."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from ..arrays import Floats
from ..documents import check
from ..formats import FACTS
from ..identification.dataset import DataError, record_of_columns
from ..identification.facts import DriveFacts
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
from ..signals import REFERENCE_POSITION, SIGNALS, TEMPERATURE, Signal
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
    Guess,
    Recognition,
)
from .evidence import bridged, signed, unwrapped
from .source import Source

FACTS_NAME = "facts.yaml"  # of the attachment that a recording carries
YAML_TYPE = "application/yaml"
CHUNK_ROWS = 4096
WRITTEN = (POSITION_REV, VELOCITY_RPS, REFERENCE_RPS, COMMAND_A, CURRENT_A, ENCODER_REV, TEMPERATURE.name)


class Converted(NamedTuple):
    """A log in our signals: `time_s` from 0, the others by their names; rows that miss something are not there."""

    columns: dict[str, Floats]
    remarks: tuple[str, ...]
    left_out: int = 0  # rows that miss a number, or whose stamp is not later than all before


def converted(source: Source, found: Recognition) -> Converted:
    """All signals in our units, wraps undone, rows without a time or a number left out (they are gaps).

    Raises RecordingError where nothing is left.
    """
    columns = {guess.signal: _values(source, guess) for guess in found.guesses}
    remarks = [*source.remarks, *found.remarks]
    if found.period_s is not None:
        columns[TIME_S] = np.arange(source.rows, dtype=np.float64) * found.period_s
    if TEMPERATURE.name in columns:  # logged as it changes
        columns[TEMPERATURE.name] = bridged(columns[TEMPERATURE.name])
    usable = np.logical_and.reduce([np.isfinite(values) for values in columns.values()])
    left_out = int((~usable).sum())
    if not usable.all():
        remarks.append(f"{int((~usable).sum())} of {usable.size} rows miss a number and are left out: they are gaps")
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
    left_out += int((usable & ~later).sum())
    if (usable & ~later).any():
        remarks.append(f"{int((usable & ~later).sum())} rows whose stamp is not later than all before are left out")
    if later.sum() < 2:
        raise RecordingError(f"{source.path}: no two rows hold a number in all of {', '.join(columns)}")
    columns = {name: np.ascontiguousarray(values[later]) for name, values in columns.items()}
    columns[TIME_S] = columns[TIME_S] - columns[TIME_S][0]
    setpoint = columns.pop(SETPOINT_REV, None)
    if setpoint is not None and REFERENCE_RPS not in columns:
        columns[REFERENCE_RPS] = np.gradient(setpoint, columns[TIME_S])
        guess = found.of(SETPOINT_REV)
        assert guess is not None
        remarks.append(f"the reference is the derivative of {guess.column!r}")
    return Converted(columns, tuple(remarks), left_out)


def usable(name: str, log: Converted, found: Recognition) -> Converted:
    """The log without its velocity, where that keeps it from a fit and the position does not."""
    if VELOCITY_RPS not in log.columns or POSITION_REV not in log.columns:
        return log
    facts = facts_of(found, {})
    try:
        record_of_columns(name, log.columns, facts)
    except DataError as error:
        rest = {key: values for key, values in log.columns.items() if key != VELOCITY_RPS}
        try:
            record_of_columns(name, rest, facts)
        except DataError:
            return log
        reason = str(error).removeprefix(f"{name}: ")
        return log._replace(
            columns=rest,
            remarks=(*log.remarks, f"the velocity is left out, it contradicts the position: {reason}"),
        )
    return log


def _values(source: Source, guess: Guess) -> Floats:
    raw = signed(source.columns[guess.column], guess.register)
    if guess.wrap is not None:
        raw = unwrapped(raw, guess.wrap)
    return np.asarray(raw * guess.factor)


def facts_of(found: Recognition, declared: Mapping[str, Any]) -> DriveFacts:
    """The facts of a recognised log: `declared` by the user, a torque constant of one where none is.

    Raises DocumentError with everything that cannot be declared so.
    """
    given = {key: value for key, value in declared.items() if value is not None}
    if found.linear:
        given["units"] = "linear"
    given.setdefault("torque_constant_nm_per_a", 1.0)
    return check(given, DriveFacts, "what is declared")


def write_facts(path: Path, facts: DriveFacts) -> None:
    """The facts as a file that `--drive` takes."""
    path.write_text(_facts_text(facts), encoding="utf-8")


def _facts_text(facts: DriveFacts) -> str:
    content = {"format": FACTS.word, **facts.model_dump(exclude_defaults=True)}
    return yaml.safe_dump(content, sort_keys=False)


def write_recording(path: Path, source: Path, log: Converted, facts: DriveFacts, assumed: Sequence[str] = ()) -> None:
    """The log as a recording of ours: rows at the stamps of the log, with the facts and what was `assumed` inside."""
    names = [name for name in WRITTEN if name in log.columns]
    by_name = {signal.name: signal for signal in (*SIGNALS, REFERENCE_POSITION, TEMPERATURE)}
    signals = [by_name["deadline_ns"]._replace(meaning="time of the sample on the clock of the log")]
    for name in names:
        own = by_name[name]
        unit = unit_on(own.unit, facts.units == "linear")
        signals.append(Signal(name, own.dtype, unit, own.meaning))
    stamps = np.round(log.columns[TIME_S] * NS_PER_S).astype(np.int64)
    rows = np.empty(stamps.size, [(s.name, s.dtype) for s in signals])
    rows["deadline_ns"] = stamps
    for name in names:
        rows[name] = log.columns[name]
    metadata = {
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
        mcap.add_attachment(FACTS_NAME, YAML_TYPE, _facts_text(facts).encode())
        for begin in range(0, stamps.size, CHUNK_ROWS):
            chunk = ChunkBuilder()
            for record in (schema, channel):
                if begin == 0:
                    mcap.register(record)
                    chunk.add_record(record_bytes(record))
            part = slice(begin, begin + CHUNK_ROWS)
            chunk.add_messages(1, _messages(rows[part], stamps[part], begin), stamps[part].astype(np.uint64))
            mcap.add_chunk(chunk)
        mcap.finish()


def _messages(rows: np.ndarray[Any, Any], stamps: np.ndarray[Any, Any], first: int) -> bytes:
    """MCAP messages of rows, one after another."""
    size = len(CDR_HEADER) + rows.itemsize
    found = np.empty(rows.size, message_dtype(size))
    found["opcode"] = Opcode.MESSAGE
    found["length"] = found.itemsize - 9
    found["channel"] = 1
    found["sequence"] = first + np.arange(rows.size)
    found["log_time"] = found["publish_time"] = stamps
    payload = np.empty((rows.size, size), np.uint8)
    payload[:, : len(CDR_HEADER)] = np.frombuffer(CDR_HEADER, np.uint8)
    payload[:, len(CDR_HEADER) :] = np.frombuffer(rows.tobytes(), np.uint8).reshape(rows.size, rows.itemsize)
    found["payload"] = payload.view(f"V{size}").ravel()
    return found.tobytes()

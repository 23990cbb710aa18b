"""Records of a session, written from the inputs of the loop and read back for a replay."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Floats
from ..control.compensation import effect_names, table_numbers, table_of
from ..control.controller import CONTROLLER_NAMES
from ..control.envelope import EnvelopeConfig, default_reactions
from ..control.own_law import ControlLaw
from ..control.reference import Profile
from ..control.set_point import SET_POINT_NAMES, SetPoint
from ..model.effects.registry import LAWS, name_error
from ..packing import flat_names, pack
from ..recording.run_records import RecordKind, RunRecord
from ..units import NS_PER_S
from . import blocks as b
from .memory import (
    COMMANDS_A,
    EFFECTS_MEMORY,
    LOOP_MEMORY_NAMES,
    PACKED_SIZE,
    TRAJECTORY,
    PackedMemory,
    unpack_memory,
)
from .tick import LoopConfig

WORD_KINDS = {  # control words whose changes are records of their own
    b.STOP: RecordKind.STOP,
    b.GOAL: RecordKind.GOAL,
    b.TOGGLE: RecordKind.TOGGLE,
    b.PROFILE_ABORT: RecordKind.ABORT,
    b.SET_POINT_ABORT: RecordKind.SET_POINT_ABORT,
    b.RESET_NUMBER: RecordKind.RESET,
    b.AUTOSTOP: RecordKind.AUTOSTOP,
    b.EFFECTS: RecordKind.IN_SERVICE,
}
REACTION = "envelope.reactions."
LONGEST_TEXT = 1000  # characters of a value in a request


class ModelNote(NamedTuple):
    """A model file in a record."""

    name: str
    content_hash: str
    text: str  # of the whole file


MEMORY_NAMES = (
    *LOOP_MEMORY_NAMES,
    *(f"effects_memory.{k}" for k in range(COMMANDS_A - EFFECTS_MEMORY)),
    *(f"command_a.{k}" for k in range(TRAJECTORY - COMMANDS_A)),
    *(f"trajectory.{k}" for k in range(PACKED_SIZE - TRAJECTORY)),
)
MEMORY_PLACES = {name: place for place, name in enumerate(MEMORY_NAMES)}
# of the row behind which the memory was
OF_THE_ROW = ("tick", "parameters_number", "effects_number", "trip", "controlword", "resetting")


class MemoryBefore(NamedTuple):
    """What the loop remembered before a row, and what stood in the row before that."""

    row_number: int  # of the row before which it was
    packed: PackedMemory
    tick: int  # from here on of the row before
    parameters_number: int
    effects_number: int
    trip: int
    controlword: int
    resetting: int


class Unnumbered(NamedTuple):
    """A record without its place, as `Session` adds it."""

    number: int
    kind: RecordKind
    names: tuple[str, ...]
    values: tuple[float, ...]
    data: Mapping[str, Any]


def of_session(session_id: str, loop: LoopConfig, envelope: EnvelopeConfig) -> Unnumbered:
    """Times of the loop and limits of the envelope, constant for the whole session."""
    values = {f"loop.{name}": value for name, value in loop._asdict().items()}
    limits = envelope._asdict()
    reactions = limits.pop("reactions")
    values |= {f"envelope.{name}": value for name, value in limits.items()}
    values |= {f"{REACTION}{trip}": reaction for trip, reaction in enumerate(reactions)}
    return Unnumbered(0, RecordKind.SESSION, tuple(values), _floats(values.values()), {"session": session_id})


def of_model(number: int, model: ModelNote) -> Unnumbered:
    """A model file."""
    return Unnumbered(number, RecordKind.MODEL, (), (), model._asdict())


def of_parameters(number: int, block: Floats, model: ModelNote | None, own_law: ControlLaw | None = None) -> Unnumbered:
    """A packed controller block, the model from which it was made, and the law of a user that acts in its place."""
    data: dict[str, Any] = {} if model is None else {"model": model.content_hash}
    if own_law is not None:
        numbers = dict(zip(flat_names(type(own_law.config)), pack(own_law.config).tolist(), strict=True))
        data["controller"] = {"name": own_law.name, "file": own_law.file, "config": numbers}
    return Unnumbered(number, RecordKind.PARAMETERS, CONTROLLER_NAMES, _floats(block), data)


def of_effects(number: int, table: Floats) -> Unnumbered:
    """A table of compensated effects."""
    names, numbers = table_numbers(table)
    laws = effect_names(table)
    data = {"effects": laws, "brought_by": {law: LAWS.brought_by(law) for law in laws if LAWS.brought_by(law)}}
    return Unnumbered(number, RecordKind.EFFECTS, tuple(names), _floats(numbers), data)


def of_profile(number: int, profile: Profile) -> Unnumbered:
    """A profile. Its samples are in the rows, bit for bit; the record holds what is needed to compare them."""
    names = ("mode", "period_s", "samples", "least", "largest")
    extremes = (float(profile.values.min()), float(profile.values.max())) if profile.values.size else (0.0, 0.0)
    values = _floats((profile.mode, profile.period_s, profile.values.size, *extremes))
    return Unnumbered(
        number,
        RecordKind.PROFILE,
        names,
        values,
        {"name": profile.name, "values_sha256": values_digest(profile.values)},
    )


def of_set_point(number: int, set_point: SetPoint) -> Unnumbered:
    """A live set point, from which a replay recomputes the reference."""
    return Unnumbered(number, RecordKind.SET_POINT, SET_POINT_NAMES, _floats(set_point), {})


def of_memory(packed: Floats, row: Any) -> RunRecord:
    """The loop's memory (memory.PACKED_SIZE,) behind this row, as the first record of the file that begins with the
    next one. Only the arrays that are in use are written.
    """
    memory = unpack_memory(packed).memory
    kept = list(range(EFFECTS_MEMORY))
    if packed[EFFECTS_MEMORY:COMMANDS_A].any():
        kept += range(EFFECTS_MEMORY, COMMANDS_A)
    if memory.law.estimator.tick >= 0:
        kept += range(COMMANDS_A, TRAJECTORY)
    if memory.motion.start_tick >= 0:
        kept += range(TRAJECTORY, PACKED_SIZE)
    data = {name: int(row[name]) for name in OF_THE_ROW}
    # a clock in ns is beyond 2^53 after 104 days: whole numbers are exact here, the packed ones are float64
    data["woke_ns"] = int(row["deadline_ns"]) + int(row["lateness_ns"])
    number = (int(row["row_number"]) + 1) & 0xFFFFFFFF
    names = tuple(MEMORY_NAMES[k] for k in kept)
    return RunRecord(0, 0, number, RecordKind.MEMORY, names, _floats(packed[kept]), data)


def values_digest(values: Floats) -> str:
    """SHA-256 of samples as little-endian float64."""
    return hashlib.sha256(np.ascontiguousarray(values, "<f8").tobytes()).hexdigest()


def of_word(kind: RecordKind, value: int) -> Unnumbered:
    """A written control word."""
    return Unnumbered(value if kind is RecordKind.RESET else 0, kind, (kind.value,), (float(value),), {})


def of_request(who: str, what: str, values: Mapping[str, Any], epoch: int | None) -> Unnumbered:
    """A request and its sender. Long texts (a model has its own record) are replaced by their digest."""
    epoch_entry = {} if epoch is None else {"epoch": epoch}
    short = {name: _shortened(value) for name, value in values.items()}
    return Unnumbered(0, RecordKind.REQUEST, (), (), {"who": who, "what": what, "values": short, **epoch_entry})


def _shortened(value: Any) -> Any:
    if isinstance(value, str) and len(value) > LONGEST_TEXT:
        return f"sha256:{hashlib.sha256(value.encode()).hexdigest()}"
    return value


# ---- and back


def envelope_of(record: RunRecord) -> EnvelopeConfig:
    """The envelope of a `session` record. Raises ValueError for one that lacks a limit of today."""
    values = record.by_name
    fields: dict[str, Any] = {}
    for name, kind in EnvelopeConfig.__annotations__.items():
        if name == "reactions":
            continue
        if f"envelope.{name}" not in values:
            raise ValueError(f"the record of the session has no envelope.{name}")
        fields[name] = _as_declared(kind, values[f"envelope.{name}"])
    reactions = default_reactions()  # an older record has fewer trips
    for name, value in values.items():
        if name.startswith(REACTION):
            reactions[int(name.removeprefix(REACTION))] = int(value)
    return EnvelopeConfig(**fields, reactions=reactions)


def period_s_of(record: RunRecord) -> float:
    """Period of the loop of a `session` record, as the loop has it."""
    return record.by_name["loop.period_ns"] / NS_PER_S


def block_of(record: RunRecord) -> Floats:
    """The packed controller block of a `parameters` record. Raises ValueError for one of other parameters."""
    if record.names != CONTROLLER_NAMES:
        other = sorted(set(record.names) ^ set(CONTROLLER_NAMES))
        raise ValueError(f"parameters {record.number} have other names than this version's: {', '.join(other)}")
    return np.array(record.values)


def set_point_of(record: RunRecord) -> Floats:
    """The packed set point of a `set_point` record. Raises ValueError for one of other names."""
    if record.names != SET_POINT_NAMES:
        raise ValueError(f"set point {record.number} has other names than this version's: {', '.join(record.names)}")
    return np.array(record.values)


def effects_of(record: RunRecord) -> Floats:
    """The table of an `effects` record, for this process. Raises ValueError for effects that are not known here."""
    try:
        return table_of(record.values, record.data["effects"])
    except KeyError as error:
        name = error.args[0]
        missing = name_error(name, record.data.get("brought_by", {}).get(name))
        raise ValueError(f"effects {record.number}: {missing}") from None


def memory_before(record: RunRecord) -> MemoryBefore:
    """The memory of a `memory` record. Raises ValueError for one of other names."""
    packed = np.zeros(PACKED_SIZE)
    if record.names[:EFFECTS_MEMORY] != LOOP_MEMORY_NAMES or not MEMORY_PLACES.keys() >= set(record.names):
        raise ValueError(f"the memory before row {record.number} has other names than this version's")
    packed[[MEMORY_PLACES[name] for name in record.names]] = record.values
    unpacked = unpack_memory(packed)
    law = unpacked.memory.law
    if law.estimator.tick >= 0:
        law = law._replace(estimator=law.estimator._replace(woke_ns=int(record.data["woke_ns"])))
    unpacked = unpacked._replace(memory=unpacked.memory._replace(law=law))
    return MemoryBefore(record.number, unpacked, **{name: int(record.data[name]) for name in OF_THE_ROW})


def _as_declared(kind: str, value: float) -> float | int | bool:
    if kind == "bool":
        return bool(value)
    return int(value) if kind == "int" else value


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
